//! Several workers learn what one learns from the same samples.
#![allow(clippy::unwrap_used)]

mod common;

use burn::tensor::Device;
use common::write_objects;
use lumi_core::{Event, Progress, Seed};
use lumi_model::checkpoint;
use lumi_model::params::export;
use lumi_train::config::StageKind;
use lumi_train::loader::{Share, make_batch, open_objects};
use lumi_train::reduce::Solo;
use lumi_train::{Finished, TrainConfig};
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};

fn config(folder: &Path, output: &str) -> TrainConfig {
    let text = format!(
        "model = 'nano'\ndata = '{0}/objects'\noutput = '{0}/{output}'\nbatch = 4\naccumulate = 2\n\
         validate_every = 3\nholdout = 4\n\
         [[stages]]\nkind = 'reconstruction'\nsteps = 4\nlearning_rate = 1e-3\nwarmup = 2\n\
         inputs = [1, 2]\ntargets = 2\n\
         [[stages]]\nkind = 'relight'\nsteps = 4\nlearning_rate = 1e-3\nwarmup = 2\n\
         inputs = [1, 2]\ntargets = 2\ninvariance = 0.1\n",
        folder.display()
    );
    let path = folder.join("train.toml");
    std::fs::write(&path, text).unwrap();
    TrainConfig::read(&path).unwrap()
}

fn folder() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    write_objects(&folder.path().join("objects"), false);
    folder
}

/// Largest difference between the saved averages of two runs, and how far the second is from random weights.
fn apart(folder: &Path, one: &str, other: &str) -> (f32, f32) {
    let device = Device::flex();
    let read = |run: &str| {
        let path = folder.join(run).join("state/average.safetensors");
        checkpoint::load(&path, &device).unwrap()
    };
    let ((a, model, _), (b, ..)) = (read(one), read(other));
    let fresh = lumi_model::Network::new(&model, Seed(0), &device);
    let [a, b, fresh] = [a, b, fresh].map(|network| export(&network));
    let most = |x: &[lumi_model::params::NamedTensor], y: &[lumi_model::params::NamedTensor]| {
        let pairs = x
            .iter()
            .zip(y)
            .flat_map(|(x, y)| x.values.iter().zip(&y.values));
        pairs.map(|(x, y)| (x - y).abs()).fold(0.0, f32::max)
    };
    (most(&a, &b), most(&b, &fresh))
}

#[test]
fn workers_split_a_batch_and_nothing_else() {
    let folder = folder();
    let config = config(folder.path(), "out");
    let (objects, _) = open_objects(&config.data, 16, config.holdout, 1 << 20, &()).unwrap();
    let model = config.model_config().unwrap();
    let stage = &config.stages[1];
    for step in 0..5 {
        let share = |rank, workers| {
            let share = Share { rank, workers };
            make_batch(&objects, &config, &model, stage, Seed(3), (step, share)).unwrap()
        };
        let whole = share(0, 1);
        for workers in [2, 4] {
            let parts: Vec<_> = (0..workers).map(|rank| share(rank, workers)).collect();
            assert!(parts.iter().all(|part| part.size == 4 / workers));
            let join = |f: &dyn Fn(&lumi_train::batch::Batch) -> Vec<f32>| -> Vec<f32> {
                parts.iter().flat_map(f).collect()
            };
            assert_eq!(join(&|b| b.posed.clone()), whole.posed);
            assert_eq!(join(&|b| b.other.clone()), whole.other);
            assert_eq!(join(&|b| b.targets.clone()), whole.targets);
            assert_eq!(join(&|b| b.source.clone()), whole.source);
            for (i, edit) in whole.edits.iter().enumerate() {
                assert_eq!(join(&|b| b.edits[i].features()), edit.features());
                assert_eq!(join(&|b| b.edits[i].truth.clone()), edit.truth);
                assert_eq!(join(&|b| b.edits[i].exposures.clone()), edit.exposures);
            }
        }
    }
}

#[test]
fn what_no_loss_asks_for_is_not_in_a_batch() {
    let folder = folder();
    let config = config(folder.path(), "out");
    let (objects, _) = open_objects(&config.data, 16, config.holdout, 1 << 20, &()).unwrap();
    let model = config.model_config().unwrap();
    let mut stage = config.stages[1].clone();
    (stage.kind, stage.chain, stage.reconstruction) = (StageKind::Joint, [0, 2], Some(0.0));
    let mut lengths = [0; 3];
    for step in 0..12 {
        let step = (step, Share::ALL);
        let batch = make_batch(&objects, &config, &model, &stage, Seed(3), step).unwrap();
        lengths[batch.edits.len()] += 1;
        assert_eq!(batch.source.is_empty(), !batch.edits.is_empty());
    }
    assert!(lengths.iter().all(|n| *n > 0), "{lengths:?}");
}

