use super::*;
use crate::material::{Coords, Material};
use crate::models;
use lumi_core::glam::Vec2;

/// A quad in glTF's xy plane, moved up by 2, with a red texture of one pixel.
fn quad() -> Vec<u8> {
    let mut png = std::io::Cursor::new(Vec::new());
    let red = image::RgbImage::from_pixel(1, 1, image::Rgb([255, 0, 0]));
    red.write_to(&mut png, image::ImageFormat::Png)
        .expect("png");
    let mut bin = Vec::new();
    for p in [
        [0.0_f32, 0.0, 0.0],
        [1.0, 0.0, 0.0],
        [1.0, 1.0, 0.0],
        [0.0, 1.0, 0.0],
    ] {
        bin.extend(p.iter().flat_map(|v| v.to_le_bytes()));
    }
    for uv in [[0.0_f32, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]] {
        bin.extend(uv.iter().flat_map(|v| v.to_le_bytes()));
    }
    bin.extend([0_u16, 1, 2, 0, 2, 3].iter().flat_map(|v| v.to_le_bytes()));
    let image = bin.len();
    bin.extend(png.get_ref());
    let length = png.get_ref().len();
    bin.resize(bin.len().next_multiple_of(4), 0);
    let json = format!(
        r#"{{"asset":{{"version":"2.0"}},"scene":0,"scenes":[{{"nodes":[0]}}],
        "nodes":[{{"children":[1],"translation":[0,2,0]}},{{"mesh":0}}],
        "meshes":[{{"primitives":[{{"attributes":{{"POSITION":0,"TEXCOORD_0":1}},"indices":2,"material":0}}]}}],
        "materials":[{{"pbrMetallicRoughness":{{"baseColorTexture":{{"index":0}},"metallicFactor":0,"roughnessFactor":0.4}}}}],
        "textures":[{{"source":0}}],"images":[{{"bufferView":3,"mimeType":"image/png"}}],
        "accessors":[{{"bufferView":0,"componentType":5126,"count":4,"type":"VEC3","min":[0,0,0],"max":[1,1,0]}},
        {{"bufferView":1,"componentType":5126,"count":4,"type":"VEC2"}},
        {{"bufferView":2,"componentType":5123,"count":6,"type":"SCALAR"}}],
        "bufferViews":[{{"buffer":0,"byteOffset":0,"byteLength":48}},{{"buffer":0,"byteOffset":48,"byteLength":32}},
        {{"buffer":0,"byteOffset":80,"byteLength":12}},{{"buffer":0,"byteOffset":{image},"byteLength":{length}}}],
        "buffers":[{{"byteLength":{}}}]}}"#,
        bin.len()
    );
    let mut json = json.into_bytes();
    json.resize(json.len().next_multiple_of(4), b' ');
    let mut glb = Vec::new();
    glb.extend(b"glTF");
    glb.extend(2_u32.to_le_bytes());
    glb.extend((12 + 8 + json.len() as u32 + 8 + bin.len() as u32).to_le_bytes());
    for (kind, chunk) in [(b"JSON", &json), (b"BIN\0", &bin)] {
        glb.extend((chunk.len() as u32).to_le_bytes());
        glb.extend(kind);
        glb.extend(chunk);
    }
    glb
}

fn write(bytes: &[u8]) -> (tempfile::TempDir, std::path::PathBuf) {
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path().join("model.glb");
    std::fs::write(&path, bytes).expect("written");
    (folder, path)
}

/// The quad with its JSON changed, the binary chunk as it was.
fn changed(from: &str, to: &str) -> Vec<u8> {
    let good = quad();
    let n = u32::from_le_bytes([good[12], good[13], good[14], good[15]]) as usize;
    let json = std::str::from_utf8(&good[20..20 + n]).expect("text");
    assert!(json.contains(from), "{from}");
    let mut json = json.trim_end().replace(from, to).into_bytes();
    json.resize(json.len().next_multiple_of(4), b' ');
    let rest = &good[20 + n..];
    let mut glb = Vec::new();
    glb.extend(b"glTF");
    glb.extend(2_u32.to_le_bytes());
    glb.extend((20 + json.len() as u32 + rest.len() as u32).to_le_bytes());
    glb.extend((json.len() as u32).to_le_bytes());
    glb.extend(b"JSON");
    glb.extend(json);
    glb.extend(rest);
    glb
}

