//! Spot lights.

use super::field::{self, aimed, bulb, expected, lamp, within};
use super::rays::cap;
use super::{LightRay, LightRays, Point, RayPattern};
use crate::{Result, Similarity};
use glam::Vec3;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::f32::consts::PI;

/// Directions of which the irradiance over the scene is averaged, for each ray.
const FINER: usize = 64;

/// A [`Point`] light that shines within a cone: radiant intensity `power · color / 4π` times [`Self::falloff`], as Blender's.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Spot {
    /// Centre.
    #[schemars(with = "[f32; 3]")]
    pub position: Vec3,
    /// What the cone's axis points at; the origin if absent.
    #[serde(default)]
    #[schemars(with = "[f32; 3]")]
    pub target: Vec3,
    /// Degrees from one side of the cone to the other, 1 to 180 (Blender's `spot_size`).
    #[serde(default = "angle")]
    pub angle: f32,
    /// How much of the cone its soft edge takes, 0 to 1 (Blender's `spot_blend`).
    #[serde(default = "blend")]
    pub blend: f32,
    /// Power in watts that it would have without the cone.
    #[serde(default = "field::power")]
    pub power: f32,
    /// Colour that multiplies the power, linear Rec. 709.
    #[serde(default = "field::white")]
    pub color: [f32; 3],
    /// Radius of the sphere (softens shadows only).
    #[serde(default = "field::radius")]
    pub radius: f32,
}

/// Blender's.
fn angle() -> f32 {
    45.0
}

/// Blender's.
fn blend() -> f32 {
    0.15
}

impl Spot {
    /// A white light with Blender's cone of 45° and radius 0.05.
    #[must_use]
    pub fn facing(position: Vec3, target: Vec3, power: f32) -> Self {
        Self {
            position,
            target,
            angle: angle(),
            blend: blend(),
            power,
            color: field::white(),
            radius: field::radius(),
        }
    }

    /// Unit vector along the cone's axis: the way it shines.
    #[must_use]
    pub fn direction(&self) -> Vec3 {
        (self.target - self.position).normalize_or(Vec3::NEG_Z)
    }

    /// The point light that it is on its axis.
    #[must_use]
    pub fn bulb(&self) -> Point {
        Point {
            position: self.position,
            power: self.power,
            color: self.color,
            radius: self.radius,
        }
    }

    /// The share of the axis' intensity at an angle of this `cosine` to it: 0 outside the cone, and within it a smooth step of the
    /// cosine over [`Self::blend`] of the way from the edge's cosine to 1, as in Cycles.
    #[must_use]
    pub fn falloff(&self, cosine: f32) -> f32 {
        let edge = self.half_angle().cos();
        let (inside, soft) = (cosine - edge, self.blend * (1.0 - edge));
        if inside <= 0.0 {
            0.0
        } else if inside >= soft {
            1.0
        } else {
            let x = inside / soft;
            x * x * (3.0 - 2.0 * x)
        }
    }

