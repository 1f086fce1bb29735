//! A run that was cut off and resumed ends with the very weights of one that was not.
#![allow(clippy::unwrap_used)]

mod common;

use burn::tensor::Device;
use common::write_objects;
use lumi_core::{Event, Progress};
use lumi_train::TrainConfig;
use lumi_train::reduce::Solo;
use std::path::Path;

/// Pulls the plug at a step.
struct Cut(u64);

impl Progress for Cut {
    fn event(&self, event: Event) {
        if let Event::Step { done, note } = event
            && done == self.0
            && note.contains("loss")
        {
            panic!("cut off");
        }
    }
}

fn config(folder: &Path, output: &str, optimizer: &str) -> TrainConfig {
    let text = format!(
        "model = 'nano'\ndata = '{0}/objects'\noutput = '{0}/{output}'\nbatch = 2\nbf16 = false\n\
         validate_every = 3\nholdout = 4\noptimizer = {{ kind = '{optimizer}' }}\n\
         [[stages]]\nkind = 'reconstruction'\nsteps = 5\nlearning_rate = 1e-3\nwarmup = 2\n\
         inputs = [1, 2]\ntargets = 2\n\
         [[stages]]\nkind = 'relight'\nsteps = 5\nlearning_rate = 1e-3\nwarmup = 2\n\
         inputs = [1, 2]\ntargets = 2\n",
        folder.display()
    );
    let path = folder.join("train.toml");
    std::fs::write(&path, text).unwrap();
    TrainConfig::read(&path).unwrap()
}

#[test]
fn resumed_equals_uninterrupted() {
    let folder = tempfile::tempdir().unwrap();
    write_objects(&folder.path().join("objects"), false);
    let device = [Device::flex()];
    for optimizer in ["adamw", "muon"] {
        let whole = config(folder.path(), &format!("{optimizer}-whole"), optimizer);
        let expected = std::fs::read(
            lumi_train::train(&whole, false, &device, &Solo, &())
                .unwrap()
                .weights,
        )
        .unwrap();

        // Cut in the first stage after a save, then in the second, then to the end.
        let cut = config(folder.path(), &format!("{optimizer}-cut"), optimizer);
        for (resume, at) in [(false, 4), (true, 4)] {
            let run = || lumi_train::train(&cut, resume, &device, &Solo, &Cut(at));
            assert!(std::panic::catch_unwind(std::panic::AssertUnwindSafe(run)).is_err());
        }
        let finished = lumi_train::train(&cut, true, &device, &Solo, &()).unwrap();
        assert!(
            std::fs::read(finished.weights).unwrap() == expected,
            "{optimizer}: weights differ"
        );

        // Longer and slower is the same run; other stages or held-out objects are not.
        type Change = fn(&mut TrainConfig);
        let refused: [(Change, &str); 4] = [
            (|c| c.stages.truncate(1), "config.stages[1]"),
            (|c| c.stages[1].targets = 1, "config.stages[1]"),
            (|c| c.stages.swap(0, 1), "config.stages[0]"),
            (|c| c.holdout = 2, "config.holdout"),
        ];
        for (change, field) in refused {
            let mut other = cut.clone();
            change(&mut other);
            let error = lumi_train::train(&other, true, &device, &Solo, &()).unwrap_err();
            assert!(error.to_string().contains(field), "{error} without {field}");
        }
        let mut longer = cut.clone();
        longer.stages[1].steps += 1;
        longer.stages[1].learning_rate = 1e-4;
        lumi_train::train(&longer, true, &device, &Solo, &()).unwrap();

        // A finished folder is not silently overwritten.
        let again = lumi_train::train(&cut, false, &device, &Solo, &())
            .unwrap_err()
            .to_string();
        assert!(again.contains("--resume"), "{again}");
    }
}

#[test]
fn two_runs_do_not_work_in_one_folder() {
    let folder = tempfile::tempdir().unwrap();
    write_objects(&folder.path().join("objects"), false);
    let config = config(folder.path(), "run", "adamw");
    let run = |resume| lumi_train::train(&config, resume, &[Device::flex()], &Solo, &());
    std::fs::create_dir_all(&config.output).unwrap();
    let other = std::fs::File::create(config.output.join("lock")).unwrap();
    other.lock().unwrap();
    let error = run(false).unwrap_err().to_string();
    assert!(
        error.contains("output") && error.contains("other"),
        "{error}"
    );
    drop(other);
    run(false).unwrap();
}
