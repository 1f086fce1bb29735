//! The JSON files of scene folders, beside the images that they name.
#![no_main]

use libfuzzer_sys::fuzz_target;
use std::sync::OnceLock;
use tempfile::TempDir;

static CAPTURES: OnceLock<TempDir> = OnceLock::new();

fn captures() -> TempDir {
    let root = tempfile::tempdir().expect("a temporary folder");
    lumi_fuzz::captures(root.path());
    for (scene, _) in lumi_fuzz::SCENES {
        lumi_data::open(root.path().join(scene)).expect("a scene");
    }
    root
}

fuzz_target!(init: lumi_fuzz::seed("scenes"), |bytes: &[u8]| {
    let root = CAPTURES.get_or_init(captures).path();
    for (scene, files) in lumi_fuzz::SCENES {
        let scene = root.join(scene);
        // One file at a time: the others stay what they were.
        for file in files {
            let file = scene.join(file);
            let whole = std::fs::read(&file).expect("a file");
            std::fs::write(&file, bytes).expect("written");
            let _ = lumi_data::open(&scene);
            std::fs::write(&file, whole).expect("written");
        }
    }
});
