//! What a set is made of besides formulas: environment maps and models, split by file.

use super::config::{GenerateConfig, Split};
use super::library::Library;
use crate::image_texture::Image;
use crate::light::MAP_ROWS;
use crate::{environment, models};
use lumi_core::color::srgb_encode;
use lumi_core::{EnvMap, Error, Result, Seed};
use rayon::prelude::*;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Maps and models of one split.
#[derive(Default)]
pub struct Assets {
    /// Environment maps, averaged down to what rendering uses.
    pub maps: Vec<Arc<EnvMap>>,
    /// Models, read when they are drawn.
    pub models: Library,
    /// Base colours of some models and tone-mapped environments, to be printed on procedural surfaces.
    pub pictures: Arc<[Arc<Image>]>,
    /// Maps that could not be read.
    pub failed: Vec<Failed>,
}

/// A file that could not be read.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Failed {
    /// Which.
    pub path: PathBuf,
    /// Why; names the file.
    pub reason: String,
}

impl Assets {
    /// Reads the maps and finds the models that `config` names, those of its split. Maps that cannot be read are left
    /// out.
    ///
    /// # Errors
    /// If a folder cannot be read, or holds no file for the split, or no map that can be read.
    pub fn load(config: &GenerateConfig) -> Result<Self> {
        let mut assets = Self::default();
        let mut pictures = Vec::new();
        if let Some(folder) = &config.hdri {
            let paths = chosen(config, folder, "hdri", environment::list(folder)?)?;
            let maps = paths.par_iter().map(|p| {
                let map = EnvMap::read(p)?;
                let shown = Arc::new(tone_mapped(&map.at_most(PICTURE_ROWS)));
                Ok((Arc::new(map.at_most(MAP_ROWS).into_owned()), shown))
            });
            let maps: Vec<Result<_>> = maps.collect();
            for (path, map) in paths.into_iter().zip(maps) {
                match map {
                    Ok((map, shown)) => {
                        assets.maps.push(map);
                        pictures.push(shown);
                    }
                    Err(e) => assets.failed.push(Failed {
                        path,
                        reason: e.to_string(),
                    }),
                }
            }
            if let ([], [first, ..]) = (&*assets.maps, &*assets.failed) {
                return Err(Error::invalid(folder, "hdri", none_read(&first.reason)));
            }
        }
        if let Some(folder) = &config.models {
            let paths = chosen(config, folder, "models", models::list(folder)?)?;
            assets.models = Library::new(folder, paths);
            pictures.extend(assets.models.base_colors(PICTURES, PICTURE_SIDE));
        }
        assets.pictures = pictures.into();
        Ok(assets)
    }

    /// All files that could not be read so far, sorted by path.
    #[must_use]
    pub fn failed(&self) -> Vec<Failed> {
        let mut all = self.failed.clone();
        all.extend(self.models.failed());
        all.sort_by(|a, b| a.path.cmp(&b.path));
        all
    }
}

/// Rows of environments as pictures.
const PICTURE_ROWS: usize = 512;
/// Pictures that are taken from models at most, which bounds memory.
const PICTURES: usize = 64;
/// Least side of a picture in pixels.
const PICTURE_SIDE: usize = 64;

/// An environment as a photograph: exposed for the mean of its darker nine tenths, clipped.
fn tone_mapped(map: &EnvMap) -> Image {
    let mut light: Vec<f32> = map.pixels.iter().map(|p| p[1].max(0.0)).collect();
    light.sort_by(f32::total_cmp);
    let most = &light[..light.len() - light.len() / 10];
    let mean = most.iter().sum::<f32>() / most.len().max(1) as f32;
    let exposure = 0.25 / mean.max(1e-6);
    let byte = |v: f32| (255.0 * srgb_encode((v * exposure).clamp(0.0, 1.0)) + 0.5) as u8;
    Image {
        width: map.width,
        height: map.height,
        pixels: map
            .pixels
            .iter()
            .map(|&[r, g, b]| [byte(r), byte(g), byte(b), 255])
            .collect(),
        srgb: true,
    }
}

/// Says of a folder that none of its files is good.
pub(super) fn none_read(first: &str) -> String {
    format!("expected at least one file that can be read, found none; the first: {first}")
}

/// Whether the file belongs to the held-out split. Only its path below the folder of the set counts (many sets call all
/// their files the same, each in a folder of its own), so that files which are added later do not move others from one
/// split to the other.
#[must_use]
pub fn held_out(below: &Path, share: f32) -> bool {
    let parts: Vec<_> = below.iter().map(|p| p.to_string_lossy()).collect();
    let hash = Seed(0).child("held out").child(&parts.join("/")).0;
    ((hash >> 40) as f32) < share * (1 << 24) as f32
}

fn chosen(
    config: &GenerateConfig,
    folder: &Path,
    field: &str,
    paths: Vec<PathBuf>,
) -> Result<Vec<PathBuf>> {
    let all = paths.len();
    let wanted = config.split == Split::HeldOut;
    let kept: Vec<PathBuf> = paths
        .into_iter()
        .filter(|p| {
            let below = p.strip_prefix(folder).unwrap_or(p);
            held_out(below, config.held_out) == wanted
        })
        .collect();
    if kept.is_empty() {
        let expected = format!(
            "expected files of this kind for the split in the folder, found {all} in all; `held_out` sets the shares"
        );
        return Err(Error::invalid(folder, field, expected));
    }
    Ok(kept)
}
