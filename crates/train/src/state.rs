//! Everything a run needs to go on as if it had never stopped, in one folder that is complete or absent.

use crate::Result;
use crate::config::{StageConfig, TrainConfig};
use crate::optim::{Average, optimizer};
use burn::module::Module;
use burn::optim::ModuleOptimizer;
use burn::store::ModuleRecord;
use lumi_model::checkpoint::{self, Provenance, Storage};
use lumi_model::{Error, ModelConfig, Network};
use serde::{Deserialize, Serialize};
use std::fs::File;
use std::path::{Path, PathBuf};

/// Where a run stands.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Progressed {
    /// Current stage.
    pub stage: usize,
    /// Finished steps of that stage.
    pub step: u64,
    /// Updates of the averaged weights.
    pub updates: u64,
    /// The run's config, so that a resumed run cannot silently be another one.
    pub config: TrainConfig,
}

/// Keeps others from working in a run's folder, as long as it lives: two runs would save over each other.
///
/// # Errors
/// If another one does.
pub fn alone(output: &Path) -> Result<File> {
    lumi_core::fs::alone(output)?.ok_or_else(|| {
        let expected = "expected a folder that no other `lumi train` works in; one does now";
        lumi_core::Error::invalid(output, "output", expected).into()
    })
}

/// Folder of the newest complete state below `output`, or of the one `age` saves before it.
fn folder(output: &Path, age: u64) -> PathBuf {
    output.join(if age == 0 {
        "state".into()
    } else {
        format!("state.{age}")
    })
}

fn failed(path: &Path, error: &dyn std::fmt::Display) -> Error {
    lumi_core::Error::invalid(path, "state", error.to_string()).into()
}

/// Writes the state, first into a sibling folder, which then becomes the newest; the oldest of `keep` states goes.
///
/// # Errors
/// If something cannot be written; the old state stays.
pub fn save(
    output: &Path,
    model: &ModelConfig,
    network: &Network,
    optimizer: &ModuleOptimizer,
    average: &Average,
    progressed: &Progressed,
) -> Result<()> {
    let io = |path: &Path, e| lumi_core::Error::io(path, e);
    let rename = |from: &Path, to: &Path| std::fs::rename(from, to).map_err(|e| io(from, e));
    let (new, current) = (output.join("state.new"), folder(output, 0));
    remove(&new)?;
    std::fs::create_dir_all(&new).map_err(|e| io(&new, e))?;
    network
        .clone()
        .into_record()
        .save(new.join("model.bpk"))
        .map_err(|e| failed(&new, &e))?;
    optimizer
        .save(new.join("optimizer.bpk"))
        .map_err(|e| failed(&new, &e))?;
    let none = Provenance::default();
    let path = new.join("average.safetensors");
    checkpoint::write(&path, average.lazy(), model, &none, Storage::F32)?;
    let text = serde_json::to_string_pretty(progressed).map_err(|e| failed(&new, &e))?;
    lumi_core::fs::atomic_write(new.join("progress.json"), text.as_bytes())?;
    // From the oldest: whenever a kill interrupts this, `progressed` finds the newest state.
    let keep = progressed.config.keep;
    remove(&folder(output, keep))?;
    for age in (0..keep).rev() {
        let from = folder(output, age);
        if from.exists() {
            rename(&from, &folder(output, age + 1))?;
        }
    }
    rename(&new, &current)?;
    remove(&folder(output, keep))
}

fn remove(folder: &Path) -> Result<()> {
    if folder.exists() {
        std::fs::remove_dir_all(folder).map_err(|e| lumi_core::Error::io(folder, e))?;
    }
    Ok(())
}

/// Reads where a run stands; `None` if there is no state to resume from.
///
/// # Errors
/// If the state is of another config or unreadable.
pub fn progressed(config: &TrainConfig) -> Result<Option<Progressed>> {
    // A kill between the last two renames of `save` leaves the state with the name of the one before it.
    let (current, old) = (folder(&config.output, 0), folder(&config.output, 1));
    if !current.exists() && old.exists() {
        std::fs::rename(&old, &current).map_err(|e| lumi_core::Error::io(&old, e))?;
    }
    let path = current.join("progress.json");
    if !path.exists() {
        return Ok(None);
    }
    let text = std::fs::read_to_string(&path).map_err(|e| lumi_core::Error::io(&path, e))?;
    let found: Progressed = serde_json::from_str(&text).map_err(|e| failed(&path, &e))?;
    // Stages may be lengthened, rates changed and folders moved; what the weights and batches are made of may not change.
    let same = |f: &dyn Fn(&TrainConfig) -> String| f(&found.config) == f(config);
    let checks: [(&str, bool); 6] = [
        (
            "model",
            found.config.model_config()? == config.model_config()?,
        ),
        ("seed", same(&|c| c.seed.to_string())),
        ("batch", same(&|c| c.batch.to_string())),
        ("accumulate", found.config.accumulate == config.accumulate),
        ("holdout", found.config.holdout == config.holdout),
        ("optimizer", found.config.optimizer == config.optimizer),
    ];
    if let Some((field, _)) = checks.iter().find(|(_, same)| !same) {
        let expected = "expected the value that the run in this folder was begun with";
        return Err(lumi_core::Error::invalid(&path, format!("config.{field}"), expected).into());
    }
    let begun = found.config.stages.iter().take(found.stage + 1);
    for (i, begun) in begun.enumerate() {
        let now = config.stages.get(i);
        if now.is_none_or(|now| paced_as(begun, now) != *now) {
            let expected = "expected the stage that the run in this folder was begun with, but for its steps and rates";
            let field = format!("config.stages[{i}]");
            return Err(lumi_core::Error::invalid(&path, field, expected).into());
        }
    }
    Ok(Some(found))
}

/// The stage with the steps and learning rates of another.
fn paced_as(stage: &StageConfig, other: &StageConfig) -> StageConfig {
    StageConfig {
        steps: other.steps,
        learning_rate: other.learning_rate,
        backbone_rate: other.backbone_rate,
        editor_rate: other.editor_rate,
        warmup: other.warmup,
        final_fraction: other.final_fraction,
        ..stage.clone()
    }
}

/// Loads weights, optimiser and, where they are wanted, averages of the saved state.
///
/// # Errors
/// If a file is missing or does not fit.
pub fn load(
    config: &TrainConfig,
    model: &ModelConfig,
    network: Network,
    average: Option<&mut Average>,
    progressed: &Progressed,
) -> Result<(Network, ModuleOptimizer)> {
    let current = folder(&config.output, 0);
    let record = ModuleRecord::load(current.join("model.bpk")).map_err(|e| failed(&current, &e))?;
    let network = network
        .try_load_record(record)
        .map_err(|e| failed(&current, &e))?;
    // Made for the loaded network: its parameters carry the saved ids, which groups and states go by.
    let optimizer = optimizer(&config.optimizer, &network)
        .load(current.join("optimizer.bpk"))
        .map_err(|e| failed(&current, &e))?;
    let Some(average) = average else {
        return Ok((network, optimizer));
    };
    let device = network.latents.device().inner();
    let (averaged, found, _) = checkpoint::load(&current.join("average.safetensors"), &device)?;
    if found != *model {
        return Err(failed(
            &current,
            &"the averaged weights are of another model",
        ));
    }
    average.tensors = lumi_model::params::export(&averaged);
    average.updates = progressed.updates;
    Ok((network, optimizer))
}
