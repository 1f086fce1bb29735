//! `lumi scene mask`, and what it shares with `prepare`: masks for photographs with poses, and the capture they make.

use crate::commands::{check_output, warn, write_json};
use crate::output;
use crate::progress::Terminal;
use crate::results::Results;
use anyhow::{Context, Result, bail};
use lumi_core::{Scene, Similarity};
use lumi_data::ball::{Silhouette, estimate};
use lumi_data::formats::{Opening, convert, transforms};
use lumi_data::{check, mask};
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// Find masks for a capture's photographs, all views at once, and write a capture that has them
#[derive(clap::Args)]
pub struct Args {
    /// Folder of the capture: photographs with their background, and poses
    scene: PathBuf,
    /// Masks of any other tool, NAME.png for each photograph NAME.*, white on the object
    #[arg(long, value_name = "DIR")]
    masks: Option<PathBuf>,
    /// Folder for the new capture, new or empty: images, masks and transforms.json
    #[arg(long)]
    out: PathBuf,
    /// Replace the capture that an earlier run has written there
    #[arg(long)]
    overwrite: bool,
    #[command(flatten)]
    size: Size,
}

/// How large photographs become.
#[derive(clap::Args)]
pub struct Size {
    /// Reduce photographs to this many pixels along their longer side
    #[arg(long, default_value_t = 1024, value_parser = clap::value_parser!(u32).range(16..))]
    max_side: u32,
}

impl Size {
    /// Photographs of this size, with the masks of a folder.
    pub fn opening(&self, masks: Option<&Path>) -> Opening {
        Opening {
            longest_side: self.max_side as usize,
            masks: masks.map(Path::to_owned),
        }
    }
}

pub fn run(args: &Args) -> Result<ExitCode> {
    convert::check_target(&args.scene, &args.out, true)?;
    check_output(&args.out)?;
    drop(Results::begin(&args.out, args.overwrite)?);
    let scene = lumi_data::open_with(&args.scene, &args.size.opening(None))?;
    warn(&scene);
    if scene.basis.is_some() {
        bail!(
            "{}: expected photographs, found a scene that was rendered one light at a time",
            args.scene.display()
        );
    }
    let masks = match &args.masks {
        Some(folder) => given(&args.scene, &args.size, folder)?,
        None => found(&scene).with_context(|| args.scene.display().to_string())?,
    };
    write(scene, Some(&masks), &args.out, args.overwrite)
}

/// The masks in `folder` for the photographs of the capture at `scene`.
pub fn given(scene: &Path, size: &Size, folder: &Path) -> Result<Vec<Vec<f32>>> {
    let masked = lumi_data::open_with(scene, &size.opening(Some(folder)))?;
    let masks = masked.views.into_iter().map(|view| {
        let alpha = view.image.and_then(|image| image.alpha);
        alpha.with_context(|| format!("--masks: view `{}`: expected a mask", view.name))
    });
    masks.collect()
}

/// Masks from the photographs themselves.
pub fn found(scene: &Scene) -> Result<Vec<Vec<f32>>> {
    let has = |view: &&lumi_core::View| view.image.as_ref().is_some_and(|i| i.alpha.is_some());
    if let Some(view) = scene.views.iter().find(has) {
        bail!(
            "view `{}`: expected photographs without masks, whose background is still there; this one has a mask or alpha",
            view.name
        );
    }
    Ok(mask::masks(scene, &Terminal::new())?)
}

/// Writes the capture, with the ball that its masks show, and what `scene check` says of it, which is printed, too; status 1
/// if that has errors.
pub fn write(
    mut scene: Scene,
    masks: Option<&[Vec<f32>]>,
    out: &Path,
    overwrite: bool,
) -> Result<ExitCode> {
    let results = Results::begin(out, overwrite)?;
    let folder = results.folder();
    match masks {
        None => transforms::write(&folder, &scene)?,
        Some(masks) => {
            scene.to_model = ball(&scene, masks)?;
            transforms::write_with_masks(&folder, &scene, masks)?;
        }
    }
    let mut report = check::check_folder(&folder)?;
    let name = out.file_name().unwrap_or(out.as_os_str());
    report.name = name.to_string_lossy().into_owned();
    write_json(&folder.join("report.json"), &report)?;
    results.finish()?;
    output::text(&report.to_string());
    Ok(if report.has_errors() {
        ExitCode::FAILURE
    } else {
        ExitCode::SUCCESS
    })
}

/// World to model space, by the ball that masks show.
pub fn ball(scene: &Scene, masks: &[Vec<f32>]) -> Result<Similarity> {
    let silhouettes = scene
        .views
        .iter()
        .zip(masks)
        .map(|(view, mask)| Silhouette {
            camera: &view.camera,
            alpha: Some(mask),
        });
    let ball = estimate(&silhouettes.collect::<Vec<_>>())?;
    Ok(Similarity::to_unit_ball(ball.centre, ball.radius))
}
