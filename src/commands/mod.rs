//! One file per subcommand: its arguments and what it does.

pub mod bench;
pub mod dataset;
pub mod demo;
pub mod eval;
pub mod import;
pub mod relight;
pub mod scene;
pub mod score;
pub mod shell;
pub mod studio;
pub mod train;
pub mod verify;

use crate::output::say_aside;
use anyhow::{Context, Result, bail};
use lumi_data::check::{self, Report};
use std::path::Path;

/// Makes sure, before the work begins, that results can be written to `path`, without making it yet: what fails
/// later leaves nothing behind.
fn check_output(path: &Path) -> Result<()> {
    // A folder may exist and still refuse files.
    tempfile::tempfile_in(standing(path)).with_context(|| {
        format!(
            "{}: expected a folder that can be written to",
            path.display()
        )
    })?;
    Ok(())
}

/// `path`, or what is nearest above it, that is there.
pub fn standing(path: &Path) -> &Path {
    let existing = path.ancestors().find(|p| p.exists());
    existing.unwrap_or(Path::new("."))
}

/// As [`check_output`], for the folder and the file that results go to, where they are asked for. The file's folder must
/// be there, unless it belongs to the output folder.
fn check_outputs(out: Option<&Path>, file: Option<&Path>) -> Result<()> {
    if let Some(out) = out {
        check_output(out)?;
    }
    let Some(file) = file else {
        return Ok(());
    };
    let folder = match file.parent() {
        Some(folder) if folder != Path::new("") => folder,
        _ => Path::new("."),
    };
    if out.is_some_and(|out| folder.starts_with(out)) {
        return Ok(());
    }
    if !folder.is_dir() {
        bail!(
            "{}: expected a file in a folder that exists",
            file.display()
        );
    }
    check_output(folder)
}

/// Prints what a reader had to assume of a capture.
fn warn(scene: &lumi_core::Scene) {
    for warning in &scene.warnings {
        say_aside!("warning: {warning}");
    }
}

/// Prints what `scene check` finds wrong or doubtful in a capture that is about to be relit, a line each.
fn foretell(scene: &lumi_core::Scene) -> Report {
    let report = check::check(scene, "");
    for problem in &report.problems {
        say_aside!("{}: {}: {}", problem.severity, problem.field, problem.text);
    }
    report
}

/// Makes the output folder.
pub fn make_folder(path: &Path) -> Result<()> {
    std::fs::create_dir_all(path).with_context(|| format!("{}: output folder", path.display()))
}

/// Writes indented JSON, whole or not at all.
fn write_json(path: &Path, value: &impl serde::Serialize) -> Result<()> {
    let text = serde_json::to_string_pretty(value)? + "\n";
    Ok(lumi_core::fs::atomic_write(path, text.as_bytes())?)
}
