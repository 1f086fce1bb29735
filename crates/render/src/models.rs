//! Model files of every format that is read: a table from extension to reader.

use crate::scene::mesh::Model;
use crate::{gltf, obj};
use lumi_core::{Error, Result};
use std::path::{Path, PathBuf};

/// A model file, read.
#[derive(Debug)]
pub struct Import {
    /// Geometry and materials, z up, at the file's scale.
    pub model: Model,
    /// What the file holds that is not shown, by name; for people.
    pub warnings: Vec<String>,
}

/// A file format.
struct Format {
    extensions: &'static [&'static str],
    read: fn(&Path) -> Result<Import>,
}

/// All formats; a new one is a row here.
const FORMATS: [Format; 2] = [
    Format {
        extensions: &["glb", "gltf"],
        read: gltf::read,
    },
    Format {
        extensions: &["obj"],
        read: obj::read,
    },
];

fn format(path: &Path) -> Option<&'static Format> {
    let extension = path.extension()?.to_str()?.to_lowercase();
    FORMATS
        .iter()
        .find(|f| f.extensions.contains(&extension.as_str()))
}

/// Reads a model; its extension says how.
///
/// # Errors
/// Names the file and what in it could not be read, or that it has no triangles.
pub fn read(path: &Path) -> Result<Import> {
    let Some(format) = format(path) else {
        let known: Vec<&str> = FORMATS.iter().flat_map(|f| f.extensions).copied().collect();
        let expected = format!("expected one of {}", known.join(", "));
        return Err(Error::invalid(path, "extension", expected));
    };
    (format.read)(path)
}

/// The model files of a folder, sorted by name.
///
/// # Errors
/// If the folder cannot be read.
pub fn list(folder: &Path) -> Result<Vec<PathBuf>> {
    let mut paths = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(|e| Error::io(folder, e))? {
        let path = entry.map_err(|e| Error::io(folder, e))?.path();
        if format(&path).is_some() {
            paths.push(path);
        }
    }
    paths.sort();
    Ok(paths)
}
