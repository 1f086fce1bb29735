//! nerfstudio's and Blender's `transforms.json`: photographs with OpenGL camera-to-world poses.
//!
//! * Intrinsics: `fl_x`, `fl_y`, `cx`, `cy`, `w`, `h` or `camera_angle_x`, `camera_angle_y`, once for
//!   all frames or per frame (which wins).
//! * Lens: `k1` to `k4`, `p1`, `p2` of `camera_model` OPENCV (or none), removed by resampling
//!   ([`crate::lens`]). A fisheye is an error.
//! * Poses stand in the world after `applied_transform` and `applied_scale`, which only say what was done
//!   to the reconstruction's own world; they are checked, and nothing else follows from them.
//! * Coverage: an image named by `mask_path` (white is the object), else the image's alpha.
//! * Roles: `transforms_train.json` (inputs) + `transforms_val.json` and `transforms_test.json` (held out), or
//!   `train_filenames` and `test_filenames`/`val_filenames`, see [`splits`]; else every eighth frame is held out if
//!   there are nine or more.
//! * Paths may be written with `\`.
//! * Up: +z if the cameras do not say otherwise ([`crate::upright`]) or `orientation_override` is `none`.
//! * Bounding ball: `bounding_sphere_center` and `bounding_sphere_radius` (ours), else estimated ([`crate::ball`]).
//!
//! Sources: nerfstudio's documentation, "Data conventions"; the NeRF authors' synthetic scenes.

mod read;
mod splits;
mod write;

pub use read::open;
pub(super) use read::{parse, place, shot};
pub use write::{write, write_with_masks};

use lumi_core::Role;
use serde::{Deserialize, Serialize};
use std::path::Path;

/// Files that hold frames, and the role that the file's name gives to them.
const FILES: [(&str, Option<Role>); 4] = [
    ("transforms.json", None),
    ("transforms_train.json", Some(Role::Input)),
    ("transforms_val.json", Some(Role::Target)),
    ("transforms_test.json", Some(Role::Target)),
];

/// Whether `folder` holds a `transforms.json` or `transforms_train.json` that no other format claims.
#[must_use]
pub fn detect(folder: &Path) -> bool {
    let here = |(name, _): &(&str, Option<Role>)| folder.join(name).is_file();
    FILES[..2].iter().any(here) && !super::stanford_orb::detect(folder)
}

/// `transforms.json`. Its lenses are parsed apart ([`parse`]): flattened fields would lose the place of an error.
#[derive(Serialize, Deserialize)]
pub(super) struct TransformsFile {
    #[serde(flatten, skip_deserializing)]
    pub lens: Lens,
    pub frames: Vec<Frame>,
    #[serde(skip_serializing_if = "Option::is_none")]
    train_filenames: Option<Vec<String>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    test_filenames: Option<Vec<String>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    val_filenames: Option<Vec<String>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    applied_transform: Option<Vec<Vec<f64>>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    applied_scale: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    orientation_override: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    bounding_sphere_center: Option<[f32; 3]>,
    #[serde(skip_serializing_if = "Option::is_none")]
    bounding_sphere_radius: Option<f32>,
}

#[derive(Serialize, Deserialize)]
pub(super) struct Frame {
    pub file_path: String,
    #[serde(skip_serializing_if = "Option::is_none")]
    mask_path: Option<String>,
    pub transform_matrix: Vec<Vec<f64>>,
    /// Stanford-ORB's: the capture that the frame was taken in.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub scene_name: Option<String>,
    #[serde(flatten, skip_deserializing)]
    pub lens: Lens,
}

/// What describes the lens, in the file's head or in a frame.
#[derive(Default, Serialize, Deserialize)]
pub(super) struct Lens {
    #[serde(skip_serializing_if = "Option::is_none")]
    camera_model: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    camera_angle_x: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    camera_angle_y: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    fl_x: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    fl_y: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    cx: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    cy: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    w: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    h: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    k1: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    k2: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    k3: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    k4: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    p1: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    p2: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    is_fisheye: Option<bool>,
}
