//! The JSON files of scene folders. There are no images beside them, so what is tried is all that comes before
//! an image is opened.
#![no_main]

use libfuzzer_sys::fuzz_target;

const FILES: [&[&str]; 4] = [
    &["transforms.json"],
    &["transforms_train.json", "transforms_test.json", "transforms_novel.json"],
    &["cameras.json", "lights.json", "object.json"],
    &["metadata/scene.json"],
];

fuzz_target!(|bytes: &[u8]| {
    let folder = tempfile::tempdir().expect("a temporary folder");
    for (i, files) in FILES.iter().enumerate() {
        let scene = folder.path().join(i.to_string());
        for below in ["metadata", "images"] {
            std::fs::create_dir_all(scene.join(below)).expect("a folder");
        }
        for file in *files {
            std::fs::write(scene.join(file), bytes).expect("a file");
        }
        let _ = lumi_data::open(scene);
    }
});
