//! Pinhole cameras and their rays.

use crate::{Error, Result, Similarity};
use glam::{Mat3, Mat4, Quat, Vec3};
use serde::{Deserialize, Serialize};

/// An OpenGL or Blender camera-to-world pose (x right, y up, z backward) as an OpenCV one
/// (x right, y down, z forward). The only place where this happens.
#[must_use]
pub fn opengl_to_opencv(camera_to_world: Mat4) -> Mat4 {
    let c = camera_to_world;
    Mat4::from_cols(c.x_axis, -c.y_axis, -c.z_axis, c.w_axis)
}

/// A pinhole camera: OpenCV axes (x right, y down, z forward), pixel centres at +0.5.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Camera {
    /// Image width in pixels.
    pub width: usize,
    /// Image height in pixels.
    pub height: usize,
    /// Horizontal focal length in pixels.
    pub fx: f32,
    /// Vertical focal length in pixels.
    pub fy: f32,
    /// Principal point, pixels from the left edge.
    pub cx: f32,
    /// Principal point, pixels from the top edge.
    pub cy: f32,
    /// Camera-to-world pose (rigid).
    pub camera_to_world: Mat4,
}

/// Largest image side that is accepted, in pixels; far above any use, it stops absurd allocations.
pub const MAX_SIDE: usize = 16_384;

impl Camera {
    /// A square-pixel camera at `eye` that looks at `target`; `fov` is the horizontal field of view in radians.
    /// World up is +z; straight up or down views take +y as up.
    #[must_use]
    pub fn look_at(eye: Vec3, target: Vec3, fov: f32, width: usize, height: usize) -> Self {
        let forward = (target - eye).normalize_or(Vec3::NEG_Z);
        let up = if forward.z.abs() > 0.999 {
            Vec3::Y
        } else {
            Vec3::Z
        };
        let right = forward.cross(up).normalize();
        let down = forward.cross(right);
        let f = 0.5 * width as f32 / (0.5 * fov).tan();
        Self {
            width,
            height,
            fx: f,
            fy: f,
            cx: 0.5 * width as f32,
            cy: 0.5 * height as f32,
            camera_to_world: Mat4::from_cols(
                right.extend(0.0),
                down.extend(0.0),
                forward.extend(0.0),
                eye.extend(1.0),
            ),
        }
    }

    /// Camera on a sphere around the origin; angles in radians, elevation from the xy plane.
    #[must_use]
    pub fn orbit(azimuth: f32, elevation: f32, radius: f32, fov: f32, side: usize) -> Self {
        let (sa, ca) = azimuth.sin_cos();
        let (se, ce) = elevation.sin_cos();
        Self::look_at(
            radius * Vec3::new(ca * ce, sa * ce, se),
            Vec3::ZERO,
            fov,
            side,
            side,
        )
    }

    /// Centre of projection in the world.
    #[must_use]
    pub fn centre(&self) -> Vec3 {
        self.camera_to_world.w_axis.truncate()
    }

    /// Unit viewing direction (the optical axis) in the world.
    #[must_use]
    pub fn forward(&self) -> Vec3 {
        self.camera_to_world.z_axis.truncate()
    }

    /// Unit direction in the world through the image point (`x`, `y`) in pixels; the centre of the
    /// top-left pixel is (0.5, 0.5).
    #[must_use]
    pub fn direction(&self, x: f32, y: f32) -> Vec3 {
        let local = Vec3::new((x - self.cx) / self.fx, (y - self.cy) / self.fy, 1.0);
        (Mat3::from_mat4(self.camera_to_world) * local).normalize()
    }

    /// Unit directions through all pixel centres, row-major, `height · width` of them.
    #[must_use]
    pub fn directions(&self) -> Vec<Vec3> {
        let mut rays = Vec::with_capacity(self.width * self.height);
        for y in 0..self.height {
            for x in 0..self.width {
                rays.push(self.direction(x as f32 + 0.5, y as f32 + 0.5));
            }
        }
        rays
    }

    /// Projects a world point: (x, y) in pixels and depth along the optical axis.
    #[must_use]
    pub fn project(&self, point: Vec3) -> (f32, f32, f32) {
        let local = Mat3::from_mat4(self.camera_to_world).transpose() * (point - self.centre());
        (
            self.fx * local.x / local.z + self.cx,
            self.fy * local.y / local.z + self.cy,
            local.z,
        )
    }

    /// The same view at another resolution: intrinsics scale with the image.
    #[must_use]
    pub fn resized(&self, width: usize, height: usize) -> Self {
        let (sx, sy) = (
            width as f32 / self.width as f32,
            height as f32 / self.height as f32,
        );
        Self {
            width,
            height,
            fx: self.fx * sx,
            fy: self.fy * sy,
            cx: self.cx * sx,
            cy: self.cy * sy,
            ..*self
        }
    }

