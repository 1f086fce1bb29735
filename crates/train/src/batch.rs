//! Samples of one step, side by side, as the network takes them.

use crate::Result;
use crate::config::TrainConfig;
use crate::loader::{Objects, Share};
use crate::plan::{EditKind, Plan};
use crate::sample::{Alone, EditLights, Sample};
use burn::tensor::{Device, Tensor, TensorData};
use lumi_core::seed::Rng;
use lumi_core::{Camera, Error, Seed};
use lumi_model::config::Mode;
use lumi_model::lights::{EditLight, LightShape, RAY_FEATURES};
use lumi_model::{ModelConfig, Network};
use safetensors::tensor::{Dtype, TensorView};
use std::path::Path;

/// Samples of one step, concatenated.
pub struct Batch {
    /// Its number in the stage, from 0.
    pub step: u64,
    /// Samples.
    pub size: usize,
    /// Input and target views per sample.
    pub views: [usize; 2],
    /// Side of the images.
    pub resolution: usize,
    /// `[b, inputs, c, r, r]`
    pub posed: Vec<f32>,
    /// The inputs under another light, as `posed`; empty if the stage has no use for them.
    pub other: Vec<f32>,
    /// `[b, targets, c, r, r]`, c = [`ModelConfig::target_channels`]
    pub targets: Vec<f32>,
    /// Cameras of the inputs and of the targets, `[b, inputs]` and `[b, targets]`, in model space.
    pub cameras: [Vec<Camera>; 2],
    /// `[b, targets, 3 or 4, r, r]`, see [`crate::sample::Truth`]; empty if the stage has no use for it.
    pub source: Vec<f32>,
    /// `[b]`
    pub exposures: Vec<f32>,
    /// `[b, 3]`
    pub backgrounds: Vec<f32>,
    /// Base colour, `[b, targets, 3, r, r]`; empty if the stage has no use for it.
    pub albedo: Vec<f32>,
    /// Edits that go before those, in order, of which there is only the light.
    pub before: Vec<BatchEdit>,
    /// Edits, in order.
    pub edits: Vec<BatchEdit>,
    /// Whether what they lead to is wanted the short way, too, where there is one.
    pub short_ways: bool,
}

/// An edit of all samples of a batch.
pub struct BatchEdit {
    /// What all samples share of it.
    pub kind: EditKind,
    /// What the network is told, a sample each.
    pub lights: Vec<EditLights>,
    /// [`crate::sample::EditSample::at_once`], of every sample or of none.
    pub at_once: Vec<EditLights>,
    /// [`crate::sample::EditSample::alone`], of every sample or of none.
    pub alone: Option<BatchAlone>,
    /// `[b, targets, 3 or 4, r, r]`
    pub truth: Vec<f32>,
    /// `[b]`
    pub exposures: Vec<f32>,
    /// How the light after it falls on the targets, `[b, targets, DIRECT, r, r]`; empty for models that are not told.
    pub direct: Vec<f32>,
}

/// [`crate::sample::Alone`] of all samples of a batch.
#[derive(Default)]
pub struct BatchAlone {
    lights: Vec<EditLights>,
    /// As [`BatchEdit::direct`].
    pub direct: Vec<f32>,
    /// `[b, 3]`
    pub shares: Vec<f32>,
}

impl BatchAlone {
    fn push(&mut self, alone: Alone) {
        self.lights.push(alone.light);
        self.direct.extend(alone.direct);
        self.shares.extend(alone.share);
    }

    /// The light as the network takes it, to be set.
    ///
    /// # Errors
    /// If the network is told lights in the other way.
    pub fn light(&self, network: &Network) -> Result<EditLight> {
        network.shaped_light(&shapes(&self.lights), Mode::Set)
    }
}

impl BatchEdit {
    /// Of no samples yet.
    fn none(kind: &EditKind) -> Self {
        Self {
            kind: kind.clone(),
            lights: Vec::new(),
            at_once: Vec::new(),
            alone: None,
            truth: Vec::new(),
            exposures: Vec::new(),
            direct: Vec::new(),
        }
    }

    /// The numbers that the network is told of the rays, sample after sample.
    #[must_use]
    pub fn features(&self) -> Vec<f32> {
        features(&self.lights)
    }

    /// The light as the network takes it.
    ///
    /// # Errors
    /// If the network is told lights in the other way.
    pub fn light(&self, network: &Network, device: &Device) -> Result<EditLight> {
        let shapes = shapes(&self.lights);
        if !shapes.is_empty() {
            return network.shaped_light(&shapes, self.kind.mode);
        }
        let features = self.features();
        let b = self.lights.len();
        let shape = [b, features.len() / (b * RAY_FEATURES).max(1), RAY_FEATURES];
        let features = Tensor::from_data(TensorData::new(features, shape), device);
        network.light_tokens(features, self.kind.mode)
    }

    /// The light of [`Self::at_once`], to be set; `None` where there is none.
    ///
    /// # Errors
    /// If the network is told lights in the other way.
    pub fn light_at_once(&self, network: &Network) -> Result<Option<EditLight>> {
        let shapes = shapes(&self.at_once);
        let light = (!shapes.is_empty()).then(|| network.shaped_light(&shapes, Mode::Set));
        light.transpose()
    }
}

/// See [`BatchEdit::features`].
fn features(lights: &[EditLights]) -> Vec<f32> {
    let of = |light: &EditLights| match light {
        EditLights::Rays(features) => features.clone(),
        EditLights::Shape(shape) => shape.rays.clone(),
    };
    lights.iter().flat_map(of).collect()
}

