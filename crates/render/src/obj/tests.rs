use super::*;
use crate::material::{Coords, Material, Opacity, Textured};
use crate::scene::mesh::Mesh;
use lumi_core::color::srgb_decode;
use lumi_core::glam::{Vec2, Vec3};
use tempfile::TempDir;

const SQUARE: &str = "mtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\n\
    usemtl red\nf 1/1 2/2 3/3 4/4\n";

/// A model's folder.
fn files(all: &[(&str, &[u8])]) -> (TempDir, PathBuf) {
    let folder = tempfile::tempdir().expect("folder");
    for (name, bytes) in all {
        let path = folder.path().join(name);
        std::fs::create_dir_all(path.parent().expect("parent")).expect("folder");
        std::fs::write(path, bytes).expect("written");
    }
    let path = folder.path().join("a.obj");
    (folder, path)
}

/// One pixel as PNG.
fn dot(pixel: [u8; 4]) -> Vec<u8> {
    let mut png = std::io::Cursor::new(Vec::new());
    let image = image::RgbaImage::from_pixel(1, 1, image::Rgba(pixel));
    image
        .write_to(&mut png, image::ImageFormat::Png)
        .expect("png");
    png.into_inner()
}

/// The square with this library and these images.
fn square(mtl: &str, images: &[(&str, &[u8])]) -> Import {
    let all = [
        &[("a.obj", SQUARE.as_bytes()), ("a.mtl", mtl.as_bytes())],
        images,
    ]
    .concat();
    read(&files(&all).1).expect("read")
}

fn textured(import: &Import) -> &Textured {
    match import.model.materials.last() {
        Some(Material::Textured(t)) => t,
        other => panic!("{other:?}"),
    }
}

fn mesh(text: &str) -> Mesh {
    read(&files(&[("a.obj", text.as_bytes())]).1)
        .expect("read")
        .model
        .mesh
}

#[test]
fn reads_faces_materials_and_images() {
    let red = dot([255, 0, 0, 255]);
    let mtl =
        "newmtl red\nKd 1 0.5 0.5\nNs 250\nPm 0.25\nKs 0.5 0.5 0.5\nPc 0.5\nmap_Kd red dot.png\n";
    let import = square(mtl, &[("red dot.png", &red)]);
    assert_eq!(import.warnings, Vec::<String>::new());
    let mesh = &import.model.mesh;
    assert_eq!(mesh.triangles.len(), 2);
    assert_eq!(mesh.bounds(), (Vec3::ZERO, Vec3::new(1.0, 0.0, 1.0)));
    assert!(mesh.normals.iter().all(|n| n.distance(Vec3::NEG_Y) < 1e-6));
    let s = import.model.materials[mesh.material[0] as usize].surface(&Coords::solid(Vec3::ONE));
    assert_eq!((s.base, s.metallic, s.roughness), (Vec3::X, 0.25, 0.5));
    assert_eq!((s.specular, s.coat), (1.0, 0.5));
}

#[test]
fn sharp_edges_stay_sharp_and_flat_ones_are_smooth() {
    // A roof of 90° and a nearly flat pair share their middle edges.
    for (height, smooth) in [(1.0, false), (0.1, true)] {
        let mesh = mesh(&format!(
            "v -1 0 0\nv -1 1 0\nv 0 0 {height}\nv 0 1 {height}\nv 1 0 0\nv 1 1 0\nf 1 3 4 2\nf 3 5 6 4\n"
        ));
        let top: Vec<Vec3> = mesh
            .positions
            .iter()
            .zip(&mesh.normals)
            .filter(|(p, _)| p.x == 0.0)
            .map(|(_, n)| *n)
            .collect();
        let spread = top.iter().any(|n| n.dot(top[0]) < 0.9);
        assert_eq!(spread, !smooth, "{height}: {top:?}");
        // Smooth corners are shared.
        assert_eq!(mesh.positions.len(), if smooth { 6 } else { 8 });
    }
}

