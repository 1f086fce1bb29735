//! The authors' camera conventions: how they normalise poses and read fields of view.

use crate::{Camera, Error, Result, Similarity};
use glam::{Mat3, Mat4, Vec3};

/// Their default `scene_scale_factor`.
pub const SCENE_SCALE: f32 = 1.35;

/// Field of view that they assume where a camera file states none, in degrees.
pub const DEFAULT_FOV_DEGREES: f32 = 30.0;

/// The similarity from the world to the authors' space, over **all** camera-to-world poses that one
/// pass sees, inputs and targets: axes from the mean camera, origin at the mean camera centre, and the
/// largest coordinate of a camera centre at `1 / scene_scale`.
///
/// Apply it to cameras and lights alike; the authors' code itself forgets the lights.
///
/// # Errors
/// If there are no poses, their mean directions vanish, or all cameras stand at one point.
pub fn normalise(poses: &[Mat4], scene_scale: f32) -> Result<Similarity> {
    let mean = |column: fn(&Mat4) -> Vec3| {
        poses.iter().map(column).sum::<Vec3>() / poses.len().max(1) as f32
    };
    let forward = mean(|p| p.z_axis.truncate()).normalize_or_zero();
    let right = mean(|p| p.y_axis.truncate())
        .cross(forward)
        .normalize_or_zero();
    let down = forward.cross(right).normalize_or_zero();
    if forward == Vec3::ZERO || right == Vec3::ZERO {
        let expected = "expected cameras that look roughly one way on average";
        return Err(Error::value("poses", expected));
    }
    let rotation = Mat3::from_cols(right, down, forward).transpose();
    let origin = mean(|p| p.w_axis.truncate());
    let reach = poses
        .iter()
        .map(|p| {
            (rotation * (p.w_axis.truncate() - origin))
                .abs()
                .max_element()
        })
        .fold(0.0, f32::max);
    let scale = 1.0 / (scene_scale * reach);
    if !(scale.is_finite() && scale > 0.0) {
        let expected = "expected cameras at more than one place";
        return Err(Error::value("poses", expected));
    }
    Ok(Similarity {
        scale,
        rotation,
        translation: -scale * (rotation * origin),
    })
}

/// Pixel intrinsics for a field of view over the **width**, whatever the image's shape.
#[must_use]
pub fn camera(fov_degrees: f32, width: usize, height: usize, camera_to_world: Mat4) -> Camera {
    let half = f64::from(fov_degrees).to_radians() / 2.0;
    let focal = (width as f64 / 2.0 / half.tan()) as f32;
    Camera {
        width,
        height,
        fx: focal,
        fy: focal,
        cx: width as f32 / 2.0,
        cy: height as f32 / 2.0,
        camera_to_world,
    }
}
