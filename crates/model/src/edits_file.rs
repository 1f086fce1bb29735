//! Edits as a file: TOML with `[[edit]]` tables of `mode` and `lights`, which `lumi relight --edits` reads and the
//! studio writes.

use crate::{Edit, Error, Mode, Result};
use lumi_core::light::{LightEntry, LightSpec};
use serde::{Deserialize, Serialize};
use std::path::Path;

/// The file.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EditsFile {
    /// Edits, first one first.
    #[serde(default)]
    pub edit: Vec<EditEntry>,
}

/// One edit as it is written.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EditEntry {
    /// What happens to the light that is there.
    pub mode: Mode,
    /// Lights; their files are relative to the edits file.
    pub lights: Vec<LightEntry>,
}

impl EditsFile {
    /// Reads the edits and their environment maps.
    ///
    /// # Errors
    /// Names the file, and the edit and light that is wrong.
    pub fn read(path: impl AsRef<Path>) -> Result<Vec<Edit>> {
        let edits = Self::written(path)?.into_iter().map(|(mode, lights)| {
            let lights = lights.iter().map(|light| light.open(Path::new("")));
            let lights = lights.collect::<lumi_core::Result<Vec<_>>>()?;
            Ok(Edit::new(mode, lights))
        });
        edits.collect()
    }

    /// Reads the edits as they are written, with the paths of their environment maps.
    ///
    /// # Errors
    /// Names the file, and the edit and light that is wrong.
    pub fn written(path: impl AsRef<Path>) -> Result<Vec<(Mode, Vec<LightSpec>)>> {
        let path = path.as_ref();
        let bytes = lumi_core::fs::read_bytes(path)?;
        let wrong = |field: &str, e: String| lumi_core::Error::invalid(path, field, e);
        let text = std::str::from_utf8(&bytes).map_err(|e| wrong("text", e.to_string()))?;
        let file: Self = toml::from_str(text).map_err(|e| wrong("edits", e.to_string()))?;
        let base = path.parent().unwrap_or(Path::new(""));
        let edits = file.edit.iter().enumerate().map(|(i, entry)| {
            let lights = entry.lights.iter().map(|light| {
                let light = light.light();
                let light = light.map_err(|e| wrong(&format!("edit {}", i + 1), e))?;
                Ok(light.with_map(|file| base.join(file)))
            });
            Ok((entry.mode, lights.collect::<lumi_core::Result<_>>()?))
        });
        edits.collect()
    }

    /// The file's text.
    ///
    /// # Errors
    /// If it cannot be written as TOML.
    pub fn to_toml(&self) -> Result<String> {
        toml::to_string(self).map_err(|e| Error::config("edits", "edit", e.to_string()))
    }
}
