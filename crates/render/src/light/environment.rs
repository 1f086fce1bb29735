//! Sampling environment maps by their radiance.

use super::LightSample;
use lumi_core::glam::{Mat3, Vec2, Vec3};
use lumi_core::{EnvMap, Environment};
use std::f32::consts::{PI, TAU};

/// Maps are averaged to at most this many rows (1.4° each) before rendering. A sun then spreads over one
/// cell, which the grid of light rays cannot tell apart, and is found by every sample.
pub const MAP_ROWS: usize = 128;

/// A piecewise constant map with the distribution of its radiance.
pub struct EnvironmentSampler {
    rotation: Mat3,
    rows: usize,
    columns: usize,
    /// Radiance of each cell.
    radiance: Vec<Vec3>,
    /// Density per steradian of each cell.
    density: Vec<f32>,
    /// Cosine of the polar angle at the rows' edges.
    edges: Vec<f32>,
    /// Which row.
    across_rows: Distribution,
    /// Which column, for each row.
    within_row: Vec<Distribution>,
}

impl EnvironmentSampler {
    pub(super) fn new(light: &Environment) -> Self {
        let map = light.map.at_most(MAP_ROWS);
        let (rows, columns) = (map.height, map.width);
        let strength = Vec3::from(light.strength);
        let radiance: Vec<Vec3> = map
            .pixels
            .iter()
            .map(|&p| Vec3::from(p) * strength)
            .collect();
        let (mut row_sums, mut within_row) = (Vec::new(), Vec::new());
        let mut total = 0.0_f64;
        for (y, row) in radiance.chunks(columns).enumerate() {
            let solid = f64::from(EnvMap::solid_angle(y, rows, columns));
            let weights: Vec<f64> = row
                .iter()
                .map(|p| f64::from(p.element_sum()) * solid)
                .collect();
            let sum: f64 = weights.iter().sum();
            within_row.push(Distribution::new(&weights));
            row_sums.push(sum);
            total += sum;
        }
        let density = radiance
            .iter()
            .map(|p| (f64::from(p.element_sum()) / total) as f32)
            .collect();
        Self {
            rotation: light.orientation(),
            rows,
            columns,
            density,
            edges: (0..=rows)
                .map(|y| (y as f32 * PI / rows as f32).cos())
                .collect(),
            across_rows: Distribution::new(&row_sums),
            within_row,
            radiance,
        }
    }

    /// Inverts the distribution, which keeps stratified numbers stratified over the sphere.
    pub(super) fn sample(&self, u: Vec2) -> Option<LightSample> {
        let (y, fy) = self.across_rows.invert(u.y);
        let (x, fx) = self.within_row[y].invert(u.x);
        let cell = y * self.columns + x;
        let pdf = self.density[cell];
        // Within a cell uniform in solid angle: linear in the cosine.
        let z = self.edges[y] + fy * (self.edges[y + 1] - self.edges[y]);
        let r = (1.0 - z * z).max(0.0).sqrt();
        let azimuth = (0.5 - (x as f32 + fx) / self.columns as f32) * TAU;
        let (s, c) = azimuth.sin_cos();
        (pdf > 0.0).then(|| LightSample {
            direction: self.rotation * Vec3::new(r * c, r * s, z),
            distance: f32::INFINITY,
            radiance: self.radiance[cell],
            pdf,
        })
    }

    pub(super) fn radiance(&self, direction: Vec3) -> (Vec3, f32) {
        let d = self.rotation.transpose() * direction;
        let u = 0.5 - d.y.atan2(d.x) / TAU;
        let v = d.z.clamp(-1.0, 1.0).acos() / PI;
        let x = ((u * self.columns as f32) as usize).min(self.columns - 1);
        let y = ((v * self.rows as f32) as usize).min(self.rows - 1);
        let cell = y * self.columns + x;
        (self.radiance[cell], self.density[cell])
    }
}

/// A discrete distribution that is inverted in a few steps.
struct Distribution {
    /// Normalised running sums, one more than there are steps, from 0 to 1.
    sums: Vec<f32>,
    /// For each of as many equal parts of [0, 1] as there are steps, the first step that reaches into it.
    guide: Vec<u32>,
}

impl Distribution {
    /// In proportion to `weights`; without any weight all steps are alike.
    fn new(weights: &[f64]) -> Self {
        let (n, total) = (weights.len(), weights.iter().sum::<f64>());
        let mut sum = 0.0;
        let mut sums = vec![0.0];
        for (i, w) in weights.iter().enumerate() {
            sum += w;
            let alike = (i + 1) as f64 / n as f64;
            sums.push(if total > 0.0 { sum / total } else { alike } as f32);
        }
        sums[n] = 1.0;
        let first = |k: usize| {
            let u = k as f32 / n as f32;
            sums[1..n].partition_point(|&s| s <= u) as u32
        };
        Self {
            guide: (0..n).map(first).collect(),
            sums,
        }
    }

    /// The step in which `u` lies, and how far through it.
    fn invert(&self, u: f32) -> (usize, f32) {
        let n = self.guide.len();
        let part = ((u * n as f32) as usize).min(n - 1);
        let first = self.guide[part] as usize;
        let last = self.guide.get(part + 1).map_or(n - 1, |&i| i as usize);
        // Beside a sun, most steps share a part.
        let i = first + self.sums[first + 1..=last].partition_point(|&s| s <= u);
        let width = self.sums[i + 1] - self.sums[i];
        let f = if width > 0.0 {
            (u - self.sums[i]) / width
        } else {
            0.5
        };
        (i, f.clamp(0.0, 0.999_999))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sampling::Sampler;
    use std::sync::Arc;

    #[test]
    fn samples_carry_the_energy_of_the_map() {
        let map = EnvMap {
            width: 16,
            height: 8,
            pixels: (0..128)
                .map(|i| {
                    if i == 37 {
                        [900.0, 500.0, 100.0]
                    } else {
                        [0.2, (i % 5) as f32, 0.1]
                    }
                })
                .collect(),
        };
        let energy = map.energy();
        let light = EnvironmentSampler::new(&Environment::new(Arc::new(map), 0.7, 1.0));
        let n = 4096;
        let mut sum = Vec3::ZERO;
        for i in 0..n {
            let s = light.sample(Sampler::new(3, i, n).pair()).expect("bright");
            let (radiance, pdf) = light.radiance(s.direction);
            // Points on the very edge of a cell may round into the next one.
            if pdf == s.pdf {
                assert_eq!(radiance, s.radiance);
            }
            sum += s.radiance / s.pdf;
        }
        for c in 0..3 {
            let mean = f64::from(sum[c]) / f64::from(n);
            assert!(
                (mean - energy[c]).abs() < 0.02 * energy[c],
                "{mean} {}",
                energy[c]
            );
        }
    }
}
