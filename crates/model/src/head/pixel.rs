//! What finishes each pixel by itself: tokens see a patch as a whole, and their few numbers cannot say of each of its pixels which
//! photograph shows it best and where the silhouette runs.

use crate::ModelConfig;
use crate::layers::Linear;
use burn::module::Module;
use burn::tensor::activation::relu;
use burn::tensor::{Device, Tensor};
use lumi_core::reprojection::{NEAREST, OF_NEAREST};
use lumi_core::seed::Rng;

/// Numbers per pixel that tokens tell it, besides those that it corrects.
pub const FEATURES: usize = 16;

/// Three linear layers with ReLU between, the same for every pixel.
#[derive(Module, Debug)]
pub struct PixelMlp {
    /// `[width, inputs]`, inputs = the head's numbers, how direct light falls, what photographs show, and 1
    pub first: Linear,
    /// `[width, width]`
    pub second: Linear,
    /// `[corrections + NEAREST, width]`
    pub last: Linear,
}

impl PixelMlp {
    /// For a config with `pixel_mlp`. The last layer begins at zero: nothing is corrected until it learns.
    #[must_use]
    pub fn new(config: &ModelConfig, rng: &mut Rng, device: &Device) -> Self {
        let width = config.pixel_mlp;
        let [_, direct, carried] = config.target_parts();
        let inputs = config.head_channels() + direct + carried + 1;
        let outputs = config.head_channels() - FEATURES + NEAREST;
        let mut layer = |output: usize, input: usize, gain: f32| {
            let std = gain * (2.0 / input as f32).sqrt();
            Linear::new(output, input, std, rng, device)
        };
        Self {
            first: layer(width, inputs, 1.0),
            second: layer(width, width, 1.0),
            last: layer(outputs, width, 0.0),
        }
    }

    /// Corrected numbers, and what the photographs show with the surface's colour corrected toward the nearest photographs'.
    ///
    /// # Shapes
    /// numbers `[m, n + FEATURES, h, w]`, given (direct light, then what photographs show, as of the config) `[m, c, h, w]` →
    /// `[m, n, h, w]` and `[m, 4, h, w]`
    #[must_use]
    pub fn forward(
        &self,
        numbers: Tensor<4>,
        given: Tensor<4>,
        config: &ModelConfig,
    ) -> (Tensor<4>, Tensor<4>) {
        let [m, told, h, w] = numbers.dims();
        let n = told - FEATURES;
        let one = Tensor::ones([m, 1, h, w], &numbers.device());
        let x = Tensor::cat(vec![numbers.clone(), given.clone(), one], 1);
        let ([_, direct, _], surface) = (config.target_parts(), config.surface_channels());
        let carried = given.narrow(1, direct, surface + NEAREST * OF_NEAREST);
        let x = x.reshape([m as i32, -1, (h * w) as i32]);
        let layer = |linear: &Linear, x: Tensor<3>| linear.weight.val().unsqueeze().matmul(x);
        let x = relu(layer(&self.first, x));
        let x = relu(layer(&self.second, x));
        let change = layer(&self.last, x).reshape([m, n + NEAREST, h, w]);
        let mut colour = carried.clone().narrow(1, 0, 3);
        for k in 0..NEAREST {
            let difference = carried.clone().narrow(1, surface + k * OF_NEAREST, 3);
            colour = colour + difference * change.clone().narrow(1, n + k, 1);
        }
        let coverage = carried.narrow(1, 3, 1);
        (
            numbers.narrow(1, 0, n) + change.narrow(1, 0, n),
            Tensor::cat(vec![colour, coverage], 1),
        )
    }
}
