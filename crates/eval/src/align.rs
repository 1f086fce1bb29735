//! Least-squares scale alignment: relighting is judged up to the exposure, per image (ILR) or per scene (SLR).

use lumi_core::DisplayImage;
use lumi_core::color::{srgb_decode, srgb_encode};

/// Per-channel factors on linear colour.
pub type Scale = [f32; 3];

/// Factors that bring predictions closest to the truth, in linear colour, over the object's pixels (weighted by
/// the truth's alpha): `Σ a·p·t / Σ a·p²` per channel. One where a channel has no light at all.
#[must_use]
pub fn fit(pairs: &[(&DisplayImage, &DisplayImage)]) -> Scale {
    let mut sums = [[0.0_f64; 2]; 3];
    for (prediction, truth) in pairs {
        for (i, (p, t)) in prediction.pixels.iter().zip(&truth.pixels).enumerate() {
            let weight = f64::from(alpha(truth, i));
            for c in 0..3 {
                let (p, t) = (f64::from(srgb_decode(p[c])), f64::from(srgb_decode(t[c])));
                sums[c][0] += weight * p * t;
                sums[c][1] += weight * p * p;
            }
        }
    }
    sums.map(|[pt, pp]| if pp > 0.0 { (pt / pp) as f32 } else { 1.0 })
}

/// The prediction with its object (the truth's alpha) scaled in linear colour; the background stays.
#[must_use]
pub fn apply(prediction: &DisplayImage, truth: &DisplayImage, scale: Scale) -> DisplayImage {
    let mut image = prediction.clone();
    for (i, pixel) in image.pixels.iter_mut().enumerate() {
        let a = alpha(truth, i);
        for c in 0..3 {
            pixel[c] = a * srgb_encode(scale[c] * srgb_decode(pixel[c])) + (1.0 - a) * pixel[c];
        }
    }
    image
}

fn alpha(truth: &DisplayImage, i: usize) -> f32 {
    truth.alpha.as_ref().map_or(1.0, |a| a[i])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_scaled_image_aligns_exactly() {
        let linear = [0.1_f32, 0.3, 0.02];
        let image = |k: f32| DisplayImage::filled(3, 2, linear.map(|v| srgb_encode(k * v)));
        let (half, truth) = (image(0.5), image(1.0));
        let scale = fit(&[(&half, &truth)]);
        assert!(scale.iter().all(|s| (s - 2.0).abs() < 1e-4), "{scale:?}");
        let aligned = apply(&half, &truth, scale);
        assert!((aligned.pixels[0][1] - truth.pixels[0][1]).abs() < 1e-5);
    }

    #[test]
    fn the_background_is_left_alone() {
        let mut truth = DisplayImage::filled(2, 1, [0.5; 3]);
        truth.alpha = Some(vec![1.0, 0.0]);
        let out = apply(&DisplayImage::filled(2, 1, [0.2; 3]), &truth, [3.0; 3]);
        assert_eq!(out.pixels[1], [0.2; 3]);
        assert!(out.pixels[0][0] > 0.3);
    }
}
