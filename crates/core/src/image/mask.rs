//! Masks: what an image file says of which pixels are the object's.

use super::DisplayImage;
use super::io::{Content, decode};
use crate::Result;
use crate::fs::read_bytes;
use image::DynamicImage;
use std::path::Path;

/// Grey levels of 8 bits up to this are labels (0, 1, 2, …), not shades of black.
const LABELS: f32 = 15.0;

/// Channels that differ by more than this are a colour, not the noise of a JPEG.
const COLORED: f32 = 0.1;

/// What a JPEG's noise makes of black stays below this.
const NOISE: f32 = 0.06;

/// Reads the coverage that an image file states as a mask; see [`read_mask_with_warnings`].
///
/// # Errors
/// Names the file and what is wrong with it.
pub fn read_mask(path: impl AsRef<Path>) -> Result<DisplayImage> {
    Ok(read_mask_with_warnings(path)?.0)
}

/// Reads the coverage that an image file states as a mask, as the image's alpha in [0, 1], and what there is to say of it.
///
/// * Alpha, unless it is the same everywhere: then it says nothing.
/// * Else grey, where white is the object. Levels that are only 0 and 1 (up to 15) are labels: all above 0 are the object.
/// * Colours, as of palettes of labels, mean that all but black is the object.
///
/// # Errors
/// Names the file and what is wrong with it.
pub fn read_mask_with_warnings(path: impl AsRef<Path>) -> Result<(DisplayImage, Vec<String>)> {
    let path = path.as_ref();
    decode_mask(path, &read_bytes(path)?)
}

/// [`read_mask_with_warnings`] of bytes at hand; `path` is for messages.
///
/// # Errors
/// As [`read_mask_with_warnings`].
pub fn decode_mask(path: &Path, bytes: &[u8]) -> Result<(DisplayImage, Vec<String>)> {
    let (content, _) = decode(path, bytes)?;
    let (width, height, pixels, depth) = match &content {
        Content::Linear(image, has_alpha) => {
            let straight = |p: &[f32; 4]| {
                let a = if *has_alpha { p[3] } else { 1.0 };
                [p[0], p[1], p[2], a].map(|v| v.clamp(0.0, 1.0))
            };
            let pixels = image.pixels.iter().map(straight).collect();
            (image.width, image.height, pixels, Depth::Float)
        }
        Content::Display(image, _) => {
            let depth = match image {
                _ if bytes.starts_with(b"\xff\xd8") => Depth::Lossy,
                DynamicImage::ImageLuma16(_)
                | DynamicImage::ImageLumaA16(_)
                | DynamicImage::ImageRgb16(_)
                | DynamicImage::ImageRgba16(_) => Depth::Sixteen,
                _ => Depth::Eight,
            };
            let rgba = image.to_rgba32f();
            let pixels = rgba.pixels().map(|p| p.0).collect();
            let (width, height) = (rgba.width() as usize, rgba.height() as usize);
            (width, height, pixels, depth)
        }
    };
    let (alpha, warnings) = coverage(pixels, depth);
    let shown = DisplayImage {
        width,
        height,
        pixels: alpha.iter().map(|a| [*a; 3]).collect(),
        alpha: Some(alpha),
    };
    Ok((shown, warnings))
}

/// How values are stored.
#[derive(Clone, Copy, PartialEq)]
enum Depth {
    Eight,
    Sixteen,
    /// Eight bits through JPEG.
    Lossy,
    Float,
}

fn coverage(pixels: Vec<[f32; 4]>, depth: Depth) -> (Vec<f32>, Vec<String>) {
    let mut warnings = Vec::new();
    let first = pixels.first().map_or(1.0, |p| p[3]);
    if pixels.iter().any(|p| p[3] != first) {
        return (pixels.iter().map(|p| p[3]).collect(), warnings);
    }
    let brightest = |p: &[f32; 4]| p[0].max(p[1]).max(p[2]);
    let darkest = |p: &[f32; 4]| p[0].min(p[1]).min(p[2]);
    let black = if depth == Depth::Lossy { NOISE } else { 0.0 };
    let object = |p: &[f32; 4]| f32::from(u8::from(brightest(p) > black));
    if pixels.iter().any(|p| brightest(p) - darkest(p) > COLORED) {
        return (pixels.iter().map(object).collect(), warnings);
    }
    let top = pixels.iter().map(brightest).fold(0.0, f32::max);
    // A mask that was saved in a wider type than its own: 0 and 1, labels, or 0 to 255 in 16 bits.
    let levels = match depth {
        Depth::Eight => (255.0 * top).round(),
        Depth::Sixteen => (65535.0 * top).round(),
        Depth::Lossy | Depth::Float => f32::INFINITY,
    };
    if levels > 0.0 && levels <= LABELS {
        if levels > 1.0 {
            warnings.push(format!(
                "grey levels of 0 to {levels} are taken as labels; all above 0 are the object"
            ));
        }
        return (pixels.iter().map(object).collect(), warnings);
    }
    let scale = if depth == Depth::Sixteen && levels <= 255.0 && levels > 0.0 {
        warnings.push("16 bits that hold 0 to 255 only are taken as 8".to_owned());
        65535.0 / 255.0
    } else {
        1.0
    };
    (pixels.iter().map(|p| scale * p[0]).collect(), warnings)
}
