//! The training loop.

use crate::Result;
use crate::config::{StageConfig, TrainConfig};
use crate::loader::{Batch, prefetch, read_objects};
use crate::log::Log;
use crate::objective::{Objective, forward};
use crate::optim::{Average, Stepped, descend, optimizer, select};
use crate::sample::Object;
use crate::state::{self, Progressed};
use crate::validate::validate;
use burn::module::Module;
use burn::tensor::Device;
use lumi_core::{Event, Progress, Seed};
use lumi_kernels::{Precision, Save};
use lumi_model::checkpoint::{self, Provenance, Storage};
use lumi_model::resize::resized;
use lumi_model::{Error, ModelConfig, Network};
use std::path::PathBuf;
use std::sync::Arc;

/// Runs all stages of a config, from its saved state if `resume`, and returns the averaged weights' file.
///
/// # Errors
/// On bad configs, data or state, on an existing state without `resume`, and when the loss is no number.
pub fn train(
    config: &TrainConfig,
    resume: bool,
    device: &Device,
    progress: &dyn Progress,
) -> Result<PathBuf> {
    let model = config.model_config()?;
    std::fs::create_dir_all(&config.output).map_err(|e| lumi_core::Error::io(&config.output, e))?;
    let start = match (state::progressed(config)?, resume) {
        (Some(found), true) => Some(found),
        (None, _) => None,
        (Some(_), false) => {
            let expected = "expected an empty folder, or --resume to continue the run in it";
            return Err(lumi_core::Error::invalid(&config.output, "output", expected).into());
        }
    };

    let training = device.clone().autodiff();
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
    let mut network = match &config.init {
        None => Network::new(&model, Seed(config.seed), &training),
        Some(path) => {
            let (network, found, _) = checkpoint::load(path, &training)?;
            resized(network, &found, &model)?
        }
    }
    .with_precision(precision)
    .with_save(save);
    let mut average = Average::new(&network, config.ema);
    let objective = Objective::new(config, &training)?;
    let mut log = Log::open(&config.output)?;
    let mut data: Option<(usize, Arc<Vec<Object>>, Vec<Object>)> = None;
    let mut taken: Vec<u64> = Vec::new();
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
                average.updates = start.updates;
                (network, optimizer) = state::load(config, &model, network, &mut average, device)?;
            }
        }
        network = select(network, stage.parts());
        log.before = taken.iter().sum();
        let resolution = stage.resolution.unwrap_or(model.resolution);
        if data.as_ref().is_none_or(|(at, ..)| *at != resolution) {
            drop(data.take());
            let (train, held) = read_objects(&config.data, resolution, config.holdout, progress)?;
            data = Some((resolution, Arc::new(train), held));
        }
        let Some((_, objects, held)) = &data else {
            continue;
        };
        check_stage(index, stage, &model, objects.iter().chain(held))?;

        let seed = Seed(config.seed).child("stage").index(index as u64);
        let numbers = (step * config.accumulate, stage.steps * config.accumulate);
        let batches = prefetch(objects.clone(), config, &model, stage, seed, numbers);
        let name = format!(
            "stage {} of {}, {:?}",
            index + 1,
            config.stages.len(),
            stage.kind
        );
        progress.event(Event::Begin {
            stage: name,
            total: stage.steps,
        });
        while step < stage.steps {
            let rate = stage.rate(step);
            let limit = f64::from(config.optimizer.clip);
            let some: Vec<Batch> = batches.iter().take(config.accumulate as usize).collect();
            let done = descend(
                network,
                &mut optimizer,
                stage.parts(),
                (rate, limit),
                &some,
                |network, batch| {
                    objective.loss(&forward(network, &model, batch, &training)?, stage)
                },
            )?;
            let Stepped { loss, norm, .. } = done;
            if !loss.is_finite() || !norm.is_finite() {
                return Err(diverged(config, &some, index, step, loss, norm));
            }
            network = done.network;
            average.update(&network);
            step += 1;

            let samples = config.batch as u64 * config.accumulate;
            log.step(index, step, loss, norm, rate, samples)?;
            let note = format!("loss {loss:.5}, {:.1} samples/s", log.throughput());
            progress.event(Event::Step { done: step, note });
            if step % config.validate_every == 0 || step == stage.steps {
                let averaged = average.apply(network.valid());
                let (scores, sheet) = validate(&averaged, held, config, &model, stage, device)?;
                log.scores(index, step, &scores, &sheet)?;
                let progressed = Progressed {
                    stage: index,
                    step,
                    updates: average.updates,
                    config: config.clone(),
                };
                state::save(&config.output, &network, &optimizer, &average, &progressed)?;
                export(config, &model, &average, &[&taken[..], &[step]].concat())?;
            }
        }
        progress.event(Event::End);
        taken.push(stage.steps);
    }
    export(config, &model, &average, &taken)
}

/// Saves what the step was given, and says where.
fn diverged(
    config: &TrainConfig,
    batches: &[Batch],
    stage: usize,
    step: u64,
    loss: f32,
    norm: f64,
) -> Error {
    let mut files = Vec::new();
    for batch in batches {
        let path = config
            .output
            .join(format!("diverged-{stage}-{}.safetensors", batch.step));
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

/// What can only be checked with the model and the data at hand.
fn check_stage<'a>(
    index: usize,
    stage: &StageConfig,
    model: &ModelConfig,
    mut objects: impl Iterator<Item = &'a Object>,
) -> Result<()> {
    let error = |name: &str, expected: String| {
        Err(lumi_core::Error::value(format!("stages[{index}].{name}"), expected).into())
    };
    let resolution = stage.resolution.unwrap_or(model.resolution);
    if !resolution.is_multiple_of(model.patch) {
        let expected = format!("expected a multiple of the model's patch, {}", model.patch);
        return error("resolution", expected);
    }
    let needed = stage.inputs[1];
    match objects.find(|o| o.record.cameras.len() < needed) {
        None => Ok(()),
        Some(object) => {
            let (name, views) = (&object.record.name, object.record.cameras.len());
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
) -> Result<PathBuf> {
    let provenance = Provenance {
        origin: "trained by lumi train".into(),
        steps: steps.to_vec(),
        data: format!(
            "light-basis objects of {}",
            config.data.file_name().unwrap_or_default().display()
        ),
        licence: "MIT OR Apache-2.0".into(),
    };
    let path = config.output.join("weights.safetensors");
    checkpoint::write(&path, average.lazy(), model, &provenance, Storage::Bf16)?;
    Ok(path)
}
