//! A record of a training store as a scene: what `dataset generate` has rendered can be looked at, relit and scored.

use super::Opening;
use crate::store::{ObjectRecord, RecordReader};
use lumi_core::{Result, Scene};
use std::path::Path;

/// Whether it is a record: a group of a Zarr store that holds one, or a safetensors file that does.
#[must_use]
pub fn detect(path: &Path) -> bool {
    let group = path.join("zarr.json").is_file() && path.join("radiance").is_dir();
    group || (path.is_file() && RecordReader::open(path).is_ok())
}

/// The record, each view an input, lit by one light at a time.
///
/// # Errors
/// As [`ObjectRecord::read`].
pub fn open(path: &Path, _opening: &Opening) -> Result<Scene> {
    Ok(ObjectRecord::read(path)?.to_scene())
}
