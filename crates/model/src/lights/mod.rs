//! From lights to tokens.

mod authors;
mod shape;

pub use authors::{AuthorsFrame, AuthorsTokenizer};
pub use shape::{LightShape, MOMENTS, SHAPE_FEATURES, seen_from};

use crate::ModelConfig;
use crate::config::{LightConfig, Mode, Output};
use crate::layers::{Linear, normal};
use burn::module::{Module, Param};
use burn::tensor::{Device, Tensor, TensorData};
use lumi_core::Light;
use lumi_core::light::{LightRay, RayPattern};
use lumi_core::seed::Rng;

/// Numbers per light ray: direction, moment, colour, power.
pub const RAY_FEATURES: usize = 10;

/// The least irradiance that is told from darkness; the logarithm of power begins there.
const DARK: f32 = 1e-4;
/// What logarithms of power are divided by, which brings them to the size of the other features.
const POWER_SCALE: f32 = 4.0;

/// Turns light features into tokens.
#[derive(Module, Debug)]
pub enum LightTokenizer {
    /// One format for every light.
    Rays(RayTokenizer),
    /// The authors' two.
    Authors(AuthorsTokenizer),
}

/// Linear map of ray features plus an embedding of the edit's mode.
#[derive(Module, Debug)]
pub struct RayTokenizer {
    /// `[d, RAY_FEATURES]`, or `[d, SHAPE_FEATURES]` for lights that are told by their shape.
    pub rays: Linear,
    /// `[3, d]`, rows as in [`Mode::ALL`]
    pub mode: Param<Tensor<2>>,
    /// What is added to scene tokens, `[d, MOMENTS]`, for lights that are told by their shape.
    pub moments: Option<Linear>,
}

/// The light of an edit, ready for the editor.
#[derive(Clone, Debug)]
pub struct EditLight {
    /// `[b, m, d]`, which take part in the attention.
    pub tokens: Tensor<3>,
    /// For lights that are told by their shape: each sample's moments, and how far it may change the tokens.
    pub shapes: Option<Vec<([f32; MOMENTS], f32)>>,
}

impl From<Tensor<3>> for EditLight {
    /// Light that is tokens alone.
    fn from(tokens: Tensor<3>) -> Self {
        Self {
            tokens,
            shapes: None,
        }
    }
}

impl LightTokenizer {
    /// Random weights for a config.
    pub fn new(config: &ModelConfig, std: f32, rng: &mut Rng, device: &Device) -> Self {
        let dim = config.dim;
        match &config.lights {
            LightConfig::Rays { .. } => {
                let shape = config.output == Output::Radiance;
                let features = if shape { SHAPE_FEATURES } else { RAY_FEATURES };
                Self::Rays(RayTokenizer {
                    rays: Linear::new(dim, features, std, rng, device),
                    mode: normal([Mode::ALL.len(), dim], std, rng, device),
                    moments: shape.then(|| Linear::new(dim, MOMENTS, std, rng, device)),
                })
            }
            LightConfig::Authors {
                environment_patch,
                point_rays,
                ..
            } => {
                let environment =
                    environment_patch.map(|p| Linear::new(dim, 9 * p * p, std, rng, device));
                let point = point_rays.then(|| Linear::new(dim, RAY_FEATURES, std, rng, device));
                Self::Authors(AuthorsTokenizer { environment, point })
            }
        }
    }
}

impl RayTokenizer {
    /// # Shapes
    /// features `[b, rays, _]` → tokens `[b, rays, d]`
    #[must_use]
    pub fn forward(&self, features: Tensor<3>, mode: Mode) -> Tensor<3> {
        let row = Mode::ALL.iter().position(|m| *m == mode).unwrap_or(0);
        let embedding = self.mode.val().narrow(0, row, 1).unsqueeze::<3>();
        self.rays.forward(features) + embedding
    }

    /// Light that is told by its shape, a sample each.
    ///
    /// # Panics
    /// If the samples have different numbers of rays.
    #[must_use]
    pub fn of_shapes(&self, shapes: &[LightShape], mode: Mode) -> EditLight {
        let each = shapes.first().map_or(0, |shape| shape.rays.len());
        assert!(
            shapes.iter().all(|shape| shape.rays.len() == each),
            "samples of a batch need equally many rays"
        );
        let features: Vec<f32> = shapes
            .iter()
            .flat_map(|shape| &shape.rays)
            .copied()
            .collect();
        let size = [shapes.len(), each / SHAPE_FEATURES, SHAPE_FEATURES];
        let device = self.rays.weight.val().device();
        let features = Tensor::from_data(TensorData::new(features, size), &device);
        EditLight {
            tokens: self.forward(features, mode),
            shapes: Some(shapes.iter().map(|s| (s.moments, s.reach)).collect()),
        }
    }
}

/// Ray features of `lights` (in model space), version 1: d, o × d, colour normalised to its
/// largest channel, and log power `ln(max(e, 10⁻⁴)) / 4` of the largest channel's irradiance at the
/// scene's centre (a fixed share per ray, see [`LightRay::irradiance`]).
///
/// Returns `[rays, 10]`, row-major.
#[must_use]
pub fn ray_features(lights: &[Light], pattern: &RayPattern) -> Vec<f32> {
    features_of(lights.iter().flat_map(|light| light.rays(pattern)))
}

/// [`ray_features`] of rays.
#[must_use]
pub fn features_of(rays: impl IntoIterator<Item = LightRay>) -> Vec<f32> {
    let mut features = Vec::new();
    for ray in rays {
        let power = ray.irradiance.iter().fold(0.0_f32, |m, v| m.max(*v));
        let color = ray
            .irradiance
            .map(|v| if power > 0.0 { v / power } else { 0.0 });
        features.extend(ray.direction.to_array());
        features.extend(ray.moment().to_array());
        features.extend(color);
        features.push(power.max(DARK).ln() / POWER_SCALE);
    }
    features
}

/// [`ray_features`] of each sample of a batch as a tensor.
///
/// # Shapes
/// `b` lists of lights with equally many rays → `[b, rays, 10]`
///
/// # Panics
/// If the samples have different numbers of rays.
#[must_use]
pub fn ray_batch(samples: &[Vec<Light>], pattern: &RayPattern, device: &Device) -> Tensor<3> {
    let features: Vec<_> = samples
        .iter()
        .map(|lights| ray_features(lights, pattern))
        .collect();
    let each = features.first().map_or(0, Vec::len);
    assert!(
        features.iter().all(|f| f.len() == each),
        "samples of a batch need equally many rays"
    );
    let shape = [samples.len(), each / RAY_FEATURES, RAY_FEATURES];
    Tensor::from_data(TensorData::new(features.concat(), shape), device)
}
