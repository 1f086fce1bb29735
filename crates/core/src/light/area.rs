//! Square area lights.

use super::field::{self, aimed, expected, finite, lamp, positive};
use super::{LightRay, LightRays, RayPattern};
use crate::{Result, Similarity};
use glam::Vec3;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::f32::consts::PI;

/// A one-sided Lambertian square of side `size` with radiance `power · color / (π · size²)`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Area {
    /// Centre of the square.
    #[schemars(with = "[f32; 3]")]
    pub position: Vec3,
    /// What it faces; the origin if absent.
    #[serde(default)]
    #[schemars(with = "[f32; 3]")]
    pub target: Vec3,
    /// One side's direction, as far as it is at right angles to the way the square faces; horizontal if absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(with = "Option<[f32; 3]>")]
    pub side: Option<Vec3>,
    /// Length of a side.
    #[serde(default = "one")]
    pub size: f32,
    /// Power in watts.
    #[serde(default = "field::power")]
    pub power: f32,
    /// Colour that multiplies the power, linear Rec. 709.
    #[serde(default = "field::white")]
    pub color: [f32; 3],
}

fn one() -> f32 {
    1.0
}

impl Area {
    /// A white square at `position` that faces `target`.
    #[must_use]
    pub fn facing(position: Vec3, target: Vec3, size: f32, power: f32) -> Self {
        Self {
            position,
            target,
            side: None,
            size,
            power,
            color: field::white(),
        }
    }

    /// Unit normal: the way it shines.
    #[must_use]
    pub fn direction(&self) -> Vec3 {
        (self.target - self.position).normalize_or(Vec3::NEG_Z)
    }

    /// Unit vectors along its sides, at right angles to each other and to [`Self::direction`].
    #[must_use]
    pub fn sides(&self) -> [Vec3; 2] {
        let direction = self.direction();
        let up = if direction.z.abs() > 0.99 {
            Vec3::Y
        } else {
            Vec3::Z
        };
        let horizontal = direction.cross(up).normalize();
        let side = self.side.map_or(horizontal, |side| {
            side.reject_from_normalized(direction)
                .normalize_or(horizontal)
        });
        [side, direction.cross(side)]
    }

    /// Emitted radiance per channel.
    #[must_use]
    pub fn radiance(&self) -> [f32; 3] {
        self.color
            .map(|c| c * self.power / (PI * self.size * self.size))
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
            side: Some(s.direction(self.sides()[0])),
            size: self.size * s.scale,
            power: self.power * s.scale * s.scale,
            ..*self
        }
    }

    pub(super) fn rays(&self, pattern: &RayPattern) -> LightRays {
        let n = pattern.local_rays;
        let area = self.size * self.size / n as f32;
        let targets = super::fibonacci_sphere(n);
        let (direction, [side, other]) = (self.direction(), self.sides());
        (0..n)
            .map(|i| {
                // R2 low-discrepancy sequence (Roberts 2018) over the square.
                let u = (0.5 + 0.754_877_7 * (i + 1) as f32).fract() - 0.5;
                let v = (0.5 + 0.569_840_3 * (i + 1) as f32).fract() - 0.5;
                let origin = self.position + self.size * (u * side + v * other);
                // Toward the centre: cos at the emitter over squared distance.
                let cosine = direction.dot(-origin.normalize()).max(0.0);
                let factor = cosine * area / origin.length_squared();
                LightRay {
                    origin: Some(origin),
                    direction: (targets[i] - origin).normalize(),
                    irradiance: self.radiance().map(|l| l * factor),
                }
            })
            .collect()
    }

    pub(super) fn check(&self) -> Result<()> {
        lamp("area", self.position, self.power, self.color)?;
        aimed("area", self.position, self.target)?;
        positive("area", "size", "metres", self.size)?;
        let Some(side) = self.side else {
            return Ok(());
        };
        finite("area", "side", side)?;
        let across = side.reject_from_normalized(self.direction());
        if across.length() <= 1e-3 * side.length() {
            let text = format!("a vector across the way the square faces, found {side}");
            return Err(expected("area", "side", text));
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sides_are_square_whatever_is_said_of_them() {
        let good = Area::facing(Vec3::new(0.0, 0.0, 3.0), Vec3::ZERO, 1.0, 100.0);
        let turned = |side: Vec3| Area {
            side: Some(side),
            ..good
        };
        let long = turned(Vec3::new(5.0, 5.0, 2.0));
        long.check().expect("its part across counts");
        let [side, other] = long.sides();
        assert!(side.distance(Vec3::new(0.5, 0.5, 0.0).normalize()) < 1e-6);
        assert!(side.dot(other).abs() < 1e-6 && other.dot(long.direction()).abs() < 1e-6);
        let above = Area {
            target: good.position,
            ..good
        };
        for (light, field) in [
            (turned(good.direction()), "area.side"),
            (turned(Vec3::ZERO), "area.side"),
            (above, "area.target"),
        ] {
            let error = light.check().expect_err(field).to_string();
            assert!(error.contains(field), "{error} without {field}");
        }
    }

    #[test]
    fn rays_carry_the_irradiance_of_a_square() {
        // Exact irradiance on the axis of a square of half-side a at distance h, facing it:
        // E = L · (4 a/√(a²+h²)) · atan(a/√(a²+h²)).
        let light = Area::facing(Vec3::new(0.0, 0.0, 3.0), Vec3::ZERO, 1.0, 100.0);
        let rays = light.rays(&RayPattern {
            local_rays: 1024,
            ..RayPattern::default()
        });
        // Irradiance on the plane z = 0 takes the receiver's cosine as well.
        let sum: f32 = rays
            .iter()
            .map(|r| r.irradiance[0] * r.origin.expect("local").normalize().z)
            .sum();
        let (a, h) = (0.5_f32, 3.0_f32);
        let s = (a * a + h * h).sqrt();
        let exact = light.radiance()[0] * 4.0 * (a / s) * (a / s).atan();
        assert!((sum - exact).abs() < 0.01 * exact, "{sum} against {exact}");
    }

    #[test]
    fn faces_its_target() {
        let light = Area::facing(Vec3::new(1.0, -2.0, 3.0), Vec3::ZERO, 1.0, 100.0);
        light.check().expect("valid");
        assert!(light.direction().dot(-light.position.normalize()) > 0.999);
        let [side, other] = light.sides();
        assert!(side.z.abs() < 1e-6 && other.dot(side).abs() < 1e-6);
    }
}
