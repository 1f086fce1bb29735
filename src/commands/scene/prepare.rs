//! `lumi scene prepare`: from photographs to a capture.

use super::colmap::Colmap;
use super::masked::{self, Size};
use super::{photographs, poses};
use crate::commands::{check_output, make_folder, standing, warn};
use crate::output::{say, say_aside};
use crate::progress::Terminal;
use crate::results::Results;
use anyhow::{Result, bail};
use lumi_core::fs::read_bytes;
use lumi_core::image::{read_mask, stated_size, write_png};
use lumi_core::{Scene, Similarity, View};
use lumi_data::formats::convert;
use lumi_data::formats::photo::mask_in;
use std::ffi::OsStr;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// Make a capture of photographs: turn them upright, find their poses (COLMAP) and masks, remove the lens, level, check
#[derive(clap::Args)]
pub struct Args {
    /// Folder of photographs (PNG, JPEG), or a video (through ffmpeg)
    photographs: PathBuf,
    /// Folder for the capture, new or empty: images, masks and transforms.json. COLMAP's log is beside it, OUT.colmap.log
    #[arg(long)]
    out: PathBuf,
    /// Poses that are known, instead of COLMAP's: a transforms.json or the folder of a COLMAP model. Photographs are not turned
    /// then, and the world is theirs
    #[arg(long, value_name = "FILE|FOLDER")]
    poses: Option<PathBuf>,
    /// Masks of any other tool, NAME.png for each photograph NAME.*, white on the object
    #[arg(long, value_name = "DIR", conflicts_with = "no_mask")]
    masks: Option<PathBuf>,
    /// Look for poses only inside the masks: for an object that was turned before a camera that stood still
    #[arg(long, requires = "masks", conflicts_with = "poses")]
    turntable: bool,
    /// Make no masks: the background belongs to what is captured
    #[arg(long)]
    no_mask: bool,
    /// Pictures to take of a video, evenly spread
    #[arg(long, default_value_t = 40, value_parser = clap::value_parser!(u32).range(2..=1000))]
    frames: u32,
    #[command(flatten)]
    size: Size,
    /// Replace the capture that an earlier run has written there
    #[arg(long)]
    overwrite: bool,
}

pub fn run(args: &Args) -> Result<ExitCode> {
    if !args.photographs.exists() {
        bail!(
            "{}: expected a folder of photographs or a video, found nothing",
            args.photographs.display()
        );
    }
    if args.photographs.is_dir() {
        convert::check_target(&args.photographs, &args.out, true)?;
    }
    check_output(&args.out)?;
    drop(Results::begin(&args.out, args.overwrite)?);
    let log = args.out.with_added_extension("colmap.log");
    // Whether COLMAP is there is known before the work.
    let colmap = match args.poses {
        None => Some(Colmap::find(&log)?),
        Some(_) => None,
    };

    let beside = args.out.parent().map_or(Path::new("."), standing);
    let work = tempfile::Builder::new()
        .prefix(".lumi-")
        .tempdir_in(beside)?;
    let work = work.path();
    let (turn, frames) = (args.poses.is_none(), args.frames as usize);
    let images = work.join("images");
    let taken = photographs::gather(&args.photographs, &images, turn, frames)?;
    let count = taken.names.len();
    if let Some(masks) = &args.masks {
        check_masks(masks, &images, &taken.names)?;
    }
    if let Some(from) = &args.poses {
        poses::bring(from, work, &taken.names)?;
    }
    if let Some(colmap) = colmap {
        let masks = match &args.masks {
            Some(masks) if args.turntable => Some(colmap_masks(masks, work, &taken.names)?),
            _ => None,
        };
        colmap.reconstruct(work, &taken, masks.as_deref(), &Terminal::new())?;
        say_aside!("COLMAP's log: {}", log.display());
    }

    let mut scene = lumi_data::open_with(work, &args.size.opening(None))?;
    warn(&scene);
    let names = taken.names.iter().map(String::as_str);
    let without: Vec<&str> = names.filter(|name| !has(&scene, name)).collect();
    if !without.is_empty() {
        say_aside!(
            "warning: no pose for {} of {count} photographs, which are left out: {}",
            without.len(),
            without.join(", ")
        );
    }
    say!(
        "{} of {count} photographs have poses",
        count - without.len()
    );
    let masks = match &args.masks {
        Some(folder) => Some(masked::given(work, &args.size, folder)?),
        None if args.no_mask || have_alpha(&scene) => None,
        None => {
            let found = masked::found(&scene)?;
            let (kept, masks, empty) = seen_in(scene.views, found);
            scene.views = kept;
            if !empty.is_empty() {
                say_aside!(
                    "warning: the object is not in {} of the photographs, whose poses may be wrong; they are left out: {}",
                    empty.len(),
                    empty.join(", ")
                );
            }
            Some(masks)
        }
    };
    if args.poses.is_none() {
        in_own_units(&mut scene, masks.as_deref())?;
    }
    masked::write(scene, masks.as_deref(), &args.out, args.overwrite)
}

