//! The loss of a batch: reconstruction, and every step of a chain of edits in token space.

use crate::Result;
use crate::config::StageKind;
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
    let posed = stack(batch.posed.clone(), [b, inputs, 3 + rays, r, r], device);
    let rays = stack(batch.rays.clone(), [b, targets, rays, r, r], device);
    let mut scene = network.encode(posed, config);
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
    Ok(Outcome { source, edits })
}

impl Outcome {
    /// Mean squared error of the display-encoded images: of the reconstruction, plus the mean over the edits.
    /// Without edits only the first, in `relight` stages with the reconstruction at half weight.
    #[must_use]
    pub fn loss(&self, kind: StageKind) -> Tensor<1> {
        let error = |(a, b): &(Tensor<5>, Tensor<5>)| (a.clone() - b.clone()).square().mean();
        let source = error(&self.source);
        let n = self.edits.len() as f64;
        let Some(edits) = self.edits.iter().map(error).reduce(|a, b| a + b) else {
            return source;
        };
        let weight = if kind == StageKind::Relight { 0.5 } else { 1.0 };
        source * weight + edits / n
    }
}
