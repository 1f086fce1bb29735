//! Recipes of data sets.

use lumi_core::{Error, Result};
use serde::{Deserialize, Deserializer, Serialize};
use std::path::PathBuf;

/// What to generate. Object `k` depends on the seed and `k` only, never on shards or threads.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct GenerateConfig {
    /// Number of objects of the whole set.
    pub objects: usize,
    /// Index of the first object.
    pub first: usize,
    /// This process's part `[i, n]`: objects whose index is `i` modulo `n`.
    pub shard: [usize; 2],
    /// Seed of everything.
    pub seed: u64,
    /// Side of the square images in pixels.
    pub resolution: usize,
    /// Paths per pixel.
    pub samples: u32,
    /// Samples of each environment and area light per path at the first surface.
    pub light_samples: u32,
    /// Whether to smooth indirect light.
    pub denoise: bool,
    /// Views per object.
    pub views: usize,
    /// Of these, how many lie on an arc as a hand-held capture's; the rest is spread over the band of elevations.
    pub arc_views: usize,
    /// Least and greatest horizontal field of view in degrees, drawn once per object; one number for both.
    #[serde(deserialize_with = "one_or_two")]
    pub fov_deg: [f32; 2],
    /// Nearest and farthest camera distance from the origin; objects have radius 1.
    pub distance: [f32; 2],
    /// Instead of `distance`: nearest and farthest in units of the distance at which the unit ball just touches
    /// the edges of the picture. 1 to 1.3 is how people frame.
    pub framing: Option<[f32; 2]>,
    /// Lowest and highest camera elevation in degrees; uniform over that band of the sphere.
    pub elevation_deg: [f32; 2],
    /// Fewest and most environment maps per object.
    pub environments: [usize; 2],
    /// Share of environment maps that come from `hdri` rather than from formulas.
    pub hdri_share: f32,
    /// Folder of `.hdr` or `.exr` lat-long maps; none means procedural maps only.
    pub hdri: Option<PathBuf>,
    /// Folder of models (glTF, GLB, OBJ) to mix in.
    pub models: Option<PathBuf>,
    /// Share of objects that are models of `models`, with colours and roughness varied.
    pub model_share: f32,
    /// Share of records that show several objects on a ground.
    pub scene_share: f32,
    /// Share of those whose ground fills the picture of every camera; the rest stand on a disc.
    pub filled_share: f32,
    /// Fewest and most objects of those.
    pub scene_objects: [usize; 2],
    /// Which part of all objects, models and maps this set is made of. No file and no seed is in both.
    pub split: Split,
    /// Share of the files of `hdri` and `models` that only the held-out split has, by a hash of their names.
    pub held_out: f32,
    /// Point lights per object.
    pub points: usize,
    /// Fewest and most area lights per object; one number for both.
    #[serde(deserialize_with = "one_or_two")]
    pub areas: [usize; 2],
    /// Nearest and farthest distance of point and area lights, on the upper hemisphere.
    pub light_distance: [f32; 2],
    /// Least and most power of point and area lights in watts.
    pub light_power: [f32; 2],
    /// Least and greatest side of area lights.
    pub area_size: [f32; 2],
}

/// A part of the data.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Split {
    /// To train on.
    #[default]
    Train,
    /// Never trained on.
    HeldOut,
}

/// `50` or `[25, 60]`.
fn one_or_two<'de, D, T>(from: D) -> std::result::Result<[T; 2], D::Error>
where
    D: Deserializer<'de>,
    T: Deserialize<'de> + Copy,
{
    #[derive(Deserialize)]
    #[serde(untagged)]
    enum Either<T> {
        One(T),
        Two([T; 2]),
    }
    Ok(match Either::deserialize(from)? {
        Either::One(v) => [v; 2],
        Either::Two(v) => v,
    })
}

