//! Image files in and out: PNG and JPEG as display images, OpenEXR and Radiance HDR as linear ones.
//!
//! The format is recognised by the file's first bytes, never by its name. EXIF orientation is not
//! applied: poses refer to the pixels as they are stored.

use super::release::Bytes;
use super::{DisplayImage, LinearImage, openexr};
use crate::camera::MAX_SIDE;
use crate::fs::{atomic_write, read_bytes};
use crate::light::EnvMap;
use crate::{Error, Result};
use image::{DynamicImage, ImageFormat, ImageReader, Limits};
use std::io::Cursor;
use std::path::Path;

/// Most pixels that a file may decode to: 16384 × 8192, the largest lat-long map that fits
/// [`MAX_SIDE`]. A broken header thus asks for 2 GiB at most.
pub const MAX_PIXELS: usize = MAX_SIDE * MAX_SIDE / 2;

/// What a file holds, by its first bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    Png,
    Jpeg,
    Hdr,
    Exr,
}

/// Reads an image as it is shown. PNG (8 or 16 bit) and JPEG are display-encoded already; alpha is
/// composited over white in that encoding and kept apart. EXR and HDR are linear and get encoded.
///
/// # Errors
/// Names the file and what is wrong with it: missing, unknown, truncated, too large, not finite.
pub fn read_display(path: impl AsRef<Path>) -> Result<DisplayImage> {
    Ok(read_photograph(path)?.0)
}

/// [`read_display`], and the linear values behind it, which are not clipped, where the file holds such (EXR or HDR).
///
/// # Errors
/// As [`read_display`].
pub fn read_photograph(path: impl AsRef<Path>) -> Result<(DisplayImage, Option<LinearImage>)> {
    let path = path.as_ref();
    decode_photograph(path, &read_bytes(path)?)
}

/// [`read_display`] of bytes at hand; `path` is for messages.
///
/// # Errors
/// As [`read_display`].
pub fn decode_display(path: &Path, bytes: &[u8]) -> Result<DisplayImage> {
    Ok(decode_photograph(path, bytes)?.0)
}

fn decode_photograph(path: &Path, bytes: &[u8]) -> Result<(DisplayImage, Option<LinearImage>)> {
    match kind(path, bytes)? {
        Kind::Png => Ok((show(&decode(path, bytes, ImageFormat::Png)?)?, None)),
        Kind::Jpeg => Ok((show(&decode(path, bytes, ImageFormat::Jpeg)?)?, None)),
        Kind::Hdr | Kind::Exr => {
            let (linear, has_alpha) = linear(path, bytes)?;
            let shown = linear.to_display();
            let shown = DisplayImage {
                alpha: shown.alpha.filter(|_| has_alpha),
                ..shown
            };
            Ok((shown, Some(linear)))
        }
    }
}

/// Reads linear premultiplied radiance from an OpenEXR (R, G, B and optionally A, half or float) or
/// Radiance HDR file; alpha is 1 where the file has none.
///
/// # Errors
/// Names the file and what is wrong with it, a value that is not finite by its pixel.
pub fn read_linear(path: impl AsRef<Path>) -> Result<LinearImage> {
    let path = path.as_ref();
    decode_linear(path, &read_bytes(path)?)
}

/// [`read_linear`] of bytes at hand; `path` is for messages.
///
/// # Errors
/// As [`read_linear`].
pub fn decode_linear(path: &Path, bytes: &[u8]) -> Result<LinearImage> {
    Ok(linear(path, bytes)?.0)
}

/// Reads the coverage that an image file states as a mask: its alpha where it has some, else its grey value.
///
/// # Errors
/// Names the file and what is wrong with it.
pub fn read_mask(path: impl AsRef<Path>) -> Result<DisplayImage> {
    let mut mask = read_display(path)?;
    if mask.alpha.is_none() {
        mask.alpha = Some(mask.pixels.iter().map(|p| p[0]).collect());
    }
    Ok(mask)
}

/// Reads a PNG or JPEG as 8-bit RGB or RGBA.
pub(super) fn read_rgba8(path: &Path) -> Result<Bytes> {
    let bytes = read_bytes(path)?;
    let decoded = match kind(path, &bytes)? {
        Kind::Png => decode(path, &bytes, ImageFormat::Png)?,
        Kind::Jpeg => decode(path, &bytes, ImageFormat::Jpeg)?,
        Kind::Hdr | Kind::Exr => {
            let expected = "expected a PNG or JPEG, found linear radiance";
            return Err(Error::invalid(path, "format", expected));
        }
    };
    let (width, height) = (decoded.width() as usize, decoded.height() as usize);
    let (channels, data) = if decoded.color().has_alpha() {
        (4, decoded.into_rgba8().into_raw())
    } else {
        (3, decoded.into_rgb8().into_raw())
    };
    Ok(Bytes {
        width,
        height,
        channels,
        data,
    })
}

