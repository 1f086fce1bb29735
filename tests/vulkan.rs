//! A Vulkan device computes what the CPU does: `cargo test --release --features vulkan --test vulkan`. Needs one:
//! docs/devices.md says how far software drivers come.
#![cfg(feature = "vulkan")]
#![allow(clippy::unwrap_used)]

use burn::tensor::Device;
use lumi_model::{Network, checkpoint, params};
use std::path::Path;
use std::process::Command;

fn lumi(args: &[&str]) {
    let output = Command::new(env!("CARGO_BIN_EXE_lumi")).args(args).output();
    let output = output.unwrap();
    let text = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{args:?}: {text}");
}

/// The authors' network, small, with the golden weights: every intermediate tensor.
#[test]
fn golden_tensors() {
    let golden = lumi_testkit::shared("reference/golden");
    for case in ["mlp", "dpt"] {
        let file = |name: &str| golden.join(case).join(name).display().to_string();
        let (weights, config) = (file("checkpoint.pt"), file("config.json"));
        let case = golden.join(case).display().to_string();
        let args = [
            "verify",
            "--weights",
            &weights,
            "--config",
            &config,
            "--case",
            &case,
        ];
        lumi(&[&args[..], &["--device", "vulkan"]].concat());
    }
}

/// Weights after a few steps of all parts with Muon, clipping and averages.
#[test]
fn training() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).display().to_string();
    let (recipe, objects) = (path("data.toml"), path("objects"));
    let text = "objects = 3\nseed = 5\nresolution = 16\nsamples = 2\nviews = 5\n";
    std::fs::write(&recipe, text).unwrap();
    lumi(&["dataset", "generate", &recipe, "--out", &objects]);
    let train = |device: &str, steps: u64| {
        let (output, config) = (path(device), path(&format!("{device}.toml")));
        let text = format!(
            "model = 'nano'\ndata = '{objects}'\noutput = '{output}'\nbatch = 4\nvalidate_every = 4\nholdout = 3\n\
             [optimizer]\nkind = 'muon'\n\
             [[stages]]\nkind = 'joint'\nsteps = {steps}\nlearning_rate = 1e-3\nwarmup = 2\nfinal_fraction = 1.0\n\
             inputs = [1, 3]\ntargets = 2\n"
        );
        std::fs::write(&config, text).unwrap();
        lumi(&["train", &config, "--devices", device]);
        let weights = Path::new(&output).join("weights.safetensors");
        let (network, ..): (Network, _, _) = checkpoint::load(&weights, &Device::flex()).unwrap();
        params::export(&network)
    };
    let (cpu, gpu) = (train("cpu", 6), train("vulkan", 6));
    let values = cpu
        .iter()
        .zip(&gpu)
        .flat_map(|(a, b)| a.values.iter().zip(&b.values));
    let apart = values.map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
    // The weights file has bf16; a step moves a weight by about 1e-3.
    assert!(apart < 2e-3, "largest difference of a weight: {apart}");
}
