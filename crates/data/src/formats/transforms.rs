//! nerfstudio's and Blender's `transforms.json`: photographs with OpenGL camera-to-world poses.
//!
//! * Intrinsics: `fl_x`, `fl_y`, `cx`, `cy`, `w`, `h` or `camera_angle_x`, `camera_angle_y`, once for
//!   all frames or per frame (which wins). Lens distortion is not supported yet and is an error.
//! * Coverage: PNG alpha, or an image named by `mask_path` (white is the object).
//! * Roles: `transforms_train.json` + `transforms_test.json`, or `train_filenames` and
//!   `test_filenames`/`val_filenames`; else every eighth frame is held out if there are nine or more.
//! * Bounding ball: `bounding_sphere_center` and `bounding_sphere_radius` (ours), else estimated ([`crate::ball`]).

use super::folder_name;
use crate::ball::{Silhouette, estimate};
use crate::json;
use glam::{Mat4, Vec3};
use lumi_core::camera::opengl_to_opencv;
use lumi_core::image::{read_display, read_mask};
use lumi_core::{Camera, DisplayImage, Error, Result, Role, Scene, Similarity, View};
use serde::Deserialize;
use std::collections::HashSet;
use std::path::{Path, PathBuf};

/// One frame in this many is held out where a file names no roles.
const HOLD_OUT: usize = 8;

/// Files that hold frames, and the role that the file's name gives to them.
const FILES: [(&str, Option<Role>); 4] = [
    ("transforms.json", None),
    ("transforms_train.json", Some(Role::Input)),
    ("transforms_val.json", None),
    ("transforms_test.json", Some(Role::Target)),
];

#[derive(Deserialize)]
struct TransformsFile {
    #[serde(flatten)]
    lens: Lens,
    frames: Vec<Frame>,
    train_filenames: Option<Vec<String>>,
    test_filenames: Option<Vec<String>>,
    val_filenames: Option<Vec<String>>,
    bounding_sphere_center: Option<[f32; 3]>,
    bounding_sphere_radius: Option<f32>,
}

#[derive(Deserialize)]
struct Frame {
    file_path: String,
    mask_path: Option<String>,
    transform_matrix: Vec<Vec<f64>>,
    #[serde(flatten)]
    lens: Lens,
}

/// What describes the lens, in the file's head or in a frame.
#[derive(Deserialize)]
struct Lens {
    camera_model: Option<String>,
    camera_angle_x: Option<f64>,
    camera_angle_y: Option<f64>,
    fl_x: Option<f64>,
    fl_y: Option<f64>,
    cx: Option<f64>,
    cy: Option<f64>,
    w: Option<f64>,
    h: Option<f64>,
    k1: Option<f64>,
    k2: Option<f64>,
    k3: Option<f64>,
    k4: Option<f64>,
    p1: Option<f64>,
    p2: Option<f64>,
    is_fisheye: Option<bool>,
}

/// Whether `folder` holds a `transforms.json` or `transforms_train.json`.
#[must_use]
pub fn detect(folder: &Path) -> bool {
    FILES[..2]
        .iter()
        .any(|(name, _)| folder.join(name).is_file())
}

/// Reads all frames and their images.
///
/// # Errors
/// Names the file and the frame or field that is missing or wrong.
pub fn open(folder: &Path) -> Result<Scene> {
    let single = folder.join(FILES[0].0).is_file();
    let files = if single { &FILES[..1] } else { &FILES[1..] };
    let (mut views, mut ball) = (Vec::new(), None);
    for &(name, role) in files.iter().filter(|(name, _)| folder.join(name).is_file()) {
        let path = folder.join(name);
        let file: TransformsFile = json::read(&path)?;
        for (i, frame) in file.frames.iter().enumerate() {
            let place = format!("frames[{i}] `{}`", frame.file_path);
            let role = role.unwrap_or_else(|| role_of(&file, i));
            let view = view(folder, &file.lens, frame, role);
            views.push(view.map_err(|e| e.within(place).at(&path))?);
        }
        ball = ball.or(file.bounding_sphere_radius.map(|radius| {
            (
                Vec3::from(file.bounding_sphere_center.unwrap_or_default()),
                radius,
            )
        }));
    }
    if views.is_empty() {
        let expected = "expected at least one frame";
        return Err(Error::invalid(folder.join(files[0].0), "frames", expected));
    }
    tell_apart(&mut views);
    let (centre, radius) = match ball {
        Some(ball) => ball,
        None => estimate_ball(&views).map_err(|e| e.at(folder))?,
    };
    if !(centre.is_finite() && radius.is_finite() && radius > 0.0) {
        let expected = format!("expected a positive length, found {radius}");
        return Err(Error::invalid(folder, "bounding_sphere_radius", expected));
    }
    Ok(Scene {
        name: folder_name(folder),
        views: views.into_iter().map(|(_, view)| view).collect(),
        to_model: Similarity::to_unit_ball(centre, radius),
        basis: None,
    })
}

fn role_of(file: &TransformsFile, index: usize) -> Role {
    let named = |list: &Option<Vec<String>>| {
        list.as_ref()
            .is_some_and(|l| l.contains(&file.frames[index].file_path))
    };
    let listed = file.train_filenames.is_some() || file.test_filenames.is_some();
    let held_out = if listed {
        let tested = named(&file.test_filenames) || named(&file.val_filenames);
        tested || (file.test_filenames.is_none() && !named(&file.train_filenames))
    } else {
        file.frames.len() > HOLD_OUT && index % HOLD_OUT == HOLD_OUT - 1
    };
    if held_out { Role::Target } else { Role::Input }
}

