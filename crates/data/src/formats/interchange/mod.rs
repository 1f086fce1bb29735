//! The interchange layout: one folder per object, rendered one light at a time.
//!
//! * `cameras.json`: views with OpenCV cameras, sizes and roles;
//! * `lights.json`: lights in Blender's units;
//! * `object.json` (optional): name and bounding sphere;
//! * `VIEW_LIGHT.exr`: half-float linear RGB, premultiplied by the alpha that all lights of a view share.

mod lights;
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

/// The file of one view under one light.
fn image_name(view: &str, light: &str) -> String {
    format!("{view}_{light}.exr")
}

/// Whether `name` may become part of a file name.
fn is_plain(name: &str) -> bool {
    let plain = |c: char| c.is_ascii_alphanumeric() || "-_+.".contains(c);
    !name.is_empty() && !name.starts_with('.') && name.chars().all(plain)
}
