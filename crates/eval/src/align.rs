//! Least-squares scale alignment: relighting is judged up to the exposure, per image (ILR) or per scene (SLR),
//! with a scale for each channel or one for all.

use crate::picture::Picture;
use lumi_core::color::srgb_encode;

/// Per-channel factors on linear colour.
pub type Scale = [f32; 3];

/// Factors that bring predictions closest to the truth, in linear colour, over the object's pixels (weighted by
/// the truth's alpha): `Σ a·p·t / Σ a·p²` per channel. One where a channel has no light at all.
#[must_use]
pub fn fit(pairs: &[(&Picture, &Picture)]) -> Scale {
    sums(pairs).map(ratio)
}

/// As [`fit`], one factor for all channels.
#[must_use]
pub fn fit_scalar(pairs: &[(&Picture, &Picture)]) -> Scale {
    let [r, g, b] = sums(pairs);
    [ratio([r[0] + g[0] + b[0], r[1] + g[1] + b[1]]); 3]
}

fn ratio([pt, pp]: [f64; 2]) -> f32 {
    if pp > 0.0 { (pt / pp) as f32 } else { 1.0 }
}

/// `[Σ a·p·t, Σ a·p²]` per channel.
fn sums(pairs: &[(&Picture, &Picture)]) -> [[f64; 2]; 3] {
    let mut sums = [[0.0_f64; 2]; 3];
    for (prediction, truth) in pairs {
        for i in 0..truth.shown.pixels.len() {
            let weight = f64::from(alpha(truth, i));
            let (p, t) = (prediction.linear_at(i), truth.linear_at(i));
            for c in 0..3 {
                let (p, t) = (f64::from(p[c]), f64::from(t[c]));
                sums[c][0] += weight * p * t;
                sums[c][1] += weight * p * p;
            }
        }
    }
    sums
}

/// The prediction with its object (the truth's alpha) scaled in linear colour; the background stays.
///
/// # Panics
/// If the prediction is smaller than the truth.
#[must_use]
pub fn apply(prediction: &Picture, truth: &Picture, scale: Scale) -> Picture {
    let mut scaled = prediction.clone();
    for (i, pixel) in scaled.shown.pixels.iter_mut().enumerate() {
        let a = alpha(truth, i);
        let linear = prediction.linear_at(i);
        for c in 0..3 {
            pixel[c] = a * srgb_encode(scale[c] * linear[c]) + (1.0 - a) * pixel[c];
        }
    }
    for (i, linear) in scaled.linear.iter_mut().flatten().enumerate() {
        if alpha(truth, i) > 0.5 {
            *linear = std::array::from_fn(|c| scale[c] * linear[c]);
        }
    }
    scaled
}

/// How far per-view scales are apart: the standard deviation of their natural logarithms. 0 for a method that is
/// consistent across views whatever its exposure; 0.1 means about ten percent. `None` for fewer than two views.
#[must_use]
pub fn spread(scales: &[f32]) -> Option<f64> {
    let logs: Vec<f64> = scales.iter().map(|s| f64::from(s.max(1e-6)).ln()).collect();
    let n = logs.len() as f64;
    let mean = logs.iter().sum::<f64>() / n;
    let variance = logs.iter().map(|l| (l - mean).powi(2)).sum::<f64>() / n;
    (logs.len() > 1).then(|| variance.sqrt())
}

fn alpha(truth: &Picture, i: usize) -> f32 {
    truth.shown.alpha.as_ref().map_or(1.0, |a| a[i])
}

#[cfg(test)]
mod tests {
    use super::*;
    use lumi_core::DisplayImage;

    fn filled(width: usize, height: usize, color: [f32; 3]) -> Picture {
        DisplayImage::filled(width, height, color).into()
    }

    #[test]
    fn a_scaled_image_aligns_exactly() {
        let linear = [0.1_f32, 0.3, 0.02];
        let image = |k: f32| filled(3, 2, linear.map(|v| srgb_encode(k * v)));
        let (half, truth) = (image(0.5), image(1.0));
        for scale in [fit(&[(&half, &truth)]), fit_scalar(&[(&half, &truth)])] {
            assert!(scale.iter().all(|s| (s - 2.0).abs() < 1e-4), "{scale:?}");
            let aligned = apply(&half, &truth, scale);
            assert!((aligned.shown.pixels[0][1] - truth.shown.pixels[0][1]).abs() < 1e-5);
        }
    }

    #[test]
    fn one_scale_for_all_channels_keeps_the_hue() {
        let truth = filled(1, 1, [0.5, 0.5, 0.5].map(srgb_encode));
        let tinted = filled(1, 1, [0.25, 0.5, 0.5].map(srgb_encode));
        let scale = fit_scalar(&[(&tinted, &truth)]);
        // Σpt / Σp² = (0.125 + 0.25 + 0.25) / (0.0625 + 0.25 + 0.25)
        assert!((scale[0] - 0.625 / 0.5625).abs() < 1e-4, "{scale:?}");
        assert!((fit(&[(&tinted, &truth)])[0] - 2.0).abs() < 1e-4);
    }

    #[test]
    fn the_background_is_left_alone() {
        let mut truth = filled(2, 1, [0.5; 3]);
        truth.shown.alpha = Some(vec![1.0, 0.0]);
        let out = apply(&filled(2, 1, [0.2; 3]), &truth, [3.0; 3]);
        assert_eq!(out.shown.pixels[1], [0.2; 3]);
        assert!(out.shown.pixels[0][0] > 0.3);
    }

    #[test]
    fn what_a_display_clips_is_aligned_before_it_is_clipped() {
        let mut truth = filled(2, 1, [1.0; 3]);
        truth.linear = Some(vec![[0.5; 3], [2.0; 3]]);
        let mut bright = filled(2, 1, [1.0; 3]);
        bright.linear = Some(vec![[5.0; 3], [20.0; 3]]);
        let scale = fit(&[(&bright, &truth)]);
        assert!((scale[0] - 0.1).abs() < 1e-6, "{scale:?}");
        let out = apply(&bright, &truth, scale);
        assert!((out.shown.pixels[0][0] - srgb_encode(0.5)).abs() < 1e-6);
        let linear = out.linear.expect("linear values");
        assert!((linear[1][2] - 2.0).abs() < 1e-5);
    }

    #[test]
    fn spread_ignores_the_common_scale() {
        assert!(spread(&[2.0]).is_none());
        assert!(spread(&[3.0, 3.0, 3.0]).expect("views") < 1e-9);
        let (a, b) = (spread(&[0.9, 1.1]), spread(&[1.8, 2.2]));
        assert!((a.expect("views") - b.expect("views")).abs() < 1e-6);
    }
}
