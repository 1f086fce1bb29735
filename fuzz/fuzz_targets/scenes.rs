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

// The first byte says which file the others are.
fuzz_target!(init: lumi_fuzz::seed("scenes"), |bytes: &[u8]| {
    let root = CAPTURES.get_or_init(captures).path();
    let Some((&which, bytes)) = bytes.split_first() else {
        return;
    };
    let (scene, file) = lumi_fuzz::SCENES[usize::from(which) % lumi_fuzz::SCENES.len()];
    let scene = root.join(scene);
    let file = scene.join(file);
    let whole = std::fs::read(&file).expect("a file");
    std::fs::write(&file, bytes).expect("written");
    let _ = lumi_data::open(&scene);
    std::fs::write(&file, whole).expect("written");
});
