//! What every format of posed photographs shares: from files, intrinsics and poses to a [`Scene`].

use super::{Opening, folder_name};
use crate::ball::{Ball, Silhouette, estimate};
use crate::lens::Distortion;
use crate::upright;
use glam::{Mat4, Vec3};
use lumi_core::color::srgb_encode;
use lumi_core::image::{read_mask_with_warnings, read_photograph_with_warnings};
use lumi_core::{
    Camera, DisplayImage, Error, LinearImage, NamedLight, Result, Role, Scene, Similarity, View,
};
use rayon::prelude::*;
use std::collections::HashSet;
use std::path::{Component, Path, PathBuf};

/// Photographs are reduced to this many pixels along their longer side unless [`Opening`] says otherwise: a hundred
/// camera files at full size would fill the memory, and no model sees more.
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
pub(super) struct Stage<'a> {
    pub up: Up,
    pub bounds: Bounds,
    pub opening: &'a Opening,
    /// What the format's reader has to say already.
    pub warnings: Vec<String>,
}

/// The file of a folder of masks that belongs to the photograph called `path`, by the last part of that.
///
/// # Errors
/// Names the mask that is missing.
pub fn mask_in(folder: &Path, path: &str) -> Result<PathBuf> {
    let path = Path::new(path);
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let stem = path.file_stem().unwrap_or_default().to_string_lossy();
    let whole = found(folder, &format!("{name}.png"));
    let mask = whole.or_else(|| image_file(folder, &stem).ok());
    mask.ok_or_else(|| {
        let expected = format!("expected a mask for the photograph `{name}`, found none");
        Error::invalid(folder.join(format!("{stem}.png")), "mask", expected)
    })
}

/// Reads all photographs (in parallel) and makes a scene of them, in a world that is z up.
///
/// # Errors
/// The first shot that cannot be read, by its place in `file`; a ball that is none or cannot be estimated.
pub(super) fn scene(
    folder: &Path,
    file: &Path,
    mut shots: Vec<Shot>,
    stage: Stage,
) -> Result<Scene> {
    if shots.is_empty() {
        return Err(Error::invalid(
            file,
            "frames",
            "expected at least one frame",
        ));
    }
    if let Some(masks) = &stage.opening.masks {
        for shot in &mut shots {
            shot.mask = Some(mask_in(masks, &shot.path)?);
        }
    }
    let longest = stage.opening.longest_side;
    let read: Vec<Result<Loaded>> = shots.par_iter().map(|s| load(s, longest)).collect();
    let mut loaded = Vec::with_capacity(shots.len());
    for (read, shot) in read.into_iter().zip(&shots) {
        loaded.push(read.map_err(|e| e.within(&shot.place).at(file))?);
    }
    let mut warnings = stage.warnings;
    let said = loaded.iter().flat_map(|l| l.warnings.iter());
    warnings.extend(gathered(said));
    warnings.extend(opaque(&mut loaded));
    let coverage: Vec<Coverage> = loaded.iter().map(|l| l.coverage).collect();
    let (mut views, radiance): (Vec<View>, Vec<_>) =
        loaded.into_iter().map(|l| (l.view, l.linear)).unzip();
    tell_apart(&mut views, &shots);
    for (view, coverage) in views.iter().zip(coverage) {
        let text = match coverage {
            Coverage::Part => continue,
            Coverage::Nothing => "covers nothing: the whole picture is background",
            Coverage::Everything => "covers everything: the whole picture is object",
        };
        warnings.push(format!("view `{}`: its mask {text}", view.name));
    }
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
    let ball = match stage.bounds {
        Bounds::Unknown => estimate_ball(&views, &all(&views)).map_err(|e| e.at(folder))?,
        Bounds::Ball(centre, radius) => Ball {
            centre: turn.point(centre),
            radius,
            stray: Vec::new(),
        },
        Bounds::Box(low, high) => ball_in_box(&views, &turn, low, high),
    };
    if !ball.centre.is_finite() {
        let expected = format!("expected finite numbers, found {}", ball.centre);
        return Err(Error::invalid(folder, "bounding_sphere_center", expected));
    }
    if !(ball.radius.is_finite() && ball.radius > 0.0) {
        let expected = format!("expected a positive length, found {}", ball.radius);
        return Err(Error::invalid(folder, "bounding_sphere_radius", expected));
    }
    warnings.extend(ball.stray.iter().map(|i| stray_mask(&views[*i].name)));
    let known = lit_by.iter().any(|lights| !lights.is_empty());
    Ok(Scene {
        name: folder_name(folder),
        views,
        to_model: Similarity::to_unit_ball(ball.centre, ball.radius),
        basis: None,
        lit_by: if known { lit_by } else { Vec::new() },
        radiance: if radiance.iter().any(Option::is_some) {
            radiance
        } else {
            Vec::new()
        },
        warnings,
    })
}

