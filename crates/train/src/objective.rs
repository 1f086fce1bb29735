//! The loss of a batch: reconstruction, and every step of a chain of edits in token space.

use crate::Result;
use crate::config::{StageConfig, StageKind};
use crate::loader::Batch;
use burn::tensor::{Device, Tensor, TensorData};
use lumi_model::batch::stack;
use lumi_model::{ModelConfig, Network};

/// A batch's images under the light of the inputs and after each edit, with what they should be.
pub struct Outcome {
    /// Render and truth under the source light, `[b, v, 3, r, r]`.
    pub source: (Tensor<5>, Tensor<5>),
    /// The same after each edit.
    pub edits: Vec<(Tensor<5>, Tensor<5>)>,
    /// Scene tokens of the inputs and of the same views under another light, `[b, K, d]`, where the batch has both.
    pub tokens: Option<(Tensor<3>, Tensor<3>)>,
}

/// Runs a batch through the network.
///
/// # Errors
/// If the network cannot take light rays.
pub fn forward(
    network: &Network,
    config: &ModelConfig,
    batch: &Batch,
    device: &Device,
) -> Result<Outcome> {
    let Batch {
        size: b,
        views: [inputs, targets],
        resolution: r,
        ..
    } = *batch;
    let images = |values: &[f32]| stack(values.to_vec(), [b, targets, 3, r, r], device);
    let rays = config.rays.channels();
    let encode = |posed: &[f32]| {
        let posed = stack(posed.to_vec(), [b, inputs, 3 + rays, r, r], device);
        network.encode(posed, config)
    };
    let mut scene = encode(&batch.posed);
    let tokens = (!batch.other.is_empty()).then(|| (scene.clone(), encode(&batch.other)));
    let rays = stack(batch.rays.clone(), [b, targets, rays, r, r], device);
    let source = (
        network.decode(scene.clone(), rays.clone(), config),
        images(&batch.source),
    );
    let mut edits = Vec::new();
    for (kind, features, truth) in &batch.edits {
        let count = features.len() / (b * lumi_model::lights::RAY_FEATURES);
        let shape = [b, count, lumi_model::lights::RAY_FEATURES];
        let features = Tensor::from_data(TensorData::new(features.clone(), shape), device);
        scene = network.edit(scene, network.light_tokens(features, kind.mode)?);
        edits.push((
            network.decode(scene.clone(), rays.clone(), config),
            images(truth),
        ));
    }
    Ok(Outcome {
        source,
        edits,
        tokens,
    })
}

impl Outcome {
    /// Mean squared error of the display-encoded images: of the reconstruction (half of it in `relight` stages), plus the
    /// mean over the edits, plus the stage's lighting invariance.
    #[must_use]
    pub fn loss(&self, stage: &StageConfig) -> Tensor<1> {
        let error = |(a, b): &(Tensor<5>, Tensor<5>)| (a.clone() - b.clone()).square().mean();
        let mut loss = error(&self.source);
        let n = self.edits.len() as f64;
        if let Some(edits) = self.edits.iter().map(error).reduce(|a, b| a + b) {
            let relight = stage.kind == StageKind::Relight;
            loss = loss * if relight { 0.5 } else { 1.0 } + edits / n;
        }
        if let Some((a, b)) = &self.tokens {
            loss = loss + (a.clone() - b.clone()).square().mean() * stage.invariance;
        }
        loss
    }
}
