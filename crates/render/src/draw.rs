//! Random draws for procedural content.

use crate::image_texture::Image;
use lumi_core::Seed;
use lumi_core::glam::{Mat3, Vec3};
use lumi_core::seed::Rng;
use rand::Rng as _;
use std::f32::consts::TAU;
use std::sync::Arc;

/// A random stream with the draws that procedural content needs.
pub struct Draw {
    rng: Rng,
    pictures: Arc<[Arc<Image>]>,
}

impl Draw {
    /// The stream of `seed` called `name`.
    #[must_use]
    pub fn new(seed: Seed, name: &str) -> Self {
        Self {
            rng: seed.stream(name),
            pictures: Arc::default(),
        }
    }

    /// The stream with pictures for [`Self::picture`].
    #[must_use]
    pub fn with_pictures(mut self, pictures: &Arc<[Arc<Image>]>) -> Self {
        self.pictures = Arc::clone(pictures);
        self
    }

    /// One of the pictures, if there are any.
    pub fn picture(&mut self) -> Option<Arc<Image>> {
        if self.pictures.is_empty() {
            return None;
        }
        let i = self.count(0, self.pictures.len() - 1);
        Some(Arc::clone(&self.pictures[i]))
    }

    /// Uniform in [0, 1).
    pub fn unit(&mut self) -> f32 {
        (self.rng.next_u64() >> 40) as f32 * (1.0 / 16_777_216.0)
    }

    /// Uniform in [low, high).
    pub fn range(&mut self, low: f32, high: f32) -> f32 {
        low + (high - low) * self.unit()
    }

    /// Uniform in the logarithm over [low, high), both > 0.
    pub fn log_range(&mut self, low: f32, high: f32) -> f32 {
        low * (high / low).powf(self.unit())
    }

    /// True with probability `p`.
    pub fn chance(&mut self, p: f32) -> bool {
        self.unit() < p
    }

    /// A whole number from `low` to `high`, both included.
    pub fn count(&mut self, low: usize, high: usize) -> usize {
        low + (self.unit() * (high - low + 1) as f32) as usize
    }

    /// One of the items.
    pub fn pick<T: Copy>(&mut self, items: &[T]) -> T {
        items[self.count(0, items.len() - 1)]
    }

    /// 32 random bits.
    pub fn bits(&mut self) -> u32 {
        (self.rng.next_u64() >> 32) as u32
    }

    /// A unit vector, uniform over the sphere.
    pub fn direction(&mut self) -> Vec3 {
        let z = self.range(-1.0, 1.0);
        let r = (1.0 - z * z).max(0.0).sqrt();
        let (s, c) = (TAU * self.unit()).sin_cos();
        Vec3::new(r * c, r * s, z)
    }

    /// A vector with each component uniform in [low, high).
    pub fn vector(&mut self, low: f32, high: f32) -> Vec3 {
        Vec3::new(
            self.range(low, high),
            self.range(low, high),
            self.range(low, high),
        )
    }

    /// Any rotation.
    pub fn rotation(&mut self) -> Mat3 {
        Mat3::from_axis_angle(self.direction(), TAU * self.unit())
    }
}