/// What there is to say of a view that is [`crate::ball::stray`].
pub(super) fn stray_mask(view: &str) -> String {
    format!(
        "view `{view}`: its mask contradicts the other views' and does not count for where the object is"
    )
}

/// What files say, `FILE: TEXT`, each text once with the number of files that say it.
fn gathered<'a>(said: impl Iterator<Item = &'a (String, String)>) -> Vec<String> {
    let mut texts: Vec<(&str, &str, usize)> = Vec::new();
    for (file, text) in said {
        match texts.iter_mut().find(|(_, t, _)| t == text) {
            Some((_, _, count)) => *count += 1,
            None => texts.push((file, text, 1)),
        }
    }
    let line = |(file, text, count)| match count {
        1 => format!("{file}: {text}"),
        _ => format!("{file} and {} more: {text}", count - 1),
    };
    texts.into_iter().map(line).collect()
}

/// Alpha that is opaque everywhere in every photograph says nothing: it is dropped, and that is said.
fn opaque(loaded: &mut [Loaded]) -> Option<String> {
    let own = |l: &&mut Loaded| l.own_alpha;
    let count = loaded.iter_mut().filter(own).count();
    let everything = |l: &mut Loaded| l.coverage == Coverage::Everything;
    if count == 0 || !loaded.iter_mut().filter(own).all(everything) {
        return None;
    }
    for one in loaded.iter_mut().filter(own) {
        one.coverage = Coverage::Part;
        if let Some(image) = &mut one.view.image {
            image.alpha = None;
        }
    }
    Some(format!(
        "alpha: opaque everywhere in all {count} photographs that have it, so it is no mask"
    ))
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
    const GUESSES: [&str; 6] = ["", ".png", ".jpg", ".jpeg", ".exr", ".hdr"];
    let mut candidates = GUESSES
        .iter()
        .filter_map(|g| found(folder, &format!("{name}{g}")));
    candidates.next().ok_or_else(|| {
        let expected = format!(
            "expected an image at {} (or with .png, .jpg, .exr)",
            folder.join(name).display()
        );
        Error::value("file_path", expected)
    })
}