#[test]
fn broken_files_are_errors_that_name_the_file_and_the_line() {
    for (text, place) in [
        ("", "faces"),
        ("# nothing\n", "faces"),
        ("v 0 0 0\nl 1 1\n", "faces"),
        (
            "v 0 0 0\nf 1 2 3\n",
            "line 2: expected vertices 1 to 1, found 2",
        ),
        ("v 0 0 0\n\nf 1 1 -2\n", "line 3: expected vertices"),
        ("v 0 0 0\nf 1 1 0\n", "line 2: expected corners"),
        ("v a b c\n", "line 1: expected a number, found `a`"),
        ("v 0 0\n", "line 1: expected 3 numbers"),
        (
            "v 0 0 0\nv 1 0 0\nv nan 1 0\nf 1 2 3\n",
            "line 4: expected finite",
        ),
        (
            "v 0 0 0\nv 1 0 0\nv 1e300 1 0\nf 1 2 3\n",
            "expected positions below",
        ),
        (
            "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 99999999999999\n",
            "line 4: expected vertices",
        ),
        (
            "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3/1/1/1\n",
            "line 4: expected corners",
        ),
        ("\u{feff}v 0 0 0\nf 1 \\\n2 x\n", "line 2: expected corners"),
    ] {
        let (_folder, path) = files(&[("a.obj", text.as_bytes())]);
        let message = read(&path).expect_err(text).to_string();
        assert!(
            message.contains("a.obj") && message.contains(place),
            "{message}"
        );
    }
    let (_folder, path) = files(&[("a.obj", b"\xff\xfev\0 \0")]);
    assert!(
        read(&path)
            .expect_err("wide")
            .to_string()
            .contains("UTF-16")
    );
}

#[test]
fn mixed_faces_keep_what_they_have() {
    // Without and with texture coordinates and normals, some of which do not exist; NaN where no face looks.
    let text = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv nan nan nan\nvt 0.25 0.75\nvt -nan(ind) 0\nvn 0 0 3\nvn 0 0 0\n\
        f 1 2 3\nf 1/1/1 3/1/1 4/2/2\nf 2/7 3/1/9 4//1\nf 1/0/0 2/1 3/1/\nf 1 2\n";
    let import = read(&files(&[("a.obj", text.as_bytes())]).1).expect("read");
    let mesh = &import.model.mesh;
    let coord = |face: usize, corner: usize| mesh.coords[mesh.triangles[face][corner] as usize];
    let (none, some) = (Vec3::Y, Vec3::new(0.25, 0.25, 0.0));
    for (face, expected) in [
        (0, [none; 3]),
        (1, [some, some, none]),
        (2, [none, some, none]),
        (3, [none, some, some]),
    ] {
        assert_eq!([0, 1, 2].map(|c| coord(face, c)), expected, "face {face}");
    }
    assert!(mesh.normals.iter().all(|n| n.distance(Vec3::NEG_Y) < 1e-6));
    assert!(import.warnings[0].contains("1 statements are faces with fewer"));
    assert!(
        import.warnings[1].contains("2 corners"),
        "{:?}",
        import.warnings
    );
}

#[test]
fn lines_are_not_filled_and_concave_faces_are_not_convex() {
    let text = "v 0 0 0\nv 4 0 0\nv 4 4 0\nv 2 1 0\nv 0 4 0\nl 1 2 3 1\np 1\nf 1 2 3 4 5\n";
    let import = read(&files(&[("a.obj", text.as_bytes())]).1).expect("read");
    let mesh = &import.model.mesh;
    let area: f32 = mesh
        .triangles
        .iter()
        .map(|t| {
            let [a, b, c] = t.map(|i| mesh.positions[i as usize]);
            0.5 * (b - a).cross(c - a).length()
        })
        .sum();
    // The square without the notch.
    assert!((area - 10.0).abs() < 1e-5, "{area}");
    assert_eq!(import.warnings.len(), 2);
    assert!(import.warnings[0].contains("1 statements are lines"));
}

