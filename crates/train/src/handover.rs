//! From an MLP head to a DPT head, without losing what the model can do.
//!
//! The weights that `init` names have an MLP head; the config's model has a DPT head, whose layers are behind gates that
//! open one after the other (as the authors do it: the deepest first, a thousand steps each). Both heads' logits are added, the MLP's as
//! far as the gate of the deepest layer is still closed. No head has biases, so with all gates closed the picture is the
//! MLP's, and with all of them open it is the DPT head's alone. The MLP learns nothing and is then gone.

use crate::config::HandoverConfig;
use burn::module::Module;
use burn::tensor::Tensor;
use burn::tensor::activation::sigmoid;
use lumi_model::config::HeadConfig;
use lumi_model::head::{Head, HeadInput};
use lumi_model::{Error, ModelConfig, Network, Result};
use std::path::Path;

/// What there is to hand over at one step.
pub struct Handover<'a> {
    from: &'a Head,
    gates: Vec<f32>,
}

impl<'a> Handover<'a> {
    /// From the head `from`, as far as the schedule has come at `step`; nothing where there is no schedule.
    #[must_use]
    pub fn at(
        step: u64,
        schedule: Option<&HandoverConfig>,
        from: Option<&'a Head>,
    ) -> Option<Self> {
        Some(Self {
            gates: schedule?.gates(step),
            from: from?,
        })
    }

    /// The picture that both heads make together.
    ///
    /// # Shapes
    /// tokens of `m` views → `[m, 3, h, w]`, display-encoded RGB in (0, 1)
    #[must_use]
    pub fn picture(&self, to: &Head, input: &HeadInput, patch: usize) -> Tensor<4> {
        let open = self.gates.last().copied().unwrap_or(1.0);
        let new = to.logits(input, patch, &self.gates);
        if open == 1.0 {
            return sigmoid(new);
        }
        sigmoid(self.from.logits(input, patch, &[]) * (1.0 - open) + new)
    }
}

/// Gives a network with an MLP head the (`fresh`) head of `model`. Returns it, its config now, and the old head.
///
/// # Errors
/// If `found` has no MLP head, `model` has one, or their patches differ.
pub fn exchange(
    mut network: Network,
    found: &ModelConfig,
    model: &ModelConfig,
    fresh: Head,
    path: &Path,
) -> Result<(Network, ModelConfig, Head)> {
    let wrong = |expected: &str| Err(Error::weights(path, "(metadata)", expected));
    if found.head != HeadConfig::Mlp {
        return wrong("expected weights with an MLP head, to hand over from");
    }
    if model.head == HeadConfig::Mlp {
        return wrong("expected a model with a DPT head in the config, to hand over to");
    }
    if found.patch != model.patch {
        return wrong("expected the patch of the config's model, to hand over");
    }
    let old = std::mem::replace(&mut network.head, fresh).no_grad();
    let found = ModelConfig {
        head: model.head.clone(),
        ..found.clone()
    };
    Ok((network, found, old))
}
