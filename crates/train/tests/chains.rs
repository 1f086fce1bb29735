//! Chains of edits: where they begin, and the shorter ways to where they lead.
#![allow(clippy::unwrap_used)]

mod common;

use burn::tensor::Device;
use lumi_core::Seed;
use lumi_model::config::{Mode, Output};
use lumi_model::{ModelConfig, Network};
use lumi_train::TrainConfig;
use lumi_train::loader::{Share, make_batch, open_objects};
use lumi_train::objective::forward;
use lumi_train::sample::EditLights;

#[test]
fn edits_of_known_light_have_a_shorter_way() {
    let folder = tempfile::tempdir().unwrap();
    common::write_objects(&folder.path().join("objects"), false);
    let path = folder.path().join("train.toml");
    let text = format!(
        "model = 'nano'\ndata = '{0}/objects'\noutput = '{0}/run'\nbatch = 2\nholdout = 4\n\
         [[stages]]\nkind = 'joint'\nsteps = 5\nlearning_rate = 1e-3\ninputs = [2, 2]\ntargets = 1\n\
         chain = [1, 2]\nconsistency = 0.1\nadditivity = 1.0\nwander = 2\n",
        folder.path().display()
    );
    std::fs::write(&path, text).unwrap();
    let config = TrainConfig::read(&path).unwrap();
    let nano = ModelConfig::preset("nano").unwrap();
    let model = ModelConfig {
        output: Output::Radiance,
        anchors: true,
        reprojection: true,
        lights: nano.lights.with_modes(&Mode::ALL),
        ..nano
    };
    let device = Device::flex();
    let network = Network::new(&model, Seed(4), &device);
    let (objects, _) = open_objects(&config.data, 16, 4, 1 << 20, &()).unwrap();
    let (mut wandered, mut at_once, mut undone, mut alone) = (0, 0, 0, 0);
    for step in 0..60 {
        let stage = &config.stages[0];
        let share = (step, Share::ALL);
        let batch = make_batch(&objects, &config, &model, stage, Seed(7), share).unwrap();
        wandered += batch.before.len();
        let mut shorter = 0;
        for (i, edit) in batch.edits.iter().enumerate() {
            let earlier = &batch.edits[..i];
            let sets = |e: &lumi_train::batch::BatchEdit| e.kind.mode == Mode::Set;
            let known = !batch.before.is_empty() || earlier.iter().any(sets);
            if known && !sets(edit) {
                at_once += 1;
                assert_eq!(edit.at_once.len(), 2);
                for light in &edit.at_once {
                    // It replaces all light.
                    assert!(matches!(light, EditLights::Shape(shape) if shape.reach == 1.0));
                }
            } else {
                assert!(edit.at_once.is_empty());
            }
            let undoes = earlier.last().is_some_and(|e| edit.kind.undoes(&e.kind));
            undone += usize::from(undoes && !known);
            let later_set = sets(edit) && i + batch.before.len() > 0;
            shorter += usize::from(later_set || (known && !sets(edit)) || undoes);
        }
        let mut sums = 0;
        for (i, edit) in batch.edits.iter().enumerate() {
            let adds = i > 0 && edit.kind.mode == Mode::Add;
            assert_eq!(edit.alone.is_some(), adds);
            if let Some(alone) = &edit.alone {
                sums += 1;
                assert_eq!(alone.shares.len(), 2 * 3);
                assert!(alone.shares.iter().all(|w| (0.0..=1.0).contains(w)));
                // What is told of the edit is the largest of them.
                for (told, own) in edit.lights.iter().zip(alone.shares.chunks(3)) {
                    let most = own.iter().copied().fold(0.0, f32::max);
                    assert!(matches!(told, EditLights::Shape(s) if (s.reach - most).abs() < 1e-5));
                }
            }
        }
        alone += sums;
        // What is written of a batch that went wrong has all of it.
        let written = folder.path().join("batch.safetensors");
        batch.write(&written).unwrap();
        let written = std::fs::read(&written).unwrap();
        let named = |part: &str| {
            let tensors = safetensors::SafeTensors::deserialize(&written).unwrap();
            tensors.names().iter().filter(|n| n.contains(part)).count()
        };
        assert_eq!(named("before"), batch.before.len());
        let known = batch.edits.iter().filter(|e| !e.at_once.is_empty());
        assert_eq!(named("at_once"), known.count());
        let outcome = forward(&network, &model, &batch, None, &device).unwrap();
        assert_eq!(outcome.detours.len(), shorter);
        for apart in outcome.detours {
            assert!(apart.into_scalar::<f32>().is_finite());
        }
        assert_eq!(outcome.sums.len(), sums);
        for apart in outcome.sums {
            assert!(apart.into_scalar::<f32>().is_finite());
        }
    }
    assert!(
        wandered > 20 && at_once > 5 && undone > 0 && alone > 3,
        "{wandered} {at_once} {undone} {alone}"
    );
}
