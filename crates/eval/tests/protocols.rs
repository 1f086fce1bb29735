//! Protocols from end to end with an untrained model: what is written, kept, repeated and refused.
#![allow(clippy::unwrap_used)]

use burn::tensor::Device;
use lumi_core::{
    Camera, DisplayImage, Light, NamedLight, Point, Role, Scene, Seed, Similarity, View, glam::Vec3,
};
use lumi_eval::cases::Subject;
use lumi_eval::draw::draw_cases;
use lumi_eval::rules::PAPER;
use lumi_eval::{Collection, Judge, Lpips, Options, Outcome, Protocol, evaluate};
use lumi_model::{ModelConfig, Relighter};
use std::path::{Path, PathBuf};

fn demo() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../assets/demo")
}

fn model() -> Relighter {
    let config = ModelConfig::preset("nano").unwrap();
    Relighter::random(&config, Seed(1), &Device::flex())
}

fn judge() -> Judge {
    let device = Device::flex();
    Judge::new(PAPER, Lpips::alex(&device).unwrap(), &device)
}

fn run(data: &Path, protocol: Protocol, options: &Options) -> lumi_eval::Result<Outcome> {
    let collection = Collection::open(data)?;
    evaluate(&model(), &collection, protocol, &judge(), options, &())
}

/// The demo's object twice, under two names, in a data set of its own.
fn twice(folder: &Path) -> PathBuf {
    let data = folder.join("data");
    std::fs::create_dir(&data).unwrap();
    for name in ["first", "second"] {
        std::fs::create_dir(data.join(name)).unwrap();
        for entry in std::fs::read_dir(demo().join("spot")).unwrap() {
            let path = entry.unwrap().path();
            std::fs::copy(&path, data.join(name).join(path.file_name().unwrap())).unwrap();
        }
    }
    let text = std::fs::read_to_string(demo().join("manifest.json")).unwrap();
    let mut manifest: serde_json::Value = serde_json::from_str(&text).unwrap();
    let spot = manifest["objects"]["spot"].take();
    manifest["objects"] = serde_json::json!({"first": spot, "second": spot});
    std::fs::write(data.join("manifest.json"), manifest.to_string()).unwrap();
    data
}

#[test]
fn finished_objects_are_taken_over_and_failures_listed() {
    let folder = tempfile::tempdir().unwrap();
    let data = twice(folder.path());
    let out = folder.path().join("out");
    let options = |jobs| Options {
        out: Some(out.clone()),
        jobs: Some(jobs),
        ..Options::default()
    };
    let whole = run(&data, Protocol::MultiView, &options(2)).unwrap();
    assert_eq!(whole.report.per_object.len(), 2);
    assert_eq!(whole.report.per_object["first"].cases.len(), 9);
    assert!(whole.report.failures.is_empty());
    // Broken in secret, the second object can only come from what is left of the first run.
    let image = data.join("second/v00_env0.exr");
    let written = std::fs::metadata(&image).unwrap().modified().unwrap();
    let length = std::fs::read(&image).unwrap().len();
    std::fs::write(&image, vec![0; length]).unwrap();
    let file = std::fs::File::options().write(true).open(&image).unwrap();
    file.set_modified(written).unwrap();
    let again = run(&data, Protocol::MultiView, &options(1)).unwrap();
    assert!(again.report == whole.report, "figures differ");
    assert_eq!(again.tiles, whole.tiles);
    // An object whose files have changed is evaluated again.
    std::fs::remove_file(&image).unwrap();
    let changed = run(&data, Protocol::MultiView, &options(1)).unwrap();
    assert!(changed.report.failures["second"].contains("v00_env0.exr"));
    // Another protocol takes nothing over: the object fails by name, the other one counts.
    let other = run(&data, Protocol::NovelView, &options(2)).unwrap();
    assert_eq!(other.report.per_object.len(), 1);
    let cause = &other.report.failures["second"];
    assert!(cause.contains("v00_env0.exr"), "{cause}");
    // A run without a folder finds the same figures.
    let skip = vec!["second".to_owned()];
    let alone = Options {
        skip,
        ..Options::default()
    };
    let fresh = run(&data, Protocol::MultiView, &alone).unwrap();
    assert_eq!(
        fresh.report.per_object["first"],
        whole.report.per_object["first"]
    );
    let unknown = Options {
        skip: vec!["third".to_owned()],
        ..Options::default()
    };
    let message = run(&data, Protocol::MultiView, &unknown)
        .unwrap_err()
        .to_string();
    assert!(
        message.contains("third") && message.contains("first"),
        "{message}"
    );
}

#[test]
fn chains_have_every_step_and_method() {
    let outcome = run(&demo(), Protocol::Progressive, &Options::default()).unwrap();
    let chains = &outcome.report.chains;
    for method in ["token", "pixel", "direct"] {
        assert_eq!(chains["replace"][method].len(), 10, "{method}");
        let psnr = |k: usize| {
            chains["replace"][method][k]
                .figures
                .whole
                .slr
                .get("psnr")
                .unwrap()
        };
        assert!((0..10).all(|k| psnr(k).is_finite()), "{method}");
        // The first edit is the same in every space.
        assert_eq!(
            chains["replace"][method][0].figures.whole,
            chains["replace"]["token"][0].figures.whole
        );
    }
    assert!(outcome.report.trivial.contains_key("pixel_chain"));
    // nano's 16 px are too few for LPIPS, which the report says rather than leave a gap.
    let figures = &outcome.report.figures;
    assert!(figures.whole.slr.get("lpips").is_none() && figures.whole.slr.get("ssim").is_some());
    assert!(
        outcome
            .report
            .notes
            .iter()
            .any(|n| n.contains("LPIPS") && n.contains("31"))
    );
}

