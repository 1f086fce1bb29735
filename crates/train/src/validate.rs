//! How good the averaged weights are on held-out objects.

use crate::Result;
use crate::batch::Batch;
use crate::config::{StageConfig, StageKind, TrainConfig};
use crate::handover::Handover;
use crate::loader::{Objects, Share};
use crate::objective::{Outcome, forward};
use crate::plan::Plan;
use burn::tensor::{Device, Tensor};
use lumi_core::{DisplayImage, Seed};
use lumi_model::{ModelConfig, Network};
use serde::Serialize;

/// PSNR in dB of display-encoded whole images, means over the same samples each time.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct Scores {
    /// Reconstruction under the light of the inputs.
    pub reconstruction: f64,
    /// After the first edit.
    pub edited: f64,
    /// The same after one scale per sample and channel; 0 of models that make no radiance.
    pub aligned: f64,
    /// After the last edit of the chain.
    pub last: f64,
    /// The reconstruction taken as the answer to the first edit: what not editing scores.
    pub unedited: f64,
}

impl std::fmt::Display for Scores {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "PSNR {:.2} dB", self.reconstruction)?;
        if self.edited > 0.0 {
            write!(f, ", edited {:.2} dB", self.edited)?;
        }
        Ok(())
    }
}

/// Batches of validation samples.
const BATCHES: u64 = 4;

/// Scores a network (on a device without autodiff; so is the head that `handover` begins with), and shows what it makes of some samples.
///
/// # Errors
/// If the network cannot take light rays.
pub fn validate(
    network: &Network,
    objects: &Objects,
    config: &TrainConfig,
    model: &ModelConfig,
    stage: &StageConfig,
    handover: Option<&Handover<'_>>,
    device: &Device,
) -> Result<(Scores, DisplayImage)> {
    let has_editor = model.editor_layers > 0 && stage.kind != StageKind::Reconstruction;
    let mut scores = Scores::default();
    let mut sheet = None;
    for i in 0..BATCHES {
        let seed = Seed(0).child("validation").index(i);
        let rng = &mut seed.stream("batch");
        let plan = Plan::of_validation(rng, stage, model);
        let all = (i, Share::ALL);
        let mut batch = Batch::of(&plan, objects, config, model, (seed, rng), all)?;
        batch.backgrounds.fill(1.0);
        let outcome = forward(network, model, &batch, handover, device)?;
        sheet.get_or_insert_with(|| picture(&outcome));
        let Some(source) = &outcome.source else {
            continue;
        };
        scores.reconstruction += psnr(&source.render, &source.truth);
        if let (true, [first, ..], [.., last]) =
            (has_editor, &outcome.edits[..], &outcome.edits[..])
        {
            scores.edited += psnr(&first.render, &first.truth);
            if let Some(aligned) = &first.aligned {
                scores.aligned += psnr(aligned, &first.truth);
            }
            scores.last += psnr(&last.render, &last.truth);
            scores.unedited += psnr(&source.render, &first.truth);
        }
    }
    let n = BATCHES as f64;
    let scores = Scores {
        reconstruction: scores.reconstruction / n,
        edited: scores.edited / n,
        aligned: scores.aligned / n,
        last: scores.last / n,
        unedited: scores.unedited / n,
    };
    Ok((
        scores,
        sheet.unwrap_or_else(|| DisplayImage::filled(1, 1, [1.0; 3])),
    ))
}

/// The first target of up to eight samples, one per row: truth and render under the source light, then after each edit.
fn picture(outcome: &Outcome) -> DisplayImage {
    let pairs = outcome.source.iter().chain(&outcome.edits);
    let first = |images: &Tensor<5>| {
        let rows = images.dims()[0].min(8);
        lumi_model::batch::to_images(images.clone().narrow(0, 0, rows).narrow(1, 0, 1))
    };
    let columns: Vec<Vec<DisplayImage>> = pairs
        .flat_map(|pair| [first(&pair.truth), first(&pair.render)])
        .collect();
    let (rows, side) = (columns[0].len(), columns[0][0].width);
    let mut sheet = DisplayImage::filled(columns.len() * side, rows * side, [1.0; 3]);
    for (column, images) in columns.iter().enumerate() {
        for (row, image) in images.iter().enumerate() {
            for (y, line) in image.pixels.chunks(side).enumerate() {
                let start = (row * side + y) * sheet.width + column * side;
                sheet.pixels[start..start + side].copy_from_slice(line);
            }
        }
    }
    sheet
}

/// Mean over images of each one's PSNR, of what a screen shows; `[b, v, 3, h, w]` both.
fn psnr(a: &Tensor<5>, b: &Tensor<5>) -> f64 {
    let [batch, views, c, h, w] = a.dims();
    let errors = (a.clone().clamp(0.0, 1.0) - b.clone().clamp(0.0, 1.0))
        .square()
        .reshape([batch * views, c * h * w])
        .mean_dim(1);
    let errors = lumi_model::params::to_vec(errors);
    let n = errors.len() as f64;
    errors
        .into_iter()
        .map(|e| -10.0 * f64::from(e.max(1e-10)).log10())
        .sum::<f64>()
        / n
}
