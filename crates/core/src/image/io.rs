//! Image files in and out: PNG and JPEG as display images, OpenEXR and Radiance HDR as linear ones.
//!
//! The format is recognised by the file's first bytes, never by its name. EXIF orientation is not
//! applied: poses refer to the pixels as they are stored.
//!
//! What a file says of its own values is applied where that is a factor or a matrix (`EXPOSURE`, `gAMA`,
//! `chromaticities`, …). Where it is not, or where something had to be assumed, readers that end in `_with_warnings`
//! return one line that names it beside the image; the others are for files of our own making.

use super::authors::Bytes;
use super::png::Colors;
use super::{DisplayImage, LinearImage, jpeg, openexr, radiance};
use crate::camera::MAX_SIDE;
use crate::fs::{atomic_write, read_bytes};
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

/// What a file decodes to.
pub(super) enum Content {
    /// Display-encoded values, and how they become sRGB.
    Display(DynamicImage, Colors),
    /// Linear radiance, and whether the file has alpha. Values may be anything.
    Linear(LinearImage, bool),
}

/// A photograph as [`read_photograph_with_warnings`] reads it.
#[derive(Clone, Debug)]
pub struct Photograph {
    /// As it is shown.
    pub shown: DisplayImage,
    /// The linear values behind it, which are not clipped, where the file holds such (EXR or HDR).
    pub linear: Option<LinearImage>,
    /// What was assumed or could not be applied, a line each.
    pub warnings: Vec<String>,
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
    let read = read_photograph_with_warnings(path)?;
    Ok((read.shown, read.linear))
}

/// [`read_photograph`], and what there is to say of the file.
///
/// # Errors
/// As [`read_display`].
pub fn read_photograph_with_warnings(path: impl AsRef<Path>) -> Result<Photograph> {
    let path = path.as_ref();
    photograph(path, &read_bytes(path)?)
}

/// [`read_display`] of bytes at hand; `path` is for messages.
///
/// # Errors
/// As [`read_display`].
pub fn decode_display(path: &Path, bytes: &[u8]) -> Result<DisplayImage> {
    Ok(photograph(path, bytes)?.shown)
}

fn photograph(path: &Path, bytes: &[u8]) -> Result<Photograph> {
    let (content, warnings) = decode(path, bytes)?;
    let (shown, linear) = match content {
        Content::Display(image, colors) => (show(&image, &colors), None),
        Content::Linear(linear, has_alpha) => {
            check_finite(&linear).map_err(|e| e.at(path))?;
            let shown = linear.to_display();
            let shown = DisplayImage {
                alpha: shown.alpha.filter(|_| has_alpha),
                ..shown
            };
            (shown, Some(linear))
        }
    };
    Ok(Photograph {
        shown,
        linear,
        warnings,
    })
}

/// Reads linear premultiplied radiance from an OpenEXR (R, G, B and optionally A, half or float) or
/// Radiance HDR file; alpha is 1 where the file has none. EXR pixels lie where the display window has them.
///
/// # Errors
/// Names the file and what is wrong with it, a value that is not finite by its pixel.
pub fn read_linear(path: impl AsRef<Path>) -> Result<LinearImage> {
    Ok(read_linear_with_warnings(path)?.0)
}

/// [`read_linear`], and what there is to say of the file.
///
/// # Errors
/// As [`read_linear`].
pub fn read_linear_with_warnings(path: impl AsRef<Path>) -> Result<(LinearImage, Vec<String>)> {
    let path = path.as_ref();
    let (image, warnings) = linear(path, &read_bytes(path)?)?;
    check_finite(&image).map_err(|e| e.at(path))?;
    Ok((image, warnings))
}

/// [`read_linear`] of bytes at hand; `path` is for messages.
///
/// # Errors
/// As [`read_linear`].
pub fn decode_linear(path: &Path, bytes: &[u8]) -> Result<LinearImage> {
    let (image, _) = linear(path, bytes)?;
    check_finite(&image).map_err(|e| e.at(path))?;
    Ok(image)
}

