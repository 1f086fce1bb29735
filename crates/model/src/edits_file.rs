//! Edits as a file: TOML with `[[edit]]` tables of `mode` and `lights`, which `lumi relight --edits` reads and the
//! studio writes.

use crate::{Edit, Error, Mode, Result};
use lumi_core::light::LightSpec;
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
    /// Lights in the grammar of [`LightSpec`]; their files are relative to the edits file.
    pub lights: Vec<String>,
}

impl EditsFile {
    /// Reads the edits and their environment maps.
    ///
    /// # Errors
    /// Names the file, and the edit and light that is wrong.
    pub fn read(path: impl AsRef<Path>) -> Result<Vec<Edit>> {
        let path = path.as_ref();
        let bytes = lumi_core::fs::read_bytes(path)?;
        let wrong = |field: &str, e: String| lumi_core::Error::invalid(path, field, e);
        let text = std::str::from_utf8(&bytes).map_err(|e| wrong("text", e.to_string()))?;
        let file: Self = toml::from_str(text).map_err(|e| wrong("edits", e.to_string()))?;
        let base = path.parent().unwrap_or(Path::new(""));
        let edits = file.edit.iter().enumerate().map(|(i, entry)| {
            let lights = entry.lights.iter().map(|text| {
                let spec: LightSpec = text
                    .parse()
                    .map_err(|e| wrong(&format!("edit {}", i + 1), e))?;
                spec.open(base)
            });
            let lights = lights.collect::<lumi_core::Result<Vec<_>>>()?;
            Ok(Edit::new(entry.mode, lights))
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
