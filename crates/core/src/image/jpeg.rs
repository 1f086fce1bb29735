//! JPEG, decoded strictly: a file that ends within its picture is an error, not a picture with a grey part.
//!
//! Some programs leave out the end marker alone. To tell the two apart, such a file is decoded several times with
//! different made-up data after its end: a complete picture takes no notice.

use super::icc;
use image::{DynamicImage, GrayImage, RgbImage};
use zune_core::bytestream::ZCursor;
use zune_core::colorspace::ColorSpace;
use zune_core::options::DecoderOptions;
use zune_jpeg::JpegDecoder;
use zune_jpeg::errors::DecodeErrors;

const END: [u8; 2] = [0xff, 0xd9];

/// What is put after a file without an end marker: nothing, and bytes that code other pixels.
const FILLERS: [&[u8]; 3] = [&[], &[0x55; 4096], &[0xaa; 4096]];

/// So many zeros at a file's end are no picture's data.
const ZEROS: usize = 64;

/// Header segments before which there are a few bytes too many; harmless, so only worth a word.
const EXTRA_BYTES: &str = "Extra bytes between headers";

/// Width and height, from the headers.
pub(super) fn size(bytes: &[u8]) -> Result<(usize, usize), String> {
    let mut decoder = JpegDecoder::new_with_options(ZCursor::new(bytes), options(false));
    decoder.decode_headers().map_err(text)?;
    decoder
        .dimensions()
        .ok_or_else(|| "no frame header".to_owned())
}

/// The picture, grey or RGB, and what there is to say of the file.
pub(super) fn decode(bytes: &[u8]) -> Result<(DynamicImage, Vec<String>), String> {
    let mut warnings = Vec::new();
    let scans = Scans::of(bytes);
    let (image, profile) = if scans.ends {
        complete(bytes, &mut warnings)?
    } else {
        if !scans.are_all_there() {
            return Err("it ends between the scans of its picture".to_owned());
        }
        let image = without_end(bytes)?;
        warnings.push("JPEG: its end marker is missing, its picture is complete".to_owned());
        image
    };
    warnings.extend(profile.and_then(|p| icc::warning(&p)));
    Ok((image, warnings))
}

type Picture = (DynamicImage, Option<Vec<u8>>);

fn complete(bytes: &[u8], warnings: &mut Vec<String>) -> Result<Picture, String> {
    picture(bytes, true).or_else(|error| {
        if !error.contains(EXTRA_BYTES) {
            return Err(error);
        }
        warnings.push(format!("JPEG: {EXTRA_BYTES}, skipped").replace("Extra", "extra"));
        picture(bytes, false)
    })
}

/// A file whose end marker is missing: what is made up after its end must not show. Zeros that fill the place of
/// what was never written are no data.
fn without_end(bytes: &[u8]) -> Result<Picture, String> {
    let end = bytes.iter().rposition(|b| *b != 0).map_or(0, |i| i + 1);
    let bytes = if bytes.len() - end < ZEROS {
        bytes
    } else {
        &bytes[..end]
    };
    let mut first: Option<Picture> = None;
    for filler in FILLERS {
        let longer = [bytes, filler, &END].concat();
        let read = picture(&longer, true).map_err(|_| CUT.to_owned())?;
        if first.as_ref().is_some_and(|f| f.0 != read.0) {
            return Err(CUT.to_owned());
        }
        first = first.or(Some(read));
    }
    first.ok_or_else(|| CUT.to_owned())
}

const CUT: &str = "it ends within its picture";

fn options(strict: bool) -> DecoderOptions {
    // Sizes are checked before, by ours.
    DecoderOptions::default()
        .set_strict_mode(strict)
        .set_max_width(usize::MAX)
        .set_max_height(usize::MAX)
}

fn text(error: DecodeErrors) -> String {
    format!("{error:?}")
}