/// Whether a view of the scene is the photograph called `name`.
fn has(scene: &Scene, name: &str) -> bool {
    let stem = Path::new(name).file_stem().and_then(OsStr::to_str);
    let mut names = scene.views.iter().map(|view| view.name.as_str());
    names.any(|name| Some(name) == stem)
}

/// The views in which masks show something, with these, and the names of the others.
fn seen_in(views: Vec<View>, masks: Vec<Vec<f32>>) -> (Vec<View>, Vec<Vec<f32>>, Vec<String>) {
    let shows = |mask: &[f32]| mask.iter().any(|m| *m > 0.5);
    let (kept, empty): (Vec<_>, Vec<_>) = views.into_iter().zip(masks).partition(|(_, m)| shows(m));
    let (views, masks) = kept.into_iter().unzip();
    (
        views,
        masks,
        empty.into_iter().map(|(view, _)| view.name).collect(),
    )
}

/// Whether all photographs have alpha of their own, which is their mask.
fn have_alpha(scene: &Scene) -> bool {
    let mut images = scene.views.iter().map(|view| view.image.as_ref());
    images.all(|image| image.is_some_and(|i| i.alpha.is_some()))
}

/// Structure from motion knows no scale: the object's ball becomes the unit ball at the origin.
fn in_own_units(scene: &mut Scene, masks: Option<&[Vec<f32>]>) -> Result<()> {
    if let Some(masks) = masks {
        scene.to_model = masked::ball(scene, masks)?;
    }
    for view in &mut scene.views {
        view.camera = view.camera.transformed(&scene.to_model);
    }
    scene.to_model = Similarity::IDENTITY;
    Ok(())
}

/// Makes sure, before poses are looked for, that each photograph has a mask of its size.
fn check_masks(folder: &Path, images: &Path, names: &[String]) -> Result<()> {
    let size = |path: &Path| -> Result<_> { Ok(stated_size(path, &read_bytes(path)?)) };
    for name in names {
        let mask = mask_in(folder, name)?;
        let (expected, found) = (size(&images.join(name))?, size(&mask)?);
        if expected != found {
            let text = |size: Option<(usize, usize)>| match size {
                Some((width, height)) => format!("{width}×{height} pixels"),
                None => "no image that is read".to_owned(),
            };
            bail!(
                "{}: expected {} as its photograph, found {}",
                mask.display(),
                text(expected),
                text(found)
            );
        }
    }
    Ok(())
}

/// The masks of `folder` as COLMAP calls them, in a folder of `work`.
fn colmap_masks(folder: &Path, work: &Path, names: &[String]) -> Result<PathBuf> {
    let to = work.join("masks-for-colmap");
    make_folder(&to)?;
    for name in names {
        let mask = read_mask(mask_in(folder, name)?)?;
        write_png(to.join(name).with_added_extension("png"), &mask)?;
    }
    Ok(to)
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    #[test]
    fn photographs_without_the_object_are_left_out_by_name() {
        let scene = lumi_data::open(lumi_testkit::demo().join("spot")).unwrap();
        let mut views = scene.views;
        views.truncate(3);
        let names: Vec<String> = views.iter().map(|view| view.name.clone()).collect();
        let masks = vec![vec![0.0, 1.0], vec![0.0, 0.1], vec![0.9, 0.0]];
        let (kept, masks, empty) = seen_in(views, masks);
        assert_eq!(kept.len(), 2);
        assert_eq!((&kept[0].name, &kept[1].name), (&names[0], &names[2]));
        assert_eq!(masks, [vec![0.0, 1.0], vec![0.9, 0.0]]);
        assert_eq!(empty, [names[1].clone()]);
    }
}
