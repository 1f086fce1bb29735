//! The camera that a person steers: on a sphere around the scene.

use crate::{Error, Result};
use lumi_core::{Camera, Similarity};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// A camera that looks at the scene's centre; angles in radians, distance in radii of the scene's ball.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
#[schemars(rename = "Camera")]
pub struct OrbitCamera {
    /// From +x, counter-clockwise from above.
    pub azimuth: f32,
    /// Above the horizon, within ±π/2.
    pub elevation: f32,
    /// From the centre, 1.05 to 20.
    pub distance: f32,
    /// Field of view, 0.1 to 2.5.
    pub fov: f32,
}

impl OrbitCamera {
    /// The same place as seen from a posed camera of the scene.
    #[must_use]
    pub fn from_camera(camera: &Camera, to_model: &Similarity) -> Self {
        let moved = camera.transformed(to_model);
        let centre = moved.centre();
        let distance = centre.length().max(1e-6);
        Self {
            azimuth: centre.y.atan2(centre.x),
            elevation: (centre.z / distance)
                .clamp(-1.0, 1.0)
                .asin()
                .clamp(-1.5, 1.5),
            distance: distance.clamp(1.05, 20.0),
            fov: (2.0 * (0.5 * camera.width as f32 / camera.fx).atan()).clamp(0.1, 2.5),
        }
    }

    /// The world-space camera of `side × side` pixels.
    ///
    /// # Errors
    /// Names the number that is out of its range.
    pub fn camera(&self, to_model: &Similarity, side: usize) -> Result<Camera> {
        let within = |name: &str, value: f32, low: f32, high: f32| {
            if value.is_finite() && (low..=high).contains(&value) {
                return Ok(());
            }
            let text = format!("camera.{name}: expected {low} to {high}, found {value}");
            Err(Error::Invalid(text))
        };
        within("azimuth", self.azimuth, -1e4, 1e4)?;
        within("elevation", self.elevation, -1.571, 1.571)?;
        within("distance", self.distance, 1.05, 20.0)?;
        within("fov", self.fov, 0.1, 2.5)?;
        let camera = Camera::orbit(self.azimuth, self.elevation, self.distance, self.fov, side);
        Ok(camera.transformed(&to_model.inverse()))
    }
}
