//! What the fuzzers begin with: valid files of every format, as the tests of `lumi-data` write them.

#[path = "../../crates/data/tests/trees/mod.rs"]
mod trees;

use lumi_core::glam::Vec3;
use lumi_data::formats;
use std::path::{Path, PathBuf};

/// Variable that names the folder for [`seed`]'s files; without it there are none.
pub const SEEDS: &str = "LUMI_FUZZ_SEEDS";

/// JSON files that describe scenes of [`captures`]: the scene, and the file in it.
pub const SCENES: [(&str, &str); 8] = [
    ("transforms", "transforms.json"),
    ("orb/blender_LDR/ball_scene001", "transforms_train.json"),
    ("orb/blender_LDR/ball_scene001", "transforms_test.json"),
    ("orb/blender_LDR/ball_scene001", "transforms_novel.json"),
    ("interchange", "cameras.json"),
    ("interchange", "lights.json"),
    ("interchange", "object.json"),
    ("authors", "metadata/ball_env_0.json"),
];

/// Files that are models or belong to them.
pub const MESHES: [&str; 7] = [
    "a.obj", "mtl.mtl", "a.glb", "a.gltf", "a.tga", "a.webp", "a.bmp",
];

/// Writes a capture in every format, and a record, below `root`.
pub fn captures(root: &Path) {
    let at = |name: &str| root.join(name);
    let pinhole = [56.0, 56.0, 24.0, 24.0];
    trees::colmap(&at("text"), false, (1, "PINHOLE"), &pinhole);
    trees::colmap(&at("binary"), true, (1, "PINHOLE"), &pinhole);
    trees::stanford_orb(&at("orb"), Vec3::Z);
    trees::objects_with_lighting(&at("owl"), Vec3::Z);
    formats::transforms::write(&at("transforms"), &trees::ball(4)).expect("written");
    formats::authors::write(&at("authors"), &trees::ball(4)).expect("written");
    // Small enough for the fuzzers' longest inputs.
    let record = trees::record().downscaled(16).expect("a multiple");
    record.write(&at("ball.safetensors")).expect("written");
    let basis = record.to_scene();
    formats::interchange::write(&at("interchange"), &basis).expect("written");
    formats::authors::write(&at("lights"), &basis).expect("written");
    let grey = image::GrayImage::from_fn(16, 16, |x, y| image::Luma([(16 * x + y) as u8]));
    grey.save(at("grey.jpg")).expect("written");
    image::DynamicImage::from(grey)
        .to_rgb8()
        .save(at("rgb.jpg"))
        .expect("written");
}

/// Puts files for `target` into the folder that [`SEEDS`] names.
pub fn seed(target: &str) {
    let Some(folder) = std::env::var_os(SEEDS).map(PathBuf::from) else {
        return;
    };
    let extensions: &[&str] = match target {
        "images" => &["png", "jpg", "exr", "hdr"],
        "models" => &["bin", "txt", "npy"],
        "records" => &["safetensors"],
        // Their first byte says which file the rest is.
        _ => &[],
    };
    let root = tempfile::tempdir().expect("a temporary folder");
    captures(root.path());
    std::fs::create_dir_all(&folder).expect("a folder");
    if target == "scenes" {
        for (i, (scene, file)) in SCENES.into_iter().enumerate() {
            let text = std::fs::read(root.path().join(scene).join(file)).expect("a file");
            let seed = [&[i as u8], text.as_slice()].concat();
            std::fs::write(folder.join(format!("{i}.json")), seed).expect("written");
        }
    }
    if target == "meshes" {
        meshes(&folder);
    }
    let mut folders = vec![root.path().to_owned()];
    while let Some(next) = folders.pop() {
        for entry in std::fs::read_dir(next).expect("a folder") {
            let path = entry.expect("an entry").path();
            let extension = path
                .extension()
                .and_then(|e| e.to_str())
                .unwrap_or_default();
            if path.is_dir() {
                folders.push(path);
            } else if extensions.contains(&extension) {
                let name = path.strip_prefix(root.path()).expect("below the root");
                let name = name.display().to_string().replace('/', "_");
                std::fs::copy(&path, folder.join(name)).expect("copied");
            }
        }
    }
}

/// The unusual models of `lumi-render`'s tests, with their first byte, and an image of each format.
fn meshes(folder: &Path) {
    let index = |extension: &str| {
        let ends = |n: &&str| n.rsplit('.').next() == Some(extension);
        MESHES.iter().position(|n| ends(&n))
    };
    let put = |count: usize, which: usize, bytes: &[u8]| {
        let seed = [&[which as u8], bytes].concat();
        std::fs::write(folder.join(count.to_string()), seed).expect("written");
    };
    let cases = Path::new(env!("CARGO_MANIFEST_DIR")).join("../crates/render/tests/data/cases");
    let (mut open, mut count) = (vec![cases], 0);
    while let Some(next) = open.pop() {
        for entry in std::fs::read_dir(next).expect("a folder") {
            let path = entry.expect("an entry").path();
            let extension = path.extension().unwrap_or_default().to_string_lossy();
            if path.is_dir() {
                open.push(path);
            } else if let Some(which) = index(&extension) {
                put(count, which, &std::fs::read(&path).expect("a file"));
                count += 1;
            }
        }
    }
    let image = image::DynamicImage::from(image::RgbaImage::from_fn(9, 9, |x, y| {
        image::Rgba([28 * x as u8, 28 * y as u8, 99, 200])
    }));
    for format in [image::ImageFormat::Tga, image::ImageFormat::WebP, image::ImageFormat::Bmp] {
        let mut bytes = std::io::Cursor::new(Vec::new());
        image.write_to(&mut bytes, format).expect("encoded");
        let extension = format.extensions_str()[0];
        let which = index(extension).expect("a mesh's image");
        put(count, which, bytes.get_ref());
        count += 1;
    }
}
