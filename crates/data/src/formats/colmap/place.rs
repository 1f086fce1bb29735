//! Where a capture has its sparse models and its images.

use super::{Model, binary, text};
use crate::formats::photo::{found, image_file};
use lumi_core::Result;
use lumi_core::fs::read_bytes;
use std::path::{Path, PathBuf};

/// Folders that hold models, or folders of them.
const FOLDERS: [&str; 3] = ["sparse", ".", "colmap/sparse"];

/// Bytes that an image of `images.bin` takes at the least.
const SMALLEST_IMAGE: u64 = 73;

/// The two files of a model.
pub(super) struct Files {
    pub cameras: PathBuf,
    pub images: PathBuf,
    /// Where they stand below the capture's folder.
    place: String,
    binary: bool,
}

impl Files {
    fn of(folder: &Path, place: &str) -> Option<Self> {
        let file =
            |stem: &str, extension: &str| found(folder, &format!("{place}/{stem}.{extension}"));
        ["bin", "txt"].into_iter().find_map(|extension| {
            Some(Self {
                cameras: file("cameras", extension)?,
                images: file("images", extension)?,
                place: place.to_owned(),
                binary: extension == "bin",
            })
        })
    }

    pub fn read(&self) -> Result<Model> {
        let read = if self.binary {
            binary::read
        } else {
            text::read
        };
        read(&self.cameras, &self.images)
    }

    /// How many images the model has; 0 for files that are not as they must be.
    fn count(&self) -> u64 {
        let Ok(bytes) = read_bytes(&self.images) else {
            return 0;
        };
        if self.binary {
            let count = bytes.first_chunk().map_or(0, |b| u64::from_le_bytes(*b));
            return count.min(bytes.len() as u64 / SMALLEST_IMAGE);
        }
        let text = String::from_utf8_lossy(&bytes);
        text::parse_images(&self.images, &text).map_or(0, |images| images.len() as u64)
    }
}

/// All models of a capture: `sparse/0` before `sparse/1`, and these before others.
pub(super) fn models(folder: &Path) -> Vec<Files> {
    let mut models = Vec::new();
    // The folder itself is searched for folders of models only if it is called so.
    let itself = called(&full(folder), "sparse");
    for place in FOLDERS {
        if place != "." || itself {
            for name in folders(&inside(folder, place)) {
                models.extend(Files::of(folder, &format!("{place}/{name}")));
            }
        }
        models.extend(Files::of(folder, place));
    }
    models
}

/// The model with the most images; the others are told of.
pub(super) fn largest(folder: &Path, warnings: &mut Vec<String>) -> Option<Files> {
    let mut models = models(folder);
    if models.len() < 2 {
        return models.pop();
    }
    let counts: Vec<u64> = models.iter().map(Files::count).collect();
    let most = counts.iter().max()?;
    let best = counts.iter().position(|count| count == most)?;
    let named = |i: usize| format!("{} ({} images)", models[i].place, counts[i]);
    let others: Vec<String> = (0..models.len())
        .filter(|i| *i != best)
        .map(named)
        .collect();
    warnings.push(format!(
        "model: took {}; there is also {}",
        named(best),
        others.join(", ")
    ));
    Some(models.swap_remove(best))
}

/// `place` below `folder`, whatever the capitals.
fn inside(folder: &Path, place: &str) -> PathBuf {
    place.split('/').fold(folder.to_owned(), |at, part| {
        let exact = at.join(part);
        if exact.is_dir() {
            return exact;
        }
        let same = folders(&at)
            .into_iter()
            .find(|n| n.eq_ignore_ascii_case(part));
        same.map_or(exact, |name| at.join(name))
    })
}

/// Names of the folders in a folder: numbers by size, then the others.
fn folders(folder: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    let entries = entries.filter(|e| e.path().is_dir());
    let mut names: Vec<String> = entries
        .filter_map(|e| e.file_name().into_string().ok())
        .collect();
    names.sort_by_key(|name| (name.parse::<u64>().map_or(u64::MAX, |n| n), name.clone()));
    names
}

/// Where the images stand: `images/` or the folder itself, or beside the folders `sparse` and `colmap` that it is in.
/// The first of these that has the image `first`.
pub(super) fn pictures(folder: &Path, first: Option<&str>) -> PathBuf {
    let mut places = vec![inside(folder, "images"), folder.to_owned()];
    let full = full(folder);
    let mut at = full.as_path();
    if at.parent().is_some_and(|parent| called(parent, "sparse")) {
        at = at.parent().unwrap_or(at);
    }
    for name in ["sparse", "colmap"] {
        if let Some(parent) = at.parent().filter(|_| called(at, name)) {
            places.push(inside(parent, "images"));
            at = parent;
        }
    }
    let has = |place: &&PathBuf| first.is_some_and(|name| image_file(place, name).is_ok());
    let chosen = places
        .iter()
        .find(has)
        .or(places.iter().find(|p| p.is_dir()));
    chosen.cloned().unwrap_or_else(|| folder.to_owned())
}

/// The folder's path from the root, where that can be found out.
fn full(folder: &Path) -> PathBuf {
    folder.canonicalize().unwrap_or_else(|_| folder.to_owned())
}

fn called(path: &Path, name: &str) -> bool {
    path.file_name()
        .is_some_and(|n| n.eq_ignore_ascii_case(name))
}
