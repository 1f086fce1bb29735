//! `lumi scene`: captures from photographs, what they hold, and from one format to another.

mod colmap;
mod masked;
mod photographs;
mod poses;
mod prepare;

use super::write_json;
use crate::output;
use crate::output::say;
use anyhow::{Context, Result};
use lumi_data::formats::convert;
use lumi_data::{Lighting, check, formats, views};
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// Make captures of photographs, look at them, convert them
#[derive(clap::Args)]
pub struct Args {
    #[command(subcommand)]
    command: Command,
}

#[derive(clap::Subcommand)]
enum Command {
    /// Say what a capture holds, and whether poses, masks and lights agree; exit status 1 if not
    Check {
        /// Folder of the capture, or its file where the format has one per scene
        scene: PathBuf,
        /// Draw cameras and views with their masks, as PNG
        #[arg(long)]
        picture: Option<PathBuf>,
        /// Write the findings as JSON
        #[arg(long)]
        json: Option<PathBuf>,
    },
    Prepare(prepare::Args),
    Mask(masked::Args),
    /// Write a capture in another format
    Convert {
        /// Folder of the capture, or its file where the format has one per scene
        scene: PathBuf,
        /// Format to write: interchange, transforms or authors
        #[arg(long)]
        to: String,
        /// Folder to write into, empty or not there yet
        #[arg(long)]
        out: PathBuf,
        /// Write into a folder that holds something already
        #[arg(long)]
        overwrite: bool,
        /// Reduce images to this many pixels along their longer side; every pixel is kept otherwise
        #[arg(long, value_parser = clap::value_parser!(u32).range(1..))]
        max_side: Option<u32>,
        /// Light to show one-light-at-a-time images under, as NAME or NAME=GAIN; repeat for several
        #[arg(long, value_parser = light)]
        light: Vec<(String, f32)>,
    },
}

fn light(text: &str) -> Result<(String, f32), String> {
    let Some((name, gain)) = text.split_once('=') else {
        return Ok((text.to_owned(), 1.0));
    };
    let wrong = |_| format!("expected NAME or NAME=GAIN, found `{text}`");
    Ok((name.to_owned(), gain.parse().map_err(wrong)?))
}

pub fn run(args: &Args) -> Result<ExitCode> {
    match &args.command {
        Command::Check {
            scene,
            picture,
            json,
        } => check(scene, picture.as_deref(), json.as_deref()),
        Command::Prepare(args) => prepare::run(args),
        Command::Mask(args) => masked::run(args),
        Command::Convert {
            scene,
            to,
            out,
            overwrite,
            max_side,
            light,
        } => convert(
            scene,
            to,
            out,
            *overwrite,
            max_side.map(|s| s as usize),
            light,
        ),
    }
}

fn check(scene: &Path, picture: Option<&Path>, json: Option<&Path>) -> Result<ExitCode> {
    let format = formats::detect(scene)?;
    let scene = format.open(scene)?;
    let report = check::check(&scene, format.name);
    output::text(&report.to_string());
    if let Some(path) = picture {
        lumi_core::image::write_png(path, &check::picture(&scene, &report)?)?;
    }
    if let Some(path) = json {
        write_json(path, &report)?;
    }
    Ok(if report.has_errors() {
        ExitCode::FAILURE
    } else {
        ExitCode::SUCCESS
    })
}

fn convert(
    scene: &Path,
    to: &str,
    out: &Path,
    overwrite: bool,
    max_side: Option<usize>,
    lights: &[(String, f32)],
) -> Result<ExitCode> {
    let format = formats::named(to)?;
    let write = format
        .write
        .with_context(|| format!("format `{to}`: expected one that can be written"))?;
    convert::check_target(scene, out, overwrite)?;
    super::check_output(out)?;
    let mut scene = lumi_data::open_with(scene, &convert::opening(max_side))?;
    super::warn(&scene);
    if let Some(side) = max_side {
        scene = convert::reduced(scene, side);
    }
    if !lights.is_empty() {
        let lighting: Lighting = lights.iter().cloned().collect();
        scene = views::photographed(&scene, &lighting)?;
    }
    write(out, &scene)?;
    say!("{} views as {to} in {}", scene.views.len(), out.display());
    for loss in convert::losses(&scene, to) {
        say!("{loss}");
    }
    Ok(ExitCode::SUCCESS)
}
