//! The training loop.

use crate::Result;
use crate::batch::Batch;
use crate::begin;
use crate::config::{StageConfig, TrainConfig};
use crate::handover::Handover;
use crate::loader::{Batches, Objects, Share, open_objects};
use crate::log::{Log, Step};
use crate::objective::{Objective, forward};
use crate::optim::{Average, Pace, Stepped, descend, optimizer, select};
use crate::reduce::{Reduce, agree, ask_first, threads};
use crate::state::{self, Progressed};
use crate::validate::validate;
use burn::module::Module;
use burn::optim::ModuleOptimizer;
use burn::tensor::Device;
use lumi_core::{DisplayImage, Event, Progress, Seed};
use lumi_model::checkpoint::{self, Provenance, Storage};
use lumi_model::head::Head;
use lumi_model::{Error, ModelConfig, Network};
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

/// What a run leaves.
#[derive(Clone, Debug)]
pub struct Finished {
    /// The averaged weights' file.
    pub weights: PathBuf,
    /// Where it was asked to stop before its end, if it was: a stage, from 0, and its finished steps.
    pub stopped: Option<(usize, u64)>,
    /// Share of the steps' time that the first worker waited for samples.
    pub waiting: f64,
}

/// Runs all stages of a config, from its saved state if `resume`: on all `devices` of this process at once, together
/// with other `processes` that have as many. Between two steps it asks the first worker's `progress` whether to stop, and
/// if so saves its state and returns.
///
/// # Errors
/// On bad configs, data or state, on an existing state without `resume`, when the loss is no number, and when another
/// worker has failed.
pub fn train(
    config: &TrainConfig,
    resume: bool,
    devices: &[Device],
    processes: &dyn Reduce,
    progress: &dyn Progress,
) -> Result<Finished> {
    let workers = devices.len() * processes.workers();
    if workers == 0 || !config.batch.is_multiple_of(workers) {
        let expected = format!("expected a multiple of the {workers} workers");
        return Err(lumi_core::Error::value("batch", expected).into());
    }
    threads::run(devices.len(), processes, |place, worker| {
        let progress: &dyn Progress = if worker.rank() == 0 { progress } else { &() };
        work(config, resume, &devices[place], worker, progress)
    })
}

/// What only the first worker keeps.
struct Lead {
    average: Average,
    log: Log,
}

/// One worker's run, stage after stage.
fn work(
    config: &TrainConfig,
    resume: bool,
    device: &Device,
    worker: &dyn Reduce,
    progress: &dyn Progress,
) -> Result<Finished> {
    let model = config.model_config()?;
    // All of them now, rather than each when the stages before it have been trained.
    for (index, stage) in config.stages.iter().enumerate() {
        stage.fits(index, &model)?;
    }
    let (start, _alone) = begin::start(config, resume, worker)?;
    let (mut run, mut network) = Run::begin(config, model, start, device, worker, progress)?;
    for index in run.taken.len()..config.stages.len() {
        match run.stage(index, network)? {
            ControlFlow::Continue(trained) => network = trained,
            ControlFlow::Break(step) => return Ok(run.finished(Some((index, step)))),
        }
    }
    run.export(&run.taken)?;
    Ok(run.finished(None))
}

/// What stays the same, or is kept, from stage to stage.
struct Run<'a> {
    config: &'a TrainConfig,
    model: ModelConfig,
    /// For validation, and with autodiff.
    device: &'a Device,
    training: Device,
    worker: &'a dyn Reduce,
    progress: &'a dyn Progress,
    objective: Objective,
    lead: Option<Lead>,
    /// Where it was when its state was saved; of the stage that it goes on with alone.
    start: Option<Progressed>,
    /// The head that the first stage hands over from.
    old_head: Option<Head>,
    data: Option<Opened>,
    /// Steps that each finished stage took.
    taken: Vec<u64>,
    time: Time,
}

/// The data at a resolution.
struct Opened {
    resolution: usize,
    training: Arc<Objects>,
    held: Objects,
}

/// Where a stage is.
struct Stage<'a> {
    index: usize,
    config: &'a StageConfig,
    network: Network,
    optimizer: ModuleOptimizer,
    batches: Batches,
    /// Steps that are done, and how many of them when the state was saved last.
    step: u64,
    saved: u64,
}

impl<'a> Run<'a> {
    /// A run from where it stands, and the network that it begins with.
    fn begin(
        config: &'a TrainConfig,
        model: ModelConfig,
        start: Option<Progressed>,
        device: &'a Device,
        worker: &'a dyn Reduce,
        progress: &'a dyn Progress,
    ) -> Result<(Self, Network)> {
        let training = device.clone().autodiff();
        let (network, old_head) = begin::network(config, &model, start.as_ref(), &training)?;
        let lead = match worker.rank() {
            0 => Some(Lead {
                average: Average::new(&network, config.ema),
                log: Log::open(&config.output)?,
            }),
            _ => None,
        };
        let done = start.as_ref().map_or(0, |start| start.stage);
        let run = Self {
            objective: Objective::new(config, &training)?,
            taken: config.stages[..done].iter().map(|s| s.steps).collect(),
            config,
            model,
            device,
            training,
            worker,
            progress,
            lead,
            start,
            old_head,
            data: None,
            time: Time::default(),
        };
        Ok((run, network))
    }