#[test]
fn runtime_adds_up() {
    let collection = Collection::open(demo()).unwrap();
    let model = model();
    let subject = Subject::load(
        &collection,
        "spot",
        4,
        false,
        model.config.resolution,
        |_| 1,
    )
    .unwrap();
    let report = lumi_eval::protocols::runtime::run(&model, &subject, 5, 2, &()).unwrap();
    assert_eq!((report.views, report.inputs, report.repeats), (5, 4, 2));
    let parts = report.encode + report.edit + report.render;
    assert!(report.encode > 0.0 && (report.end_to_end - parts).abs() < 1e-9);
    assert!((report.relight_only + report.encode - report.end_to_end).abs() < 1e-9);
    assert!((report.render_per_view * 5.0 - report.render).abs() < 1e-9);
}

#[test]
fn drawn_cases_fit_the_scene_and_repeat() {
    let scene = lumi_data::open(demo().join("spot")).unwrap();
    let cases = draw_cases(&scene).unwrap();
    assert_eq!(
        format!("{cases:?}"),
        format!("{:?}", draw_cases(&scene).unwrap())
    );
    assert_eq!((cases.inputs.len(), cases.views.len()), (8, 8));
    assert!(cases.inputs.iter().all(|v| !cases.views.contains(v)));
    assert!(cases.source.0.contains_key("env0"));
    assert_eq!(
        (
            cases.progressive.pool.len(),
            cases.progressive.sequence.len()
        ),
        (5, 10)
    );
    assert!(cases.progressive.sequence.windows(2).all(|w| w[0] != w[1]));
    // Every lighting gives the object a mean luminance of 0.2.
    let basis = scene.basis.as_ref().unwrap();
    for (name, lighting) in &cases.targets {
        let lights = lighting.resolve(basis).unwrap();
        let (mut light, mut area) = (0.0, 0.0);
        for view in 0..scene.views.len() {
            for [r, g, b, a] in basis.compose(view, &lights).pixels {
                light += f64::from(0.2126 * r + 0.7152 * g + 0.0722 * b);
                area += f64::from(a);
            }
        }
        assert!(
            (light / area - 0.2).abs() < 1e-3,
            "{name}: {}",
            light / area
        );
    }
    // A folder of one scene is a collection of its own.
    let collection = Collection::open(demo().join("spot")).unwrap();
    assert_eq!(collection.names(&[], &[]).unwrap(), ["spot"]);
}

#[test]
fn photographs_with_known_light_are_grouped_by_it() {
    let view = |i: usize, role| View {
        name: format!("photo{i}"),
        role,
        camera: Camera::orbit(i as f32, 0.4, 2.7, 0.87, 16),
        image: Some(DisplayImage::filled(16, 16, [0.1 * i as f32; 3])),
    };
    let roles = [
        Role::Input,
        Role::Input,
        Role::Target,
        Role::Target,
        Role::Target,
    ];
    let lamp = |name: &str, x: f32| NamedLight {
        name: name.into(),
        light: Light::Point(Point::new(Vec3::new(x, 0.0, 3.0), 500.0)),
    };
    let lit_by = vec![
        vec![],
        vec![],
        vec![lamp("kitchen", 1.0)],
        vec![lamp("garden", 2.0)],
        vec![lamp("kitchen", 3.0)],
    ];
    let scene = Scene {
        name: "cup".into(),
        views: roles
            .into_iter()
            .enumerate()
            .map(|(i, r)| view(i, r))
            .collect(),
        to_model: Similarity::IDENTITY,
        basis: None,
        lit_by,
        radiance: Vec::new(),
        warnings: Vec::new(),
    };
    let subject = Subject::photographs(&scene, 2, 16, 1).unwrap();
    assert_eq!(subject.targets, ["garden", "kitchen"]);
    let kitchen = subject.target("kitchen").unwrap();
    assert_eq!(kitchen.views, ["photo2", "photo4"]);
    let at = |i: usize| match &kitchen.lights_of(i)[0] {
        Light::Point(p) => p.position.x,
        _ => 0.0,
    };
    // Each photograph keeps the light as it was measured for it.
    assert_eq!((at(0), at(1)), (1.0, 3.0));
    let mut gallery = lumi_eval::gallery::Gallery::default();
    let record = Protocol::NovelView
        .object(&model(), &subject, &judge(), &mut gallery)
        .unwrap();
    assert_eq!(record.cases["kitchen"].views.len(), 2);
    assert!(!record.trivial.contains_key("colour_ratio"));
    assert!(
        Protocol::Progressive
            .object(&model(), &subject, &judge(), &mut gallery)
            .is_err()
    );
    let dark = Scene {
        lit_by: Vec::new(),
        ..scene
    };
    let nothing = Subject::photographs(&dark, 2, 16, 1)
        .err()
        .unwrap()
        .to_string();
    assert!(
        nothing.contains("cup") && nothing.contains("light is known"),
        "{nothing}"
    );
}