#[test]
fn colours_of_vertices_are_srgb_and_white_where_missing() {
    let color = |mesh: &Mesh, x: f32| {
        let at = mesh.positions.iter().position(|p| p.x == x);
        mesh.colors[at.expect("vertex")]
    };
    let partly = mesh("v 0 0 0\nv 1 0 0 0.5 0 1\nv 2 1 0 1.0\nf 1 2 3\n");
    assert_eq!(color(&partly, 0.0).truncate(), Vec3::ONE);
    let expected = Vec3::new(srgb_decode(0.5), 0.0, 1.0);
    assert!(color(&partly, 1.0).truncate().distance(expected) < 1e-6);
    assert_eq!(color(&partly, 2.0).truncate(), Vec3::ONE);
    let bytes = mesh("v 0 0 0 255 0 51\nv 1 0 0 0 0 0\nv 2 1 0 0 0 0\nf 1 2 3\n");
    let expected = Vec3::new(1.0, 0.0, srgb_decode(0.2));
    assert!(color(&bytes, 0.0).truncate().distance(expected) < 1e-6);
    assert!(
        mesh("v 0 0 0\nv 1 0 0\nv 2 1 0\nf 1 2 3\n")
            .colors
            .is_empty()
    );
}

#[test]
fn images_take_the_place_of_colours_and_obey_their_options() {
    let red = dot([255, 0, 0, 255]);
    let import = square(
        "newmtl red\nKd 0 0 0\nmap_Kd -s 2 3 1 -o 0.5 0.25 r.png\n",
        &[("r.png", &red)],
    );
    let t = textured(&import);
    assert_eq!(t.factor.base, Vec3::ONE);
    // (u, v) = (0.25, 0.5), v up, is (2·0.25 + 0.5, 3·0.5 + 0.25).
    let at = t.base.as_ref().expect("image").transform;
    let at = at.transform_point2(Vec2::new(0.25, 0.5));
    assert!(at.distance(Vec2::new(1.0, 1.0 - 1.75)) < 1e-6, "{at}");
    // Missing: grey, and one warning whatever uses it.
    let import = square("newmtl red\nKd 0 0 0\nmap_Kd no.png\nmap_d no.png\n", &[]);
    assert_eq!(textured(&import).factor.base, Vec3::splat(0.8));
    assert_eq!(import.warnings.len(), 1, "{:?}", import.warnings);
    assert!(import.warnings[0].contains("`red`") && import.warnings[0].contains("`no.png`"));
    let import = square(
        "newmtl red\nKd 1 0 0\nmap_Kd bad.png\nmap_Pr bad.png\n",
        &[("bad.png", b"no")],
    );
    assert_eq!(textured(&import).factor.base, Vec3::X);
    assert_eq!(import.warnings.len(), 1, "{:?}", import.warnings);
}

#[test]
fn masks_relief_and_glow() {
    let (red, half) = (dot([255, 0, 0, 255]), dot([128, 128, 128, 255]));
    let images: [(&str, &[u8]); 2] = [("r.png", &red), ("h.png", &half)];
    let opacity = |mtl: &str| {
        let import = square(mtl, &images);
        let m = import.model.materials.last().expect("material");
        let at = Coords::solid(Vec3::ZERO);
        (m.opacity(&at), m.surface(&at).base, import.warnings)
    };
    let near = |a: f32, b: f32| (a - b).abs() < 1e-5;
    let (o, base, warnings) = opacity("newmtl red\nmap_Kd r.png\nmap_d h.png\nd 0\n");
    assert!(near(o, 128.0 / 255.0) && base == Vec3::X && warnings.is_empty());
    let (o, base, _) = opacity("newmtl red\nKd 0 1 0\nmap_d h.png\n");
    assert!(near(o, 128.0 / 255.0) && base == Vec3::Y);
    let (o, _, warnings) = opacity("newmtl red\nTr 1\n");
    assert!(o == 0.0 && warnings[0].contains("cannot be seen"));

    // Blender writes normal maps as map_Bump.
    let import = square("newmtl red\nmap_Bump -bm 0.5 r.png\nKe 1 0 0\n", &images);
    let normal = textured(&import).normal.as_ref().expect("normals");
    assert_eq!(normal.scale, 0.5);
    assert!(
        import
            .model
            .mesh
            .tangents
            .iter()
            .flatten()
            .all(|t| t.x.abs() > 0.99)
    );
    assert!(import.warnings[0].contains("own light"));
    let import = square("newmtl red\nbump h.png\n", &images);
    assert!(textured(&import).normal.is_none() && import.warnings[0].contains("heights"));
}

