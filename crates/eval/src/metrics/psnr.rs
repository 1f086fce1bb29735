//! Peak signal-to-noise ratio, −10·log₁₀ of the mean squared error at peak 1.

use lumi_core::DisplayImage;
use lumi_core::color::srgb_decode;

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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn known_values() {
        let a = DisplayImage::filled(4, 3, [0.5; 3]);
        let b = DisplayImage::filled(4, 3, [0.6; 3]);
        assert!((psnr(&a, &b) - 20.0).abs() < 1e-4);
        assert_eq!(psnr(&a, &a), 100.0);
        assert!(psnr_where(&a, &b, &|_| false).is_nan());
    }
}
