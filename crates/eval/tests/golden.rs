//! SSIM against scikit-image and LPIPS against the reference implementation's published values.
#![allow(clippy::unwrap_used)]

use burn::tensor::{Device, Tensor, TensorData};
use lumi_core::DisplayImage;
use lumi_core::image::read_display;
use lumi_eval::metrics::{Lpips, Net, Window, ssim, ssim_map};
use lumi_model::params::to_vec;
use lumi_testkit::{demo, extra, shared};
use serde_json::Value;
use std::path::Path;

/// The pictures of `tools/eval_golden.py`.
fn pattern(width: usize, height: usize, k: usize) -> DisplayImage {
    let mut image = DisplayImage::filled(width, height, [0.0; 3]);
    for (i, pixel) in image.pixels.iter_mut().enumerate() {
        let (x, y) = (i % width, i / width);
        for (c, v) in pixel.iter_mut().enumerate() {
            let byte = (x * 7 + y * 13 + c * 29 + k * ((x * y) % 11) * 5 + k * x * x) % 256;
            *v = byte as f32 / 255.0;
        }
    }
    image
}

#[test]
fn ssim_equals_scikit_image() {
    let golden = include_str!("golden/ssim.json");
    let cases: Vec<Value> = serde_json::from_str(golden).unwrap();
    assert!(cases.len() >= 5);
    for case in cases {
        let number = |key: &str| case[key].as_u64().unwrap() as usize;
        let (width, height) = (number("width"), number("height"));
        let a = pattern(width, height, number("a"));
        let mut b = pattern(width, height, number("b"));
        if number("a") == number("b") {
            for (i, pixel) in b.pixels.iter_mut().enumerate() {
                let shift = 4.0 / 255.0 * ((i % width % 3) as f32 - 1.0);
                *pixel = pixel.map(|v| ((v + shift).clamp(0.0, 1.0) * 255.0).round() / 255.0);
            }
        }
        let map = ssim_map(&a, &b, Window::GAUSSIAN).unwrap();
        let found = [
            ("gaussian", ssim(&a, &b, Window::GAUSSIAN).unwrap()),
            (
                "gaussian_map_mean",
                map.iter().sum::<f64>() / map.len() as f64,
            ),
            (
                "uniform",
                ssim(&a, &b, Window::Uniform { radius: 3 }).unwrap(),
            ),
        ];
        for (key, value) in found {
            let expected = case[key].as_f64().unwrap();
            assert!(
                (value - expected).abs() < 1e-5,
                "{width}×{height} {key}: {value}, scikit-image {expected}"
            );
        }
    }
}

fn tensor(image: &DisplayImage) -> Tensor<4> {
    let values: Vec<f32> = (0..3)
        .flat_map(|c| image.pixels.iter().map(move |p| p[c]))
        .collect();
    let shape = [1, 3, image.height, image.width];
    Tensor::from_data(TensorData::new(values, shape), &Device::flex())
}

fn made(f: impl Fn(usize, usize) -> [f32; 3]) -> DisplayImage {
    let mut image = DisplayImage::filled(64, 64, [0.0; 3]);
    for (i, p) in image.pixels.iter_mut().enumerate() {
        *p = f(i % 64, i / 64);
    }
    image
}

fn equals_published(lpips: &Lpips, key: &str) {
    let text = std::fs::read_to_string(shared("lpips/lpips_golden.json")).unwrap();
    let golden: Value = serde_json::from_str(&text).unwrap();
    let golden = &golden["values"][key];
    let read = |name: &str| read_display(shared(&format!("lpips/imgs/ex_{name}.png"))).unwrap();
    let gradient = made(|x, y| {
        let (x, y) = (x as f32, y as f32);
        [x / 63.0, y / 63.0, (x + y) / 126.0]
    });
    let checker = made(|x, y| [((x / 8 + y / 8) % 2) as f32; 3]);
    // Zeros and ones in [−1, 1] are a half and one in [0, 1].
    let (zeros, ones) = (made(|_, _| [0.5; 3]), made(|_, _| [1.0; 3]));
    let cases = [
        ("ref_p0", read("ref"), read("p0")),
        ("ref_p1", read("ref"), read("p1")),
        ("gradient_vs_checker", gradient, checker),
        ("zeros_vs_ones", zeros, ones),
    ];
    for (name, a, b) in cases {
        let found = to_vec(lpips.distance(tensor(&a), tensor(&b)).unwrap())[0];
        let expected = golden[name].as_f64().unwrap();
        let error = (f64::from(found) - expected).abs();
        assert!(error < 1e-3, "{key} {name}: {found}, published {expected}");
        let same = to_vec(lpips.distance(tensor(&a), tensor(&a)).unwrap())[0];
        assert_eq!(same, 0.0, "{key} {name} against itself");
    }
}

