//! What an uploaded folder may hold, checked before any reader of scenes sees it: no path that leaves the folder,
//! no image larger than the limits.

use crate::limits::{IMAGE_PIXELS, JSON_BYTES, UPLOAD_PIXELS};
use crate::{Error, Result};
use serde_json::Value;
use std::fs::File;
use std::io::{BufReader, Read};
use std::path::{Component, Path};

/// Whether a relative path, as files write it, stays below the folder it is relative to.
#[must_use]
pub fn stays_inside(path: &str) -> bool {
    let mut depth = 0_i32;
    for part in path.replace('\\', "/").split('/') {
        match part {
            ".." => depth -= 1,
            "" | "." => {}
            _ => depth += 1,
        }
        if depth < 0 {
            return false;
        }
    }
    let drive = path.as_bytes().get(1) == Some(&b':');
    !path.starts_with(['/', '\\', '~']) && !drive
}

/// Checks every file below `folder`. A path stands in some format's JSON or text; whatever its key, a text that
/// leads out of the folder is refused.
///
/// # Errors
/// Names the file, and the field or size that is refused.
pub fn check(folder: &Path) -> Result<()> {
    let mut pixels = 0;
    for file in files(folder)? {
        let name = file.strip_prefix(folder).unwrap_or(&file).display();
        if let Some((width, height)) = image_size(&file) {
            let size = width.saturating_mul(height);
            pixels += size;
            if size > IMAGE_PIXELS {
                let text = format!(
                    "{name}: expected at most {IMAGE_PIXELS} pixels, found {width}×{height}"
                );
                return Err(Error::TooLarge(text));
            }
            if pixels > UPLOAD_PIXELS {
                let text = format!(
                    "{name}: expected at most {UPLOAD_PIXELS} pixels in all images together"
                );
                return Err(Error::TooLarge(text));
            }
        } else if file.extension().is_some_and(|e| e == "json") {
            let bytes = std::fs::metadata(&file).map_or(0, |m| m.len());
            if bytes > JSON_BYTES {
                let text = format!("{name}: expected at most {} MiB", JSON_BYTES >> 20);
                return Err(Error::TooLarge(text));
            }
            let text = lumi_data::without_byte_order_mark(lumi_core::fs::read_bytes(&file)?);
            let json: Value = serde_json::from_slice(&text)
                .map_err(|e| Error::Invalid(format!("{name}: expected JSON: {e}")))?;
            if let Some((field, path)) = way_out(&json, String::new()) {
                let text =
                    format!("{name}: {field}: expected a path inside the folder, found `{path}`");
                return Err(Error::Invalid(text));
            }
        } else if leads_out(&file)? {
            let text = format!("{name}: expected paths inside the folder, found `../`");
            return Err(Error::Invalid(text));
        }
    }
    Ok(())
}

/// All plain files below `folder`; links are an error.
fn files(folder: &Path) -> Result<Vec<std::path::PathBuf>> {
    let (mut found, mut folders) = (Vec::new(), vec![folder.to_owned()]);
    while let Some(folder) = folders.pop() {
        let entries = std::fs::read_dir(&folder).map_err(|e| lumi_core::Error::io(&folder, e))?;
        for entry in entries {
            let entry = entry.map_err(|e| lumi_core::Error::io(&folder, e))?;
            let kind = entry
                .file_type()
                .map_err(|e| lumi_core::Error::io(entry.path(), e))?;
            if kind.is_dir() {
                folders.push(entry.path());
            } else if kind.is_file() {
                found.push(entry.path());
            } else {
                let name = entry.file_name();
                let text = format!("{}: expected plain files only", name.display());
                return Err(Error::Invalid(text));
            }
        }
    }
    found.sort();
    Ok(found)
}

/// The first text in `json` that leads out of its folder, and where it stands.
fn way_out(json: &Value, place: String) -> Option<(String, String)> {
    match json {
        Value::String(text) => {
            // Prose may begin with any sign; a path has no line breaks and is short.
            let path = text.len() < 4096 && !text.contains('\n');
            (path && !stays_inside(text)).then(|| (place, text.clone()))
        }
        Value::Array(items) => items
            .iter()
            .enumerate()
            .find_map(|(i, item)| way_out(item, format!("{place}[{i}]"))),
        Value::Object(fields) => fields.iter().find_map(|(key, value)| {
            let place = if place.is_empty() {
                key.clone()
            } else {
                format!("{place}.{key}")
            };
            way_out(value, place)
        }),
        _ => None,
    }
}

