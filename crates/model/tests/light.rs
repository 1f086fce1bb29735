//! Laws of light that hold for any weights.
#![allow(clippy::unwrap_used)]

use burn::tensor::Device;
use lumi_core::glam::Vec3;
use lumi_core::{Camera, DisplayImage, Light, LinearImage, Point, Seed, Similarity, View};
use lumi_model::config::{Mode, Output};
use lumi_model::{Edit, Illumination, ModelConfig, Relighter, SceneTokens};

fn model() -> Relighter {
    let config = ModelConfig {
        output: Output::Radiance,
        anchors: true,
        reprojection: true,
        surface: true,
        direct: true,
        pixel_mlp: 8,
        pixel_context: 2,
        streams: 2,
        view_tokens: true,
        lights: ModelConfig::preset("nano")
            .unwrap()
            .lights
            .with_modes(&Mode::ALL),
        ..ModelConfig::preset("nano").unwrap()
    };
    config.validate("test").unwrap();
    Relighter::random(&config, Seed(1), &Device::flex())
}

fn captured(model: &Relighter) -> SceneTokens {
    let view = |i: usize| {
        let pixels = (0..256).map(|p| [(p % 16) as f32 / 16.0, 0.3, (p + i) as f32 / 300.0]);
        View {
            name: format!("v{i}"),
            role: lumi_core::Role::Input,
            camera: Camera::orbit(i as f32, 0.4, 2.75, 0.87, 16),
            image: Some(DisplayImage {
                width: 16,
                height: 16,
                pixels: pixels.collect(),
                alpha: None,
            }),
        }
    };
    let views: Vec<View> = (0..3).map(view).collect();
    model.encode(&views, Similarity::IDENTITY).unwrap()
}

fn lamp(x: f32, power: f32, color: [f32; 3]) -> Light {
    let mut point = Point::new(Vec3::new(x, -2.0, 2.0), power);
    point.color = color;
    Light::Point(point)
}

fn see(model: &Relighter, tokens: &SceneTokens) -> Vec<[f32; 4]> {
    let camera = Camera::orbit(0.5, 0.5, 2.75, 0.87, 16);
    let images = model.render_radiance(tokens, &[camera]).unwrap();
    images
        .into_iter()
        .flat_map(|image: LinearImage| image.pixels)
        .collect()
}

/// Largest difference of any value, over the largest value.
fn off(a: &[[f32; 4]], b: &[[f32; 4]]) -> f32 {
    let largest = b
        .as_flattened()
        .iter()
        .fold(1e-20_f32, |m, v| m.max(v.abs()));
    let pairs = a.as_flattened().iter().zip(b.as_flattened());
    pairs.fold(0.0_f32, |m, (a, b)| m.max((a - b).abs())) / largest
}

fn times(pixels: &[[f32; 4]], gain: [f32; 3]) -> Vec<[f32; 4]> {
    let [r, g, b] = gain;
    pixels
        .iter()
        .map(|p| [r * p[0], g * p[1], b * p[2], p[3]])
        .collect()
}

#[test]
fn power_and_colour_are_exact() {
    let model = model();
    let start = captured(&model);
    let set = |light| see(&model, &model.edit(&start, &Edit::set([light])).unwrap());
    let white = set(lamp(3.0, 1000.0, [1.0; 3]));
    assert!(white.iter().any(|p| p[0] > 1e-3), "a black picture");
    for power in [0.001, 250.0, 4000.0] {
        let gain = [power / 1000.0; 3];
        let found = set(lamp(3.0, power, [1.0; 3]));
        let error = off(&found, &times(&white, gain));
        assert!(error < 1e-4, "{power} W: {error}");
    }
    let tint = [0.2, 1.0, 0.0];
    let tinted = set(lamp(3.0, 1000.0, tint));
    assert!(off(&tinted, &times(&white, tint)) < 1e-4);
    assert!(tinted.iter().all(|p| p[2] == 0.0), "no blue light, no blue");
}

#[test]
fn no_power_changes_nothing_and_dimming_is_exact() {
    let model = model();
    let start = captured(&model);
    let lit = model
        .edit(&start, &Edit::set([lamp(3.0, 800.0, [1.0; 3])]))
        .unwrap();
    let before = see(&model, &lit);
    let mut dark = lamp(-3.0, 800.0, [1.0; 3]);
    if let Light::Point(point) = &mut dark {
        point.power = f32::MIN_POSITIVE;
    }
    let after = model.edit(&lit, &Edit::add([dark])).unwrap();
    assert!(off(&see(&model, &after), &before) < 1e-6);
    let half = see(&model, &lit.scaled([0.5, 0.25, 0.0]));
    assert!(off(&half, &times(&before, [0.5, 0.25, 0.0])) < 1e-6);
}

#[test]
fn set_replaces_all_light_unless_chained() {
    let model = model();
    let start = captured(&model);
    let b = || lamp(-1.0, 700.0, [1.0, 0.8, 0.6]);
    let alone = see(&model, &model.edit(&start, &Edit::set([b()])).unwrap());
    let mut tokens = start.clone();
    for i in 0..11 {
        let light = lamp(i as f32 - 5.0, 500.0, [1.0; 3]);
        tokens = model.edit(&tokens, &Edit::add([light])).unwrap();
    }
    let after = see(&model, &model.edit(&tokens, &Edit::set([b()])).unwrap());
    assert_eq!(after, alone);
    let chained = model.edit(&tokens, &Edit::set([b()]).chained()).unwrap();
    assert_ne!(see(&model, &chained), alone);
}

