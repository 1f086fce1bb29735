//! The authors' DPT head: several decoder layers, gated, fused on the patch grid.

use super::{HeadInput, convolve, gated, kernel, to_map};
use crate::ModelConfig;
use crate::layers::{Linear, ones};
use burn::module::{Module, Param};
use burn::tensor::activation::gelu;
use burn::tensor::{Device, Tensor};
use lumi_core::seed::Rng;
use lumi_kernels::Precision;

/// Per layer: linear, refine, gate; then from the deepest layer up: `fused = fuse(fused + next)`, with one
/// shared fusion module; then 1×1 convolution, pixel shuffle, sigmoid.
#[derive(Module, Debug)]
pub struct Dpt {
    /// Per layer, shallowest first.
    pub layers: Vec<DptLayer>,
    /// Shared by all fusions.
    pub fuse: Refine,
    /// `[3·p², f, 1, 1]`, output channel `colour · p² + row · p + column`
    pub pixels: Param<Tensor<4>>,
}

/// One decoder layer's way into the head.
#[derive(Module, Debug)]
pub struct DptLayer {
    /// `[f, d]`
    pub project: Linear,
    /// On the patch grid.
    pub refine: Refine,
    /// `[1]`; a scalar in the authors' files
    pub gate: Param<Tensor<1>>,
}

/// Convolution, GELU, convolution, GELU; kernels `[f, f, 3, 3]`.
#[derive(Module, Debug)]
pub struct Refine {
    /// First.
    pub conv1: Param<Tensor<4>>,
    /// Second.
    pub conv2: Param<Tensor<4>>,
}

impl Refine {
    pub(super) fn new(features: usize, rng: &mut Rng, device: &Device) -> Self {
        Self {
            conv1: kernel(features, features, 3, rng, device),
            conv2: kernel(features, features, 3, rng, device),
        }
    }

    /// # Shapes
    /// `[m, f, h, w]` → same
    #[must_use]
    pub fn forward(&self, x: Tensor<4>, precision: Precision) -> Tensor<4> {
        let hidden = gelu(convolve(x, &self.conv1, precision));
        gelu(convolve(hidden, &self.conv2, precision))
    }
}

/// The head's intermediate maps, for verification.
pub struct DptMaps {
    /// Refined maps before their gates, shallowest first, `[m, f, rows, columns]`.
    pub refined: Vec<Tensor<4>>,
    /// After all fusions, `[m, f, rows, columns]`.
    pub fused: Tensor<4>,
    /// `[m, 3·p², rows, columns]`
    pub patch_pixels: Tensor<4>,
}

impl Dpt {
    pub(super) fn new(
        config: &ModelConfig,
        features: usize,
        layers: usize,
        std: f32,
        rng: &mut Rng,
        device: &Device,
    ) -> Self {
        let layer = |rng: &mut Rng| DptLayer {
            project: Linear::new(features, config.dim, std, rng, device),
            refine: Refine::new(features, rng, device),
            gate: ones(1, device),
        };
        Self {
            layers: (0..layers).map(|_| layer(rng)).collect(),
            fuse: Refine::new(features, rng, device),
            pixels: kernel(3 * config.patch * config.patch, features, 1, rng, device),
        }
    }

    /// All intermediate maps.
    #[must_use]
    pub fn maps(&self, input: &HeadInput) -> DptMaps {
        self.gated_maps(input, &[])
    }

    fn gated_maps(&self, input: &HeadInput, gates: &[f32]) -> DptMaps {
        let precision = input.precision;
        let map = |(layer, tap): (&DptLayer, &Tensor<3>)| {
            let projected = layer.project.forward(tap.clone());
            layer
                .refine
                .forward(to_map(projected, input.rows, input.columns), precision)
        };
        let refined: Vec<_> = self.layers.iter().zip(&input.taps).map(map).collect();
        let opened = |i: usize| {
            let learnt = self.layers[i].gate.val().reshape([1, 1, 1, 1]);
            gated(refined[i].clone() * learnt, gates, i)
        };
        let deepest = refined.len() - 1;
        let fused = (0..deepest).rev().fold(opened(deepest), |fused, i| {
            self.fuse.forward(fused + opened(i), precision)
        });
        let patch_pixels = convolve(fused.clone(), &self.pixels, precision);
        DptMaps {
            refined,
            fused,
            patch_pixels,
        }
    }

    pub(super) fn logits(&self, input: &HeadInput, patch: usize, gates: &[f32]) -> Tensor<4> {
        let HeadInput { rows, columns, .. } = *input;
        let pixels = self.gated_maps(input, gates).patch_pixels;
        let m = pixels.dims()[0];
        pixels
            .reshape([m, 3, patch, patch, rows, columns])
            .permute([0, 1, 4, 2, 5, 3])
            .reshape([m, 3, rows * patch, columns * patch])
    }
}
