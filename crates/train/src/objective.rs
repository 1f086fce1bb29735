//! The loss of a batch: reconstruction, and every step of a chain of edits in token space.

use crate::Result;
use crate::config::{PerceptualConfig, StageConfig, StageKind, TrainConfig};
use crate::handover::Handover;
use crate::loader::Batch;
use burn::tensor::{Device, Tensor, TensorData};
use lumi_eval::{Lpips, Net};
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
    /// Base colour, predicted and true, before the first edit and after each; empty if the batch has none.
    pub albedo: Vec<(Tensor<5>, Tensor<5>)>,
}

/// Runs a batch through the network; while a head is handed over, both make the pictures.
///
/// # Errors
/// If the network cannot take light rays.
pub fn forward(
    network: &Network,
    config: &ModelConfig,
    batch: &Batch,
    handover: Option<&Handover<'_>>,
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
    // Where tokens are is not up to the network.
    let channels = |scene: Tensor<3>| scene.narrow(2, 0, config.dim);
    let tokens = (!batch.other.is_empty())
        .then(|| (channels(scene.clone()), channels(encode(&batch.other))));
    let rays = stack(batch.rays.clone(), [b, targets, rays, r, r], device);
    let mut albedo = Vec::new();
    let mut decode = |scene: Tensor<3>| {
        let input = network.decoder_tokens(scene, rays.clone(), config);
        if let (Some(head), false) = (&network.albedo, batch.albedo.is_empty()) {
            let picture = head.forward(input.clone(), config.patch);
            let picture = picture.reshape([b, targets, 3, r, r]);
            albedo.push((picture, images(&batch.albedo)));
        }
        let picture = match handover {
            Some(handover) => handover.picture(&network.head, &input, config.patch),
            None => network.head.forward(input, config.patch),
        };
        picture.reshape([b, targets, 3, r, r])
    };
    let source = (decode(scene.clone()), images(&batch.source));
    let mut edits = Vec::new();
    for (kind, features, truth) in &batch.edits {
        let count = features.len() / (b * lumi_model::lights::RAY_FEATURES);
        let shape = [b, count, lumi_model::lights::RAY_FEATURES];
        let features = Tensor::from_data(TensorData::new(features.clone(), shape), device);
        scene = network.edit(scene, network.light_tokens(features, kind.mode)?);
        edits.push((decode(scene.clone()), images(truth)));
    }
    Ok(Outcome {
        source,
        edits,
        tokens,
        albedo,
    })
}

/// What a run minimises.
pub struct Objective {
    /// Loaded where a stage asks for it.
    lpips: Option<Lpips>,
}

impl Objective {
    /// The objective of a run's stages.
    ///
    /// # Errors
    /// If a stage asks for LPIPS and its weights cannot be found.
    pub fn new(config: &TrainConfig, device: &Device) -> Result<Self> {
        let PerceptualConfig { net, weights } = &config.perceptual;
        let asked = config.stages.iter().any(|stage| stage.lpips > 0.0);
        let lpips = asked.then(|| match net {
            Net::Alex => Lpips::alex(device),
            Net::Vgg => Lpips::vgg(weights.as_deref(), device),
        });
        Ok(Self {
            lpips: lpips.transpose()?,
        })
    }

    /// The loss of a batch: of the reconstruction (half of it in `relight` stages), plus the mean over the edits, plus
    /// the stage's lighting invariance, plus its share of the albedo's mean squared error, which light must not change.
    /// A picture's loss is the mean squared error of its display-encoded values, plus the stage's share of LPIPS.
    ///
    /// # Errors
    /// If the pictures are too small for LPIPS.
    pub fn loss(&self, outcome: &Outcome, stage: &StageConfig) -> Result<Tensor<1>> {
        let mut loss = self.error(&outcome.source, stage)?;
        if stage.kind == StageKind::Relight && !outcome.edits.is_empty() {
            loss = loss * 0.5;
        }
        let share = 1.0 / outcome.edits.len().max(1) as f64;
        for edit in &outcome.edits {
            loss = loss + self.error(edit, stage)? * share;
        }
        if let Some((a, b)) = &outcome.tokens {
            loss = loss + (a.clone() - b.clone()).square().mean() * stage.invariance;
        }
        let share = stage.albedo / outcome.albedo.len().max(1) as f64;
        for (a, b) in &outcome.albedo {
            loss = loss + (a.clone() - b.clone()).square().mean() * share;
        }
        Ok(loss)
    }

    fn error(&self, (a, b): &(Tensor<5>, Tensor<5>), stage: &StageConfig) -> Result<Tensor<1>> {
        let square = (a.clone() - b.clone()).square().mean();
        let Some(lpips) = self.lpips.as_ref().filter(|_| stage.lpips > 0.0) else {
            return Ok(square);
        };
        let [batch, views, c, h, w] = a.dims();
        let [a, b] = [a, b].map(|t| t.clone().reshape([batch * views, c, h, w]));
        Ok(square + lpips.distance(a, b)?.mean() * stage.lpips)
    }
}
