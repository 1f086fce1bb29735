//! Changing an image's size.

use super::LinearImage;
use crate::{Error, Result};

/// Box average of premultiplied colour and alpha down to `width × height`, which must divide the image's size.
///
/// # Errors
/// If the sizes do not divide.
pub fn box_downscale(image: &LinearImage, width: usize, height: usize) -> Result<LinearImage> {
    if width == 0 || height == 0 || image.width % width != 0 || image.height % height != 0 {
        let expected = format!(
            "expected a size that divides {}×{}, found {width}×{height}",
            image.width, image.height
        );
        return Err(Error::value("size", expected));
    }
    let (kx, ky) = (image.width / width, image.height / height);
    let norm = 1.0 / (kx * ky) as f32;
    let mut out = LinearImage::new(width, height);
    for (i, pixel) in out.pixels.iter_mut().enumerate() {
        let (x0, y0) = (i % width * kx, i / width * ky);
        for y in y0..y0 + ky {
            for source in &image.pixels[y * image.width + x0..][..kx] {
                for c in 0..4 {
                    pixel[c] += source[c] * norm;
                }
            }
        }
    }
    Ok(out)
}

/// Lanczos-3 resize of an interleaved image with `channels` values per pixel, with the kernel
/// widened when shrinking (as Pillow does), so nothing aliases.
///
/// # Panics
/// If `data` is not `width · height · channels` long.
#[must_use]
pub fn lanczos_resize(
    data: &[f32],
    (width, height, channels): (usize, usize, usize),
    (new_width, new_height): (usize, usize),
) -> Vec<f32> {
    assert_eq!(data.len(), width * height * channels, "image data length");
    let columns = filters(width, new_width);
    let mut wide = vec![0.0; new_width * height * channels];
    for y in 0..height {
        for (x, (first, weights)) in columns.iter().enumerate() {
            for c in 0..channels {
                let at = |k: usize| data[(y * width + first + k) * channels + c];
                wide[(y * new_width + x) * channels + c] =
                    weights.iter().enumerate().map(|(k, w)| w * at(k)).sum();
            }
        }
    }
    let rows = filters(height, new_height);
    let mut out = vec![0.0; new_width * new_height * channels];
    let stride = new_width * channels;
    for (y, (first, weights)) in rows.iter().enumerate() {
        for (k, w) in weights.iter().enumerate() {
            let source = &wide[(first + k) * stride..][..stride];
            for (o, s) in out[y * stride..][..stride].iter_mut().zip(source) {
                *o += w * s;
            }
        }
    }
    out
}

/// Per output sample: first input sample and normalised weights.
fn filters(from: usize, to: usize) -> Vec<(usize, Vec<f32>)> {
    const LOBES: f64 = 3.0;
    let scale = from as f64 / to as f64;
    let stretch = scale.max(1.0);
    let sinc = |x: f64| {
        if x == 0.0 {
            1.0
        } else {
            (std::f64::consts::PI * x).sin() / (std::f64::consts::PI * x)
        }
    };
    let kernel = |x: f64| {
        if x.abs() < LOBES {
            sinc(x) * sinc(x / LOBES)
        } else {
            0.0
        }
    };
    (0..to)
        .map(|i| {
            let centre = (i as f64 + 0.5) * scale;
            let support = LOBES * stretch;
            let first = (centre - support + 0.5).max(0.0) as usize;
            let last = ((centre + support + 0.5) as usize).min(from);
            let raw: Vec<f64> = (first..last)
                .map(|j| kernel((j as f64 + 0.5 - centre) / stretch))
                .collect();
            let sum: f64 = raw.iter().sum();
            (first, raw.iter().map(|w| (w / sum) as f32).collect())
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn box_average_keeps_the_mean() {
        let image = LinearImage {
            width: 4,
            height: 2,
            pixels: (0..8).map(|i| [i as f32, 0.0, 0.0, 1.0]).collect(),
        };
        let small = box_downscale(&image, 2, 1).expect("divides");
        assert_eq!(small.pixels[0][0], 2.5);
        assert_eq!(small.pixels[1], [4.5, 0.0, 0.0, 1.0]);
        assert!(box_downscale(&image, 3, 1).is_err());
    }

    #[test]
    fn lanczos_keeps_constants_and_identity() {
        let flat = vec![0.3_f32; 7 * 5 * 2];
        assert!(
            lanczos_resize(&flat, (7, 5, 2), (3, 9))
                .iter()
                .all(|v| (v - 0.3).abs() < 1e-6)
        );
        let ramp: Vec<f32> = (0..35).map(|i| i as f32).collect();
        let same = lanczos_resize(&ramp, (7, 5, 1), (7, 5));
        assert!(same.iter().zip(&ramp).all(|(a, b)| (a - b).abs() < 1e-4));
    }
}
