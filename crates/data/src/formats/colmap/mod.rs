//! COLMAP's sparse models, text and binary: photographs with poses from structure from motion.
//!
//! * Layout: `images/` beside `sparse/` or `colmap/sparse/`, with models in it or in folders of it (`0`, `1`, …); or
//!   the model's files in the folder itself. A model is `cameras` and `images`, both `.bin` or both `.txt`; binary
//!   wins where both are there. Points are not read. Of several models that with the most images is taken, and the
//!   others are told of. Names may be in capitals. A folder `sparse` or `colmap` may be opened by itself: its images
//!   are then looked for beside it.
//! * Cameras: SIMPLE_PINHOLE, PINHOLE, SIMPLE_RADIAL, RADIAL and OPENCV; lenses are removed by resampling
//!   ([`crate::lens`]). Pixel centres are at +0.5, as ours.
//! * Poses are stored world-to-camera, as a unit quaternion (w first) and a translation, in OpenCV axes.
//! * Coverage: `masks/IMAGE.png` (COLMAP's own rule: the image's whole name, then `.png`) or
//!   `masks/STEM.png`, else the image's alpha.
//! * Roles: every eighth image by name is held out if there are nine or more.
//! * Up is estimated from the cameras ([`crate::upright`]), for the model's own world has any orientation.
//! * Where a `transforms.json` stands in the same folder, that is read instead: it was made from the model.
//!
//! Source: COLMAP's documentation, "Output Format" and "Camera Models".

pub(crate) mod binary;
pub(crate) mod text;

mod place;

use super::Opening;
use super::photo::{
    self, Bounds, Encoding, Intrinsics, Shot, Stage, Up, found, image_file, usual_role,
};
use crate::lens::Distortion;
use glam::{DMat4, DQuat, DVec3, Mat4};
use lumi_core::{Error, Result, Scene};
use std::collections::BTreeMap;
use std::path::{Component, Path, PathBuf};

/// A camera of the model.
#[derive(Clone, Debug)]
pub(crate) struct ModelCamera {
    pub model: CameraModel,
    pub width: u64,
    pub height: u64,
    pub params: Vec<f64>,
}

/// An image of the model.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct ModelImage {
    /// w, x, y, z.
    pub rotation: [f64; 4],
    pub translation: [f64; 3],
    pub camera: u32,
    pub name: String,
}

/// A sparse model without its points.
pub(crate) struct Model {
    pub cameras: BTreeMap<u32, ModelCamera>,
    pub images: Vec<ModelImage>,
}

/// The camera models that are pinholes behind a polynomial lens.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum CameraModel {
    SimplePinhole,
    Pinhole,
    SimpleRadial,
    Radial,
    OpenCv,
}

