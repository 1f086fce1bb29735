//! The kernels under autodiff against Burn's own operations, and what the golden cases do not reach:
//! the `cached` decoder, light rays and the pyramid head.
#![allow(clippy::unwrap_used)]

use burn::tensor::{Device, Distribution, Tensor, TensorData};
use lumi_core::Seed;
use lumi_core::glam::{EulerRot, Mat3};
use lumi_kernels::{Pattern, Precision, Save};
use lumi_model::block::Block;
use lumi_model::config::{DecoderAttention, HeadConfig};
use lumi_model::frames::Frames;
use lumi_model::params::to_vec;
use lumi_model::{ModelConfig, Network};

fn relative(a: Vec<f32>, b: Vec<f32>) -> f32 {
    assert_eq!(a.len(), b.len());
    let largest = b.iter().fold(1e-12_f32, |m, v| m.max(v.abs()));
    a.iter()
        .zip(&b)
        .fold(0.0_f32, |m, (x, y)| m.max((x - y).abs()))
        / largest
}

#[test]
fn kernels_equal_burns_operations() {
    let device = Device::flex().autodiff();
    let rng = &mut Seed(3).stream("test");
    let mut block = Block::new(48, 16, 0.2, rng, &device);
    let patterns = [(21, 0), (9, 4)].map(|(context, group)| Pattern { context, group });
    let places = [None, Some(places([2, 21], &device))];
    let cases = patterns.iter().flat_map(|p| places.iter().map(|f| (*p, f)));
    for (pattern, frames) in cases {
        let frames = frames.as_ref();
        let x = Tensor::<3>::random([2, 21, 48], Distribution::Normal(0.0, 1.0), &device);
        let weight = Tensor::<3>::random([2, 21, 48], Distribution::Normal(0.0, 1.0), &device);
        let mut run = |composed: bool, save: Save| {
            block.save = save;
            let x = x.clone().require_grad();
            let y = if composed {
                block.forward_composed(x.clone(), pattern, frames)
            } else {
                block.forward(x.clone(), pattern, frames)
            };
            let grads = (y.clone() * weight.clone()).sum().backward();
            let matrices = [&block.qkv, &block.proj, &block.fc1, &block.fc2];
            let gains = [&block.norm1, &block.q_norm, &block.k_norm, &block.norm2];
            let mut values = vec![to_vec(y), to_vec(x.grad(&grads).unwrap())];
            values.extend(matrices.map(|p| to_vec(p.val().grad(&grads).unwrap())));
            values.extend(gains.map(|p| to_vec(p.val().grad(&grads).unwrap())));
            values
        };
        let expected = run(true, Save::Activations);
        for save in [Save::Activations, Save::Input] {
            for (i, (a, b)) in run(false, save).into_iter().zip(&expected).enumerate() {
                let error = relative(a, b.clone());
                let framed = frames.is_some();
                assert!(
                    error < 2e-5,
                    "{pattern:?}, {framed}, {save:?}, tensor {i}: {error}"
                );
            }
        }
    }
}

/// Frames of `[b, n]` tokens: turned about all three axes, and moved.
fn places([b, n]: [usize; 2], device: &Device) -> Frames {
    let mut values = Vec::new();
    for i in 0..b * n {
        let i = i as f32;
        let turn = Mat3::from_euler(EulerRot::XYZ, 0.7 * i, 1.3 * i, 2.1 * i);
        values.extend(turn.transpose().to_cols_array());
        values.extend([0.5 * i.sin(), 0.5 * i.cos(), 0.3 * (2.0 * i).sin()]);
    }
    Frames::new(Tensor::from_data(
        TensorData::new(values, [b, n, 12]),
        device,
    ))
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
    let c = config.rays.channels();
    let posed = lumi_model::batch::stack(random(3 * (3 + c) * r * r), [1, 3, 3 + c, r, r], &device);
    let rays = lumi_model::batch::stack(random(2 * c * r * r), [1, 2, c, r, r], &device);
    let scene = network.encode(posed, config);
    let image = network.decode(scene, rays, config);
    (network, image)
}

/// A view's picture must not depend on which other views are rendered with it.
#[test]
fn cached_views_are_independent() {
    let config = ModelConfig::preset("nano").unwrap();
    assert_eq!(config.decoder, DecoderAttention::Cached);
    let (network, _) = render(&config, Precision::F32);
    let device = Device::flex();
    let z = Tensor::<3>::random([1, 16, 32], Distribution::Normal(0.0, 1.0), &device);
    let rays = Tensor::<5>::random([1, 3, 6, 16, 16], Distribution::Normal(0.0, 1.0), &device);
    let together = network
        .decode(z.clone(), rays.clone(), &config)
        .narrow(1, 1, 1);
    let alone = network.decode(z, rays.narrow(1, 1, 1), &config);
    assert!(relative(to_vec(together), to_vec(alone)) < 1e-5);
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
    let decoders = [DecoderAttention::Joint, DecoderAttention::Cached];
    let both = heads.into_iter().flat_map(|head| {
        decoders.map(|decoder| ModelConfig {
            head: head.clone(),
            decoder,
            ..ModelConfig::preset("nano").unwrap()
        })
    });
    let framed = decoders.map(|decoder| ModelConfig {
        decoder,
        view_tokens: true,
        frames: true,
        ..ModelConfig::preset("nano").unwrap()
    });
    both.chain(framed).collect()
}

/// Keys and values kept per scene, and weights packed once, change nothing.
#[test]
fn prepared_scenes_and_packed_weights_render_the_same() {
    let device = Device::flex();
    for config in configs() {
        for (precision, tolerance) in [(Precision::F32, 1e-5), (Precision::Bf16, 0.01)] {
            let (network, _) = render(&config, precision);
            let normal = Distribution::Normal(0.0, 1.0);
            let z = Tensor::<3>::random([2, 16, config.token_width()], normal, &device);
            let rays = Tensor::<5>::random([2, 3, 6, 16, 16], normal, &device);
            let expected = to_vec(network.decode(z.clone(), rays.clone(), &config));
            let packed = network.packed();
            let prepared = packed.prepare(z.clone(), &config);
            for (name, render) in [
                ("packed", packed.decode(z.clone(), rays.clone(), &config)),
                (
                    "prepared",
                    packed.decode_prepared(&prepared, rays.clone(), &config),
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
        assert_eq!(exact.dims(), [1, 2, 3, 16, 16]);
        let (exact, fast) = (to_vec(exact), to_vec(fast));
        assert!(exact.iter().all(|v| (0.0..=1.0).contains(v)));
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
