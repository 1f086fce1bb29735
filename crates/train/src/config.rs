//! A training run as a TOML file; unknown keys are rejected.

mod stage;

pub use stage::{HandoverConfig, Parts, StageConfig, StageKind};

use crate::Result;
use lumi_eval::Net;
use lumi_model::{Error, ModelConfig, import};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// A whole run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TrainConfig {
    /// Preset name, or a path to a model config.
    pub model: String,
    /// Training stores (`lumi dataset generate`): Zarr groups or safetensors files, see `lumi_data::store`.
    pub data: Data,
    /// Folder for state, logs and weights.
    pub output: PathBuf,
    /// Seed of everything random.
    #[serde(default)]
    pub seed: u64,
    /// Weights file to start from instead of random weights. Its model must be the same, but for smaller patches (see
    /// [`lumi_model::resize`]), another resolution and other edit modes.
    #[serde(default)]
    pub init: Option<PathBuf>,
    /// Samples per step and accumulated batch, over all workers.
    pub batch: usize,
    /// Batches whose mean gradient makes one step.
    #[serde(default = "one")]
    pub accumulate: u64,
    /// Saved states that are kept, the newest first in `state`, then `state.1` and so on.
    #[serde(default = "one")]
    pub keep: u64,
    /// Matrix operands in bf16 instead of f32 where our kernels run.
    #[serde(default)]
    pub bf16: bool,
    /// Keep only the blocks' inputs for the backward pass and compute the rest again: less memory for more time.
    #[serde(default)]
    pub recompute: bool,
    /// Decay of the averaged weights per step, after a warm-up.
    #[serde(default = "default_ema")]
    pub ema: f32,
    /// Steps between validations, which also save the state.
    #[serde(default = "default_every")]
    pub validate_every: u64,
    /// Of every this many objects the last one is held out for validation.
    #[serde(default = "default_holdout")]
    pub holdout: usize,
    /// Threads of each worker that make batches ahead of time.
    #[serde(default = "default_loaders")]
    pub loaders: usize,
    /// MiB of pictures that each worker keeps in memory once they are read; the others are read again when they are needed.
    #[serde(default = "default_cache")]
    pub cache_mib: usize,
    /// The network behind stages' `lpips`.
    #[serde(default)]
    pub perceptual: PerceptualConfig,
    /// The optimiser.
    #[serde(default)]
    pub optimizer: OptimizerConfig,
    /// Stages, one after the other.
    pub stages: Vec<StageConfig>,
}

fn one() -> u64 {
    1
}

/// Where samples come from: one store, or several with shares.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum Data {
    /// `data = "FOLDER"`
    One(PathBuf),
    /// `data = [{ store = "FOLDER", share = 0.8 }, …]`
    Several(Vec<StoreShare>),
}

/// A store and how many samples come from it, in proportion to the others' shares.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StoreShare {
    /// Its folder.
    pub store: PathBuf,
    /// More than 0.
    pub share: f32,
}

impl Data {
    /// The stores and their shares.
    #[must_use]
    pub fn stores(&self) -> Vec<(&Path, f32)> {
        match self {
            Self::One(store) => vec![(store, 1.0)],
            Self::Several(stores) => stores.iter().map(|s| (&*s.store, s.share)).collect(),
        }
    }
}

impl<P: Into<PathBuf>> From<P> for Data {
    fn from(store: P) -> Self {
        Self::One(store.into())
    }
}

fn default_ema() -> f32 {
    0.999
}

fn default_every() -> u64 {
    500
}

fn default_holdout() -> usize {
    50
}

fn default_loaders() -> usize {
    1
}

fn default_cache() -> usize {
    4096
}

/// LPIPS as a loss.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PerceptualConfig {
    /// Whose features are compared.
    pub net: Net,
    /// VGG16's weights; without a path they are looked for as `lumi eval` does. AlexNet's are part of the program.
    pub weights: Option<PathBuf>,
}

impl Default for PerceptualConfig {
    fn default() -> Self {
        Self {
            net: Net::Vgg,
            weights: None,
        }
    }
}

