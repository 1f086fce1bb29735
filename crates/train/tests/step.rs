//! One optimiser step: accumulated gradients, what learns, and where a number that is none stops a run.
#![allow(clippy::unwrap_used)]

use burn::tensor::{Device, Distribution, Tensor};
use lumi_core::Seed;
use lumi_model::network::Part;
use lumi_model::{ModelConfig, Network, params};
use lumi_train::config::{OptimizerConfig, Parts};
use lumi_train::optim::{Pace, descend, optimizer, select};
use lumi_train::reduce::Solo;

type Pair = (Tensor<5>, Tensor<5>);

fn setting(parts: Parts) -> (ModelConfig, Network, [Pair; 2]) {
    let device = Device::flex().autodiff();
    let config = ModelConfig::preset("nano").unwrap();
    let network = select(Network::new(&config, Seed(4), &device), parts);
    let (r, c) = (config.resolution, config.rays.channels());
    let random = |channels| {
        let normal = Distribution::Normal(0.0, 1.0);
        Tensor::<5>::random([1, 2, channels, r, r], normal, &device)
    };
    let batches = [(); 2].map(|()| (random(3 + c), random(c)));
    (config, network, batches)
}

/// Some loss that every part of the network has a share in.
fn loss(network: &Network, config: &ModelConfig, (posed, rays): &Pair) -> Tensor<1> {
    let scene = network.encode(posed.clone(), &[], config);
    let light = scene.channels.clone();
    let edited = network.edit(&scene, light, config);
    let render = network.decode(&edited, rays.clone(), &[], config);
    (render - 0.3).square().mean()
}

#[test]
fn accumulated_batches_are_one_large_batch() {
    let (config, network, batches) = setting(Parts::ALL);
    let settings = OptimizerConfig::default();
    let both = |network: &Network, batches: &[Pair; 2]| {
        let [a, b] = batches
            .each_ref()
            .map(|batch| loss(network, &config, batch));
        Ok((a + b) / 2.0)
    };
    let mut adamw = optimizer(&settings, &network);
    let rate = Pace::even(1e-2, 1.0);
    let large = descend(
        network.clone(),
        &mut adamw,
        Parts::ALL,
        rate,
        std::slice::from_ref(&batches),
        &Solo,
        both,
    );
    let mut adamw = optimizer(&settings, &network);
    let single = |network: &Network, batch: &Pair| Ok(loss(network, &config, batch));
    let small = descend(
        network.clone(),
        &mut adamw,
        Parts::ALL,
        rate,
        &batches,
        &Solo,
        single,
    );
    let (large, small) = (large.unwrap(), small.unwrap());
    assert!((large.loss - small.loss).abs() < 1e-6);
    assert!((large.norm / small.norm - 1.0).abs() < 1e-4);
    let before = params::export(&network);
    let (a, b) = (
        params::export(&large.network),
        params::export(&small.network),
    );
    let mut moved = 0.0_f32;
    for ((a, b), before) in a.iter().zip(&b).zip(&before) {
        for (x, z) in a.values.iter().zip(&before.values) {
            moved = moved.max((x - z).abs());
        }
        // AdamW's first step is the gradient's sign: a value whose gradient is next to nothing may fall either way, so
        // the mean is compared.
        let mean = |v: &[f32]| v.iter().map(|v| v.abs()).sum::<f32>() / v.len() as f32;
        let apart: Vec<f32> = a.values.iter().zip(&b.values).map(|(x, y)| x - y).collect();
        assert!(mean(&apart) < 1e-4, "{}: {}", a.name, mean(&apart));
    }
    assert!(moved > 5e-3, "nothing was learnt");
}

#[test]
fn only_the_chosen_parts_learn() {
    for parts in [
        Parts {
            encoder: false,
            editor: true,
            decoder: false,
            head: false,
            albedo: false,
        },
        Parts {
            encoder: true,
            editor: true,
            decoder: false,
            head: false,
            albedo: false,
        },
        Parts {
            encoder: true,
            editor: false,
            decoder: true,
            head: true,
            albedo: false,
        },
    ] {
        let (config, network, batches) = setting(parts);
        let mut adamw = optimizer(&OptimizerConfig::default(), &network);
        let single = |network: &Network, batch: &Pair| Ok(loss(network, &config, batch));
        let before = params::export(&network);
        let done = descend(
            network,
            &mut adamw,
            parts,
            Pace::even(1e-2, 1.0),
            &batches,
            &Solo,
            single,
        )
        .unwrap();
        let after = params::export(&done.network);
        let changed = |part: Part| {
            let mut pairs = before.iter().zip(&after);
            pairs.any(|(a, b)| Part::of(&a.name) == part && a.values != b.values)
        };
        for part in [Part::Encoder, Part::Editor, Part::Decoder, Part::Head] {
            assert_eq!(changed(part), parts.train(part), "{parts:?}: {part:?}");
        }
    }
}

#[test]
fn parts_go_at_their_own_rates() {
    let (config, network, batches) = setting(Parts::ALL);
    let mut adamw = optimizer(&OptimizerConfig::default(), &network);
    let single = |network: &Network, batch: &Pair| Ok(loss(network, &config, batch));
    let pace = Pace {
        rate: 1e-3,
        backbone: 0.5,
        editor: 4.0,
        limit: 1.0,
    };
    let before = params::export(&network);
    let parts = Parts::ALL;
    let done = descend(network, &mut adamw, parts, pace, &batches, &Solo, single).unwrap();
    let after = params::export(&done.network);
    // AdamW's first step moves a weight by the rate, but for its decay and where gradients are as small as epsilon.
    for (part, rate) in [
        (Part::Encoder, 0.5e-3),
        (Part::Editor, 2e-3),
        (Part::Decoder, 0.5e-3),
        (Part::Head, 1e-3),
    ] {
        let of_part = before
            .iter()
            .zip(&after)
            .filter(|(a, _)| Part::of(&a.name) == part);
        let far = of_part
            .flat_map(|(a, b)| a.values.iter().zip(&b.values))
            .fold(0.0_f32, |far, (a, b)| far.max((a - b).abs()));
        assert!(
            (far / rate - 1.0).abs() < 0.05,
            "{part:?}: {far} for {rate}"
        );
    }
}

#[test]
fn a_loss_that_is_no_number_changes_nothing() {
    let (config, network, batches) = setting(Parts::ALL);
    let mut adamw = optimizer(&OptimizerConfig::default(), &network);
    let broken = |network: &Network, batch: &Pair| Ok(loss(network, &config, batch) * f32::NAN);
    let before = params::export(&network);
    let done = descend(
        network,
        &mut adamw,
        Parts::ALL,
        Pace::even(1e-2, 1.0),
        &batches,
        &Solo,
        broken,
    )
    .unwrap();
    assert!(done.loss.is_nan());
    for (a, b) in before.iter().zip(params::export(&done.network)) {
        assert_eq!(a.values, b.values);
    }
}
