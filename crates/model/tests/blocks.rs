//! The kernels under autodiff against Burn's own operations, and what the golden cases do not reach:
//! places, streams, the `one-way` decoder and the pyramid head.
#![allow(clippy::unwrap_used)]

use burn::tensor::{Device, Distribution, Tensor};
use lumi_core::{Camera, Seed};
use lumi_kernels::{Precision, Save};
use lumi_model::block::Block;
use lumi_model::config::{DecoderAttention, HeadConfig, Output};
use lumi_model::network::Scene;
use lumi_model::params::to_vec;
use lumi_model::places::Places;
use lumi_model::{ModelConfig, Network};
use std::sync::Arc;

fn relative(a: Vec<f32>, b: Vec<f32>) -> f32 {
    assert_eq!(a.len(), b.len());
    let largest = b.iter().fold(1e-12_f32, |m, v| m.max(v.abs()));
    a.iter()
        .zip(&b)
        .fold(0.0_f32, |m, (x, y)| m.max((x - y).abs()))
        / largest
}

/// Blocks with and without places, streams and a context, by our kernels and by Burn's operations, with gradients.
#[test]
fn kernels_equal_burns_operations() {
    let device = Device::flex().autodiff();
    let rng = &mut Seed(3).stream("test");
    let scene = Places::new(2, 5, &cameras(4), 4);
    let views = Places::new(2, 0, &cameras(6), 4);
    let (m, n) = (scene.tokens(), views.tokens());
    assert_eq!((m, n), (5 + 2 * 16, 3 * 16));
    let random = |n: usize| {
        Tensor::<3>::random([2, n, 48], Distribution::Normal(0.0, 1.0), &device)
    };
    for streams in [1, 2] {
        let mut block = Block::new(48, 16, streams, 0.2, rng, &device);
        for (crossed, placed) in [(false, false), (false, true), (true, false), (true, true)] {
            let (rows, sight) = match crossed {
                true => (n, views.toward(&scene, 16)),
                false => (m + 3, scene.among_themselves(3, 16)),
            };
            let sight = placed.then_some(&sight);
            let (x, context, weight) = (random(rows), random(m), random(rows));
            let mut run = |composed: bool, save: Save| {
                block.save = save;
                let (x, context) = (x.clone().require_grad(), context.clone().require_grad());
                let given = (x.clone(), context.clone());
                let y = match (crossed, composed) {
                    (true, true) => block.cross_composed(given.0, given.1, 16, sight),
                    (true, false) => block.cross(given.0, given.1, 16, sight),
                    (false, true) => block.forward_composed(given.0, sight),
                    (false, false) => block.forward(given.0, sight),
                };
                let grads = (y.clone() * weight.clone()).sum().backward();
                let gains = [&block.norm1, &block.q_norm, &block.k_norm, &block.norm2];
                let streams = [&block.v, &block.proj, &block.fc1, &block.fc2];
                let matrices = streams.into_iter().flatten().chain([&block.q, &block.k]);
                let mut values = vec![to_vec(y), to_vec(x.grad(&grads).unwrap())];
                values.extend(matrices.map(|p| to_vec(p.val().grad(&grads).unwrap())));
                values.extend(gains.map(|p| to_vec(p.val().grad(&grads).unwrap())));
                if crossed {
                    values.push(to_vec(context.grad(&grads).unwrap()));
                }
                values
            };
            let expected = run(true, Save::Activations);
            for save in [Save::Activations, Save::Input] {
                for (i, (a, b)) in run(false, save).into_iter().zip(&expected).enumerate() {
                    let error = relative(a, b.clone());
                    assert!(
                        error < 3e-5,
                        "{streams} streams, context {crossed}, places {placed}, {save:?}, tensor {i}: {error}"
                    );
                }
            }
        }
    }
}

/// Cameras around the origin with pictures of 16 × 16 pixels.
fn cameras(n: usize) -> Vec<Camera> {
    let one = |i: usize| Camera::orbit(0.9 * i as f32, 0.2 + 0.1 * i as f32, 2.75, 0.87, 16);
    (0..n).map(one).collect()
}

