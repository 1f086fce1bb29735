//! What every format of posed photographs shares: from files, intrinsics and poses to a [`Scene`].

use super::folder_name;
use crate::ball::{Silhouette, estimate};
use crate::lens::Distortion;
use crate::upright;
use glam::{Mat4, Vec3};
use lumi_core::color::srgb_encode;
use lumi_core::image::{read_mask, read_photograph};
use lumi_core::{
    Camera, DisplayImage, Error, LinearImage, NamedLight, Result, Role, Scene, Similarity, View,
};
use rayon::prelude::*;
use std::collections::HashSet;
use std::path::{Path, PathBuf};

/// Photographs are reduced to this many pixels along their longer side when they are read, cameras with
/// them: a hundred camera files at full size would fill the memory, and no model sees more.
pub const LONGEST_SIDE: usize = 1024;

/// One frame in this many is held out where a capture names no roles and has more frames than that.
const HOLD_OUT: usize = 8;

/// A photograph that is not read yet.
pub(super) struct Shot {
    /// Where it stands in which file, for messages.
    pub place: String,
    /// Its path as the format gives it; views are named after its stem.
    pub path: String,
    pub role: Role,
    pub image: PathBuf,
    /// Coverage in a file of its own; the image's own alpha otherwise.
    pub mask: Option<PathBuf>,
    pub intrinsics: Intrinsics,
    /// OpenCV camera-to-world.
    pub pose: Mat4,
    pub encoding: Encoding,
    pub lit_by: Vec<NamedLight>,
}

/// How 8-bit files encode light.
#[derive(Clone, Copy)]
pub(super) enum Encoding {
    Srgb,
    /// A power of 1/γ.
    Gamma(f32),
}

/// Intrinsics as files state them; [`Intrinsics::camera`] needs the image's size.
#[derive(Clone, Copy, Default)]
pub(super) struct Intrinsics {
    /// Stated width and height in pixels.
    pub size: [Option<f64>; 2],
    /// Focal lengths in pixels.
    pub focal: [Option<f64>; 2],
    /// Full fields of view in radians, where there is no focal length.
    pub angle: [Option<f64>; 2],
    /// Principal point in pixels; the middle otherwise.
    pub centre: [Option<f64>; 2],
    pub distortion: Distortion,
}

/// Which way is up in a format's world.
pub(super) enum Up {
    /// +z, as the format says.
    Z,
    /// This direction.
    Along(Vec3),
    /// Nobody says; see [`upright::levelling`].
    FromCameras,
}

/// What a format says of where the object is.
pub(super) enum Bounds {
    /// Nothing: its ball is estimated from masks and cameras.
    Unknown,
    /// Centre and radius of its ball.
    Ball(Vec3, f32),
    /// Corners of a box around it, not tight: masks may know better.
    Box(Vec3, Vec3),
}

/// What a format knows of the scene as a whole.
pub(super) struct Stage {
    pub up: Up,
    pub bounds: Bounds,
}

/// Reads all photographs (in parallel) and makes a scene of them, in a world that is z up.
///
/// # Errors
/// The first shot that cannot be read, by its place in `file`; a ball that is none or cannot be estimated.
pub(super) fn scene(folder: &Path, file: &Path, shots: Vec<Shot>, stage: &Stage) -> Result<Scene> {
    if shots.is_empty() {
        return Err(Error::invalid(
            file,
            "frames",
            "expected at least one frame",
        ));
    }
    let read: Vec<Result<(View, Option<LinearImage>)>> = shots.par_iter().map(load).collect();
    let mut views = Vec::with_capacity(shots.len());
    let mut radiance = Vec::with_capacity(shots.len());
    for (loaded, shot) in read.into_iter().zip(&shots) {
        let (view, linear) = loaded.map_err(|e| e.within(&shot.place).at(file))?;
        views.push(view);
        radiance.push(linear);
    }
    tell_apart(&mut views, &shots);
    let cameras: Vec<Camera> = views.iter().map(|v| v.camera).collect();
    let turn = match stage.up {
        Up::Z => Similarity::IDENTITY,
        Up::Along(up) => upright::turning_to_z(up),
        Up::FromCameras => upright::levelling(&cameras),
    };
    for view in &mut views {
        view.camera = view.camera.transformed(&turn);
    }
    let lit_by: Vec<Vec<NamedLight>> = shots.iter().map(|s| lights(s, &turn)).collect();
    let (centre, radius) = match stage.bounds {
        Bounds::Unknown => estimate_ball(&views).map_err(|e| e.at(folder))?,
        Bounds::Ball(centre, radius) => (turn.point(centre), radius),
        Bounds::Box(low, high) => ball_in_box(&views, &turn, low, high),
    };
    if !(centre.is_finite() && radius.is_finite() && radius > 0.0) {
        let expected = format!("expected a positive length, found {radius}");
        return Err(Error::invalid(folder, "bounding_sphere_radius", expected));
    }
    let known = lit_by.iter().any(|lights| !lights.is_empty());
    Ok(Scene {
        name: folder_name(folder),
        views,
        to_model: Similarity::to_unit_ball(centre, radius),
        basis: None,
        lit_by: if known { lit_by } else { Vec::new() },
        radiance: if radiance.iter().any(Option::is_some) {
            radiance
        } else {
            Vec::new()
        },
    })
}

