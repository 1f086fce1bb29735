//! Sets of objects on disk: the same whatever made them, and continued where they stopped.

use lumi_core::{Event, Progress};
use lumi_data::store::list;
use lumi_render::generate::{GenerateConfig, Summary, generate};
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

fn bytes(folder: &Path) -> Vec<(String, Vec<u8>)> {
    let read = |p: &std::path::PathBuf| {
        let name = p.file_name().expect("name").to_string_lossy().into_owned();
        (name, std::fs::read(p).expect("bytes"))
    };
    list(folder).expect("listed").iter().map(read).collect()
}

#[test]
fn shards_and_threads_do_not_matter_and_runs_resume() {
    let (whole, parts) = (
        tempfile::tempdir().expect("folder"),
        tempfile::tempdir().expect("folder"),
    );
    let all = generate(&config(), whole.path(), &()).expect("generated");
    assert_eq!(
        all,
        Summary {
            rendered: 4,
            skipped: 0
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
        pool.install(|| generate(&config, parts.path(), &()))
            .expect("generated");
    }
    assert_eq!(bytes(whole.path()), bytes(parts.path()));
    assert!(whole.path().join("object_000003.safetensors").exists());
    // One is lost; only that one is made again.
    std::fs::remove_file(whole.path().join("object_000005.safetensors")).expect("removed");
    let again = generate(&config(), whole.path(), &()).expect("generated");
    assert_eq!(
        again,
        Summary {
            rendered: 1,
            skipped: 3
        }
    );
    assert_eq!(bytes(whole.path()), bytes(parts.path()));
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
    generate(&small, folder.path(), &log).expect("generated");
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
    let message = generate(&missing, folder.path(), &())
        .expect_err("missing")
        .to_string();
    assert!(message.contains("/nowhere/maps"), "{message}");
}
