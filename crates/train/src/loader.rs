//! Batches by step: the same step always gives the same batch, made ahead of time on a thread.

use crate::Result;
use crate::batch::Batch;
use crate::config::{Data, StageConfig, TrainConfig};
use crate::object::{Budget, Object};
use crate::plan::Plan;
use crate::reduce::Reduce;
use lumi_core::seed::Rng;
use lumi_core::{Error, Event, Progress, Seed};
use lumi_data::store;
use lumi_model::ModelConfig;
use rand::RngExt;
use rayon::{ThreadPool, ThreadPoolBuildError, ThreadPoolBuilder};
use std::sync::Arc;
use std::sync::mpsc::{Receiver, sync_channel};

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

    pub(crate) fn draw(&self, rng: &mut Rng) -> &Object {
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
    let plan = Plan::draw(rng, stage, model);
    Batch::of(&plan, objects, config, model, (seed, rng), (step, share))
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
            made.map_err(|_| lumi_model::Error::Failed("a loader thread has stopped".into()))?
        };
        (0..count).map(|_| next()).collect()
    }
}
