//! Lat-long environment maps.

use super::field::{self, some_light};
use super::{LightRay, LightRays, RayPattern};
use crate::{Error, Result, Similarity};
use glam::{Mat3, Vec3};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::borrow::Cow;
use std::f32::consts::{PI, TAU};
use std::sync::Arc;

/// A lat-long radiance map: row 0 is +z; column `u = 0.5 − atan2(y, x)/2π`, so the centre column looks along +x.
#[derive(Clone, Debug, PartialEq)]
pub struct EnvMap {
    /// Width in pixels.
    pub width: usize,
    /// Height in pixels.
    pub height: usize,
    /// Linear radiance, row-major.
    pub pixels: Vec<[f32; 3]>,
}

/// Distant light from all sides.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Environment<M = Arc<EnvMap>> {
    /// The map, shared between copies, or what names it.
    pub map: M,
    /// Degrees that the map is turned about its own +z, counter-clockwise from above.
    #[serde(default)]
    pub rotate: f32,
    /// Where the map's axes stand after that: a rotation, column by column. Without it the map's +z is up.
    #[serde(default = "upright", skip_serializing_if = "field::is_identity")]
    #[schemars(with = "[f32; 9]")]
    pub rotation: Mat3,
    /// Factor on the map's radiance, one for all channels or one for each.
    #[serde(default = "field::factor::one", with = "field::factor")]
    #[schemars(with = "field::factor::Factor")]
    pub strength: [f32; 3],
}

fn upright() -> Mat3 {
    Mat3::IDENTITY
}

impl EnvMap {
    /// A map of one colour.
    #[must_use]
    pub fn uniform(radiance: [f32; 3]) -> Self {
        Self {
            width: 2,
            height: 1,
            pixels: vec![radiance; 2],
        }
    }

    /// Radiance from direction `d` (unit, in the map's frame), bilinear, wrapping around.
    #[must_use]
    pub fn lookup(&self, d: Vec3) -> [f32; 3] {
        let u = (0.5 - d.y.atan2(d.x) / TAU) * self.width as f32 - 0.5;
        let v = d.z.clamp(-1.0, 1.0).acos() / PI * self.height as f32 - 0.5;
        let (x0, y0) = (u.floor(), v.floor());
        let (tx, ty) = (u - x0, v - y0);
        let at = |x: f32, y: f32| {
            let x = (x as isize).rem_euclid(self.width as isize) as usize;
            let y = (y.max(0.0) as usize).min(self.height - 1);
            self.pixels[y * self.width + x]
        };
        let (a, b) = (at(x0, y0), at(x0 + 1.0, y0));
        let (c, e) = (at(x0, y0 + 1.0), at(x0 + 1.0, y0 + 1.0));
        std::array::from_fn(|k| {
            (a[k] * (1.0 - tx) + b[k] * tx) * (1.0 - ty) + (c[k] * (1.0 - tx) + e[k] * tx) * ty
        })
    }

    /// Direction in the map's frame of the point (`u`, `v`) in [0, 1]².
    #[must_use]
    pub fn direction(u: f32, v: f32) -> Vec3 {
        let (st, ct) = (v * PI).sin_cos();
        let (sp, cp) = ((0.5 - u) * TAU).sin_cos();
        Vec3::new(st * cp, st * sp, ct)
    }

    /// Solid angle in sr of a pixel in `row` of a lat-long grid with the given size; a row's pixels are alike.
    #[must_use]
    pub fn solid_angle(row: usize, rows: usize, columns: usize) -> f32 {
        let edge = |r: usize| (r as f64 * std::f64::consts::PI / rows as f64).cos();
        ((edge(row) - edge(row + 1)) * std::f64::consts::TAU / columns as f64) as f32
    }

    /// Solid-angle-weighted mean over each cell of a coarser `rows × columns` grid: energy is kept exactly.
    /// Cells that the source does not divide evenly take fractional pixels.
    #[must_use]
    pub fn prefiltered(&self, rows: usize, columns: usize) -> Self {
        let along = overlaps(self.width, columns);
        let down = overlaps(self.height, rows);
        let mut pixels = vec![[0.0_f32; 3]; rows * columns];
        for (r, ys) in down.iter().enumerate() {
            for (c, xs) in along.iter().enumerate() {
                let (mut sum, mut total) = ([0.0_f64; 3], 0.0_f64);
                for &(y, wy) in ys {
                    let row = f64::from(Self::solid_angle(y, self.height, self.width)) * wy;
                    for &(x, wx) in xs {
                        let (p, w) = (self.pixels[y * self.width + x], row * wx);
                        for k in 0..3 {
                            sum[k] += w * f64::from(p[k]);
                        }
                        total += w;
                    }
                }
                pixels[r * columns + c] = sum.map(|s| (s / total) as f32);
            }
        }
        Self {
            width: columns,
            height: rows,
            pixels,
        }
    }