#[test]
fn libraries_are_found_or_named() {
    let warnings = |obj: &str, others: &[(&str, &[u8])]| {
        let all = [&[("a.obj", obj.as_bytes())], others].concat();
        let import = read(&files(&all).1).expect("read");
        (import.model.materials.len() - 1, import.warnings)
    };
    let none = Vec::<String>::new();
    let face = "v 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl m\nf 1 2 3\n";
    let with = |line: &str| format!("{line}\n{face}");
    let m: &[u8] = b"newmtl m\nKd 1 0 0\n";
    for (line, name) in [
        ("mtllib b.mtl", "b.mtl"),
        ("mtllib  my lib.mtl  # made by hand", "my lib.mtl"),
        ("mtllib \"b.mtl\"", "b.mtl"),
        ("mtllib C:\\models\\b.mtl", "b.mtl"),
        ("mtllib sub\\b.mtl", "sub/b.mtl"),
        ("mtllib B.MTL", "b.mtl"),
        ("mtllib q.mtl b.mtl", "b.mtl"),
        // The model's own, which nothing names.
        ("", "a.mtl"),
    ] {
        let (made, warnings) = warnings(&with(line), &[(name, m), ("q.mtl", b"newmtl q\n")]);
        assert_eq!((made, warnings), (1, none.clone()), "{line}");
    }
    let (made, all) = warnings(&with("mtllib my lib.mtl b.mtl"), &[]);
    assert_eq!((made, all.len()), (0, 1));
    assert_eq!(
        all[0],
        "material library `my lib.mtl`, `b.mtl` is not there; material `m` shown grey"
    );
    let (_, all) = warnings(&with("mtllib b.mtl\nmtllib c.mtl"), &[("b.mtl", m)]);
    assert_eq!(all, ["material library `c.mtl` is not there"]);
    let (_, all) = warnings(face, &[]);
    assert_eq!(all, ["material `m` is in no material library; shown grey"]);
    let (_, all) = warnings(&with("mtllib b.mtl"), &[("b.mtl", b"newmtl m\nKd x\n")]);
    assert_eq!(
        all,
        ["b.mtl: line 2: Kd: expected one to three numbers, found `x`; left out"]
    );
    // Comments behind names, on either side, and names with spaces and `#`.
    for (used, defined) in [
        ("m # red", "m"),
        ("m #2", "m #2"),
        ("my m", "my m # new"),
        ("m\t", "m"),
    ] {
        let obj = face.replace("usemtl m", &format!("mtllib b.mtl\nusemtl\t{used}"));
        let mtl = format!("newmtl {defined}\nKd 1 0 0\n");
        let (made, warnings) = warnings(&obj, &[("b.mtl", mtl.as_bytes())]);
        assert_eq!((made, warnings), (1, none.clone()), "{used}");
    }
}

#[test]
fn images_are_beside_their_library() {
    let red = dot([255, 0, 0, 255]);
    let obj = SQUARE.replace("a.mtl", "sub/a.mtl");
    let mtl = b"newmtl red\nmap_Kd tex\\r.png\nmap_Pr up.png\n";
    let all: [(&str, &[u8]); 4] = [
        ("a.obj", obj.as_bytes()),
        ("sub/a.mtl", mtl),
        ("sub/tex/r.png", &red),
        ("up.png", &red),
    ];
    let import = read(&files(&all).1).expect("read");
    assert_eq!(import.warnings, Vec::<String>::new());
    let t = textured(&import);
    assert!(t.base.is_some() && t.metallic_roughness.is_some());
    assert_eq!(t.opacity, Opacity::Opaque);
}

#[test]
fn far_coordinates_keep_their_shape() {
    let corner =
        |dx: f64, dy: f64| format!("v {:.3} {:.3} 50\n", 587_326.86 + dx, 5_970_228.5 + dy);
    let text = corner(0.0, 0.0) + &corner(0.123, 0.0) + &corner(0.123, 0.456) + "f 1 2 3\n";
    let (low, high) = mesh(&text).bounds();
    assert!(
        (high - low).distance(Vec3::new(0.123, 0.0, 0.456)) < 1e-6,
        "{low} {high}"
    );
}
