//! The loss of a batch: reconstruction, and every step of a chain of edits in token space.

use crate::Result;
use crate::batch::Batch;
use crate::config::{PerceptualConfig, StageConfig, TrainConfig};
use crate::handover::Handover;
use crate::sample::BEYOND_WHITE;
use burn::tensor::{Device, Tensor};
use lumi_core::color::CURVE;
use lumi_eval::{Lpips, Net};
use lumi_model::batch::stack;
use lumi_model::config::{Mode, Output};
use lumi_model::network::Scene;
use lumi_model::{Error, ModelConfig, Network};

/// A batch's pictures under one light, and what they should be.
pub struct Pair {
    /// `[b, v, 3, r, r]`, as a viewer sees them over the batch's backgrounds (white for models that make display-encoded
    /// pictures).
    pub render: Tensor<5>,
    /// The same of the truth.
    pub truth: Tensor<5>,
    /// Coverage, made and true, `[b, v, 1, r, r]`, of models that make it.
    pub alpha: Option<(Tensor<5>, Tensor<5>)>,
    /// `render` with the colours of each sample scaled, per channel, to come nearest to the truth's; of models that make
    /// radiance.
    pub aligned: Option<Tensor<5>>,
}

/// A batch's pictures under the light of the inputs and after each edit, with what they should be.
pub struct Outcome {
    /// Under the source light, where the batch has it.
    pub source: Option<Pair>,
    /// After each edit.
    pub edits: Vec<Pair>,
    /// Scene tokens of the inputs and of the same views under another light, `[b, K, d]`, where the batch has both.
    pub tokens: Option<(Tensor<3>, Tensor<3>)>,
    /// How far scene tokens after edits are from those that a shorter way leads to, [`apart`]; empty where the batch has no use
    /// for it.
    pub detours: Vec<Tensor<1>>,
    /// How far pictures after lights were added are from the sums of the model's own pictures, mean squared difference; empty where
    /// the batch has no use for it.
    pub sums: Vec<Tensor<1>>,
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
    let images = |values: &[f32], channels: usize| {
        stack(values.to_vec(), [b, targets, channels, r, r], device)
    };
    let [of_inputs, of_targets] = &batch.cameras;
    let encode = |posed: &[f32]| {
        let channels = config.posed_channels();
        let posed = stack(posed.to_vec(), [b, inputs, channels, r, r], device);
        network.encode(posed, of_inputs, config)
    };
    let mut scene = encode(&batch.posed);
    let tokens =
        (!batch.other.is_empty()).then(|| (scene.channels.clone(), encode(&batch.other).channels));
    let channels = config.target_channels();
    let given = stack(batch.targets.clone(), [b, targets, channels, r, r], device);
    let backgrounds = stack(batch.backgrounds.clone(), [b, 1, 3, 1, 1], device);
    let mut albedo = Vec::new();
    let [rays, direct, carried] = config.target_parts();
    let under = |values: &[f32]| {
        if values.is_empty() {
            return given.clone();
        }
        let parts = vec![
            given.clone().narrow(2, 0, rays),
            images(values, direct),
            given.clone().narrow(2, rays + direct, carried),
        ];
        Tensor::cat(parts, 2)
    };
    // What the network makes of the targets; base colour, too, where the picture is one of the batch's own.
    let mut made = |scene: &Scene, light: &[f32], own: bool| -> Tensor<5> {
        let given = under(light);
        let input = network.decoder_tokens(scene, given.clone(), of_targets, config);
        if let (Some(head), false, true) = (&network.albedo, batch.albedo.is_empty(), own) {
            let picture = head.forward(input.clone(), config.patch);
            let picture = picture.reshape([b, targets, 3, r, r]);
            albedo.push((picture, images(&batch.albedo, 3)));
        }
        match handover {
            Some(handover) => {
                let picture = handover.picture(&network.head, &input, config.patch);
                picture.reshape([b, targets, config.output.channels(), r, r])
            }
            None => network.picture(&input, given, config),
        }
    };
    let exposed = |exposures: &[f32]| stack(exposures.to_vec(), [b, 1, 1, 1, 1], device);
    let compared = |picture: Tensor<5>, truth: &[f32], exposures: &[f32]| -> Pair {
        let truth = images(truth, config.output.channels());
        match config.output {
            Output::Display => Pair {
                render: picture,
                truth,
                alpha: None,
                aligned: None,
            },
            Output::Radiance => over(&backgrounds, picture, truth, exposed(exposures)),
        }
    };
    let wanted = !batch.source.is_empty();
    let source = wanted.then(|| {
        let picture = made(&scene, &[], true);
        compared(picture, &batch.source, &batch.exposures)
    });
    let (mut edits, mut detours, mut sums) = (Vec::new(), Vec::new(), Vec::new());
    let captured = scene.clone();
    for edit in &batch.before {
        scene = network.edit(&scene, edit.light(network, device)?, config);
        scene.channels = scene.channels.detach();
    }
    let mut states = vec![scene.clone()];
    let mut last: Option<Tensor<5>> = None;
    for (i, edit) in batch.edits.iter().enumerate() {
        let light = edit.light(network, device)?;
        scene = network.edit(&scene, light.clone(), config);
        if batch.short_ways && i + batch.before.len() > 0 {
            let at_once = edit.light_at_once(network)?;
            let short = match edit.kind.mode {
                Mode::Set => Some(network.edit(&captured, light, config)),
                Mode::Remove if i > 0 && edit.kind.undoes(&batch.edits[i - 1].kind) => {
                    Some(states[i - 1].clone())
                }
                _ => at_once.map(|light| network.edit(&captured, light, config)),
            };
            detours.extend(short.map(|short| apart(&scene, &short)));
        }
        states.push(scene.clone());
        let picture = made(&scene, &edit.direct, true);
        if let (Some(alone), Some(last)) = (&edit.alone, last) {
            let scene = network.edit(&captured, alone.light(network)?, config);
            let other = made(&scene, &alone.direct, false);
            let shares = stack(alone.shares.clone(), [b, 1, 3, 1, 1], device);
            let sum = sum(&last, &other, &shares).detach();
            sums.push(seen_apart(
                &backgrounds,
                picture.clone(),
                sum,
                exposed(&edit.exposures),
            ));
        }
        last = Some(picture.clone());
        edits.push(compared(picture, &edit.truth, &edit.exposures));
    }
    Ok(Outcome {
        source,
        edits,
        tokens,
        detours,
        sums,
        albedo,
    })
}

