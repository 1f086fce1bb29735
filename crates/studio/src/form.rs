//! Lights and edits as they travel between page and server, in the scene's world space.

use crate::limits::{LIGHTS, NAME};
use crate::maps::{MapEntry, Maps};
use crate::{Error, Result};
use lumi_core::light::LightSpec;
use lumi_core::{Area, Environment, Light, Point};
use lumi_model::{Edit, Mode};
use serde::{Deserialize, Serialize};
use std::path::PathBuf;
use std::sync::Arc;

/// A light as JSON; units as in [`lumi_core::Light`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "lowercase", deny_unknown_fields)]
pub enum LightForm {
    /// Distant light from a map.
    Environment {
        /// Id of the map.
        map: String,
        /// Degrees about +z, counter-clockwise from above.
        rotate: f32,
        /// Factor on the map's radiance.
        strength: f32,
    },
    /// A small sphere.
    Point {
        /// Centre.
        position: [f32; 3],
        /// Watts.
        power: f32,
        /// Factor on the power, linear Rec. 709.
        color: [f32; 3],
    },
    /// A square that shines to one side.
    Area {
        /// Centre.
        position: [f32; 3],
        /// What it faces.
        target: [f32; 3],
        /// Length of a side.
        size: f32,
        /// Watts.
        power: f32,
        /// Factor on the power, linear Rec. 709.
        color: [f32; 3],
    },
}

/// One edit as JSON.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EditForm {
    /// What a person calls it; it changes nothing of the picture.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub name: Option<String>,
    /// What happens to the light that is there.
    pub mode: Mode,
    /// The lights.
    pub lights: Vec<LightForm>,
}

impl LightForm {
    /// The light itself.
    ///
    /// # Errors
    /// If its map is unknown.
    pub fn light(&self, maps: &Maps) -> Result<Light> {
        Ok(match *self {
            Self::Environment {
                ref map,
                rotate,
                strength,
            } => {
                let map = Arc::clone(&maps.get(map)?.map);
                Light::Environment(Environment::new(map, rotate.to_radians(), strength))
            }
            Self::Point {
                position,
                power,
                color,
            } => Light::Point(Point {
                color,
                ..Point::new(position.into(), power)
            }),
            Self::Area {
                position,
                target,
                size,
                power,
                color,
            } => Light::Area(Area {
                color,
                ..Area::facing(position.into(), target.into(), size, power)
            }),
        })
    }

    /// The light in the grammar of the command line, its map in the file that `file` names.
    ///
    /// # Errors
    /// If its map is unknown.
    pub fn spec(
        &self,
        maps: &Maps,
        file: impl FnOnce(Arc<MapEntry>) -> PathBuf,
    ) -> Result<LightSpec> {
        Ok(match self {
            Self::Environment {
                map,
                rotate,
                strength,
            } => LightSpec::Environment {
                file: file(maps.get(map)?),
                rotate: *rotate,
                strength: *strength,
            },
            local => LightSpec::Local(local.light(maps)?),
        })
    }

    /// Id of the map it needs.
    #[must_use]
    pub fn map(&self) -> Option<&str> {
        match self {
            Self::Environment { map, .. } => Some(map),
            _ => None,
        }
    }
}

impl EditForm {
    /// The edit itself.
    ///
    /// # Errors
    /// On an unknown map, no light or too many lights, and a name that is none. Ranges are checked by the model.
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
        let lights = self.lights.iter().map(|l| l.light(maps));
        Ok(Edit::new(self.mode, lights.collect::<Result<Vec<_>>>()?))
    }

    /// Whether nothing but the name differs.
    #[must_use]
    pub fn lights_as(&self, other: &Self) -> bool {
        (self.mode, &self.lights) == (other.mode, &other.lights)
    }
}
