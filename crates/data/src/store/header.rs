//! What describes a record besides its arrays: JSON in a file's metadata or a group's attributes.

use super::{ObjectRecord, VERSION};
use lumi_core::glam::{Mat3, Vec3};
use lumi_core::{Area, Camera, EnvMap, Environment, Error, Light, NamedLight, Point, Result};
use serde::{Deserialize, Serialize};
use std::sync::Arc;

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Header {
    pub version: u32,
    pub name: String,
    pub cameras: Vec<Camera>,
    pub lights: Vec<LightHeader>,
}

#[derive(Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct LightHeader {
    pub name: String,
    light: LightFields,
}

/// What a light is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LightKind {
    /// [`lumi_core::Environment`]
    Environment,
    /// [`lumi_core::Point`]
    Point,
    /// [`lumi_core::Area`]
    Area,
}

/// A light without its map, which is an array of its own.
#[derive(Clone, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case", deny_unknown_fields)]
enum LightFields {
    Environment {
        rotation: Mat3,
        strength: [f32; 3],
    },
    Point {
        position: Vec3,
        power: f32,
        color: [f32; 3],
        radius: f32,
    },
    Area {
        position: Vec3,
        direction: Vec3,
        side: Vec3,
        size: f32,
        power: f32,
        color: [f32; 3],
    },
}

impl Header {
    pub fn new(record: &ObjectRecord) -> Self {
        Self {
            version: VERSION,
            name: record.name.clone(),
            cameras: record.cameras.clone(),
            lights: record.lights.iter().map(LightHeader::new).collect(),
        }
    }

    /// Width and height of the views, once version and cameras are as they must be.
    pub fn check(&self) -> Result<(usize, usize)> {
        if self.version != VERSION {
            let expected = format!("expected {VERSION}, found {}", self.version);
            return Err(Error::value("version", expected));
        }
        let first = self.cameras.first();
        let first = first.ok_or_else(|| Error::value("cameras", "expected at least one"))?;
        first.validate().map_err(|e| e.within("cameras[0]"))?;
        Ok((first.width, first.height))
    }
}

impl LightHeader {
    fn new(named: &NamedLight) -> Self {
        let light = match &named.light {
            Light::Environment(l) => LightFields::Environment {
                rotation: l.rotation,
                strength: l.strength,
            },
            Light::Point(l) => LightFields::Point {
                position: l.position,
                power: l.power,
                color: l.color,
                radius: l.radius,
            },
            Light::Area(l) => LightFields::Area {
                position: l.position,
                direction: l.direction,
                side: l.side,
                size: l.size,
                power: l.power,
                color: l.color,
            },
        };
        Self {
            name: named.name.clone(),
            light,
        }
    }

    /// Its kind.
    pub fn kind(&self) -> LightKind {
        match self.light {
            LightFields::Environment { .. } => LightKind::Environment,
            LightFields::Point { .. } => LightKind::Point,
            LightFields::Area { .. } => LightKind::Area,
        }
    }

    /// The light; `map` reads the map of an environment of this name.
    pub fn with_map(self, map: impl FnOnce(&str) -> Result<EnvMap>) -> Result<NamedLight> {
        let light = match self.light {
            LightFields::Environment { rotation, strength } => Light::Environment(Environment {
                map: Arc::new(map(&self.name)?),
                rotation,
                strength,
            }),
            LightFields::Point {
                position,
                power,
                color,
                radius,
            } => Light::Point(Point {
                position,
                power,
                color,
                radius,
            }),
            LightFields::Area {
                position,
                direction,
                side,
                size,
                power,
                color,
            } => Light::Area(Area {
                position,
                direction,
                side,
                size,
                power,
                color,
            }),
        };
        Ok(NamedLight {
            name: self.name,
            light,
        })
    }
}

/// The same light with a map within half floats: what lies beyond them, as suns do, goes into its strength.
pub(super) fn within_half(named: &NamedLight) -> NamedLight {
    let mut named = named.clone();
    if let Light::Environment(light) = &mut named.light {
        let values = light.map.pixels.as_flattened().iter();
        let top = values.fold(0.0_f32, |m, v| m.max(*v));
        let scale = top / f32::from(half::f16::MAX);
        if scale > 1.0 {
            let pixels = light.map.pixels.iter().map(|p| p.map(|v| v / scale));
            light.map = Arc::new(EnvMap {
                pixels: pixels.collect(),
                ..*light.map
            });
            light.strength = light.strength.map(|s| s * scale);
        }
    }
    named
}

/// A map from the half floats `[height, width, 3]`.
pub(super) fn map(height: usize, width: usize, values: &[half::f16]) -> EnvMap {
    let pixels = values
        .chunks_exact(3)
        .map(|p| [p[0].to_f32(), p[1].to_f32(), p[2].to_f32()])
        .collect();
    EnvMap {
        width,
        height,
        pixels,
    }
}

/// The half floats of a map, `[height, width, 3]`.
pub(super) fn halves(map: &EnvMap) -> Vec<half::f16> {
    let values = map.pixels.iter().flatten();
    values.map(|&v| super::to_half(v)).collect()
}