/// A frame as a view, together with its `file_path`.
fn view(folder: &Path, head: &Lens, frame: &Frame, role: Role) -> Result<(String, View)> {
    for lens in [head, &frame.lens] {
        check_lens(lens)?;
    }
    let mut image = read_display(image_file(folder, &frame.file_path)?)?;
    if let Some(mask) = &frame.mask_path {
        image = masked(&image, &read_mask(folder.join(mask))?)?;
    }
    let camera = camera(head, &frame.lens, &image, pose(&frame.transform_matrix)?)?;
    camera.validate()?;
    let name = Path::new(&frame.file_path).file_stem();
    let name = name.map_or_else(|| "view".to_owned(), |n| n.to_string_lossy().into_owned());
    let view = View {
        name,
        role,
        camera,
        image: Some(image),
    };
    Ok((frame.file_path.clone(), view))
}

/// The image of a frame, whose extension may be left out.
fn image_file(folder: &Path, file_path: &str) -> Result<PathBuf> {
    let exact = folder.join(file_path);
    let with = |extension: &&str| folder.join(format!("{file_path}.{extension}"));
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

fn check_lens(lens: &Lens) -> Result<()> {
    let coefficients = [
        ("k1", lens.k1),
        ("k2", lens.k2),
        ("k3", lens.k3),
        ("k4", lens.k4),
        ("p1", lens.p1),
        ("p2", lens.p2),
    ];
    for (field, value) in coefficients {
        if let Some(value) = value.filter(|v| *v != 0.0) {
            let expected =
                format!("expected undistorted images (0), found {value}; undistort them first");
            return Err(Error::value(field, expected));
        }
    }
    let model = lens.camera_model.as_deref();
    // OPENCV without coefficients is a pinhole.
    let pinhole = [
        "PINHOLE",
        "SIMPLE_PINHOLE",
        "OPENCV",
        "SIMPLE_RADIAL",
        "RADIAL",
        "perspective",
    ];
    if let Some(model) = model.filter(|m| !pinhole.contains(m)) {
        let expected = format!("expected a pinhole camera, found `{model}`");
        return Err(Error::value("camera_model", expected));
    }
    if lens.is_fisheye == Some(true) {
        return Err(Error::value(
            "is_fisheye",
            "expected a pinhole camera, found a fisheye",
        ));
    }
    Ok(())
}

/// Intrinsics from the frame, else from the head, for the image as it is stored.
fn camera(head: &Lens, own: &Lens, image: &DisplayImage, pose: Mat4) -> Result<Camera> {
    let get = |field: fn(&Lens) -> Option<f64>| field(own).or_else(|| field(head));
    let (width, height) = (image.width as f64, image.height as f64);
    for (field, stated, found) in [("w", get(|l| l.w), width), ("h", get(|l| l.h), height)] {
        if let Some(stated) = stated.filter(|s| *s != found) {
            let expected = format!("expected an image of {stated} pixels as stated, found {found}");
            return Err(Error::value(field, expected));
        }
    }
    let focal = |side: f64, angle: Option<f64>| angle.map(|a| 0.5 * side / (0.5 * a).tan());
    let fx = get(|l| l.fl_x).or_else(|| focal(width, get(|l| l.camera_angle_x)));
    let fy = get(|l| l.fl_y).or_else(|| focal(height, get(|l| l.camera_angle_y)));
    let Some((fx, fy)) = fx.or(fy).zip(fy.or(fx)) else {
        return Err(Error::value(
            "fl_x",
            "expected fl_x or camera_angle_x in the frame or the file's head",
        ));
    };
    Ok(Camera {
        width: image.width,
        height: image.height,
        fx: fx as f32,
        fy: fy as f32,
        cx: get(|l| l.cx).unwrap_or(0.5 * width) as f32,
        cy: get(|l| l.cy).unwrap_or(0.5 * height) as f32,
        camera_to_world: pose,
    })
}

/// A 3×4 or 4×4 OpenGL matrix as an OpenCV pose.
fn pose(stored: &[Vec<f64>]) -> Result<Mat4> {
    let full = (3..=4).contains(&stored.len()) && stored.iter().all(|row| row.len() == 4);
    if !full {
        return Err(Error::value(
            "transform_matrix",
            "expected 4 rows of 4 numbers",
        ));
    }
    let mut rows: json::Rows = [[0.0, 0.0, 0.0, 1.0]; 4];
    for (row, stored) in rows.iter_mut().zip(stored) {
        row.copy_from_slice(stored);
    }
    Ok(opengl_to_opencv(json::matrix(&rows)))
}

/// `image` over white by `mask`'s coverage.
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
fn tell_apart(views: &mut [(String, View)]) {
    let distinct: HashSet<_> = views.iter().map(|(_, v)| v.name.clone()).collect();
    if distinct.len() < views.len() {
        for (path, view) in views {
            view.name = path.trim_start_matches("./").replace(['/', '\\'], "_");
        }
    }
}

fn estimate_ball(views: &[(String, View)]) -> Result<(Vec3, f32)> {
    let silhouettes: Vec<_> = views
        .iter()
        .map(|(_, v)| Silhouette {
            camera: &v.camera,
            alpha: v.image.as_ref().and_then(|i| i.alpha.as_deref()),
        })
        .collect();
    estimate(&silhouettes)
}
