//! The façade: what it does with good input, and one clear error for each kind of bad input.
#![allow(clippy::unwrap_used)]

use burn::tensor::Device;
use lumi_core::glam::{Mat3, Vec3};
use lumi_core::{
    Camera, DisplayImage, EnvMap, Environment, Light, Point, Role, Seed, Similarity, View,
};
use lumi_model::checkpoint::{self, Provenance, Storage};
use lumi_model::config::{DecoderAttention, Output};
use lumi_model::resize::resized;
use lumi_model::{Edit, ModelConfig, Network, Relighter};
use std::path::Path;
use std::sync::Arc;

fn save(path: &Path, seed: u64) -> ModelConfig {
    let config = ModelConfig::preset("nano").unwrap();
    let network = Network::new(&config, Seed(seed), &Device::flex());
    let provenance = Provenance {
        origin: "a test".into(),
        ..Provenance::default()
    };
    checkpoint::save(path, &network, &config, &provenance, Storage::Bf16).unwrap();
    config
}

fn model(folder: &Path, seed: u64) -> Relighter {
    let path = folder.join(format!("{seed}.safetensors"));
    save(&path, seed);
    Relighter::load(path, &Device::flex()).unwrap()
}

fn views(count: usize, side: usize) -> Vec<View> {
    let view = |i: usize| View {
        name: format!("v{i:02}"),
        role: Role::Input,
        camera: Camera::orbit(i as f32, 0.4, 2.75, 0.87, side),
        image: Some(DisplayImage::filled(
            side,
            side,
            [0.2 + 0.1 * i as f32, 0.5, 0.4],
        )),
    };
    (0..count).map(view).collect()
}

fn point() -> Light {
    Light::Point(Point::new(Vec3::new(0.0, 2.0, 3.0), 800.0))
}

fn words<T>(result: lumi_model::Result<T>, expected: &[&str]) {
    let text = match result {
        Ok(_) => panic!("expected an error with {expected:?}"),
        Err(e) => e.to_string(),
    };
    for word in expected {
        assert!(text.contains(word), "expected `{word}` in: {text}");
    }
}

#[test]
fn encode_edit_render_save_and_load() {
    let folder = tempfile::tempdir().unwrap();
    let model = model(folder.path(), 1);
    let cameras: Vec<_> = (0..11)
        .map(|i| Camera::orbit(0.5 * i as f32, 0.3, 2.75, 0.87, 16))
        .collect();
    let z = model.encode(&views(3, 16), Similarity::IDENTITY).unwrap();
    let environment = Environment::new(Arc::new(EnvMap::uniform([1.0, 0.8, 0.6])), 0.4, 1.0);
    let z = model
        .edit(&z, &Edit::set([Light::Environment(environment)]))
        .unwrap();
    let z = model.edit(&z, &Edit::add([point()])).unwrap();
    assert_eq!(
        z.history,
        ["encode 3 views", "set environment", "add point"]
    );
    let images = model.render(&z, &cameras).unwrap();
    assert_eq!(images.len(), 11);
    assert!(
        images
            .iter()
            .flat_map(|i| &i.pixels)
            .flatten()
            .all(|v| (0.0..=1.0).contains(v))
    );
    // A view alone is what it was among the others.
    let alone = model.render(&z, &cameras[9..10]).unwrap();
    let off = alone[0]
        .pixels
        .iter()
        .flatten()
        .zip(images[9].pixels.iter().flatten());
    assert!(off.fold(0.0_f32, |m, (a, b)| m.max((a - b).abs())) < 1e-5);

    z.forget_prepared();
    assert_eq!(model.render(&z, &cameras).unwrap(), images, "made again");

    let path = folder.path().join("scene.tokens");
    model.save_tokens(&z, &path).unwrap();
    let again = model.load_tokens(&path).unwrap();
    assert_eq!(
        (again.history.clone(), again.frame()),
        (z.history.clone(), z.frame())
    );
    assert_eq!(model.render(&again, &cameras).unwrap(), images);
    words(
        other_model(folder.path()).load_tokens(&path),
        &["made by model", "mean nothing"],
    );
}

#[test]
fn tokens_of_views_are_kept_edited_seen_and_saved() {
    for anchors in [false, true] {
        check_tokens_of_views(anchors);
    }
}

