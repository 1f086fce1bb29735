//! Peak signal-to-noise ratio, −10·log₁₀ of the mean squared error at peak 1.

use lumi_core::DisplayImage;
use lumi_core::color::{srgb_decode, srgb_encode};

/// Equal images would give infinity; the mean squared error is floored here, at 100 dB.
const FLOOR: f64 = 1e-10;

/// Over the whole image, in dB.
///
/// # Panics
/// If the sizes differ.
#[must_use]
pub fn psnr(a: &DisplayImage, b: &DisplayImage) -> f64 {
    psnr_where(a, b, &|_| true)
}

/// Over the pixels whose index `keep` accepts, in dB; NaN if there are none.
///
/// # Panics
/// If the sizes differ.
#[must_use]
pub fn psnr_where(a: &DisplayImage, b: &DisplayImage, keep: &dyn Fn(usize) -> bool) -> f64 {
    over(a, b, keep, |v| v)
}

/// As [`psnr_where`], of the linear values behind the display encoding.
///
/// # Panics
/// If the sizes differ.
#[must_use]
pub fn psnr_linear_where(a: &DisplayImage, b: &DisplayImage, keep: &dyn Fn(usize) -> bool) -> f64 {
    over(a, b, keep, srgb_decode)
}

fn over(
    a: &DisplayImage,
    b: &DisplayImage,
    keep: &dyn Fn(usize) -> bool,
    value: fn(f32) -> f32,
) -> f64 {
    assert_eq!(
        (a.width, a.height),
        (b.width, b.height),
        "images of one size"
    );
    let (mut sum, mut count) = (0.0_f64, 0_u64);
    for (i, (p, q)) in a.pixels.iter().zip(&b.pixels).enumerate() {
        if keep(i) {
            sum += (0..3)
                .map(|c| f64::from(value(p[c]) - value(q[c])).powi(2))
                .sum::<f64>();
            count += 3;
        }
    }
    if count == 0 {
        return f64::NAN;
    }
    -10.0 * (sum / count as f64).max(FLOOR).log10()
}

/// Where PSNR-H clips linear values.
const HIGH: f32 = 4.0;

/// PSNR-H of Stanford-ORB, in dB: of linear values, both images brightened by the ratio of the truth's mean display
/// value to its mean linear value (photographs are dark in linear colour), then clipped to [0, 4]; the peak is 1.
/// No lower than that of `floor`, which is not brightened.
///
/// # Panics
/// If the lengths differ.
#[must_use]
pub fn psnr_high_range(
    prediction: &[[f32; 3]],
    truth: &[[f32; 3]],
    floor: Option<&[[f32; 3]]>,
) -> f64 {
    assert_eq!(prediction.len(), truth.len(), "images of one size");
    let sum = |value: fn(f32) -> f32| -> f64 {
        let values = truth.iter().flatten();
        values.map(|v| f64::from(value(v.clamp(0.0, 1.0)))).sum()
    };
    let ratio = (sum(srgb_encode) / sum(|v| v)) as f32;
    let gain = if ratio.is_finite() { ratio } else { 1.0 };
    let seen = |v: f32| (gain * v).clamp(0.0, HIGH);
    let compared = |image: &[[f32; 3]], value: &dyn Fn(f32) -> f32| {
        let pairs = image.iter().flatten().zip(truth.iter().flatten());
        let errors = pairs.map(|(p, t)| f64::from(value(*p) - seen(*t)).powi(2));
        let mse = errors.sum::<f64>() / (3 * truth.len()).max(1) as f64;
        -10.0 * mse.max(FLOOR).log10()
    };
    let value = compared(prediction, &seen);
    floor.map_or(value, |f| value.max(compared(f, &|v| v)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn high_range_values() {
        let truth = [[0.25_f32; 3], [2.0; 3]];
        // Mean display value over mean linear value of the clipped truth.
        let gain = (srgb_encode(0.25) + 1.0) / 1.25;
        let expected = -10.0 * f64::from(0.5 * (0.1 * gain).powi(2)).log10();
        let found = psnr_high_range(&[[0.35; 3], [2.0; 3]], &truth, None);
        assert!(
            (found - expected).abs() < 1e-3,
            "{found}, expected {expected}"
        );
        // Clipped to white, the highlight is missed.
        let clipped = psnr_high_range(&[[0.25; 3], [1.0; 3]], &truth, None);
        let expected = -10.0 * f64::from(0.5 * gain.powi(2)).log10();
        assert!(
            (clipped - expected).abs() < 1e-3,
            "{clipped}, expected {expected}"
        );
        assert_eq!(psnr_high_range(&truth, &truth, None), 100.0);
        // Above 4 nobody looks.
        let far = [[5.0_f32; 3], [10.0; 3]];
        assert_eq!(psnr_high_range(&[[4.5; 3], [9.0; 3]], &far, None), 100.0);
        let wrong = [[2.0; 3], [0.0; 3]];
        let floor = psnr_high_range(&wrong, &truth, Some(&[[0.5; 3]; 2]));
        let errors = (0.5 - 0.25 * gain).powi(2) + (0.5 - 2.0 * gain).powi(2);
        let expected = -10.0 * f64::from(0.5 * errors).log10();
        assert!(
            (floor - expected).abs() < 1e-3,
            "{floor}, expected {expected}"
        );
        assert!(psnr_high_range(&wrong, &truth, None) < floor);
    }

    #[test]
    fn known_values() {
        let a = DisplayImage::filled(4, 3, [0.5; 3]);
        let b = DisplayImage::filled(4, 3, [0.6; 3]);
        assert!((psnr(&a, &b) - 20.0).abs() < 1e-4);
        assert_eq!(psnr(&a, &a), 100.0);
        assert!(psnr_where(&a, &b, &|_| false).is_nan());
    }
}
