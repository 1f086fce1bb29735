//! Batches by step: the same step always gives the same batch, made ahead of time on a thread.

use crate::Result;
use crate::config::{StageConfig, TrainConfig};
use crate::sample::{EditKind, Object, Plan, Sample};
use lumi_core::{Error, Event, Progress, Seed};
use lumi_data::store::{self, ObjectRecord};
use lumi_model::ModelConfig;
use lumi_model::lights::RAY_FEATURES;
use rand::RngExt;
use safetensors::tensor::{Dtype, TensorView};
use std::path::Path;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, sync_channel};

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
    /// `[b, inputs, 3 + c, r, r]`
    pub posed: Vec<f32>,
    /// The inputs under another light, as `posed`; empty if the stage has no use for them.
    pub other: Vec<f32>,
    /// `[b, targets, c, r, r]`
    pub rays: Vec<f32>,
    /// `[b, targets, 3, r, r]`
    pub source: Vec<f32>,
    /// Per edit: its kind, light features `[b, rays, 10]`, targets `[b, targets, 3, r, r]`.
    pub edits: Vec<(EditKind, Vec<f32>, Vec<f32>)>,
}

impl Batch {
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
            ("rays".to_owned(), images(&self.rays, t), &self.rays),
            ("source".to_owned(), images(&self.source, t), &self.source),
        ];
        for (i, (kind, features, truth)) in self.edits.iter().enumerate() {
            let mode = format!("{:?}", kind.mode).to_lowercase();
            let count = features.len() / (b * RAY_FEATURES);
            let shape = vec![b, count, RAY_FEATURES];
            tensors.push((format!("edit{i}.{mode}.lights"), shape, features));
            tensors.push((format!("edit{i}.{mode}.truth"), images(truth, t), truth));
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

/// Reads a store at a resolution, split into training and held-out objects.
///
/// # Errors
/// If the folder holds no objects, or one is corrupt.
pub fn read_objects(
    folder: &Path,
    resolution: usize,
    holdout: usize,
    progress: &dyn Progress,
) -> Result<(Vec<Object>, Vec<Object>)> {
    let files = store::list(folder)?;
    if files.is_empty() {
        let expected = "expected records of a training store; `lumi dataset generate` makes them";
        return Err(Error::invalid(folder, "(folder)", expected).into());
    }
    let total = files.len() as u64;
    progress.event(Event::Begin {
        stage: "reading objects".into(),
        total,
    });
    let (mut training, mut held) = (Vec::new(), Vec::new());
    for (i, path) in files.iter().enumerate() {
        let record = ObjectRecord::read(path)?;
        let object = Object::new(record.downscaled(resolution).map_err(|e| e.at(path))?)
            .map_err(|e| e.at(path))?;
        if i % holdout == holdout - 1 {
            held.push(object)
        } else {
            training.push(object)
        }
        progress.event(Event::Step {
            done: i as u64 + 1,
            note: String::new(),
        });
    }
    progress.event(Event::End);
    if held.is_empty() {
        let expected = format!("expected at least {holdout} objects, so that some can be held out");
        return Err(Error::invalid(folder, "(folder)", expected).into());
    }
    Ok((training, held))
}

/// The batch of one step.
#[must_use]
pub fn make_batch(
    objects: &[Object],
    config: &TrainConfig,
    model: &ModelConfig,
    stage: &StageConfig,
    seed: Seed,
    step: u64,
) -> Batch {
    let seed = seed.index(step);
    let rng = &mut seed.stream("batch");
    let plan = Plan::draw(rng, stage, model.lights.modes());
    let resolution = stage.resolution.unwrap_or(model.resolution);
    let mut batch = Batch {
        step,
        size: config.batch,
        views: [plan.inputs, plan.targets],
        resolution,
        posed: Vec::new(),
        other: Vec::new(),
        rays: Vec::new(),
        source: Vec::new(),
        edits: plan
            .edits
            .iter()
            .map(|kind| (kind.clone(), Vec::new(), Vec::new()))
            .collect(),
    };
    for i in 0..config.batch as u64 {
        let object = &objects[rng.random_range(0..objects.len())];
        let sample = Sample::draw(object, &plan, model, seed.index(i));
        batch.posed.extend(sample.posed);
        batch.other.extend(sample.other);
        batch.rays.extend(sample.rays);
        batch.source.extend(sample.source);
        for (all, (features, pictures)) in batch.edits.iter_mut().zip(sample.edits) {
            all.1.extend(features);
            all.2.extend(pictures);
        }
    }
    batch
}

/// Makes the batches `from..to` of a stage on a thread, two ahead.
#[must_use]
pub fn prefetch(
    objects: Arc<Vec<Object>>,
    config: &TrainConfig,
    model: &ModelConfig,
    stage: &StageConfig,
    seed: Seed,
    (from, to): (u64, u64),
) -> Receiver<Batch> {
    let (send, receive) = sync_channel(2);
    let (config, model, stage) = (config.clone(), model.clone(), stage.clone());
    std::thread::spawn(move || {
        for step in from..to {
            let batch = make_batch(&objects, &config, &model, &stage, seed, step);
            // The loop has ended early; nobody wants more.
            if send.send(batch).is_err() {
                return;
            }
        }
    });
    receive
}
