//! Sets of objects on disk: the same whatever made them, and continued where they stopped.

use lumi_core::{Event, Progress};
use lumi_data::store::{ObjectRecord, list};
use lumi_render::generate::{Assets, Backend, GenerateConfig, Split, Summary, generate, held_out};
use lumi_render::objects::Stage;
use std::path::Path;
use std::sync::Mutex;

fn config() -> GenerateConfig {
    GenerateConfig {
        objects: 4,
        first: 3,
        seed: 9,
        resolution: 16,
        samples: 2,
        views: 2,
        ..GenerateConfig::default()
    }
}

/// The records of a folder: names, and bytes of everything that they are made of.
fn bytes(folder: &Path) -> Vec<(String, Vec<u8>)> {
    let mut all = Vec::new();
    let mut open = list(folder).expect("listed");
    while let Some(path) = open.pop() {
        if path.is_dir() {
            let below = std::fs::read_dir(&path).expect("folder");
            open.extend(below.map(|entry| entry.expect("entry").path()));
        } else {
            let name = path.strip_prefix(folder).expect("below");
            let bytes = std::fs::read(&path).expect("bytes");
            all.push((name.display().to_string(), bytes));
        }
    }
    all.sort();
    all
}

fn same(a: &Path, b: &Path) {
    let (a, b) = (bytes(a), bytes(b));
    let names = |all: &[(String, Vec<u8>)]| all.iter().map(|f| f.0.clone()).collect::<Vec<_>>();
    assert_eq!(names(&a), names(&b));
    for ((name, a), (_, b)) in a.iter().zip(&b) {
        assert!(a == b, "{name} differs");
    }
}

#[test]
fn shards_and_threads_do_not_matter_and_runs_resume() {
    let (whole, parts) = (
        tempfile::tempdir().expect("folder"),
        tempfile::tempdir().expect("folder"),
    );
    let all = generate(&config(), &Backend::Native, whole.path(), &()).expect("generated");
    assert_eq!(
        all,
        Summary {
            rendered: 4,
            ..Summary::default()
        }
    );
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(1)
        .build()
        .expect("pool");
    for i in 0..2 {
        let config = GenerateConfig {
            shard: [i, 2],
            ..config()
        };
        pool.install(|| generate(&config, &Backend::Native, parts.path(), &()))
            .expect("generated");
    }
    same(whole.path(), parts.path());
    assert_eq!(list(whole.path()).expect("listed").len(), 4);
    // One is cut short; only that one is made again. One that is a file counts as well.
    let path = |name: &str| whole.path().join(name);
    std::fs::remove_file(path("object_000005/zarr.json")).expect("removed");
    let record = ObjectRecord::read(&path("object_000004")).expect("read");
    std::fs::remove_dir_all(path("object_000004")).expect("removed");
    record
        .write(&path("object_000004.safetensors"))
        .expect("written");
    let again = generate(&config(), &Backend::Native, whole.path(), &()).expect("generated");
    assert_eq!(
        again,
        Summary {
            rendered: 1,
            skipped: 3,
            ..Summary::default()
        }
    );
    std::fs::remove_file(path("object_000004.safetensors")).expect("removed");
    record.write(&path("object_000004")).expect("written");
    same(whole.path(), parts.path());
}

#[test]
fn records_hold_what_was_asked_for() {
    let record = config().object(7, &Default::default()).expect("rendered");
    record.validate().expect("valid");
    assert_eq!(
        (record.name.as_str(), record.cameras.len(), record.size()),
        ("object_000007", 2, (16, 16))
    );
    let kinds = |kind: &str| {
        record
            .lights
            .iter()
            .filter(|l| l.light.kind() == kind)
            .count()
    };
    assert!((2..=3).contains(&kinds("environment")) && kinds("point") == 4 && kinds("area") == 2);
    for camera in &record.cameras {
        let d = camera.centre().length();
        assert!((2.55..2.95).contains(&d) && camera.centre().z > 0.08 * d);
    }
    let scene = record.to_scene();
    assert_eq!(
        scene.basis.expect("basis").radiance.len(),
        record.lights.len()
    );
    // The object is there, and some light reaches it.
    assert!(record.alpha.iter().any(|a| a.to_f32() > 0.5));
    assert!(record.radiance.iter().any(|v| v.to_f32() > 0.01));
    // Its base colour is at most white times coverage, and covers what alpha covers.
    for view in 0..2 {
        let albedo = record.albedo_of(view).expect("rendered");
        let colored = albedo.pixels.iter().filter(|p| p[..3] != [0.0; 3]);
        assert!(colored.count() > 10);
        for p in &albedo.pixels {
            assert!(p[..3].iter().all(|&v| v <= p[3] + 1e-3), "{p:?}");
        }
    }
}