#[test]
fn reads_a_textured_quad_and_turns_it_z_up() {
    let (folder, path) = write(&quad());
    let listed = models::list(folder.path()).expect("listed");
    assert_eq!(listed, std::slice::from_ref(&path));
    let import = models::read(&path).expect("read");
    assert_eq!(import.warnings, Vec::<String>::new());
    let model = import.model;
    assert_eq!(model.mesh.triangles.len(), 2);
    let (lo, hi) = model.mesh.bounds();
    assert!(lo.distance(Vec3::new(0.0, 0.0, 2.0)) < 1e-6, "{lo}");
    assert!(hi.distance(Vec3::new(1.0, 0.0, 3.0)) < 1e-6, "{hi}");
    // It faced glTF's +z, which is our −y.
    assert!(model.mesh.normals[0].distance(Vec3::NEG_Y) < 1e-6);
    let surface = model.materials[0].surface(&Coords::solid(Vec3::new(0.5, 0.5, 0.0)));
    assert_eq!((surface.base, surface.metallic), (Vec3::X, 0.0));
    assert!((surface.roughness - 0.4).abs() < 1e-6);
}

#[test]
fn without_scenes_children_still_follow_their_parents() {
    let with = r#""scene":0,"scenes":[{"nodes":[0]}],
        "nodes":[{"children":[1],"translation":[0,2,0]},{"mesh":0}]"#;
    let without = r#""nodes":[{"mesh":0},{"children":[0],"translation":[0,2,0]}]"#;
    let (_folder, path) = write(&changed(with, without));
    let (lo, hi) = models::read(&path).expect("read").model.mesh.bounds();
    assert!(lo.distance(Vec3::new(0.0, 0.0, 2.0)) < 1e-6, "{lo}");
    assert!(hi.distance(Vec3::new(1.0, 0.0, 3.0)) < 1e-6, "{hi}");
}

#[test]
fn materials_carry_every_feature() {
    let bytes = changed(
        r#""roughnessFactor":0.4}"#,
        r#""roughnessFactor":0.4,"baseColorFactor":[1,1,1,0.25]},"alphaMode":"BLEND","doubleSided":true,
        "normalTexture":{"index":0,"scale":0.5,"texCoord":1,"extensions":{"KHR_texture_transform":
        {"offset":[0.5,0],"rotation":1.5707964,"scale":[2,1]}}},"emissiveFactor":[1,0,0],
        "extensions":{"KHR_materials_clearcoat":{"clearcoatFactor":0.5},"KHR_materials_specular":{"specularFactor":0.5},
        "KHR_materials_ior":{"ior":2.0}}"#,
    );
    let import = read(&write(&bytes).1).expect("read");
    let Material::Textured(t) = &import.model.materials[0] else {
        panic!("textured");
    };
    assert_eq!(t.factor.coat, 0.5);
    // An index of 2 reflects 1/9; half of it at all angles.
    assert!((t.factor.specular - 1.0 / 9.0 / 0.04).abs() < 1e-5);
    assert_eq!(t.factor.specular_weight, 0.5);
    assert_eq!(
        import.model.materials[0].opacity(&Coords::solid(Vec3::ZERO)),
        0.25
    );
    let normal = t.normal.as_ref().expect("normal map");
    assert_eq!((normal.scale, normal.texture.set), (0.5, 1));
    // (u, v) = (0.25, 0) is scaled to 0.5, turned to −v, and moved by half.
    let at = normal
        .texture
        .transform
        .transform_point2(Vec2::new(0.25, 0.0));
    assert!(at.distance(Vec2::new(0.5, -0.5)) < 1e-6, "{at}");
    assert!(
        import.warnings[0].contains("own light"),
        "{:?}",
        import.warnings
    );
}

#[test]
fn unknown_extensions_are_named() {
    let used = changed(
        r#""asset""#,
        r#""extensionsUsed":["KHR_materials_sheen","KHR_texture_transform"],"asset""#,
    );
    let warnings = read(&write(&used).1).expect("read").warnings;
    assert_eq!(warnings.len(), 1);
    assert!(warnings[0].contains("KHR_materials_sheen"));
    let required = changed(
        r#""asset""#,
        r#""extensionsUsed":["KHR_draco_mesh_compression"],"extensionsRequired":["KHR_draco_mesh_compression"],"asset""#,
    );
    let message = read(&write(&required).1).expect_err("required").to_string();
    assert!(message.contains("extensionsRequired"), "{message}");
}

