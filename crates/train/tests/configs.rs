//! The configs that come with the program are good ones.
#![allow(clippy::unwrap_used)]

use lumi_train::TrainConfig;
use std::path::{Path, PathBuf};

fn configs() -> Vec<PathBuf> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../configs");
    let mut all = Vec::new();
    for folder in ["train", "paper-512", "paper-64", "ablation"] {
        let files = std::fs::read_dir(root.join(folder)).unwrap();
        all.extend(files.map(|file| file.unwrap().path()));
    }
    all
}

#[test]
fn training_configs_parse_and_fit_their_models() {
    // Paths in them are relative to the root of the repository.
    std::env::set_current_dir(concat!(env!("CARGO_MANIFEST_DIR"), "/../..")).unwrap();
    let all = configs();
    assert!(all.len() >= 11, "{all:?}");
    for path in all {
        let fails = |e: lumi_model::Error| -> ! { panic!("{}: {e}", path.display()) };
        let config = TrainConfig::read(&path).unwrap_or_else(|e| fails(e));
        let model = config.model_config().unwrap_or_else(|e| fails(e));
        for (i, stage) in config.stages.iter().enumerate() {
            stage.fits(i, &model).unwrap_or_else(|e| fails(e));
        }
    }
}

#[test]
fn misfits_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("train.toml");
    let read = |top: &str, stage: &str| {
        let text = format!(
            "model = 'nano'\ndata = 'd'\noutput = 'o'\nbatch = 1\n{top}\n[[stages]]\nkind = 'joint'\n\
             steps = 10\nlearning_rate = 1e-3\ninputs = [1, 1]\ntargets = 1\n{stage}"
        );
        std::fs::write(&path, text).unwrap();
        let config = TrainConfig::read(&path)?;
        config.stages[0].fits(0, &config.model_config()?)
    };
    let fails = |top: &str, stage: &str, part: &str| {
        let error = read(top, stage).unwrap_err().to_string();
        assert!(error.contains(part), "{error} without {part}");
    };
    read("", "").unwrap();
    fails("loaders = 0", "", "loaders");
    for wrong in ["clip = -1.0", "clip = 0.0", "beta2 = 1.0", "epsilon = nan"] {
        let field = format!("optimizer.{}", wrong.split(' ').next().unwrap());
        fails(&format!("optimizer = {{ {wrong} }}"), "", &field);
    }
    fails("", "final_fraction = 5.0", "stages[0].final_fraction");
    fails("", "albedo = 0.5", "stages[0].albedo");
    fails("", "resolution = 13", "stages[0].resolution");
    fails("", "shift = 99", "stages[0].shift");
    fails("", "backbone_rate = -1.0", "stages[0].backbone_rate");
    fails("", "editor_rate = -1.0", "stages[0].editor_rate");
    let handover = "handover = { starts = [0], ramp = 5 }";
    fails("", handover, "stages[0].handover");
    let frozen = "freeze_encoder = true\n[[stages]]\nkind = 'reconstruction'\nsteps = 1\nlearning_rate = 1e-3\n\
                  inputs = [1, 1]\ntargets = 1\nfreeze_encoder = true";
    fails("", frozen, "stages[1].freeze_encoder");
    // `nano` has no layers to hand over to.
    fails("init = 'w'", handover, "stages[0].handover.starts");
    let late = "handover = { starts = [8], ramp = 5 }";
    fails("init = 'w'", late, "before the stage ends");
}
