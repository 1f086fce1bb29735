//! The training loop.

use crate::Result;
use crate::config::{StageConfig, TrainConfig};
use crate::handover::{self, Handover};
use crate::loader::{Batch, Batches, Objects, Share, open_objects};
use crate::log::{Log, Step};
use crate::object::Object;
use crate::objective::{Objective, forward};
use crate::optim::{Average, Pace, Stepped, descend, optimizer, select};
use crate::reduce::{Reduce, agree, ask_first, meet, threads};
use crate::state::{self, Progressed};
use crate::validate::validate;
use burn::module::Module;
use burn::optim::ModuleOptimizer;
use burn::tensor::Device;
use lumi_core::{DisplayImage, Event, Progress, Seed};
use lumi_kernels::{Precision, Save};
use lumi_model::checkpoint::{self, Provenance, Storage};
use lumi_model::head::Head;
use lumi_model::resize::resized;
use lumi_model::{Error, ModelConfig, Network};
use std::fs::File;
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

/// One worker's run.
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
    let (start, _alone) = start(config, resume, worker)?;
    let training = device.clone().autodiff();
    let (mut network, old_head) = begin(config, &model, start.as_ref(), &training)?;
    let mut lead = match worker.rank() {
        0 => Some(Lead {
            average: Average::new(&network, config.ema),
            log: Log::open(&config.output)?,
        }),
        _ => None,
    };
    let share = Share::of(worker);
    let objective = Objective::new(config, &training)?;
    let mut data: Option<(usize, Arc<Objects>, Objects)> = None;
    let mut taken: Vec<u64> = Vec::new();
    let mut time = Time::default();
    for (index, stage) in config.stages.iter().enumerate() {
        let mut optimizer = optimizer(&config.optimizer, &network);
        let mut step = 0;
        if let Some(start) = &start {
            if index < start.stage {
                taken.push(stage.steps);
                continue;
            }
            if index == start.stage {
                step = start.step;
                let average = lead.as_mut().map(|lead| &mut lead.average);
                (network, optimizer) = state::load(config, &model, network, average, start)?;
            }
        }
        network = select(network, stage.parts());
        let resolution = stage.resolution(&model);
        if data.as_ref().is_none_or(|(at, ..)| *at != resolution) {
            drop(data.take());
            let cache = config.cache_mib.saturating_mul(1 << 20);
            let (train, held) =
                open_objects(&config.data, resolution, config.holdout, cache, progress)?;
            agree(worker, "objects", &names(&train))?;
            data = Some((resolution, Arc::new(train), held));
        }
        let Some((_, objects, held)) = &data else {
            continue;
        };
        check_data(index, stage, objects.iter().chain(held.iter()))?;

        let seed = Seed(config.seed).child("stage").index(index as u64);
        let numbers = (step * config.accumulate, stage.steps * config.accumulate);
        let mut batches = Batches::prefetch(objects, config, &model, stage, seed, numbers, share);
        let save = |lead: &Lead, network: &Network, optimizer: &ModuleOptimizer, step: u64| {
            let progressed = Progressed {
                stage: index,
                step,
                updates: lead.average.updates,
                config: config.clone(),
            };
            let (output, average) = (&config.output, &lead.average);
            state::save(output, &model, network, optimizer, average, &progressed)?;
            export(config, &model, average, &[&taken[..], &[step]].concat())
        };
        let mut saved = step;
        let (number, all) = (index + 1, config.stages.len());
        progress.event(Event::Begin {
            stage: format!("stage {number} of {all}, {:?}", stage.kind),
            total: stage.steps,
        });
        while step < stage.steps {
            if ask_first(worker, progress.stop())? {
                if let Some(lead) = lead.as_ref().filter(|_| saved != step) {
                    save(lead, &network, &optimizer, step)?;
                }
                progress.event(Event::End);
                return Ok(Finished {
                    weights: weights(config),
                    stopped: Some((index, step)),
                    waiting: time.waiting(),
                });
            }
            let rate = stage.rate(step);
            let pace = Pace {
                rate,
                backbone: stage.backbone_rate,
                editor: stage.editor_rate,
                limit: f64::from(config.optimizer.clip),
            };
            let handover = Handover::at(step, stage.handover.as_ref(), old_head.as_ref());
            let begun = Instant::now();
            let some = batches.take(config.accumulate)?;
            let waited = begun.elapsed();
            let done = descend(
                network,
                &mut optimizer,
                stage.parts(),
                pace,
                &some,
                worker,
                |network, batch| {
                    let outcome = forward(network, &model, batch, handover.as_ref(), &training)?;
                    objective.loss(&outcome, stage)
                },
            )?;
            let Stepped { loss, norm, .. } = done;
            if !loss.is_finite() || !norm.is_finite() {
                return Err(diverged(config, &some, (index, step), worker, (loss, norm)));
            }
            network = done.network;
            step += 1;
            time.add(waited, begun.elapsed());

            let Some(lead) = &mut lead else {
                continue;
            };
            lead.average.update(&network);
            lead.log.step(&Step {
                stage: index,
                step,
                before: taken.iter().sum(),
                loss,
                norm,
                rate,
                samples: config.batch as u64 * config.accumulate,
                waiting: time.waiting(),
            })?;
            let note = lead.log.note();
            progress.event(Event::Step { done: step, note });
            if step % config.validate_every == 0 || step == stage.steps {
                let averaged = lead.average.apply(network.valid());
                let old_head = old_head.as_ref().map(Module::valid);
                let handover = Handover::at(step, stage.handover.as_ref(), old_head.as_ref());
                let handover = handover.as_ref();
                let (scores, sheet) =
                    validate(&averaged, held, config, &model, stage, handover, device)?;
                lead.log.scores(index, step, &scores, &sheet)?;
                progress.event(Event::Picture {
                    caption: format!("validation at step {step}: {scores}"),
                    image: Arc::new(top(sheet, SHOWN * resolution)),
                });
                save(lead, &network, &optimizer, step)?;
                saved = step;
            }
        }
        progress.event(Event::End);
        taken.push(stage.steps);
    }
    let weights = weights(config);
    if let Some(lead) = &lead {
        export(config, &model, &lead.average, &taken)?;
    }
    Ok(Finished {
        weights,
        stopped: None,
        waiting: time.waiting(),
    })
}

