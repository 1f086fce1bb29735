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

/// Lines that an OBJ or MTL file might have, and some that none should.
fn lines() -> impl Strategy<Value = Vec<u8>> {
    let keyword = prop_oneof![
        Just("v"),
        Just("vt"),
        Just("vn"),
        Just("f"),
        Just("f"),
        Just("l"),
        Just("p"),
        Just("usemtl"),
        Just("mtllib"),
        Just("newmtl"),
        Just("Kd"),
        Just("Ks"),
        Just("Ns"),
        Just("d"),
        Just("Tr"),
        Just("map_Kd"),
        Just("map_Bump"),
        Just("norm"),
        Just("#"),
        Just("\u{feff}v"),
        Just("")
    ];
    let word = prop_oneof![
        (-4_i64..9).prop_map(|i| i.to_string()),
        (-4_i64..9, -4_i64..9).prop_map(|(a, b)| format!("{a}/{b}")),
        (1_i64..5, 0_i64..5, 0_i64..5).prop_map(|(a, b, c)| format!("{a}/{b}/{c}")),
        (1_i64..5, 1_i64..5).prop_map(|(a, b)| format!("{a}//{b}")),
        any::<f64>().prop_map(|x| x.to_string()),
        any::<i64>().prop_map(|i| i.to_string()),
        Just("nan".to_owned()),
        Just("-nan(ind)".to_owned()),
        Just("1e999".to_owned()),
        Just("a.mtl".to_owned()),
        Just("-s".to_owned()),
        Just("-o".to_owned()),
        Just("-bm".to_owned()),
        Just("\\".to_owned()),
        Just("#".to_owned()),
        Just("\"".to_owned()),
        Just("\u{e9}".to_owned()),
        Just("..".to_owned()),
        Just("/".to_owned()),
    ];
    let line = (keyword, proptest::collection::vec(word, 0..9));
    let text = proptest::collection::vec(line, 0..60).prop_map(|lines| {
        let line = |(k, words): (&str, Vec<String>)| format!("{k} {}\n", words.join(" "));
        lines.into_iter().map(line).collect::<String>().into_bytes()
    });
    // Some vertices, so that some faces are good.
    text.prop_map(|text| {
        [
            b"v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvn 0 0 1\n",
            text.as_slice(),
        ]
        .concat()
    })
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

    #[test]
    fn obj_of_odd_lines(bytes in lines()) {
        let folder = tempfile::tempdir().expect("folder");
        let path = folder.path().join("a.obj");
        std::fs::write(folder.path().join("a.mtl"), &bytes).expect("written");
        read(&path, &bytes);
        // A corner takes two bytes at least, and nothing is made of less.
        if let Ok(import) = models::read(&path) {
            let mesh = import.model.mesh;
            assert!(3 * mesh.triangles.len() <= 3 * bytes.len() / 2);
            assert!(mesh.positions.len() <= 3 * mesh.triangles.len());
            assert!(import.warnings.len() <= bytes.len());
        }
    }

    #[test]
    fn polygons_are_filled_once(radii in proptest::collection::vec(0.1..1.0_f64, 3..40), turn in 0.0..6.0_f64) {
        // Any such star is seen whole from its middle, and so crosses itself nowhere.
        let n = radii.len();
        let corners: Vec<[f64; 2]> = (0..n)
            .map(|i| {
                let (s, c) = (turn + std::f64::consts::TAU * i as f64 / n as f64).sin_cos();
                [radii[i] * c, radii[i] * s]
            })
            .collect();
        let mut text = String::new();
        for [x, y] in &corners {
            text += &format!("v {} {} {}\n", x + 1e6, y - 2e6, 0.3 * x);
        }
        text += "f";
        for i in 0..n {
            text += &format!(" {}", i + 1);
        }
        let folder = tempfile::tempdir().expect("folder");
        let path = folder.path().join("a.obj");
        std::fs::write(&path, text).expect("written");
        let mesh = models::read(&path).expect("read").model.mesh;
        let doubled = |[x, y]: [f64; 2], [u, v]: [f64; 2]| x * v - y * u;
        let exact: f64 = (0..n).map(|i| doubled(corners[i], corners[(i + 1) % n])).sum();
        let found: f32 = mesh
            .triangles
            .iter()
            .map(|t| {
                // Seen from above: y of the file is z.
                let [a, b, c] = t.map(|i| mesh.positions[i as usize]);
                (b.x - a.x) * (c.z - a.z) - (b.z - a.z) * (c.x - a.x)
            })
            .map(f32::abs)
            .sum();
        assert!((f64::from(found) - exact).abs() < 1e-4 * exact.max(1.0), "{found} {exact}");
    }
}
