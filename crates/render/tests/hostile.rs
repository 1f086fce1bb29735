//! Model files that are cut, changed, huge or random: an error that names the file, or a model; never a panic.

use lumi_core::glam::Vec3;
use lumi_render::models;
use lumi_render::scene::Geometry;
use proptest::prelude::*;
use std::path::Path;

/// Two triangles with normals, texture coordinates, colours, a normal map in a data URI and two instances.
fn gltf() -> String {
    let mut bin = Vec::new();
    for p in [
        [0.0_f32, 0.0, 0.0],
        [1.0, 0.0, 0.0],
        [1.0, 1.0, 0.0],
        [0.0, 1.0, 0.0],
    ] {
        bin.extend(p.iter().flat_map(|v| v.to_le_bytes()));
    }
    for _ in 0..4 {
        bin.extend([0.0_f32, 0.0, 1.0].iter().flat_map(|v| v.to_le_bytes()));
    }
    for uv in [[0.0_f32, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]] {
        bin.extend(uv.iter().flat_map(|v| v.to_le_bytes()));
    }
    bin.extend([255_u8, 128, 0, 255].repeat(4));
    bin.extend([0_u16, 1, 2, 0, 2, 3].iter().flat_map(|v| v.to_le_bytes()));
    let mut png = std::io::Cursor::new(Vec::new());
    image::RgbImage::from_pixel(2, 2, image::Rgb([128, 128, 255]))
        .write_to(&mut png, image::ImageFormat::Png)
        .expect("png");
    let data = |bytes: &[u8]| {
        use base64::Engine;
        base64::engine::general_purpose::STANDARD.encode(bytes)
    };
    format!(
        r#"{{"asset":{{"version":"2.0"}},"scene":0,"scenes":[{{"nodes":[0]}}],
        "nodes":[{{"children":[1,2],"scale":[1,2,1]}},{{"mesh":0}},{{"mesh":0,"translation":[0,0,1]}}],
        "meshes":[{{"primitives":[{{"attributes":{{"POSITION":0,"NORMAL":1,"TEXCOORD_0":2,"COLOR_0":3}},
        "indices":4,"material":0,"mode":4}}]}}],
        "materials":[{{"normalTexture":{{"index":0,"scale":1}},"alphaMode":"MASK","alphaCutoff":0.4,
        "extensions":{{"KHR_materials_clearcoat":{{"clearcoatFactor":1}}}}}}],
        "textures":[{{"source":0,"sampler":0}}],"samplers":[{{"wrapS":33071,"magFilter":9728}}],
        "images":[{{"uri":"data:image/png;base64,{}"}}],
        "accessors":[{{"bufferView":0,"componentType":5126,"count":4,"type":"VEC3","min":[0,0,0],"max":[1,1,0]}},
        {{"bufferView":0,"byteOffset":48,"componentType":5126,"count":4,"type":"VEC3"}},
        {{"bufferView":0,"byteOffset":96,"componentType":5126,"count":4,"type":"VEC2"}},
        {{"bufferView":0,"byteOffset":128,"componentType":5121,"normalized":true,"count":4,"type":"VEC4"}},
        {{"bufferView":0,"byteOffset":144,"componentType":5123,"count":6,"type":"SCALAR"}}],
        "bufferViews":[{{"buffer":0,"byteOffset":0,"byteLength":156}}],
        "buffers":[{{"byteLength":156,"uri":"data:application/octet-stream;base64,{}"}}]}}"#,
        data(png.get_ref()),
        data(&bin)
    )
}

const OBJ: &str = "v 0 0 0 1 0 0\nv 1 0 0 0 1 0\nv 1 1 0 0 0 1\nv 0 1 0 1 1 1\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\n\
    vn 0 0 1\no a\ns off\nf 1/1/1 2/2/1 3/3/1 4/4/1\ng b\nf -4//1 -3//1 -2//1\n";

/// Reads the bytes as a model; what can be read can be traced.
fn read(path: &Path, bytes: &[u8]) {
    std::fs::write(path, bytes).expect("written");
    match models::read(path) {
        Ok(import) => {
            let geometry = Geometry::new(import.model);
            let hit = geometry.visible(Vec3::new(0.3, 3.0, 0.2), Vec3::NEG_Y, || 0.5);
            if let Some(hit) = hit {
                let s = geometry.shading(Vec3::new(0.3, 3.0, 0.2), Vec3::NEG_Y, &hit);
                assert!(s.normal.is_finite());
            }
        }
        Err(e) => {
            let name = path.file_name().expect("name").to_string_lossy();
            assert!(e.to_string().contains(&*name), "{e}");
        }
    }
}

#[test]
fn the_seeds_themselves_are_good() {
    let folder = tempfile::tempdir().expect("folder");
    for (name, text, triangles) in [("a.gltf", gltf(), 4), ("a.obj", OBJ.to_owned(), 3)] {
        let path = folder.path().join(name);
        std::fs::write(&path, text).expect("written");
        let model = models::read(&path).expect("read").model;
        assert_eq!(model.mesh.triangles.len(), triangles, "{name}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 300, ..ProptestConfig::default() })]

    #[test]
    fn changed_gltf(at in 0_usize..2600, byte in any::<u8>(), keep in 0.0..1.0_f64, cut in any::<bool>()) {
        let folder = tempfile::tempdir().expect("folder");
        let mut bytes = gltf().into_bytes();
        let n = bytes.len();
        bytes[at % n] = byte;
        if cut {
            bytes.truncate((keep * n as f64) as usize);
        }
        read(&folder.path().join("a.gltf"), &bytes);
    }

    #[test]
    fn changed_numbers_of_gltf(which in 0_usize..200, number in prop_oneof![
        Just(0_i64), Just(-1), Just(i64::MAX), Just(4_294_967_295), Just(1_000_000_000), 0_i64..9000
    ]) {
        // One of the numbers of the JSON becomes another.
        let folder = tempfile::tempdir().expect("folder");
        let text = gltf();
        let digits: Vec<(usize, &str)> = text
            .match_indices(|c: char| c.is_ascii_digit())
            .filter(|(i, _)| text.as_bytes()[i - 1] == b':' || text.as_bytes()[i - 1] == b'[')
            .collect();
        let (at, _) = digits[which % digits.len()];
        let end = at + text[at..].find(|c: char| !c.is_ascii_digit()).expect("more");
        let changed = format!("{}{number}{}", &text[..at], &text[end..]);
        read(&folder.path().join("a.gltf"), changed.as_bytes());
    }

    #[test]
    fn changed_obj(at in 0_usize..OBJ.len(), byte in any::<u8>(), keep in 0..OBJ.len(), cut in any::<bool>()) {
        let folder = tempfile::tempdir().expect("folder");
        let mut bytes = OBJ.as_bytes().to_vec();
        bytes[at] = byte;
        if cut {
            bytes.truncate(keep);
        }
        read(&folder.path().join("a.obj"), &bytes);
    }

    #[test]
    fn random_bytes(bytes in proptest::collection::vec(any::<u8>(), 0..300), glb in any::<bool>()) {
        let folder = tempfile::tempdir().expect("folder");
        let mut all = if glb { b"glTF\x02\0\0\0".to_vec() } else { Vec::new() };
        all.extend(bytes);
        read(&folder.path().join("a.glb"), &all);
        read(&folder.path().join("a.obj"), &all);
    }
}