fn shapes(lights: &[EditLights]) -> Vec<LightShape> {
    let shape = |light: &EditLights| match light {
        EditLights::Shape(shape) => Some(shape.clone()),
        EditLights::Rays(_) => None,
    };
    lights.iter().filter_map(shape).collect()
}

impl Batch {
    /// A worker's share of the batch of a plan: samples of objects that `rng` draws.
    ///
    /// # Errors
    /// If a picture of an object cannot be read.
    pub fn of(
        plan: &Plan,
        objects: &Objects,
        config: &TrainConfig,
        model: &ModelConfig,
        (seed, rng): (Seed, &mut Rng),
        (step, share): (u64, Share),
    ) -> Result<Self> {
        let mut batch = Batch {
            step,
            size: config.batch / share.workers,
            views: [plan.inputs, plan.targets],
            resolution: plan.resolution,
            posed: Vec::new(),
            other: Vec::new(),
            targets: Vec::new(),
            cameras: [Vec::new(), Vec::new()],
            source: Vec::new(),
            exposures: Vec::new(),
            backgrounds: Vec::new(),
            albedo: Vec::new(),
            before: plan.before.iter().map(BatchEdit::none).collect(),
            edits: plan.edits.iter().map(BatchEdit::none).collect(),
            short_ways: plan.short_ways,
        };
        let mine = batch.size * share.rank..batch.size * (share.rank + 1);
        for i in 0..config.batch {
            let object = objects.draw(rng);
            if !mine.contains(&i) {
                continue;
            }
            let sample = Sample::draw(object, plan, model, seed.index(i as u64))?;
            batch.posed.extend(sample.posed);
            batch.other.extend(sample.other);
            batch.targets.extend(sample.targets);
            for (all, cameras) in batch.cameras.iter_mut().zip(sample.cameras) {
                all.extend(cameras);
            }
            batch.source.extend(sample.source);
            batch.exposures.push(sample.exposure);
            batch.backgrounds.extend(sample.background);
            batch.albedo.extend(sample.albedo);
            for (all, light) in batch.before.iter_mut().zip(sample.before) {
                all.lights.push(light);
            }
            for (all, edit) in batch.edits.iter_mut().zip(sample.edits) {
                all.lights.push(edit.light);
                all.at_once.extend(edit.at_once);
                if let Some(alone) = edit.alone {
                    all.alone.get_or_insert_default().push(alone);
                }
                all.truth.extend(edit.truth);
                all.exposures.push(edit.exposure);
                all.direct.extend(edit.direct);
            }
        }
        Ok(batch)
    }

    /// Writes everything the network is given and compared with as safetensors, for looking into what went wrong.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn write(&self, path: &Path) -> Result<()> {
        let [b, v, t, r] = [self.size, self.views[0], self.views[1], self.resolution];
        let channels = |values: &[f32], views: usize| values.len() / (b * views * r * r).max(1);
        let images = |values, views| vec![b, views, channels(values, views), r, r];
        let mut tensors = vec![
            ("posed".to_owned(), images(&self.posed, v), &self.posed),
            ("other".to_owned(), images(&self.other, v), &self.other),
            (
                "targets".to_owned(),
                images(&self.targets, t),
                &self.targets,
            ),
            ("source".to_owned(), images(&self.source, t), &self.source),
            ("albedo".to_owned(), images(&self.albedo, t), &self.albedo),
        ];
        for (name, values, width) in [
            ("exposures", &self.exposures, 1),
            ("backgrounds", &self.backgrounds, 3),
        ] {
            tensors.push((name.to_owned(), vec![b, width], values));
        }
        let mode = |edit: &BatchEdit| format!("{:?}", edit.kind.mode).to_lowercase();
        let mut told = Vec::new();
        for (i, edit) in self.before.iter().enumerate() {
            told.push((format!("before{i}.{}.lights", mode(edit)), edit.features()));
        }
        for (i, edit) in self.edits.iter().enumerate() {
            told.push((format!("edit{i}.{}.lights", mode(edit)), edit.features()));
            if !edit.at_once.is_empty() {
                told.push((
                    format!("edit{i}.{}.at_once", mode(edit)),
                    features(&edit.at_once),
                ));
            }
        }
        for (name, features) in &told {
            let shape = vec![b, features.len() / b.max(1)];
            tensors.push((name.clone(), shape, features));
        }
        for (i, edit) in self.edits.iter().enumerate() {
            let mode = mode(edit);
            let truth = images(&edit.truth, t);
            tensors.push((format!("edit{i}.{mode}.truth"), truth, &edit.truth));
            let exposures = &edit.exposures;
            tensors.push((format!("edit{i}.{mode}.exposures"), vec![b, 1], exposures));
        }
        let failed =
            |e: safetensors::SafeTensorError| Error::invalid(path, "tensors", e.to_string());
        let bytes: Vec<Vec<u8>> = tensors
            .iter()
            .map(|(.., values)| values.iter().flat_map(|v| v.to_le_bytes()).collect())
            .collect();
        let views = tensors
            .iter()
            .zip(&bytes)
            .map(|((name, shape, _), bytes)| {
                Ok((name, TensorView::new(Dtype::F32, shape.clone(), bytes)?))
            })
            .collect::<std::result::Result<Vec<_>, _>>()
            .map_err(failed)?;
        let file = safetensors::serialize(views, None).map_err(failed)?;
        lumi_core::fs::atomic_write(path, &file)?;
        Ok(())
    }
}
