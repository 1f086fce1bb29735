//! Environment maps: bundled ones, those of a folder, and those that were dropped on the page.

use crate::limits::{IMAGE_PIXELS, MAP_BYTES, MAPS};
use crate::{Error, Result, references};
use lumi_core::{DisplayImage, EnvMap, color::srgb_encode, image::encode_png};
use schemars::JsonSchema;
use serde::Serialize;
use std::collections::HashMap;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

/// Maps are kept at most this wide; the model's own grid is far coarser, and energy is kept exactly.
const WIDTH: usize = 256;

/// Poly Haven maps (CC0), reduced by `examples/make_maps.rs`.
const BUNDLED: &[(&str, &[u8])] = &[
    ("Sunrise", include_bytes!("../maps/sunrise.exr")),
    ("Park", include_bytes!("../maps/park.exr")),
    ("Sky", include_bytes!("../maps/sky.exr")),
    ("Esplanade", include_bytes!("../maps/esplanade.exr")),
    ("Hall", include_bytes!("../maps/hall.exr")),
    ("Warehouse", include_bytes!("../maps/warehouse.exr")),
];

/// A map and how to show it.
pub struct MapEntry {
    /// Fingerprint of its pixels.
    pub id: String,
    /// Name for people.
    pub name: String,
    /// The radiance.
    pub map: Arc<EnvMap>,
    /// Its file, where it has one on this machine.
    pub file: Option<PathBuf>,
    /// A tone-mapped PNG of the whole map.
    pub preview: Vec<u8>,
}

/// What a page needs to know of a map.
#[derive(Serialize, JsonSchema)]
#[schemars(rename = "Map")]
pub struct MapInfo {
    /// What lights name it by: a fingerprint of its pixels.
    id: String,
    /// Name for people.
    name: String,
    /// Azimuth and elevation in degrees of the brightest direction in the map's frame.
    brightest: [f32; 2],
    /// Solid-angle mean of the radiance, per channel.
    mean: [f64; 3],
}

/// All maps by id, in the order in which they came.
#[derive(Default)]
pub struct Maps(Mutex<Held>);

#[derive(Default)]
struct Held {
    order: Vec<String>,
    by_id: HashMap<String, Arc<MapEntry>>,
}

/// How names of files end that a folder of maps offers.
const ENDINGS: [&str; 5] = ["hdr", "exr", "jpg", "jpeg", "png"];

impl Maps {
    /// The bundled maps and those of `folder` (files whose names end as [`ENDINGS`], by name).
    ///
    /// # Errors
    /// If the folder cannot be listed, has too many maps, or a map in it cannot be read.
    pub fn load(folder: Option<&Path>) -> Result<Self> {
        let maps = Self::default();
        if let Some(folder) = folder {
            let failed = |e| lumi_core::Error::io(folder, e);
            let entries = std::fs::read_dir(folder).map_err(failed)?;
            let paths = entries.map(|entry| Ok(entry.map_err(failed)?.path()));
            let mut files = paths.collect::<Result<Vec<PathBuf>>>()?;
            files.retain(|p| {
                let ends =
                    |e: &std::ffi::OsStr| ENDINGS.iter().any(|known| e.eq_ignore_ascii_case(known));
                p.extension().is_some_and(ends)
            });
            files.sort();
            let most = MAPS - BUNDLED.len();
            if files.len() > most {
                let text = format!(
                    "{}: expected at most {most} environment maps ({}), found {}",
                    folder.display(),
                    ENDINGS.join(", "),
                    files.len()
                );
                return Err(Error::TooLarge(text));
            }
            for path in files {
                let name = path.file_stem().unwrap_or_default().to_string_lossy();
                let map = EnvMap::read(&path)?;
                let file = path.canonicalize().unwrap_or_else(|_| path.clone());
                maps.insert(&name, &map, Some(file))?;
            }
        }
        for (name, bytes) in BUNDLED {
            maps.insert(name, &decode(name, bytes)?.0, None)?;
        }
        Ok(maps)
    }

    /// Reads a map that somebody sent: what it is called from then on, and what there is to say of it.
    ///
    /// # Errors
    /// On too many bytes, pixels or maps, and on a file that is no map, by what is wrong with it.
    pub fn add(&self, name: &str, bytes: &[u8]) -> Result<(String, Vec<String>)> {
        if bytes.len() > MAP_BYTES {
            let text = format!("{name}: expected at most {} MiB", MAP_BYTES >> 20);
            return Err(Error::TooLarge(text));
        }
        let (map, warnings) = decode(name, bytes)?;
        Ok((self.insert(name, &map, None)?, warnings))
    }