/// The picture under two lights, of the pictures under each: (1 − share) · a + share · b in radiance, and the mean of their
/// coverages.
///
/// # Shapes
/// pictures `[b, v, 4, r, r]`, shares `[b, 1, 3, 1, 1]`
fn sum(a: &Tensor<5>, b: &Tensor<5>, shares: &Tensor<5>) -> Tensor<5> {
    let [a, b] = [a, b].map(|t| (t.clone().narrow(2, 0, 3), t.clone().narrow(2, 3, 1)));
    let radiance = |t: Tensor<5>| t.clamp_min(0.0).powf_scalar(CURVE);
    let both = radiance(a.0) * (shares.clone().neg() + 1.0) + radiance(b.0) * shares.clone();
    let colour = both.clamp_min(0.0).powf_scalar(1.0 / CURVE);
    Tensor::cat(vec![colour, (a.1 + b.1) * 0.5], 2)
}

/// How far two pictures `[b, v, 4, r, r]` are from one another as they are seen at an exposure over backgrounds.
fn seen_apart(
    backgrounds: &Tensor<5>,
    a: Tensor<5>,
    b: Tensor<5>,
    exposures: Tensor<5>,
) -> Tensor<1> {
    let [a, b] = [a, b].map(|t| {
        let alpha = t.clone().narrow(2, 3, 1);
        let shown = shown(t.narrow(2, 0, 3), exposures.clone());
        shown * alpha.clone() + behind(backgrounds, &alpha)
    });
    (a - b).square().mean()
}

/// What [`crate::sample::shown`] makes of colours at exposures.
fn shown(colour: Tensor<5>, exposures: Tensor<5>) -> Tensor<5> {
    let colour = colour * exposures;
    let beyond = colour.clone().clamp_min(1.0).log() * BEYOND_WHITE;
    colour.clamp_max(1.0) + beyond
}

/// What coverage leaves of backgrounds.
fn behind(backgrounds: &Tensor<5>, alpha: &Tensor<5>) -> Tensor<5> {
    (alpha.clone().neg() + 1.0) * backgrounds.clone()
}

