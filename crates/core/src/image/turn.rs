//! EXIF orientation. Readers of captures take no notice of it, for poses refer to pixels as they are stored; photographs that
//! have no poses yet are turned once, before anything looks at them.

use super::io::{Content, decode};
use crate::{Error, Result};
use image::metadata::Orientation;
use image::{ImageDecoder, ImageFormat, ImageReader};
use std::io::Cursor;
use std::path::Path;

/// The photograph in `bytes` turned as its EXIF data says, as a PNG; `None` if it stands upright already. `path` is for
/// messages.
///
/// # Errors
/// Names the file if it cannot be read, or holds no display-encoded picture.
pub fn turned(path: &Path, bytes: &[u8]) -> Result<Option<Vec<u8>>> {
    let orientation = || -> image::ImageResult<Orientation> {
        let reader = ImageReader::new(Cursor::new(bytes)).with_guessed_format()?;
        reader.into_decoder()?.orientation()
    };
    let wrong = |e: image::ImageError| Error::invalid(path, "image", e.to_string());
    let orientation = orientation().map_err(wrong)?;
    if orientation == Orientation::NoTransforms {
        return Ok(None);
    }
    let (Content::Display(mut image, _), _) = decode(path, bytes)? else {
        let expected = "expected a PNG or JPEG, found linear radiance";
        return Err(Error::invalid(path, "format", expected));
    };
    image.apply_orientation(orientation);
    let mut file = Cursor::new(Vec::new());
    image.write_to(&mut file, ImageFormat::Png).map_err(wrong)?;
    Ok(Some(file.into_inner()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::{ImageEncoder, RgbImage};

    /// A JPEG of 16 × 8 pixels, bright on the left, with an EXIF orientation.
    fn photograph(orientation: u8) -> Vec<u8> {
        let bright = |x: u32| if x < 8 { 255 } else { 0 };
        let image = RgbImage::from_fn(16, 8, |x, _| image::Rgb([bright(x); 3]));
        // One directory with one entry: tag 0x112, a short.
        let mut exif = b"II*\0\x08\0\0\0\x01\0\x12\x01\x03\0\x01\0\0\0".to_vec();
        exif.extend([orientation, 0, 0, 0, 0, 0, 0, 0]);
        let mut file = Vec::new();
        let mut encoder = image::codecs::jpeg::JpegEncoder::new_with_quality(&mut file, 95);
        encoder.set_exif_metadata(exif).expect("takes EXIF");
        encoder.encode_image(&image).expect("encodes");
        file
    }

    #[test]
    fn photographs_are_turned_as_exif_says() {
        let path = Path::new("a.jpg");
        assert!(turned(path, &photograph(1)).expect("reads").is_none());
        // 6: the camera was turned to the left, so that the picture's left side is the scene's top.
        let png = turned(path, &photograph(6)).expect("reads").expect("turns");
        let upright = crate::image::decode_display(path, &png).expect("a PNG");
        assert_eq!((upright.width, upright.height), (8, 16));
        assert!(upright.pixels[0][0] > 0.9 && upright.pixels[15 * 8][0] < 0.1);
        assert!(turned(path, b"\xff\xd8\xff").is_err());
    }
}
