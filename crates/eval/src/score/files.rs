//! Folders of pictures: `OBJECT/CASE/VIEW.png`.

use crate::Result;
use crate::picture::Picture;
use crate::run::plain;
use lumi_core::Error;
use lumi_core::image::read_display;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Endings of picture files, in the order in which they are looked for.
const ENDINGS: [&str; 5] = ["png", "jpg", "jpeg", "exr", "hdr"];

/// The predictions of a case's views.
pub(super) fn read(
    root: &Path,
    object: &str,
    case: &str,
    views: &[String],
) -> Result<Vec<Picture>> {
    let folder = root.join(plain(object)?).join(plain(case)?);
    // A folder that is not there lacks its pictures, which is said of the first.
    let there = entries(&folder).unwrap_or_default();
    let one = |view: &String| -> Result<Picture> {
        let name = plain(view)?;
        let named = |p: &&PathBuf| p.file_stem().is_some_and(|stem| stem == name);
        let found = there.iter().filter(named).filter(|p| p.is_file());
        let path = found.filter_map(|p| Some((rank(p)?, p))).min();
        let (_, path) = path.ok_or_else(|| {
            let expected = "expected this picture (.png, .jpg, .exr or .hdr)".to_owned();
            Error::invalid(folder.join(format!("{name}.png")), "prediction", expected)
        })?;
        Ok(Picture::read(path)?)
    };
    views.iter().map(one).collect()
}

/// The place of a picture's ending among [`ENDINGS`], whatever its case; `None` if it is no picture.
fn rank(path: &Path) -> Option<usize> {
    let ending = path.extension()?.to_str()?.to_lowercase();
    ENDINGS.iter().position(|e| *e == ending)
}

/// Names of the folders in a folder, sorted.
pub(super) fn subfolders(folder: &Path) -> Result<Vec<String>> {
    let paths = entries(folder)?.into_iter().filter(|p| p.is_dir());
    let names = paths.filter_map(|p| Some(p.file_name()?.to_str()?.to_owned()));
    Ok(names.filter(|n| !n.starts_with('.')).collect())
}

/// Pictures in a folder by name without ending, sorted.
pub(super) fn pictures(folder: &Path) -> Result<BTreeMap<String, PathBuf>> {
    let files = entries(folder)?.into_iter();
    let files = files.filter(|path| rank(path).is_some());
    let named: BTreeMap<String, PathBuf> = files
        .filter_map(|p| Some((p.file_stem()?.to_str()?.to_owned(), p)))
        .collect();
    if named.is_empty() {
        return Err(Error::invalid(folder, "pictures", "expected at least one").into());
    }
    Ok(named)
}

fn entries(folder: &Path) -> Result<Vec<PathBuf>> {
    let list = std::fs::read_dir(folder).map_err(|e| Error::io(folder, e))?;
    let paths: std::io::Result<Vec<PathBuf>> = list.map(|e| Ok(e?.path())).collect();
    let mut paths = paths.map_err(|e| Error::io(folder, e))?;
    paths.sort();
    Ok(paths)
}

/// Side of the first picture of an object's predictions.
pub(super) fn picture_side(object: &Path) -> Result<usize> {
    let cases = subfolders(object)?;
    let none = || {
        Error::invalid(
            object,
            "predictions",
            "expected a folder of pictures per case",
        )
    };
    let first = pictures(&object.join(cases.first().ok_or_else(none)?))?;
    let path = first.values().next().ok_or_else(none)?;
    let image = read_display(path)?;
    if image.width != image.height {
        let expected = format!(
            "expected a square picture, found {}×{}",
            image.width, image.height
        );
        return Err(Error::invalid(path, "size", expected).into());
    }
    Ok(image.width)
}
