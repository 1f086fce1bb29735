//! Scene formats: a new one is a file here and a row of [`FORMATS`].

pub mod interchange;
pub mod transforms;

use lumi_core::{Error, Result, Scene};
use std::path::Path;

/// How a folder becomes a [`Scene`].
pub struct Format {
    /// Name for people and command lines.
    pub name: &'static str,
    /// What a folder of this format holds, for messages.
    pub holds: &'static str,
    /// Whether `folder` looks like this format; cheap, reads no images.
    pub detect: fn(&Path) -> bool,
    /// Reads the whole scene.
    pub open: fn(&Path) -> Result<Scene>,
}

/// Every format that can be opened.
pub const FORMATS: &[Format] = &[
    Format {
        name: "interchange",
        holds: "cameras.json, lights.json and one EXR per view and light",
        detect: interchange::detect,
        open: interchange::open,
    },
    Format {
        name: "transforms",
        holds: "transforms.json (nerfstudio, Blender) and images",
        detect: transforms::detect,
        open: transforms::open,
    },
];

/// The format of `folder`.
///
/// # Errors
/// If the folder cannot be listed or is empty, or if no format or more than one matches.
pub fn detect(folder: impl AsRef<Path>) -> Result<&'static Format> {
    let folder = folder.as_ref();
    let mut entries = std::fs::read_dir(folder).map_err(|e| Error::io(folder, e))?;
    if entries.next().is_none() {
        let expected = format!("expected a scene, found an empty folder; {}", list());
        return Err(Error::invalid(folder, "format", expected));
    }
    let matches: Vec<_> = FORMATS.iter().filter(|f| (f.detect)(folder)).collect();
    match matches[..] {
        [one] => Ok(one),
        [] => Err(Error::invalid(
            folder,
            "format",
            format!("expected a scene; {}", list()),
        )),
        _ => {
            let names: Vec<_> = matches.iter().map(|f| f.name).collect();
            let expected = format!(
                "expected one scene format, found {}; {}",
                names.join(" and "),
                list()
            );
            Err(Error::invalid(folder, "format", expected))
        }
    }
}

/// Opens a scene folder in whatever format it is.
///
/// # Errors
/// As [`detect`], and as the format's reader.
pub fn open(folder: impl AsRef<Path>) -> Result<Scene> {
    (detect(&folder)?.open)(folder.as_ref())
}

fn list() -> String {
    let rows: Vec<_> = FORMATS
        .iter()
        .map(|f| format!("{} ({})", f.name, f.holds))
        .collect();
    format!("formats: {}", rows.join("; "))
}

/// The last part of a folder's path, as the scene's name.
fn folder_name(folder: &Path) -> String {
    let full = folder.canonicalize().unwrap_or_else(|_| folder.to_owned());
    full.file_name()
        .map_or_else(|| "scene".to_owned(), |n| n.to_string_lossy().into_owned())
}