#[test]
fn lpips_over_alexnet_equals_the_published_values() {
    equals_published(
        &Lpips::alex(&Device::flex()).unwrap(),
        "alexnet_fp16weights",
    );
}

#[test]
fn lpips_over_vgg16_equals_the_published_values() {
    let Some(weights) = extra("lpips/vgg16.fp16.safetensors") else {
        return;
    };
    let lpips = Lpips::vgg(Some(&weights), &Device::flex()).unwrap();
    equals_published(&lpips, "vgg16_fp16weights");
}

#[test]
fn a_gradient_flows_to_the_images() {
    let device = Device::flex().autodiff();
    let lpips = Lpips::alex(&device).unwrap();
    let (a, b) = (pattern(35, 33, 1), pattern(35, 33, 2));
    let values = |image: &DisplayImage| -> Vec<f32> {
        (0..3)
            .flat_map(|c| image.pixels.iter().map(move |p| p[c]))
            .collect()
    };
    let on = |values: Vec<f32>| -> Tensor<4> {
        Tensor::from_data(TensorData::new(values, [1, 3, 33, 35]), &device)
    };
    let x = on(values(&a)).require_grad();
    let loss = lpips.distance(x.clone(), on(values(&b))).unwrap().sum();
    let gradient = to_vec(x.grad(&loss.backward()).unwrap());
    assert!(gradient.iter().all(|g| g.is_finite()));
    // Along the gradient itself the slope is its squared length.
    let length: f32 = gradient.iter().map(|g| g * g).sum::<f32>().sqrt();
    let at = |step: f32| {
        let moved = values(&a)
            .iter()
            .zip(&gradient)
            .map(|(v, g)| v + step * g / length)
            .collect();
        to_vec(lpips.distance(on(moved), on(values(&b))).unwrap())[0]
    };
    let h = 0.02;
    let slope = (at(h) - at(-h)) / (2.0 * h);
    assert!(
        (slope - length).abs() < 0.03 * length,
        "{slope} against {length}"
    );
    // Where ReLU leaves nothing, nothing is divided by zero.
    let black = on(vec![0.0; 3 * 33 * 35]).require_grad();
    let loss = lpips.distance(black.clone(), on(values(&b))).unwrap().sum();
    let gradient = to_vec(black.grad(&loss.backward()).unwrap());
    assert!(gradient.iter().all(|g| g.is_finite()));
}

#[test]
fn small_images_are_refused_by_name() {
    assert_eq!((Net::Alex.least_side(), Net::Vgg.least_side()), (31, 16));
    let lpips = Lpips::alex(&Device::flex()).unwrap();
    let (large, small) = (pattern(31, 31, 1), pattern(40, 30, 1));
    lpips.distance(tensor(&large), tensor(&large)).unwrap();
    let message = lpips
        .distance(tensor(&small), tensor(&small))
        .unwrap_err()
        .to_string();
    assert!(
        message.contains("at least 31 pixels") && message.contains("40×30"),
        "{message}"
    );
}

#[test]
fn missing_or_foreign_weights_are_explained() {
    let device = Device::flex();
    let nowhere = Path::new("/nowhere/vgg16.safetensors");
    let message = Lpips::vgg(Some(nowhere), &device).unwrap_err().to_string();
    assert!(message.contains("/nowhere/vgg16.safetensors"), "{message}");
    let alexnet = demo().join("../lpips/alexnet.fp16.safetensors");
    let message = Lpips::vgg(Some(&alexnet), &device).unwrap_err().to_string();
    assert!(
        message.contains("features.0.weight") && message.contains("[64, 3, 3, 3]"),
        "{message}"
    );
}

#[test]
fn the_spatial_map_agrees_with_the_distance() {
    // Constant images have constant features but for the borders; the map's mean is near the distance.
    let lpips = Lpips::alex(&Device::flex()).unwrap();
    let (a, b) = (made(|_, _| [0.5; 3]), made(|_, _| [1.0; 3]));
    let distance = to_vec(lpips.distance(tensor(&a), tensor(&b)).unwrap())[0];
    let map = to_vec(lpips.spatial(tensor(&a), tensor(&b)).unwrap());
    assert_eq!(map.len(), 64 * 64);
    let mean = map.iter().sum::<f32>() / map.len() as f32;
    assert!(
        (mean - distance).abs() < 0.1 * distance,
        "{mean} against {distance}"
    );
}
