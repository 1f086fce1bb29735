//! Pictures enlarged smoothly, and animations of them.

use super::{DisplayImage, lanczos_resize};
use crate::{Error, Result};
use image::codecs::gif::{GifEncoder, Repeat};
use image::{Delay, Frame, RgbaImage};

/// The picture at `side` pixels of width, smoothly.
#[must_use]
pub fn enlarged(image: &DisplayImage, side: usize) -> DisplayImage {
    let height = image.height * side / image.width;
    let size = (image.width, image.height, 3);
    let values = lanczos_resize(image.pixels.as_flattened(), size, (side, height));
    let clamped = |p: &[f32; 3]| p.map(|v| v.clamp(0.0, 1.0));
    DisplayImage {
        width: side,
        height,
        pixels: values.as_chunks::<3>().0.iter().map(clamped).collect(),
        alpha: image.alpha.as_ref().map(|alpha| {
            let size = (image.width, image.height, 1);
            let values = lanczos_resize(alpha, size, (side, height));
            values.iter().map(|a| a.clamp(0.0, 1.0)).collect()
        }),
    }
}

/// An endless GIF of the frames, `side` pixels wide each.
///
/// # Errors
/// If the frames cannot be encoded.
pub fn encode_gif(frames: &[DisplayImage], side: usize, per_second: u32) -> Result<Vec<u8>> {
    let failed = |e: image::ImageError| Error::value("GIF", format!("could not be encoded: {e}"));
    let mut bytes = Vec::new();
    {
        let mut encoder = GifEncoder::new_with_speed(&mut bytes, 10);
        encoder.set_repeat(Repeat::Infinite).map_err(failed)?;
        for frame in frames {
            let frame = enlarged(frame, side);
            let rgb = frame.to_bytes();
            let opaque = |p: &[u8; 3]| [p[0], p[1], p[2], 255];
            let data = rgb.as_chunks::<3>().0.iter().flat_map(opaque).collect();
            let (width, height) = (frame.width as u32, frame.height as u32);
            let buffer = RgbaImage::from_raw(width, height, data)
                .ok_or_else(|| Error::value("GIF", "expected width · height pixels"))?;
            let delay = Delay::from_numer_denom_ms(1000, per_second);
            let frame = Frame::from_parts(buffer, 0, 0, delay);
            encoder.encode_frame(frame).map_err(failed)?;
        }
    }
    Ok(bytes)
}