/// How far scene tokens are from those of a shorter way, which have nothing to learn from them: mean squared difference over the
/// mean square.
fn apart(scene: &Scene, short: &Scene) -> Tensor<1> {
    let short = short.channels.clone().detach();
    let whole = short.clone().square().mean();
    (scene.channels.clone() - short).square().mean() / (whole + 1e-6)
}

/// A render `[b, v, 4, r, r]` at an exposure and its truth (see [`crate::sample::Truth`]), both over backgrounds.
fn over(
    backgrounds: &Tensor<5>,
    render: Tensor<5>,
    truth: Tensor<5>,
    exposures: Tensor<5>,
) -> Pair {
    let [alpha, true_alpha] = [&render, &truth].map(|t| t.clone().narrow(2, 3, 1));
    let shown = shown(render.narrow(2, 0, 3), exposures);
    let truth = truth.narrow(2, 0, 3);
    let scale = scale(shown.clone() * true_alpha.clone(), truth.clone());
    Pair {
        render: shown.clone() * alpha.clone() + behind(backgrounds, &alpha),
        aligned: Some(shown * scale * alpha.clone() + behind(backgrounds, &alpha)),
        truth: truth + behind(backgrounds, &true_alpha),
        alpha: Some((alpha, true_alpha)),
    }
}

/// Least and most that [`scale`] scales by.
const SCALED: [f32; 2] = [0.4, 2.5];

/// What to multiply each sample's channels with so that they come nearest to the truth's in the mean square: constants, since
/// the error does not change with them there.
///
/// # Shapes
/// both `[b, v, 3, r, r]` → `[b, 1, 3, 1, 1]`
fn scale(shown: Tensor<5>, truth: Tensor<5>) -> Tensor<5> {
    let [b, v, c, h, w] = shown.dims();
    let sum = |x: Tensor<5>| {
        let rows = x.swap_dims(1, 2).reshape([b * c, v * h * w]);
        rows.sum_dim(1)
    };
    let (shown, truth) = (shown.detach(), truth.detach());
    let scale = sum(shown.clone() * truth) / (sum(shown.square()) + 1e-6);
    let [least, most] = SCALED;
    scale.clamp(least, most).reshape([b, 1, c, 1, 1])
}