    /// Radians from the axis to the edge.
    fn half_angle(&self) -> f32 {
        0.5 * self.angle.to_radians()
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
            target: s.point(self.target),
            power: self.power * s.scale * s.scale,
            radius: self.radius * s.scale,
            ..*self
        }
    }

    /// The centre alone may lie in the dark, so a spot brings the mean of its irradiance over the directions in which the unit ball
    /// is seen: what a point light brings, if the cone holds the whole ball. Its rays go where its light goes and share that evenly.
    pub(super) fn rays(&self, pattern: &RayPattern) -> LightRays {
        let n = pattern.local_rays;
        let (axis, distance2) = (self.direction(), self.position.length_squared());
        let toward = -self.position.normalize();
        let seen = (1.0 - 1.0 / distance2).max(0.0).sqrt();
        let edge = self.half_angle().cos();
        // All light that meets the ball is in the narrower of both cones.
        let (middle, narrow) = if edge > seen {
            (axis, edge)
        } else {
            (toward, seen)
        };
        let directions = cap(middle, narrow, n * FINER);
        let weights: Vec<f64> = directions
            .iter()
            .map(|d| match d.dot(toward) >= seen - 1e-6 {
                true => f64::from(self.falloff(d.dot(axis))),
                false => 0.0,
            })
            .collect();
        let total: f64 = weights.iter().sum();
        let part = f64::from((1.0 - narrow) / (1.0 - seen).max(f32::MIN_POSITIVE));
        let mean = total / weights.len() as f64 * part.min(1.0);
        let share = mean / f64::from(distance2) / n as f64;
        let irradiance = self
            .bulb()
            .intensity()
            .map(|i| (f64::from(i) * share) as f32);
        // Evenly spaced places along the running sum of the weights.
        let (mut i, mut sum) = (0, weights.first().copied().unwrap_or_default());
        (0..n)
            .map(|k| {
                let wanted = (k as f64 + 0.5) / n as f64 * total;
                while sum < wanted && i + 1 < weights.len() {
                    i += 1;
                    sum += weights[i];
                }
                LightRay {
                    origin: Some(self.position),
                    direction: directions[i],
                    irradiance,
                }
            })
            .collect()
    }

    pub(super) fn check(&self) -> Result<()> {
        lamp("spot", self.position, self.power, self.color)?;
        aimed("spot", self.position, self.target)?;
        within("spot", "angle", self.angle, [1.0, 180.0])?;
        within("spot", "blend", self.blend, [0.0, 1.0])?;
        bulb("spot", self.radius)
    }

    /// Whether some of the cone meets the unit ball.
    pub(super) fn reaches(&self) -> Result<()> {
        let off = self.direction().angle_between(-self.position);
        let seen = (1.0 / self.position.length()).min(1.0).asin();
        if off >= self.half_angle() + seen {
            let text = format!(
                "a place that makes the cone of {}° meet the scene's bounding sphere, found {:.0}° between its axis and the scene's centre",
                self.angle,
                off * 180.0 / PI
            );
            return Err(expected("spot", "target", text));
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Light;
    use crate::light::LightSource;

    fn spot(angle: f32, blend: f32, target: Vec3) -> Spot {
        Spot {
            angle,
            blend,
            ..Spot::facing(Vec3::new(0.0, 0.0, 4.0), target, 800.0)
        }
    }

    fn sum(rays: &[LightRay]) -> f32 {
        rays.iter().map(|r| r.irradiance[1]).sum()
    }

    #[test]
    fn its_power_is_that_of_the_cone() {
        for (angle, blend) in [(30.0, 0.0), (60.0, 0.15), (120.0, 1.0), (180.0, 0.5)] {
            let light = spot(angle, blend, Vec3::ZERO);
            let edge = light.half_angle().cos();
            // ∫ falloff dω = 2π (1 − cos edge)(1 − blend/2).
            let exact = 2.0 * PI * (1.0 - edge) * (1.0 - 0.5 * blend);
            let n = 200_000;
            let step = 2.0 / n as f32;
            let cosines = (0..n).map(|i| -1.0 + (i as f32 + 0.5) * step);
            let found: f64 = cosines.map(|c| f64::from(light.falloff(c))).sum();
            let found = found as f32 * step * 2.0 * PI;
            assert!(
                (found / exact - 1.0).abs() < 1e-3,
                "{found} against {exact}"
            );
        }
    }

    #[test]
    fn one_that_holds_the_scene_is_a_point_light() {
        let light = spot(60.0, 0.0, Vec3::ZERO);
        let pattern = RayPattern::default();
        let (rays, point) = (light.rays(&pattern), light.bulb().rays(&pattern));
        assert!((sum(&rays) / sum(&point) - 1.0).abs() < 1e-3);
        let mean = rays.iter().map(|r| r.direction).sum::<Vec3>() / rays.len() as f32;
        assert!(mean.distance(Vec3::NEG_Z) < 0.03, "{mean}");
    }

    #[test]
    fn one_that_leaves_the_centre_dark_brings_what_the_scene_gets() {
        let pattern = RayPattern {
            local_rays: 256,
            ..RayPattern::default()
        };
        // A hard cone wholly within the ball's outline: its part of the ball's solid angle is lit.
        let aside = spot(4.0, 0.0, Vec3::new(0.6, 0.0, 0.0));
        let seen = (1.0_f32 - 1.0 / 16.0).sqrt();
        let part = (1.0 - 2_f32.to_radians().cos()) / (1.0 - seen);
        let full = sum(&aside.bulb().rays(&pattern));
        let rays = aside.rays(&pattern);
        assert!((sum(&rays) / (part * full) - 1.0).abs() < 1e-2);
        for ray in &rays {
            assert!(ray.direction.dot(aside.direction()) >= 2_f32.to_radians().cos() - 1e-6);
        }
        // Half of one on the outline is past the ball.
        let half = spot(4.0, 0.0, Vec3::ZERO);
        let edge = Vec3::new(seen.acos().sin(), 0.0, -seen);
        let half = Spot {
            target: half.position + edge,
            ..half
        };
        let ratio = sum(&half.rays(&pattern)) / (part * full);
        assert!((ratio - 0.5).abs() < 0.06, "{ratio}");
    }

    #[test]
    fn one_that_misses_the_scene_is_an_error() {
        let miss = |target: Vec3| Light::Spot(spot(20.0, 0.15, target)).validate();
        miss(Vec3::new(0.9, 0.0, 0.0)).expect("beside the centre");
        let error = miss(Vec3::new(5.0, 0.0, 0.0))
            .expect_err("misses")
            .to_string();
        assert!(error.contains("spot.target"), "{error}");
        for (light, field) in [
            (spot(0.0, 0.1, Vec3::ZERO), "spot.angle"),
            (spot(190.0, 0.1, Vec3::ZERO), "spot.angle"),
            (spot(f32::NAN, 0.1, Vec3::ZERO), "spot.angle"),
            (spot(20.0, 1.5, Vec3::ZERO), "spot.blend"),
            (spot(20.0, 0.1, Vec3::new(0.0, 0.0, 4.0)), "spot.target"),
        ] {
            let light: LightSource<()> = LightSource::Spot(light);
            let error = light.check().expect_err(field).to_string();
            assert!(error.contains(field), "{error} without {field}");
        }
    }
}
