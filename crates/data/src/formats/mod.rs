//! Scene formats: a new one is a file here and a row of [`FORMATS`].

pub mod authors;
pub mod colmap;
pub mod convert;
pub mod interchange;
pub mod objects_with_lighting;
pub mod photo;
pub mod record;
pub mod stanford_orb;
pub mod transforms;

use lumi_core::{Error, Result, Scene};
use std::path::{Path, PathBuf};

/// How a folder becomes a [`Scene`].
pub struct Format {
    /// Name for people and command lines.
    pub name: &'static str,
    /// What a folder of this format holds, for messages.
    pub holds: &'static str,
    /// Whether a folder (or file) looks like this format; cheap, reads no images.
    pub detect: fn(&Path) -> bool,
    /// Reads the whole scene.
    pub read: fn(&Path, &Opening) -> Result<Scene>,
    /// Writes a scene into a folder, where the format can be written.
    pub write: Option<fn(&Path, &Scene) -> Result<()>>,
}

/// How scenes are read.
#[derive(Clone, Debug)]
pub struct Opening {
    /// Photographs are reduced to this many pixels along their longer side, cameras with them.
    pub longest_side: usize,
    /// Folder whose masks take the place of the capture's own: `NAME.EXTENSION.png` or `NAME.png` (or `.jpg` and others)
    /// for each photograph `NAME.EXTENSION`. Only captures of photographs have masks of their own files.
    pub masks: Option<PathBuf>,
}

impl Opening {
    /// Every pixel of every photograph, whatever memory that takes.
    pub const FULL: Self = Self {
        longest_side: usize::MAX,
        masks: None,
    };
}

impl Default for Opening {
    fn default() -> Self {
        Self {
            longest_side: photo::LONGEST_SIDE,
            masks: None,
        }
    }
}

impl Format {
    /// Reads the scene as models want it, large photographs reduced.
    ///
    /// # Errors
    /// Names the file and the view, light or field that is missing or wrong.
    pub fn open(&self, path: &Path) -> Result<Scene> {
        (self.read)(path, &Opening::default())
    }
}

/// Every format there is.
pub const FORMATS: &[Format] = &[
    Format {
        name: "interchange",
        holds: "cameras.json, lights.json and one EXR per view and light",
        detect: interchange::detect,
        read: interchange::open,
        write: Some(interchange::write),
    },
    Format {
        name: "transforms",
        holds: "transforms.json (nerfstudio, Blender) and images",
        detect: transforms::detect,
        read: transforms::open,
        write: Some(transforms::write),
    },
    Format {
        name: "colmap",
        holds: "cameras.bin or .txt below sparse/ or colmap/sparse/ (COLMAP) and images/",
        detect: colmap::detect,
        read: colmap::open,
        write: None,
    },
    Format {
        name: "stanford-orb",
        holds: "transforms_train.json, transforms_test.json and transforms_novel.json (Stanford-ORB)",
        detect: stanford_orb::detect,
        read: stanford_orb::open,
        write: None,
    },
    Format {
        name: "objects-with-lighting",
        holds: "inputs/exposure.txt and gt_image_0000.png (Objects With Lighting)",
        detect: objects_with_lighting::detect,
        read: objects_with_lighting::open,
        write: None,
    },
    Format {
        name: "authors",
        holds: "metadata/SCENE.json and images/SCENE (the authors' release)",
        detect: authors::detect,
        read: authors::open,
        write: Some(authors::write),
    },
    Format {
        name: "record",
        holds: "one object of a store that `lumi dataset generate` has made",
        detect: record::detect,
        read: record::open,
        write: None,
    },
];

/// The format called `name`.
///
/// # Errors
/// Lists the formats if there is none of that name.
pub fn named(name: &str) -> Result<&'static Format> {
    let found = FORMATS.iter().find(|f| f.name == name);
    found.ok_or_else(|| Error::value(format!("format `{name}`"), list()))
}

/// The format of `folder`, which may be a file where the format has one per scene.
///
/// # Errors
/// If the folder cannot be listed or is empty, or if no format or more than one matches.
pub fn detect(folder: impl AsRef<Path>) -> Result<&'static Format> {
    let folder = folder.as_ref();
    let empty = || {
        let mut entries = std::fs::read_dir(folder).map_err(|e| Error::io(folder, e))?;
        Ok(entries.next().is_none())
    };
    if !folder.is_file() && empty()? {
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
    detect(&folder)?.open(folder.as_ref())
}

/// As [`open`], with photographs of the size that `opening` wants.
///
/// # Errors
/// As [`open`].
pub fn open_with(folder: impl AsRef<Path>, opening: &Opening) -> Result<Scene> {
    (detect(&folder)?.read)(folder.as_ref(), opening)
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
