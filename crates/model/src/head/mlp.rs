//! The MLP head: each token becomes its patch.

use super::HeadInput;
use crate::ModelConfig;
use crate::layers::{LayerNorm, Linear};
use burn::module::Module;
use burn::tensor::{Device, Tensor};
use lumi_core::seed::Rng;

/// LayerNorm, linear; inside a token pixels run row, column, channel.
#[derive(Module, Debug)]
pub struct Mlp {
    /// `[d]`
    pub norm: LayerNorm,
    /// `[channels·p², d]`
    pub pixels: Linear,
}

impl Mlp {
    pub(super) fn new(
        config: &ModelConfig,
        channels: usize,
        std: f32,
        rng: &mut Rng,
        device: &Device,
    ) -> Self {
        let outputs = channels * config.patch * config.patch;
        Self {
            norm: LayerNorm::new(config.dim, device),
            pixels: Linear::new(outputs, config.dim, std, rng, device),
        }
    }

    pub(super) fn logits(&self, input: &HeadInput, patch: usize) -> Tensor<4> {
        let HeadInput { rows, columns, .. } = *input;
        let pixels = self.pixels.forward(self.norm.forward(input.last.clone()));
        let [m, _, numbers] = pixels.dims();
        let channels = numbers / (patch * patch);
        pixels
            .reshape([m, rows, columns, patch, patch, channels])
            .permute([0, 5, 1, 3, 2, 4])
            .reshape([m, channels, rows * patch, columns * patch])
    }
}
