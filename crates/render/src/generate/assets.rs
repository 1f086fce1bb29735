//! What a set is made of besides formulas: environment maps and models, split by file.

use super::config::{GenerateConfig, Split};
use crate::light::MAP_ROWS;
use crate::scene::mesh::Model;
use crate::{environment, models};
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
        if let Some(folder) = &config.hdri {
            let paths = chosen(config, folder, "hdri", environment::list(folder)?)?;
            let maps = paths.par_iter().map(|p| {
                let map = EnvMap::read(p)?;
                Ok(Arc::new(map.at_most(MAP_ROWS).into_owned()))
            });
            assets.maps = maps.collect::<Result<_>>()?;
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
                assets.models.push(import.model);
            }
        }
        Ok(assets)
    }
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
