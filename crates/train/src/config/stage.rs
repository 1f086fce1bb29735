//! One stage of a run.

use crate::Result;
use lumi_model::network::Part;
use lumi_model::{Mode, ModelConfig};
use serde::{Deserialize, Serialize};

/// Which parts of a network learn.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Parts {
    /// Latents, image tokenizer, encoder.
    pub encoder: bool,
    /// Light tokenizers, editor.
    pub editor: bool,
    /// Ray tokenizer, decoder.
    pub decoder: bool,
    /// Head.
    pub head: bool,
    /// Albedo head, where the model has one.
    pub albedo: bool,
}

impl Parts {
    /// All of them.
    pub const ALL: Self = Self {
        encoder: true,
        editor: true,
        decoder: true,
        head: true,
        albedo: true,
    };

    /// Whether `part` learns.
    #[must_use]
    pub fn train(self, part: Part) -> bool {
        match part {
            Part::Encoder => self.encoder,
            Part::Editor => self.editor,
            Part::Decoder => self.decoder,
            Part::Head => self.head,
            Part::Albedo => self.albedo,
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
    /// Pixels that each picture is moved by at most, each way, with its principal point: with half a patch or more, the
    /// network learns no one place of its patches, which `overlap` wants of it. White comes in from outside, so it suits
    /// objects that stay inside their pictures.
    #[serde(default)]
    pub shift: usize,
    /// Leaves the encoder as it is (a row of the paper's ablation); `relight` and `joint` stages.
    #[serde(default)]
    pub freeze_encoder: bool,
    /// Trains the head alone.
    #[serde(default)]
    pub head_only: bool,
    /// Factor on the learning rate of everything but the head.
    #[serde(default = "unchanged")]
    pub backbone_rate: f64,
    /// Further factor on the learning rate of the editor and the light tokenizers: where the others come trained, these
    /// begin from nothing.
    #[serde(default = "unchanged")]
    pub editor_rate: f64,
    /// Hands over from the MLP head of the weights that `init` names to the DPT head of the config's model; first stage
    /// only.
    #[serde(default)]
    pub handover: Option<HandoverConfig>,
    /// Weight of the reconstruction under the light of the inputs beside the mean of the edits: 1, or 0.5 in `relight` stages,
    /// if absent. The paper's relight stage has none of it (0), and with 0 nothing is decoded for it.
    #[serde(default)]
    pub reconstruction: Option<f64>,
    /// Whether samples show more than was rendered (docs/decisions/0063-more-than-was-rendered.md): worlds turned, mirrored
    /// and with colours exchanged, environments mixed, lights tinted. The paper has none of it.
    #[serde(default = "yes")]
    pub augment: bool,
    /// Weight of the albedo head's mean squared error, for models with `albedo` (a row of the paper's ablation).
    #[serde(default)]
    pub albedo: f64,
    /// Weight of LPIPS beside the squared error of each picture (paper: 0.9).
    #[serde(default)]
    pub lpips: f64,
    /// Share of the squared error after edits that is taken after one scale per sample and channel: how bright and how tinted
    /// an object is cannot be told from photographs under unknown light, and is not to drown what can.
    #[serde(default)]
    pub aligned: f64,
    /// Weight of lighting invariance: the mean squared difference between the scene tokens of the same views under two
    /// lightings (paper §3.4, 0.1 there).
    #[serde(default)]
    pub invariance: f64,
    /// Weight of consistency: how far scene tokens after a `set` that follows other edits are from those of the same `set` made to
    /// the captured ones, after taking a light away again from those before it was added, and after adding and taking away from
    /// those after one `set` of what is on then; mean squared difference over the mean square. The paper has none of it.
    #[serde(default)]
    pub consistency: f64,
    /// Weight of additivity: the mean squared difference between pictures after a light was added and the sum of the model's own
    /// pictures before it and under that light alone, which have nothing to learn from it. The paper has none of it.
    #[serde(default)]
    pub additivity: f64,
    /// Most edits that, in half of the batches, go before the chain: a `set` each, neither shown nor learnt through, so that the
    /// editor learns to go on from where long chains have led it. The paper has none of it.
    #[serde(default)]
    pub wander: usize,
    /// Fewest and most edits in a chain (ignored by reconstruction); batches of 0 edits are reconstruction alone, in `joint`
    /// stages.
    #[serde(default = "default_chain")]
    pub chain: [usize; 2],
    /// Training resolution in pixels; the model's own if absent.
    #[serde(default)]
    pub resolution: Option<usize>,
}

/// When the layers of a DPT head open; see [`crate::handover`].
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct HandoverConfig {
    /// Step at which each layer of the head begins to open, in the order of the model's `head.layers`; the MLP head goes
    /// as the last of them comes.
    pub starts: Vec<u64>,
    /// Steps that it takes.
    pub ramp: u64,
}

impl HandoverConfig {
    /// How far each layer is open at a step, 0 to 1.
    #[must_use]
    pub fn gates(&self, step: u64) -> Vec<f32> {
        let open = |start: &u64| {
            let gone = step.saturating_sub(*start) as f64;
            (gone / self.ramp.max(1) as f64).min(1.0) as f32
        };
        self.starts.iter().map(open).collect()
    }

    /// The step at which all layers are open.
    #[must_use]
    pub fn end(&self) -> u64 {
        let last = self.starts.iter().max().copied().unwrap_or_default();
        last.saturating_add(self.ramp)
    }
}

fn yes() -> bool {
    true
}

fn unchanged() -> f64 {
    1.0
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
        let decoder = self.kind != StageKind::Relight;
        Parts {
            encoder: !self.head_only && !self.freeze_encoder,
            editor: !self.head_only && self.kind != StageKind::Reconstruction,
            decoder: !self.head_only && decoder,
            head: decoder,
            albedo: self.albedo > 0.0,
        }
    }

    /// Weight of the reconstruction in the loss.
    #[must_use]
    pub fn reconstruction(&self) -> f64 {
        let usual = match self.kind {
            StageKind::Relight => 0.5,
            StageKind::Reconstruction | StageKind::Joint => 1.0,
        };
        self.reconstruction.unwrap_or(usual)
    }

    /// Whether a batch with so many edits wants pictures under the light of the inputs, too.
    #[must_use]
    pub fn reconstructs(&self, edits: usize) -> bool {
        edits == 0 || self.reconstruction() > 0.0
    }

    /// Learning rate at `step` of this stage.
    #[must_use]
    pub fn rate(&self, step: u64) -> f64 {
        let warm = ((step + 1) as f64 / self.warmup.max(1) as f64).min(1.0);
        let progress = step as f64 / self.steps.max(1) as f64;
        let cosine = 0.5 * (1.0 + (std::f64::consts::PI * progress.min(1.0)).cos());
        self.learning_rate * warm * (self.final_fraction + (1.0 - self.final_fraction) * cosine)
    }

    /// Checks values by themselves; an error is a field and what was expected.
    pub(super) fn validate(&self) -> std::result::Result<(), (&'static str, &'static str)> {
        let [least, most] = self.inputs;
        if least == 0 || least > most || most > 32 {
            return Err(("inputs", "expected [least, most] within 1 to 32"));
        }
        if !(0.0..=1.0).contains(&self.input_targets) {
            return Err(("input_targets", "expected a share in [0, 1]"));
        }
        if !(0.0..=1.0).contains(&self.aligned) {
            return Err(("aligned", "expected a share in [0, 1]"));
        }
        if self.targets == 0 {
            return Err(("targets", "expected at least 1"));
        }
        let [least, most] = self.chain;
        if least > most || most == 0 || most > 64 {
            return Err((
                "chain",
                "expected [least, most] within 0 to 64, some edits at most",
            ));
        }
        if least == 0 && self.kind == StageKind::Relight {
            let expected = "expected 1 edit at least, since `relight` stages train edits alone";
            return Err(("chain", expected));
        }
        if self.wander > 64 {
            return Err(("wander", "expected 0 to 64"));
        }
        if self.head_only && self.kind == StageKind::Relight {
            let expected = "expected false, since `relight` stages freeze the head";
            return Err(("head_only", expected));
        }
        if self.freeze_encoder && self.kind == StageKind::Reconstruction {
            let expected = "expected false, since `reconstruction` stages train the encoder";
            return Err(("freeze_encoder", expected));
        }
        if !(0.0..=1.0).contains(&self.final_fraction) {
            return Err(("final_fraction", "expected a share in [0, 1]"));
        }
        if let Some(handover) = &self.handover
            && (handover.ramp == 0 || handover.end() > self.steps)
        {
            let expected = "expected every layer to be open before the stage ends";
            return Err(("handover", expected));
        }
        for (name, value) in [
            ("reconstruction", self.reconstruction()),
            ("invariance", self.invariance),
            ("consistency", self.consistency),
            ("additivity", self.additivity),
            ("lpips", self.lpips),
            ("albedo", self.albedo),
            ("backbone_rate", self.backbone_rate),
            ("editor_rate", self.editor_rate),
        ] {
            if !(value >= 0.0 && value.is_finite()) {
                return Err((name, "expected a number that is not negative"));
            }
        }
        if !(self.learning_rate > 0.0 && self.learning_rate.is_finite()) {
            return Err(("learning_rate", "expected a positive number"));
        }
        Ok(())
    }

    /// The side of its images in pixels.
    #[must_use]
    pub fn resolution(&self, model: &ModelConfig) -> usize {
        self.resolution.unwrap_or(model.resolution)
    }

    /// Checks that it suits a model; `index` is its number in errors.
    ///
    /// # Errors
    /// Names the field and what was expected.
    pub fn fits(&self, index: usize, model: &ModelConfig) -> Result<()> {
        let error = |name: &str, expected: String| {
            Err(lumi_core::Error::value(format!("stages[{index}].{name}"), expected).into())
        };
        if !self.resolution(model).is_multiple_of(model.patch) {
            let expected = format!("expected a multiple of the model's patch, {}", model.patch);
            return error("resolution", expected);
        }
        if self.kind != StageKind::Reconstruction && !model.lights.modes().contains(&Mode::Set) {
            let expected =
                "expected `reconstruction`, or a model whose `lights.modes` have \"set\"";
            return error("kind", expected.into());
        }
        if self.shift > model.patch {
            let expected = format!("expected at most the model's patch, {}", model.patch);
            return error("shift", expected);
        }
        let layers = model.head.layers();
        if let Some(handover) = &self.handover
            && (layers.is_empty() || handover.starts.len() != layers.len())
        {
            let expected = format!("expected one step for each of the head's layers {layers:?}");
            return error("handover.starts", expected);
        }
        if self.albedo > 0.0 && !model.albedo {
            return error(
                "albedo",
                "expected 0, or a model with `albedo = true`".into(),
            );
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gates_open_one_after_the_other() {
        let handover = HandoverConfig {
            starts: vec![3000, 2000, 1000, 0],
            ramp: 1000,
        };
        assert_eq!(handover.gates(0), [0.0; 4]);
        assert_eq!(handover.gates(500), [0.0, 0.0, 0.0, 0.5]);
        assert_eq!(handover.gates(2250), [0.0, 0.25, 1.0, 1.0]);
        assert_eq!(handover.end(), 4000);
        assert_eq!(handover.gates(4000), [1.0; 4]);
    }
}
