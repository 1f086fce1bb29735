//! Square area lights.

use super::point::check_local;
use super::{LightRay, LightRays, RayPattern};
use crate::{Error, Result, Similarity};
use glam::Vec3;
use std::f32::consts::PI;

/// A one-sided Lambertian square of side `size` with radiance `power · color / (π · size²)`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Area {
    /// Centre of the square.
    pub position: Vec3,
    /// Unit normal: the way it shines.
    pub direction: Vec3,
    /// Unit vector along one side, perpendicular to `direction`.
    pub side: Vec3,
    /// Length of a side.
    pub size: f32,
    /// Power in watts.
    pub power: f32,
    /// Colour that multiplies the power.
    pub color: [f32; 3],
}

impl Area {
    /// A white square at `position` that faces `target`.
    #[must_use]
    pub fn facing(position: Vec3, target: Vec3, size: f32, power: f32) -> Self {
        let direction = (target - position).normalize_or(Vec3::NEG_Z);
        let helper = if direction.z.abs() > 0.99 {
            Vec3::Y
        } else {
            Vec3::Z
        };
        let side = direction.cross(helper).normalize();
        Self {
            position,
            direction,
            side,
            size,
            power,
            color: [1.0; 3],
        }
    }

    /// The other side's unit vector.
    #[must_use]
    pub fn other_side(&self) -> Vec3 {
        self.direction.cross(self.side)
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
            direction: s.direction(self.direction),
            side: s.direction(self.side),
            size: self.size * s.scale,
            power: self.power * s.scale * s.scale,
            ..*self
        }
    }

    pub(super) fn rays(&self, pattern: &RayPattern) -> LightRays {
        let n = pattern.local_rays;
        let area = self.size * self.size / n as f32;
        let targets = super::fibonacci_sphere(n);
        (0..n)
            .map(|i| {
                // R2 low-discrepancy sequence (Roberts 2018) over the square.
                let u = (0.5 + 0.754_877_7 * (i + 1) as f32).fract() - 0.5;
                let v = (0.5 + 0.569_840_3 * (i + 1) as f32).fract() - 0.5;
                let origin = self.position + self.size * (u * self.side + v * self.other_side());
                // Toward the centre: cos at the emitter over squared distance.
                let cosine = self.direction.dot(-origin.normalize()).max(0.0);
                let factor = cosine * area / origin.length_squared();
                LightRay {
                    origin: Some(origin),
                    direction: (targets[i] - origin).normalize(),
                    irradiance: self.radiance().map(|l| l * factor),
                }
            })
            .collect()
    }

    pub(super) fn validate(&self) -> Result<()> {
        check_local("area", self.position, self.power, self.color)?;
        if !(self.size.is_finite() && self.size > 0.0) {
            let expected = format!("expected a positive length, found {}", self.size);
            return Err(Error::value("area.size", expected));
        }
        let is_unit = |v: Vec3| (v.length() - 1.0).abs() <= 1e-3;
        if !is_unit(self.direction) {
            let expected = format!("expected a unit vector, found {}", self.direction);
            return Err(Error::value("area.direction", expected));
        }
        if !(is_unit(self.side) && self.direction.dot(self.side).abs() <= 1e-3) {
            let expected = format!(
                "expected a unit vector at right angles to the direction, found {}",
                self.side
            );
            return Err(Error::value("area.side", expected));
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn vectors_of_other_lengths_are_named() {
        let good = Area::facing(Vec3::new(0.0, 0.0, 3.0), Vec3::ZERO, 1.0, 100.0);
        assert!(good.validate().is_ok());
        let long = Area {
            side: good.side * 5.0,
            ..good
        };
        let skew = Area {
            side: good.direction,
            ..good
        };
        let short = Area {
            direction: good.direction * 0.5,
            ..good
        };
        for (light, field) in [
            (long, "area.side"),
            (skew, "area.side"),
            (short, "area.direction"),
        ] {
            let error = light.validate().expect_err(field).to_string();
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
        light.validate().expect("valid");
        assert!(light.direction.dot(-light.position.normalize()) > 0.999);
        assert!(light.other_side().dot(light.side).abs() < 1e-6);
    }
}
