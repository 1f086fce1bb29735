//! Environment maps from image files.

use super::LinearImage;
use super::io::{Content, check_finite, decode, show};
use crate::fs::read_bytes;
use crate::light::EnvMap;
use crate::{Error, Result};
use half::f16;
use std::path::Path;

impl EnvMap {
    /// Reads and validates a lat-long map; see [`EnvMap::read_with_warnings`].
    ///
    /// # Errors
    /// As [`EnvMap::read_with_warnings`].
    pub fn read(path: impl AsRef<Path>) -> Result<Self> {
        Ok(Self::read_with_warnings(path)?.0)
    }

    /// Reads and validates a lat-long map from a Radiance HDR or OpenEXR file, or from a picture (PNG, JPEG), and says what it had
    /// to assume; alpha is ignored.
    ///
    /// * A map is twice as wide as high. Others are taken as the whole sphere all the same, with a warning.
    /// * Infinite radiance, as of suns beyond half floats, becomes the largest half float or, if that is larger, the
    ///   largest other value of the map, with a warning.
    /// * A picture ends at white, where a sky's sun begins: it is taken with a warning.
    /// * Negative values up to a thousandth of the largest, which filters leave, become zero.
    ///
    /// # Errors
    /// Names the file, and the pixel of a value that is further below zero or not a number. Square maps (light probes)
    /// are refused, and so are maps without any light.
    pub fn read_with_warnings(path: impl AsRef<Path>) -> Result<(Self, Vec<String>)> {
        let path = path.as_ref();
        Self::decode(path, &read_bytes(path)?)
    }

    /// [`EnvMap::read_with_warnings`] of bytes at hand; `path` is for messages.
    ///
    /// # Errors
    /// As [`EnvMap::read_with_warnings`].
    pub fn decode(path: &Path, bytes: &[u8]) -> Result<(Self, Vec<String>)> {
        let (content, mut warnings) = decode(path, bytes)?;
        let mut image = match content {
            Content::Linear(image, _) => image,
            Content::Display(image, colors) => {
                warnings.push(ENDS_AT_WHITE.to_owned());
                show(&image, &colors).to_linear()
            }
        };
        shape(image.width, image.height)
            .map(|warning| warnings.extend(warning))
            .and_then(|()| {
                warnings.extend(finite_suns(&mut image));
                check_finite(&image)?;
                image.clear_left_overs()
            })
            .map_err(|e| e.at(path))?;
        let map = Self {
            width: image.width,
            height: image.height,
            pixels: image.pixels.iter().map(|p| [p[0], p[1], p[2]]).collect(),
        };
        map.validate().map_err(|e| e.at(path))?;
        Ok((map, warnings))
    }

    /// The map as an opaque picture, as [`super::write_exr`] takes it.
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

/// What there is to say of a map from a picture.
const ENDS_AT_WHITE: &str = "radiance: a picture ends at white; its sun and lamps are too dark, and what they light has too soft shadows";

/// A lat-long map is twice as wide as high; one pixel more or less is rounding.
fn shape(width: usize, height: usize) -> Result<Option<String>> {
    if width == height && width > 1 {
        let expected = format!(
            "expected a lat-long map, twice as wide as high, found {width}×{height}: square maps are light probes \
             (mirror ball, angular or equal-area), of which no file says which; convert it to lat-long first"
        );
        return Err(Error::value("size", expected));
    }
    Ok((width.abs_diff(2 * height) > 1).then(|| {
        format!(
            "size: {width}×{height} is not twice as wide as high; taken as lat-long, the whole sphere stretched over it"
        )
    }))
}

/// What cannot be infinite is made as bright as the file can say.
fn finite_suns(image: &mut LinearImage) -> Option<String> {
    let colors = || image.pixels.iter().flat_map(|p| &p[..3]);
    let infinite = colors().filter(|v| **v == f32::INFINITY).count();
    if infinite == 0 {
        return None;
    }
    let finite = colors().filter(|v| v.is_finite());
    let top = finite.fold(f32::from(f16::MAX), |m, v| m.max(*v));
    for pixel in &mut image.pixels {
        for v in pixel[..3].iter_mut().filter(|v| **v == f32::INFINITY) {
            *v = top;
        }
    }
    Some(format!(
        "radiance: {infinite} values are infinite and were taken as {top}; the sun may be far too dark"
    ))
}
