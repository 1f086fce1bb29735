//! Two processes under `mpirun` learn what one learns from the same samples:
//! `cargo test --release --features mpi --test train_mpi`.
#![cfg(feature = "mpi")]
#![allow(clippy::unwrap_used)]

use burn::tensor::Device;
use lumi_model::{Network, checkpoint, params};
use std::path::Path;
use std::process::{Command, Output};
use std::time::{Duration, Instant};

const LUMI: &str = env!("CARGO_BIN_EXE_lumi");

/// Where root may start processes, and more of them than the machine has cores.
fn mpirun(processes: usize) -> Command {
    let mut command = Command::new("mpirun");
    command
        .env("OMPI_ALLOW_RUN_AS_ROOT", "1")
        .env("OMPI_ALLOW_RUN_AS_ROOT_CONFIRM", "1")
        .args([
            "--oversubscribe",
            "-n",
            &processes.to_string(),
            LUMI,
            "train",
        ]);
    command
}

fn done(output: &Output) {
    let text = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{text}");
}

fn config(folder: &Path, output: &str, steps: u64) -> String {
    let text = format!(
        "model = 'nano'\ndata = '{0}/objects'\noutput = '{0}/{output}'\nbatch = 4\nvalidate_every = 4\n\
         holdout = 3\n\
         [[stages]]\nkind = 'joint'\nsteps = {steps}\nlearning_rate = 1e-3\nwarmup = 2\n\
         final_fraction = 1.0\ninputs = [1, 3]\ntargets = 2\n",
        folder.display()
    );
    let path = folder.join(format!("{output}.toml"));
    std::fs::write(&path, text).unwrap();
    path.to_str().unwrap().to_owned()
}

fn data(folder: &Path) {
    let data = folder.join("data.toml");
    let text = "objects = 3\nseed = 5\nresolution = 16\nsamples = 2\nviews = 5\n";
    std::fs::write(&data, text).unwrap();
    let objects = folder.join("objects");
    let mut command = Command::new(LUMI);
    command.args(["dataset", "generate"]).arg(&data);
    done(&command.arg("--out").arg(&objects).output().unwrap());
}

/// Largest difference between the averages of two runs.
fn apart(folder: &Path, one: &str, other: &str) -> f32 {
    let read = |run: &str| {
        let path = folder.join(run).join("state/average.safetensors");
        let (network, ..): (Network, _, _) = checkpoint::load(&path, &Device::flex()).unwrap();
        params::export(&network)
    };
    let (a, b) = (read(one), read(other));
    let values = a
        .iter()
        .zip(&b)
        .flat_map(|(a, b)| a.values.iter().zip(&b.values));
    values.map(|(a, b)| (a - b).abs()).fold(0.0, f32::max)
}

#[test]
fn two_processes_learn_what_one_does() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    data(folder);
    let alone = |output: &str, steps, extra: &[&str]| {
        let mut command = Command::new(LUMI);
        command
            .args(["train", &config(folder, output, steps)])
            .args(extra);
        done(&command.output().unwrap());
    };
    let together = |output: &str, steps, extra: &[&str]| {
        let mut command = mpirun(2);
        command
            .args([&config(folder, output, steps), "--mpi"])
            .args(extra);
        done(&command.output().unwrap());
    };
    alone("one", 8, &[]);
    alone("short", 4, &[]);
    assert!(apart(folder, "one", "short") > 1e-3, "nothing was learnt");
    together("two", 8, &[]);
    assert!(
        apart(folder, "one", "two") < 2e-5,
        "{}",
        apart(folder, "one", "two")
    );
    // Two processes of two workers each, which go on where one worker stopped.
    together("short", 8, &["--resume", "--devices", "cpu,cpu"]);
    assert!(
        apart(folder, "one", "short") < 2e-5,
        "{}",
        apart(folder, "one", "short")
    );
}

#[test]
fn one_failing_process_ends_all() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    data(folder);
    let good = config(folder, "good", 1_000_000);
    // The second process finds other settings than the first, and neither may wait for the other for ever.
    let other = config(folder, "other", 1_000);
    let start = Instant::now();
    let mut command = mpirun(1);
    let output = command
        .args([
            &good, "--mpi", ":", "-n", "1", LUMI, "train", &other, "--mpi",
        ])
        .output()
        .unwrap();
    assert!(start.elapsed() < Duration::from_secs(60));
    assert!(!output.status.success());
    let text = String::from_utf8_lossy(&output.stderr);
    assert!(
        text.contains("the same config and saved state in every process"),
        "{text}"
    );
}
