//! What a network with `output = "radiance"` is told of an edit's light: its shape and its share, never its power
//! ([`crate::illumination`]).
//!
//! With eᵢ the irradiance of ray i at the scene's centre and dᵢ its direction, sᵢ = eᵢ / Σe is the ray's part of its light
//! in each colour channel by itself, and w the light's share of all light. Rays are told by w·sᵢ; the light as a whole by its
//! moments w·Σs, w·Σs·d and w·Σs·ddᵀ, which every scene token gets as its own frame sees them
//! (docs/decisions/0009-light-moments.md): a matte surface's irradiance is nearly a quadratic polynomial of its normal with
//! such coefficients (Ramamoorthi and Hanrahan, SIGGRAPH 2001).

use crate::config::Mode;
use crate::illumination::{Change, Illumination, irradiance};
use lumi_core::Result;
use lumi_core::glam::{Mat3, Vec3};
use lumi_core::light::LightRay;
use lumi_kernels::FRAME;

/// Numbers per light ray: direction, moment, and of each channel's w·s the logarithm and the root.
pub const SHAPE_FEATURES: usize = 12;

/// Numbers of a light's moments: 3 of order 0, 9 of order 1, 27 of order 2, and one per mode.
pub const MOMENTS: usize = 39 + Mode::ALL.len();

/// Below this part of a light, logarithms end.
const LEAST: f64 = 1e-5;

/// An edit's light for a network with `output = "radiance"`, in model space.
#[derive(Clone, Debug, PartialEq)]
pub struct LightShape {
    /// `[rays, SHAPE_FEATURES]`
    pub rays: Vec<f32>,
    /// In model space.
    pub moments: [f32; MOMENTS],
    /// How far the edit may change the tokens ([`Change::reach`]).
    pub reach: f32,
}

impl LightShape {
    /// Of rays in model space and what they do to a scene's illumination.
    ///
    /// # Errors
    /// As [`Illumination::change`].
    pub fn new(rays: &[LightRay], mode: Mode, before: Illumination) -> Result<(Self, Change)> {
        let whole = irradiance(rays);
        let change = before.change(mode, whole)?;
        let lit = whole.iter().filter(|e| **e > 0.0).count().max(1) as f64;
        let part = |ray: &LightRay| -> [f64; 3] {
            let shape = [0, 1, 2].map(|c| {
                let e = f64::from(ray.irradiance[c]);
                if whole[c] > 0.0 { e / whole[c] } else { 0.0 }
            });
            // A channel without light has the others' shape: tint is not told, so the others must not notice.
            let mean = shape.iter().sum::<f64>() / lit;
            std::array::from_fn(|c| change.share[c] * if whole[c] > 0.0 { shape[c] } else { mean })
        };
        let mut features = Vec::with_capacity(rays.len() * SHAPE_FEATURES);
        let mut sums = [[0.0_f64; 13]; 3];
        for ray in rays {
            let parts = part(ray);
            let d = ray.direction;
            features.extend(d.to_array());
            features.extend(ray.moment().to_array());
            // Both are between −1.5 and 1.5.
            features.extend(parts.map(|w| (w.max(LEAST).ln() / 4.0 + 1.4) as f32));
            features.extend(parts.map(|w| w.sqrt() as f32));
            let d = d.to_array().map(f64::from);
            for (sums, w) in sums.iter_mut().zip(parts) {
                sums[0] += w;
                for i in 0..3 {
                    sums[1 + i] += w * d[i];
                    for j in 0..3 {
                        sums[4 + 3 * i + j] += w * d[i] * d[j];
                    }
                }
            }
        }
        let mut moments = [0.0; MOMENTS];
        for (c, sums) in sums.iter().enumerate() {
            moments[c] = sums[0] as f32;
            for i in 0..3 {
                moments[3 + 3 * c + i] = sums[1 + i] as f32;
            }
            for i in 0..9 {
                moments[12 + 9 * c + i] = sums[4 + i] as f32;
            }
        }
        for (flag, of) in moments[39..].iter_mut().zip(Mode::ALL) {
            *flag = if of == mode { 1.0 } else { 0.0 };
        }
        let shape = Self {
            rays: features,
            moments,
            reach: change.reach() as f32,
        };
        Ok((shape, change))
    }
}