    /// The camera of the part of `width × height` pixels whose top-left corner is (`x`, `y`).
    #[must_use]
    pub fn cropped(&self, (x, y): (usize, usize), (width, height): (usize, usize)) -> Self {
        Self {
            width,
            height,
            cx: self.cx - x as f32,
            cy: self.cy - y as f32,
            ..*self
        }
    }

    /// A camera `t` of the way to `other`: centre and intrinsics on a line, rotation along the shorter
    /// arc at even speed. Keeps this camera's image size.
    #[must_use]
    pub fn interpolated(&self, other: &Self, t: f32) -> Self {
        let turn = |c: &Self| Quat::from_mat3(&Mat3::from_mat4(c.camera_to_world));
        let rotation = turn(self).slerp(turn(other), t);
        let mix = |a: f32, b: f32| a + (b - a) * t;
        Self {
            fx: mix(self.fx, other.fx),
            fy: mix(self.fy, other.fy),
            cx: mix(self.cx, other.cx),
            cy: mix(self.cy, other.cy),
            camera_to_world: Mat4::from_rotation_translation(
                rotation,
                self.centre().lerp(other.centre(), t),
            ),
            ..*self
        }
    }

    /// The camera moved by a similarity.
    #[must_use]
    pub fn transformed(&self, s: &Similarity) -> Self {
        Self {
            camera_to_world: s.pose(&self.camera_to_world),
            ..*self
        }
    }

    /// Checks sizes, intrinsics and that the pose is rigid (rotation orthonormal to 1e-3, det +1).
    ///
    /// # Errors
    /// Names the field and what was expected.
    pub fn validate(&self) -> Result<()> {
        for (field, side) in [("width", self.width), ("height", self.height)] {
            if side == 0 || side > MAX_SIDE {
                let expected = format!("expected 1 to {MAX_SIDE} pixels, found {side}");
                return Err(Error::value(field, expected));
            }
        }
        for (field, f) in [("fx", self.fx), ("fy", self.fy)] {
            if !(f.is_finite() && f > 0.0) {
                let expected = format!("expected a positive focal length in pixels, found {f}");
                return Err(Error::value(field, expected));
            }
        }
        for (field, c) in [("cx", self.cx), ("cy", self.cy)] {
            if !c.is_finite() {
                return Err(Error::value(
                    field,
                    format!("expected a finite number, found {c}"),
                ));
            }
        }
        if !self.camera_to_world.is_finite() {
            return Err(Error::value("camera_to_world", "expected finite numbers"));
        }
        let r = Mat3::from_mat4(self.camera_to_world);
        let off = (r * r.transpose() - Mat3::IDENTITY)
            .to_cols_array()
            .iter()
            .fold(0.0_f32, |m, v| m.max(v.abs()));
        if off > 1e-3 || r.determinant() < 0.0 {
            let found = if off > 1e-3 {
                format!("its axes are off orthonormal by {off:.2e}")
            } else {
                "it mirrors (determinant < 0)".to_owned()
            };
            let expected = format!("expected a rotation in the upper left 3×3; {found}");
            return Err(Error::value("camera_to_world", expected));
        }
        let last = self.camera_to_world.row(3);
        if last.abs_diff_eq(glam::Vec4::W, 1e-4) {
            Ok(())
        } else {
            let expected = format!("expected the last row 0 0 0 1, found {last}");
            Err(Error::value("camera_to_world", expected))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn look_at_centres_its_target_and_keeps_up() {
        let camera = Camera::look_at(Vec3::new(2.0, -1.0, 1.0), Vec3::ZERO, 0.9, 64, 48);
        camera.validate().expect("rigid");
        let (x, y, z) = camera.project(Vec3::ZERO);
        assert!((x - 32.0).abs() < 1e-3 && (y - 24.0).abs() < 1e-3 && z > 0.0);
        // A point above the target appears higher up, which is a smaller y.
        assert!(camera.project(Vec3::new(0.0, 0.0, 0.2)).1 < y);
    }

    #[test]
    fn direction_inverts_projection() {
        let camera = Camera::orbit(0.7, 0.5, 3.0, 0.9, 32);
        let p = Vec3::new(0.2, -0.1, 0.3);
        let (x, y, _) = camera.project(p);
        let d = camera.direction(x, y);
        assert!(d.distance((p - camera.centre()).normalize()) < 1e-5);
    }

    #[test]
    fn validation_names_the_field() {
        let mut camera = Camera::orbit(0.0, 0.3, 3.0, 0.9, 32);
        camera.camera_to_world.x_axis *= 1.1;
        let message = camera.validate().expect_err("scaled").to_string();
        assert!(
            message.contains("camera_to_world") && message.contains("rotation"),
            "{message}"
        );
        let mut camera = Camera::orbit(0.0, 0.3, 3.0, 0.9, 32);
        camera.fx = f32::NAN;
        assert!(
            camera
                .validate()
                .expect_err("nan")
                .to_string()
                .contains("fx")
        );
    }
}