#[test]
fn two_threads_learn_what_one_does() {
    let folder = folder();
    let run = |output: &str, workers: usize, resume| {
        let devices = vec![Device::flex(); workers];
        let config = config(folder.path(), output);
        lumi_train::train(&config, resume, &devices, &Solo, &()).unwrap()
    };
    run("one", 1, false);
    run("two", 2, false);
    let (error, learnt) = apart(folder.path(), "two", "one");
    assert!(learnt > 2e-3, "nothing was learnt: {learnt}");
    assert!(error < 2e-5, "{error} beside {learnt}");
    // Two runs of two workers are the same bit by bit, however the threads were scheduled.
    let first = run("two again", 2, false).weights;
    let bytes = |path: &Path| std::fs::read(path).unwrap();
    assert!(bytes(&first) == bytes(&folder.path().join("two/weights.safetensors")));
}

#[test]
fn a_run_may_go_on_with_more_workers() {
    let folder = folder();
    let run = |output: &str, workers: usize, steps: u64| {
        let devices = vec![Device::flex(); workers];
        let mut config = config(folder.path(), output);
        // The same learning rates, but the run ends earlier.
        config.stages.truncate(1);
        config.stages[0].final_fraction = 1.0;
        config.stages[0].steps = steps;
        lumi_train::train(&config, true, &devices, &Solo, &()).unwrap();
    };
    run("one", 1, 6);
    run("grown", 1, 3);
    run("grown", 4, 6);
    let (error, learnt) = apart(folder.path(), "grown", "one");
    assert!(learnt > 2e-3, "nothing was learnt: {learnt}");
    assert!(error < 2e-5, "{error} beside {learnt}");
}

/// Asks to stop once so many steps are done.
#[derive(Default)]
struct StopAfter {
    steps: u64,
    done: AtomicU64,
}

impl Progress for StopAfter {
    fn event(&self, event: Event) {
        if let Event::Step { note, .. } = event
            && note.contains("loss")
        {
            self.done.fetch_add(1, Ordering::Relaxed);
        }
    }

    fn stop(&self) -> bool {
        self.done.load(Ordering::Relaxed) >= self.steps
    }
}

#[test]
fn a_run_asked_to_stop_loses_no_step() {
    let folder = folder();
    let devices = vec![Device::flex(); 2];
    let whole = config(folder.path(), "whole");
    let weights = |finished: &Finished| std::fs::read(&finished.weights).unwrap();
    let finished = lumi_train::train(&whole, false, &devices, &Solo, &()).unwrap();
    assert_eq!(finished.stopped, None);
    let expected = weights(&finished);

    let mut cut = config(folder.path(), "cut");
    // No save but those of stopping and of a stage's end.
    cut.validate_every = 1000;
    let before = StopAfter::default();
    let finished = lumi_train::train(&cut, true, &devices, &Solo, &before).unwrap();
    assert_eq!(finished.stopped, Some((0, 0)));
    assert!(!finished.weights.exists());

    // One step at a time: in the middle of a stage, at its end, in the next stage.
    let all: u64 = cut.stages.iter().map(|stage| stage.steps).sum();
    for step in 1..all {
        let one = StopAfter {
            steps: 1,
            ..StopAfter::default()
        };
        let finished = lumi_train::train(&cut, true, &devices, &Solo, &one).unwrap();
        let first = cut.stages[0].steps;
        let stands = if step < first {
            (0, step)
        } else {
            (1, step - first)
        };
        assert_eq!(finished.stopped, Some(stands));
        assert!(finished.weights.exists());
    }
    let last = StopAfter {
        steps: 1,
        ..StopAfter::default()
    };
    let finished = lumi_train::train(&cut, true, &devices, &Solo, &last).unwrap();
    assert_eq!(finished.stopped, None, "the end is the end");
    assert!(weights(&finished) == expected, "weights differ");
}

#[test]
fn what_does_not_divide_is_refused() {
    let folder = folder();
    let devices = vec![Device::flex(); 3];
    let config = config(folder.path(), "out");
    let error = lumi_train::train(&config, false, &devices, &Solo, &())
        .unwrap_err()
        .to_string();
    assert!(
        error.contains("batch") && error.contains("3 workers"),
        "{error}"
    );
}