/// Moments as tokens with these frames see them, appended to `out`.
///
/// # Shapes
/// moments `[MOMENTS]`, frames `[n, 12]` → `[n, MOMENTS]`
pub fn seen_from(moments: &[f32; MOMENTS], frames: &[f32], out: &mut Vec<f32>) {
    for frame in frames.chunks_exact(FRAME) {
        // Row by row, so as columns it is transposed: what takes model space's vectors into the token's own.
        let back = Mat3::from_cols_slice(&frame[..9]);
        let start = out.len();
        out.extend(moments);
        let own = &mut out[start..];
        for c in 0..3 {
            let at = 3 + 3 * c;
            let first = back * Vec3::from_slice(&moments[at..]);
            own[at..at + 3].copy_from_slice(&first.to_array());
            let at = 12 + 9 * c;
            // Symmetric, so rows and columns are the same.
            let second = Mat3::from_cols_slice(&moments[at..at + 9]);
            let second = back * second * back.transpose();
            own[at..at + 9].copy_from_slice(&second.to_cols_array());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use lumi_core::light::{Point, RayPattern};
    use lumi_core::{Light, Similarity};

    fn rays(rotation: Mat3, power: f32) -> Vec<LightRay> {
        let place = Similarity {
            rotation,
            ..Similarity::IDENTITY
        };
        let at = |x, y, z, share: f32| {
            Light::Point(Point::new(Vec3::new(x, y, z), share * power))
                .transformed(&place)
                .rays(&RayPattern::default())
        };
        [at(1.0, 2.5, 3.0, 0.9), at(-3.0, 0.5, 1.0, 0.5)].concat()
    }

    #[test]
    fn power_and_tint_are_not_told() {
        let of = |gain: [f32; 3]| {
            let mut rays = rays(Mat3::IDENTITY, 1000.0);
            for ray in &mut rays {
                ray.irradiance = std::array::from_fn(|c| ray.irradiance[c] * gain[c]);
            }
            let (shape, change) =
                LightShape::new(&rays, Mode::Set, Illumination::CAPTURED).expect("shape");
            (shape, change.after)
        };
        let (plain, scale) = of([1.0; 3]);
        let (tinted, scaled) = of([4.0, 0.5, 2.0]);
        let (dark, _) = of([0.0, 0.0, 3.0]);
        for other in [&tinted, &dark] {
            for (a, b) in plain.rays.iter().zip(&other.rays) {
                assert!((a - b).abs() < 1e-5, "{a} and {b}");
            }
        }
        for c in 0..3 {
            let ratio = scaled.0[c] / scale.0[c];
            assert!((ratio / [4.0, 0.5, 2.0][c] - 1.0).abs() < 1e-6);
        }
        assert_eq!(plain.reach, 1.0);
    }

    #[test]
    fn a_single_lamp_is_its_direction() {
        let lamp = Light::Point(Point::new(Vec3::new(0.0, 0.0, 4.0), 1000.0));
        let rays = lamp.rays(&RayPattern::default());
        let (shape, _) = LightShape::new(&rays, Mode::Set, Illumination::CAPTURED).expect("shape");
        let m = shape.moments;
        // From the centre the lamp stands along z; its rays go to all of the unit ball.
        assert!((m[0] - 1.0).abs() < 1e-5);
        assert!(m[5] < -0.97, "{}", m[5]);
        assert!(m[12 + 8] > 0.95, "{}", m[12 + 8]);
        let trace: f32 = [0, 4, 8].iter().map(|i| m[12 + i]).sum();
        assert!((trace - m[0]).abs() < 1e-4, "{trace}");
        assert_eq!(m[39..], [1.0, 0.0, 0.0]);
    }

    #[test]
    fn seen_from_a_turned_frame_is_turned_light_seen_from_model_space() {
        let turn = Mat3::from_rotation_z(0.8) * Mat3::from_rotation_x(-0.5);
        let rows = turn.transpose().to_cols_array();
        let frame: Vec<f32> = rows.into_iter().chain([0.3, -0.2, 0.1]).collect();
        let shape = |rotation| {
            let rays = rays(rotation, 1000.0);
            let (shape, _) = LightShape::new(&rays, Mode::Add, Illumination::CAPTURED).expect("ok");
            shape.moments
        };
        let mut seen = Vec::new();
        seen_from(&shape(Mat3::IDENTITY), &frame, &mut seen);
        // In the frame's own space, the lights have been turned the other way.
        let want = shape(turn.transpose());
        for (i, (a, b)) in seen.iter().zip(&want).enumerate() {
            assert!((a - b).abs() < 1e-3, "{i}: {a} and {b}");
        }
    }
}
