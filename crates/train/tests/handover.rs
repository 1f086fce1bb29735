//! A DPT head takes over from an MLP head.
#![allow(clippy::unwrap_used)]

mod common;

use burn::tensor::{Device, Distribution, Tensor};
use common::write_objects;
use lumi_core::Seed;
use lumi_model::checkpoint::{self, Provenance, Storage};
use lumi_model::config::HeadConfig;
use lumi_model::network::Part;
use lumi_model::network::Scene;
use lumi_model::{ModelConfig, Network, params};
use lumi_train::TrainConfig;
use lumi_train::config::HandoverConfig;
use lumi_train::handover::{Handover, exchange};
use lumi_train::reduce::Solo;
use std::path::Path;

/// `nano`, which has an MLP head, with another head.
fn models() -> [ModelConfig; 3] {
    let mlp = ModelConfig::preset("nano").unwrap();
    assert_eq!(mlp.head, HeadConfig::Mlp);
    let (features, layers) = (8, vec![1, 2]);
    let dpt = HeadConfig::Dpt {
        features,
        layers: layers.clone(),
    };
    let pyramid = HeadConfig::DptPyramid { features, layers };
    let with = |head| ModelConfig {
        head,
        ..mlp.clone()
    };
    [with(dpt), with(pyramid), mlp]
}

#[test]
fn closed_gates_leave_the_mlps_picture_and_open_ones_the_dpts() {
    let device = Device::flex();
    let [dpt, pyramid, mlp] = models();
    for model in [dpt, pyramid] {
        let old = Network::new(&mlp, Seed(1), &device);
        let (r, c) = (model.resolution, model.rays.channels());
        let normal = Distribution::Normal(0.0, 1.0);
        let scene = Scene {
            channels: Tensor::random([1, model.scene_tokens, model.dim], normal, &device),
            places: None,
        };
        let rays = Tensor::<5>::random([1, 2, c, r, r], normal, &device);
        let expected = params::to_vec(old.decode(&scene, rays.clone(), &[], &mlp));

        let fresh = Network::new(&model, Seed(2), &device).head;
        let (network, now, old_head) =
            exchange(old, &mlp, &model, fresh, Path::new("weights")).unwrap();
        assert_eq!(now, model);
        let schedule = HandoverConfig {
            starts: vec![10, 0],
            ramp: 10,
        };
        let picture = |step| {
            let input = network.decoder_tokens(&scene, rays.clone(), &[], &model);
            let handover = Handover::at(step, Some(&schedule), Some(&old_head)).unwrap();
            params::to_vec(handover.picture(&network.head, &input, model.patch))
        };
        assert_eq!(picture(0), expected);
        let last = params::to_vec(network.decode(&scene, rays.clone(), &[], &model));
        assert_ne!(last, expected);
        for step in [20, 1000] {
            assert_eq!(picture(step), last);
        }
        // On the way the picture moves a little at a time, and the layers come one after the other.
        let far = |a: &[f32], b: &[f32]| {
            let apart = a.iter().zip(b).map(|(a, b)| (a - b).abs());
            apart.fold(0.0, f32::max)
        };
        assert!(far(&picture(1), &expected) < 0.3 * far(&last, &expected));
        assert!(far(&picture(10), &last) > 0.0);
    }
}

#[test]
fn what_cannot_be_handed_over_is_named() {
    let device = Device::flex();
    let [dpt, _, mlp] = models();
    let head = |model: &ModelConfig| Network::new(model, Seed(2), &device).head;
    let fails = |found: &ModelConfig, model: &ModelConfig, part: &str| {
        let network = Network::new(found, Seed(1), &device);
        let error = exchange(network, found, model, head(model), Path::new("w")).unwrap_err();
        assert!(error.to_string().contains(part), "{error}");
    };
    fails(&dpt, &dpt, "with an MLP head");
    fails(&mlp, &mlp, "with a DPT head");
    let mut other = dpt.clone();
    other.patch *= 2;
    fails(&mlp, &other, "patch");
}

#[test]
fn a_run_hands_over_and_trains_the_head_alone() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    write_objects(&folder.join("objects"), false);
    let device = Device::flex();
    let [_, pyramid, mlp] = models();
    let begun = Network::new(&mlp, Seed(5), &device);
    let weights = folder.join("mlp.safetensors");
    let none = Provenance::default();
    checkpoint::save(&weights, &begun, &mlp, &none, Storage::F32).unwrap();
    std::fs::write(
        folder.join("model.toml"),
        toml::to_string(&pyramid).unwrap(),
    )
    .unwrap();
    let text = format!(
        "model = '{0}/model.toml'\ndata = '{0}/objects'\noutput = '{0}/out'\n\
         init = '{0}/mlp.safetensors'\nbatch = 2\nvalidate_every = 3\nholdout = 4\nema = 0.0\n\
         [[stages]]\nkind = 'reconstruction'\nsteps = 6\nlearning_rate = 1e-3\nwarmup = 2\n\
         inputs = [1, 2]\ntargets = 2\nhead_only = true\nhandover = {{ starts = [2, 0], ramp = 3 }}\n",
        folder.display()
    );
    let path = folder.join("train.toml");
    std::fs::write(&path, text).unwrap();
    let config = TrainConfig::read(&path).unwrap();
    lumi_train::train(&config, false, std::slice::from_ref(&device), &Solo, &()).unwrap();
    let average = folder.join("out/state/average.safetensors");
    let (trained, found, _) = checkpoint::load(&average, &device).unwrap();
    assert_eq!(found, pyramid);
    let fresh = params::export(&Network::new(&pyramid, Seed(0), &device).head);
    for (new, fresh) in params::export(&trained.head).iter().zip(fresh) {
        assert_ne!(new.values, fresh.values, "{} did not learn", new.name);
    }
    let old = params::export(&begun);
    for new in params::export(&trained) {
        if Part::of(&new.name) != Part::Head {
            let old = old.iter().find(|old| old.name == new.name).unwrap();
            assert_eq!(new.values, old.values, "{} has changed", new.name);
        }
    }
}