fn picture(bytes: &[u8], strict: bool) -> Result<Picture, String> {
    let mut decoder = JpegDecoder::new_with_options(ZCursor::new(bytes), options(strict));
    decoder.decode_headers().map_err(text)?;
    let grey = decoder.input_colorspace() == Some(ColorSpace::Luma);
    let wanted = if grey {
        ColorSpace::Luma
    } else {
        ColorSpace::RGB
    };
    decoder.set_options(decoder.options().jpeg_set_out_colorspace(wanted));
    let pixels = decoder.decode().map_err(text)?;
    let (width, height) = decoder.dimensions().unwrap_or_default();
    let (w, h) = (width as u32, height as u32);
    let image = if grey {
        GrayImage::from_raw(w, h, pixels).map(DynamicImage::from)
    } else {
        RgbImage::from_raw(w, h, pixels).map(DynamicImage::from)
    };
    let image = image.ok_or_else(|| format!("expected {width}×{height} pixels"))?;
    Ok((image, decoder.icc_profile()))
}

/// What the markers say of a file's scans.
#[derive(Default)]
struct Scans {
    /// Whether the end marker is there.
    ends: bool,
    components: Vec<u8>,
    /// For each component, the lowest bit that each coefficient has got; none yet is `u8::MAX`.
    bits: Vec<[u8; 64]>,
}

impl Scans {
    fn of(bytes: &[u8]) -> Self {
        let mut scans = Self::default();
        let mut at = 2;
        while let Some(marker) = next_marker(bytes, &mut at) {
            match marker {
                0xd9 => {
                    scans.ends = true;
                    break;
                }
                // Markers without a segment.
                0x01 | 0xd0..=0xd8 => {}
                _ => {
                    let Some(length) = bytes.get(at..).and_then(|b| b.first_chunk::<2>()) else {
                        break;
                    };
                    let end = at + usize::from(u16::from_be_bytes(*length)).max(2);
                    let Some(segment) = bytes.get(at + 2..end) else {
                        break;
                    };
                    match marker {
                        0xc0..=0xc2 => scans.frame(segment),
                        0xda => scans.scan(segment),
                        _ => {}
                    }
                    at = end;
                }
            }
        }
        scans
    }

    /// Precision, height, width, then three bytes a component.
    fn frame(&mut self, segment: &[u8]) {
        let components = segment.get(6..).unwrap_or_default();
        self.components = components.as_chunks::<3>().0.iter().map(|c| c[0]).collect();
        self.bits = vec![[u8::MAX; 64]; self.components.len()];
    }

    /// A count, two bytes a component, then first and last coefficient and two half bytes of bits.
    fn scan(&mut self, segment: &[u8]) {
        let Some((&count, rest)) = segment.split_first() else {
            return;
        };
        let Some((components, band)) = rest.split_at_checked(2 * usize::from(count)) else {
            return;
        };
        let &[first, last, bits] = band else {
            return;
        };
        for id in components.iter().step_by(2) {
            let found = self.components.iter().position(|c| c == id);
            if let Some(bands) = found.and_then(|i| self.bits.get_mut(i)) {
                let range = usize::from(first)..=usize::from(last.min(63));
                for band in bands.get_mut(range).unwrap_or_default() {
                    *band = bits & 0x0f;
                }
            }
        }
    }

    /// Whether every coefficient of every component has been begun down to its last bit.
    fn are_all_there(&self) -> bool {
        !self.bits.is_empty() && self.bits.iter().flatten().all(|b| *b == 0)
    }
}

/// The marker at or after `at`, which goes behind it; stuffed zeros and fill bytes are none.
fn next_marker(bytes: &[u8], at: &mut usize) -> Option<u8> {
    loop {
        let rest = bytes.get(*at..)?;
        let i = rest
            .windows(2)
            .position(|w| w[0] == 0xff && !matches!(w[1], 0x00 | 0xff))?;
        *at += i + 2;
        let marker = rest[i + 1];
        // Restarts stand within the picture's data.
        if !(0xd0..=0xd7).contains(&marker) {
            return Some(marker);
        }
    }
}