    /// Adds a map that is there already in memory, such as one out of a session file.
    ///
    /// # Errors
    /// If there are too many.
    pub fn insert(&self, name: &str, map: &EnvMap, file: Option<PathBuf>) -> Result<String> {
        map.validate()?;
        let small = map.at_most(WIDTH / 2).into_owned();
        let numbers = small.pixels.as_flattened().iter();
        let bytes: Vec<u8> = numbers.flat_map(|v| v.to_le_bytes()).collect();
        let id = lumi_model::checkpoint::fingerprint(&bytes);
        let mut held = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if held.by_id.contains_key(&id) {
            return Ok(id);
        }
        if held.order.len() >= MAPS {
            let text = format!("expected at most {MAPS} environment maps");
            return Err(Error::TooLarge(text));
        }
        let entry = MapEntry {
            id: id.clone(),
            name: name.chars().take(60).collect(),
            preview: encode_png(&preview(&small))?,
            map: Arc::new(small),
            file,
        };
        held.order.push(id.clone());
        held.by_id.insert(id.clone(), Arc::new(entry));
        Ok(id)
    }

    /// The map called `id`.
    ///
    /// # Errors
    /// If there is none.
    pub fn get(&self, id: &str) -> Result<Arc<MapEntry>> {
        let held = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let found = held.by_id.get(id).cloned();
        found.ok_or_else(|| Error::NotFound(format!("map `{id}`: there is no such map")))
    }

    /// All maps, in the order in which they came.
    #[must_use]
    pub fn list(&self) -> Vec<MapInfo> {
        let held = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let entries = held.order.iter().filter_map(|id| held.by_id.get(id));
        entries.map(|e| info(e)).collect()
    }
}

/// Decodes what was sent, through a private file: readers name files in what they report.
fn decode(name: &str, bytes: &[u8]) -> Result<(EnvMap, Vec<String>)> {
    let failed = |e: std::io::Error| Error::Internal(format!("temporary file: {e}"));
    let mut file = tempfile::NamedTempFile::new().map_err(failed)?;
    file.write_all(bytes).map_err(failed)?;
    if let Some((width, height)) = references::image_size(file.path())
        && width.saturating_mul(height) > IMAGE_PIXELS
    {
        let text =
            format!("{name}: expected at most {IMAGE_PIXELS} pixels, found {width}×{height}");
        return Err(Error::TooLarge(text));
    }
    EnvMap::read_with_warnings(file.path()).map_err(|e| {
        let text = e.to_string();
        Error::Invalid(text.replace(&file.path().display().to_string(), name))
    })
}

fn info(entry: &MapEntry) -> MapInfo {
    let coarse = entry.map.prefiltered(16, 32);
    let luminance = |p: &[f32; 3]| 0.2126 * p[0] + 0.7152 * p[1] + 0.0722 * p[2];
    let brightest = coarse
        .pixels
        .iter()
        .enumerate()
        .max_by(|a, b| luminance(a.1).total_cmp(&luminance(b.1)));
    let (column, row) = brightest.map_or((0, 0), |(i, _)| (i % 32, i / 32));
    let (u, v) = ((column as f32 + 0.5) / 32.0, (row as f32 + 0.5) / 16.0);
    MapInfo {
        id: entry.id.clone(),
        name: entry.name.clone(),
        brightest: [(0.5 - u) * 360.0, 90.0 - v * 180.0],
        mean: entry.map.energy().map(|e| e / (4.0 * std::f64::consts::PI)),
    }
}

/// The map as a picture: exposed so that its mean is mid-grey, highlights rolled off.
fn preview(map: &EnvMap) -> DisplayImage {
    let mean = map.energy().iter().sum::<f64>() / (12.0 * std::f64::consts::PI);
    let exposure = (0.45 / mean) as f32;
    let tone = |v: f32| {
        let x = v * exposure;
        srgb_encode(x * (1.0 + x / 36.0) / (1.0 + x))
    };
    DisplayImage {
        width: map.width,
        height: map.height,
        pixels: map.pixels.iter().map(|p| p.map(tone)).collect(),
        alpha: None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_folder_of_too_many_maps_is_named_with_their_count() {
        let folder = tempfile::tempdir().expect("folder");
        for i in 0..MAPS {
            std::fs::write(folder.path().join(format!("{i}.hdr")), b"").expect("written");
        }
        let Err(refused) = Maps::load(Some(folder.path())) else {
            panic!("expected an error")
        };
        let text = refused.to_string();
        let folder = folder.path().display().to_string();
        for part in [&folder, "at most 122", "found 128"] {
            assert!(text.contains(part), "{part}: {text}");
        }
    }
}
