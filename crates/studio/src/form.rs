//! Lights and edits as they travel between page and server, in the scene's world space.

use crate::limits::{LIGHTS, NAME};
use crate::maps::{MapEntry, Maps};
use crate::{Error, Result};
use lumi_core::Light;
use lumi_core::light::{LightSource, LightSpec};
use lumi_model::{Edit, Mode};
use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::{Deserialize, Serialize};
use std::path::PathBuf;
use std::sync::Arc;

/// A light whose map is one of the studio's, by its id.
pub type LightForm = LightSource<String>;

/// One edit as JSON.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
#[schemars(rename = "Edit")]
pub struct EditForm {
    /// What a person calls it; it changes nothing of the picture.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(with = "String", length(min = 1, max = NAME))]
    pub name: Option<String>,
    /// What happens to the light that is there.
    #[schemars(schema_with = "modes")]
    pub mode: Mode,
    /// The lights.
    #[schemars(length(min = 1, max = LIGHTS))]
    pub lights: Vec<LightForm>,
}

/// Names of the modes.
pub(crate) fn modes(_: &mut SchemaGenerator) -> Schema {
    json_schema!({"type": "string", "enum": Mode::ALL})
}

/// The light itself.
///
/// # Errors
/// If its map is unknown.
fn light(form: &LightForm, maps: &Maps) -> Result<Light> {
    let map = |id: String| Ok(Arc::clone(&maps.get(&id)?.map));
    form.clone().try_with_map(map)
}

/// The light as the command line has it, its map in the file that `file` names.
///
/// # Errors
/// If its map is unknown.
pub fn spec(
    form: &LightForm,
    maps: &Maps,
    file: impl FnOnce(Arc<MapEntry>) -> PathBuf,
) -> Result<LightSpec> {
    form.clone().try_with_map(|id| Ok(file(maps.get(&id)?)))
}

impl EditForm {
    /// The edit itself.
    ///
    /// # Errors
    /// On an unknown map, no light or too many lights, a light out of range, and a name that is none. Whether lights fit the scene is
    /// checked by the model.
    pub fn edit(&self, maps: &Maps) -> Result<Edit> {
        let name = self.name.as_deref().unwrap_or("-");
        if name.trim().is_empty()
            || name.chars().count() > NAME
            || name.chars().any(char::is_control)
        {
            let text = format!("name: expected 1 to {NAME} characters in one line");
            return Err(Error::Invalid(text));
        }
        if self.lights.is_empty() || self.lights.len() > LIGHTS {
            let found = self.lights.len();
            let text = format!("lights: expected 1 to {LIGHTS}, found {found}");
            return Err(Error::Invalid(text));
        }
        let lights = self.lights.iter().map(|form| {
            form.check()?;
            light(form, maps)
        });
        Ok(Edit::new(self.mode, lights.collect::<Result<Vec<_>>>()?))
    }

    /// Whether nothing but the name differs.
    #[must_use]
    pub fn lights_as(&self, other: &Self) -> bool {
        (self.mode, &self.lights) == (other.mode, &other.lights)
    }
}
