//! Structural similarity (Wang et al. 2004) of colour images: per channel, then the mean over the channels.
//!
//! With [`Window::GAUSSIAN`] it equals scikit-image's `structural_similarity(a, b, data_range=1, channel_axis=-1,
//! gaussian_weights=True, sigma=1.5, use_sample_covariance=False)`.

use lumi_core::DisplayImage;
use serde::{Deserialize, Serialize};

/// The neighbourhood in which images are compared.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Window {
    /// Gaussian weights cut off `radius` pixels away; population covariance.
    Gaussian {
        /// Standard deviation in pixels.
        sigma: f64,
        /// The window is 2·radius + 1 pixels wide.
        radius: usize,
    },
    /// Equal weights; sample covariance, as scikit-image's default.
    Uniform {
        /// The window is 2·radius + 1 pixels wide.
        radius: usize,
    },
}

impl Window {
    /// The window of the original paper: 11 pixels, σ = 1.5.
    pub const GAUSSIAN: Self = Self::Gaussian {
        sigma: 1.5,
        radius: 5,
    };

    /// Weights of one axis, which sum to 1.
    fn weights(self) -> Vec<f64> {
        let raw: Vec<f64> = match self {
            Self::Gaussian { sigma, radius } => {
                let r = radius as f64;
                let at = |i: usize| (-0.5 * ((i as f64 - r) / sigma).powi(2)).exp();
                (0..=2 * radius).map(at).collect()
            }
            Self::Uniform { radius } => vec![1.0; 2 * radius + 1],
        };
        let sum: f64 = raw.iter().sum();
        raw.into_iter().map(|w| w / sum).collect()
    }

    /// Shortest side of an image that holds the window.
    #[must_use]
    pub fn least_side(self) -> usize {
        2 * self.radius() + 1
    }

    fn radius(self) -> usize {
        match self {
            Self::Gaussian { radius, .. } | Self::Uniform { radius } => radius,
        }
    }
}

/// Stabilisers (0.01·peak)² and (0.03·peak)² at peak 1.
const C1: f64 = 0.0001;
const C2: f64 = 0.0009;

/// Mean over the pixels at least the window's radius away from the border, in [−1, 1]; `None` if the image is
/// smaller than the window.
///
/// # Panics
/// If the sizes differ.
#[must_use]
pub fn ssim(a: &DisplayImage, b: &DisplayImage, window: Window) -> Option<f64> {
    let map = ssim_map(a, b, window)?;
    let r = window.radius();
    let (mut sum, mut count) = (0.0, 0_u32);
    for row in map.chunks(a.width).take(a.height - r).skip(r) {
        for v in &row[r..a.width - r] {
            sum += v;
            count += 1;
        }
    }
    Some(sum / f64::from(count))
}

/// The similarity around each pixel, row-major; images continue mirrored beyond their borders. `None` if the
/// image is smaller than the window.
///
/// # Panics
/// If the sizes differ.
#[must_use]
pub fn ssim_map(a: &DisplayImage, b: &DisplayImage, window: Window) -> Option<Vec<f64>> {
    let size = (a.width, a.height);
    assert_eq!(size, (b.width, b.height), "images of one size");
    if a.width.min(a.height) < window.least_side() {
        return None;
    }
    let weights = window.weights();
    let unbiased = match window {
        Window::Gaussian { .. } => 1.0,
        Window::Uniform { .. } => {
            let n = (weights.len() * weights.len()) as f64;
            n / (n - 1.0)
        }
    };
    let mut map = vec![0.0; a.pixels.len()];
    for c in 0..3 {
        let filtered = |f: &dyn Fn(f64, f64) -> f64| {
            let pixels = a.pixels.iter().zip(&b.pixels);
            let values = pixels.map(|(p, q)| f(f64::from(p[c]), f64::from(q[c])));
            filter(&values.collect::<Vec<_>>(), size, &weights)
        };
        let (ma, mb) = (filtered(&|p, _| p), filtered(&|_, q| q));
        let (aa, bb) = (filtered(&|p, _| p * p), filtered(&|_, q| q * q));
        let ab = filtered(&|p, q| p * q);
        for (i, out) in map.iter_mut().enumerate() {
            let va = unbiased * (aa[i] - ma[i] * ma[i]);
            let vb = unbiased * (bb[i] - mb[i] * mb[i]);
            let cov = unbiased * (ab[i] - ma[i] * mb[i]);
            let luminance = (2.0 * ma[i] * mb[i] + C1) / (ma[i] * ma[i] + mb[i] * mb[i] + C1);
            *out += luminance * (2.0 * cov + C2) / (va + vb + C2) / 3.0;
        }
    }
    Some(map)
}

/// Filters rows, then columns; index −1 is 0, −2 is 1, as beyond the other end.
fn filter(values: &[f64], (width, height): (usize, usize), weights: &[f64]) -> Vec<f64> {
    let radius = weights.len() / 2;
    let mirrored = |i: usize, n: usize| {
        // `i` counts from `radius` before the first sample.
        let i = i as isize - radius as isize;
        let n = n as isize;
        let inside = if i < 0 {
            -1 - i
        } else if i >= n {
            2 * n - 1 - i
        } else {
            i
        };
        inside as usize
    };
    let mut rows = vec![0.0; values.len()];
    for (row, out) in values.chunks(width).zip(rows.chunks_mut(width)) {
        for (x, o) in out.iter_mut().enumerate() {
            *o = (0..weights.len())
                .map(|k| weights[k] * row[mirrored(x + k, width)])
                .sum();
        }
    }
    let mut out = vec![0.0; values.len()];
    for (y, line) in out.chunks_mut(width).enumerate() {
        for (k, weight) in weights.iter().enumerate() {
            let source = &rows[mirrored(y + k, height) * width..][..width];
            for (o, s) in line.iter_mut().zip(source) {
                *o += weight * s;
            }
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    fn picture(phase: f32) -> DisplayImage {
        let mut image = DisplayImage::filled(17, 13, [0.0; 3]);
        for (i, p) in image.pixels.iter_mut().enumerate() {
            let v = (i as f32 * 0.37 + phase).sin() * 0.5 + 0.5;
            *p = [v, v * v, 1.0 - v];
        }
        image
    }

    #[test]
    fn an_image_is_like_itself_and_unlike_others() {
        for window in [Window::GAUSSIAN, Window::Uniform { radius: 3 }] {
            let same = ssim(&picture(0.0), &picture(0.0), window).expect("large enough");
            assert!((same - 1.0).abs() < 1e-12);
            let other = ssim(&picture(0.0), &picture(1.5), window).expect("large enough");
            assert!(other < 0.9, "{other}");
        }
    }

    #[test]
    fn constants_have_a_closed_form() {
        let (a, b) = (
            DisplayImage::filled(12, 11, [0.25; 3]),
            DisplayImage::filled(12, 11, [0.5; 3]),
        );
        let expected = (2.0 * 0.125 + C1) / (0.0625 + 0.25 + C1);
        let found = ssim(&a, &b, Window::GAUSSIAN).expect("large enough");
        assert!(
            (found - expected).abs() < 1e-9,
            "{found} against {expected}"
        );
    }

    #[test]
    fn small_images_have_none() {
        let a = DisplayImage::filled(10, 30, [0.5; 3]);
        assert!(ssim(&a, &a, Window::GAUSSIAN).is_none());
    }
}