    /// Trains a stage to its end, or to where it was asked to stop: a step.
    fn stage(&mut self, index: usize, network: Network) -> Result<ControlFlow<u64, Network>> {
        let mut stage = self.enter(index, network)?;
        let (number, all) = (index + 1, self.config.stages.len());
        self.progress.event(Event::Begin {
            stage: format!("stage {number} of {all}, {:?}", stage.config.kind),
            total: stage.config.steps,
        });
        while stage.step < stage.config.steps {
            if ask_first(self.worker, self.progress.stop())? {
                self.save(&mut stage)?;
                self.progress.event(Event::End);
                return Ok(ControlFlow::Break(stage.step));
            }
            stage = self.step(stage)?;
            if stage.step % self.config.validate_every == 0 || stage.step == stage.config.steps {
                self.validate(&stage)?;
                self.save(&mut stage)?;
            }
        }
        self.progress.event(Event::End);
        self.taken.push(stage.config.steps);
        Ok(ControlFlow::Continue(stage.network))
    }

    /// A stage at its beginning, or where its state was saved.
    fn enter(&mut self, index: usize, mut network: Network) -> Result<Stage<'a>> {
        let config = &self.config.stages[index];
        let mut optimizer = optimizer(&self.config.optimizer, &network);
        let mut step = 0;
        if let Some(start) = self.start.take() {
            step = start.step;
            let average = self.lead.as_mut().map(|lead| &mut lead.average);
            (network, optimizer) = state::load(self.config, &self.model, network, average, &start)?;
        }
        let objects = {
            let data = self.open(config)?;
            let all = data.training.iter().chain(data.held.iter());
            begin::check_data(index, config, all)?;
            Arc::clone(&data.training)
        };
        let seed = Seed(self.config.seed).child("stage").index(index as u64);
        let each = self.config.accumulate;
        let batches = Batches::prefetch(
            &objects,
            self.config,
            &self.model,
            config,
            seed,
            (step * each, config.steps * each),
            Share::of(self.worker),
        );
        Ok(Stage {
            index,
            config,
            network: select(network, config.parts()),
            optimizer,
            batches,
            step,
            saved: step,
        })
    }

    /// The data at a stage's resolution.
    fn open(&mut self, stage: &StageConfig) -> Result<&Opened> {
        let resolution = stage.resolution(&self.model);
        // Another one is gone before this one is there.
        let kept = self
            .data
            .take()
            .filter(|data| data.resolution == resolution);
        let data = match kept {
            Some(data) => data,
            None => {
                let cache = self.config.cache_mib.saturating_mul(1 << 20);
                let (data, holdout) = (&self.config.data, self.config.holdout);
                let (training, held) =
                    open_objects(data, resolution, holdout, cache, self.progress)?;
                agree(self.worker, "objects", &begin::names(&training))?;
                Opened {
                    resolution,
                    training: Arc::new(training),
                    held,
                }
            }
        };
        Ok(self.data.insert(data))
    }

    /// One step: its samples, their loss, the optimiser, the average and the log.
    fn step(&mut self, mut stage: Stage<'a>) -> Result<Stage<'a>> {
        let (config, before) = (stage.config, stage.step);
        let pace = Pace {
            rate: config.rate(before),
            backbone: config.backbone_rate,
            editor: config.editor_rate,
            limit: f64::from(self.config.optimizer.clip),
        };
        let handover = Handover::at(before, config.handover.as_ref(), self.old_head.as_ref());
        let begun = Instant::now();
        let samples = stage.batches.take(self.config.accumulate)?;
        let waited = begun.elapsed();
        let done = descend(
            stage.network,
            &mut stage.optimizer,
            config.parts(),
            pace,
            &samples,
            self.worker,
            |network, batch| {
                let (model, device) = (&self.model, &self.training);
                let outcome = forward(network, model, batch, handover.as_ref(), device)?;
                self.objective.loss(&outcome, config)
            },
        )?;
        let Stepped { loss, norm, .. } = done;
        if !loss.is_finite() || !norm.is_finite() {
            let (place, found) = ((stage.index, before), (loss, norm));
            return Err(diverged(self.config, &samples, place, self.worker, found));
        }
        stage.network = done.network;
        stage.step += 1;
        self.time.add(waited, begun.elapsed());
        if let Some(lead) = &mut self.lead {
            lead.average.update(&stage.network);
            lead.log.step(&Step {
                stage: stage.index,
                step: stage.step,
                before: self.taken.iter().sum(),
                loss,
                norm,
                rate: pace.rate,
                samples: self.config.batch as u64 * self.config.accumulate,
                waiting: self.time.waiting(),
            })?;
            let (done, note) = (stage.step, lead.log.note());
            self.progress.event(Event::Step { done, note });
        }
        Ok(stage)
    }

    /// Scores the averaged weights on what is held out, if this worker keeps them.
    fn validate(&mut self, stage: &Stage<'_>) -> Result<()> {
        let (Some(lead), Some(data)) = (&mut self.lead, &self.data) else {
            return Ok(());
        };
        let averaged = lead.average.apply(stage.network.valid());
        let old_head = self.old_head.as_ref().map(Module::valid);
        let (step, config) = (stage.step, stage.config);
        let handover = Handover::at(step, config.handover.as_ref(), old_head.as_ref());
        let (scores, sheet) = validate(
            &averaged,
            &data.held,
            self.config,
            &self.model,
            config,
            handover.as_ref(),
            self.device,
        )?;
        lead.log.scores(stage.index, step, &scores, &sheet)?;
        self.progress.event(Event::Picture {
            caption: format!("validation at step {step}: {scores}"),
            image: Arc::new(top(sheet, SHOWN * data.resolution)),
        });
        Ok(())
    }

    /// Saves the state and the averaged weights, if this worker keeps them and something is new.
    fn save(&self, stage: &mut Stage<'_>) -> Result<()> {
        let Some(lead) = self.lead.as_ref().filter(|_| stage.saved != stage.step) else {
            return Ok(());
        };
        let progressed = Progressed {
            stage: stage.index,
            step: stage.step,
            updates: lead.average.updates,
            config: self.config.clone(),
        };
        state::save(
            &self.config.output,
            &self.model,
            &stage.network,
            &stage.optimizer,
            &lead.average,
            &progressed,
        )?;
        stage.saved = stage.step;
        self.export(&[&self.taken[..], &[stage.step]].concat())
    }

    /// Writes the averaged weights for use, `weights.safetensors`, if this worker keeps them.
    fn export(&self, steps: &[u64]) -> Result<()> {
        let Some(lead) = &self.lead else {
            return Ok(());
        };
        let stores = self.config.data.stores();
        let name =
            |(store, _): &(&Path, f32)| store.file_name().unwrap_or_default().display().to_string();
        let stores: Vec<String> = stores.iter().map(name).collect();
        let provenance = Provenance {
            origin: "trained by lumi train".into(),
            steps: steps.to_vec(),
            data: format!("light-basis objects of {}", stores.join(", ")),
            licence: "MIT OR Apache-2.0".into(),
        };
        checkpoint::write(
            &weights(self.config),
            lead.average.lazy(),
            &self.model,
            &provenance,
            Storage::Bf16,
        )
    }

    fn finished(&self, stopped: Option<(usize, u64)>) -> Finished {
        Finished {
            weights: weights(self.config),
            stopped,
            waiting: self.time.waiting(),
        }
    }
}

