//! Suns: discs at infinity.

use super::LightSample;
use crate::sampling::frame;
use lumi_core::Sun;
use lumi_core::glam::{Vec2, Vec3};
use std::f32::consts::TAU;

/// A sun with what its samples need.
pub struct SunSampler {
    toward: Vec3,
    /// 1 less the cosine from the disc's centre to its edge, by way of the half angle: it keeps its digits where the disc is small.
    height: f32,
    /// Of the disc; of one without extent the irradiance.
    radiance: Vec3,
}

impl SunSampler {
    pub(super) fn new(light: &Sun) -> Self {
        let radius = light.radius();
        let half = (0.5 * radius).sin();
        let height = 2.0 * half * half;
        let radiance = if height > 0.0 {
            light.radiance()
        } else {
            light.irradiance()
        };
        Self {
            toward: light.toward(),
            height,
            radiance: radiance.into(),
        }
    }

    /// Whether it is more than one direction.
    pub(super) fn extended(&self) -> bool {
        self.height > 0.0
    }

    /// Uniform in the solid angle of the disc.
    pub(super) fn sample(&self, u: Vec2) -> LightSample {
        let down = u.x * self.height;
        let r = (down * (2.0 - down)).max(0.0).sqrt();
        let (s, c) = (TAU * u.y).sin_cos();
        let (tangent, bitangent) = frame(self.toward);
        let aside = r * (c * tangent + s * bitangent);
        LightSample {
            direction: (aside + (1.0 - down) * self.toward).normalize(),
            distance: f32::INFINITY,
            radiance: self.radiance,
            pdf: self.pdf(),
        }
    }

    pub(super) fn seen(&self, direction: Vec3) -> Option<(Vec3, f32)> {
        // |a − b|² = 2 (1 − a·b)
        let apart = direction.distance_squared(self.toward);
        let within = self.extended() && apart <= 2.0 * self.height;
        within.then(|| (self.radiance, self.pdf()))
    }

    fn pdf(&self) -> f32 {
        if self.extended() {
            1.0 / (TAU * self.height)
        } else {
            1.0
        }
    }
}
