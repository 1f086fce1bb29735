//! Poses that are known already, brought together with the photographs they belong to.

use crate::commands::make_folder;
use anyhow::{Context, Result, bail};
use serde_json::Value;
use std::ffi::OsStr;
use std::path::Path;

/// Files of a COLMAP model that are read.
const MODEL: [&str; 4] = ["cameras.bin", "images.bin", "cameras.txt", "images.txt"];

/// Puts the poses of `from` (a `transforms.json` or the folder it is in, or the folder of a COLMAP model) into `work`, beside
/// its `images`, of which there are `names`. Frames whose photograph is not there are left out; a COLMAP model must have all of its
/// images there.
///
/// # Errors
/// If `from` holds no poses, or none of these photographs.
pub fn bring(from: &Path, work: &Path, names: &[String]) -> Result<()> {
    let inside = from.join("transforms.json");
    if from.is_file() || inside.is_file() {
        let file = if from.is_file() { from } else { &inside };
        return transforms(file, work, names);
    }
    let sparse = work.join("sparse");
    make_folder(&sparse)?;
    let mut found = 0;
    for file in MODEL {
        if from.join(file).is_file() {
            let to = sparse.join(file);
            std::fs::copy(from.join(file), &to).with_context(|| to.display().to_string())?;
            found += 1;
        }
    }
    if found < 2 {
        bail!(
            "--poses {}: expected a transforms.json, or a folder with cameras and images of COLMAP (.bin or .txt)",
            from.display()
        );
    }
    Ok(())
}

fn transforms(file: &Path, work: &Path, names: &[String]) -> Result<()> {
    let place = || format!("--poses {}", file.display());
    let bytes = lumi_core::fs::read_bytes(file)?;
    let mut document: Value =
        serde_json::from_slice(&lumi_data::without_byte_order_mark(bytes)).with_context(place)?;
    let frames = document.get_mut("frames").and_then(Value::as_array_mut);
    let frames = frames.with_context(|| format!("{}: expected `frames`", place()))?;
    let stem = |path: &str| {
        let slashed = path.replace('\\', "/");
        Path::new(&slashed).file_stem().map(OsStr::to_owned)
    };
    frames.retain_mut(|frame| {
        let path = frame
            .get("file_path")
            .and_then(Value::as_str)
            .unwrap_or_default();
        // An extension may be left out, so that what looks like one may belong to the name.
        let same = |name: &&String| {
            stem(name) == stem(path) || Path::new(name).file_stem() == Path::new(path).file_name()
        };
        let Some(name) = names.iter().find(same) else {
            return false;
        };
        let path = format!("images/{name}");
        if let Some(frame) = frame.as_object_mut() {
            frame.insert("file_path".into(), path.into());
            frame.remove("mask_path");
        }
        true
    });
    if frames.is_empty() {
        bail!(
            "{}: expected frames of these photographs, such as `{}`",
            place(),
            names[0]
        );
    }
    // Lists name frames as they were called there.
    if let Some(document) = document.as_object_mut() {
        for list in ["train_filenames", "test_filenames", "val_filenames"] {
            document.remove(list);
        }
    }
    let text = serde_json::to_vec_pretty(&document)?;
    Ok(lumi_core::fs::atomic_write(
        work.join("transforms.json"),
        &text,
    )?)
}
