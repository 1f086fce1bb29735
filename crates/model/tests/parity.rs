//! The authors' network, tensor by tensor, against the golden cases.
#![allow(clippy::unwrap_used)]

use burn::tensor::Device;
use lumi_model::{import, verify};
use lumi_testkit::shared;

fn check(variant: &str, weights: &str) {
    let folder = shared("reference/golden").join(variant);
    let config = import::read_config(&folder.join("config.json")).unwrap();
    let device = Device::flex();
    let network = import::load_release(&folder.join(weights), &config, &device).unwrap();
    let rows =
        verify::verify(&network, &config, &folder.join("case.safetensors"), &device).unwrap();
    for row in &rows {
        println!("{variant} {:32} {:.2e} (≤ {:.0e})", row.tensor, row.max_error, row.tolerance);
    }
    assert!(rows.len() > 25, "only {} tensors compared", rows.len());
    let bad: Vec<_> = rows.iter().filter(|r| !r.ok()).collect();
    assert!(bad.is_empty(), "{bad:#?}");
}

#[test]
fn mlp_matches() {
    check("mlp", "weights.safetensors");
}

#[test]
fn dpt_matches() {
    check("dpt", "weights.safetensors");
}

#[test]
fn checkpoints_match() {
    check("mlp", "checkpoint.pt");
    check("dpt", "checkpoint.pt");
}
