//! Checkpoints as people have them: `cases/models/26` and `27` of the shared folder.
#![allow(clippy::unwrap_used)]

use burn::tensor::Device;
use lumi_core::Seed;
use lumi_model::checkpoint::{self, Provenance, Storage};
use lumi_model::{ModelConfig, Network, Relighter, import, params};
use std::path::PathBuf;

fn case(path: &str) -> PathBuf {
    lumi_testkit::shared("cases/models").join(path)
}

#[test]
fn names_that_pytorchs_wrappers_leave_are_read_through() {
    let load = |file: &str| {
        let path = case("27-pt-prefixes").join(file);
        let config = import::read_config(&case("27-pt-prefixes/cfg.json")).unwrap();
        let network = import::load_authors(&path, &config, &Device::flex()).unwrap();
        let of = |t: params::LazyParam<'_>| (t.name.clone(), (t.read)());
        params::lazy(&network)
            .into_iter()
            .map(of)
            .collect::<Vec<_>>()
    };
    // One wrapped by `DistributedDataParallel`, one by `torch.compile`: each has all of its weights.
    for file in ["module.pt", "orig_mod.pt"] {
        let weights = load(file);
        assert!(weights.len() > 20, "{file}");
        for (name, values) in weights {
            assert!(values.iter().any(|v| *v != 0.0), "{file}: {name} is blank");
        }
    }
}

#[test]
fn weights_that_are_no_numbers_are_refused_by_name() {
    let folder = case("26-nan-weights-black-pictures");
    let config = import::read_config(&folder.join("cfg.json")).unwrap();
    let refused = |error: String| {
        assert!(
            error.contains("finite numbers, found NaN") && error.contains("tensor `"),
            "{error}"
        );
    };
    let imported = import::load_authors(&folder.join("nan.pt"), &config, &Device::flex());
    refused(imported.unwrap_err().to_string());
    // The case's own weights file is of an older format, which is said first.
    let loaded = Relighter::load(folder.join("nanw.safetensors"), &Device::flex());
    let text = loaded.err().unwrap().to_string();
    assert!(text.contains("found lumitokens-1"), "{text}");

    let config = ModelConfig::preset("nano").unwrap();
    let network = Network::new(&config, Seed(1), &Device::flex());
    let mut tensors = params::lazy(&network);
    let count = tensors[2].shape.iter().product();
    let name = tensors[2].name.clone();
    tensors[2].read = Box::new(move || {
        let mut values = vec![0.5; count];
        values[count - 1] = f32::NAN;
        values
    });
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("nan.safetensors");
    let provenance = Provenance::default();
    checkpoint::write(&path, tensors, &config, &provenance, Storage::Bf16).unwrap();
    let text = Relighter::load(&path, &Device::flex())
        .err()
        .unwrap()
        .to_string();
    assert!(text.contains(&format!("`{name}`")), "{text}");
    refused(text);
}