/// Every eighth frame is held out if there are nine or more.
pub(super) fn usual_role(index: usize, frames: usize) -> Role {
    if frames > HOLD_OUT && index % HOLD_OUT == HOLD_OUT - 1 {
        Role::Target
    } else {
        Role::Input
    }
}

/// The image that a file calls `name`, whose extension may be left out.
pub(super) fn image_file(folder: &Path, name: &str) -> Result<PathBuf> {
    let exact = folder.join(name);
    let with = |extension: &&str| folder.join(format!("{name}.{extension}"));
    let guesses = ["png", "jpg", "jpeg", "PNG", "JPG", "exr"];
    let mut candidates = std::iter::once(exact.clone()).chain(guesses.iter().map(with));
    candidates.find(|p| p.is_file()).ok_or_else(|| {
        let expected = format!(
            "expected an image at {} (or with .png, .jpg, .exr)",
            exact.display()
        );
        Error::value("file_path", expected)
    })
}

impl Intrinsics {
    /// The pinhole for an image of this size.
    pub fn camera(&self, width: usize, height: usize, pose: Mat4) -> Result<Camera> {
        let found = [width as f64, height as f64];
        for (i, field) in ["w", "h"].into_iter().enumerate() {
            if let Some(stated) = self.size[i].filter(|s| *s != found[i]) {
                let expected = format!(
                    "expected an image of {stated} pixels as stated, found {}",
                    found[i]
                );
                return Err(Error::value(field, expected));
            }
        }
        let from_angle = |i: usize| self.angle[i].map(|a| 0.5 * found[i] / (0.5 * a).tan());
        let fx = self.focal[0].or_else(|| from_angle(0));
        let fy = self.focal[1].or_else(|| from_angle(1));
        let Some((fx, fy)) = fx.or(fy).zip(fy.or(fx)) else {
            let expected = "expected fl_x or camera_angle_x in the frame or the file's head";
            return Err(Error::value("fl_x", expected));
        };
        let camera = Camera {
            width,
            height,
            fx: fx as f32,
            fy: fy as f32,
            cx: self.centre[0].unwrap_or(0.5 * found[0]) as f32,
            cy: self.centre[1].unwrap_or(0.5 * found[1]) as f32,
            camera_to_world: pose,
        };
        camera.validate()?;
        Ok(camera)
    }
}

