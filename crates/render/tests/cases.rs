//! Files as people bring them, made small after public bug reports of other tools: `data/cases/README.md` says which.
//! Where there is a `reference`, the model must look like that one, which has nothing unusual.

use lumi_core::color::srgb_decode;
use lumi_core::glam::{Vec2, Vec3, Vec4};
use lumi_render::material::{Coords, Surface};
use lumi_render::models::{self, Import};
use lumi_render::scene::mesh::Model;
use std::path::{Path, PathBuf};

/// Colour of the plain cases.
const BLUE: Vec3 = Vec3::new(0.2, 0.5, 0.7);
const GREY: Vec3 = Vec3::splat(0.8);

fn case(name: &str, folder: &str) -> PathBuf {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/cases");
    root.join(name).join(folder)
}

/// The model of a folder of a case.
fn read(name: &str, folder: &str) -> Import {
    let folder = case(name, folder);
    let file = ["a.obj", "a.glb"].map(|n| folder.join(n));
    let file = file.iter().find(|f| f.exists()).expect("a model");
    models::read(file).expect("read")
}

/// What a corner of a triangle shows.
fn corner(model: &Model, face: usize, corner: usize) -> (Vec3, Vec3, Surface) {
    let mesh = &model.mesh;
    let v = mesh.triangles[face][corner] as usize;
    let surface = model.materials[mesh.material[face] as usize].surface(&Coords {
        solid: mesh.coords[v],
        uv: [mesh.coords[v].truncate(), Vec2::ZERO],
        color: mesh.colors.get(v).copied().unwrap_or(Vec4::ONE),
    });
    (mesh.positions[v], mesh.normals[v], surface)
}

/// Both fill the ball alike and are made of the same.
fn same(name: &str, folder: &str, reference: &str) {
    let (mut a, mut b) = (read(name, folder).model, read(name, reference).model);
    a.mesh.normalise();
    b.mesh.normalise();
    assert_eq!(a.mesh.triangles.len(), b.mesh.triangles.len());
    for face in 0..a.mesh.triangles.len() {
        for c in 0..3 {
            let ((p, n, s), (q, m, t)) = (corner(&a, face, c), corner(&b, face, c));
            assert!(p.distance(q) < 1e-4, "{name} {face} {c}: {p} {q}");
            assert!(n.distance(m) < 1e-3, "{name} {face} {c}: {n} {m}");
            assert!(
                s.base.distance(t.base) < 1e-5,
                "{name} {face} {c}: {s:?} {t:?}"
            );
            assert_eq!(s.metallic, t.metallic);
        }
    }
}

/// The one colour of a model, and that nothing was warned about.
fn color(import: &Import) -> Vec3 {
    assert_eq!(import.warnings, Vec::<String>::new());
    colors(&import.model)
}

fn colors(model: &Model) -> Vec3 {
    let base = |face| corner(model, face, 0).2.base;
    for face in 0..model.mesh.triangles.len() {
        assert!(base(face).distance(base(0)) < 1e-6);
    }
    base(0)
}

/// A cube has its eight corners and twelve triangles.
fn is_cube(import: &Import, low: Vec3, high: Vec3) {
    assert_eq!(import.model.mesh.triangles.len(), 12);
    let (l, h) = import.model.mesh.bounds();
    assert!(l.distance(low) < 1e-5 && h.distance(high) < 1e-5, "{l} {h}");
}

/// (x, y, z) ↦ (x, −z, y) of the unit cube.
const LOW: Vec3 = Vec3::new(0.0, -1.0, 0.0);
const HIGH: Vec3 = Vec3::new(1.0, 0.0, 1.0);

#[test]
fn attributes_of_applications_are_ignored() {
    let import = read("01-gltf-custom-attribute", "models");
    assert_eq!(color(&import), BLUE);
    is_cube(&import, LOW, HIGH);
    same("01-gltf-custom-attribute", "models", "reference");
}

/// A grid of 55 × 55 vertices in one accessor, and 2000 primitives that each use three of them.
fn shared() -> Vec<u8> {
    let side = 55_u16;
    let mut bin = Vec::new();
    for i in 0..side * side {
        let p = [f32::from(i % side), f32::from(i / side), 0.0];
        bin.extend(p.iter().flat_map(|v| v.to_le_bytes()));
    }
    let vertices = bin.len();
    let (mut primitives, mut accessors) = (Vec::new(), Vec::new());
    for k in 0..2000_u16 {
        let i = k / (side - 1) * side + k % (side - 1);
        bin.extend([i, i + 1, i + side].iter().flat_map(|v| v.to_le_bytes()));
        let n = k + 1;
        primitives.push(format!(
            r#"{{"attributes":{{"POSITION":0,"NORMAL":0}},"indices":{n}}}"#
        ));
        accessors.push(format!(
            r#"{{"bufferView":1,"byteOffset":{},"componentType":5123,"count":3,"type":"SCALAR"}}"#,
            6 * k
        ));
    }
    let json = format!(
        r#"{{"asset":{{"version":"2.0"}},"nodes":[{{"mesh":0}}],"meshes":[{{"primitives":[{}]}}],
        "accessors":[{{"bufferView":0,"componentType":5126,"count":{},"type":"VEC3","min":[0,0,0],"max":[54,54,0]}},{}],
        "bufferViews":[{{"buffer":0,"byteLength":{vertices}}},
        {{"buffer":0,"byteOffset":{vertices},"byteLength":{}}}],"buffers":[{{"byteLength":{}}}]}}"#,
        primitives.join(","),
        side * side,
        accessors.join(","),
        bin.len() - vertices,
        bin.len()
    );
    glb(json, bin)
}

