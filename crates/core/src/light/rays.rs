//! Light as rays: what the `rays` encoding turns into tokens.

use glam::Vec3;
use serde::{Deserialize, Serialize};

/// How finely each light is turned into rays.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RayPattern {
    /// Rows of the environment grid (equal steps of the polar angle).
    pub environment_rows: usize,
    /// Columns of the environment grid.
    pub environment_columns: usize,
    /// Rays per light that is no environment.
    pub local_rays: usize,
}

impl Default for RayPattern {
    fn default() -> Self {
        Self {
            environment_rows: 16,
            environment_columns: 32,
            local_rays: 64,
        }
    }
}

/// One ray of light.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct LightRay {
    /// Where it starts; `None` for a ray from infinity (its moment is zero).
    pub origin: Option<Vec3>,
    /// Unit direction in which the light travels.
    pub direction: Vec3,
    /// The share of irradiance, per channel, which this ray brings to a surface at the origin that
    /// faces it. The rays of a light add up to the light's irradiance there, so one unit serves all kinds.
    pub irradiance: [f32; 3],
}

/// The rays of one light.
pub type LightRays = Vec<LightRay>;

impl LightRay {
    /// Plücker moment o × d; zero for rays from infinity.
    #[must_use]
    pub fn moment(&self) -> Vec3 {
        self.origin.map_or(Vec3::ZERO, |o| o.cross(self.direction))
    }

    /// The ray of a light so many times as strong, per channel.
    #[must_use]
    pub fn scaled(&self, factor: [f64; 3]) -> Self {
        Self {
            irradiance: std::array::from_fn(|c| (f64::from(self.irradiance[c]) * factor[c]) as f32),
            ..*self
        }
    }
}

/// `n` nearly uniform points on the unit sphere (Fibonacci lattice), poles included, along y.
#[must_use]
pub fn fibonacci_sphere(n: usize) -> Vec<Vec3> {
    let golden = std::f64::consts::PI * (3.0 - 5.0_f64.sqrt());
    (0..n)
        .map(|i| {
            let y = if n > 1 {
                1.0 - 2.0 * i as f64 / (n - 1) as f64
            } else {
                1.0
            };
            let r = (1.0 - y * y).max(0.0).sqrt();
            let (s, c) = (i as f64 * golden).sin_cos();
            Vec3::new((c * r) as f32, y as f32, (s * r) as f32)
        })
        .collect()
}

/// `n` directions spread evenly over the solid angle of the cone about the unit vector `axis` whose edge has the cosine `edge`: a
/// spiral by the golden angle (Vogel 1979), from the axis outward.
pub(super) fn cap(axis: Vec3, edge: f32, n: usize) -> Vec<Vec3> {
    let golden = std::f64::consts::PI * (3.0 - 5.0_f64.sqrt());
    let (tangent, bitangent) = axis.any_orthonormal_pair();
    (0..n)
        .map(|i| {
            let down = (i as f64 + 0.5) / n as f64 * f64::from(1.0 - edge);
            let (r, z) = ((down * (2.0 - down)).sqrt() as f32, (1.0 - down) as f32);
            let (s, c) = (i as f64 * golden).sin_cos();
            (r * (c as f32 * tangent + s as f32 * bitangent) + z * axis).normalize()
        })
        .collect()
}
