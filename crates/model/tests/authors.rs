//! The façade with the authors' network: golden weights (random), their lights and their frames.
#![allow(clippy::unwrap_used)]

use burn::tensor::Device;
use lumi_core::glam::{Mat3, Vec3};
use lumi_core::{
    Area, Camera, DisplayImage, EnvMap, Environment, Light, Point, Role, Similarity, View,
};
use lumi_kernels::Precision;
use lumi_model::checkpoint::{self, Provenance, Storage};
use lumi_model::{Edit, Relighter, import};
use std::path::Path;
use std::sync::Arc;

const SIDE: usize = 32;

fn model(folder: &Path) -> Relighter {
    let golden = lumi_testkit::shared("reference/golden/mlp");
    let device = Device::flex();
    let config = import::read_config(&golden.join("config.json")).unwrap();
    let weights = golden.join("weights.safetensors");
    let network = import::load_authors(&weights, &config, &device).unwrap();
    let path = folder.join("imported.safetensors");
    let provenance = Provenance::default();
    checkpoint::save(&path, &network, &config, &provenance, Storage::F32).unwrap();
    Relighter::load(&path, &device)
        .unwrap()
        .with_precision(Precision::F32)
}

fn picture(i: usize) -> DisplayImage {
    let mut image = DisplayImage::filled(SIDE, SIDE, [0.0; 3]);
    for (p, pixel) in image.pixels.iter_mut().enumerate() {
        *pixel = [0, 1, 2].map(|c| ((p * (c + 3) + i * 17) % 31) as f32 / 31.0);
    }
    image
}

fn views() -> Vec<View> {
    let view = |i: usize| View {
        name: format!("v{i:02}"),
        role: Role::Input,
        camera: Camera::orbit(0.3 * i as f32, 0.4 + 0.1 * i as f32, 2.75, 0.87, SIDE),
        image: Some(picture(i)),
    };
    (0..2).map(view).collect()
}

fn environment() -> Light {
    let (width, height) = (24, 12);
    let pixels = (0..width * height)
        .map(|p| [p % 7, p % 5, p % 11].map(|v| v as f32 * 0.3))
        .collect();
    Light::Environment(Environment::new(
        Arc::new(EnvMap {
            width,
            height,
            pixels,
        }),
        0.7,
        1.0,
    ))
}

fn local() -> Vec<Light> {
    vec![
        Light::Point(Point::new(Vec3::new(0.0, 2.0, 3.0), 800.0)),
        Light::Area(Area::facing(
            Vec3::new(3.0, -1.0, 3.0),
            Vec3::ZERO,
            2.0,
            600.0,
        )),
    ]
}

fn difference(a: &DisplayImage, b: &DisplayImage) -> f32 {
    let channels = a.pixels.iter().flatten().zip(b.pixels.iter().flatten());
    channels.fold(0.0, |m, (x, y)| m.max((x - y).abs()))
}

/// Renders view 0 after setting `lights`, with the whole world moved by `s`.
fn relit(model: &Relighter, lights: &[Light], s: &Similarity) -> DisplayImage {
    let mut views = views();
    for view in &mut views {
        view.camera = view.camera.transformed(s);
    }
    let lights: Vec<Light> = lights.iter().map(|l| l.transformed(s)).collect();
    let scene = model.encode(&views, s.inverse()).unwrap();
    let scene = model.edit(&scene, &Edit::set(lights)).unwrap();
    let images = model.render(&scene, &[views[0].camera]).unwrap();
    images.into_iter().next().unwrap()
}

#[test]
fn lights_and_cameras_share_one_frame() {
    let folder = tempfile::tempdir().unwrap();
    let model = model(folder.path());
    let still = Similarity::IDENTITY;
    let moved = Similarity {
        scale: 2.5,
        rotation: Mat3::from_axis_angle(Vec3::new(1.0, 2.0, -0.5).normalize(), 0.8),
        translation: Vec3::new(4.0, -1.0, 2.0),
    };
    let both = [vec![environment()], local()].concat();
    let mut images = Vec::new();
    for lights in [vec![environment()], local(), both] {
        let image = relit(&model, &lights, &still);
        // Where the world's origin and axes are must not matter, as long as cameras and lights agree. Environment
        // encodings have 8 bits, so that rounding may move some of them by one.
        let elsewhere = relit(&model, &lights, &moved);
        let error = difference(&image, &elsewhere);
        assert!(error < 2e-3, "{error}");
        images.push(image);
    }
    for (a, b) in [(0, 1), (1, 2), (0, 2)] {
        assert!(
            difference(&images[a], &images[b]) > 5e-3,
            "lights {a} and {b} look alike"
        );
    }
    // A light that moves without the cameras changes the picture.
    let turned: Vec<Light> = local()
        .iter()
        .map(|l| {
            l.transformed(&Similarity {
                rotation: Mat3::from_rotation_z(1.5),
                ..still
            })
        })
        .collect();
    assert!(difference(&images[1], &relit(&model, &turned, &still)) > 1e-3);
}

#[test]
fn tokens_keep_their_frame_and_bad_edits_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let model = model(folder.path());
    let scene = model.encode(&views(), Similarity::IDENTITY).unwrap();
    let path = folder.path().join("tokens.safetensors");
    model.save_tokens(&scene, &path).unwrap();
    let loaded = model.load_tokens(&path).unwrap();
    let lights = [vec![environment()], local()].concat();
    let camera = [views()[1].camera];
    let [a, b] = [&scene, &loaded].map(|scene| {
        let lit = model.edit(scene, &Edit::set(lights.clone())).unwrap();
        model.render(&lit, &camera).unwrap().remove(0)
    });
    assert_eq!(a, b);

    let two = Edit::set([environment(), environment()]);
    let text = model.edit(&scene, &two).unwrap_err().to_string();
    assert!(text.contains("one environment"), "{text}");
    let text = model
        .edit(&scene, &Edit::add(local()))
        .unwrap_err()
        .to_string();
    assert!(text.contains("Add"), "{text}");
    let inside = Light::Point(Point::new(Vec3::new(0.1, 0.0, 0.0), 800.0));
    assert!(model.edit(&scene, &Edit::set([inside])).is_err());
}