fn render(config: &ModelConfig, precision: Precision) -> (Network, Tensor<5>) {
    let device = Device::flex();
    let network = Network::new(config, Seed(1), &device).with_precision(precision);
    let rng = &mut Seed(2).stream("inputs");
    let mut random = |n: usize| -> Vec<f32> {
        use rand::RngExt;
        (0..n).map(|_| 2.0 * rng.random::<f32>() - 1.0).collect()
    };
    let r = config.resolution;
    let (p, c) = (config.posed_channels(), config.rays.channels());
    let posed = lumi_model::batch::stack(random(3 * p * r * r), [1, 3, p, r, r], &device);
    let rays = lumi_model::batch::stack(random(2 * c * r * r), [1, 2, c, r, r], &device);
    let scene = network.encode(posed, &cameras(3), config);
    let image = network.decode(&scene, rays, &cameras(2), config);
    (network, image)
}

/// A scene of random tokens from two views each.
fn scene(config: &ModelConfig, b: usize) -> Scene {
    let places = Places::new(b, config.scene_tokens, &cameras(2 * b), config.patch);
    let k = match config.view_tokens {
        true => places.tokens(),
        false => config.scene_tokens,
    };
    let normal = Distribution::Normal(0.0, 1.0);
    Scene {
        channels: Tensor::random([b, k, config.dim], normal, &Device::flex()),
        places: config.anchors.then(|| Arc::new(places)),
    }
}

/// A view's picture must not depend on which other views are rendered with it.
#[test]
fn one_way_views_are_independent() {
    for config in configs() {
        let (network, _) = render(&config, Precision::F32);
        let z = scene(&config, 1);
        let normal = Distribution::Normal(0.0, 1.0);
        let rays = Tensor::<5>::random([1, 3, 6, 16, 16], normal, &Device::flex());
        let cameras = cameras(3);
        let together = network.decode(&z, rays.clone(), &cameras, &config);
        let alone = network.decode(&z, rays.narrow(1, 1, 1), &cameras[1..2], &config);
        let error = relative(to_vec(together.narrow(1, 1, 1)), to_vec(alone));
        assert!(error < 1e-5, "{config:?}: {error}");
    }
}

/// Every head with every decoder, at the size of `nano`.
fn configs() -> Vec<ModelConfig> {
    let layers = vec![1, 2];
    let heads = [
        HeadConfig::Mlp,
        HeadConfig::Dpt {
            features: 8,
            layers: layers.clone(),
        },
        HeadConfig::DptPyramid {
            features: 8,
            layers,
        },
    ];
    let decoders = [DecoderAttention::Joint, DecoderAttention::OneWay];
    let both = heads.into_iter().flat_map(|head| {
        decoders.map(|decoder| ModelConfig {
            head: head.clone(),
            decoder,
            ..ModelConfig::preset("nano").unwrap()
        })
    });
    let placed = [1, 2].into_iter().flat_map(|streams| {
        [Output::Display, Output::Radiance].map(|output| ModelConfig {
            view_tokens: true,
            anchors: true,
            streams,
            output,
            ..ModelConfig::preset("nano").unwrap()
        })
    });
    both.chain(placed).collect()
}

/// Keys and values kept per scene, and weights packed once, change nothing.
#[test]
fn prepared_scenes_and_packed_weights_render_the_same() {
    let device = Device::flex();
    for config in configs() {
        for (precision, tolerance) in [(Precision::F32, 1e-5), (Precision::Bf16, 0.01)] {
            let (network, _) = render(&config, precision);
            let normal = Distribution::Normal(0.0, 1.0);
            let z = scene(&config, 2);
            let rays = Tensor::<5>::random([2, 3, 6, 16, 16], normal, &device);
            let cameras = cameras(6);
            let expected = to_vec(network.decode(&z, rays.clone(), &cameras, &config));
            let packed = network.packed();
            let prepared = packed.prepare(&z, &config);
            for (name, render) in [
                ("packed", packed.decode(&z, rays.clone(), &cameras, &config)),
                (
                    "prepared",
                    packed.decode_prepared(&prepared, rays.clone(), &cameras, &config),
                ),
            ] {
                let error = relative(to_vec(render), expected.clone());
                assert!(
                    error < tolerance,
                    "{name}, {:?}, {precision:?}: {error}",
                    config.decoder
                );
            }
        }
    }
}