/// Read, decode, undistort, mask, reduce. The second image is what [`Scene::radiance`] keeps.
fn load(shot: &Shot) -> Result<(View, Option<LinearImage>)> {
    let (mut image, linear) = read_photograph(&shot.image)?;
    let compared = shot.role == Role::Target && !shot.lit_by.is_empty();
    // No format whose light is known has lenses to undo.
    let mut linear = linear.filter(|_| compared && shot.intrinsics.distortion.is_none());
    if let Encoding::Gamma(gamma) = shot.encoding {
        let encode = |v: f32| srgb_encode(v.powf(gamma));
        image.pixels.iter_mut().for_each(|p| *p = p.map(encode));
    }
    let mut camera = shot
        .intrinsics
        .camera(image.width, image.height, shot.pose)?;
    if let Some(mask) = &shot.mask {
        image = masked(&image, &read_mask(mask)?)?;
        if let (Some(linear), Some(alpha)) = (&mut linear, &image.alpha) {
            for (pixel, a) in linear.pixels.iter_mut().zip(alpha) {
                let own = if pixel[3] > 0.0 { pixel[3] } else { 1.0 };
                *pixel = [0, 1, 2, 3].map(|c| pixel[c] / own * a);
                pixel[3] = *a;
            }
        }
    }
    if !shot.intrinsics.distortion.is_none() {
        image = shot.intrinsics.distortion.undistort(&camera, &image)?;
    }
    let longer = image.width.max(image.height);
    if longer > LONGEST_SIDE {
        let side = |s: usize| (s * LONGEST_SIDE).div_ceil(longer);
        let (width, height) = (side(image.width), side(image.height));
        image = image.resized(width, height);
        linear = linear.map(|l| l.resized(width, height));
        camera = camera.resized(width, height);
    }
    let name = Path::new(&shot.path).file_stem();
    let view = View {
        name: name.map_or_else(|| "view".to_owned(), |n| n.to_string_lossy().into_owned()),
        role: shot.role,
        camera,
        image: Some(image),
    };
    Ok((view, linear))
}

fn lights(shot: &Shot, turn: &Similarity) -> Vec<NamedLight> {
    let turned = |l: &NamedLight| NamedLight {
        name: l.name.clone(),
        light: l.light.transformed(turn),
    };
    shot.lit_by.iter().map(turned).collect()
}

/// `image` over white by `mask`'s coverage. An alpha of the image's own is replaced.
fn masked(image: &DisplayImage, mask: &DisplayImage) -> Result<DisplayImage> {
    if (image.width, image.height) != (mask.width, mask.height) {
        let expected = format!(
            "expected {}×{} pixels as the image, found {}×{}",
            image.width, image.height, mask.width, mask.height
        );
        return Err(Error::value("mask_path", expected));
    }
    let alpha = mask.alpha.clone().unwrap_or_default();
    let over = |(p, a): (&[f32; 3], &f32)| p.map(|v| v * a + 1.0 - a);
    Ok(DisplayImage {
        pixels: image.pixels.iter().zip(&alpha).map(over).collect(),
        alpha: Some(alpha),
        ..*image
    })
}

/// Where file stems repeat (`left/000.png`, `right/000.png`), names become whole paths.
fn tell_apart(views: &mut [View], shots: &[Shot]) {
    let distinct: HashSet<_> = views.iter().map(|v| v.name.clone()).collect();
    if distinct.len() < views.len() {
        for (view, shot) in views.iter_mut().zip(shots) {
            view.name = shot
                .path
                .trim_start_matches("./")
                .trim_start_matches("../")
                .replace(['/', '\\'], "_");
        }
    }
}

/// The ball that the masks show, where it is inside the box's own; else that, which may be 1.7 times as large as the
/// object, and the model takes the object to fill it.
fn ball_in_box(views: &[View], turn: &Similarity, low: Vec3, high: Vec3) -> (Vec3, f32) {
    let (centre, radius) = (turn.point(0.5 * (low + high)), 0.5 * low.distance(high));
    let masked = |v: &&View| v.image.as_ref().is_some_and(|i| i.alpha.is_some());
    let inputs = views.iter().filter(|v| v.role == Role::Input);
    let masked: Vec<&View> = inputs.filter(masked).collect();
    match estimate_ball(masked) {
        Ok((c, r)) if c.distance(centre) + r <= radius => (c, r),
        _ => (centre, radius),
    }
}

fn estimate_ball<'a>(views: impl IntoIterator<Item = &'a View>) -> Result<(Vec3, f32)> {
    let silhouettes: Vec<_> = views
        .into_iter()
        .map(|v| Silhouette {
            camera: &v.camera,
            alpha: v.image.as_ref().and_then(|i| i.alpha.as_deref()),
        })
        .collect();
    estimate(&silhouettes)
}
