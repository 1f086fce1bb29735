//! Smooths the indirect part of a render, guided by what the camera saw first.
//!
//! Indirect light is smooth over a surface but noisy at few paths per pixel, above all in shadows, where the sRGB
//! curve magnifies it and, being concave, turns noise into darkness. Direct light is left alone: shadows and highlights
//! stay sharp. The filter is an edge-avoiding à-trous wavelet (Dammertz et al. 2010) whose weights come from geometry
//! only, so one set of weights serves every light and a sum of lights is filtered as the lights are.

use lumi_core::glam::Vec3;

/// What the camera saw first in a pixel, summed over its samples.
#[derive(Clone, Copy, Debug, Default)]
pub struct Feature {
    /// Positions.
    pub position: Vec3,
    /// Shading normals.
    pub normal: Vec3,
    /// Base colours.
    pub base: Vec3,
    /// How far indirect light may be smoothed, 0 for mirrors to 1 for diffuse surfaces.
    pub blur: f32,
    /// Number of samples that hit the object.
    pub hits: f32,
}

/// Added to base colours before light is divided by them, so that black surfaces divide by something.
const BASE_FLOOR: f32 = 0.05;
/// One row of the B3 spline that weights the 5 × 5 taps.
const SPLINE: [f32; 5] = [1.0 / 16.0, 0.25, 0.375, 0.25, 1.0 / 16.0];

/// Filters `indirect`, `[y, x, light]` premultiplied, in place, as seen from `eye`; `pixel` is the size of a pixel at
/// distance 1.
pub fn smooth(indirect: &mut [Vec3], features: &[Feature], width: usize, eye: Vec3, pixel: f32) {
    let lights = indirect.len() / features.len().max(1);
    let height = features.len() / width;
    let guides: Vec<Option<Guide>> = features.iter().map(Guide::new).collect();
    // Light without the surface's colour: patterns do not stop the filter and are not blurred by it.
    let mut light: Vec<Vec3> = Vec::with_capacity(indirect.len());
    for (pixel, feature) in indirect.chunks(lights).zip(features) {
        let scale = modulation(feature).map_or(Vec3::ZERO, Vec3::recip);
        light.extend(pixel.iter().map(|v| *v * scale));
    }
    let original = light.clone();
    // Each pass doubles the reach: 6 pixels at 64, 14 at 128, 30 at 256 and more.
    let passes = match width {
        0..=96 => 2,
        97..=192 => 3,
        _ => 4,
    };
    let mut next = light.clone();
    for pass in 0..passes {
        let step = 1_isize << pass;
        for y in 0..height {
            for x in 0..width {
                let p = y * width + x;
                let Some(centre) = &guides[p] else {
                    continue;
                };
                let reach = pixel * eye.distance(centre.position) * step as f32;
                let out = &mut next[p * lights..][..lights];
                out.fill(Vec3::ZERO);
                let mut total = 0.0;
                for (j, wy) in SPLINE.iter().enumerate() {
                    for (i, wx) in SPLINE.iter().enumerate() {
                        let qx = x as isize + (i as isize - 2) * step;
                        let qy = y as isize + (j as isize - 2) * step;
                        if qx < 0 || qy < 0 || qx >= width as isize || qy >= height as isize {
                            continue;
                        }
                        let q = qy as usize * width + qx as usize;
                        let Some(other) = &guides[q] else {
                            continue;
                        };
                        let w = wx * wy * centre.likeness(other, reach);
                        if w < 1e-4 {
                            continue;
                        }
                        total += w;
                        let source = &light[q * lights..][..lights];
                        for (o, s) in out.iter_mut().zip(source) {
                            *o += w * *s;
                        }
                    }
                }
                if total > 0.0 {
                    for o in out {
                        *o /= total;
                    }
                } else {
                    // Opposite normals that cancel are like nothing, not even themselves.
                    out.copy_from_slice(&light[p * lights..][..lights]);
                }
            }
        }
        std::mem::swap(&mut light, &mut next);
    }
    for (p, feature) in features.iter().enumerate() {
        let (Some(guide), Some(scale)) = (&guides[p], modulation(feature)) else {
            continue;
        };
        for l in p * lights..(p + 1) * lights {
            indirect[l] = original[l].lerp(light[l], guide.blur) * scale;
        }
    }
}

/// Base colour times hits: what indirect light is divided by.
fn modulation(feature: &Feature) -> Option<Vec3> {
    (feature.hits > 0.0).then(|| feature.base + BASE_FLOOR * feature.hits)
}

/// A pixel's mean feature.
struct Guide {
    position: Vec3,
    normal: Vec3,
    blur: f32,
    /// Pixels at outlines saw less of the object and are noisier.
    weight: f32,
}

impl Guide {
    fn new(feature: &Feature) -> Option<Self> {
        (feature.hits > 0.0).then(|| Self {
            position: feature.position / feature.hits,
            normal: feature.normal.normalize_or_zero(),
            blur: feature.blur / feature.hits,
            weight: feature.hits,
        })
    }

    /// How much `other` may tell about this pixel.
    fn likeness(&self, other: &Self, reach: f32) -> f32 {
        let d = other.position - self.position;
        // Distance from this pixel's tangent plane separates surfaces in front of each other;
        // distance along it separates what only lines up in the image.
        let off = self.normal.dot(d) / (0.7 * reach);
        let along = d.length_squared() / (36.0 * reach * reach);
        let turn = self.normal.dot(other.normal).max(0.0).powi(8);
        other.weight * turn * (-off * off - along).exp()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// About 4 away.
    const EYE: Vec3 = Vec3::new(0.3, 0.3, 4.0);

    fn feature(x: usize, z: f32, normal: Vec3) -> Feature {
        Feature {
            position: Vec3::new(0.04 * x as f32, 0.0, z),
            normal,
            base: Vec3::splat(0.5),
            blur: 1.0,
            hits: 1.0,
        }
    }

    #[test]
    fn constants_stay_and_edges_stop_the_filter() {
        // Left half a floor, right half a wall; light differs.
        let features: Vec<Feature> = (0..256)
            .map(|i| {
                let x = i % 16;
                let normal = if x < 8 { Vec3::Z } else { Vec3::NEG_X };
                let mut f = feature(x, 0.0, normal);
                f.position.y = 0.04 * (i / 16) as f32;
                f
            })
            .collect();
        let noise = |i: usize| 1.0 + if (i * 7919) % 13 < 6 { 0.5 } else { -0.5 };
        let mut light: Vec<Vec3> = (0..256)
            .map(|i| Vec3::splat(if i % 16 < 8 { noise(i) } else { 10.0 }))
            .collect();
        smooth(&mut light, &features, 16, EYE, 0.01);
        for (i, v) in light.iter().enumerate() {
            if i % 16 < 8 {
                assert!((v.x - 0.96).abs() < 0.25, "{i}: {v}");
            } else {
                assert!((v.x - 10.0).abs() < 1e-4, "{i}: {v}");
            }
        }
    }

    #[test]
    fn mirrors_are_left_alone() {
        let features: Vec<Feature> = (0..64)
            .map(|i| Feature {
                blur: 0.0,
                ..feature(i % 8, 0.0, Vec3::Z)
            })
            .collect();
        let mut light: Vec<Vec3> = (0..64).map(|i| Vec3::splat((i % 3) as f32)).collect();
        let before = light.clone();
        smooth(&mut light, &features, 8, EYE, 0.01);
        assert!(
            light
                .iter()
                .zip(&before)
                .all(|(a, b)| a.distance(*b) < 1e-5)
        );
    }
}
