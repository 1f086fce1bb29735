//! Batches by step: the same step always gives the same batch, made ahead of time on a thread.

use crate::Result;
use crate::config::{Data, StageConfig, TrainConfig};
use crate::object::{Budget, Object};
use crate::reduce::Reduce;
use crate::sample::{Alone, EditKind, EditLights, Plan, Sample};
use burn::tensor::{Device, Tensor, TensorData};
use lumi_core::seed::Rng;
use lumi_core::{Camera, Error, Event, Progress, Seed};
use lumi_data::store;
use lumi_model::config::Mode;
use lumi_model::lights::{EditLight, LightShape, RAY_FEATURES};
use lumi_model::{ModelConfig, Network};
use rand::RngExt;
use rayon::{ThreadPool, ThreadPoolBuildError, ThreadPoolBuilder};
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

/// Objects of several stores, of which each is drawn from as often as its share says.
#[derive(Default)]
pub struct Objects {
    stores: Vec<(f32, Vec<Object>)>,
}

impl Objects {
    /// All of them, store by store.
    pub fn iter(&self) -> impl Iterator<Item = &Object> {
        self.stores.iter().flat_map(|(_, objects)| objects)
    }

    fn draw(&self, rng: &mut Rng) -> &Object {
        let whole: f32 = self.stores.iter().map(|(share, _)| share).sum();
        let mut left = match self.stores.len() {
            1 => 0.0,
            _ => whole * rng.random::<f32>(),
        };
        let passed = |(share, _): &&(f32, Vec<Object>)| {
            left -= share;
            left < 0.0
        };
        let last = &self.stores[self.stores.len() - 1];
        let (_, objects) = self.stores.iter().find(passed).unwrap_or(last);
        &objects[rng.random_range(0..objects.len())]
    }
}

/// Opens stores at a resolution, each split into training and held-out objects; all together may keep `cache` bytes in
/// memory.
///
/// # Errors
/// If a folder holds no objects, or too few to hold one out, or one is not as it must be.
pub fn open_objects(
    data: &Data,
    resolution: usize,
    holdout: usize,
    cache: usize,
    progress: &dyn Progress,
) -> Result<(Objects, Objects)> {
    let budget = Budget::new(cache);
    let (mut training, mut held) = (Objects::default(), Objects::default());
    for (folder, share) in data.stores() {
        let files = store::list(folder)?;
        if files.len() < holdout {
            let found = files.len();
            let expected = format!(
                "expected at least {holdout} records of a training store, so that some can be held out, found {found}; `lumi dataset generate` makes them"
            );
            return Err(Error::invalid(folder, "(folder)", expected).into());
        }
        progress.event(Event::Begin {
            stage: "opening objects".into(),
            total: files.len() as u64,
        });
        let (mut kept, mut aside) = (Vec::new(), Vec::new());
        for (i, path) in files.iter().enumerate() {
            let object = Object::open(path, resolution, &budget)?;
            if i % holdout == holdout - 1 {
                aside.push(object)
            } else {
                kept.push(object)
            }
            progress.event(Event::Step {
                done: i as u64 + 1,
                note: String::new(),
            });
        }
        progress.event(Event::End);
        training.stores.push((share, kept));
        held.stores.push((share, aside));
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
    objects: &Objects,
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
        let sample = Sample::draw(object, &plan, model, seed.index(i as u64))?;
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

/// Batches in the order of their steps, made ahead of time on threads.
pub struct Batches {
    /// One per thread; they take turns.
    made: Vec<Receiver<Result<Batch>>>,
    next: usize,
}

/// A thread to make batches on: in the pool of the training step's own parallel loops, these would wait for it at the end of
/// each. It gives way to them, and makes batches in what time steps leave, or while they wait for it.
fn aside() -> std::result::Result<ThreadPool, ThreadPoolBuildError> {
    let give_way = |_| {
        // Where it may not, it takes its turns.
        #[cfg(target_os = "linux")]
        let _ = rustix::process::setpriority_process(Some(rustix::thread::gettid()), GIVES_WAY);
    };
    let pool = ThreadPoolBuilder::new().num_threads(1);
    pool.start_handler(give_way).build()
}

/// The niceness of threads that make batches.
#[cfg(target_os = "linux")]
const GIVES_WAY: i32 = 10;

/// Batches that each thread makes before the first of them is taken.
const AHEAD: usize = 2;

impl Batches {
    /// Makes a worker's share of the batches `from..to` of a stage on `config.loaders` threads.
    #[must_use]
    pub fn prefetch(
        objects: &Arc<Objects>,
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
                let aside = aside();
                for step in (from + first..to).step_by(config.loaders) {
                    let make =
                        || make_batch(&objects, &config, &model, &stage, seed, (step, share));
                    let batch = match &aside {
                        Ok(aside) => aside.install(make),
                        Err(_) => make(),
                    };
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
