//! From `transforms.json` to a scene.

use super::{FILES, Frame, Lens, TransformsFile, splits};
use crate::formats::Opening;
use crate::formats::photo::{
    self, Bounds, Encoding, Intrinsics, Shot, Stage, Up, found, image_file,
};
use crate::json;
use crate::lens::Distortion;
use glam::{Mat4, Vec3};
use lumi_core::camera::opengl_to_opencv;
use lumi_core::{Error, Result, Role, Scene};
use std::path::Path;

/// Camera models whose lens the coefficients describe; without coefficients all of them are pinholes.
const PINHOLES: [&str; 6] = [
    "PINHOLE",
    "SIMPLE_PINHOLE",
    "OPENCV",
    "SIMPLE_RADIAL",
    "RADIAL",
    "perspective",
];

/// Reads all frames and their images.
///
/// # Errors
/// Names the file and the frame or field that is missing or wrong.
pub fn open(folder: &Path, opening: &Opening) -> Result<Scene> {
    let single = folder.join(FILES[0].0).is_file();
    let files = if single { &FILES[..1] } else { &FILES[1..] };
    let (mut shots, mut ball, mut up) = (Vec::new(), None, Up::FromCameras);
    let mut warnings = Vec::new();
    for &(name, role) in files.iter().filter(|(name, _)| folder.join(name).is_file()) {
        let path = folder.join(name);
        let file = parse(&path)?;
        check_applied(&file).map_err(|e| e.at(&path))?;
        let roles = match role {
            Some(role) => vec![Some(role); file.frames.len()],
            None => splits::roles(&file, &mut warnings).map_err(|e| e.at(&path))?,
        };
        for (i, (frame, role)) in file.frames.iter().zip(roles).enumerate() {
            let Some(role) = role else { continue };
            let shot = image_file(folder, &frame.file_path)
                .and_then(|image| shot(folder, image, &file.lens, frame, role));
            let mut shot = shot.map_err(|e| e.within(place(i, frame)).at(&path))?;
            shot.place = place(i, frame);
            shots.push(shot);
        }
        let centre = || Vec3::from(file.bounding_sphere_center.unwrap_or_default());
        ball = ball.or(file.bounding_sphere_radius.map(|radius| (centre(), radius)));
        if file.orientation_override.as_deref() == Some("none") {
            up = Up::Z;
        }
    }
    let bounds = ball.map_or(Bounds::Unknown, |(centre, radius)| {
        Bounds::Ball(centre, radius)
    });
    let stage = Stage {
        up,
        bounds,
        opening,
        warnings,
    };
    photo::scene(folder, &folder.join(files[0].0), shots, stage)
}

/// Reads a file and its lenses.
///
/// # Errors
/// Names the file, the line and the field that is missing or wrong.
pub(in crate::formats) fn parse(path: &Path) -> Result<TransformsFile> {
    #[derive(serde::Deserialize)]
    struct Lenses {
        frames: Vec<Lens>,
    }
    let document = json::Document::read(path)?;
    let mut file: TransformsFile = document.parse()?;
    file.lens = document.parse()?;
    let lenses: Lenses = document.parse()?;
    for (frame, lens) in file.frames.iter_mut().zip(lenses.frames) {
        frame.lens = lens;
    }
    Ok(file)
}

/// How messages call a frame.
pub(in crate::formats) fn place(i: usize, frame: &Frame) -> String {
    format!("frames[{i}] `{}`", frame.file_path)
}

/// A frame whose photograph is `image`; its place in messages is the caller's.
pub(in crate::formats) fn shot(
    folder: &Path,
    image: std::path::PathBuf,
    head: &Lens,
    frame: &Frame,
    role: Role,
) -> Result<Shot> {
    Ok(Shot {
        place: String::new(),
        path: frame.file_path.replace('\\', "/"),
        role,
        image,
        mask: frame.mask_path.as_ref().map(|mask| {
            // One that is not there is an error when it is read.
            found(folder, mask).unwrap_or_else(|| folder.join(mask))
        }),
        intrinsics: intrinsics(head, &frame.lens)?,
        pose: pose(&frame.transform_matrix)?,
        encoding: Encoding::Srgb,
        lit_by: Vec::new(),
    })
}

/// Intrinsics from the frame, else from the head.
fn intrinsics(head: &Lens, own: &Lens) -> Result<Intrinsics> {
    for lens in [head, own] {
        let model = lens.camera_model.as_deref();
        if let Some(model) = model.filter(|m| !PINHOLES.contains(m)) {
            let expected = format!("expected a pinhole camera, found `{model}`");
            return Err(Error::value("camera_model", expected));
        }
        if lens.is_fisheye == Some(true) {
            let expected = "expected a pinhole camera, found a fisheye";
            return Err(Error::value("is_fisheye", expected));
        }
    }
    let get = |field: fn(&Lens) -> Option<f64>| field(own).or_else(|| field(head));
    let or_zero = |field: fn(&Lens) -> Option<f64>| get(field).unwrap_or(0.0);
    // A frame's focal length beats the head's, and so does its field of view.
    let own_focal = own.fl_x.or(own.fl_y).is_some();
    let own_angle = own.camera_angle_x.or(own.camera_angle_y).is_some();
    let focal = if own_angle && !own_focal {
        [None, None]
    } else {
        [get(|l| l.fl_x), get(|l| l.fl_y)]
    };
    Ok(Intrinsics {
        size: [get(|l| l.w), get(|l| l.h)],
        focal,
        angle: [get(|l| l.camera_angle_x), get(|l| l.camera_angle_y)],
        centre: [get(|l| l.cx), get(|l| l.cy)],
        distortion: Distortion {
            radial: [
                or_zero(|l| l.k1),
                or_zero(|l| l.k2),
                or_zero(|l| l.k3),
                or_zero(|l| l.k4),
            ],
            tangential: [or_zero(|l| l.p1), or_zero(|l| l.p2)],
        },
    })
}

/// A 3×4 or 4×4 OpenGL matrix as an OpenCV pose.
fn pose(stored: &[Vec<f64>]) -> Result<Mat4> {
    let full = (3..=4).contains(&stored.len()) && stored.iter().all(|row| row.len() == 4);
    if !full {
        let expected = "expected 4 rows of 4 numbers";
        return Err(Error::value("transform_matrix", expected));
    }
    let mut rows: json::Rows = [[0.0, 0.0, 0.0, 1.0]; 4];
    for (row, stored) in rows.iter_mut().zip(stored) {
        row.copy_from_slice(stored);
    }
    Ok(opengl_to_opencv(json::matrix(&rows)))
}

/// What was applied to the poses must at least be a transformation.
fn check_applied(file: &TransformsFile) -> Result<()> {
    if let Some(rows) = &file.applied_transform {
        let numbers = || rows.iter().flatten().all(|v| v.is_finite());
        let full = (3..=4).contains(&rows.len()) && rows.iter().all(|row| row.len() == 4);
        if !(full && numbers()) {
            let expected = "expected 3 or 4 rows of 4 finite numbers";
            return Err(Error::value("applied_transform", expected));
        }
    }
    match file.applied_scale {
        Some(s) if !(s.is_finite() && s > 0.0) => {
            let expected = format!("expected a positive number, found {s}");
            Err(Error::value("applied_scale", expected))
        }
        _ => Ok(()),
    }
}