fn check_tokens_of_views(anchors: bool) {
    let plain = ModelConfig::preset("nano").unwrap();
    let config = ModelConfig {
        view_tokens: true,
        anchors,
        ..plain.clone()
    };
    let width = config.dim;
    let model = Relighter::random(&config, Seed(1), &Device::flex());
    let k = plain.scene_tokens + 3 * config.image_tokens(16, 16);
    let z = model.encode(&views(3, 16), Similarity::IDENTITY).unwrap();
    let encoded = model.token_values(&z);
    assert_eq!(encoded.len(), k * width);
    assert_eq!(z.bytes(), 4 * encoded.len());
    let z = model.edit(&z, &Edit::set([point()])).unwrap();
    let edited = model.token_values(&z);
    assert_eq!(edited.len(), encoded.len());
    let learned = plain.scene_tokens * width;
    assert_ne!(edited[learned..], encoded[learned..]);
    // The decoder sees them: others make another picture.
    let camera = [Camera::orbit(0.5, 0.3, 2.75, 0.87, 16)];
    let frame = z.frame().clone();
    assert_eq!(frame.views.len(), if anchors { 3 } else { 0 });
    let from =
        |values: Vec<f32>| model.captured_from_values(values, frame.clone(), None, Vec::new());
    let mut without = edited.clone();
    without[learned..].fill(0.0);
    let images = [edited.clone(), without]
        .map(|values| model.render(&from(values).unwrap(), &camera).unwrap());
    assert_ne!(images[0], images[1]);

    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.tokens");
    model.save_tokens(&z, &path).unwrap();
    let again = model.load_tokens(&path).unwrap();
    assert_eq!(model.token_values(&again), edited);

    // What no scene of a model can have is refused.
    words(
        from(edited[..learned].to_vec()),
        &["tokens", "more than 16"],
    );
    words(from(edited[1..].to_vec()), &["tokens", "per token"]);
    let other = Relighter::random(&plain, Seed(1), &Device::flex());
    let refused = other.captured_from_values(edited, frame, None, Vec::new());
    let expected = if anchors {
        ["views", "anchors"]
    } else {
        ["tokens", "expected 16"]
    };
    words(refused, &expected);
}

/// A model whose colours are those of the photographs.
fn with_reprojection() -> Relighter {
    let plain = ModelConfig {
        view_tokens: true,
        anchors: true,
        decoder: DecoderAttention::OneWay,
        output: Output::Radiance,
        ..ModelConfig::preset("nano").unwrap()
    };
    let config = ModelConfig {
        reprojection: true,
        surface: true,
        margins: true,
        direct: true,
        pixel_mlp: 8,
        ..plain.clone()
    };
    config.validate("test").unwrap();
    let device = Device::flex();
    let network = resized(
        Network::new(&plain, Seed(1), &device),
        &plain,
        &config,
        Seed(2),
    )
    .unwrap();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("weights.safetensors");
    let provenance = Provenance::default();
    checkpoint::save(&path, &network, &config, &provenance, Storage::F32).unwrap();
    Relighter::load(&path, &device).unwrap()
}

#[test]
fn detail_comes_from_the_photographs() {
    let model = with_reprojection();
    // Stripes of one line, which pictures of half the size average to grey.
    let mut fine = views(4, 32);
    for view in &mut fine {
        let image = view.image.as_mut().unwrap();
        for (i, pixel) in image.pixels.iter_mut().enumerate() {
            *pixel = [if i / 32 % 2 == 0 { 0.3 } else { 0.7 }, 0.5, 0.5];
        }
    }
    let halved = |view: &View| View {
        camera: view.camera.resized(16, 16),
        image: view.image.as_ref().map(|image| image.resized(16, 16)),
        ..view.clone()
    };
    let coarse: Vec<View> = fine.iter().map(halved).collect();
    let plain = model.encode(&coarse, Similarity::IDENTITY).unwrap();
    let expected = model.token_values(&plain);
    let shown = model.render(&plain, &[coarse[1].camera]).unwrap().remove(0);

    let model = model.with_detail(2).unwrap();
    assert_eq!(model.side(), 32);
    let z = model.encode(&fine, Similarity::IDENTITY).unwrap();
    assert_eq!(model.token_values(&z), expected);
    assert_eq!(z.frame().views[0].width, 16);
    let larger = model.render(&z, &[fine[1].camera]).unwrap().remove(0);
    assert_eq!((larger.width, larger.height), (32, 32));
    // Averaged, it is the picture without detail, and it has what that has not: contrast between lines.
    let pairs = larger.resized(16, 16).pixels.into_iter().zip(&shown.pixels);
    let apart: f32 = pairs.map(|(a, b)| (a[0] - b[0]).abs()).sum::<f32>() / 256.0;
    assert!(apart < 0.03, "{apart}");
    let contrast = |image: &DisplayImage| {
        let w = image.width;
        let below = image.pixels.iter().zip(&image.pixels[w..]);
        below.map(|(a, b)| (a[0] - b[0]).abs()).sum::<f32>() / (w * (w - 1)) as f32
    };
    let [fine_lines, coarse_lines] = [&larger, &shown].map(contrast);
    assert!(
        fine_lines > 0.05 + coarse_lines,
        "{fine_lines} {coarse_lines}"
    );

    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.tokens");
    model.save_tokens(&z, &path).unwrap();
    let again = model.load_tokens(&path).unwrap();
    assert_eq!(model.render(&again, &[fine[1].camera]).unwrap()[0], larger);
    words(
        model.encode(&views(3, 20), Similarity::IDENTITY),
        &["multiples of 16"],
    );
    let nano = Relighter::random(
        &ModelConfig::preset("nano").unwrap(),
        Seed(1),
        &Device::flex(),
    );
    words(
        nano.with_detail(2),
        &["detail", "not given the photographs"],
    );
    words(
        with_reprojection().with_detail(0),
        &["detail", "expected 1 to 16"],
    );
}