fn glb(json: String, bin: Vec<u8>) -> Vec<u8> {
    let (mut json, mut bin) = (json.into_bytes(), bin);
    json.resize(json.len().next_multiple_of(4), b' ');
    bin.resize(bin.len().next_multiple_of(4), 0);
    let mut glb = b"glTF\x02\0\0\0".to_vec();
    glb.extend((28 + json.len() as u32 + bin.len() as u32).to_le_bytes());
    for (kind, chunk) in [(b"JSON", json), (b"BIN\0", bin)] {
        glb.extend((chunk.len() as u32).to_le_bytes());
        glb.extend(kind);
        glb.extend(chunk);
    }
    glb
}

#[test]
fn shared_accessors_are_not_copied_for_each_primitive() {
    // 02-gltf-shared-accessors-oom: six million vertices when each primitive had all of them.
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path().join("a.glb");
    std::fs::write(&path, shared()).expect("written");
    let mesh = models::read(&path).expect("read").model.mesh;
    assert_eq!((mesh.triangles.len(), mesh.positions.len()), (2000, 6000));
    // The last one: 1999 = 37 · 54 + 1.
    let at = |c: usize| mesh.positions[mesh.triangles[1999][c] as usize];
    let expected = [[1.0, 37.0], [2.0, 37.0], [1.0, 38.0]].map(|[x, y]| Vec3::new(x, 0.0, y));
    assert_eq!([0, 1, 2].map(at), expected);
}

#[test]
fn one_number_is_a_grey() {
    let import = read("03-mtl-kd-one-number-panic", "models");
    assert_eq!(color(&import), Vec3::splat(0.5));
    is_cube(&import, LOW, HIGH);
}

#[test]
fn faces_with_and_without_texture_coordinates() {
    let name = "04-obj-mixed-v-vt-scrambled";
    let (import, reference) = (read(name, "models"), read(name, "reference"));
    assert_eq!(import.warnings, Vec::<String>::new());
    for face in 0..12 {
        for c in 0..3 {
            let (p, _, s) = corner(&import.model, face, c);
            let (q, _, t) = corner(&reference.model, face, c);
            assert_eq!(p, q);
            // The first two triangles are the face without, which is at (0, 0).
            let expected = if face < 2 {
                corner(&reference.model, 0, 0).2
            } else {
                t
            };
            assert_eq!(s.base, expected.base, "{face} {c}");
        }
    }
}

#[test]
fn coordinates_of_maps_keep_their_shape() {
    let name = "07-georeferenced-coordinates";
    let (mut a, mut b) = (read(name, "models").model, read(name, "reference").model);
    a.mesh.normalise();
    b.mesh.normalise();
    // The file itself has three decimals of metres.
    for face in 0..b.mesh.triangles.len() {
        for c in 0..3 {
            let ((p, n, _), (q, m, _)) = (corner(&a, face, c), corner(&b, face, c));
            assert!(
                p.distance(q) < 1e-3 && n.distance(m) < 0.02,
                "{p} {q}, {n} {m}"
            );
        }
    }
    same(name, "models2", "reference2");
}

#[test]
fn images_win_over_black() {
    let name = "08-mtl-kd-zero-with-map";
    assert_eq!(read(name, "models").warnings, Vec::<String>::new());
    same(name, "models", "reference");
    let lit = (0..12).map(|f| {
        corner(&read(name, "models").model, f, 1)
            .2
            .base
            .max_element()
    });
    assert!(lit.fold(0.0, f32::max) > 0.1);
}

#[test]
fn colours_of_vertices_are_srgb() {
    let expected = 0.8 * srgb_decode(0.5);
    let found = color(&read("10-obj-vertex-colours-srgb", "models"));
    assert!(found.distance(Vec3::splat(expected)) < 1e-6 && (expected - 0.171).abs() < 1e-3);
}

#[test]
fn text_in_any_encoding_and_form() {
    for (name, folder) in [
        ("11-obj-legacy-encoding", "models"),
        ("11-obj-legacy-encoding", "models2"),
        ("13-obj-continuation-and-comments", "models"),
        ("13-obj-continuation-and-comments", "models2"),
        ("14-usemtl-empty-or-tab", "models2"),
        ("15-mtllib-missing-is-silent", "models3"),
    ] {
        let import = read(name, folder);
        assert_eq!(color(&import), BLUE, "{name}/{folder}");
        is_cube(&import, LOW, HIGH);
    }
    // An empty name is no material.
    assert_eq!(color(&read("14-usemtl-empty-or-tab", "models")), GREY);
}