/// Which optimiser the matrices of the transformer blocks take; everything else takes AdamW.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum OptimizerKind {
    /// AdamW as well.
    #[default]
    Adamw,
    /// Muon: orthogonalised momentum, with updates of AdamW's size.
    Muon,
}

/// The optimiser: decoupled weight decay, global-norm clipping.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct OptimizerConfig {
    /// For the matrices of the blocks.
    pub kind: OptimizerKind,
    /// Decay of the first moment.
    pub beta1: f32,
    /// Decay of the second moment.
    pub beta2: f32,
    /// Added to the root of the second moment.
    pub epsilon: f32,
    /// Decoupled weight decay.
    pub weight_decay: f32,
    /// Largest global norm of the gradient.
    pub clip: f32,
}

impl Default for OptimizerConfig {
    fn default() -> Self {
        let kind = OptimizerKind::Adamw;
        Self {
            kind,
            beta1: 0.9,
            beta2: 0.98,
            epsilon: 1e-8,
            weight_decay: 0.02,
            clip: 1.0,
        }
    }
}

impl TrainConfig {
    /// Reads and checks a config; relative paths in it are relative to the working folder.
    ///
    /// # Errors
    /// On unreadable files, unknown or missing keys, and values out of range.
    pub fn read(path: &Path) -> Result<Self> {
        let text = std::fs::read_to_string(path).map_err(|e| lumi_core::Error::io(path, e))?;
        let source = path.display().to_string();
        let config: Self =
            toml::from_str(&text).map_err(|e| Error::config(&source, "(file)", e.to_string()))?;
        config.validate(&source)?;
        Ok(config)
    }

    /// The model's config.
    ///
    /// # Errors
    /// If it is neither a preset nor a readable config.
    pub fn model_config(&self) -> Result<ModelConfig> {
        import::config_or_preset(&self.model)
    }

    fn validate(&self, source: &str) -> Result<()> {
        let error = |field: String, expected: &str| Err(Error::config(source, field, expected));
        if self.batch == 0 || self.batch > 4096 {
            return error("batch".into(), "expected 1 to 4096");
        }
        for (field, value) in [("accumulate", self.accumulate), ("keep", self.keep)] {
            if value == 0 || value > 4096 {
                return error(field.into(), "expected 1 to 4096");
            }
        }
        if self.loaders == 0 || self.loaders > 256 {
            return error("loaders".into(), "expected 1 to 256");
        }
        if !(0.0..1.0).contains(&self.ema) {
            return error("ema".into(), "expected a decay in [0, 1)");
        }
        let o = &self.optimizer;
        for (field, beta) in [("beta1", o.beta1), ("beta2", o.beta2)] {
            if !(0.0..1.0).contains(&beta) {
                return error(format!("optimizer.{field}"), "expected a decay in [0, 1)");
            }
        }
        for (field, value) in [("epsilon", o.epsilon), ("clip", o.clip)] {
            if !(value > 0.0 && value.is_finite()) {
                return error(format!("optimizer.{field}"), "expected a positive number");
            }
        }
        if !(o.weight_decay >= 0.0 && o.weight_decay.is_finite()) {
            let expected = "expected a number that is not negative";
            return error("optimizer.weight_decay".into(), expected);
        }
        if self.holdout < 2 {
            return error("holdout".into(), "expected at least 2");
        }
        if self.validate_every == 0 {
            return error("validate_every".into(), "expected at least 1");
        }
        let stores = self.data.stores();
        let fits = |share: f32| share > 0.0 && share.is_finite();
        if stores.is_empty() || !stores.iter().all(|(_, share)| fits(*share)) {
            return error("data".into(), "expected at least one store, with shares over 0");
        }
        if self.stages.is_empty() {
            return error("stages".into(), "expected at least one stage");
        }
        for (i, stage) in self.stages.iter().enumerate() {
            if let Err((field, expected)) = stage.validate() {
                return error(format!("stages[{i}].{field}"), expected);
            }
            if stage.handover.is_some() && (i > 0 || self.init.is_none()) {
                let expected = "expected it in the first stage only, with `init`";
                return error(format!("stages[{i}].handover"), expected);
            }
        }
        Ok(())
    }
}
