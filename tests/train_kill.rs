//! Training that is killed or asked to stop at random moments ends with the weights of a run that was not.
#![allow(clippy::unwrap_used)]

use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

fn lumi(args: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_lumi"));
    command
        .args(args)
        .stdout(Stdio::null())
        .stderr(Stdio::null());
    command
}

fn config(folder: &Path, output: &str) -> String {
    let text = format!(
        "model = 'nano'\ndata = '{0}/objects'\noutput = '{0}/{output}'\nbatch = 2\nvalidate_every = 4\n\
         holdout = 3\nkeep = 2\naccumulate = 2\n\
         [[stages]]\nkind = 'reconstruction'\nsteps = 60\nlearning_rate = 1e-3\nwarmup = 5\n\
         inputs = [1, 3]\ntargets = 2\n\
         [[stages]]\nkind = 'relight'\nsteps = 60\nlearning_rate = 1e-3\nwarmup = 5\n\
         inputs = [1, 3]\ntargets = 2\ninvariance = 0.1\n",
        folder.display()
    );
    let path = folder.join(format!("{output}.toml"));
    std::fs::write(&path, text).unwrap();
    path.to_str().unwrap().to_owned()
}

#[test]
fn killed_ten_times_equals_uninterrupted() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let data = folder.join("data.toml");
    std::fs::write(
        &data,
        "objects = 3\nseed = 5\nresolution = 16\nsamples = 2\nviews = 5\n",
    )
    .unwrap();
    let objects = folder.join("objects");
    let [data, objects] = [&data, &objects].map(|p| p.to_str().unwrap());
    let generated = lumi(&["dataset", "generate", data, "--out", objects]).status();
    assert!(generated.unwrap().success());

    let start = Instant::now();
    assert!(
        lumi(&["train", &config(folder, "whole")])
            .status()
            .unwrap()
            .success()
    );
    let whole = start.elapsed();

    let cut = config(folder, "cut");
    // Each run gets past one save of its own and is then killed after a while that differs from run to run; a run has
    // thirty saves, so none of the ten reaches the end.
    let progress = folder.join("cut/state/progress.json");
    let saved = || std::fs::read_to_string(&progress).unwrap_or_default();
    for i in 0..10_u32 {
        let before = saved();
        let mut child = lumi(&["train", &cut, "--resume"]).spawn().unwrap();
        while saved() == before {
            assert!(child.try_wait().unwrap().is_none(), "run {i} ended early");
            std::thread::sleep(Duration::from_millis(1));
        }
        let share = (f64::from(i * 7 + 3) * 0.618_034).fract();
        std::thread::sleep(whole.mul_f64(0.04 * share));
        assert!(
            child.try_wait().unwrap().is_none(),
            "run {i} reached the end"
        );
        child.kill().unwrap();
        child.wait().unwrap();
    }
    assert!(
        lumi(&["train", &cut, "--resume"])
            .status()
            .unwrap()
            .success()
    );
    let weights = |run: &str| std::fs::read(folder.join(run).join("weights.safetensors")).unwrap();
    assert!(weights("whole") == weights("cut"), "weights differ");
    assert!(folder.join("cut/state.1").exists() && !folder.join("cut/state.2").exists());

    #[cfg(unix)]
    {
        let asked = config(folder, "asked");
        for signal in ["-INT", "-TERM"] {
            stop_when_asked(&asked, &folder.join("asked"), signal);
        }
        let done = lumi(&["train", &asked, "--resume"]).status().unwrap();
        assert!(done.success());
        assert!(weights("whole") == weights("asked"), "weights differ");
    }
}

/// Trains until the next line of its log, then asks it to stop: the state is of the step that it names.
#[cfg(unix)]
fn stop_when_asked(config: &str, output: &Path, signal: &str) {
    let log = output.join("log.jsonl");
    let lines = || std::fs::read_to_string(&log).map_or(0, |text| text.lines().count());
    let before = lines();
    let mut command = lumi(&["train", config, "--resume"]);
    let child = command
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn();
    let mut child = child.unwrap();
    while lines() == before {
        assert!(child.try_wait().unwrap().is_none(), "the run ended early");
        std::thread::sleep(Duration::from_millis(1));
    }
    let id = child.id().to_string();
    assert!(
        Command::new("kill")
            .args([signal, &id])
            .status()
            .unwrap()
            .success()
    );
    let ended = child.wait_with_output().unwrap();
    let said = String::from_utf8_lossy(&ended.stdout);
    assert_eq!(ended.status.code(), Some(130), "{said}");
    assert!(String::from_utf8_lossy(&ended.stderr).contains("stopping after this step"));
    let text = std::fs::read_to_string(output.join("state/progress.json")).unwrap();
    let state: serde_json::Value = serde_json::from_str(&text).unwrap();
    let stage = state["stage"].as_u64().unwrap() + 1;
    let named = format!("stopped after step {} of stage {stage};", state["step"]);
    assert!(said.contains(&named), "{said} without {named}");
}
