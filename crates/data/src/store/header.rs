//! What describes a record besides its arrays: JSON in a file's metadata or a group's attributes.

use super::{ObjectRecord, VERSION};
use lumi_core::glam::Vec3;
use lumi_core::light::{LightSource, ahead};
use lumi_core::{Camera, EnvMap, Error, Light, NamedLight, Result};
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};
use std::sync::Arc;

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Header {
    pub version: u32,
    pub name: String,
    pub cameras: Vec<Camera>,
    pub lights: Vec<LightHeader>,
}

/// A light, with the name of the array that is its map.
#[derive(Clone, Serialize, Deserialize)]
#[serde(try_from = "Written")]
pub(super) struct LightHeader {
    pub name: String,
    light: LightSource<String>,
}

/// A light as it stands in a record.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Written {
    name: String,
    light: Map<String, Value>,
}

impl TryFrom<Written> for LightHeader {
    type Error = Error;

    fn try_from(written: Written) -> Result<Self> {
        let Written { name, mut light } = written;
        of_today(&name, &mut light);
        let light = LightSource::from_fields(light)?;
        Ok(Self { name, light })
    }
}

/// Earlier records leave out that a map is called as its light, and tell where a square faces by a direction.
fn of_today(name: &str, light: &mut Map<String, Value>) {
    match light.get("kind").and_then(Value::as_str) {
        Some("environment") => {
            light.entry("map").or_insert_with(|| name.into());
        }
        Some("area") => {
            let vector = |key: &str| Vec3::deserialize(light.get(key)?).ok();
            if let (Some(position), Some(direction)) = (vector("position"), vector("direction")) {
                light.remove("direction");
                let target = ahead(position, direction).to_array();
                light.insert("target".to_owned(), target.to_vec().into());
            }
        }
        _ => {}
    }
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
    /// [`lumi_core::Spot`]
    Spot,
    /// [`lumi_core::Sun`]
    Sun,
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
        let light = named.light.clone();
        Self {
            name: named.name.clone(),
            light: light.with_map(|_| named.name.clone()),
        }
    }

    /// Its kind.
    pub fn kind(&self) -> LightKind {
        match self.light {
            LightSource::Environment(_) => LightKind::Environment,
            LightSource::Point(_) => LightKind::Point,
            LightSource::Area(_) => LightKind::Area,
            LightSource::Spot(_) => LightKind::Spot,
            LightSource::Sun(_) => LightKind::Sun,
        }
    }

    /// The light; `map` reads the array of that name.
    pub fn with_map(self, map: impl FnOnce(&str) -> Result<EnvMap>) -> Result<NamedLight> {
        let light = self.light.try_with_map(|name| map(&name).map(Arc::new))?;
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

#[cfg(test)]
mod tests {
    use super::*;
    use lumi_core::glam::{Mat3, Vec3};

    #[test]
    fn lights_of_earlier_records_are_read() {
        let read = |text: &str| serde_json::from_str::<LightHeader>(text).expect("a light");
        let sky = read(
            r#"{"name": "env0", "light": {"kind": "environment", "rotation": [0,1,0,-1,0,0,0,0,1], "strength": [1.5, 1, 0.5]}}"#,
        );
        let LightSource::Environment(sky) = sky.light else {
            panic!("an environment")
        };
        let turned = Mat3::from_cols(Vec3::Y, Vec3::NEG_X, Vec3::Z);
        assert_eq!((sky.map.as_str(), sky.orientation()), ("env0", turned));
        assert_eq!(sky.strength, [1.5, 1.0, 0.5]);
        let square = read(
            r#"{"name": "area0", "light": {"kind": "area", "position": [30, 0, 0], "direction": [-0.6, 0, -0.8],
                "side": [0, 1, 0], "size": 1.5, "power": 900, "color": [1, 1, 1]}}"#,
        );
        let LightSource::Area(square) = square.light else {
            panic!("an area light")
        };
        let direction = Vec3::new(-0.6, 0.0, -0.8);
        assert!(square.direction().distance(direction) < 1e-6);
        assert!(square.sides()[0].distance(Vec3::Y) < 1e-6);
        read(
            r#"{"name": "p", "light": {"kind": "point", "position": [0, 0, 3], "power": 5, "color": [1, 1, 1], "radius": 0.1}}"#,
        );
        let wrong =
            r#"{"name": "p", "light": {"kind": "point", "position": [0, 0, 3], "watts": 5}}"#;
        let error = serde_json::from_str::<LightHeader>(wrong)
            .err()
            .expect("an error");
        assert!(error.to_string().contains("point.watts"), "{error}");
    }
}
