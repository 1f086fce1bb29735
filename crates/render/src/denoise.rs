//! Smooths a render, guided by what the camera saw first.
//!
//! Indirect light is smooth over a surface but noisy at few paths per pixel, above all in shadows, where the sRGB
//! curve magnifies it and, being concave, turns noise into darkness. Direct light is left alone: shadows and highlights
//! stay sharp. The filter is an edge-avoiding à-trous wavelet (Dammertz et al. 2010) whose weights come from geometry
//! only, so one set of weights serves every light and a sum of lights is filtered as the lights are.
//!
//! Direct light of environments and squares is smoothed by [`smooth_direct`] over neighbours from which it does not
//! differ by more than the spread of its samples explains: noise goes, shadows stay.

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

/// Direct light may differ between like pixels by this many standard deviations.
const SPREAD: f32 = 2.0;

/// Filters `direct`, `[y, x, light]` premultiplied, in place, for the lights that are `extended`. `squares` are the sums
/// over a pixel's samples of the squared luminance of direct light over [`demodulated`] base colour.
pub fn smooth_direct(
    direct: &mut [Vec3],
    squares: &[f32],
    features: &[Feature],
    extended: &[bool],
    width: usize,
    eye: Vec3,
    pixel: f32,
) {
    let (lights, height) = (extended.len(), features.len() / width);
    let guides: Vec<Option<Guide>> = features.iter().map(Guide::new).collect();
    let mut light = Vec::with_capacity(direct.len());
    let mut means = Vec::with_capacity(direct.len());
    let mut spreads = Vec::with_capacity(direct.len());
    for (p, feature) in features.iter().enumerate() {
        let scale = modulation(feature).map_or(Vec3::ZERO, Vec3::recip);
        let hits = feature.hits.max(1.0);
        for l in p * lights..(p + 1) * lights {
            let v = direct[l] * scale;
            let mean = luminance(v);
            light.push(v);
            means.push(mean);
            // Variance of the mean.
            let variance = (squares[l] / hits - mean * mean).max(0.0);
            spreads.push(variance / (hits - 1.0).max(1.0));
        }
    }
    let mut taps: Vec<(usize, f32)> = Vec::with_capacity(25);
    for y in 0..height {
        for x in 0..width {
            let p = y * width + x;
            let (Some(centre), Some(scale)) = (&guides[p], modulation(&features[p])) else {
                continue;
            };
            let reach = pixel * eye.distance(centre.position);
            taps.clear();
            for (j, wy) in SPLINE.iter().enumerate() {
                for (i, wx) in SPLINE.iter().enumerate() {
                    let (qx, qy) = (x + i, y + j);
                    if qx < 2 || qy < 2 || qx - 2 >= width || qy - 2 >= height {
                        continue;
                    }
                    let q = (qy - 2) * width + qx - 2;
                    if let Some(other) = &guides[q] {
                        let w = wx * wy * centre.likeness(other, reach);
                        if w > 1e-3 {
                            taps.push((q, w));
                        }
                    }
                }
            }
            for l in (0..lights).filter(|&l| extended[l]) {
                // The spread of few samples is itself uncertain, so the neighbours' helps, but must not make up one in
                // full shadow.
                let around: f32 = taps.iter().map(|&(q, w)| w * spreads[q * lights + l]).sum();
                let weights: f32 = taps.iter().map(|&(_, w)| w).sum();
                let spread = (around / weights.max(1e-12)).min(4.0 * spreads[p * lights + l]);
                let own = means[p * lights + l];
                let (mut sum, mut total) = (Vec3::ZERO, 0.0);
                for &(q, w) in &taps {
                    let k = q * lights + l;
                    let difference = means[k] - own;
                    let allowed = SPREAD * SPREAD * (spread + spreads[k].min(spread)) + 1e-12;
                    let excess = difference * difference / allowed;
                    let w = w / ((1.0 + excess) * (1.0 + excess));
                    sum += w * light[k];
                    total += w;
                }
                if total > 0.0 {
                    let own = light[p * lights + l];
                    direct[p * lights + l] = own.lerp(sum / total, centre.blur) * scale;
                }
            }
        }
    }
}

/// Light over what the base colour does to it.
#[must_use]
pub fn demodulated(light: Vec3, base: Vec3) -> f32 {
    luminance(light / (base + BASE_FLOOR))
}

fn luminance(v: Vec3) -> f32 {
    v.dot(Vec3::new(0.2126, 0.7152, 0.0722))
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
    fn noise_of_direct_light_goes_and_its_shadows_stay() {
        // Lit on the left with noise of ±20 %, dark on the right, on one floor.
        let features: Vec<Feature> = (0..256)
            .map(|i| Feature {
                position: Vec3::new(0.04 * (i % 16) as f32, 0.04 * (i / 16) as f32, 0.0),
                hits: 8.0,
                ..feature(0, 0.0, Vec3::Z)
            })
            .map(|f| Feature {
                position: 8.0 * f.position,
                base: 8.0 * f.base,
                blur: 8.0,
                ..f
            })
            .collect();
        let noise = |i: usize| if (i * 7919) % 13 < 6 { 1.2 } else { 0.8 };
        let lit = |i: usize| i % 16 < 8;
        let mut light: Vec<Vec3> = (0..256)
            .map(|i| Vec3::splat(if lit(i) { 8.0 * noise(i) } else { 0.08 }))
            .collect();
        // Samples spread by 0.2 · √8 around their mean make the mean spread by 0.2.
        let squares: Vec<f32> = (0..256)
            .map(|i| {
                let mean = demodulated(light[i] / 8.0, Vec3::splat(0.5));
                let deviation = if lit(i) { 0.57 * mean } else { 0.0 };
                8.0 * (mean * mean + deviation * deviation)
            })
            .collect();
        let before = light.clone();
        smooth_direct(&mut light, &squares, &features, &[true], 16, EYE, 0.01);
        let error = |light: &[Vec3]| {
            let all = (0..256)
                .filter(|&i| lit(i))
                .map(|i| (light[i].x - 8.0).powi(2));
            all.sum::<f32>()
        };
        assert!(error(&light) < 0.25 * error(&before), "{}", error(&light));
        assert!((0..256).all(|i| lit(i) || light[i].x < 0.1));
        let mut alone = before.clone();
        smooth_direct(&mut alone, &squares, &features, &[false], 16, EYE, 0.01);
        assert_eq!(alone, before);
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
