//! Folders of environment maps; the maps themselves are read by [`lumi_core::EnvMap::read`].

use lumi_core::{Error, Result};
use std::path::{Path, PathBuf};

/// The `.hdr` and `.exr` files of a folder, sorted by name.
///
/// # Errors
/// If the folder cannot be read.
pub fn list(folder: &Path) -> Result<Vec<PathBuf>> {
    let mut paths = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(|e| Error::io(folder, e))? {
        let path = entry.map_err(|e| Error::io(folder, e))?.path();
        let extension = path.extension().unwrap_or_default();
        if extension.eq_ignore_ascii_case("hdr") || extension.eq_ignore_ascii_case("exr") {
            paths.push(path);
        }
    }
    paths.sort();
    Ok(paths)
}