    /// The map with at most `rows` rows and twice as many columns: finer ones are averaged ([`Self::prefiltered`]).
    #[must_use]
    pub fn at_most(&self, rows: usize) -> Cow<'_, Self> {
        if self.height <= rows && self.width <= 2 * rows {
            Cow::Borrowed(self)
        } else {
            Cow::Owned(self.prefiltered(rows, 2 * rows))
        }
    }

    /// Integral of the radiance over the sphere, per channel.
    #[must_use]
    pub fn energy(&self) -> [f64; 3] {
        let mut sum = [0.0; 3];
        for (y, row) in self.pixels.chunks(self.width).enumerate() {
            let w = f64::from(Self::solid_angle(y, self.height, self.width));
            for p in row {
                for k in 0..3 {
                    sum[k] += w * f64::from(p[k]);
                }
            }
        }
        sum
    }

    /// Checks the size and that radiance is finite, not negative and somewhere above zero.
    ///
    /// # Errors
    /// Names the first bad pixel.
    pub fn validate(&self) -> Result<()> {
        if self.width == 0 || self.height == 0 || self.pixels.len() != self.width * self.height {
            return Err(Error::value(
                "size",
                "expected an environment map of at least 1×1 pixels",
            ));
        }
        if let Some(i) = self
            .pixels
            .iter()
            .position(|p| p.iter().any(|v| !v.is_finite() || *v < 0.0))
        {
            let (x, y) = (i % self.width, i / self.width);
            let expected = format!("expected finite radiance ≥ 0, found {:?}", self.pixels[i]);
            return Err(Error::value(format!("pixel ({x}, {y})"), expected));
        }
        if self.energy().iter().all(|e| *e <= 0.0) {
            return Err(Error::value(
                "radiance",
                "expected an environment map with some light in it, found zero energy",
            ));
        }
        Ok(())
    }
}

/// For each of `to` equal cells, the source samples out of `from` it covers, with the covered fraction.
fn overlaps(from: usize, to: usize) -> Vec<Vec<(usize, f64)>> {
    (0..to)
        .map(|i| {
            let (a, b) = (
                i as f64 * from as f64 / to as f64,
                (i + 1) as f64 * from as f64 / to as f64,
            );
            (a.floor() as usize..(b.ceil() as usize).min(from))
                .map(|j| (j, (b.min((j + 1) as f64) - a.max(j as f64)).max(0.0)))
                .filter(|&(_, w)| w > 1e-9)
                .collect()
        })
        .collect()
}

impl<M> Environment<M> {
    /// A map as it stands in the world: `rotation` maps a direction of the map to a world direction.
    #[must_use]
    pub fn oriented(map: M, rotation: Mat3, strength: [f32; 3]) -> Self {
        Self {
            map,
            rotate: 0.0,
            rotation,
            strength,
        }
    }

    /// Orientation of the map in the world; maps a direction of the map to a world direction.
    #[must_use]
    pub fn orientation(&self) -> Mat3 {
        self.rotation * Mat3::from_rotation_z(self.rotate.to_radians())
    }

    pub(super) fn check(&self) -> Result<()> {
        some_light("environment", "strength", self.strength)?;
        let turned = self.orientation();
        if !(turned.transpose() * turned).abs_diff_eq(Mat3::IDENTITY, 1e-3) {
            let text = format!("a rotation, found {:?}", turned.to_cols_array());
            return Err(field::expected("environment", "rotation", text));
        }
        Ok(())
    }
}

impl Environment {
    /// `map` turned by `rotation_z` radians about +z (counter-clockwise from above) and scaled.
    #[must_use]
    pub fn new(map: Arc<EnvMap>, rotation_z: f32, strength: f32) -> Self {
        Self::oriented(map, Mat3::from_rotation_z(rotation_z), [strength; 3])
    }

    /// Radiance arriving from the world direction `d` (unit, pointing away from the scene).
    #[must_use]
    pub fn radiance(&self, d: Vec3) -> [f32; 3] {
        let l = self.map.lookup(self.orientation().transpose() * d);
        std::array::from_fn(|k| l[k] * self.strength[k])
    }

    pub(super) fn scaled(&self, gain: [f32; 3]) -> Self {
        Self {
            strength: std::array::from_fn(|k| self.strength[k] * gain[k]),
            ..self.clone()
        }
    }

    pub(super) fn transformed(&self, s: &Similarity) -> Self {
        Self {
            rotation: s.rotation * self.rotation,
            ..self.clone()
        }
    }

