//! What a run begins with: where it stands, its network, and data that suits its stages.

use crate::Result;
use crate::config::{StageConfig, TrainConfig};
use crate::handover;
use crate::loader::Objects;
use crate::object::Object;
use crate::reduce::{Reduce, agree, meet};
use crate::state::{self, Progressed};
use burn::tensor::Device;
use lumi_core::Seed;
use lumi_kernels::{Precision, Save};
use lumi_model::head::Head;
use lumi_model::resize::resized;
use lumi_model::{ModelConfig, Network, checkpoint};
use std::fs::File;

/// Where the run begins, the same for all workers, `None` at the beginning; and what keeps others out of its folder, which the
/// first worker has.
pub(crate) fn start(
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
pub(crate) fn network(
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

/// What can only be checked with the data at hand.
pub(crate) fn check_data<'a>(
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

/// The names of objects, as workers compare them.
pub(crate) fn names(objects: &Objects) -> String {
    let names = objects.iter().map(|object| object.name());
    names.collect::<Vec<_>>().join("\n")
}
