//! The interchange layout: one folder per object, rendered one light at a time.
//!
//! * `cameras.json`: views with OpenCV cameras, sizes and roles;
//! * `lights.json`: lights in Blender's units;
//! * `object.json` (optional): name and bounding sphere;
//! * `VIEW_LIGHT.exr`: half-float linear RGB, premultiplied by the alpha that all lights of a view share.

mod read;
mod write;

pub use read::open;
pub use write::write;

use crate::json::Rows;
use serde::{Deserialize, Serialize};
use std::path::Path;

/// Whether `folder` holds the two files that every such folder has.
#[must_use]
pub fn detect(folder: &Path) -> bool {
    folder.join("cameras.json").is_file() && folder.join("lights.json").is_file()
}

/// `cameras.json`; further keys, such as spherical coordinates, are for people.
#[derive(Serialize, Deserialize)]
struct CamerasFile {
    convention: Option<String>,
    views: Vec<ViewRecord>,
}

#[derive(Serialize, Deserialize)]
struct ViewRecord {
    name: String,
    role: RoleRecord,
    width: usize,
    height: usize,
    fx: f32,
    fy: f32,
    cx: f32,
    cy: f32,
    camera_to_world: Rows,
}

#[derive(Clone, Copy, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
enum RoleRecord {
    Input,
    Target,
}

/// `object.json`; further keys are provenance.
#[derive(Serialize, Deserialize, Default)]
struct ObjectFile {
    #[serde(skip_serializing_if = "Option::is_none")]
    name: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    bounding_sphere_center: Option<[f32; 3]>,
    #[serde(skip_serializing_if = "Option::is_none")]
    bounding_sphere_radius: Option<f32>,
}

/// A factor for all channels, or one for each.
#[derive(Clone, Copy, Serialize, Deserialize)]
#[serde(untagged)]
enum Strength {
    All(f32),
    Each([f32; 3]),
}

fn one() -> Strength {
    Strength::All(1.0)
}

fn white() -> [f32; 3] {
    [1.0; 3]
}

fn radius() -> f32 {
    0.05
}

/// Light of type `env`. The fields named `_…` here and below repeat the others in another form for
/// people and are not read; any other key is an error, so that a misspelt one is noticed.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct EnvRecord {
    name: String,
    file: String,
    #[serde(default)]
    rotation_z: f32,
    #[serde(default = "one")]
    strength: Strength,
    #[serde(rename = "lookup", default, skip_serializing)]
    _lookup: serde::de::IgnoredAny,
}

/// Light of type `point`.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct PointRecord {
    name: String,
    position: [f32; 3],
    power_watts: f32,
    #[serde(default = "white")]
    color: [f32; 3],
    #[serde(default = "radius")]
    radius: f32,
    #[serde(rename = "distance", default, skip_serializing)]
    _distance: serde::de::IgnoredAny,
    #[serde(rename = "radiant_intensity", default, skip_serializing)]
    _radiant_intensity: serde::de::IgnoredAny,
    #[serde(rename = "sphere_radiance", default, skip_serializing)]
    _sphere_radiance: serde::de::IgnoredAny,
}

/// Light of type `area`; without `direction` it faces the origin.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct AreaRecord {
    name: String,
    position: [f32; 3],
    size: f32,
    power_watts: f32,
    #[serde(default = "white")]
    color: [f32; 3],
    direction: Option<[f32; 3]>,
    side_u: Option<[f32; 3]>,
    #[serde(rename = "side_v", default, skip_serializing)]
    _side_v: serde::de::IgnoredAny,
    #[serde(rename = "distance", default, skip_serializing)]
    _distance: serde::de::IgnoredAny,
    #[serde(rename = "radiance", default, skip_serializing)]
    _radiance: serde::de::IgnoredAny,
    #[serde(rename = "light_to_world", default, skip_serializing)]
    _light_to_world: serde::de::IgnoredAny,
}

/// The file of one view under one light.
fn image_name(view: &str, light: &str) -> String {
    format!("{view}_{light}.exr")
}

/// Whether `name` may become part of a file name.
fn is_plain(name: &str) -> bool {
    let plain = |c: char| c.is_ascii_alphanumeric() || "-_+.".contains(c);
    !name.is_empty() && !name.starts_with('.') && name.chars().all(plain)
}
