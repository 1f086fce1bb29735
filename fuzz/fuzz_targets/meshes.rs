//! OBJ, MTL and glTF models, and images of the formats that only models have.
#![no_main]

use libfuzzer_sys::fuzz_target;
use lumi_render::{image_file, models};
use std::sync::OnceLock;
use tempfile::TempDir;

static FOLDER: OnceLock<TempDir> = OnceLock::new();

/// A model whose library is `mtl.mtl`.
const SQUARE: &str = "mtllib mtl.mtl\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\n\
    usemtl m\nf 1/1 2/2 3/3 4/4\n";

fn folder() -> TempDir {
    let folder = tempfile::tempdir().expect("a temporary folder");
    std::fs::write(folder.path().join("mtl.obj"), SQUARE).expect("written");
    folder
}

/// Images may be as large as they say; those that say more than this take memory, not care.
fn is_small(bytes: &[u8], format: image::ImageFormat) -> bool {
    let reader = image::ImageReader::with_format(std::io::Cursor::new(bytes), format);
    reader.into_dimensions().is_ok_and(|(w, h)| u64::from(w) * u64::from(h) < 1 << 22)
}

// The first byte says which file the others are.
fuzz_target!(init: lumi_fuzz::seed("meshes"), |bytes: &[u8]| {
    let folder = FOLDER.get_or_init(folder).path();
    let Some((&which, bytes)) = bytes.split_first() else {
        return;
    };
    let name = lumi_fuzz::MESHES[usize::from(which) % lumi_fuzz::MESHES.len()];
    let file = folder.join(name);
    if let Ok(format) = image::ImageFormat::from_path(&file) {
        if is_small(bytes, format) {
            let _ = image_file::decode(bytes, &file);
        }
        return;
    }
    std::fs::write(&file, bytes).expect("written");
    if name == "mtl.mtl" {
        // Whatever a library says, the shape is good.
        models::read(&folder.join("mtl.obj")).expect("a square");
    } else {
        let _ = models::read(&file);
    }
});
