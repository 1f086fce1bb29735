//! What the program carries inside itself: the trained weights and the demo scene.

use crate::device::DeviceName;
use anyhow::{Context, Result, bail};
use include_dir::{Dir, include_dir};
use lumi_model::Relighter;
use std::path::{Path, PathBuf};
use tempfile::TempDir;

static DEMO: Dir = include_dir!("$CARGO_MANIFEST_DIR/assets/demo");
static WEIGHTS: &[u8] = include_bytes!("../assets/lumi-mini.safetensors");

/// The model at `path`, or the bundled one.
///
/// # Errors
/// As [`Relighter::load`].
pub fn model(path: Option<&Path>, device: &DeviceName) -> Result<Relighter> {
    let device = device.open();
    Ok(match path {
        Some(path) => Relighter::load(path, &device)?,
        None => Relighter::from_bytes(WEIGHTS, Path::new("(bundled weights)"), &device)?,
    })
}

/// The demo's evaluation folder (a manifest and one object) in a temporary place.
///
/// # Errors
/// If it cannot be unpacked there.
pub fn demo_folder() -> Result<TempDir> {
    let folder = TempDir::new().context("temporary folder for the demo scene")?;
    DEMO.extract(folder.path())
        .context("unpacking the demo scene")?;
    Ok(folder)
}

/// The same in `folder`, which must not be there yet, whole or not at all.
///
/// # Errors
/// If it is there, or cannot be unpacked there.
pub fn unpack_demo(folder: &Path) -> Result<()> {
    let place = || folder.display().to_string();
    if folder.exists() {
        bail!("{}: expected a folder that is not there yet", place());
    }
    let above = folder.parent().filter(|above| *above != Path::new(""));
    let above = above.unwrap_or(Path::new("."));
    std::fs::create_dir_all(above).with_context(place)?;
    let fresh = TempDir::new_in(above).with_context(place)?;
    let whole = fresh.path().join("whole");
    std::fs::create_dir(&whole).with_context(place)?;
    DEMO.extract(&whole).context("unpacking the demo scene")?;
    std::fs::rename(whole, folder).with_context(place)
}

/// The demo's scene below `folder`, unpacked unless it is there already: its path stays the same from run to run.
///
/// # Errors
/// If it cannot be unpacked there.
pub fn demo_scene(folder: &Path) -> Result<PathBuf> {
    let scene = folder.join("spot");
    if !scene.is_dir() {
        std::fs::create_dir_all(folder).with_context(|| folder.display().to_string())?;
        let fresh = TempDir::new_in(folder).context("temporary folder for the demo scene")?;
        DEMO.extract(fresh.path())
            .context("unpacking the demo scene")?;
        match std::fs::rename(fresh.path().join("spot"), &scene) {
            // Another studio may have been faster.
            Err(e) if !scene.is_dir() => Err(e).with_context(|| scene.display().to_string())?,
            _ => {}
        }
    }
    Ok(scene)
}
