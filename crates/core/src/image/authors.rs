//! The authors' image loading: Pillow's 8-bit Lanczos resize, a centred square and a white background.
//!
//! Their network saw images that went through Pillow, which rounds to 8 bits after each of its two
//! passes and works on premultiplied colour. A float resize differs by up to two grey levels, so the
//! arithmetic is repeated here exactly.

use super::DisplayImage;
use super::io::read_rgba8;
use crate::{Camera, Error, Result};
use std::path::Path;

/// Fractional bits of Pillow's fixed-point filter weights.
const PRECISION: u32 = 32 - 8 - 2;

/// Interleaved 8-bit pixels.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Bytes {
    /// Width in pixels.
    pub width: usize,
    /// Height in pixels.
    pub height: usize,
    /// 3 (RGB) or 4 (RGBA, straight alpha).
    pub channels: usize,
    /// `width · height · channels` values.
    pub data: Vec<u8>,
}

/// Reads an 8-bit image file and [`prepare`]s it.
///
/// # Errors
/// Names the file and what is wrong with it.
pub fn read(
    path: impl AsRef<Path>,
    camera: &Camera,
    side: usize,
    patch: usize,
) -> Result<(DisplayImage, Camera)> {
    let path = path.as_ref();
    prepare(&read_rgba8(path)?, camera, side, patch).map_err(|e| e.at(path))
}

/// Resizes to height `side` (and a width that is a multiple of `patch`), cuts the centred square and
/// composites over white. The camera's intrinsics follow; its size is that of `image` before and
/// `side × side` after.
///
/// # Errors
/// If the image has no pixels, or is too narrow for a square of `side` pixels (the authors' code
/// assumes landscape or square images).
pub fn prepare(
    image: &Bytes,
    camera: &Camera,
    side: usize,
    patch: usize,
) -> Result<(DisplayImage, Camera)> {
    let (w, h, channels) = (image.width, image.height, image.channels);
    if w * h == 0 || image.data.len() != w * h * channels || !(3..=4).contains(&channels) {
        let expected = format!("expected RGB or RGBA pixels, found {w}×{h}×{channels}");
        return Err(Error::value("image", expected));
    }
    // `int(S / h · w)`, then Python's round, which takes halves to even.
    let scaled = (side as f64 / h as f64 * w as f64).floor();
    let width = (scaled / patch as f64).round_ties_even() as usize * patch;
    if width < side {
        let expected = format!("expected at least {side} columns at height {side}, found {width}");
        return Err(Error::value("image width", expected));
    }
    let small = resize(image, width, side);
    let x0 = (width - side) / 2;
    let at = |i: usize| &small.data[(i / side * width + x0 + i % side) * channels..][..channels];
    let unit = |v: u8| f32::from(v) / 255.0;
    let alpha: Option<Vec<f32>> =
        (channels == 4).then(|| (0..side * side).map(|i| unit(at(i)[3])).collect());
    let pixels = (0..side * side).map(|i| {
        let a = alpha.as_ref().map_or(1.0, |a| a[i]);
        std::array::from_fn(|c| unit(at(i)[c]) * a + (1.0 - a))
    });
    let shown = DisplayImage {
        width: side,
        height: side,
        pixels: pixels.collect(),
        alpha: alpha.clone(),
    };
    let camera = Camera {
        width: w,
        height: h,
        ..*camera
    };
    let camera = camera.resized(width, side).cropped((x0, 0), (side, side));
    Ok((shown, camera))
}

/// Pillow's `Image.resize(…, LANCZOS)`.
fn resize(image: &Bytes, width: usize, height: usize) -> Bytes {
    if (width, height) == (image.width, image.height) {
        return image.clone();
    }
    let mut work = image.clone();
    if image.channels == 4 {
        premultiply(&mut work.data);
    }
    // A pass over an axis whose size stays is skipped, and with it a rounding.
    if width != work.width {
        work = columns(&work, width);
    }
    if height != work.height {
        work = transposed(&columns(&transposed(&work), height));
    }
    if image.channels == 4 {
        unpremultiply(&mut work.data);
    }
    work
}

/// Resamples each row to `width` samples, rounding to 8 bits.
fn columns(image: &Bytes, width: usize) -> Bytes {
    let n = image.channels;
    let filters = super::resample::lanczos_weights(image.width, width);
    let fixed = |w: &f64| (w * f64::from(1_u32 << PRECISION)).round() as i32;
    let filters: Vec<(usize, Vec<i32>)> = filters
        .iter()
        .map(|(first, w)| (*first, w.iter().map(fixed).collect()))
        .collect();
    let mut data = Vec::with_capacity(width * image.height * n);
    for row in image.data.chunks_exact(image.width * n) {
        for (first, weights) in &filters {
            for c in 0..n {
                let sum: i32 = weights
                    .iter()
                    .enumerate()
                    .map(|(k, w)| w * i32::from(row[(first + k) * n + c]))
                    .sum();
                let rounded = (sum + (1 << (PRECISION - 1))) >> PRECISION;
                data.push(rounded.clamp(0, 255) as u8);
            }
        }
    }
    Bytes {
        width,
        data,
        ..*image
    }
}

fn transposed(image: &Bytes) -> Bytes {
    let (w, h, n) = (image.width, image.height, image.channels);
    let mut data = Vec::with_capacity(image.data.len());
    for x in 0..w {
        for y in 0..h {
            data.extend_from_slice(&image.data[(y * w + x) * n..][..n]);
        }
    }
    Bytes {
        width: h,
        height: w,
        channels: n,
        data,
    }
}

/// Colour times alpha, rounded as Pillow does.
fn premultiply(rgba: &mut [u8]) {
    for pixel in rgba.chunks_exact_mut(4) {
        let alpha = u32::from(pixel[3]);
        for v in &mut pixel[..3] {
            let t = u32::from(*v) * alpha + 128;
            *v = (((t >> 8) + t) >> 8) as u8;
        }
    }
}

/// Colour over alpha, truncated as Pillow does.
fn unpremultiply(rgba: &mut [u8]) {
    for pixel in rgba.chunks_exact_mut(4) {
        let alpha = u32::from(pixel[3]);
        if alpha != 0 && alpha != 255 {
            for v in &mut pixel[..3] {
                *v = (u32::from(*v) * 255 / alpha).min(255) as u8;
            }
        }
    }
}