/// Whether a file that is neither image nor JSON writes `../` or `..\` (image lists of other formats). Lists are text:
/// behind a zero byte the file is binary (points, databases, videos), where such bytes stand by chance.
fn leads_out(file: &Path) -> Result<bool> {
    let mut reader = BufReader::new(File::open(file).map_err(|e| lumi_core::Error::io(file, e))?);
    let (mut buffer, mut kept) = (vec![0; 1 << 16], 0);
    loop {
        let read = reader
            .read(&mut buffer[kept..])
            .map_err(|e| lumi_core::Error::io(file, e))?;
        let full = kept + read;
        let zero = buffer[..full].iter().position(|b| *b == 0);
        let found = buffer[..zero.unwrap_or(full)]
            .windows(3)
            .any(|w| w == b"../" || w == b"..\\");
        if found || zero.is_some() || read == 0 {
            return Ok(found);
        }
        kept = full.min(2);
        buffer.copy_within(full - kept..full, 0);
    }
}

/// Width and height that an image file states, if it is one by its first bytes.
#[must_use]
pub fn image_size(path: &Path) -> Option<(u64, u64)> {
    let mut magic = [0; 4];
    File::open(path).ok()?.read_exact(&mut magic).ok()?;
    if let [0x89, b'P', ..] | [0xff, 0xd8, ..] | [b'#', b'?', ..] | [0x76, 0x2f, 0x31, 0x01] = magic
    {
        let bytes = lumi_core::fs::read_bytes(path).ok()?;
        let (width, height) = lumi_core::image::stated_size(path, &bytes)?;
        return Some((width as u64, height as u64));
    }
    // Textures of models may be of other kinds.
    let reader = image::ImageReader::open(path)
        .ok()?
        .with_guessed_format()
        .ok()?;
    let (width, height) = reader.into_dimensions().ok()?;
    Some((u64::from(width), u64::from(height)))
}

/// A name of a sent file as a relative path: plain parts only.
///
/// # Errors
/// Names the path and what is wrong with it.
pub fn plain_path(name: &str) -> Result<std::path::PathBuf> {
    let refuse = |why: &str| {
        let shown: String = name.chars().take(120).collect();
        Err(Error::Invalid(format!("{shown:?}: {why}")))
    };
    if name.contains(['\\', ':', '\0']) || name.chars().any(char::is_control) {
        return refuse("expected a path without \\, : and control characters");
    }
    let path = Path::new(name);
    let plain = |c: Component| matches!(c, Component::Normal(_) | Component::CurDir);
    if name.is_empty() || !path.components().all(plain) || path.file_name().is_none() {
        return refuse("expected a path inside the folder");
    }
    let parts: Vec<_> = path.components().collect();
    if parts.len() > 16 || parts.iter().any(|p| p.as_os_str().len() > 200) {
        return refuse("expected at most 16 parts of 200 bytes");
    }
    Ok(path
        .components()
        .filter(|c| *c != Component::CurDir)
        .collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ways_out_are_seen() {
        for inside in ["images/0.png", "./a", "a/../b", "v00", "name: x", "a b/c.d"] {
            assert!(stays_inside(inside), "{inside}");
        }
        for outside in [
            "../a",
            "/etc/passwd",
            "a/../../b",
            "..\\a",
            "C:\\x",
            "~/x",
            "\\\\host\\x",
        ] {
            assert!(!stays_inside(outside), "{outside}");
        }
    }

    #[test]
    fn binary_files_are_no_lists() {
        let folder = tempfile::tempdir().expect("folder");
        let put = |bytes: &[u8]| {
            std::fs::write(folder.path().join("file"), bytes).expect("written");
            check(folder.path())
        };
        let points = [&b"\x09\0\0\0\0\0\0\0 ../ ..\\"[..], &[7; 100_000], b"../"].concat();
        put(&points).expect("points that are no paths");
        put(b"SQLite format 3\0../").expect("a database");
        // Across the border between two reads too.
        for before in [0, 10, (1 << 16) - 2, (1 << 16) - 1, 1 << 16, 200_000] {
            let list = [&vec![b' '; before][..], b"../secret.png\n"].concat();
            let refused = put(&list).expect_err("a way out");
            assert!(refused.to_string().contains("../"), "{before}: {refused}");
        }
    }

    #[test]
    fn names_of_sent_files() {
        assert_eq!(
            plain_path("a/./b.png").expect("plain"),
            Path::new("a/b.png")
        );
        for bad in ["", "/a", "../a", "a/../b", "a\\b", "C:a", "a\nb", "."] {
            assert!(plain_path(bad).is_err(), "{bad:?}");
        }
    }
}
