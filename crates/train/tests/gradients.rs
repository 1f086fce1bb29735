//! Gradients and optimiser steps of the authors' network against the golden cases.
#![allow(clippy::unwrap_used)]

use burn::module::{Module, ModuleVisitor, Param};
use burn::optim::GradientsParams;
use burn::tensor::{Device, Gradients, Tensor};
use lumi_model::params::{self, to_vec};
use lumi_model::{ModelConfig, Network, import, verify};
use lumi_testkit::{golden, shared};
use lumi_train::config::OptimizerConfig;
use lumi_train::optim::optimizer;
use std::collections::BTreeMap;

const RELATIVE: f32 = 1e-3;

/// Gradients by the authors' names.
fn by_name(
    network: &Network,
    config: &ModelConfig,
    grads: &Gradients,
) -> BTreeMap<String, Vec<f32>> {
    struct Collect<'a>(
        Vec<String>,
        &'a Gradients,
        &'a ModelConfig,
        BTreeMap<String, Vec<f32>>,
    );
    impl ModuleVisitor for Collect<'_> {
        fn enter_module(&mut self, name: &str, _: &str) {
            self.0.push(name.to_owned());
        }
        fn exit_module(&mut self, _: &str, _: &str) {
            self.0.pop();
        }
        fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
            let grad = param.val().grad(self.1).unwrap();
            let name = import::authors_name(&self.0.join("."), self.2);
            // Thirds of one matrix of theirs come in its order.
            let whole = name.split('[').next().unwrap().to_owned();
            self.3.entry(whole).or_default().extend(to_vec(grad));
        }
    }
    let mut visitor = Collect(Vec::new(), grads, config, BTreeMap::new());
    network.visit(&mut visitor);
    visitor.3
}

/// Largest difference over the largest golden value.
fn relative(ours: &[f32], golden: &[f32]) -> f32 {
    assert_eq!(ours.len(), golden.len());
    let largest = golden.iter().fold(0.0_f32, |m, v| m.max(v.abs()));
    let worst = ours
        .iter()
        .zip(golden)
        .fold(0.0_f32, |m, (a, b)| m.max((a - b).abs()));
    worst / largest
}

fn check(variant: &str) {
    let folder = shared("reference/golden").join(variant);
    let path = folder.join("case.safetensors");
    let config = import::read_config(&folder.join("config.json")).unwrap();
    let device = Device::flex().autodiff();
    let mut network =
        import::load_authors(&folder.join("weights.safetensors"), &config, &device).unwrap();
    let case = golden(&format!("reference/golden/{variant}/case.safetensors"));

    let loss = verify::loss(&network, &config, &path, &device).unwrap();
    let value: f32 = loss.clone().into_scalar();
    assert!((value - case["grad.loss"].data[0]).abs() < 1e-6, "{value}");
    let grads = loss.backward();
    let ours = by_name(&network, &config, &grads);

    let mut compared = 0;
    for (name, tensor) in &case {
        let Some(parameter) = name.strip_prefix("grad.").filter(|p| *p != "loss") else {
            continue;
        };
        let error = relative(&ours[parameter], &tensor.data);
        println!("{variant} {name:60} {error:.1e}");
        assert!(error < RELATIVE, "{name}: {error}");
        compared += 1;
    }
    assert!(compared >= 10, "only {compared} gradients in the case");

    // Every parameter's norm; the golden order is that of sorted names.
    let norms = &case["grad_norms"].data;
    assert_eq!(norms.len(), ours.len());
    for ((name, values), golden) in ours.iter().zip(norms) {
        let norm = values
            .iter()
            .map(|v| f64::from(*v).powi(2))
            .sum::<f64>()
            .sqrt() as f32;
        assert!(
            (norm - golden).abs() <= RELATIVE * golden.abs(),
            "{name}: {norm} against {golden}"
        );
    }

    // Two AdamW steps with that same gradient.
    let settings = OptimizerConfig {
        beta1: 0.9,
        beta2: 0.95,
        epsilon: 1e-8,
        weight_decay: 0.05,
        ..OptimizerConfig::default()
    };
    let mut adamw = optimizer(&settings, &network);
    let mut grads = grads;
    let copy =
        |network: &Network, grads: &mut Gradients| GradientsParams::from_module(grads, network);
    let first = copy(&network, &mut grads);
    let again = verify::loss(&network, &config, &path, &device).unwrap();
    let second = GradientsParams::from_grads(again.backward(), &network);
    network = adamw.step(1e-3, network, first);
    network = adamw.step(1e-3, network, second);
    let stepped: BTreeMap<String, Vec<f32>> = params::export(&network)
        .into_iter()
        .map(|t| (import::authors_name(&t.name, &config), t.values))
        .collect();
    let last = config.editor_layers - 1;
    for (golden, name) in [
        (
            "adamw2.n_light_field_latent",
            "n_light_field_latent".to_owned(),
        ),
        (
            "adamw2.editor_last_norm2",
            format!("transformer_editor.{last}.norm2.weight"),
        ),
    ] {
        let error = relative(&stepped[&name], &case[golden].data);
        println!("{variant} {golden:60} {error:.1e}");
        assert!(error < RELATIVE, "{golden}: {error}");
    }
}

#[test]
fn mlp_gradients_match() {
    check("mlp");
}

#[test]
fn dpt_gradients_match() {
    check("dpt");
}
