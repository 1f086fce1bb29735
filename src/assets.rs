//! What the program carries inside itself: the trained weights and the demo scene.

use anyhow::{Context, Result};
use burn::tensor::Device;
use include_dir::{Dir, include_dir};
use lumi_model::Relighter;
use std::path::Path;
use tempfile::TempDir;

static DEMO: Dir = include_dir!("$CARGO_MANIFEST_DIR/assets/demo");
static WEIGHTS: &[u8] = include_bytes!("../assets/lumi-mini.safetensors");

/// The model at `path`, or the bundled one.
pub fn model(path: Option<&Path>) -> Result<Relighter> {
    let device = Device::flex();
    Ok(match path {
        Some(path) => Relighter::load(path, &device)?,
        None => Relighter::from_bytes(WEIGHTS, Path::new("(bundled weights)"), &device)?,
    })
}

/// The demo's evaluation folder (a manifest and one object) in a temporary place.
pub fn demo_folder() -> Result<TempDir> {
    let folder = TempDir::new().context("temporary folder for the demo scene")?;
    DEMO.extract(folder.path())
        .context("unpacking the demo scene")?;
    Ok(folder)
}
