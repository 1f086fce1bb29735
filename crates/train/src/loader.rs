//! Batches by step: the same step always gives the same batch, made ahead of time on a thread.

use crate::Result;
use crate::config::{StageConfig, TrainConfig};
use crate::object::{Budget, Object};
use crate::reduce::Reduce;
use crate::sample::{EditKind, Plan, Sample};
use lumi_core::{Error, Event, Progress, Seed};
use lumi_data::store;
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
    /// Base colour, `[b, targets, 3, r, r]`; empty if the stage has no use for it.
    pub albedo: Vec<f32>,
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
            ("albedo".to_owned(), images(&self.albedo, t), &self.albedo),
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

/// Opens a store at a resolution, split into training and held-out objects, which may keep `cache` bytes in memory.
///
/// # Errors
/// If the folder holds no objects, or one is not as it must be.
pub fn open_objects(
    folder: &Path,
    resolution: usize,
    holdout: usize,
    cache: usize,
    progress: &dyn Progress,
) -> Result<(Vec<Object>, Vec<Object>)> {
    let files = store::list(folder)?;
    if files.is_empty() {
        let expected = "expected records of a training store; `lumi dataset generate` makes them";
        return Err(Error::invalid(folder, "(folder)", expected).into());
    }
    let total = files.len() as u64;
    progress.event(Event::Begin {
        stage: "opening objects".into(),
        total,
    });
    let budget = Budget::new(cache);
    let (mut training, mut held) = (Vec::new(), Vec::new());
    for (i, path) in files.iter().enumerate() {
        let object = Object::open(path, resolution, &budget)?;
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

/// Which of a step's samples a worker takes: `config.batch` are dealt out evenly, in the order of the workers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Share {
    /// The worker's number, from 0.
    pub rank: usize,
    /// Workers; a divisor of the batch.
    pub workers: usize,
}

impl Share {
    /// Every sample.
    pub const ALL: Self = Self {
        rank: 0,
        workers: 1,
    };

    /// That of a worker.
    #[must_use]
    pub fn of(worker: &dyn Reduce) -> Self {
        Self {
            rank: worker.rank(),
            workers: worker.workers(),
        }
    }
}

/// A worker's share of the batch of one step. The samples depend on seed and step, not on how many share them.
///
/// # Errors
/// If a picture of an object cannot be read.
pub fn make_batch(
    objects: &[Object],
    config: &TrainConfig,
    model: &ModelConfig,
    stage: &StageConfig,
    seed: Seed,
    (step, share): (u64, Share),
) -> Result<Batch> {
    let seed = seed.index(step);
    let rng = &mut seed.stream("batch");
    let plan = Plan::draw(rng, stage, model.lights.modes());
    let resolution = stage.resolution(model);
    let mut batch = Batch {
        step,
        size: config.batch / share.workers,
        views: [plan.inputs, plan.targets],
        resolution,
        posed: Vec::new(),
        other: Vec::new(),
        rays: Vec::new(),
        source: Vec::new(),
        albedo: Vec::new(),
        edits: plan
            .edits
            .iter()
            .map(|kind| (kind.clone(), Vec::new(), Vec::new()))
            .collect(),
    };
    let mine = batch.size * share.rank..batch.size * (share.rank + 1);
    for i in 0..config.batch {
        let object = &objects[rng.random_range(0..objects.len())];
        if !mine.contains(&i) {
            continue;
        }
        let sample = Sample::draw(object, &plan, model, seed.index(i as u64))?;
        batch.posed.extend(sample.posed);
        batch.other.extend(sample.other);
        batch.rays.extend(sample.rays);
        batch.source.extend(sample.source);
        batch.albedo.extend(sample.albedo);
        for (all, (features, pictures)) in batch.edits.iter_mut().zip(sample.edits) {
            all.1.extend(features);
            all.2.extend(pictures);
        }
    }
    Ok(batch)
}

/// Batches in the order of their steps, made ahead of time on threads.
pub struct Batches {
    /// One per thread; they take turns.
    made: Vec<Receiver<Result<Batch>>>,
    next: usize,
}

/// Batches that each thread makes before the first of them is taken.
const AHEAD: usize = 2;

impl Batches {
    /// Makes a worker's share of the batches `from..to` of a stage on `config.loaders` threads.
    #[must_use]
    pub fn prefetch(
        objects: &Arc<Vec<Object>>,
        config: &TrainConfig,
        model: &ModelConfig,
        stage: &StageConfig,
        seed: Seed,
        (from, to): (u64, u64),
        share: Share,
    ) -> Self {
        let make = |first: u64| {
            let (send, receive) = sync_channel(AHEAD);
            let (config, model, stage) = (config.clone(), model.clone(), stage.clone());
            let objects = Arc::clone(objects);
            std::thread::spawn(move || {
                for step in (from + first..to).step_by(config.loaders) {
                    let batch = make_batch(&objects, &config, &model, &stage, seed, (step, share));
                    let failed = batch.is_err();
                    // If nobody takes it, the loop has ended early and wants no more.
                    if send.send(batch).is_err() || failed {
                        return;
                    }
                }
            });
            receive
        };
        Self {
            made: (0..config.loaders as u64).map(make).collect(),
            next: 0,
        }
    }

    /// The next `count` batches.
    ///
    /// # Errors
    /// If one could not be made.
    pub fn take(&mut self, count: u64) -> Result<Vec<Batch>> {
        let mut next = || {
            let made = self.made[self.next].recv();
            self.next = (self.next + 1) % self.made.len();
            made.map_err(|_| lumi_model::Error::Unsupported("a loader thread has stopped".into()))?
        };
        (0..count).map(|_| next()).collect()
    }
}