/// Samples that a progress event shows.
const SHOWN: usize = 2;

/// The uppermost `rows` of an image.
fn top(mut image: DisplayImage, rows: usize) -> DisplayImage {
    image.height = rows.min(image.height);
    image.pixels.truncate(image.width * image.height);
    image
}

/// Where the run begins, the same for all workers, `None` at the beginning; and what keeps others out of its folder, which the
/// first worker has.
fn start(
    config: &TrainConfig,
    resume: bool,
    worker: &dyn Reduce,
) -> Result<(Option<Progressed>, Option<File>)> {
    let output = &config.output;
    let mut alone = None;
    if worker.rank() == 0 {
        std::fs::create_dir_all(output).map_err(|e| lumi_core::Error::io(output, e))?;
        alone = Some(state::alone(output)?);
        // Puts an interrupted save right, which the others must not see half done.
        state::progressed(config)?;
    }
    meet(worker)?;
    let found = state::progressed(config)?;
    if found.is_some() && !resume {
        let expected = "expected an empty folder, or --resume to continue the run in it";
        return Err(lumi_core::Error::invalid(output, "output", expected).into());
    }
    let stands = found.as_ref().map(|found| (found.stage, found.step));
    agree(
        worker,
        "config and saved state",
        &format!("{config:?} {stands:?}"),
    )?;
    Ok((found, alone))
}

/// The network that a run begins with, and the head that its first stage hands over from. A resumed run needs `init` for
/// that head alone: its state has everything else.
fn begin(
    config: &TrainConfig,
    model: &ModelConfig,
    start: Option<&Progressed>,
    training: &Device,
) -> Result<(Network, Option<Head>)> {
    let precision = if config.bf16 {
        Precision::Bf16
    } else {
        Precision::F32
    };
    let save = if config.recompute {
        Save::Input
    } else {
        Save::Activations
    };
    let mut network = Network::new(model, Seed(config.seed), training);
    let mut old_head = None;
    let hands_over = config.stages[0].handover.is_some();
    let needed = start.is_none_or(|start| start.stage == 0 && hands_over);
    if let Some(path) = config.init.as_ref().filter(|_| needed) {
        let fresh = network;
        let mut found;
        (network, found, _) = checkpoint::load(path, training)?;
        if hands_over {
            let (given, now, old) = handover::exchange(network, &found, model, fresh.head, path)?;
            (network, found, old_head) = (given, now, Some(old));
        }
        // A head for base colour is not resized: with other patches it begins anew.
        if model.albedo && (!found.albedo || found.patch != model.patch) {
            network.albedo = fresh.albedo;
            found.albedo = true;
        }
        network = resized(network, &found, model, Seed(config.seed))?;
    }
    let network = network.with_precision(precision).with_save(save);
    Ok((network, old_head))
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

fn names(objects: &Objects) -> String {
    let names = objects.iter().map(|object| object.name());
    names.collect::<Vec<_>>().join("\n")
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
    Error::Unsupported(format!(
        "training diverged at step {step} of stage {stage}: loss {loss}, gradient norm {norm}; its samples are in {}",
        files.join(", ")
    ))
}

/// What can only be checked with the data at hand.
fn check_data<'a>(
    index: usize,
    stage: &StageConfig,
    objects: impl Iterator<Item = &'a Object>,
) -> Result<()> {
    let error = |name: &str, expected: String| {
        Err(lumi_core::Error::value(format!("stages[{index}].{name}"), expected).into())
    };
    let objects: Vec<_> = objects.collect();
    if stage.albedo > 0.0
        && let Some(object) = objects.iter().find(|o| !o.has_albedo())
    {
        let expected = format!("expected 0, since `{}` has no albedo", object.name());
        return error("albedo", expected);
    }
    let needed = stage.inputs[1];
    match objects.iter().find(|o| o.cameras().len() < needed) {
        None => Ok(()),
        Some(object) => {
            let (name, views) = (object.name(), object.cameras().len());
            let expected = format!("expected at most the {views} views that `{name}` has");
            error("inputs", expected)
        }
    }
}

/// Writes the averaged weights for use, `weights.safetensors`.
fn export(
    config: &TrainConfig,
    model: &ModelConfig,
    average: &Average,
    steps: &[u64],
) -> Result<()> {
    let stores = config.data.stores();
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
        &weights(config),
        average.lazy(),
        model,
        &provenance,
        Storage::Bf16,
    )
}
