//! What a run costs, from its config alone: operations per step, and memory.

use crate::Result;
use crate::config::{Parts, StageConfig, StageKind, TrainConfig};
use crate::plan::Plan;
use lumi_core::Seed;
use lumi_eval::Net;
use lumi_model::config::DecoderAttention;
use lumi_model::{ModelConfig, Network, params};

/// Plans that the mean over a stage's random numbers is taken from.
const PLANS: u64 = 4096;

/// Operations per pixel of VGG16's convolutions up to `conv5_3` (15.35 G multiplications at 224 × 224 pixels), and of
/// AlexNet's (0.66 G).
fn lpips_flops(net: Net) -> f64 {
    let per_picture = match net {
        Net::Vgg => 15.35e9,
        Net::Alex => 0.66e9,
    };
    2.0 * per_picture / (224.0 * 224.0)
}

/// What a stage costs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StageCost {
    /// Steps.
    pub steps: u64,
    /// Floating-point operations per step, over all samples: the forward passes, twice that backward where weights
    /// learn, once where they only pass gradients on, and the forward pass again with `recompute`.
    pub flops: f64,
    /// Bytes per sample that the blocks keep for the backward pass of the largest plan; heads and LPIPS come on top.
    pub kept: f64,
}

impl StageCost {
    /// The cost of the stage with this index.
    ///
    /// # Errors
    /// If it does not suit the model.
    pub fn of(config: &TrainConfig, model: &ModelConfig, index: usize) -> Result<Self> {
        let stage = &config.stages[index];
        stage.fits(index, model)?;
        let again = if config.recompute { 1.0 } else { 0.0 };
        let rng = &mut Seed(0).stream("cost");
        let mut flops = 0.0;
        for _ in 0..PLANS {
            flops += sample_flops(config, model, stage, &Plan::draw(rng, stage, model), again);
        }
        let samples = config.batch as f64 * config.accumulate as f64;
        Ok(Self {
            steps: stage.steps,
            flops: samples * flops / PLANS as f64,
            kept: kept(config, model, stage),
        })
    }
}

fn sample_flops(
    config: &TrainConfig,
    model: &ModelConfig,
    stage: &StageConfig,
    plan: &Plan,
    again: f64,
) -> f64 {
    let (r, parts) = (stage.resolution(model), stage.parts());
    // Forward, backward to what came before where that learns, backward to the weights.
    let passes = |before: bool, learns: bool, again: f64| match (before, learns) {
        (_, true) => 3.0 + again,
        (true, false) => 2.0 + again,
        (false, false) => 1.0,
    };
    let Before {
        editor,
        decoder,
        head,
    } = Before::of(parts);
    let encodings = if plan.other_light { 2.0 } else { 1.0 };
    let scene = model.scene_of(plan.inputs, r);
    let encode = encodings * model.encode_flops(plan.inputs, r);
    let encode = encode * passes(false, parts.encoder, again);
    let pattern = model.lights.pattern();
    let map = pattern.environment_rows * pattern.environment_columns;
    let edits: f64 = plan
        .edits
        .iter()
        .map(|edit| {
            let [environments, points, areas] = edit.counts;
            let lights = environments * map + (points + areas) * pattern.local_rays;
            model.edit_flops(scene, lights) * passes(editor, parts.editor, again)
        })
        .sum();
    let decodings = (usize::from(plan.reconstruct) + plan.edits.len()) as f64;
    let views = plan.targets as f64;
    // Heads keep what they need, so that nothing of them is computed again.
    let decode = model.decode_flops(scene, plan.targets, r) * passes(decoder, parts.decoder, again)
        + views * model.head_flops(r) * passes(head, parts.head, 0.0);
    let pictures = if stage.lpips > 0.0 { 3.0 } else { 0.0 };
    let perceptual = pictures * views * lpips_flops(config.perceptual.net) * (r * r) as f64;
    encode + edits + decodings * (decode + perceptual)
}

/// Whether something learns before each part: only then do gradients pass through it.
struct Before {
    editor: bool,
    decoder: bool,
    head: bool,
}

impl Before {
    fn of(parts: Parts) -> Self {
        let editor = parts.encoder;
        let decoder = editor || parts.editor;
        let head = decoder || parts.decoder;
        Self {
            editor,
            decoder,
            head,
        }
    }
}

/// Bytes per sample that blocks keep: their inputs, and without `recompute` queries, keys, values, attention's result,
/// the first sum, and the hidden layer.
fn kept(config: &TrainConfig, model: &ModelConfig, stage: &StageConfig) -> f64 {
    let hidden = if config.bf16 { 2.0 } else { 4.0 };
    let per_value = if config.recompute {
        4.0
    } else {
        6.0 * 4.0 + 4.0 * hidden
    };
    let r = stage.resolution(model);
    let (k, n) = (model.scene_of(stage.inputs[1], r), model.image_tokens(r, r));
    let encodings = if stage.invariance > 0.0 { 2 } else { 1 };
    let parts = stage.parts();
    let encoder = if parts.encoder {
        encodings * model.encoder_layers * (model.scene_tokens + stage.inputs[1] * n)
    } else {
        0
    };
    let before = Before::of(parts);
    let edits = match stage.kind {
        StageKind::Reconstruction => 0,
        StageKind::Relight | StageKind::Joint => stage.chain[1],
    };
    let reconstructs = usize::from(stage.reconstructs(edits));
    let pattern = model.lights.pattern();
    let lights = pattern.environment_rows * pattern.environment_columns + 2 * pattern.local_rays;
    let decoder = match model.decoder {
        DecoderAttention::Joint => stage.targets * (k + n),
        DecoderAttention::OneWay => k + stage.targets * n,
    };
    // A part keeps something where it or one before it learns.
    let editor = if before.decoder {
        edits * model.editor_layers * (k + lights)
    } else {
        0
    };
    let decoder = if before.head {
        (reconstructs + edits) * model.decoder_layers * decoder
    } else {
        0
    };
    let tokens = encoder + editor + decoder;
    tokens as f64 * model.dim as f64 * per_value
}

/// Bytes of weights, their gradients and AdamW's two moments, all in f32.
#[must_use]
pub fn state_bytes(model: &ModelConfig) -> f64 {
    16.0 * weights(model) as f64
}

/// How many weights a model has.
#[must_use]
pub fn weights(model: &ModelConfig) -> usize {
    let device = burn::tensor::Device::flex();
    // Counted on a model of one block per stack, since all blocks of a width are alike.
    let count = |layers: usize| -> usize {
        let mut small = model.clone();
        (
            small.encoder_layers,
            small.editor_layers,
            small.decoder_layers,
        ) = (layers, 0, 0);
        let tensors = params::lazy(&Network::blank(&small, &device));
        tensors
            .iter()
            .map(|t| t.shape.iter().product::<usize>())
            .sum()
    };
    let (one, two) = (count(1), count(2));
    one + (two - one) * (model.encoder_layers + model.editor_layers + model.decoder_layers - 1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use lumi_model::config::HeadConfig;

    #[test]
    fn the_papers_model_has_its_weights() {
        let mut model = ModelConfig::preset("authors-512-mlp").expect("preset");
        assert_eq!(weights(&model), 258_551_808);
        model.head = HeadConfig::Dpt {
            features: 256,
            layers: vec![3, 6, 9, 12],
        };
        assert_eq!(weights(&model), 265_137_412);
    }
}
