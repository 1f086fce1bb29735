//! The paper's DPT head: tokens reassembled into multi-scale maps, fused progressively to full resolution.

use super::dpt::Refine;
use super::{HeadInput, convolve, gated, kernel, to_map};
use crate::ModelConfig;
use crate::layers::Linear;
use burn::module::{Module, Param};
use burn::tensor::activation::gelu;
use burn::tensor::module::interpolate;
use burn::tensor::ops::{InterpolateMode, InterpolateOptions};
use burn::tensor::{Device, Tensor};
use lumi_core::seed::Rng;

/// The shallowest layer becomes the finest map. With L layers, map i (0 = shallowest) has 2^(L−1−i) times
/// the patch grid's resolution: each token is projected to its cells of that map, so nothing is lost by
/// up-sampling. From the deepest up: add the next finer map and refine. What is then missing to full
/// resolution is done by up-sampling with a convolution at each step.
#[derive(Module, Debug)]
pub struct Pyramid {
    /// Per layer, shallowest first: `[f·s², d]` with s the layer's scale.
    pub reassemble: Vec<Linear>,
    /// Refinement after each fusion, deepest first.
    pub fuse: Vec<Refine>,
    /// Convolutions between the finest map and full resolution, `[f, f, 3, 3]` each.
    pub upsample: Vec<Param<Tensor<4>>>,
    /// `[3, f, 3, 3]`
    pub pixels: Param<Tensor<4>>,
}

impl Pyramid {
    pub(super) fn new(
        config: &ModelConfig,
        features: usize,
        layers: usize,
        std: f32,
        rng: &mut Rng,
        device: &Device,
    ) -> Self {
        let reassemble = (0..layers)
            .map(|i| {
                let scale = 1 << (layers - 1 - i);
                Linear::new(features * scale * scale, config.dim, std, rng, device)
            })
            .collect();
        Self {
            reassemble,
            fuse: (0..layers)
                .map(|_| Refine::new(features, rng, device))
                .collect(),
            upsample: steps_to_full(config.patch, 1 << (layers - 1))
                .iter()
                .map(|_| kernel(features, features, 3, rng, device))
                .collect(),
            pixels: kernel(3, features, 3, rng, device),
        }
    }

    pub(super) fn logits(&self, input: &HeadInput, patch: usize, gates: &[f32]) -> Tensor<4> {
        let HeadInput {
            rows,
            columns,
            precision,
            ..
        } = *input;
        let deepest = self.reassemble.len() - 1;
        let map = |i: usize| {
            let scale = 1 << (deepest - i);
            let cells = self.reassemble[i].forward(input.taps[i].clone());
            let [m, _, channels] = cells.dims();
            let features = channels / (scale * scale);
            let map = to_map(cells, rows, columns)
                .reshape([m, features, scale, scale, rows, columns])
                .permute([0, 1, 4, 2, 5, 3])
                .reshape([m, features, rows * scale, columns * scale]);
            gated(map, gates, i)
        };
        let mut fused = map(deepest);
        fused = fused.clone() + self.fuse[0].forward(fused, precision);
        for (i, fuse) in (0..deepest).rev().zip(&self.fuse[1..]) {
            let finer = map(i);
            let [_, _, h, w] = finer.dims();
            let sum = resize(fused, h, w) + finer;
            fused = sum.clone() + fuse.forward(sum, precision);
        }
        for (factor, conv) in steps_to_full(patch, 1 << deepest)
            .into_iter()
            .zip(&self.upsample)
        {
            let [_, _, h, w] = fused.dims();
            fused = gelu(convolve(
                resize(fused, h * factor, w * factor),
                conv,
                precision,
            ));
        }
        let full = resize(fused, rows * patch, columns * patch);
        convolve(full, &self.pixels, precision)
    }
}

/// Factors of two between a map of `scale` times the patch grid and full resolution.
fn steps_to_full(patch: usize, scale: usize) -> Vec<usize> {
    std::iter::successors(Some(scale), |s| Some(s * 2))
        .take_while(|s| s * 2 <= patch)
        .map(|_| 2)
        .collect()
}

/// Bilinear with half-pixel centres; `[m, f, h, w]` → `[m, f, height, width]`.
pub(crate) fn resize(x: Tensor<4>, height: usize, width: usize) -> Tensor<4> {
    let [_, _, h, w] = x.dims();
    if (h, w) == (height, width) {
        return x;
    }
    let options = InterpolateOptions::new(InterpolateMode::Bilinear).with_align_corners(false);
    interpolate(x, options.with_output_size([height, width]))
}