/// Reads a PNG or JPEG as 8-bit RGB or RGBA.
pub(super) fn read_rgba8(path: &Path) -> Result<Bytes> {
    let (Content::Display(decoded, _), _) = decode(path, &read_bytes(path)?)? else {
        let expected = "expected a PNG or JPEG, found linear radiance";
        return Err(Error::invalid(path, "format", expected));
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

/// Writes a photograph as an 8-bit PNG that [`read_display`] reads back, as [`encode_png_with_alpha`] makes it.
///
/// # Errors
/// Names the file if it cannot be written.
pub fn write_png_with_alpha(path: impl AsRef<Path>, image: &DisplayImage) -> Result<()> {
    let path = path.as_ref();
    let bytes = encode_png_with_alpha(image).map_err(|e| e.at(path))?;
    atomic_write(path, &bytes)
}

/// An 8-bit PNG file: RGBA with straight colour where coverage is known, else RGB. The image must be over white.
///
/// # Errors
/// As [`encode_png`].
pub fn encode_png_with_alpha(image: &DisplayImage) -> Result<Vec<u8>> {
    let Some(alpha) = &image.alpha else {
        return encode_png(image);
    };
    check_size(image.width, image.height, image.pixels.len())?;
    check_size(image.width, image.height, alpha.len())?;
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
        .ok_or_else(|| Error::value("size", "expected width · height pixels"))?;
    let mut file = Cursor::new(Vec::new());
    buffer
        .write_to(&mut file, ImageFormat::Png)
        .map_err(|e| Error::value("PNG", format!("could not be encoded: {e}")))?;
    Ok(file.into_inner())
}

/// Writes linear premultiplied RGBA as an OpenEXR file: in half floats, or in whole ones where a value lies beyond
/// their range (65504), as a sun's does.
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

/// First bytes of the files that are read, and what they are.
const READ: [(&[u8], Kind, &str); 4] = [
    (b"\x89PNG", Kind::Png, "a PNG image"),
    (b"\xff\xd8\xff", Kind::Jpeg, "a JPEG image"),
    (b"#?", Kind::Hdr, "a Radiance HDR image"),
    (b"\x76\x2f\x31\x01", Kind::Exr, "an OpenEXR image"),
];

fn kind(path: &Path, bytes: &[u8]) -> Result<Kind> {
    let found = READ.iter().find(|(magic, ..)| bytes.starts_with(magic));
    found.map(|&(_, kind, _)| kind).ok_or_else(|| {
        let found = type_of(bytes).unwrap_or("something else");
        Error::invalid(
            path,
            "format",
            format!("expected a PNG, JPEG, EXR or HDR image, found {found}"),
        )
    })
}

/// What a file is, by its first bytes, in words for messages; `None` for files without a mark.
#[must_use]
pub fn type_of(bytes: &[u8]) -> Option<&'static str> {
    const OTHERS: [(usize, &[u8], &str); 20] = [
        (8, b"WEBP", "a WebP image"),
        (0, b"II*\0", "a TIFF image (or a camera's raw file)"),
        (0, b"MM\0*", "a TIFF image (or a camera's raw file)"),
        (0, b"GIF8", "a GIF image"),
        (0, b"BM", "a BMP image"),
        (4, b"ftyphei", "a HEIC image"),
        (4, b"ftypmif1", "a HEIC image"),
        (4, b"ftypavif", "an AVIF image"),
        (4, b"ftyp", "a video"),
        (0, b"\0\0\0\x0cjP  ", "a JPEG 2000 image"),
        (0, b"\0\0\0\x0cJXL ", "a JPEG XL image"),
        (0, b"\xff\x0a", "a JPEG XL image"),
        (0, b"DDS ", "a DDS texture"),
        (0, b"\xabKTX", "a KTX texture"),
        (0, b"8BPS", "a Photoshop document"),
        (0, b"PF", "a PFM image"),
        (0, b"PK\x03\x04", "a ZIP archive"),
        (0, b"%PDF", "a PDF document"),
        (0, b"glTF", "a glTF model"),
        (
            0,
            b"version https://git-lfs",
            "a pointer of Git LFS; fetch the file itself",
        ),
    ];
    if bytes.is_empty() {
        return Some("an empty file");
    }
    let is = |(at, magic, _): &&(usize, &[u8], &str)| {
        bytes.get(*at..).is_some_and(|rest| rest.starts_with(magic))
    };
    let text = bytes.trim_ascii_start();
    let page = text.starts_with(b"<!") || text.starts_with(b"<html");
    let read = READ.iter().find(|(magic, ..)| bytes.starts_with(magic));
    let named = read.map(|row| row.2);
    let named = named.or_else(|| OTHERS.iter().find(is).map(|row| row.2));
    named.or(page.then_some("a web page"))
}

/// What a file of any kind holds, and what there is to say of it. Values are not checked here.
pub(super) fn decode(path: &Path, bytes: &[u8]) -> Result<(Content, Vec<String>)> {
    match kind(path, bytes)? {
        Kind::Png => {
            let image = decode_png(path, bytes)?;
            let mut colors = Colors::of(bytes);
            let warnings = std::mem::take(&mut colors.warnings);
            Ok((Content::Display(image, colors), warnings))
        }
        Kind::Jpeg => {
            let bad = |e| Error::invalid(path, "image", incomplete("Jpeg", &e));
            let (w, h) = jpeg::size(bytes).map_err(bad)?;
            check_header(w, h, bytes).map_err(|e| e.at(path))?;
            let (image, warnings) = jpeg::decode(bytes).map_err(bad)?;
            Ok((Content::Display(image, Colors::default()), warnings))
        }
        Kind::Hdr => {
            let (image, warnings) = radiance::decode(bytes).map_err(|e| e.at(path))?;
            Ok((Content::Linear(image, false), warnings))
        }
        Kind::Exr => {
            let read = openexr::decode(path, bytes)?;
            Ok((Content::Linear(read.image, read.has_alpha), read.warnings))
        }
    }
}

/// A JPEG's picture, grey or RGB, decoded strictly: one that ends within its picture is an error.
///
/// # Errors
/// Says what was wrong.
pub fn decode_jpeg(bytes: &[u8]) -> std::result::Result<(DynamicImage, Vec<String>), String> {
    jpeg::decode(bytes)
}

/// Width and height that a PNG, JPEG, EXR or HDR file states, which is what its picture will take; `None` for other
/// files and for headers that cannot be read.
#[must_use]
pub fn stated_size(path: &Path, bytes: &[u8]) -> Option<(usize, usize)> {
    match kind(path, bytes).ok()? {
        Kind::Png => {
            let reader = ImageReader::with_format(Cursor::new(bytes), ImageFormat::Png);
            let (width, height) = reader.into_dimensions().ok()?;
            Some((width as usize, height as usize))
        }
        Kind::Jpeg => jpeg::size(bytes).ok(),
        Kind::Hdr => radiance::size(bytes).ok(),
        Kind::Exr => openexr::size(bytes),
    }
}

fn incomplete(format: &str, error: &dyn std::fmt::Display) -> String {
    format!("expected a complete {format} file of at most {MAX_SIDE} pixels a side; {error}")
}

/// What a header says of the size, before it is believed.
fn check_header(width: usize, height: usize, bytes: &[u8]) -> Result<()> {
    check_size(width, height, width.saturating_mul(height))?;
    check_plausible(width, height, bytes.len())
}

/// Decodes through the `image` crate, within the size limits.
fn decode_png(path: &Path, bytes: &[u8]) -> Result<DynamicImage> {
    let bad = |e: image::ImageError| Error::invalid(path, "image", incomplete("Png", &e));
    let reader = || ImageReader::with_format(Cursor::new(bytes), ImageFormat::Png);
    let (width, height) = reader().into_dimensions().map_err(bad)?;
    check_header(width as usize, height as usize, bytes).map_err(|e| e.at(path))?;
    let mut reader = reader();
    let mut limits = Limits::default();
    // Four 32-bit floats a pixel, and as much again for the decoder itself.
    limits.max_alloc = Some(32 * MAX_PIXELS as u64);
    reader.limits(limits);
    reader.decode().map_err(bad)
}

/// A decoded display-encoded image over white, its alpha kept apart.
pub(super) fn show(decoded: &DynamicImage, colors: &Colors) -> DisplayImage {
    let has_alpha = decoded.color().has_alpha();
    let rgba = decoded.to_rgba32f();
    let over_white = |p: &image::Rgba<f32>| {
        let [r, g, b, a] = p.0;
        colors.shown([r, g, b]).map(|v| v * a + (1.0 - a))
    };
    DisplayImage {
        width: rgba.width() as usize,
        height: rgba.height() as usize,
        pixels: rgba.pixels().map(over_white).collect(),
        alpha: has_alpha.then(|| rgba.pixels().map(|p| p.0[3]).collect()),
    }
}

/// The linear image of an EXR or HDR file. Values are not checked here.
fn linear(path: &Path, bytes: &[u8]) -> Result<(LinearImage, Vec<String>)> {
    let refused = |name: &str| {
        let expected =
            format!("expected linear radiance (EXR or HDR), found a display-encoded {name}");
        Err(Error::invalid(path, "format", expected))
    };
    match kind(path, bytes)? {
        Kind::Png => refused("PNG"),
        Kind::Jpeg => refused("JPEG"),
        Kind::Hdr | Kind::Exr => match decode(path, bytes)? {
            (Content::Linear(image, _), warnings) => Ok((image, warnings)),
            (Content::Display(..), _) => refused("image"),
        },
    }
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

pub(super) fn check_finite(image: &LinearImage) -> Result<()> {
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