/// Samples that a progress event shows.
const SHOWN: usize = 2;

/// The uppermost `rows` of an image.
fn top(mut image: DisplayImage, rows: usize) -> DisplayImage {
    image.height = rows.min(image.height);
    image.pixels.truncate(image.width * image.height);
    image
}

/// Time that steps took, and how much of it went by waiting for samples.
#[derive(Default)]
struct Time {
    waited: Duration,
    all: Duration,
}

impl Time {
    fn add(&mut self, waited: Duration, all: Duration) {
        self.waited += waited;
        self.all += all;
    }

    fn waiting(&self) -> f64 {
        self.waited.as_secs_f64() / self.all.as_secs_f64().max(1e-9)
    }
}

/// The file of a run's averaged weights.
fn weights(config: &TrainConfig) -> PathBuf {
    config.output.join("weights.safetensors")
}

/// Saves what the step was given, and says where.
fn diverged(
    config: &TrainConfig,
    batches: &[Batch],
    (stage, step): (usize, u64),
    worker: &dyn Reduce,
    (loss, norm): (f32, f64),
) -> Error {
    let worker = match worker.workers() {
        1 => String::new(),
        _ => format!("-worker{}", worker.rank()),
    };
    let mut files = Vec::new();
    for batch in batches {
        let path = config.output.join(format!(
            "diverged-{stage}-{}{worker}.safetensors",
            batch.step
        ));
        if let Err(error) = batch.write(&path) {
            return error;
        }
        files.push(path.display().to_string());
    }
    Error::Failed(format!(
        "training diverged at step {step} of stage {stage}: loss {loss}, gradient norm {norm}; its samples are in {}",
        files.join(", ")
    ))
}