#[test]
fn missing_libraries_and_materials_are_named_once() {
    for (folder, names) in [
        ("models", &["`b.mtl`", "`m`"][..]),
        ("models2", &["`wrong`"]),
    ] {
        let import = read("15-mtllib-missing-is-silent", folder);
        let [warning] = &*import.warnings else {
            panic!("{:?}", import.warnings);
        };
        assert!(names.iter().all(|n| warning.contains(n)), "{warning}");
        assert_eq!(colors(&import.model), GREY);
    }
}

#[test]
fn textures_in_other_formats_and_places() {
    let name = "16-texture-file-stops-everything";
    let tga = read(name, "models");
    assert_eq!(tga.warnings, Vec::<String>::new());
    // The first pixel of the file, which is its bottom left.
    let expected = Vec3::from([0x28, 0x3c, 0xdc_u8].map(|v| srgb_decode(f32::from(v) / 255.0)));
    let pixel = tga.model.materials[1].surface(&Coords::solid(Vec3::new(0.01, 0.99, 0.0)));
    assert!(pixel.base.distance(expected) < 1e-5, "{pixel:?}");
    // By the last part of a path of another machine.
    same(name, "models2", "../08-mtl-kd-zero-with-map/reference");
    assert_eq!(read(name, "models2").warnings, Vec::<String>::new());
    let missing = read(name, "models3");
    assert_eq!(missing.warnings.len(), 1);
    assert!(
        missing.warnings[0].contains("`t.png`"),
        "{:?}",
        missing.warnings
    );
    assert_eq!(colors(&missing.model), Vec3::ONE);
}

#[test]
fn options_end_where_names_begin() {
    let import = read("17-map-options-with-spaces", "models");
    let plain = read("08-mtl-kd-zero-with-map", "reference");
    assert_eq!(import.warnings, Vec::<String>::new());
    // Twice as often both ways from the bottom left.
    let at = |import: &Import, u: f32, v: f32| {
        let material = &import.model.materials[1];
        material
            .surface(&Coords::solid(Vec3::new(u, 1.0 - v, 0.0)))
            .base
    };
    for (u, v) in [(0.1, 0.05), (0.3, 0.2), (0.45, 0.4)] {
        assert!(at(&import, u, v).distance(at(&plain, 2.0 * u, 2.0 * v)) < 1e-5);
        assert!(at(&import, u + 0.5, v).distance(at(&import, u, v)) < 1e-5);
    }
}

#[test]
fn reflectance_is_as_khronos_defines_it() {
    let name = "19-gltf-ior1000-becomes-mirror";
    let surface = |folder: &str| {
        let import = read(name, folder);
        assert_eq!(import.warnings, Vec::<String>::new());
        corner(&import.model, 0, 0).2
    };
    let head_on = |s: &Surface| (0.04 * s.specular * s.specular_color).min(Vec3::ONE);
    let plastic = surface("models");
    assert!(
        head_on(&plastic).distance(Vec3::splat(0.04)) < 3e-4,
        "{plastic:?}"
    );
    assert_eq!((plastic.base, plastic.specular_weight), (BLUE, 1.0));
    let gold = surface("models2");
    let expected = Vec3::new(1.0, 0.766, 0.336);
    assert!(head_on(&gold).distance(expected) < 1e-5, "{gold:?}");
    assert_eq!(head_on(&surface("reference")), Vec3::splat(0.04));
}

#[test]
fn skins_are_evaluated_and_their_nodes_ignored() {
    for folder in ["models", "models2"] {
        same("20-gltf-skinned-node-transform", folder, "reference");
        assert_eq!(
            read("20-gltf-skinned-node-transform", folder).warnings,
            Vec::<String>::new()
        );
    }
}

#[test]
fn textures_without_an_image_are_left_out() {
    let name = "22-gltf-texture-without-source";
    let import = read(name, "models");
    assert_eq!(colors(&import.model), Vec3::ONE);
    let named = |what: &str| import.warnings.iter().filter(|w| w.contains(what)).count();
    assert_eq!(
        (named("textures[0]"), named("FOO_x")),
        (1, 1),
        "{:?}",
        import.warnings
    );
    // WebP is read.
    let import = read(name, "models2");
    let webp = color(&import);
    assert!(webp.distance(Vec3::ONE) > 0.1, "{webp}");
}

#[test]
fn hidden_nodes_do_not_frame_the_picture() {
    let name = "23-gltf-hidden-node-spoils-framing";
    same(name, "models", "reference");
    let warnings = read(name, "models").warnings;
    assert!(
        warnings.len() == 1 && warnings[0].contains("scaled to nothing"),
        "{warnings:?}"
    );
}
