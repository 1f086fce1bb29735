//! From a scene of photographs to `transforms.json` and PNGs.

use super::{Frame, Lens, TransformsFile};
use crate::json;
use lumi_core::camera::opengl_to_opencv;
use lumi_core::image::{write_png, write_png_with_alpha};
use lumi_core::{DisplayImage, Error, Result, Role, Scene, View};
use std::collections::HashSet;
use std::path::Path;

/// Writes `scene` into `folder`, which is created if need be: `images/NAME.png`, RGBA where coverage is
/// known, and `transforms.json` with roles, intrinsics per frame and the bounding ball. Lights have no
/// place in this format.
///
/// # Errors
/// Names the view that has no photograph, or the file that cannot be written.
pub fn write(folder: &Path, scene: &Scene) -> Result<()> {
    write_frames(folder, scene, |_, view, stem| {
        let file_path = format!("images/{stem}.png");
        write_png_with_alpha(folder.join(&file_path), photograph(view)?)?;
        Ok(frame(file_path, view))
    })
}

/// As [`write`], with coverage in files of its own: photographs keep their background, and `masks[i]`, in [0, 1] and as large
/// as the photograph of view `i`, becomes `masks/NAME.png`, white on the object.
///
/// # Errors
/// As [`write`]; names the view whose mask has another size.
pub fn write_with_masks(folder: &Path, scene: &Scene, masks: &[Vec<f32>]) -> Result<()> {
    make(&folder.join("masks"))?;
    write_frames(folder, scene, |i, view, stem| {
        let image = photograph(view)?;
        let mask = masks.get(i).filter(|m| m.len() == image.pixels.len());
        let mask = mask.ok_or_else(|| {
            let expected = format!("expected a mask of {}×{} pixels", image.width, image.height);
            Error::value(format!("view `{}`", view.name), expected)
        })?;
        let mask = DisplayImage {
            width: image.width,
            height: image.height,
            pixels: mask.iter().map(|a| [*a; 3]).collect(),
            alpha: None,
        };
        let (file_path, mask_path) = (format!("images/{stem}.png"), format!("masks/{stem}.png"));
        write_png(folder.join(&file_path), image)?;
        write_png(folder.join(&mask_path), &mask)?;
        Ok(Frame {
            mask_path: Some(mask_path),
            ..frame(file_path, view)
        })
    })
}

fn photograph(view: &View) -> Result<&DisplayImage> {
    let expected = "expected a photograph; name a light to show a one-light-at-a-time scene under";
    let missing = || Error::value(format!("view `{}`", view.name), expected);
    view.image.as_ref().ok_or_else(missing)
}

fn make(folder: &Path) -> Result<()> {
    std::fs::create_dir_all(folder).map_err(|e| Error::io(folder, e))
}

/// Lets `write` put each view's pictures into the folder, by its index and the stem of its files, and writes their frames.
fn write_frames(
    folder: &Path,
    scene: &Scene,
    write: impl Fn(usize, &View, String) -> Result<Frame>,
) -> Result<()> {
    make(&folder.join("images"))?;
    let stems = file_stems(&scene.views).into_iter();
    let views = scene.views.iter().enumerate().zip(stems);
    let frames = views.map(|((i, view), stem)| write(i, view, stem));
    let frames = frames.collect::<Result<Vec<Frame>>>()?;
    let with = |role: Role| {
        let named = frames
            .iter()
            .zip(&scene.views)
            .filter(|(_, v)| v.role == role);
        Some(named.map(|(f, _)| f.file_path.clone()).collect())
    };
    let ball = scene.to_model.inverse();
    let file = TransformsFile {
        lens: Lens {
            camera_model: Some("PINHOLE".to_owned()),
            ..Lens::default()
        },
        train_filenames: with(Role::Input),
        test_filenames: with(Role::Target),
        val_filenames: None,
        applied_transform: None,
        applied_scale: None,
        orientation_override: Some("none".to_owned()),
        bounding_sphere_center: Some(ball.point(glam::Vec3::ZERO).to_array()),
        bounding_sphere_radius: Some(ball.scale),
        frames,
    };
    json::write(&folder.join("transforms.json"), &file)
}

/// The views' names as files', all different also where capitals do not count. What could leave the folder or mean
/// something to a system becomes `_`; where two views would share a file, the later one gets a number.
fn file_stems(views: &[View]) -> Vec<String> {
    let plain = |c: char| {
        if c.is_ascii_alphanumeric() || "-_+.".contains(c) {
            c
        } else {
            '_'
        }
    };
    let safe = |name: &str| {
        let name: String = name.chars().map(plain).collect();
        if name.is_empty() || name.starts_with('.') {
            format!("_{name}")
        } else {
            name
        }
    };
    // Names that stay as they are go first.
    let mut taken: HashSet<String> = HashSet::new();
    let kept: Vec<bool> = views
        .iter()
        .map(|v| safe(&v.name) == v.name && taken.insert(v.name.to_lowercase()))
        .collect();
    let mut stem = |(view, kept): (&View, bool)| {
        let name = safe(&view.name);
        if kept {
            return name;
        }
        let numbered = (2..).map(|n| format!("{name}-{n}"));
        let mut candidates = std::iter::once(name.clone()).chain(numbered);
        let free = candidates.find(|c| taken.insert(c.to_lowercase()));
        free.unwrap_or(name)
    };
    views.iter().zip(kept).map(&mut stem).collect()
}

fn frame(file_path: String, view: &View) -> Frame {
    let c = &view.camera;
    // The flip of two axes undoes itself.
    let pose = json::rows(opengl_to_opencv(c.camera_to_world));
    Frame {
        file_path,
        mask_path: None,
        transform_matrix: pose.iter().map(|row| row.to_vec()).collect(),
        scene_name: None,
        lens: Lens {
            fl_x: Some(c.fx.into()),
            fl_y: Some(c.fy.into()),
            cx: Some(c.cx.into()),
            cy: Some(c.cy.into()),
            w: Some(c.width as f64),
            h: Some(c.height as f64),
            ..Lens::default()
        },
    }
}