/// The file that is called `name` below `folder`: exactly, else with `\` for `/`, else in other capitals.
pub(super) fn found(folder: &Path, name: &str) -> Option<PathBuf> {
    let exact = folder.join(name);
    if exact.is_file() {
        return Some(exact);
    }
    let slashed = name.replace('\\', "/");
    let mut path = folder.to_owned();
    for part in Path::new(&slashed).components() {
        match part {
            Component::Normal(part) if !path.join(part).exists() => {
                let wanted = part.to_string_lossy().to_lowercase();
                let entries = std::fs::read_dir(&path)
                    .ok()?
                    .filter_map(|e| Some(e.ok()?.path()));
                let same = |p: &PathBuf| {
                    p.file_name()
                        .is_some_and(|n| n.to_string_lossy().to_lowercase() == wanted)
                };
                path = entries.filter(same).min()?;
            }
            part => path.push(part),
        }
    }
    path.is_file().then_some(path)
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

/// A photograph that was read.
struct Loaded {
    view: View,
    /// What [`Scene::radiance`] keeps.
    linear: Option<LinearImage>,
    coverage: Coverage,
    /// Whether coverage is the photograph's own alpha.
    own_alpha: bool,
    /// Files and what there is to say of them.
    warnings: Vec<(String, String)>,
}

/// How much of a picture a mask covers; without a mask, [`Coverage::Part`].
#[derive(Clone, Copy, PartialEq)]
enum Coverage {
    Nothing,
    Part,
    Everything,
}

impl Coverage {
    fn of(alpha: Option<&[f32]>) -> Self {
        match alpha {
            Some(a) if a.iter().all(|a| *a <= 0.0) => Self::Nothing,
            Some(a) if a.iter().all(|a| *a >= 1.0) => Self::Everything,
            _ => Self::Part,
        }
    }
}

/// Read, decode, undistort, mask, reduce to `longest` pixels.
fn load(shot: &Shot, longest: usize) -> Result<Loaded> {
    let read = read_photograph_with_warnings(&shot.image)?;
    let (mut image, linear) = (read.shown, read.linear);
    let of = |path: &str, texts: Vec<String>| -> Vec<(String, String)> {
        texts
            .into_iter()
            .map(|text| (path.to_owned(), text))
            .collect()
    };
    let mut warnings = of(&shot.path, read.warnings);
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
    if let Some(path) = &shot.mask {
        let (mask, said) = read_mask_with_warnings(path)?;
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        warnings.extend(of(&format!("mask {name}"), said));
        image = masked(&image, &mask).map_err(|e| e.at(path))?;
        if let (Some(linear), Some(alpha)) = (&mut linear, &image.alpha) {
            for (pixel, a) in linear.pixels.iter_mut().zip(alpha) {
                let own = if pixel[3] > 0.0 { pixel[3] } else { 1.0 };
                *pixel = [0, 1, 2, 3].map(|c| pixel[c] / own * a);
                pixel[3] = *a;
            }
        }
    }
    let coverage = Coverage::of(image.alpha.as_deref());
    if !shot.intrinsics.distortion.is_none() {
        image = shot.intrinsics.distortion.undistort(&camera, &image)?;
    }
    let longer = image.width.max(image.height);
    if longer > longest {
        let side = |s: usize| (s * longest).div_ceil(longer);
        let (width, height) = (side(image.width), side(image.height));
        image = image.resized(width, height);
        linear = linear.map(|l| l.resized(width, height));
        camera = camera.resized(width, height);
    }
    let name = Path::new(&shot.path).file_stem();
    let own_alpha = shot.mask.is_none() && image.alpha.is_some();
    let view = View {
        name: name.map_or_else(|| "view".to_owned(), |n| n.to_string_lossy().into_owned()),
        role: shot.role,
        camera,
        image: Some(image),
    };
    Ok(Loaded {
        view,
        linear,
        coverage,
        own_alpha,
        warnings,
    })
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
        return Err(Error::value("mask", expected));
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
fn ball_in_box(views: &[View], turn: &Similarity, low: Vec3, high: Vec3) -> Ball {
    let (centre, radius) = (turn.point(0.5 * (low + high)), 0.5 * low.distance(high));
    let masked = |i: &usize| {
        let image = views[*i].image.as_ref();
        views[*i].role == Role::Input && image.is_some_and(|i| i.alpha.is_some())
    };
    let masked: Vec<usize> = all(views).into_iter().filter(masked).collect();
    match estimate_ball(views, &masked) {
        Ok(ball) if ball.centre.distance(centre) + ball.radius <= radius => ball,
        _ => Ball {
            centre,
            radius,
            stray: Vec::new(),
        },
    }
}

fn all(views: &[View]) -> Vec<usize> {
    (0..views.len()).collect()
}

/// The ball that these of the views show; strays are indices of `views`.
fn estimate_ball(views: &[View], these: &[usize]) -> Result<Ball> {
    let silhouettes: Vec<_> = these
        .iter()
        .map(|&i| Silhouette {
            camera: &views[i].camera,
            alpha: views[i].image.as_ref().and_then(|i| i.alpha.as_deref()),
        })
        .collect();
    let mut ball = estimate(&silhouettes)?;
    ball.stray.iter_mut().for_each(|i| *i = these[*i]);
    Ok(ball)
}
