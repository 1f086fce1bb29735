//! Similarities (rotation, uniform scale, translation), applied to views and lights alike.

use glam::{Mat3, Mat4, Vec3};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// `x ↦ scale · rotation · x + translation`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Similarity {
    /// Uniform scale, > 0.
    pub scale: f32,
    /// Rotation, column by column. Points, directions and lights may be mirrored by it, too; cameras would become left-handed.
    #[schemars(with = "[f32; 9]")]
    pub rotation: Mat3,
    /// Translation, applied last.
    #[schemars(with = "[f32; 3]")]
    pub translation: Vec3,
}

impl Similarity {
    /// Leaves everything where it is.
    pub const IDENTITY: Self = Self {
        scale: 1.0,
        rotation: Mat3::IDENTITY,
        translation: Vec3::ZERO,
    };

    /// Maps the ball around `centre` with `radius` onto the unit ball at the origin.
    #[must_use]
    pub fn to_unit_ball(centre: Vec3, radius: f32) -> Self {
        let scale = 1.0 / radius;
        Self {
            scale,
            rotation: Mat3::IDENTITY,
            translation: -centre * scale,
        }
    }

    /// A point.
    #[must_use]
    pub fn point(&self, x: Vec3) -> Vec3 {
        self.scale * (self.rotation * x) + self.translation
    }

    /// A direction: only rotated, keeps its length.
    #[must_use]
    pub fn direction(&self, d: Vec3) -> Vec3 {
        self.rotation * d
    }

    /// A camera-to-world pose: its centre moves as a point, its axes stay orthonormal.
    #[must_use]
    pub fn pose(&self, camera_to_world: &Mat4) -> Mat4 {
        let axes = self.rotation * Mat3::from_mat4(*camera_to_world);
        let centre = self.point(camera_to_world.w_axis.truncate());
        Mat4::from_cols(
            axes.x_axis.extend(0.0),
            axes.y_axis.extend(0.0),
            axes.z_axis.extend(0.0),
            centre.extend(1.0),
        )
    }

    /// The similarity that undoes this one.
    #[must_use]
    pub fn inverse(&self) -> Self {
        let (scale, rotation) = (1.0 / self.scale, self.rotation.transpose());
        Self {
            scale,
            rotation,
            translation: -scale * (rotation * self.translation),
        }
    }

    /// First `self`, then `next`.
    #[must_use]
    pub fn then(&self, next: &Self) -> Self {
        Self {
            scale: next.scale * self.scale,
            rotation: next.rotation * self.rotation,
            translation: next.point(self.translation),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn inverse_and_composition() {
        let a = Similarity {
            scale: 2.0,
            rotation: Mat3::from_rotation_z(0.4),
            translation: Vec3::new(1.0, -2.0, 0.5),
        };
        let b = Similarity::to_unit_ball(Vec3::new(3.0, 1.0, 2.0), 0.5);
        let x = Vec3::new(0.3, 0.7, -1.1);
        assert!(a.inverse().point(a.point(x)).distance(x) < 1e-5);
        assert!(a.then(&b).point(x).distance(b.point(a.point(x))) < 1e-5);
        assert!(b.point(Vec3::new(3.5, 1.0, 2.0)).distance(Vec3::X) < 1e-6);
    }
}
