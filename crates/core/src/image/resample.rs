//! Changing an image's size.

use super::{DisplayImage, LinearImage};
use crate::{Error, Result};

/// Box average of premultiplied colour and alpha down to `width × height`, which must divide the image's size.
///
/// # Errors
/// If the sizes do not divide.
pub fn box_downscale(image: &LinearImage, width: usize, height: usize) -> Result<LinearImage> {
    let divides = image.width.is_multiple_of(width) && image.height.is_multiple_of(height);
    if width == 0 || height == 0 || !divides {
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
    let (columns, rows) = (filters(width, new_width), filters(height, new_height));
    separable(data, (width, height, channels), &columns, &rows)
}

/// Resize without ringing where it matters: an axis that shrinks takes area averages (fractional
/// pixels included), an axis that grows takes Lanczos-3.
///
/// # Panics
/// If `data` is not `width · height · channels` long.
#[must_use]
pub fn area_resize(
    data: &[f32],
    (width, height, channels): (usize, usize, usize),
    (new_width, new_height): (usize, usize),
) -> Vec<f32> {
    let axis = |from, to| {
        if to > from {
            filters(from, to)
        } else {
            area_filters(from, to)
        }
    };
    let (columns, rows) = (axis(width, new_width), axis(height, new_height));
    separable(data, (width, height, channels), &columns, &rows)
}

impl LinearImage {
    /// The image at another size by [`area_resize`], on premultiplied values.
    #[must_use]
    pub fn resized(&self, width: usize, height: usize) -> Self {
        if (width, height) == (self.width, self.height) {
            return self.clone();
        }
        let from = (self.width, self.height, 4);
        let data = area_resize(self.pixels.as_flattened(), from, (width, height));
        // Lanczos overshoots at edges when it enlarges; radiance and coverage cannot be negative.
        let pixel = |p: &[f32]| {
            [
                p[0].max(0.0),
                p[1].max(0.0),
                p[2].max(0.0),
                p[3].clamp(0.0, 1.0),
            ]
        };
        Self {
            width,
            height,
            pixels: data.chunks_exact(4).map(pixel).collect(),
        }
    }

    /// The part of `width × height` pixels whose top-left corner is (`x`, `y`).
    ///
    /// # Panics
    /// If it reaches beyond the image.
    #[must_use]
    pub fn cropped(&self, (x, y): (usize, usize), (width, height): (usize, usize)) -> Self {
        let pixels = crop(&self.pixels, self.width, (x, y), (width, height));
        Self {
            width,
            height,
            pixels,
        }
    }
}

impl DisplayImage {
    /// The image at another size by [`area_resize`], on display values over the background.
    #[must_use]
    pub fn resized(&self, width: usize, height: usize) -> Self {
        if (width, height) == (self.width, self.height) {
            return self.clone();
        }
        let resize = |data: &[f32], channels| {
            let mut data = area_resize(data, (self.width, self.height, channels), (width, height));
            data.iter_mut().for_each(|v| *v = v.clamp(0.0, 1.0));
            data
        };
        let data = resize(self.pixels.as_flattened(), 3);
        Self {
            width,
            height,
            pixels: data.chunks_exact(3).map(|p| [p[0], p[1], p[2]]).collect(),
            alpha: self.alpha.as_ref().map(|a| resize(a, 1)),
        }
    }

    /// The part of `width × height` pixels whose top-left corner is (`x`, `y`).
    ///
    /// # Panics
    /// If it reaches beyond the image.
    #[must_use]
    pub fn cropped(&self, (x, y): (usize, usize), (width, height): (usize, usize)) -> Self {
        let alpha = self.alpha.as_ref();
        Self {
            width,
            height,
            pixels: crop(&self.pixels, self.width, (x, y), (width, height)),
            alpha: alpha.map(|a| crop(a, self.width, (x, y), (width, height))),
        }
    }
}

fn crop<T: Copy>(
    data: &[T],
    stride: usize,
    (x, y): (usize, usize),
    (width, height): (usize, usize),
) -> Vec<T> {
    assert!(x + width <= stride, "crop beyond the right edge");
    (y..y + height)
        .flat_map(|row| &data[row * stride + x..][..width])
        .copied()
        .collect()
}

/// For each output sample: first input sample and weights that sum to 1.
type Filters = Vec<(usize, Vec<f32>)>;

/// Filters the columns, then the rows, of an interleaved image.
fn separable(
    data: &[f32],
    (width, height, channels): (usize, usize, usize),
    columns: &Filters,
    rows: &Filters,
) -> Vec<f32> {
    assert_eq!(data.len(), width * height * channels, "image data length");
    let stride = columns.len() * channels;
    let mut wide = vec![0.0; stride * height];
    for y in 0..height {
        for (x, (first, weights)) in columns.iter().enumerate() {
            for c in 0..channels {
                let at = |k: usize| data[(y * width + first + k) * channels + c];
                wide[y * stride + x * channels + c] =
                    weights.iter().enumerate().map(|(k, w)| w * at(k)).sum();
            }
        }
    }
    let mut out = vec![0.0; stride * rows.len()];
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

/// Each of `to` equal cells takes the input samples it covers, by the covered share.
fn area_filters(from: usize, to: usize) -> Filters {
    let scale = from as f64 / to as f64;
    (0..to)
        .map(|i| {
            let (a, b) = (i as f64 * scale, (i + 1) as f64 * scale);
            let first = a.floor() as usize;
            let share = |j: usize| (b.min((j + 1) as f64) - a.max(j as f64)).max(0.0) / scale;
            let last = (b.ceil() as usize).clamp(first + 1, from);
            (first, (first..last).map(|j| share(j) as f32).collect())
        })
        .collect()
}

/// Lanczos-3, stretched when shrinking.
fn filters(from: usize, to: usize) -> Filters {
    let single = |(first, weights): (usize, Vec<f64>)| {
        (first, weights.into_iter().map(|w| w as f32).collect())
    };
    lanczos_weights(from, to).into_iter().map(single).collect()
}

/// For each output sample: first input sample and Lanczos-3 weights that sum to 1, over the same
/// samples as Pillow takes.
pub(super) fn lanczos_weights(from: usize, to: usize) -> Vec<(usize, Vec<f64>)> {
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
            (first, raw.iter().map(|w| w / sum).collect())
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

    #[test]
    fn area_resize_agrees_with_the_box_and_takes_fractions() {
        let image = LinearImage {
            width: 6,
            height: 4,
            pixels: (0..24).map(|i| [i as f32, 1.0, 0.5, 0.25]).collect(),
        };
        let (a, b) = (
            image.resized(3, 2),
            box_downscale(&image, 3, 2).expect("divides"),
        );
        for (p, q) in a.pixels.iter().zip(&b.pixels) {
            assert!((0..4).all(|c| (p[c] - q[c]).abs() < 1e-5));
        }
        // Two cells over three samples: the middle one is shared.
        let row = area_resize(&[3.0, 6.0, 9.0], (3, 1, 1), (2, 1));
        assert!((row[0] - 4.0).abs() < 1e-6 && (row[1] - 8.0).abs() < 1e-6);
        let mean = |d: &[f32]| d.iter().sum::<f32>() / d.len() as f32;
        let ramp: Vec<f32> = (0..70).map(|i| (i * i % 11) as f32).collect();
        let small = area_resize(&ramp, (10, 7, 1), (4, 3));
        assert!((mean(&small) - mean(&ramp)).abs() < 1e-4);
    }

    #[test]
    fn crop_takes_the_named_pixels() {
        let image = LinearImage {
            width: 4,
            height: 3,
            pixels: (0..12).map(|i| [i as f32, 0.0, 0.0, 1.0]).collect(),
        };
        let part = image.cropped((1, 1), (2, 2));
        let values: Vec<f32> = part.pixels.iter().map(|p| p[0]).collect();
        assert_eq!(values, [5.0, 6.0, 9.0, 10.0]);
    }
}