    pub(super) fn rays(&self, pattern: &RayPattern) -> LightRays {
        let (rows, columns) = (pattern.environment_rows, pattern.environment_columns);
        // The grid is fixed in the world, so the map is prefiltered in its own frame at four times
        // the resolution first and then averaged over each world cell: a rotation moves light between
        // cells without losing any.
        let fine = self.map.prefiltered(4 * rows, 4 * columns);
        let orientation = self.orientation();
        let mut grid = vec![[0.0_f32; 3]; rows * columns];
        for (i, radiance) in fine.pixels.iter().enumerate() {
            let (y, x) = (i / fine.width, i % fine.width);
            let local = EnvMap::direction(
                (x as f32 + 0.5) / fine.width as f32,
                (y as f32 + 0.5) / fine.height as f32,
            );
            let d = orientation * local;
            let column =
                (((0.5 - d.y.atan2(d.x) / TAU) * columns as f32) as usize).min(columns - 1);
            let row = ((d.z.clamp(-1.0, 1.0).acos() / PI * rows as f32) as usize).min(rows - 1);
            let solid = EnvMap::solid_angle(y, fine.height, fine.width);
            for k in 0..3 {
                grid[row * columns + column][k] += radiance[k] * solid * self.strength[k];
            }
        }
        grid.iter()
            .enumerate()
            .map(|(i, &irradiance)| LightRay {
                origin: None,
                direction: -EnvMap::direction(
                    (i % columns) as f32 / columns as f32 + 0.5 / columns as f32,
                    (i / columns) as f32 / rows as f32 + 0.5 / rows as f32,
                ),
                irradiance,
            })
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_look_where_the_convention_says() {
        for (u, d) in [(0.5, Vec3::X), (0.25, Vec3::Y), (0.75, Vec3::NEG_Y)] {
            assert!(EnvMap::direction(u, 0.5).distance(d) < 1e-6);
        }
        let mut map = EnvMap {
            width: 8,
            height: 4,
            pixels: vec![[0.0; 3]; 32],
        };
        map.pixels[8 + 2] = [1.0; 3]; // u = 2.5/8, v = 1.5/4
        assert_eq!(
            map.lookup(EnvMap::direction(2.5 / 8.0, 1.5 / 4.0))[0].round(),
            1.0
        );
    }

    #[test]
    fn solid_angles_cover_the_sphere() {
        let sum: f32 = (0..16).map(|r| 32.0 * EnvMap::solid_angle(r, 16, 32)).sum();
        assert!((sum - 4.0 * PI).abs() < 1e-4);
    }

    #[test]
    fn prefilter_and_rays_keep_energy_under_rotation() {
        let pixels = (0..30 * 15)
            .map(|i| [(i % 7) as f32, (i % 3) as f32, 1.0])
            .collect();
        let map = Arc::new(EnvMap {
            width: 30,
            height: 15,
            pixels,
        });
        let energy = map.energy();
        assert_eq!(*map.at_most(15), *map);
        assert_eq!(map.at_most(14).width, 28);
        let coarse = map.prefiltered(4, 8).energy();
        let light = Environment::new(map, 0.3, 2.0);
        let rays = light.rays(&RayPattern::default());
        for k in 0..3 {
            assert!((coarse[k] - energy[k]).abs() < 1e-4 * energy[k]);
            let sum: f64 = rays.iter().map(|r| f64::from(r.irradiance[k])).sum();
            assert!((sum - 2.0 * energy[k]).abs() < 1e-3 * sum);
        }
    }

    #[test]
    fn rotation_turns_counter_clockwise() {
        let mut pixels = vec![[0.0; 3]; 64 * 32];
        pixels[16 * 64 + 32] = [100.0; 3]; // looks along +x
        let light = Environment::new(
            Arc::new(EnvMap {
                width: 64,
                height: 32,
                pixels,
            }),
            PI / 2.0,
            1.0,
        );
        let brightest = light
            .rays(&RayPattern::default())
            .into_iter()
            .max_by(|a, b| a.irradiance[0].total_cmp(&b.irradiance[0]))
            .expect("rays");
        // The light now comes from +y and so travels along −y.
        assert!(brightest.direction.dot(Vec3::NEG_Y) > 0.95);
    }

    #[test]
    fn zero_energy_and_nan_are_errors() {
        let dark = EnvMap::uniform([0.0; 3])
            .validate()
            .expect_err("dark")
            .to_string();
        assert!(dark.contains("zero energy"), "{dark}");
        let bad = EnvMap::uniform([f32::NAN; 3])
            .validate()
            .expect_err("nan")
            .to_string();
        assert!(bad.contains("pixel (0, 0)"), "{bad}");
    }
}