impl Default for GenerateConfig {
    fn default() -> Self {
        Self {
            objects: 16,
            first: 0,
            shard: [0, 1],
            seed: 0,
            resolution: 64,
            samples: 16,
            light_samples: 4,
            denoise: true,
            views: 16,
            arc_views: 0,
            fov_deg: [50.0; 2],
            distance: [2.55, 2.95],
            framing: None,
            elevation_deg: [5.0, 75.0],
            environments: [2, 3],
            hdri_share: 0.4,
            hdri: None,
            models: None,
            model_share: 0.2,
            scene_share: 0.0,
            filled_share: 0.67,
            scene_objects: [1, 8],
            split: Split::Train,
            held_out: 0.0,
            points: 4,
            areas: [2; 2],
            light_distance: [3.0, 5.0],
            light_power: [500.0, 1500.0],
            area_size: [0.5, 4.0],
        }
    }
}

impl GenerateConfig {
    /// Checks ranges.
    ///
    /// # Errors
    /// Names the field and what was expected.
    pub fn validate(&self) -> Result<()> {
        let range = |field: &str, [low, high]: [f32; 2], least: f32| {
            if low.is_finite() && high.is_finite() && low >= least && high >= low {
                Ok(())
            } else {
                let expected = format!("expected {least} ≤ low ≤ high, found {low} and {high}");
                Err(Error::value(field, expected))
            }
        };
        // Cameras and lights must stay outside the unit ball that the object fills.
        range("distance", self.distance, 1.05)?;
        range("light_distance", self.light_distance, 1.05)?;
        range("elevation_deg", self.elevation_deg, -90.0)?;
        range("light_power", self.light_power, 1e-3)?;
        range("area_size", self.area_size, 1e-3)?;
        let positive = [
            ("resolution", self.resolution),
            ("samples", self.samples as usize),
            ("light_samples", self.light_samples as usize),
            ("views", self.views),
            ("lights", self.environments[0] + self.points + self.areas[0]),
        ];
        for (field, n) in positive {
            if n == 0 {
                return Err(Error::value(field, "expected at least 1, found 0"));
            }
        }
        if self.objects > 1 << 30 || self.first > 1 << 40 {
            return Err(Error::value("objects", "expected at most 2³⁰"));
        }
        if self.resolution > 4096 {
            return Err(Error::value("resolution", "expected at most 4096 pixels"));
        }
        range("fov_deg", self.fov_deg, 1.0)?;
        if self.fov_deg[1] > 150.0 {
            return Err(Error::value("fov_deg", "expected 1° to 150°"));
        }
        if let Some(framing) = self.framing {
            range("framing", framing, 0.5)?;
            // The narrowest allowed view is the nearest one: it must be outside the ball.
            if framing[0] / (0.5 * self.fov_deg[1].to_radians()).sin() < 1.05 {
                let expected =
                    "expected cameras outside the unit ball for the widest field of view";
                return Err(Error::value("framing", expected));
            }
        }
        if self.arc_views > self.views {
            return Err(Error::value("arc_views", "expected at most `views`"));
        }
        let [few, many] = self.scene_objects;
        if few == 0 || few > many || many > 64 {
            return Err(Error::value(
                "scene_objects",
                "expected 1 ≤ fewest ≤ most ≤ 64",
            ));
        }
        for (field, [few, many]) in [("environments", self.environments), ("areas", self.areas)] {
            if few > many {
                return Err(Error::value(field, "expected fewest ≤ most"));
            }
        }
        for (field, share) in [
            ("hdri_share", self.hdri_share),
            ("model_share", self.model_share),
            ("scene_share", self.scene_share),
            ("filled_share", self.filled_share),
            ("held_out", self.held_out),
        ] {
            if !(0.0..=1.0).contains(&share) {
                return Err(Error::value(field, "expected a share from 0 to 1"));
            }
        }
        let [i, n] = self.shard;
        if i >= n {
            let expected = format!("expected [i, n] with i < n, found [{i}, {n}]");
            return Err(Error::value("shard", expected));
        }
        Ok(())
    }
}