/// Weight of alpha's squared error beside that of pictures.
const ALPHA: f64 = 0.4;

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

    /// The loss of a batch: the stage's share of the reconstruction (all of it, where there are no edits), plus the mean over the edits, plus the stage's lighting invariance, its consistency and its additivity, plus its share of the albedo's mean squared error, which light must not change.
    /// A picture's loss is the mean squared error of its display-encoded values (after edits, the stage's `aligned` share of it
    /// after scaling, and then LPIPS too), plus the stage's share of LPIPS.
    ///
    /// # Errors
    /// If the pictures are too small for LPIPS.
    pub fn loss(&self, outcome: &Outcome, stage: &StageConfig) -> Result<Tensor<1>> {
        let mut terms = Vec::new();
        if let Some(source) = &outcome.source {
            let alone = outcome.edits.is_empty();
            let share = if alone { 1.0 } else { stage.reconstruction() };
            terms.push(self.error(source, stage, 0.0)? * share);
        }
        let share = 1.0 / outcome.edits.len().max(1) as f64;
        for edit in &outcome.edits {
            terms.push(self.error(edit, stage, stage.aligned)? * share);
        }
        if let Some((a, b)) = &outcome.tokens {
            terms.push((a.clone() - b.clone()).square().mean() * stage.invariance);
        }
        let share = stage.consistency / outcome.detours.len().max(1) as f64;
        terms.extend(outcome.detours.iter().map(|apart| apart.clone() * share));
        let share = stage.additivity / outcome.sums.len().max(1) as f64;
        terms.extend(outcome.sums.iter().map(|apart| apart.clone() * share));
        let share = stage.albedo / outcome.albedo.len().max(1) as f64;
        for (a, b) in &outcome.albedo {
            terms.push((a.clone() - b.clone()).square().mean() * share);
        }
        let sum = terms.into_iter().reduce(|a, b| a + b);
        sum.ok_or_else(|| Error::Unsupported("a batch asks for no picture".into()))
    }

    /// The error of a pair, of which the share `aligned` is that of the scaled render.
    fn error(&self, pair: &Pair, stage: &StageConfig, aligned: f64) -> Result<Tensor<1>> {
        let (a, b) = (&pair.render, &pair.truth);
        let mut square = (a.clone() - b.clone()).square().mean();
        if let (Some(scaled), true) = (&pair.aligned, aligned > 0.0) {
            let scaled = (scaled.clone() - b.clone()).square().mean();
            square = square * (1.0 - aligned) + scaled * aligned;
        }
        if let Some((a, b)) = &pair.alpha {
            square = square + (a.clone() - b.clone()).square().mean() * ALPHA;
        }
        let Some(lpips) = self.lpips.as_ref().filter(|_| stage.lpips > 0.0) else {
            return Ok(square);
        };
        let [batch, views, c, h, w] = a.dims();
        let a = pair.aligned.as_ref().filter(|_| aligned > 0.0).unwrap_or(a);
        let [a, b] = [a, b].map(|t| t.clone().reshape([batch * views, c, h, w]));
        Ok(square + lpips.distance(a, b)?.mean() * stage.lpips)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use burn::tensor::TensorData;

    #[test]
    fn light_adds_up_in_radiance_and_each_channel_by_its_share() {
        let device = Device::flex();
        // [1, 1, 4, 1, 2]
        let picture = |radiance: [f32; 3], alpha: f32| -> Tensor<5> {
            let channels = radiance.map(|v| v.powf(1.0 / CURVE)).into_iter();
            let values: Vec<f32> = channels.chain([alpha]).flat_map(|v| [v, v]).collect();
            Tensor::from_data(TensorData::new(values, [1, 1, 4, 1, 2]), &device)
        };
        let shares = TensorData::new(vec![0.25_f32, 0.0, 1.0], [1, 1, 3, 1, 1]);
        let shares = Tensor::<5>::from_data(shares, &device);
        let (a, b) = (picture([0.2, 0.4, 0.6], 1.0), picture([0.6, 0.9, 0.1], 0.5));
        let both = sum(&a, &b, &shares);
        let found: Vec<f32> = lumi_model::params::to_vec(both.clone());
        for (c, expected) in [0.3, 0.4, 0.1].into_iter().enumerate() {
            let found = found[2 * c].powf(CURVE);
            assert!((found - expected).abs() < 1e-5, "{found} for {expected}");
        }
        assert!((found[6] - 0.75).abs() < 1e-6);
        // Over black, half as much colour is a quarter as much error.
        let black = Tensor::<5>::zeros([1, 1, 3, 1, 1], &device);
        let one = Tensor::<5>::ones([1, 1, 1, 1, 1], &device);
        let dark = picture([0.0; 3], 1.0);
        let apart = |gain: f32| {
            let bright = picture([0.2 * gain.powf(CURVE); 3], 1.0);
            let apart = seen_apart(&black, bright, dark.clone(), one.clone());
            apart.into_scalar::<f32>()
        };
        assert!((apart(1.0) - 0.2_f32.powf(2.0 / CURVE)).abs() < 1e-5);
        assert!((apart(0.5) - 0.25 * apart(1.0)).abs() < 1e-5);
    }

    #[test]
    fn scales_undo_how_bright_and_how_tinted_a_sample_is() {
        let device = Device::flex();
        let values = |gain: [f32; 6]| -> Tensor<5> {
            // [2, 2, 3, 1, 2]
            let value = |i: usize| {
                let (sample, channel) = (i / 12, i / 2 % 3);
                gain[3 * sample + channel] * (0.1 + 0.07 * (i % 7) as f32)
            };
            let data = TensorData::new((0..24).map(value).collect::<Vec<_>>(), [2, 2, 3, 1, 2]);
            Tensor::from_data(data, &device)
        };
        let truth = values([1.0; 6]);
        let gains = [0.5, 1.25, 1.0, 2.0, 0.8, 5.0];
        let found = scale(values(gains), truth);
        let found: Vec<f32> = lumi_model::params::to_vec(found);
        for (gain, found) in gains.into_iter().zip(found) {
            // A fifth is beyond what is undone.
            let expected = (1.0 / gain).max(SCALED[0]);
            assert!((found - expected).abs() < 1e-4, "{found} for {expected}");
        }
    }
}
