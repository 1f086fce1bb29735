//! The MLP head: each token becomes its patch.

use super::HeadInput;
use crate::ModelConfig;
use crate::layers::{LayerNorm, Linear};
use burn::module::Module;
use burn::tensor::{Device, Tensor};
use lumi_core::seed::Rng;

/// LayerNorm, linear, sigmoid; inside a token pixels run row, column, colour.
#[derive(Module, Debug)]
pub struct Mlp {
    /// `[d]`
    pub norm: LayerNorm,
    /// `[3·p², d]`
    pub pixels: Linear,
}

impl Mlp {
    pub(super) fn new(config: &ModelConfig, std: f32, rng: &mut Rng, device: &Device) -> Self {
        let outputs = 3 * config.patch * config.patch;
        Self {
            norm: LayerNorm::new(config.dim, device),
            pixels: Linear::new(outputs, config.dim, std, rng, device),
        }
    }

    pub(super) fn logits(&self, input: &HeadInput, patch: usize) -> Tensor<4> {
        let HeadInput { rows, columns, .. } = *input;
        let pixels = self.pixels.forward(self.norm.forward(input.last.clone()));
        let m = pixels.dims()[0];
        pixels
            .reshape([m, rows, columns, patch, patch, 3])
            .permute([0, 5, 1, 3, 2, 4])
            .reshape([m, 3, rows * patch, columns * patch])
    }
}
