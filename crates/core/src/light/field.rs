//! What fields of lights have in common: defaults, ranges, and how they are written.

use super::LightSource;
use crate::{Error, Result};
use glam::{Mat3, Vec3};
use serde::de::DeserializeOwned;
use serde_json::{Map, Value};

/// Watts, W/m² and factors of the strongest light: a world in millimetres asks for a million times as much as one in metres, and
/// beyond that there are mistakes.
const MOST: f32 = 1e12;

/// Watts of a light that names none.
pub(super) fn power() -> f32 {
    1000.0
}

/// The colour of a light that names none.
pub(super) fn white() -> [f32; 3] {
    [1.0; 3]
}

/// Blender's radius of a bulb that names none.
pub(super) fn radius() -> f32 {
    0.05
}

pub(super) fn is_identity(rotation: &Mat3) -> bool {
    *rotation == Mat3::IDENTITY
}

/// Something is expected of a field of a kind of light.
pub(super) fn expected(kind: &str, field: &str, text: String) -> Error {
    Error::value(format!("{kind}.{field}"), format!("expected {text}"))
}

pub(super) fn finite(kind: &str, field: &str, vector: Vec3) -> Result<()> {
    let text = || format!("finite numbers, found {vector}");
    let ok = vector.is_finite().then_some(());
    ok.ok_or_else(|| expected(kind, field, text()))
}

/// A power, strength or length.
pub(super) fn positive(kind: &str, field: &str, unit: &str, value: f32) -> Result<()> {
    let text = || format!("a positive number of {unit} up to {MOST:e}, found {value}");
    let ok = (value > 0.0 && value <= MOST).then_some(());
    ok.ok_or_else(|| expected(kind, field, text()))
}

pub(super) fn within(kind: &str, field: &str, value: f32, [low, high]: [f32; 2]) -> Result<()> {
    let text = || format!("{low} to {high}, found {value}");
    let ok = (low..=high).contains(&value).then_some(());
    ok.ok_or_else(|| expected(kind, field, text()))
}

/// A factor per channel.
pub(super) fn some_light(kind: &str, field: &str, channels: [f32; 3]) -> Result<()> {
    let wrong = |v: &f32| !v.is_finite() || *v < 0.0;
    if channels.iter().any(wrong) || channels.iter().all(|v| *v == 0.0) {
        let text = format!("values ≥ 0, not all zero, found {channels:?}");
        return Err(expected(kind, field, text));
    }
    Ok(())
}

/// What a light with a place needs: place, power and colour.
pub(super) fn lamp(kind: &str, position: Vec3, power: f32, color: [f32; 3]) -> Result<()> {
    finite(kind, "position", position)?;
    positive(kind, "power", "watts", power)?;
    some_light(kind, "color", color)
}

/// The radius of a bulb, which may be a point.
pub(super) fn bulb(kind: &str, radius: f32) -> Result<()> {
    within(kind, "radius", radius, [0.0, MOST])
}

/// A light that is aimed needs somewhere else to look.
pub(super) fn aimed(kind: &str, position: Vec3, target: Vec3) -> Result<()> {
    finite(kind, "target", target)?;
    if (target - position).try_normalize().is_none() {
        let text = format!("another place than the light's own, found {target}");
        return Err(expected(kind, "target", text));
    }
    Ok(())
}

/// In model space lights stand outside the scene.
pub(super) fn outside(kind: &str, position: Vec3) -> Result<()> {
    let found = position.length();
    if found <= 1.0 {
        let text = format!(
            "a light outside the scene's bounding sphere, found it at {found:.2} of its radius"
        );
        return Err(expected(kind, "position", text));
    }
    Ok(())
}

/// A factor for all channels, or one for each: one number is written where they are the same.
pub(super) mod factor {
    use schemars::JsonSchema;
    use serde::{Deserialize, Deserializer, Serialize, Serializer};

    /// A factor for all channels, or one for each.
    #[derive(Serialize, Deserialize, JsonSchema)]
    #[serde(untagged)]
    pub(in crate::light) enum Factor {
        All(f32),
        Each([f32; 3]),
    }

    pub fn one() -> [f32; 3] {
        [1.0; 3]
    }

    pub fn serialize<S: Serializer>(&[r, g, b]: &[f32; 3], to: S) -> Result<S::Ok, S::Error> {
        match r == g && g == b {
            true => Factor::All(r).serialize(to),
            false => Factor::Each([r, g, b]).serialize(to),
        }
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(from: D) -> Result<[f32; 3], D::Error> {
        Ok(match Factor::deserialize(from)? {
            Factor::All(v) => [v; 3],
            Factor::Each(v) => v,
        })
    }
}

impl<M: DeserializeOwned> LightSource<M> {
    /// A light from the members of its JSON object.
    ///
    /// # Errors
    /// As [`serde`], but with the name of the wrong field; ranges are not checked ([`Self::check`]).
    pub fn from_fields(fields: Map<String, Value>) -> Result<Self> {
        let kind = fields.get("kind").cloned().unwrap_or_default();
        let parse = |fields: &Map<String, Value>| {
            serde_json::from_value::<Self>(Value::Object(fields.clone())).map_err(|e| e.to_string())
        };
        parse(&fields).map_err(|text| {
            // Alone, a field lacks the others; any other complaint is of its own value.
            let alone = |(name, value): (&String, &Value)| {
                let single = [("kind", &kind), (name.as_str(), value)];
                let single = single.map(|(name, value)| (name.to_owned(), value.clone()));
                let text = parse(&Map::from_iter(single)).err()?;
                (!text.starts_with("missing field")).then(|| (name.clone(), text))
            };
            let found = fields.iter().find_map(alone);
            let (name, text) = found.unwrap_or_else(|| ("light".to_owned(), text));
            let kind = kind.as_str().filter(|_| name != "kind").unwrap_or("light");
            Error::value(format!("{kind}.{name}"), text)
        })
    }
}