#[test]
fn tokens_keep_the_photographs_that_the_decoder_is_given() {
    let model = with_reprojection();
    let z = model.encode(&views(3, 16), Similarity::IDENTITY).unwrap();
    let z = model.edit(&z, &Edit::set([point()])).unwrap();
    let camera = [Camera::orbit(0.5, 0.3, 2.75, 0.87, 16)];
    let seen = model.render(&z, &camera).unwrap();

    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.tokens");
    model.save_tokens(&z, &path).unwrap();
    let again = model.load_tokens(&path).unwrap();
    assert_eq!(model.render(&again, &camera).unwrap(), seen);
    assert!(!z.lights().is_empty());
    assert_eq!(again.lights(), z.lights());

    // Other photographs behind the same tokens make another picture, and there is none without.
    let values = model.token_values(&z);
    let photographs = z.photographs().unwrap().values();
    let from = |photographs: Option<&[f32]>| {
        let frame = z.frame().clone();
        model.captured_from_values(values.clone(), frame, photographs, Vec::new())
    };
    let black = vec![0.0; photographs.len()];
    let other = from(Some(&black)).unwrap();
    let here = from(Some(&photographs)).unwrap();
    assert_ne!(
        model.render(&other, &camera).unwrap(),
        model.render(&here, &camera).unwrap()
    );
    words(from(None), &["photographs", "reprojection"]);
    words(from(Some(&photographs[4..])), &["photographs", "3 views"]);
}

#[test]
fn refinement_comes_nearer_to_the_photographs() {
    let folder = tempfile::tempdir().unwrap();
    let inputs = views(10, 16);
    let cameras: Vec<_> = inputs.iter().map(|view| view.camera).collect();
    let place = Similarity {
        scale: 0.5,
        rotation: Mat3::from_rotation_z(0.7),
        translation: Vec3::new(0.1, -0.2, 0.1),
    };
    let error = |steps: usize| {
        let model = model(folder.path(), 4).with_refinement(steps);
        let z = model.encode(&inputs, place).unwrap();
        let images = model.render(&z, &cameras).unwrap();
        let truth = inputs
            .iter()
            .flat_map(|view| &view.image.as_ref().unwrap().pixels);
        let pairs = images
            .iter()
            .flat_map(|image| &image.pixels)
            .flatten()
            .zip(truth.flatten());
        let error: f32 = pairs.map(|(a, b)| (a - b).powi(2)).sum();
        (error, z.history)
    };
    let (encoded, history) = error(0);
    assert_eq!(history, ["encode 10 views"]);
    let (few, history) = error(5);
    assert_eq!(history, ["encode 10 views", "refine 5 steps"]);
    let (many, _) = error(40);
    assert!(few < encoded && many < few, "{encoded} {few} {many}");
}

/// Another model of the same architecture.
fn other_model(folder: &Path) -> Relighter {
    model(folder, 2)
}

