//! Folders of models, good and bad, as `lumi dataset generate` takes them.

use lumi_core::{Event, Progress};
use lumi_render::generate::{Assets, Backend, GenerateConfig, Split, Summary, generate};
use std::path::Path;
use std::sync::Mutex;

struct Log(Mutex<Vec<String>>);

impl Progress for Log {
    fn event(&self, event: Event) {
        if let Event::Warning(text) = event {
            self.0.lock().expect("lock").push(text);
        }
    }
}

/// Many objects of the models in `folder`, each as small as can be.
fn run(folder: &Path, objects: usize) -> (lumi_core::Result<Summary>, Vec<String>) {
    let config = GenerateConfig {
        objects,
        resolution: 8,
        samples: 1,
        views: 1,
        environments: [1, 1],
        points: 0,
        areas: [0, 0],
        denoise: false,
        model_share: 1.0,
        models: Some(folder.to_owned()),
        ..GenerateConfig::default()
    };
    let (out, log) = (tempfile::tempdir().expect("folder"), Log(Mutex::default()));
    let summary = generate(&config, &Backend::Native, out.path(), &log);
    (summary, log.0.into_inner().expect("warnings"))
}

#[test]
fn one_bad_file_does_not_stop_the_others_and_is_listed() {
    let root = tempfile::tempdir().expect("folder");
    let at = |name: &str| root.path().join(name);
    std::fs::create_dir_all(at("sub/deeper")).expect("folder");
    for (name, bytes) in [
        ("bad.glb", &b"glTF\x02\0\0\0"[..]),
        ("sub/bad.obj", b"v 0 0\n"),
        (
            "sub/deeper/good.obj",
            b"v 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl m\nf 1 2 3\n",
        ),
    ] {
        std::fs::write(at(name), bytes).expect("written");
    }
    let (summary, warnings) = run(root.path(), 12);
    let summary = summary.expect("generated");
    assert_eq!(summary.rendered, 12);
    let failed: Vec<&Path> = summary.failed.iter().map(|f| f.path.as_path()).collect();
    assert_eq!(failed, [at("bad.glb"), at("sub/bad.obj")]);
    assert!(
        summary.failed[1].reason.contains("line 1"),
        "{:?}",
        summary.failed
    );
    // Said once, however often it is drawn.
    let [warning] = &*warnings else {
        panic!("{warnings:?}")
    };
    assert!(
        warning.contains("good.obj") && warning.contains("`m`"),
        "{warning}"
    );

    std::fs::remove_file(at("sub/deeper/good.obj")).expect("removed");
    let message = run(root.path(), 2).0.expect_err("none").to_string();
    assert!(message.contains("found none"), "{message}");
}

#[test]
fn a_folder_of_cases_is_generated() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/cases");
    let folder = root.join("16-texture-file-stops-everything");
    let (summary, warnings) = run(&folder, 12);
    let summary = summary.expect("generated");
    assert_eq!((summary.rendered, summary.failed.len()), (12, 0));
    assert!(
        warnings.iter().all(|w| w.contains("models3")),
        "{warnings:?}"
    );
}

#[test]
fn files_of_one_name_are_split_by_their_folders() {
    let root = tempfile::tempdir().expect("folder");
    for i in 0..40 {
        let folder = root.path().join(i.to_string());
        std::fs::create_dir(&folder).expect("folder");
        std::fs::write(folder.join("model.obj"), "v 0 0 0\n").expect("written");
    }
    let count = |split: Split| {
        let config = GenerateConfig {
            models: Some(root.path().to_owned()),
            held_out: 0.5,
            split,
            ..GenerateConfig::default()
        };
        let assets = Assets::load(&config).expect("loaded");
        assets.models.len()
    };
    let (train, held) = (count(Split::Train), count(Split::HeldOut));
    assert!(
        train + held == 40 && train > 8 && held > 8,
        "{train} {held}"
    );
}