impl CameraModel {
    /// COLMAP's number, name and count of parameters of each model that we know.
    const TABLE: [(u32, &'static str, usize, Self); 5] = [
        (0, "SIMPLE_PINHOLE", 3, Self::SimplePinhole),
        (1, "PINHOLE", 4, Self::Pinhole),
        (2, "SIMPLE_RADIAL", 4, Self::SimpleRadial),
        (3, "RADIAL", 5, Self::Radial),
        (4, "OPENCV", 8, Self::OpenCv),
    ];

    fn by_number(number: u32) -> Result<Self> {
        let row = Self::TABLE.iter().find(|row| row.0 == number);
        row.map(|row| row.3)
            .ok_or_else(|| unknown(&format!("number {number}")))
    }

    fn by_name(name: &str) -> Result<Self> {
        let row = Self::TABLE.iter().find(|row| row.1 == name);
        row.map(|row| row.3).ok_or_else(|| unknown(name))
    }

    fn parameters(self) -> usize {
        let row = Self::TABLE.iter().find(|row| row.3 == self);
        row.map_or(0, |row| row.2)
    }
}

fn unknown(found: &str) -> Error {
    let known: Vec<_> = CameraModel::TABLE.iter().map(|row| row.1).collect();
    let expected = format!(
        "expected one of {}, found {found}; run COLMAP's image_undistorter",
        known.join(", ")
    );
    Error::value("camera model", expected)
}

/// Whether `folder` holds a model and no `transforms.json`.
#[must_use]
pub fn detect(folder: &Path) -> bool {
    !place::models(folder).is_empty() && !super::transforms::detect(folder)
}

/// Reads the largest model and its images.
///
/// # Errors
/// Names the file and the camera, image or line that is missing or wrong.
pub fn open(folder: &Path, opening: &Opening) -> Result<Scene> {
    let mut warnings = Vec::new();
    let Some(files) = place::largest(folder, &mut warnings) else {
        let expected =
            "expected cameras.bin and images.bin, or both as .txt, below sparse/ or colmap/sparse/";
        return Err(Error::invalid(folder, "model", expected));
    };
    let mut model = files.read()?;
    model.images.sort_by(|a, b| a.name.cmp(&b.name));
    for image in &mut model.images {
        image.name = image.name.replace('\\', "/");
    }
    let pictures = place::pictures(folder, model.images.first().map(|i| i.name.as_str()));
    let count = model.images.len();
    let mut shots = Vec::with_capacity(count);
    for (i, image) in model.images.iter().enumerate() {
        let place = format!("image `{}`", image.name);
        let shot = shot(&pictures, &model, image);
        let mut shot = shot.map_err(|e| e.within(&place).at(&files.images))?;
        shot.place = place;
        shot.role = usual_role(i, count);
        shots.push(shot);
    }
    let stage = Stage {
        up: Up::FromCameras,
        bounds: Bounds::Unknown,
        opening,
        warnings,
    };
    photo::scene(folder, &files.images, shots, stage)
}

fn shot(pictures: &Path, model: &Model, image: &ModelImage) -> Result<Shot> {
    let camera = model.cameras.get(&image.camera).ok_or_else(|| {
        let expected = format!("expected a camera of the model, found {}", image.camera);
        Error::value("camera id", expected)
    })?;
    // COLMAP names images below its image folder; anything else would read files that are not the capture's.
    let plain = |c| matches!(c, Component::Normal(_) | Component::CurDir);
    if !Path::new(&image.name).components().all(plain) {
        let expected = "expected a path below the folder of images";
        return Err(Error::value("name", expected));
    }
    let file = image_file(pictures, &image.name)?;
    Ok(Shot {
        place: String::new(),
        path: image.name.clone(),
        role: lumi_core::Role::Input,
        image: file,
        mask: mask_file(pictures, &image.name),
        intrinsics: intrinsics(camera)?,
        pose: pose(image)?,
        encoding: Encoding::Srgb,
        lit_by: Vec::new(),
    })
}

/// The mask of an image, where there is one: in `masks/` beside the folder `images`, or in the folder of images.
fn mask_file(pictures: &Path, name: &str) -> Option<PathBuf> {
    let beside = pictures
        .file_name()
        .is_some_and(|n| n.eq_ignore_ascii_case("images"));
    let capture = pictures.parent().filter(|_| beside).unwrap_or(pictures);
    let stem = Path::new(name).with_extension("png");
    let names = [format!("{name}.png"), stem.to_string_lossy().into_owned()];
    names
        .iter()
        .find_map(|name| found(&capture.join("masks"), name))
}

fn intrinsics(camera: &ModelCamera) -> Result<Intrinsics> {
    let p = &camera.params;
    if p.len() != camera.model.parameters() || !p.iter().all(|v| v.is_finite()) {
        let expected = format!(
            "expected {} finite parameters of a {:?} camera, found {p:?}",
            camera.model.parameters(),
            camera.model
        );
        return Err(Error::value("camera", expected));
    }
    let (focal, centre, lens) = match camera.model {
        CameraModel::Pinhole | CameraModel::OpenCv => ([p[0], p[1]], [p[2], p[3]], &p[4..]),
        _ => ([p[0]; 2], [p[1], p[2]], &p[3..]),
    };
    let coefficient = |i: usize| lens.get(i).copied().unwrap_or(0.0);
    Ok(Intrinsics {
        size: [Some(camera.width as f64), Some(camera.height as f64)],
        focal: focal.map(Some),
        centre: centre.map(Some),
        angle: [None; 2],
        distortion: Distortion {
            radial: [coefficient(0), coefficient(1), 0.0, 0.0],
            tangential: [coefficient(2), coefficient(3)],
        },
    })
}

/// World-to-camera quaternion and translation as a camera-to-world matrix.
fn pose(image: &ModelImage) -> Result<Mat4> {
    let [w, x, y, z] = image.rotation;
    let rotation = DQuat::from_xyzw(x, y, z, w);
    let length = rotation.length();
    if !(length - 1.0).abs().le(&0.01) {
        let expected = format!("expected a unit quaternion, found one of length {length}");
        return Err(Error::value("rotation", expected));
    }
    let to_camera = DMat4::from_rotation_translation(
        rotation.normalize(),
        DVec3::from_array(image.translation),
    );
    Ok(to_camera.inverse().as_mat4())
}
