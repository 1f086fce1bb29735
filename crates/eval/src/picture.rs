//! What is compared: an image as it is shown, and what a display clips.

use crate::Result;
use lumi_core::color::srgb_decode;
use lumi_core::image::{box_downscale, read_photograph};
use lumi_core::{Camera, DisplayImage, LinearImage};
use lumi_model::config::Output;
use lumi_model::{Relighter, SceneTokens};
use std::path::Path;

/// An image to be compared.
#[derive(Clone, Debug, PartialEq)]
pub struct Picture {
    /// As it is shown: clipped, over its background.
    pub shown: DisplayImage,
    /// The linear values without clipping, one per pixel, where the source has them: the object's straight
    /// colour where it covers more than half of a pixel, else what is behind the shown value.
    pub linear: Option<Vec<[f32; 3]>>,
}

impl From<DisplayImage> for Picture {
    fn from(shown: DisplayImage) -> Self {
        Self {
            shown,
            linear: None,
        }
    }
}

impl Picture {
    /// What is shown, and the radiance that it was clipped from. Negative radiance (noise of a camera) becomes zero.
    ///
    /// # Panics
    /// If the sizes differ.
    #[must_use]
    pub fn with_radiance(shown: DisplayImage, radiance: &LinearImage) -> Self {
        assert_eq!(
            (shown.width, shown.height),
            (radiance.width, radiance.height),
            "images of one size"
        );
        let value = |(&[r, g, b, a], shown): (&[f32; 4], &[f32; 3])| {
            if a > 0.5 {
                [r, g, b].map(|v| (v / a).max(0.0))
            } else {
                shown.map(srgb_decode)
            }
        };
        let pixels = radiance.pixels.iter().zip(&shown.pixels);
        Self {
            linear: Some(pixels.map(value).collect()),
            shown,
        }
    }

    /// Reads a picture; EXR and HDR files have linear values.
    ///
    /// # Errors
    /// As [`lumi_core::image::read_display`].
    pub fn read(path: impl AsRef<Path>) -> lumi_core::Result<Self> {
        let (shown, linear) = read_photograph(path)?;
        Ok(match linear {
            Some(linear) => Self::with_radiance(shown, &linear),
            None => shown.into(),
        })
    }

    /// The scene as a model sees it from `cameras`, with the radiance beyond white where it makes any. Models with
    /// [`Relighter::with_detail`] make larger pictures, of which these are the averages.
    ///
    /// # Errors
    /// As [`Relighter::render`].
    pub fn rendered(
        model: &Relighter,
        tokens: &SceneTokens,
        cameras: &[Camera],
    ) -> Result<Vec<Self>> {
        if model.config.output == Output::Display {
            return Ok(Self::all(&model.render(tokens, cameras)?));
        }
        let detail = model.detail();
        let finer = |c: &Camera| c.resized(c.width * detail, c.height * detail);
        let finer: Vec<Camera> = cameras.iter().map(finer).collect();
        let radiance = model.render_radiance(tokens, &finer)?;
        let picture = |(image, camera): (&LinearImage, &Camera)| {
            let image = box_downscale(image, camera.width, camera.height)?;
            Ok(Self::with_radiance(image.to_display(), &image))
        };
        radiance.iter().zip(cameras).map(picture).collect()
    }

    /// Plain display images.
    #[must_use]
    pub fn all(images: &[DisplayImage]) -> Vec<Self> {
        images.iter().cloned().map(Self::from).collect()
    }

    /// Linear values of pixel `i`, unclipped where they are known.
    ///
    /// # Panics
    /// If the index is out of range.
    #[must_use]
    pub fn linear_at(&self, i: usize) -> [f32; 3] {
        match &self.linear {
            Some(linear) => linear[i],
            None => self.shown.pixels[i].map(srgb_decode),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_the_object_keeps_what_is_beyond_white() {
        let radiance = LinearImage {
            width: 3,
            height: 1,
            pixels: vec![[3.0, 0.5, -0.1, 1.0], [1.6, 0.4, 0.0, 0.8], [0.0; 4]],
        };
        let picture = Picture::with_radiance(radiance.to_display(), &radiance);
        let linear = picture.linear.as_ref().expect("linear values");
        assert_eq!(linear[0], [3.0, 0.5, 0.0]);
        assert!((linear[1][0] - 2.0).abs() < 1e-6 && (linear[1][1] - 0.5).abs() < 1e-6);
        assert_eq!(linear[2], [1.0; 3]);
        assert_eq!(Picture::from(picture.shown).linear_at(0)[0], 1.0);
    }
}