#[test]
fn every_head_and_decoder_renders_full_resolution() {
    for config in configs() {
        let (_, exact) = render(&config, Precision::F32);
        let (_, fast) = render(&config, Precision::Bf16);
        assert_eq!(exact.dims(), [1, 2, config.output.channels(), 16, 16]);
        let (exact, fast) = (to_vec(exact), to_vec(fast));
        let most = match config.output {
            Output::Display => 1.0,
            Output::Radiance => f32::MAX,
        };
        assert!(exact.iter().all(|v| (0.0..=most).contains(v)));
        let spread = exact
            .iter()
            .fold(0.0_f32, |m, v| m.max((v - exact[0]).abs()));
        assert!(spread > 1e-4, "a constant picture");
        let worst = exact
            .iter()
            .zip(&fast)
            .fold(0.0_f32, |m, (a, b)| m.max((a - b).abs()));
        assert!(worst < 0.02, "bf16 is off by {worst}");
    }
}

/// The pyramid head's gradient against finite differences, through all its scales.
#[test]
fn the_pyramid_head_differentiates() {
    let device = Device::flex().autodiff();
    let head = HeadConfig::DptPyramid {
        features: 4,
        layers: vec![1, 2],
    };
    let config = ModelConfig {
        head,
        ..ModelConfig::preset("nano").unwrap()
    };
    let network = Network::new(&config, Seed(1), &device);
    let shape = [1, 4, 32];
    let normal = || Tensor::<3>::random(shape, Distribution::Normal(0.0, 1.0), &device);
    let (last, deep, shallow, direction) = (normal(), normal(), normal(), normal());
    let run = |shallow: Tensor<3>| {
        let taps = vec![shallow, deep.clone()];
        let input = lumi_model::head::HeadInput {
            precision: Precision::F32,
            last: last.clone(),
            taps,
            rows: 2,
            columns: 2,
        };
        network.head.forward(input, config.patch).square().sum()
    };
    let x = shallow.clone().require_grad();
    let grad = x.grad(&run(x.clone()).backward()).unwrap();
    let analytic: f32 = (grad * direction.clone().inner()).sum().into_scalar();
    let h = 1e-2;
    let at = |k: f32| -> f32 { run(shallow.clone() + direction.clone() * k).into_scalar() };
    let numeric = (at(h) - at(-h)) / (2.0 * h);
    assert!(
        (analytic - numeric).abs() < 0.02 * numeric.abs().max(0.05),
        "{analytic} {numeric}"
    );
}

/// Convolutions of our kernels against Burn's own, with their gradients: a head's picture and what it makes of a loss.
#[test]
fn convolutions_equal_burns_operations() {
    use burn::tensor::ops::ConvOptions;
    let device = Device::flex().autodiff();
    let layers = vec![1, 2];
    let config = ModelConfig {
        head: HeadConfig::Dpt {
            features: 6,
            layers,
        },
        ..ModelConfig::preset("nano").unwrap()
    };
    let network = Network::new(&config, Seed(8), &device);
    let lumi_model::head::Head::Dpt(head) = &network.head else {
        panic!("a DPT head");
    };
    let normal = Distribution::Normal(0.0, 1.0);
    let x = Tensor::<4>::random([3, 6, 5, 7], normal, &device).require_grad();
    let weight = Tensor::<4>::random([3, 6, 5, 7], normal, &device);
    let ours = head.fuse.forward(x.clone(), Precision::F32);
    let plain = |x: Tensor<4>, kernel: &Tensor<4>| {
        let options = ConvOptions::new([1, 1], [1, 1], [1, 1], 1);
        burn::tensor::activation::gelu(burn::tensor::module::conv2d(
            x,
            kernel.clone(),
            None,
            options,
        ))
    };
    let kernels = [head.fuse.conv1.val(), head.fuse.conv2.val()];
    let theirs = plain(plain(x.clone(), &kernels[0]), &kernels[1]);
    let run = |y: Tensor<4>| {
        let grads = (y.clone() * weight.clone()).sum().backward();
        let mut values = vec![to_vec(y), to_vec(x.grad(&grads).unwrap())];
        values.extend(kernels.each_ref().map(|k| to_vec(k.grad(&grads).unwrap())));
        values
    };
    for (i, (a, b)) in run(ours).into_iter().zip(run(theirs)).enumerate() {
        let error = relative(a, b);
        assert!(error < 2e-5, "tensor {i}: {error}");
    }
}
