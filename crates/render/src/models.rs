//! Model files of every format that is read: a table from extension to reader.

use crate::scene::mesh::Model;
use crate::{gltf, obj};
use lumi_core::glam::DVec3;
use lumi_core::{Error, Result};
use std::collections::HashSet;
use std::path::{Path, PathBuf};

/// A model file, read.
#[derive(Debug)]
pub struct Import {
    /// Geometry and materials, z up, at the file's scale; around the origin if the file's place is far from it.
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

/// The model files of a folder and its subfolders, sorted by path. Hidden ones, whose names begin with a dot, are none.
///
/// # Errors
/// If a folder cannot be read.
pub fn list(folder: &Path) -> Result<Vec<PathBuf>> {
    let mut paths = Vec::new();
    let (mut open, mut seen) = (vec![folder.to_owned()], HashSet::new());
    while let Some(folder) = open.pop() {
        let failed = |e| Error::io(&folder, e);
        // Links may lead back up.
        if !seen.insert(folder.canonicalize().map_err(failed)?) {
            continue;
        }
        for entry in std::fs::read_dir(&folder).map_err(failed)? {
            let entry = entry.map_err(failed)?;
            if entry.file_name().as_encoded_bytes().starts_with(b".") {
                continue;
            }
            let path = entry.path();
            if path.is_dir() {
                open.push(path);
            } else if format(&path).is_some() {
                paths.push(path);
            }
        }
    }
    paths.sort();
    Ok(paths)
}

/// A part of a file, and what was expected there.
pub(crate) type Place = (String, String);

/// Models whose centre is farther from the origin than this many times their size are moved to it: f32 keeps 24 bits of
/// coordinates, of which this takes four.
const FAR: f64 = 16.0;

/// The point of a box of positions, in f64, that becomes the origin before they become f32. Maps and surveys have
/// coordinates of millions of metres, of which f32 keeps only halves.
pub(crate) fn origin(low: DVec3, high: DVec3) -> DVec3 {
    let centre = 0.5 * low + 0.5 * high;
    if centre.abs().max_element() > FAR * (high - low).max_element() {
        centre
    } else {
        DVec3::ZERO
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn folders_are_searched_with_their_subfolders() {
        let root = tempfile::tempdir().expect("folder");
        let at = |name: &str| root.path().join(name);
        std::fs::create_dir_all(at("b/c.obj")).expect("folder");
        std::fs::create_dir_all(at(".git")).expect("folder");
        for name in [
            "z.OBJ",
            "b/a.glb",
            "b/c.obj/d.gltf",
            "._z.obj",
            ".git/e.obj",
            "b/f.mtl",
        ] {
            std::fs::write(at(name), b"").expect("written");
        }
        #[cfg(unix)]
        std::os::unix::fs::symlink(root.path(), at("b/loop")).expect("link");
        let expected = ["b/a.glb", "b/c.obj/d.gltf", "z.OBJ"].map(at);
        assert_eq!(list(root.path()).expect("listed"), expected);
        assert!(list(&at("nothing")).is_err());
    }

    #[test]
    fn only_far_models_move() {
        let near = (DVec3::ZERO, DVec3::ONE);
        assert_eq!(origin(near.0, near.1), DVec3::ZERO);
        let far = DVec3::new(587_326.86, 5_970_228.5, 50.0);
        assert_eq!(origin(far - 2.0, far + 2.0), far);
    }
}
