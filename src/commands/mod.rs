//! One file per subcommand: its arguments and what it does.

pub mod dataset;
pub mod demo;
pub mod eval;
pub mod import;
pub mod relight;
pub mod scene;
pub mod train;
pub mod verify;

use anyhow::{Context, Result};
use std::path::Path;

/// Makes the output folder, so that an unwritable place is known before the work begins.
fn output_folder(path: &Path) -> Result<()> {
    std::fs::create_dir_all(path).with_context(|| format!("{}: output folder", path.display()))?;
    // A folder may exist and still refuse files.
    tempfile::tempfile_in(path).with_context(|| format!("{}: not writable", path.display()))?;
    Ok(())
}

/// Writes indented JSON, whole or not at all.
fn write_json(path: &Path, value: &impl serde::Serialize) -> Result<()> {
    let text = serde_json::to_string_pretty(value)? + "\n";
    Ok(lumi_core::fs::atomic_write(path, text.as_bytes())?)
}