/// Views and lights go through one similarity: a scene moved and scaled as a whole looks the same.
#[test]
fn a_moved_scene_looks_the_same() {
    let folder = tempfile::tempdir().unwrap();
    let model = model(folder.path(), 3);
    let render = |place: &Similarity| {
        let mut inputs = views(2, 16);
        for view in &mut inputs {
            view.camera = view.camera.transformed(place);
        }
        let camera = Camera::orbit(0.2, 0.6, 2.7, 0.87, 16).transformed(place);
        let z = model.encode(&inputs, place.inverse()).unwrap();
        let z = model
            .edit(&z, &Edit::set([point().transformed(place)]))
            .unwrap();
        model.render(&z, &[camera]).unwrap().remove(0)
    };
    let place = Similarity {
        scale: 3.0,
        rotation: Mat3::from_rotation_z(1.1),
        translation: Vec3::new(5.0, -2.0, 1.0),
    };
    let (here, there) = (render(&Similarity::IDENTITY), render(&place));
    let pairs = here
        .pixels
        .iter()
        .flatten()
        .zip(there.pixels.iter().flatten());
    let worst = pairs.fold(0.0_f32, |m, (a, b)| m.max((a - b).abs()));
    assert!(worst < 2e-3, "{worst}");
}

#[test]
fn bad_input_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let model = model(folder.path(), 4);
    let frame = Similarity::IDENTITY;
    words(model.encode(&[], frame), &["inputs", "1 to 32"]);
    words(model.encode(&views(33, 16), frame), &["inputs", "33"]);
    words(
        model.encode(&views(2, 20), frame),
        &["v00", "multiples of 8", "20"],
    );
    let mut mixed = views(2, 16);
    mixed[1].image = Some(DisplayImage::filled(8, 8, [0.0; 3]));
    words(model.encode(&mixed, frame), &["v01", "one size"]);
    mixed[1].image = None;
    words(model.encode(&mixed, frame), &["v01", "photograph"]);
    let mut skewed = views(1, 16);
    skewed[0].camera.camera_to_world.x_axis *= 2.0;
    words(
        model.encode(&skewed, frame),
        &["v00", "camera_to_world", "rotation"],
    );

    let z = model.encode(&views(1, 16), frame).unwrap();
    words(
        model.edit(&z, &Edit::remove([point()])),
        &["trained for", "Remove"],
    );
    words(model.edit(&z, &Edit::set([])), &["at least one light"]);
    let inside = Light::Point(Point::new(Vec3::new(0.1, 0.0, 0.0), 800.0));
    words(
        model.edit(&z, &Edit::set([inside])),
        &["point.position", "outside"],
    );
    let mut camera = Camera::orbit(0.0, 0.3, 2.75, 0.87, 16);
    camera.fx = -1.0;
    words(model.render(&z, &[camera]), &["camera 0", "fx"]);
}

#[test]
fn hostile_weights_files_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("w.safetensors");
    save(&path, 5);
    let load = |path: &Path| Relighter::load(path, &Device::flex());
    let good = std::fs::read(&path).unwrap();
    let bad = folder.path().join("bad.safetensors");

    // A header that promises a network far larger than the file.
    let text = String::from_utf8_lossy(&good).into_owned();
    assert!(text.contains("\\\"dim\\\":32"));
    let mut huge = good.clone();
    let at = |word: &str| {
        let find = |w: &[u8]| w == word.as_bytes();
        good.windows(word.len()).position(find).unwrap()
    };
    let tokens = at("\\\"scene_tokens\\\":16");
    // Same length, so that the header's size still holds.
    huge[tokens..tokens + 19].copy_from_slice(b"\\\"scene_tokens\\\":99");
    std::fs::write(&bad, &huge).unwrap();
    words(load(&bad), &["bad.safetensors", "latents", "[99, 32]"]);
    let dim = at("\\\"dim\\\":32");
    let mut misfit = good.clone();
    misfit[dim..dim + 10].copy_from_slice(b"\\\"dim\\\":90");
    std::fs::write(&bad, &misfit).unwrap();
    words(load(&bad), &["bad.safetensors", "head_dim"]);

    for cut in [0, 7, 100, good.len() / 2, good.len() - 1] {
        std::fs::write(&bad, &good[..cut]).unwrap();
        words(load(&bad), &["bad.safetensors"]);
    }
    std::fs::write(&bad, b"\xff\xff\xff\xff\xff\xff\xff\xff{}").unwrap();
    words(load(&bad), &["bad.safetensors", "safetensors file"]);
    words(load(&folder.path().join("none")), &["none"]);
}
