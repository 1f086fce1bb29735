//! Heads: from decoder tokens to pixels.

mod dpt;
mod mlp;
pub(crate) mod pixel;
mod pyramid;

pub use dpt::Dpt;
pub use mlp::Mlp;
pub use pixel::{CONTEXT, FEATURES, PixelMlp};
pub use pyramid::Pyramid;
pub(crate) use pyramid::resize;

use crate::ModelConfig;
use crate::bridge;
use crate::config::HeadConfig;
use burn::module::{Module, Param};
use burn::tensor::activation::sigmoid;
use burn::tensor::ops::ConvOptions;
use burn::tensor::{Device, Tensor, module::conv2d};
use lumi_core::seed::Rng;
use lumi_kernels::Precision;

/// Any of the heads.
#[derive(Module, Debug)]
pub enum Head {
    /// See [`Mlp`].
    Mlp(Mlp),
    /// See [`Dpt`].
    Dpt(Dpt),
    /// See [`Pyramid`].
    Pyramid(Pyramid),
}

/// What a head works on: the image tokens of `m` views on a `rows × columns` patch grid.
#[derive(Clone)]
pub struct HeadInput {
    /// After the last decoder block, `[m, rows·columns, d]`.
    pub last: Tensor<3>,
    /// After each block of the head's layer list, in that order, same shape.
    pub taps: Vec<Tensor<3>>,
    /// Precision of matrix operands where our kernels run.
    pub precision: Precision,
    /// Patch rows.
    pub rows: usize,
    /// Patch columns.
    pub columns: usize,
}

impl Head {
    /// Random weights for a config; `channels` numbers per pixel, of which DPT heads always make three.
    pub fn new(
        config: &ModelConfig,
        channels: usize,
        std: f32,
        rng: &mut Rng,
        device: &Device,
    ) -> Self {
        match &config.head {
            HeadConfig::Mlp => Self::Mlp(Mlp::new(config, channels, std, rng, device)),
            HeadConfig::Dpt { features, layers } => {
                Self::Dpt(Dpt::new(config, *features, layers.len(), std, rng, device))
            }
            HeadConfig::DptPyramid { features, layers } => Self::Pyramid(Pyramid::new(
                config,
                *features,
                layers.len(),
                std,
                rng,
                device,
            )),
        }
    }

    /// # Shapes
    /// tokens of `m` views → `[m, 3, rows·patch, columns·patch]`, display-encoded RGB in (0, 1)
    #[must_use]
    pub fn forward(&self, input: HeadInput, patch: usize) -> Tensor<4> {
        sigmoid(self.logits(&input, patch, &[]))
    }

    /// What [`Self::forward`] squashes. `gates` scale what each layer of the head's list brings, shallowest first; none
    /// leave it as it is. With all gates at 0 the logits are 0, since no head has biases.
    ///
    /// # Shapes
    /// tokens of `m` views → `[m, channels, rows·patch, columns·patch]`
    #[must_use]
    pub fn logits(&self, input: &HeadInput, patch: usize, gates: &[f32]) -> Tensor<4> {
        match self {
            Self::Mlp(head) => head.logits(input, patch),
            Self::Dpt(head) => head.logits(input, patch, gates),
            Self::Pyramid(head) => head.logits(input, patch, gates),
        }
    }
}

impl HeadConfig {
    /// Decoder blocks (1-based) whose outputs the head takes besides the last.
    #[must_use]
    pub fn layers(&self) -> &[usize] {
        match self {
            Self::Mlp => &[],
            Self::Dpt { layers, .. } | Self::DptPyramid { layers, .. } => layers,
        }
    }
}

/// `x`, scaled by the gate of layer `i` if there are gates.
fn gated<const D: usize>(x: Tensor<D>, gates: &[f32], i: usize) -> Tensor<D> {
    match gates.get(i) {
        Some(&gate) => x * gate,
        None => x,
    }
}

/// A bias-free convolution that keeps the size: `[m, in, h, w]` → `[m, out, h, w]`, kernel `[out, in, k, k]`, k odd.
fn convolve(x: Tensor<4>, kernel: &Param<Tensor<4>>, precision: Precision) -> Tensor<4> {
    let weight = kernel.val();
    if bridge::has_kernels(&x.device()) {
        return bridge::conv::convolve(x, weight, precision);
    }
    let pad = weight.dims()[2] / 2;
    conv2d(
        x,
        weight,
        None,
        ConvOptions::new([1, 1], [pad, pad], [1, 1], 1),
    )
}

/// Tokens as a map: `[m, rows·columns, c]` → `[m, c, rows, columns]`.
fn to_map(tokens: Tensor<3>, rows: usize, columns: usize) -> Tensor<4> {
    let [m, _, channels] = tokens.dims();
    tokens.swap_dims(1, 2).reshape([m, channels, rows, columns])
}

/// Kernel with PyTorch's default initialisation, U(±1/√fan_in).
fn kernel(out: usize, input: usize, k: usize, rng: &mut Rng, device: &Device) -> Param<Tensor<4>> {
    let bound = 1.0 / ((input * k * k) as f32).sqrt();
    crate::layers::uniform([out, input, k, k], bound, rng, device)
}