#[test]
fn progress_is_told_and_wrong_configs_are_errors() {
    struct Log(Mutex<Vec<Event>>);
    impl Progress for Log {
        fn event(&self, event: Event) {
            self.0.lock().expect("lock").push(event);
        }
    }
    let log = Log(Mutex::new(Vec::new()));
    let folder = tempfile::tempdir().expect("folder");
    let small = GenerateConfig {
        objects: 2,
        ..config()
    };
    generate(&small, &Backend::Native, folder.path(), &log).expect("generated");
    let events = log.0.into_inner().expect("events");
    assert!(matches!(&events[0], Event::Begin { total: 2, .. }));
    assert!(matches!(events.last(), Some(Event::End)));
    let steps = events
        .iter()
        .filter(|e| matches!(e, Event::Step { .. }))
        .count();
    assert_eq!(steps, 2);

    let wrong = |change: fn(&mut GenerateConfig), field: &str| {
        let mut config = config();
        change(&mut config);
        let message = config.validate().expect_err("wrong").to_string();
        assert!(message.contains(field), "{message}");
    };
    wrong(|c| c.shard = [2, 2], "shard");
    wrong(|c| c.views = 0, "views");
    wrong(|c| c.distance = [0.5, 2.0], "distance");
    wrong(|c| c.hdri_share = 1.5, "hdri_share");
    wrong(|c| c.area_size = [2.0, 1.0], "area_size");
    let missing = GenerateConfig {
        hdri: Some("/nowhere/maps".into()),
        ..config()
    };
    let message = generate(&missing, &Backend::Native, folder.path(), &())
        .expect_err("missing")
        .to_string();
    assert!(message.contains("/nowhere/maps"), "{message}");
}

#[test]
fn cameras_frame_the_ball_for_every_field_of_view() {
    let config = GenerateConfig {
        fov_deg: [25.0, 60.0],
        framing: Some([1.0, 1.3]),
        views: 20,
        arc_views: 12,
        ..config()
    };
    config.validate().expect("valid");
    let mut fields = Vec::new();
    for i in 0..30 {
        let cameras = config.cameras(lumi_core::Seed(7).index(i), &Stage::default());
        assert_eq!(cameras.len(), 20);
        let half = (0.5 * cameras[0].width as f32 / cameras[0].fx).atan();
        fields.push(2.0 * half.to_degrees());
        for c in &cameras {
            let filled = (1.0 / c.centre().length()).asin() / half;
            assert!((0.7..=1.0001).contains(&filled), "{filled}");
            assert!(c.centre().z > 0.0 && c.fx == cameras[0].fx);
        }
        // Neighbours on the arc are near each other.
        for pair in cameras[..12].windows(2) {
            let (a, b) = (pair[0].centre().normalize(), pair[1].centre().normalize());
            assert!(a.angle_between(b) < 1.1);
        }
    }
    let spread = |f: fn(f32, f32) -> f32| fields.iter().copied().reduce(f).expect("some");
    assert!(spread(f32::min) < 32.0 && spread(f32::max) > 53.0);
    let wide = GenerateConfig {
        fov_deg: [25.0, 149.0],
        ..config
    };
    assert!(wide.validate().is_err());
}

#[test]
fn splits_share_neither_seeds_nor_files() {
    let held = GenerateConfig {
        split: Split::HeldOut,
        ..config()
    };
    let assets = Assets::default();
    let job = |c: &GenerateConfig| c.job(0, &assets).expect("a job");
    let (a, b) = (job(&config()), job(&held));
    assert_ne!(a.pixels, b.pixels);
    assert_ne!(a.model.mesh.positions, b.model.mesh.positions);
    let names: Vec<String> = (0..1000).map(|i| format!("map_{i}.hdr")).collect();
    let out = |share: f32| {
        let chosen = names.iter().filter(|n| held_out(Path::new(n), share));
        chosen.cloned().collect::<Vec<_>>()
    };
    assert!(out(0.0).is_empty() && out(1.0).len() == 1000);
    let (few, more) = (out(0.1), out(0.3));
    assert!((70..130).contains(&few.len()));
    assert!(few.iter().all(|n| more.contains(n)));
}

#[test]
fn scenes_are_rendered_like_objects() {
    let config = GenerateConfig {
        scene_share: 1.0,
        scene_objects: [2, 3],
        ..config()
    };
    let record = config.object(0, &Assets::default()).expect("rendered");
    record.validate().expect("valid");
    assert!(record.alpha.iter().any(|a| a.to_f32() > 0.99));
}

#[test]
fn a_filling_ground_fills_every_picture_and_keeps_lights_above_it() {
    let config = GenerateConfig {
        scene_share: 1.0,
        filled_share: 1.0,
        scene_objects: [1, 2],
        elevation_deg: [0.0, 80.0],
        fov_deg: [25.0, 60.0],
        framing: Some([1.0, 1.3]),
        views: 6,
        arc_views: 3,
        samples: 1,
        points: 2,
        environments: [1, 1],
        ..config()
    };
    for k in 0..8 {
        let record = config.object(k, &Assets::default()).expect("rendered");
        assert!(record.alpha.iter().all(|a| a.to_f32() == 1.0), "{k}");
        for (i, light) in record.lights.iter().enumerate() {
            let image = record.compose(0, &[(i, [1.0; 3])]);
            let lit = image.pixels.iter().filter(|p| p[0] > 0.0).count();
            assert!(2 * lit > image.pixels.len(), "{k}: {} {lit}", light.name);
        }
    }
}

#[test]
fn recipes_are_valid() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../configs/data");
    let mut names = Vec::new();
    for entry in std::fs::read_dir(folder).expect("folder") {
        let path = entry.expect("entry").path();
        let text = std::fs::read_to_string(&path).expect("text");
        let config: GenerateConfig = toml::from_str(&text).expect("recipe");
        config.validate().expect("valid");
        names.push(path.file_stem().expect("name").to_owned());
    }
    assert!(names.len() >= 4, "{names:?}");
}
