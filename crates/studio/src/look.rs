//! How radiance becomes the picture that a person sees: exposure and tone curve. Light itself is changed by edits.

use crate::{Error, Result};
use lumi_core::{DisplayImage, LinearImage};
use schemars::JsonSchema;
use serde::Deserialize;

/// Exposure and tone curve.
#[derive(Clone, Copy, Debug, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Look {
    /// In stops: each one doubles the radiance.
    pub exposure: f32,
    /// What becomes of bright radiance.
    pub tone: Tone,
}

/// A tone curve.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Tone {
    /// The display's curve; what is brighter than white is white.
    #[default]
    Standard,
    /// A shoulder that keeps shades beyond white apart: K. Narkowicz's fit of the ACES curve, 2015.
    Filmic,
}

/// Stops either way.
const STOPS: f32 = 10.0;

impl Look {
    /// Checks its range.
    ///
    /// # Errors
    /// On an exposure that is beyond ten stops either way.
    pub fn check(&self) -> Result<()> {
        if (-STOPS..=STOPS).contains(&self.exposure) {
            return Ok(());
        }
        let found = self.exposure;
        let text = format!("exposure: expected -{STOPS} to {STOPS} stops, found {found}");
        Err(Error::Invalid(text))
    }

    /// A picture of premultiplied radiance, over white, with its alpha.
    #[must_use]
    pub fn shown(&self, radiance: &LinearImage) -> DisplayImage {
        let gain = self.exposure.exp2();
        let toned = |v: f32| match self.tone {
            Tone::Standard => v,
            Tone::Filmic => v * (2.51 * v + 0.03) / (v * (2.43 * v + 0.59) + 0.14),
        };
        let pixel = |p: &[f32; 4]| {
            let alpha = p[3].clamp(0.0, 1.0);
            let colour = |v: f32| match alpha {
                0.0 => 0.0,
                a => a * toned((gain * v / a).max(0.0)).min(1.0),
            };
            [colour(p[0]), colour(p[1]), colour(p[2]), alpha]
        };
        let shown = LinearImage {
            pixels: radiance.pixels.iter().map(pixel).collect(),
            ..*radiance
        };
        shown.to_display()
    }
}

/// Bytes of a picture over white, R G B A of each pixel: colour times alpha, over nothing.
#[must_use]
pub fn cut_out(image: &DisplayImage) -> Vec<u8> {
    let byte = |v: f32| (255.0 * v.clamp(0.0, 1.0)).round() as u8;
    let pixel = |(i, p): (usize, &[f32; 3])| {
        let alpha = image.alpha.as_ref().map_or(1.0, |a| a[i].clamp(0.0, 1.0));
        let [r, g, b] = p.map(|v| byte(v - (1.0 - alpha)));
        [r, g, b, byte(alpha)]
    };
    image.pixels.iter().enumerate().flat_map(pixel).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn image(pixels: &[[f32; 4]]) -> LinearImage {
        LinearImage {
            width: pixels.len(),
            height: 1,
            pixels: pixels.to_vec(),
        }
    }

    #[test]
    fn a_stop_doubles_radiance_and_nothing_else() {
        let radiance = image(&[[0.1, 0.2, 0.05, 1.0], [0.05, 0.1, 0.2, 0.5], [0.0; 4]]);
        let twice = radiance.pixels.iter();
        let twice = twice.map(|&[r, g, b, a]| [2.0 * r, 2.0 * g, 2.0 * b, a]);
        let twice = image(&twice.collect::<Vec<_>>());
        let look = |exposure: f32, tone: Tone| Look { exposure, tone };
        for tone in [Tone::Standard, Tone::Filmic] {
            let (a, b) = (
                look(1.0, tone).shown(&radiance),
                look(0.0, tone).shown(&twice),
            );
            for (a, b) in a.pixels.iter().flatten().zip(b.pixels.iter().flatten()) {
                assert!((a - b).abs() < 1e-5, "{a} and {b}");
            }
        }
        assert_eq!(Look::default().shown(&radiance), radiance.to_display());
        assert!(look(f32::NAN, Tone::Standard).check().is_err());
        assert!(look(-10.5, Tone::Standard).check().is_err());
    }

    #[test]
    fn the_filmic_curve_keeps_bright_shades_apart_and_rises() {
        let filmic = Look {
            exposure: 0.0,
            tone: Tone::Filmic,
        };
        let values = [0.0, 0.05, 0.2, 0.6, 1.0, 2.0, 4.0];
        let pixels: Vec<[f32; 4]> = values.iter().map(|v| [*v, *v, *v, 1.0]).collect();
        let shown = filmic.shown(&image(&pixels));
        let shown: Vec<f32> = shown.pixels.iter().map(|p| p[0]).collect();
        assert!(shown.is_sorted_by(|a, b| a < b), "{shown:?}");
        assert!(shown[6] <= 1.0 && shown[4] < 0.95);
    }

    #[test]
    fn a_cut_out_has_colour_times_alpha() {
        let shown = image(&[[0.5, 0.5, 0.5, 0.5], [0.0; 4]]).to_display();
        assert_eq!(cut_out(&shown), [128, 128, 128, 128, 0, 0, 0, 0]);
        let plain = DisplayImage::filled(1, 1, [1.0, 0.0, 0.2]);
        assert_eq!(cut_out(&plain), [255, 0, 51, 255]);
    }
}
