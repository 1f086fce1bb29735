//! What a set is made of besides formulas: environment maps and models, split by file.

use super::config::{GenerateConfig, Split};
use crate::image_texture::Image;
use crate::light::MAP_ROWS;
use crate::material::Material;
use crate::scene::mesh::Model;
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
    /// Models as they are in their files.
    pub models: Vec<Model>,
    /// Base colours of the models and tone-mapped environments, to be printed on procedural surfaces.
    pub pictures: Arc<[Arc<Image>]>,
    /// What the models' files hold that is not shown.
    pub warnings: Vec<String>,
}

impl Assets {
    /// Reads the maps and models that `config` names, those of its split.
    ///
    /// # Errors
    /// If a folder or a file cannot be read, or a folder holds none for the split.
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
            let read: Vec<_> = maps.collect::<Result<_>>()?;
            (assets.maps, pictures) = read.into_iter().unzip();
        }
        if let Some(folder) = &config.models {
            let paths = chosen(config, folder, "models", models::list(folder)?)?;
            let imports: Vec<models::Import> = paths
                .par_iter()
                .map(|p| models::read(p))
                .collect::<Result<_>>()?;
            for (path, import) in paths.iter().zip(imports) {
                let name = path.display();
                let warnings = import.warnings.iter().map(|w| format!("{name}: {w}"));
                assets.warnings.extend(warnings);
                pictures.extend(base_colors(&import.model));
                assets.models.push(import.model);
            }
        }
        assets.pictures = pictures.into();
        Ok(assets)
    }
}

/// Rows of environments as pictures.
const PICTURE_ROWS: usize = 512;
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

/// The images of base colours that a model has, each once.
fn base_colors(model: &Model) -> Vec<Arc<Image>> {
    let mut found: Vec<Arc<Image>> = Vec::new();
    for material in &model.materials {
        let Material::Textured(textured) = material else {
            continue;
        };
        let Some(base) = &textured.base else {
            continue;
        };
        let image = &base.image;
        let large = image.width.min(image.height) >= PICTURE_SIDE;
        if large && !found.iter().any(|f| Arc::ptr_eq(f, image)) {
            found.push(Arc::clone(image));
        }
    }
    found
}

/// Whether the file belongs to the held-out split. Only its name counts, so that files which are added later do
/// not move others from one split to the other.
#[must_use]
pub fn held_out(path: &Path, share: f32) -> bool {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let hash = Seed(0).child("held out").child(&name).0;
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
        .filter(|p| held_out(p, config.held_out) == wanted)
        .collect();
    if kept.is_empty() {
        let expected = format!(
            "expected files of this kind for the split in the folder, found {all} in all; `held_out` sets the shares"
        );
        return Err(Error::invalid(folder, field, expected));
    }
    Ok(kept)
}
