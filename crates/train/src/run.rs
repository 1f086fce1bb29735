//! The training loop.

use crate::Result;
use crate::config::{StageConfig, TrainConfig};
use crate::loader::{prefetch, read_objects};
use crate::objective::forward;
use crate::optim::{Average, Stepped, descend, optimizer, select};
use crate::sample::Object;
use crate::state::{self, Progressed};
use crate::validate::{Scores, validate};
use burn::module::Module;
use burn::tensor::Device;
use lumi_core::{Event, Progress, Seed};
use lumi_kernels::{Precision, Save};
use lumi_model::checkpoint::{self, Provenance, Storage};
use lumi_model::{Error, ModelConfig, Network};
use serde_json::json;
use std::io::Write;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Instant;

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
            if found != model {
                let expected = "expected weights of the config's model";
                return Err(Error::weights(path, "(metadata)", expected));
            }
            network
        }
    }
    .with_precision(precision)
    .with_save(save);
    let mut average = Average::new(&network, config.ema);
    let mut log = Log::open(config)?;
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
        network = select(network, stage.kind);
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
        let batches = prefetch(
            objects.clone(),
            config,
            &model,
            stage,
            seed,
            (step, stage.steps),
        );
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
        for batch in batches {
            let rate = stage.rate(step);
            let limit = f64::from(config.optimizer.clip);
            let loss = forward(&network, &model, &batch, &training)?.loss(stage.kind);
            let done = descend(network, &mut optimizer, loss, stage.kind, (rate, limit));
            let Stepped {
                loss: value, norm, ..
            } = done;
            if !value.is_finite() || !norm.is_finite() {
                let text =
                    format!("step {step} of stage {index}: loss {value}, gradient norm {norm}");
                return Err(Error::Unsupported(format!("training diverged at {text}")));
            }
            network = done.network;
            average.update(&network);
            step += 1;

            log.step(index, step, value, norm, rate, batch.size)?;
            let note = format!("loss {value:.5}, {:.1} samples/s", log.throughput());
            progress.event(Event::Step { done: step, note });
            if step % config.validate_every == 0 || step == stage.steps {
                let averaged = average.apply(network.valid());
                let scores = validate(&averaged, held, config, &model, stage, device)?;
                log.scores(index, step, &scores)?;
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

/// `log.jsonl`: one line per ten steps and per validation.
struct Log {
    file: std::fs::File,
    path: PathBuf,
    started: Instant,
    samples: u64,
    mean: f32,
}

impl Log {
    fn open(config: &TrainConfig) -> Result<Self> {
        let path = config.output.join("log.jsonl");
        let file = std::fs::OpenOptions::new()
            .create(true)
            .append(true)
            .open(&path);
        let file = file.map_err(|e| lumi_core::Error::io(&path, e))?;
        Ok(Self {
            file,
            path,
            started: Instant::now(),
            samples: 0,
            mean: 0.0,
        })
    }

    /// Samples per second since the run began or resumed.
    fn throughput(&self) -> f64 {
        self.samples as f64 / self.started.elapsed().as_secs_f64().max(1e-9)
    }

    fn step(
        &mut self,
        stage: usize,
        step: u64,
        loss: f32,
        norm: f64,
        rate: f64,
        samples: usize,
    ) -> Result<()> {
        self.samples += samples as u64;
        self.mean = if self.mean == 0.0 {
            loss
        } else {
            0.98 * self.mean + 0.02 * loss
        };
        if !step.is_multiple_of(10) {
            return Ok(());
        }
        let line = json!({
            "stage": stage, "step": step, "loss": self.mean, "grad_norm": norm,
            "learning_rate": rate, "samples_per_second": self.throughput(),
        });
        self.write(&line)
    }

    fn scores(&mut self, stage: usize, step: u64, scores: &Scores) -> Result<()> {
        self.write(&json!({"stage": stage, "step": step, "validation": scores}))
    }

    fn write(&mut self, line: &serde_json::Value) -> Result<()> {
        writeln!(self.file, "{line}").map_err(|e| lumi_core::Error::io(&self.path, e).into())
    }
}
