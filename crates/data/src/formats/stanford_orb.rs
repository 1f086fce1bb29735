//! Stanford-ORB (Kuang et al. 2023) as published: `blender_LDR/OBJECT_sceneNNN` or `blender_HDR/…`.
//!
//! * `transforms_train.json` (inputs), `transforms_test.json` and `transforms_novel.json` (held out), in
//!   Blender's convention; every frame of the last names the capture it was taken in (`scene_name`), and
//!   its image stands there, while its pose is in this capture's world already.
//! * Masks: `train_mask/0000.png` for `train/0000.png`, likewise `test_mask`.
//! * Light: `ground_truth/SCENE/env_map/0000.exr` beside the `blender_…` folder, one map per test image and
//!   in that **camera's** frame: the middle column looks the way the camera does, row 0 is the camera's up
//!   (skylibs' convention: u = ½ + atan2(x, −z)/2π and v = acos(y)/π in OpenGL camera axes). The light of
//!   training images is not known. Lights are named after the capture: all its images have the same light, each
//!   as measured for it.
//! * Up is estimated from the cameras ([`crate::upright`]).
//!
//! Sources: the data set's README ("Dataset Structure"), and its authors' answer in its issue 9 on the
//! maps' frame.

use super::Opening;
use super::photo::{self, Bounds, Shot, Stage, Up, image_file};
use super::transforms::{parse, place, shot};
use glam::{Mat3, Mat4, Vec3};
use lumi_core::{EnvMap, Environment, Error, Light, NamedLight, Result, Role, Scene};
use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

const TRAIN: &str = "transforms_train.json";
const TEST: &str = "transforms_test.json";
const NOVEL: &str = "transforms_novel.json";

/// Rows to which a capture's 4 MB maps are averaged: light is fuzzy beyond, and hundreds stay in memory.
const MAP_ROWS: usize = 128;

/// Whether `folder` holds the three files of poses.
#[must_use]
pub fn detect(folder: &Path) -> bool {
    [TRAIN, TEST, NOVEL]
        .iter()
        .all(|f| folder.join(f).is_file())
}

/// Reads inputs, held-out views of the same capture and of the object's other captures, and their lights.
///
/// # Errors
/// Names the file and the frame or field that is missing or wrong.
pub fn open(folder: &Path, opening: &Opening) -> Result<Scene> {
    // The name of the folder leads to the others, so it must be one.
    let folder = &folder.canonicalize().map_err(|e| Error::io(folder, e))?;
    let captures = folder.parent().unwrap_or(folder);
    let mut maps = Maps {
        ground_truth: captures.join("../ground_truth"),
        read: HashMap::new(),
        warnings: Vec::new(),
    };
    let own = super::folder_name(folder);
    let mut shots = Vec::new();
    for (name, role) in [
        (TRAIN, Role::Input),
        (TEST, Role::Target),
        (NOVEL, Role::Target),
    ] {
        let path = folder.join(name);
        let file = parse(&path)?;
        for (i, frame) in file.frames.iter().enumerate() {
            let scene = frame.scene_name.clone().unwrap_or_else(|| own.clone());
            let shot = plain(&scene).and_then(|()| {
                let capture = captures.join(&scene);
                let image = image_file(&capture, &frame.file_path)?;
                let mut shot = shot(&capture, image, &file.lens, frame, role)?;
                shot.mask = shot.mask.or_else(|| mask(&shot.image));
                if role == Role::Target {
                    shot.lit_by = maps.light(&scene, &shot)?;
                }
                Ok(shot)
            });
            let mut shot = shot.map_err(|e| e.within(place(i, frame)).at(&path))?;
            shot.place = place(i, frame);
            if scene != own {
                shot.path = format!("{scene}/{}", frame.file_path.trim_start_matches("./"));
            }
            shots.push(shot);
        }
    }
    let stage = Stage {
        up: Up::FromCameras,
        bounds: Bounds::Unknown,
        opening,
        warnings: maps.warnings,
    };
    photo::scene(folder, &folder.join(TRAIN), shots, stage)
}

/// A capture's name becomes part of a path.
fn plain(name: &str) -> Result<()> {
    if name.is_empty() || name.contains(['/', '\\']) || name.starts_with('.') {
        let expected = format!("expected the name of a capture, found `{name}`");
        return Err(Error::value("scene_name", expected));
    }
    Ok(())
}

/// `test_mask/0000.png` for `test/0000.png` or `.exr`.
fn mask(image: &Path) -> Option<PathBuf> {
    let folder = image.parent()?;
    let masks = format!("{}_mask", folder.file_name()?.to_str()?);
    let stem = Path::new(image.file_name()?).with_extension("png");
    Some(folder.with_file_name(masks).join(stem)).filter(|p| p.is_file())
}

/// Environment maps, each read once.
struct Maps {
    ground_truth: PathBuf,
    read: HashMap<PathBuf, Arc<EnvMap>>,
    warnings: Vec<String>,
}

impl Maps {
    /// The light of a test image; nothing where the maps were not downloaded.
    fn light(&mut self, scene: &str, shot: &Shot) -> Result<Vec<NamedLight>> {
        let Some(stem) = shot.image.file_stem() else {
            return Ok(Vec::new());
        };
        let folder = self.ground_truth.join(scene).join("env_map");
        let path = folder.join(Path::new(stem).with_extension("exr"));
        if !path.is_file() {
            return Ok(Vec::new());
        }
        let map = match self.read.get(&path) {
            Some(map) => Arc::clone(map),
            None => {
                let (map, said) = EnvMap::read_with_warnings(&path)?;
                let place = format!("{scene}/env_map/{}", stem.to_string_lossy());
                self.warnings
                    .extend(said.iter().map(|text| format!("{place}: {text}")));
                Arc::new(map.at_most(MAP_ROWS).into_owned())
            }
        };
        self.read.insert(path, Arc::clone(&map));
        let light = Environment::oriented(map, camera_aligned(&shot.pose), [1.0; 3]);
        Ok(vec![NamedLight {
            name: scene.to_owned(),
            light: Light::Environment(light),
        }])
    }
}

/// Orientation of a map whose middle column looks along the camera's axis and whose row 0 is the camera's up.
/// Ours has +x in the middle, +y at a quarter and +z in row 0: forward, left and up.
fn camera_aligned(pose: &Mat4) -> Mat3 {
    let axes = Mat3::from_mat4(*pose);
    let [right, down, forward]: [Vec3; 3] = [axes.x_axis, axes.y_axis, axes.z_axis];
    Mat3::from_cols(forward, -right, -down)
}
