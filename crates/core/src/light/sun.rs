//! Suns.

use super::field::{self, expected, finite, positive, some_light, within};
use super::rays::cap;
use super::{LightRay, LightRays, RayPattern};
use crate::{Result, Similarity};
use glam::Vec3;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::f32::consts::PI;

/// A distant disc of even radiance that brings the irradiance `strength · color` to whatever faces it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Sun {
    /// The way toward it, of any length.
    #[schemars(with = "[f32; 3]")]
    pub from: Vec3,
    /// Irradiance in W/m².
    #[serde(default = "strength")]
    pub strength: f32,
    /// Degrees from one side of the disc to the other, 0 to 180.
    #[serde(default = "angle")]
    pub angle: f32,
    /// Colour that multiplies the strength, linear Rec. 709.
    #[serde(default = "field::white")]
    pub color: [f32; 3],
}

/// Blender's.
fn strength() -> f32 {
    1.0
}

/// The sun's own, as seen from Earth.
fn angle() -> f32 {
    0.526
}

impl Sun {
    /// A white sun as large as the one in the sky.
    #[must_use]
    pub fn new(from: Vec3, strength: f32) -> Self {
        Self {
            from,
            strength,
            angle: angle(),
            color: field::white(),
        }
    }

    /// Unit vector toward its centre.
    #[must_use]
    pub fn toward(&self) -> Vec3 {
        self.from.normalize_or(Vec3::Z)
    }

    /// Irradiance in W/m² per channel on a surface that faces it.
    #[must_use]
    pub fn irradiance(&self) -> [f32; 3] {
        self.color.map(|c| c * self.strength)
    }

    /// Radians from its centre to its edge.
    #[must_use]
    pub fn radius(&self) -> f32 {
        0.5 * self.angle.to_radians()
    }

    /// Radiance of the disc per channel; infinite for one without extent.
    #[must_use]
    pub fn radiance(&self) -> [f32; 3] {
        let sine = self.radius().sin();
        self.irradiance().map(|e| e / (PI * sine * sine))
    }

    pub(super) fn scaled(&self, gain: [f32; 3]) -> Self {
        Self {
            color: std::array::from_fn(|c| self.color[c] * gain[c]),
            ..*self
        }
    }

    pub(super) fn transformed(&self, s: &Similarity) -> Self {
        Self {
            from: s.direction(self.from),
            ..*self
        }
    }

    /// Rays from all over the disc.
    pub(super) fn rays(&self, pattern: &RayPattern) -> LightRays {
        let toward = self.toward();
        let places = cap(toward, self.radius().cos(), pattern.local_rays);
        // Even radiance: what comes from the edge meets a surface that faces the centre at an angle.
        let cosines: f32 = places.iter().map(|p| p.dot(toward)).sum();
        let ray = |place: Vec3| LightRay {
            origin: None,
            direction: -place,
            irradiance: self.irradiance().map(|e| e * place.dot(toward) / cosines),
        };
        places.into_iter().map(ray).collect()
    }

    pub(super) fn check(&self) -> Result<()> {
        finite("sun", "from", self.from)?;
        if self.from.try_normalize().is_none() {
            let text = format!("a direction, found {}", self.from);
            return Err(expected("sun", "from", text));
        }
        positive("sun", "strength", "W/m²", self.strength)?;
        within("sun", "angle", self.angle, [0.0, 180.0])?;
        some_light("sun", "color", self.color)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rays_carry_the_irradiance_from_within_the_disc() {
        for angle in [0.0, 0.526, 40.0, 180.0] {
            let light = Sun {
                angle,
                ..Sun::new(Vec3::new(1.0, -2.0, 2.0), 3.0)
            };
            light.check().expect("valid");
            let rays = light.rays(&RayPattern::default());
            let sum: f32 = rays.iter().map(|r| r.irradiance[2]).sum();
            assert!((sum - 3.0).abs() < 1e-4, "{sum}");
            for ray in &rays {
                let cosine = -ray.direction.dot(light.toward());
                assert!(cosine >= light.radius().cos() - 1e-6 && ray.origin.is_none());
            }
        }
    }

    #[test]
    fn a_similarity_turns_it_and_no_more() {
        let s = Similarity {
            rotation: glam::Mat3::from_rotation_x(0.5),
            ..Similarity::to_unit_ball(Vec3::new(1.0, 2.0, 3.0), 4.0)
        };
        let light = Sun::new(Vec3::Z, 3.0);
        let moved = light.transformed(&s);
        assert_eq!(moved.irradiance(), light.irradiance());
        assert!(moved.toward().distance(s.rotation * Vec3::Z) < 1e-6);
    }

    #[test]
    fn what_is_no_sun_is_named() {
        let good = Sun::new(Vec3::Z, 1.0);
        for (light, field) in [
            (Sun::new(Vec3::ZERO, 1.0), "sun.from"),
            (Sun::new(Vec3::NAN, 1.0), "sun.from"),
            (Sun::new(Vec3::Z, 0.0), "sun.strength"),
            (
                Sun {
                    angle: 181.0,
                    ..good
                },
                "sun.angle",
            ),
            (
                Sun {
                    color: [0.0; 3],
                    ..good
                },
                "sun.color",
            ),
        ] {
            let error = light.check().expect_err(field).to_string();
            assert!(error.contains(field), "{error} without {field}");
        }
    }
}