#[test]
fn quantised_and_sparse_numbers_are_read() {
    // Normalised bytes as texture coordinates, in the place of the first eight bytes of the positions.
    let bytes = changed(
        r#"{"bufferView":1,"componentType":5126,"count":4,"type":"VEC2"}"#,
        r#"{"bufferView":0,"componentType":5121,"normalized":true,"count":4,"type":"VEC2",
        "sparse":{"count":1,"indices":{"bufferView":2,"byteOffset":2,"componentType":5123},
        "values":{"bufferView":2,"byteOffset":0}}}"#,
    );
    let mesh = read(&write(&bytes).1).expect("read").model.mesh;
    // Sparse element 1 holds the bytes (0, 0) of the first index.
    assert_eq!(mesh.coords[1], Vec3::ZERO);
}

#[test]
fn hostile_numbers_are_errors_that_name_the_file() {
    for (from, to) in [
        (
            r#""count":4,"type":"VEC3""#,
            r#""count":4294967295,"type":"VEC3""#,
        ),
        (r#""count":6"#, r#""count":1000000000"#),
        (
            r#"{"bufferView":0,"componentType":5126,"count":4"#,
            r#"{"componentType":5126,"count":3000000000"#,
        ),
        (r#""byteLength":48"#, r#""byteLength":4800000"#),
        (r#""children":[1]"#, r#""children":[1,1]"#),
        (r#""children":[1]"#, r#""children":[0]"#),
        (r#""children":[1]"#, r#""children":[7]"#),
        (r#""mesh":0"#, r#""mesh":3"#),
        (r#""indices":2"#, r#""indices":0"#),
        (r#""type":"VEC2""#, r#""type":"VEC3""#),
        (r#""scenes":[{"nodes":[0]}]"#, r#""scenes":[{"nodes":[]}]"#),
    ] {
        let (_folder, path) = write(&changed(from, to));
        let message = read(&path).expect_err(to).to_string();
        assert!(message.contains("model.glb"), "{message}");
    }
}

#[test]
fn broken_files_are_errors() {
    let good = quad();
    for n in (0..good.len()).step_by(37) {
        let (_folder, path) = write(&good[..n]);
        let message = read(&path).expect_err("cut").to_string();
        assert!(message.contains("model.glb"), "{message}");
    }
}

#[test]
fn what_cannot_be_shown_is_left_out_and_the_rest_is_shown() {
    for (from, to, warning) in [
        (r#""TEXCOORD_0":1"#, r#""TEXCOORD_0":1,"_BATCHID":1"#, None),
        (
            r#""TEXCOORD_0":1"#,
            r#""TEXCOORD_0":1,"BATCHID":1"#,
            Some("1 attributes"),
        ),
        (
            r#""primitives":["#,
            r#""primitives":[{"attributes":{"NORMAL":0}},"#,
            Some("1 primitives have no POSITION"),
        ),
        (
            r#""textures":[{"source":0}]"#,
            r#""textures":[{}]"#,
            Some("textures[0]"),
        ),
        (
            r#"{"bufferView":3,"mimeType":"image/png"}"#,
            r#"{"uri":"no.png"}"#,
            Some("images[0]: `no.png` is not there"),
        ),
        (
            r#"{"bufferView":3,"mimeType":"image/png"}"#,
            r#"{"bufferView":2,"mimeType":"image/png"}"#,
            Some("images[0]: expected a PNG"),
        ),
        (
            r#"{"mesh":0}"#,
            r#"{"mesh":0,"weights":[0.5]}"#,
            Some("morph targets"),
        ),
        (r#"{"mesh":0}"#, r#"{"mesh":0,"weights":[0]}"#, None),
        (
            r#""metallicFactor":0"#,
            r#""metallicFactor":0,"baseColorFactor":[2,1,1,1]"#,
            Some("base colour is not within 0 and 1"),
        ),
    ] {
        let (_folder, path) = write(&changed(from, to));
        let import = read(&path).expect(to);
        assert_eq!(import.model.mesh.triangles.len(), 2, "{to}");
        let found: Vec<&str> = import.warnings.iter().map(String::as_str).collect();
        match warning {
            None => assert_eq!(found, [""; 0], "{to}"),
            Some(text) => assert!(found.len() == 1 && found[0].contains(text), "{found:?}"),
        }
        let surface = import.model.materials[0].surface(&Coords::solid(Vec3::ZERO));
        assert!(surface.base.max_element() <= 1.0);
    }
}

#[test]
fn hidden_nodes_are_not_shown_but_move_their_joints() {
    let hidden = changed(
        r#"[{"children":[1],"translation":[0,2,0]},{"mesh":0}]"#,
        r#"[{"children":[1,2],"translation":[0,2,0]},{"mesh":0},{"mesh":0,"children":[3],"translation":[9,0,0],
        "extensions":{"KHR_node_visibility":{"visible":false}}},{"mesh":0}]"#,
    );
    let import = read(&write(&hidden).1).expect("read");
    assert_eq!(import.warnings, Vec::<String>::new());
    assert_eq!(import.model.mesh.triangles.len(), 2);
    assert!(import.model.mesh.bounds().1.x < 1.5);
}

#[test]
fn specular_glossiness_is_reflectance_and_the_rest_of_roughness() {
    let bytes = changed(
        r#""materials":[{"#,
        r#""materials":[{"extensions":{"KHR_materials_pbrSpecularGlossiness":{"diffuseFactor":[0.5,0.25,0,1],
        "specularFactor":[1,0.5,0.25],"glossinessFactor":0.75,"specularGlossinessTexture":{"index":0}}},"#,
    );
    let import = read(&write(&bytes).1).expect("read");
    assert_eq!(import.warnings, Vec::<String>::new());
    let s = import.model.materials[0].surface(&Coords::solid(Vec3::ZERO));
    // The image is red and opaque.
    assert_eq!(0.04 * s.specular * s.specular_color, Vec3::X);
    assert_eq!((s.base, s.metallic), (Vec3::new(0.5, 0.25, 0.0), 0.0));
    assert!((s.roughness - 0.25).abs() < 0.5 / 255.0, "{}", s.roughness);
}

#[test]
fn rotations_of_any_length_turn_by_their_direction() {
    // A quarter about y, not normalised, under a parent far away in f64.
    let bytes = changed(
        r#""translation":[0,2,0]},{"mesh":0}"#,
        r#""translation":[4000000.25,2,0]},{"mesh":0,"rotation":[0,2,0,2],"scale":[1,1,3]}"#,
    );
    let mesh = read(&write(&bytes).1).expect("read").model.mesh;
    // x becomes −z, which is our y; recentred, since it is far off.
    let (low, high) = mesh.bounds();
    assert!(low.distance(Vec3::new(0.0, -0.0, -0.5)) < 0.51, "{low}");
    assert!(
        (high - low).distance(Vec3::new(0.0, 1.0, 1.0)) < 1e-6,
        "{low} {high}"
    );
}

#[test]
fn positions_that_the_file_itself_has_rounded_are_told() {
    // Floats of four million have steps of a half.
    let (_folder, path) = write(&quad());
    let mut bytes = std::fs::read(&path).expect("read");
    let json = u32::from_le_bytes([bytes[12], bytes[13], bytes[14], bytes[15]]) as usize;
    for vertex in 0..4 {
        let at = 28 + json + 12 * vertex;
        let x = f32::from_le_bytes([bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]]);
        bytes[at..at + 4].copy_from_slice(&(x + 4e6).to_le_bytes());
    }
    std::fs::write(&path, bytes).expect("written");
    let warnings = read(&path).expect("read").warnings;
    assert!(
        warnings.len() == 1 && warnings[0].contains("steps of 0.48"),
        "{warnings:?}"
    );
}

#[test]
fn glbs_that_say_they_are_shorter_than_their_header_are_errors() {
    for length in [0_u32, 11, 12, 19] {
        let mut bytes = quad();
        bytes[8..12].copy_from_slice(&length.to_le_bytes());
        let message = read(&write(&bytes).1).expect_err("short").to_string();
        assert!(
            message.contains(&format!("or more, found {length}")),
            "{message}"
        );
    }
}
