//! The pictures that an object contributes to a report's sheets.

use lumi_core::DisplayImage;
use lumi_core::color::srgb_encode;
use serde::{Deserialize, Serialize};

/// One picture on a sheet.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Tile {
    /// The sheet: `grid`, `light-sweep`, `steps-…`.
    pub sheet: String,
    /// Label of its row.
    pub row: String,
    /// Caption below it.
    pub caption: String,
    /// File name within the object's folder.
    pub file: String,
}

/// Pictures of one object while it is being evaluated.
#[derive(Default)]
pub struct Gallery {
    /// What was kept, in the order of the sheets.
    pub tiles: Vec<(Tile, DisplayImage)>,
    /// Predictions by case and view, to be saved as `lumi score` reads them.
    pub predictions: Vec<(String, String, DisplayImage)>,
}

impl Gallery {
    /// Adds a picture to a row of a sheet.
    pub fn add(&mut self, sheet: &str, row: &str, caption: impl Into<String>, image: DisplayImage) {
        let file = format!("{:04}.png", self.tiles.len());
        let tile = Tile {
            sheet: sheet.to_owned(),
            row: row.to_owned(),
            caption: caption.into(),
            file,
        };
        self.tiles.push((tile, image));
    }
}

/// Error that is shown at the bright end of [`error_map`].
pub const ERROR_RANGE: f32 = 0.5;

/// Where an image is wrong: the mean absolute difference over the channels, from black (none) over purple and
/// orange to pale yellow ([`ERROR_RANGE`] and above).
///
/// # Panics
/// If the sizes differ.
#[must_use]
pub fn error_map(a: &DisplayImage, b: &DisplayImage) -> DisplayImage {
    assert_eq!(
        (a.width, a.height),
        (b.width, b.height),
        "images of one size"
    );
    let pixels = a.pixels.iter().zip(&b.pixels).map(|(p, q)| {
        let error = (0..3).map(|c| (p[c] - q[c]).abs()).sum::<f32>() / 3.0;
        heat(error / ERROR_RANGE)
    });
    DisplayImage {
        pixels: pixels.collect(),
        alpha: None,
        ..*a
    }
}

/// A colour scale whose lightness grows evenly.
fn heat(t: f32) -> [f32; 3] {
    const STOPS: [[f32; 3]; 5] = [
        [0.0, 0.0, 0.01],
        [0.08, 0.01, 0.16],
        [0.45, 0.03, 0.16],
        [0.95, 0.32, 0.06],
        [0.97, 0.93, 0.6],
    ];
    let t = t.clamp(0.0, 1.0) * (STOPS.len() - 1) as f32;
    let i = (t as usize).min(STOPS.len() - 2);
    let f = t - i as f32;
    std::array::from_fn(|c| srgb_encode(STOPS[i][c] + f * (STOPS[i + 1][c] - STOPS[i][c])))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn errors_grow_brighter() {
        let truth = DisplayImage::filled(1, 1, [0.5; 3]);
        let brightness = |v: f32| {
            let map = error_map(&DisplayImage::filled(1, 1, [v; 3]), &truth);
            map.pixels[0].iter().sum::<f32>()
        };
        let levels = [0.5, 0.6, 0.7, 0.85, 1.0].map(brightness);
        assert!(levels.windows(2).all(|w| w[0] < w[1]), "{levels:?}");
    }
}
