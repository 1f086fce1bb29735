//! Zip files, unpacked within limits.

use crate::limits::{UPLOAD_BYTES, UPLOAD_FILES};
use crate::references::plain_path;
use crate::{Error, Result};
use std::fs::File;
use std::io::{Read, Write};
use std::path::Path;
use zip::ZipArchive;

/// Unpacks `file` below `folder`. What counts is the bytes that really come out, whatever the headers state.
///
/// # Errors
/// On a broken archive, names that leave the folder, links, encrypted or too many entries, and on more bytes than
/// the limit.
pub fn unpack(file: File, folder: &Path) -> Result<()> {
    let broken = |e: zip::result::ZipError| Error::Invalid(format!("zip: {e}"));
    let mut archive = ZipArchive::new(file).map_err(broken)?;
    if archive.len() > UPLOAD_FILES {
        let text = format!(
            "zip: expected at most {UPLOAD_FILES} files, found {}",
            archive.len()
        );
        return Err(Error::TooLarge(text));
    }
    let mut left = UPLOAD_BYTES;
    for i in 0..archive.len() {
        let mut entry = archive.by_index(i).map_err(broken)?;
        let name = entry.name().map_err(broken)?.into_owned();
        let path = folder.join(plain_path(name.trim_end_matches('/'))?);
        if entry.is_symlink() {
            return Err(Error::Invalid(format!("zip: {name}: expected no links")));
        }
        let io = |e: std::io::Error| Error::Invalid(format!("zip: {name}: {e}"));
        if entry.is_dir() {
            std::fs::create_dir_all(&path).map_err(io)?;
            continue;
        }
        if let Some(parent) = path.parent() {
            std::fs::create_dir_all(parent).map_err(io)?;
        }
        let mut out = File::create_new(&path).map_err(io)?;
        left = copy(&mut entry, &mut out, left)
            .map_err(io)?
            .ok_or_else(|| {
                let most = UPLOAD_BYTES >> 20;
                Error::TooLarge(format!(
                    "zip: {name}: unpacks to more than {most} MiB in all"
                ))
            })?;
    }
    Ok(())
}

/// Copies until the end; `None` when more than `left` bytes come, else what is left of them.
fn copy(from: &mut impl Read, to: &mut impl Write, left: u64) -> std::io::Result<Option<u64>> {
    let written = std::io::copy(&mut from.take(left + 1), to)?;
    Ok(left.checked_sub(written))
}