/// Writes what is shown as an 8-bit RGB PNG, values rounded.
///
/// # Errors
/// Names the file if it cannot be written.
pub fn write_png(path: impl AsRef<Path>, image: &DisplayImage) -> Result<()> {
    let path = path.as_ref();
    atomic_write(path, &encode_png(image).map_err(|e| e.at(path))?)
}

/// What is shown as an 8-bit RGB PNG file, values rounded.
///
/// # Errors
/// If the image has not `width · height` pixels, or is too large for the format.
pub fn encode_png(image: &DisplayImage) -> Result<Vec<u8>> {
    check_size(image.width, image.height, image.pixels.len())?;
    let (width, height) = (image.width as u32, image.height as u32);
    let buffer = image::RgbImage::from_raw(width, height, image.to_bytes())
        .ok_or_else(|| Error::value("size", "expected width · height pixels"))?;
    let mut file = Cursor::new(Vec::new());
    buffer
        .write_to(&mut file, ImageFormat::Png)
        .map_err(|e| Error::value("PNG", format!("could not be encoded: {e}")))?;
    Ok(file.into_inner())
}

/// Writes a photograph as an 8-bit PNG that [`read_display`] reads back: RGBA with straight colour where
/// coverage is known, else RGB. The image must be over white.
///
/// # Errors
/// Names the file if it cannot be written.
pub fn write_png_with_alpha(path: impl AsRef<Path>, image: &DisplayImage) -> Result<()> {
    let path = path.as_ref();
    let Some(alpha) = &image.alpha else {
        return write_png(path, image);
    };
    check_size(image.width, image.height, image.pixels.len())
        .and_then(|()| check_size(image.width, image.height, alpha.len()))
        .map_err(|e| e.at(path))?;
    let byte = |v: f32| (v.clamp(0.0, 1.0) * 255.0).round() as u8;
    let straight = |p: &[f32; 3], a: f32| {
        let color = |v: f32| {
            if a > 0.0 { (v - (1.0 - a)) / a } else { 0.0 }
        };
        [
            byte(color(p[0])),
            byte(color(p[1])),
            byte(color(p[2])),
            byte(a),
        ]
    };
    let pixels = image.pixels.iter().zip(alpha);
    let bytes = pixels.flat_map(|(p, &a)| straight(p, a)).collect();
    let buffer = image::RgbaImage::from_raw(image.width as u32, image.height as u32, bytes)
        .ok_or_else(|| Error::invalid(path, "size", "expected width · height pixels"))?;
    let mut file = Cursor::new(Vec::new());
    buffer
        .write_to(&mut file, ImageFormat::Png)
        .map_err(|e| Error::invalid(path, "PNG", format!("could not be encoded: {e}")))?;
    atomic_write(path, file.get_ref())
}

/// Writes linear premultiplied RGBA as a half-float OpenEXR file. Values beyond the half range
/// (65504) are stored as its end, so that what was written can be read.
///
/// # Errors
/// Names the file if it cannot be written, and the pixel of a value that is not finite.
pub fn write_exr(path: impl AsRef<Path>, image: &LinearImage) -> Result<()> {
    let path = path.as_ref();
    atomic_write(path, &encode_exr(image).map_err(|e| e.at(path))?)
}

/// The file that [`write_exr`] writes.
///
/// # Errors
/// On a size that no file has, and on a value that is not finite, by its pixel.
pub fn encode_exr(image: &LinearImage) -> Result<Vec<u8>> {
    check_size(image.width, image.height, image.pixels.len())?;
    check_finite(image)?;
    openexr::encode(image)
}

impl EnvMap {
    /// Reads and validates a lat-long map from a Radiance HDR or OpenEXR file; alpha is ignored.
    ///
    /// # Errors
    /// Names the file, and the pixel of a value that is negative or not finite; a map without any
    /// light in it is an error too.
    pub fn read(path: impl AsRef<Path>) -> Result<Self> {
        let path = path.as_ref();
        let image = read_linear(path)?;
        let map = Self {
            width: image.width,
            height: image.height,
            pixels: image.pixels.iter().map(|p| [p[0], p[1], p[2]]).collect(),
        };
        map.validate().map_err(|e| e.at(path))?;
        Ok(map)
    }

    /// The map as an opaque picture, as [`write_exr`] takes it.
    #[must_use]
    pub fn to_image(&self) -> LinearImage {
        let opaque = |p: &[f32; 3]| [p[0], p[1], p[2], 1.0];
        LinearImage {
            width: self.width,
            height: self.height,
            pixels: self.pixels.iter().map(opaque).collect(),
        }
    }
}

