//! Point lights.

use super::field::{self, bulb, lamp};
use super::{LightRay, LightRays, RayPattern, fibonacci_sphere};
use crate::{Result, Similarity};
use glam::Vec3;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::f32::consts::PI;

/// A small sphere that shines equally in all directions: radiant intensity `power · color / 4π`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Point {
    /// Centre.
    #[schemars(with = "[f32; 3]")]
    pub position: Vec3,
    /// Power in watts.
    #[serde(default = "field::power")]
    pub power: f32,
    /// Colour that multiplies the power, linear Rec. 709.
    #[serde(default = "field::white")]
    pub color: [f32; 3],
    /// Radius of the sphere (softens shadows only).
    #[serde(default = "field::radius")]
    pub radius: f32,
}

impl Point {
    /// A white light with Blender-like radius 0.05.
    #[must_use]
    pub fn new(position: Vec3, power: f32) -> Self {
        Self {
            position,
            power,
            color: field::white(),
            radius: field::radius(),
        }
    }

    /// Radiant intensity in W/sr per channel.
    #[must_use]
    pub fn intensity(&self) -> [f32; 3] {
        self.color.map(|c| c * self.power / (4.0 * PI))
    }

    pub(super) fn scaled(&self, gain: [f32; 3]) -> Self {
        Self {
            color: std::array::from_fn(|c| self.color[c] * gain[c]),
            ..*self
        }
    }

    pub(super) fn transformed(&self, s: &Similarity) -> Self {
        Self {
            position: s.point(self.position),
            power: self.power * s.scale * s.scale,
            radius: self.radius * s.scale,
            ..*self
        }
    }

    pub(super) fn rays(&self, pattern: &RayPattern) -> LightRays {
        let n = pattern.local_rays;
        let share = 1.0 / (self.position.length_squared() * n as f32);
        let irradiance = self.intensity().map(|i| i * share);
        fibonacci_sphere(n)
            .into_iter()
            .map(|s| LightRay {
                origin: Some(self.position),
                direction: (s - self.position).normalize(),
                irradiance,
            })
            .collect()
    }

    pub(super) fn check(&self) -> Result<()> {
        lamp("point", self.position, self.power, self.color)?;
        bulb("point", self.radius)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Light;

    #[test]
    fn rays_carry_the_irradiance_at_the_centre() {
        let light = Point::new(Vec3::new(0.0, 0.0, 2.0), 800.0);
        let rays = light.rays(&RayPattern::default());
        let sum: f32 = rays.iter().map(|r| r.irradiance[0]).sum();
        assert!((sum - 800.0 / (4.0 * PI) / 4.0).abs() < 1e-3);
        assert!(
            rays.iter()
                .all(|r| (r.direction.length() - 1.0).abs() < 1e-5)
        );
    }

    #[test]
    fn a_similarity_keeps_irradiance() {
        let s = Similarity::to_unit_ball(Vec3::new(1.0, 2.0, 3.0), 4.0);
        let light = Point::new(Vec3::new(9.0, 2.0, 3.0), 500.0);
        let moved = light.transformed(&s);
        let before = light.intensity()[0] / 64.0; // 8 units from the centre
        let after = moved.intensity()[0] / moved.position.length_squared();
        assert!((before - after).abs() < 1e-5 * before);
    }

    #[test]
    fn a_light_inside_the_scene_is_an_error() {
        let light = Light::Point(Point::new(Vec3::new(0.2, 0.0, 0.1), 800.0));
        light.check().expect("fine in some scene");
        let error = light.validate().expect_err("inside").to_string();
        assert!(error.contains("point.position"), "{error}");
    }
}