#[test]
fn light_is_added_and_taken_away_by_its_share() {
    let model = model();
    let start = captured(&model);
    let (a, b) = (
        lamp(3.0, 1000.0, [1.0; 3]),
        lamp(-3.0, 500.0, [1.0, 0.5, 0.0]),
    );
    let set = |light: &Light| model.edit(&start, &Edit::set([light.clone()])).unwrap();
    let (first, second) = (set(&a), set(&b));
    let both = model.edit(&first, &Edit::add([b.clone()])).unwrap();
    for c in 0..3 {
        let sum = first.illumination.0[c] + second.illumination.0[c];
        assert!((both.illumination.0[c] / sum - 1.0).abs() < 1e-9);
    }
    let back = model.edit(&both, &Edit::remove([b.clone()])).unwrap();
    for c in 0..3 {
        let found = back.illumination.0[c] / first.illumination.0[c];
        assert!((found - 1.0).abs() < 1e-6, "{found}");
    }
    // Whatever the editor makes of a removal, it is corrected until adding leads back.
    let apart = |a: &SceneTokens, b: &SceneTokens| -> f32 {
        let (a, b) = (model.token_values(a), model.token_values(b));
        a.iter().zip(&b).map(|(a, b)| (a - b).powi(2)).sum()
    };
    let (left, brought) = (apart(&back, &first), apart(&both, &first));
    assert!(
        brought > 0.0 && left < 0.01 * brought,
        "{left} of {brought}"
    );
    let error = model
        .edit(&second, &Edit::remove([a]))
        .unwrap_err()
        .to_string();
    assert!(error.contains("remove") && error.contains("red"), "{error}");
    let dark = model.edit(&second, &Edit::remove([b])).unwrap();
    assert_eq!(dark.illumination, Illumination([0.0; 3]));
    assert!(see(&model, &dark).iter().all(|p| p[..3] == [0.0; 3]));
}

#[test]
fn scenes_keep_their_light_in_files() {
    let model = model();
    let start = captured(&model);
    let lit = model
        .edit(&start, &Edit::set([lamp(3.0, 800.0, [1.0, 0.5, 0.2])]))
        .unwrap();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.tokens");
    model.save_tokens(&lit, &path).unwrap();
    let again = model.load_tokens(&path).unwrap();
    assert_eq!(again.illumination, lit.illumination);
    assert_eq!(see(&model, &again), see(&model, &lit));
    // What it was captured as goes with it, since `set` begins there.
    let b = || Edit::set([lamp(-2.0, 300.0, [1.0; 3])]);
    let [a, b] = [&lit, &again].map(|tokens| see(&model, &model.edit(tokens, &b()).unwrap()));
    assert_eq!(a, b);
}

#[test]
fn told_the_captured_light_pictures_are_as_bright_as_photographs_whatever_its_power() {
    let model = model();
    let start = captured(&model);
    let light = |power: f32, tint: [f32; 3]| lamp(2.5, power, tint);
    let exposure = |lights: &[Light]| {
        let told = model.with_captured_light(&start, lights).unwrap();
        told.frame().exposure.0
    };
    let once = exposure(&[light(700.0, [1.0; 3])]);
    // The same photographs in four times the light: cameras let a fourth of it in.
    let fourth = exposure(&[light(2800.0, [1.0; 3])]);
    let tinted = exposure(&[light(700.0, [1.0, 0.5, 0.25])]);
    for (c, tint) in [1.0, 0.5, 0.25].into_iter().enumerate() {
        assert!(once[c] > 0.0 && (once[c] / fourth[c] - 4.0).abs() < 1e-3);
        assert!((tinted[c] * tint / once[c] - 1.0).abs() < 1e-3);
    }

    // Under that light, pictures of the input views are as bright as the photographs; under all others in proportion.
    let told = model
        .with_captured_light(&start, &[light(700.0, [1.0; 3])])
        .unwrap();
    let lit = model
        .edit(&told, &Edit::set([light(700.0, [1.0; 3])]))
        .unwrap();
    let cameras = told.frame().views.clone();
    let pictures = model.render_radiance(&lit, &cameras).unwrap();
    let photographs = start.photographs().unwrap().images();
    let (mut made, mut shown) = ([0.0_f32; 3], [0.0_f32; 3]);
    for (picture, photograph) in pictures.iter().zip(&photographs) {
        for (p, t) in picture.pixels.iter().zip(&photograph.pixels) {
            if p[3] > 0.9 && t.iter().all(|v| *v < 0.98) {
                for c in 0..3 {
                    made[c] += p[c] / p[3];
                    shown[c] += lumi_core::color::srgb_decode(t[c]);
                }
            }
        }
    }
    for (made, shown) in made.iter().zip(shown) {
        assert!((made / shown - 1.0).abs() < 1e-3, "{made} and {shown}");
    }
    let other = || Edit::set([lamp(-2.0, 300.0, [0.3, 1.0, 0.7])]);
    let [plain, told_so] =
        [&start, &told].map(|tokens| see(&model, &model.edit(tokens, &other()).unwrap()));
    assert!(off(&told_so, &times(&plain, once.map(|e| e as f32))) < 1e-4);
    // The captured pictures are what they were.
    assert_eq!(see(&model, &told), see(&model, &start));

    // It is kept with the tokens, and told once, before any edit.
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.tokens");
    model.save_tokens(&told, &path).unwrap();
    assert_eq!(model.load_tokens(&path).unwrap().frame(), told.frame());
    let late = model.with_captured_light(&lit, &[light(1.0, [1.0; 3])]);
    let error = late.unwrap_err().to_string();
    assert!(error.contains("before any edit"), "{error}");
    let inside = Light::Point(Point::new(Vec3::new(0.1, 0.0, 0.2), 10.0));
    assert!(model.with_captured_light(&start, &[inside]).is_err());
}