fn kind(path: &Path, bytes: &[u8]) -> Result<Kind> {
    const MAGIC: [(&[u8], Kind); 4] = [
        (b"\x89PNG", Kind::Png),
        (b"\xff\xd8\xff", Kind::Jpeg),
        (b"#?", Kind::Hdr),
        (b"\x76\x2f\x31\x01", Kind::Exr),
    ];
    let found = MAGIC.iter().find(|(magic, _)| bytes.starts_with(magic));
    found.map(|&(_, kind)| kind).ok_or_else(|| {
        let what = if bytes.is_empty() {
            "an empty file"
        } else {
            "something else"
        };
        Error::invalid(
            path,
            "format",
            format!("expected a PNG, JPEG, EXR or HDR image, found {what}"),
        )
    })
}

/// Decodes through the `image` crate, within the size limits.
fn decode(path: &Path, bytes: &[u8], format: ImageFormat) -> Result<DynamicImage> {
    let bad = |e: image::ImageError| {
        Error::invalid(
            path,
            "image",
            format!("expected a complete {format:?} file of at most {MAX_SIDE} pixels a side; {e}"),
        )
    };
    let (width, height) = ImageReader::with_format(Cursor::new(bytes), format)
        .into_dimensions()
        .map_err(bad)?;
    let (w, h) = (width as usize, height as usize);
    check_size(w, h, w.saturating_mul(h))
        .and_then(|()| check_plausible(w, h, bytes.len()))
        .map_err(|e| e.at(path))?;
    let mut reader = ImageReader::with_format(Cursor::new(bytes), format);
    let mut limits = Limits::default();
    // Four 32-bit floats a pixel, and as much again for the decoder itself.
    limits.max_alloc = Some(32 * MAX_PIXELS as u64);
    reader.limits(limits);
    reader.decode().map_err(bad)
}

/// A decoded display-encoded image over white, its alpha kept apart.
fn show(decoded: &DynamicImage) -> Result<DisplayImage> {
    let has_alpha = decoded.color().has_alpha();
    let rgba = decoded.to_rgba32f();
    let over_white = |p: &image::Rgba<f32>| {
        let [r, g, b, a] = p.0;
        [r, g, b].map(|v| v * a + (1.0 - a))
    };
    Ok(DisplayImage {
        width: rgba.width() as usize,
        height: rgba.height() as usize,
        pixels: rgba.pixels().map(over_white).collect(),
        alpha: has_alpha.then(|| rgba.pixels().map(|p| p.0[3]).collect()),
    })
}

/// The linear image of an EXR or HDR file, and whether the file has alpha.
fn linear(path: &Path, bytes: &[u8]) -> Result<(LinearImage, bool)> {
    let (image, has_alpha) = match kind(path, bytes)? {
        Kind::Exr => openexr::decode(path, bytes)?,
        Kind::Hdr => {
            let rgb = decode(path, bytes, ImageFormat::Hdr)?.to_rgb32f();
            let image = LinearImage {
                width: rgb.width() as usize,
                height: rgb.height() as usize,
                pixels: rgb
                    .pixels()
                    .map(|p| [p.0[0], p.0[1], p.0[2], 1.0])
                    .collect(),
            };
            (image, false)
        }
        Kind::Png | Kind::Jpeg => {
            let expected =
                "expected linear radiance (EXR or HDR), found a display-encoded PNG or JPEG";
            return Err(Error::invalid(path, "format", expected));
        }
    };
    check_finite(&image).map_err(|e| e.at(path))?;
    Ok((image, has_alpha))
}

/// Sides from 1 to [`MAX_SIDE`], at most [`MAX_PIXELS`], and a buffer that fits.
pub(super) fn check_size(width: usize, height: usize, pixels: usize) -> Result<()> {
    let fits = (1..=MAX_SIDE).contains(&width) && (1..=MAX_SIDE).contains(&height);
    if fits && pixels == width * height && pixels <= MAX_PIXELS {
        return Ok(());
    }
    let expected = format!(
        "expected sides of 1 to {MAX_SIDE} and at most {MAX_PIXELS} pixels, found {width}×{height} with {pixels} pixels"
    );
    Err(Error::value("size", expected))
}

/// Most pixels that a byte of a file can stand for: Deflate, the strongest coding of all formats, makes
/// 1032 bytes of one, which hold eight one-bit pixels each.
const PIXELS_PER_BYTE: usize = 8 * 1032;

/// A header that promises more pixels than its file can hold is refused before anything is allocated.
pub(super) fn check_plausible(width: usize, height: usize, bytes: usize) -> Result<()> {
    if width * height <= bytes.saturating_mul(PIXELS_PER_BYTE) {
        return Ok(());
    }
    let expected =
        format!("expected data for {width}×{height} pixels, found a file of {bytes} bytes");
    Err(Error::value("size", expected))
}

fn check_finite(image: &LinearImage) -> Result<()> {
    let bad = image
        .pixels
        .iter()
        .position(|p| !p.iter().all(|v| v.is_finite()));
    bad.map_or(Ok(()), |i| {
        let (x, y) = (i % image.width, i / image.width);
        let expected = format!("expected finite numbers, found {:?}", image.pixels[i]);
        Err(Error::value(format!("pixel ({x}, {y})"), expected))
    })
}
