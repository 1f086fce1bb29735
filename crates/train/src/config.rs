//! A training run as a TOML file; unknown keys are rejected.

use crate::Result;
use lumi_eval::Net;
use lumi_model::network::Part;
use lumi_model::{Error, ModelConfig, import};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// A whole run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TrainConfig {
    /// Preset name, or a path to a model config.
    pub model: String,
    /// Training store (`lumi dataset generate`): Zarr groups or safetensors files, see `lumi_data::store`.
    pub data: PathBuf,
    /// Folder for state, logs and weights.
    pub output: PathBuf,
    /// Seed of everything random.
    #[serde(default)]
    pub seed: u64,
    /// Weights file to start from instead of random weights. Its model must be the same, but for smaller patches (see
    /// [`lumi_model::resize`]), another resolution and other edit modes.
    #[serde(default)]
    pub init: Option<PathBuf>,
    /// Samples per step.
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

fn default_ema() -> f32 {
    0.999
}

fn default_every() -> u64 {
    500
}

fn default_holdout() -> usize {
    50
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

/// Which parts of a network learn.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Parts {
    /// Latents, image tokenizer, encoder.
    pub encoder: bool,
    /// Light tokenizers, editor.
    pub editor: bool,
    /// Ray tokenizer, decoder, head.
    pub decoder: bool,
}

impl Parts {
    /// All of them.
    pub const ALL: Self = Self {
        encoder: true,
        editor: true,
        decoder: true,
    };

    /// Whether `part` learns.
    #[must_use]
    pub fn train(self, part: Part) -> bool {
        match part {
            Part::Encoder => self.encoder,
            Part::Editor => self.editor,
            Part::Decoder => self.decoder,
        }
    }
}

/// What a stage trains.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum StageKind {
    /// Encoder and decoder, to reproduce views under the light of the inputs.
    Reconstruction,
    /// Encoder and editor, decoder frozen: chains of edits in token space with a loss at each step.
    Relight,
    /// Everything at once: reconstruction and chains of edits.
    Joint,
}

/// One stage.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StageConfig {
    /// What it trains.
    pub kind: StageKind,
    /// Optimiser steps.
    pub steps: u64,
    /// Peak learning rate.
    pub learning_rate: f64,
    /// Steps of linear warm-up; a cosine to `final_fraction` of the peak follows.
    #[serde(default = "default_warmup")]
    pub warmup: u64,
    /// Last learning rate as a fraction of the peak.
    #[serde(default = "default_final")]
    pub final_fraction: f64,
    /// Fewest and most input views.
    pub inputs: [usize; 2],
    /// Target views per sample.
    pub targets: usize,
    /// Share of the targets that are input views. Seeing a view that was given is easy, and learning it first
    /// takes the network out of painting an average of all objects.
    #[serde(default)]
    pub input_targets: f32,
    /// Leaves the encoder as it is (a row of the paper's ablation); `relight` and `joint` stages.
    #[serde(default)]
    pub freeze_encoder: bool,
    /// Weight of LPIPS beside the squared error of each picture (paper: 0.9).
    #[serde(default)]
    pub lpips: f64,
    /// Weight of lighting invariance: the mean squared difference between the scene tokens of the same views under two
    /// lightings (paper §3.4, 0.1 there).
    #[serde(default)]
    pub invariance: f64,
    /// Fewest and most edits in a chain (ignored by reconstruction).
    #[serde(default = "default_chain")]
    pub chain: [usize; 2],
    /// Training resolution in pixels; the model's own if absent.
    #[serde(default)]
    pub resolution: Option<usize>,
}

fn default_warmup() -> u64 {
    200
}

fn default_final() -> f64 {
    0.05
}

fn default_chain() -> [usize; 2] {
    [1, 2]
}

impl StageConfig {
    /// The parts of the network that it trains.
    #[must_use]
    pub fn parts(&self) -> Parts {
        Parts {
            encoder: self.kind == StageKind::Reconstruction || !self.freeze_encoder,
            editor: self.kind != StageKind::Reconstruction,
            decoder: self.kind != StageKind::Relight,
        }
    }

    /// Learning rate at `step` of this stage.
    #[must_use]
    pub fn rate(&self, step: u64) -> f64 {
        let warm = ((step + 1) as f64 / self.warmup.max(1) as f64).min(1.0);
        let progress = step as f64 / self.steps.max(1) as f64;
        let cosine = 0.5 * (1.0 + (std::f64::consts::PI * progress.min(1.0)).cos());
        self.learning_rate * warm * (self.final_fraction + (1.0 - self.final_fraction) * cosine)
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
        if !(0.0..1.0).contains(&self.ema) {
            return error("ema".into(), "expected a decay in [0, 1)");
        }
        if self.holdout < 2 {
            return error("holdout".into(), "expected at least 2");
        }
        if self.validate_every == 0 {
            return error("validate_every".into(), "expected at least 1");
        }
        if self.stages.is_empty() {
            return error("stages".into(), "expected at least one stage");
        }
        for (i, stage) in self.stages.iter().enumerate() {
            let field = |name: &str| format!("stages[{i}].{name}");
            let [least, most] = stage.inputs;
            if least == 0 || least > most || most > 32 {
                return error(field("inputs"), "expected [least, most] within 1 to 32");
            }
            if !(0.0..=1.0).contains(&stage.input_targets) {
                return error(field("input_targets"), "expected a share in [0, 1]");
            }
            if stage.targets == 0 {
                return error(field("targets"), "expected at least 1");
            }
            let [least, most] = stage.chain;
            if least == 0 || least > most || most > 64 {
                return error(field("chain"), "expected [least, most] within 1 to 64");
            }
            for (name, weight) in [("invariance", stage.invariance), ("lpips", stage.lpips)] {
                if !(weight >= 0.0 && weight.is_finite()) {
                    return error(field(name), "expected a number that is not negative");
                }
            }
            if !(stage.learning_rate > 0.0 && stage.learning_rate.is_finite()) {
                return error(field("learning_rate"), "expected a positive number");
            }
        }
        Ok(())
    }
}
