//! Environment maps from Radiance HDR files.

use lumi_core::{EnvMap, Error, Result};
use std::path::{Path, PathBuf};

/// Reads a lat-long map. Negative or non-finite pixels become black.
///
/// # Errors
/// If the file cannot be read or holds no light.
pub fn read(path: &Path) -> Result<EnvMap> {
    let reader = image::ImageReader::open(path).map_err(|e| Error::io(path, e))?;
    let decoded = reader
        .decode()
        .map_err(|e| Error::invalid(path, "image", e.to_string()))?
        .into_rgb32f();
    let clean = |v: f32| if v.is_finite() { v.max(0.0) } else { 0.0 };
    let map = EnvMap {
        width: decoded.width() as usize,
        height: decoded.height() as usize,
        pixels: decoded.pixels().map(|p| p.0.map(clean)).collect(),
    };
    map.validate().map_err(|e| e.at(path))?;
    Ok(map)
}

/// The `.hdr` files of a folder, sorted by name.
///
/// # Errors
/// If the folder cannot be read.
pub fn list(folder: &Path) -> Result<Vec<PathBuf>> {
    let mut paths = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(|e| Error::io(folder, e))? {
        let path = entry.map_err(|e| Error::io(folder, e))?.path();
        if path
            .extension()
            .is_some_and(|e| e.eq_ignore_ascii_case("hdr"))
        {
            paths.push(path);
        }
    }
    paths.sort();
    Ok(paths)
}
