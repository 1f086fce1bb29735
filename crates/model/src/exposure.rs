//! How bright photographs are for the light that they were taken in, where that is known.
//!
//! A dark object in bright light and a bright one in dim light look alike, and cameras choose exposure and white balance: from
//! photographs alone nobody can tell how much of the light an object sends back. With the captured light it can be told: put
//! under that light by an edit, the object must look as it was photographed.

use crate::config::Output;
use crate::relighter::Captured;
use crate::{Edit, Error, Illumination, Relighter, Result, SceneFrame, SceneTokens};
use lumi_core::color::srgb_decode;
use lumi_core::{Camera, DisplayImage, Light, LinearImage};
use std::sync::Arc;

/// What light is multiplied with, per channel, so that pictures under it come out as the photographs' camera would have exposed
/// and balanced them; 1 where the captured light is not known.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Exposure(pub [f64; 3]);

impl Default for Exposure {
    fn default() -> Self {
        Self([1.0; 3])
    }
}

impl Exposure {
    pub(crate) fn is_unknown(&self) -> bool {
        *self == Self::default()
    }

    /// That with which `pictures` are as bright, per channel, as what photographs of the same views show of the object: the ratio of
    /// sums over pixels that the object covers in both and that the photograph does not clip. A channel without light keeps 1.
    fn between(pictures: &[LinearImage], photographs: &[DisplayImage]) -> Option<Self> {
        let (mut made, mut shown, mut pixels) = ([0.0_f64; 3], [0.0_f64; 3], 0_usize);
        for (picture, photograph) in pictures.iter().zip(photographs) {
            let covered = |i: usize| photograph.alpha.as_ref().map_or(1.0, |a| a[i]) > COVERED;
            for (i, (p, t)) in picture.pixels.iter().zip(&photograph.pixels).enumerate() {
                if !covered(i) || p[3] <= COVERED || t.iter().any(|v| *v >= CLIPPED) {
                    continue;
                }
                pixels += 1;
                for c in 0..3 {
                    made[c] += f64::from(p[c] / p[3]);
                    shown[c] += f64::from(srgb_decode(t[c]));
                }
            }
        }
        let ratio = |c: usize| {
            if made[c] > 0.0 {
                shown[c] / made[c]
            } else {
                1.0
            }
        };
        (pixels > 0).then(|| Self([0, 1, 2].map(ratio)))
    }
}

/// Alpha from which a pixel counts as the object's.
const COVERED: f32 = 0.9;
/// Display value from which a photograph may have clipped.
const CLIPPED: f32 = 0.98;

impl Relighter {
    /// Whether it takes [`Self::with_captured_light`].
    #[must_use]
    pub fn takes_captured_light(&self) -> bool {
        self.config.reprojection && self.config.output == Output::Radiance
    }

    /// The capture, told the light that its photographs were taken in, in world space: all later edits are then as bright, and as
    /// tinted, as the photographs' camera would have shown them. How much the photographs differ from what the model makes of
    /// them under that light settles it, for each channel.
    ///
    /// Not part of the paper, whose captured light is unknown.
    ///
    /// # Errors
    /// As [`Self::edit`]; for tokens that were edited, for models that do not take it, and if the photographs show nothing that
    /// is not clipped.
    pub fn with_captured_light(
        &self,
        capture: &SceneTokens,
        lights: &[Light],
    ) -> Result<SceneTokens> {
        let unfit = |text: &str| Err(Error::Unsupported(text.to_owned()));
        let photographs = capture.captured.photographs.as_ref();
        let Some(photographs) = photographs.filter(|_| self.takes_captured_light()) else {
            return unfit(
                "captured light: expected a model that is given the photographs and makes radiance",
            );
        };
        if capture.illumination != Illumination::CAPTURED || !capture.lights().is_empty() {
            return unfit("captured light: expected scene tokens before any edit");
        }
        let frame = SceneFrame {
            exposure: Exposure::default(),
            ..capture.captured.frame.clone()
        };
        let told = |frame| SceneTokens {
            captured: Arc::new(Captured {
                frame,
                scene: capture.captured.scene.clone(),
                photographs: Some(photographs.clone()),
            }),
            ..capture.clone()
        };
        let unknown = told(frame.clone());
        let lit = self.edit(&unknown, &Edit::set(lights))?;
        let to_world = frame.to_model.inverse();
        let camera = |c: &Camera| {
            let fine = c.resized(c.width * self.detail, c.height * self.detail);
            fine.transformed(&to_world)
        };
        let cameras: Vec<Camera> = frame.views.iter().map(camera).collect();
        let pictures = self.render_radiance(&lit, &cameras)?;
        let Some(exposure) = Exposure::between(&pictures, &photographs.fine.images()) else {
            return unfit("captured light: expected photographs that show the object unclipped");
        };
        Ok(told(SceneFrame { exposure, ..frame }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use lumi_core::color::srgb_encode;
    use std::slice::from_ref;

    #[test]
    fn the_ratio_is_that_of_what_both_show_and_nothing_clips() {
        let picture = LinearImage {
            width: 4,
            height: 1,
            pixels: vec![
                [0.2, 0.1, 0.4, 1.0],
                [0.1, 0.1, 0.1, 0.95],
                [0.9; 4],
                [0.0; 4],
            ],
        };
        // Brighter by 2, 3 and a half, then clipped, then outside.
        let straight = |p: &[f32; 4]| [2.0, 3.0, 0.5].map(|k| k * p[0] / p[3]);
        let mut shown: Vec<[f32; 3]> = picture.pixels[..2]
            .iter()
            .map(|p| {
                let [r, g, b] = [0, 1, 2].map(|c| p[c] / p[3]);
                [2.0 * r, 3.0 * g, 0.5 * b].map(srgb_encode)
            })
            .collect();
        shown.extend([[1.0, 0.2, 0.2], straight(&[0.5; 4])]);
        let photograph = DisplayImage {
            width: 4,
            height: 1,
            pixels: shown,
            alpha: Some(vec![1.0, 1.0, 1.0, 0.0]),
        };
        let all = Exposure::between(from_ref(&picture), from_ref(&photograph));
        for (found, expected) in all.expect("seen").0.into_iter().zip([2.0, 3.0, 0.5]) {
            assert!((found - expected).abs() < 1e-4, "{found} for {expected}");
        }
        let outside = DisplayImage {
            alpha: Some(vec![0.0; 4]),
            ..photograph
        };
        assert_eq!(Exposure::between(&[picture], &[outside]), None);
    }
}
