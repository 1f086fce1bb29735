//! The explicit-albedo row of the ablation.
#![allow(clippy::unwrap_used)]

mod common;

use burn::tensor::Device;
use common::write_objects;
use lumi_core::Seed;
use lumi_model::checkpoint::{self, Provenance, Storage};
use lumi_model::network::Part;
use lumi_model::{ModelConfig, Network, params};
use lumi_train::TrainConfig;
use lumi_train::loader::{Share, make_batch, open_objects};
use lumi_train::objective::{Objective, forward};
use lumi_train::reduce::Solo;
use std::path::Path;

fn config(folder: &Path, weight: f64) -> TrainConfig {
    let mut model = ModelConfig::preset("nano").unwrap();
    model.albedo = true;
    std::fs::write(folder.join("model.toml"), toml::to_string(&model).unwrap()).unwrap();
    let text = format!(
        "model = '{0}/model.toml'\ndata = '{0}/objects'\noutput = '{0}/out'\n\
         init = '{0}/plain.safetensors'\nbatch = 2\nvalidate_every = 5\nholdout = 4\nema = 0.0\n\
         [[stages]]\nkind = 'relight'\nsteps = 5\nlearning_rate = 1e-3\nwarmup = 1\n\
         inputs = [1, 2]\ntargets = 2\nalbedo = {weight}\n",
        folder.display()
    );
    let path = folder.join("train.toml");
    std::fs::write(&path, text).unwrap();
    TrainConfig::read(&path).unwrap()
}

#[test]
fn a_second_head_learns_base_colour_under_any_light() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    write_objects(&folder.join("objects"), true);
    let device = Device::flex();
    // Weights without the head are a fine start.
    let plain = ModelConfig::preset("nano").unwrap();
    let begun = Network::new(&plain, Seed(5), &device);
    let path = folder.join("plain.safetensors");
    checkpoint::save(&path, &begun, &plain, &Provenance::default(), Storage::F32).unwrap();

    let config = config(folder, 0.5);
    let model = config.model_config().unwrap();
    let stage = &config.stages[0];
    let (objects, _) = open_objects(&config.data, 16, 4, 0, &()).unwrap();
    let batch = make_batch(&objects, &config, &model, stage, Seed(1), (0, Share::ALL)).unwrap();
    let network = Network::new(&model, Seed(5), &device);
    let mut outcome = forward(&network, &model, &batch, None, &device).unwrap();
    // Before the first edit and after each; the truth is one and the same.
    assert_eq!(outcome.albedo.len(), 1 + batch.edits.len());
    let truths: Vec<_> = outcome
        .albedo
        .iter()
        .map(|(_, t)| params::to_vec(t.clone()))
        .collect();
    assert!(truths.iter().all(|truth| *truth == batch.albedo));
    assert_ne!(batch.albedo, batch.source);
    let objective = Objective::new(&config, &device).unwrap();
    let loss = |outcome: &_| objective.loss(outcome, stage).unwrap().into_scalar::<f32>();
    let whole = loss(&outcome);
    let count = outcome.albedo.len() as f32;
    let errors = std::mem::take(&mut outcome.albedo);
    let errors: f32 = errors
        .into_iter()
        .map(|(a, b)| (a - b).square().mean().into_scalar::<f32>())
        .sum();
    assert!((whole - loss(&outcome) - 0.5 * errors / count).abs() < 1e-6);

    lumi_train::train(&config, false, std::slice::from_ref(&device), &Solo, &()).unwrap();
    let average = folder.join("out/state/average.safetensors");
    let (trained, ..) = checkpoint::load(&average, &device).unwrap();
    let fresh = Network::new(&model, Seed(0), &device);
    let heads = [&trained, &fresh].map(|n| params::export(n.albedo.as_ref().unwrap()));
    assert_ne!(heads[0], heads[1]);
    // The decoder stays frozen.
    let old = params::export(&begun);
    for new in params::export(&trained) {
        if [Part::Decoder, Part::Head].contains(&Part::of(&new.name)) {
            let old = old.iter().find(|old| old.name == new.name).unwrap();
            assert_eq!(new.values, old.values, "{} has changed", new.name);
        }
    }
}

#[test]
fn records_without_albedo_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    write_objects(&folder.join("objects"), false);
    let mut config = config(folder, 0.5);
    config.init = None;
    let error = lumi_train::train(&config, false, &[Device::flex()], &Solo, &()).unwrap_err();
    let error = error.to_string();
    assert!(
        error.contains("stages[0].albedo") && error.contains("object_"),
        "{error}"
    );
}
