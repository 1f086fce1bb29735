//! Images: linear radiance inside, display-encoded sRGB at the borders.

mod animation;
pub mod authors;
mod exr_layers;
mod icc;
mod io;
mod jpeg;
mod layers;
mod map;
mod mask;
mod openexr;
mod png;
mod primaries;
mod radiance;
mod resample;
mod turn;

use crate::color::{srgb_decode, srgb_encode};
use crate::{Error, Result};
pub use animation::{encode_gif, enlarged};
pub use io::{
    MAX_PIXELS, Photograph, decode_display, decode_jpeg, decode_linear, encode_exr, encode_png,
    encode_png_with_alpha, read_display, read_linear, read_linear_with_warnings, read_photograph,
    read_photograph_with_warnings, stated_size, type_of, write_exr, write_png,
    write_png_with_alpha,
};
pub use layers::write_layers;
pub use mask::{decode_mask, read_mask, read_mask_with_warnings};
pub use resample::{area_resize, box_downscale, lanczos_resize};
pub use turn::turned;

/// Share of the largest value up to which values beyond their range are what filters leave, not faults.
pub const LEFT_OVER: f32 = 1e-3;

/// Linear Rec. 709 radiance, **premultiplied** by alpha; row-major, `[r, g, b, a]`.
#[derive(Clone, Debug, PartialEq)]
pub struct LinearImage {
    /// Width in pixels.
    pub width: usize,
    /// Height in pixels.
    pub height: usize,
    /// `width · height` pixels.
    pub pixels: Vec<[f32; 4]>,
}

/// What a viewer shows: sRGB-encoded RGB in [0, 1] over a background, with the object's coverage kept apart.
#[derive(Clone, Debug, PartialEq)]
pub struct DisplayImage {
    /// Width in pixels.
    pub width: usize,
    /// Height in pixels.
    pub height: usize,
    /// `width · height` pixels, row-major, already over the background.
    pub pixels: Vec<[f32; 3]>,
    /// Coverage of each pixel by the object in [0, 1], where the source had alpha or a mask.
    pub alpha: Option<Vec<f32>>,
}

impl LinearImage {
    /// A transparent black image.
    #[must_use]
    pub fn new(width: usize, height: usize) -> Self {
        Self {
            width,
            height,
            pixels: vec![[0.0; 4]; width * height],
        }
    }

    /// Light is not negative. What filters and denoisers leave below zero, up to a thousandth of the largest value,
    /// becomes zero.
    ///
    /// # Errors
    /// Names the first pixel that is further below.
    pub fn clear_left_overs(&mut self) -> Result<()> {
        let colors = || self.pixels.iter().flat_map(|p| &p[..3]);
        let lowest = -LEFT_OVER * colors().fold(0.0_f32, |m, v| m.max(*v));
        for (i, pixel) in self.pixels.iter_mut().enumerate() {
            if pixel[..3].iter().any(|v| *v < lowest) {
                let (x, y) = (i % self.width, i / self.width);
                let expected = format!("expected radiance ≥ 0, found {pixel:?}");
                return Err(Error::value(format!("pixel ({x}, {y})"), expected));
            }
            pixel[..3].iter_mut().for_each(|v| *v = v.max(0.0));
        }
        Ok(())
    }

    /// Adds `gain · other`'s colour; alpha stays. Both must show the same view.
    ///
    /// # Panics
    /// If the sizes differ.
    pub fn add_light(&mut self, other: &Self, gain: [f32; 3]) {
        assert_eq!(
            (self.width, self.height),
            (other.width, other.height),
            "sizes of one view differ"
        );
        for (a, b) in self.pixels.iter_mut().zip(&other.pixels) {
            for c in 0..3 {
                a[c] += gain[c] * b[c];
            }
        }
    }

    /// Display encoding over white: `sRGB(clip(rgb / a)) · a + (1 − a)`, blended after encoding.
    #[must_use]
    pub fn to_display(&self) -> DisplayImage {
        let pixels = self
            .pixels
            .iter()
            .map(|&[r, g, b, a]| {
                let alpha = a.clamp(0.0, 1.0);
                let encode = |v: f32| {
                    if alpha > 0.0 {
                        srgb_encode(v / alpha) * alpha + (1.0 - alpha)
                    } else {
                        1.0
                    }
                };
                [encode(r), encode(g), encode(b)]
            })
            .collect();
        let alpha = Some(self.pixels.iter().map(|p| p[3].clamp(0.0, 1.0)).collect());
        DisplayImage {
            width: self.width,
            height: self.height,
            pixels,
            alpha,
        }
    }
}

impl DisplayImage {
    /// A uniform image without alpha.
    #[must_use]
    pub fn filled(width: usize, height: usize, color: [f32; 3]) -> Self {
        Self {
            width,
            height,
            pixels: vec![color; width * height],
            alpha: None,
        }
    }

    /// Three bytes a pixel, row-major, rounded.
    #[must_use]
    pub fn to_bytes(&self) -> Vec<u8> {
        let byte = |v: f32| (v.clamp(0.0, 1.0) * 255.0).round() as u8;
        self.pixels.iter().flat_map(|p| p.map(byte)).collect()
    }

    /// The linear values behind the encoding, opaque: what the background hid stays hidden.
    #[must_use]
    pub fn to_linear(&self) -> LinearImage {
        let linear = |p: &[f32; 3]| {
            let [r, g, b] = p.map(srgb_decode);
            [r, g, b, 1.0]
        };
        LinearImage {
            width: self.width,
            height: self.height,
            pixels: self.pixels.iter().map(linear).collect(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn display_encoding_blends_after_encoding() {
        let image = LinearImage {
            width: 2,
            height: 1,
            pixels: vec![[0.25, 0.25, 0.25, 0.5], [0.0, 0.0, 0.0, 0.0]],
        };
        let shown = image.to_display();
        assert!((shown.pixels[0][0] - (0.735_357 * 0.5 + 0.5)).abs() < 1e-5);
        assert_eq!(shown.pixels[1], [1.0; 3]);
    }

    #[test]
    fn light_adds_up() {
        let mut sum = LinearImage {
            width: 1,
            height: 1,
            pixels: vec![[0.1, 0.2, 0.3, 1.0]],
        };
        let other = sum.clone();
        sum.add_light(&other, [1.0, 2.0, 0.0]);
        assert_eq!(sum.pixels[0], [0.2, 0.6, 0.3, 1.0]);
    }
}
