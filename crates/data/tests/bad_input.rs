//! Broken scenes end in one clear error that names the file and the field, never in a panic.
#![allow(clippy::unwrap_used)]

use lumi_core::glam::{Mat3, Vec3};
use lumi_core::image::write_exr;
use lumi_core::{
    Area, Camera, EnvMap, Environment, Light, LightBasis, LinearImage, NamedLight, Point, Role,
    Scene, Similarity, View,
};
use lumi_data::formats::interchange;
use lumi_data::{Manifest, open};
use serde_json::{Value, json};
use std::path::Path;
use std::sync::Arc;
use tempfile::TempDir;

const SIDE: usize = 8;

/// A change to a JSON file, and what the error must say.
type Fault = (fn(&mut Value), &'static [&'static str]);

/// A disc under one light of each kind, seen by four cameras.
fn tiny() -> Scene {
    let camera = |i: usize| Camera::orbit(i as f32, 0.4, 3.0, 0.9, SIDE);
    let view = |i: usize| View {
        name: format!("v{i:02}"),
        role: if i < 3 { Role::Input } else { Role::Target },
        camera: camera(i),
        image: None,
    };
    let disc = |i: usize| {
        let (dx, dy) = ((i % SIDE) as f32 - 3.5, (i / SIDE) as f32 - 3.5);
        if dx * dx + dy * dy < 7.0 {
            [0.25, 0.5, 0.75, 1.0]
        } else {
            [0.0; 4]
        }
    };
    let image = LinearImage {
        width: SIDE,
        height: SIDE,
        pixels: (0..SIDE * SIDE).map(disc).collect(),
    };
    let lights = [
        (
            "env0",
            Light::Environment(Environment::new(
                Arc::new(EnvMap::uniform([0.5, 1.0, 2.0])),
                0.3,
                2.0,
            )),
        ),
        (
            "point0",
            Light::Point(Point::new(Vec3::new(0.0, 2.0, 3.0), 700.0)),
        ),
        (
            "area0",
            Light::Area(Area::facing(
                Vec3::new(2.0, 1.0, 3.0),
                Vec3::ZERO,
                1.5,
                900.0,
            )),
        ),
    ];
    let lights: Vec<NamedLight> = lights
        .into_iter()
        .map(|(name, light)| NamedLight {
            name: name.to_owned(),
            light,
        })
        .collect();
    Scene {
        name: "tiny".to_owned(),
        views: (0..4).map(view).collect(),
        to_model: Similarity::to_unit_ball(Vec3::ZERO, 0.9),
        basis: Some(LightBasis {
            radiance: vec![vec![image; 4]; lights.len()],
            lights,
        }),
        lit_by: Vec::new(),
        radiance: Vec::new(),
        warnings: Vec::new(),
    }
}

fn written() -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    interchange::write(folder.path(), &tiny()).unwrap();
    folder
}

/// The message of opening `folder`, which must hold every one of `parts`.
fn refuses(folder: &Path, parts: &[&str]) {
    let opened = open(folder).map(|scene| scene.name);
    let message = opened.expect_err("must fail").to_string();
    for part in parts {
        assert!(message.contains(part), "`{part}` is not in: {message}");
    }
    assert_eq!(message.lines().count(), 1, "{message}");
}

fn change(folder: &Path, file: &str, edit: impl FnOnce(&mut Value)) {
    let path = folder.join(file);
    let mut value: Value = serde_json::from_slice(&std::fs::read(&path).unwrap()).unwrap();
    edit(&mut value);
    std::fs::write(path, value.to_string()).unwrap();
}

#[test]
fn a_written_scene_reads_back() {
    let (folder, scene) = (written(), tiny());
    let back = open(folder.path()).unwrap();
    assert_eq!((back.name.as_str(), back.views.len()), ("tiny", 4));
    assert!((back.to_model.scale - scene.to_model.scale).abs() < 1e-5);
    let (a, b) = (scene.basis.unwrap(), back.basis.unwrap());
    assert_eq!(a.radiance, b.radiance);
    for (a, b) in a.lights.iter().zip(&b.lights) {
        assert_eq!(a.name, b.name);
        match (&a.light, &b.light) {
            (Light::Environment(a), Light::Environment(b)) => {
                assert_eq!((&a.map, a.strength), (&b.map, b.strength));
                assert!(a.orientation().abs_diff_eq(b.orientation(), 1e-6));
            }
            (Light::Point(a), Light::Point(b)) => assert_eq!(a, b),
            (Light::Area(a), Light::Area(b)) => {
                assert!(a.direction().distance(b.direction()) < 1e-6);
                assert!(a.sides()[0].distance(b.sides()[0]) < 1e-6);
                assert_eq!((a.size, a.power), (b.size, b.power));
            }
            _ => panic!("kinds differ"),
        }
    }
    for (a, b) in scene.views.iter().zip(&back.views) {
        assert_eq!((a.role, a.camera), (b.role, b.camera));
    }
    // Without object.json the ball comes from the silhouettes.
    std::fs::remove_file(folder.path().join("object.json")).unwrap();
    let ball = open(folder.path()).unwrap().to_model.inverse();
    assert!(
        ball.translation.length() < 0.01 && (0.7..1.2).contains(&ball.scale),
        "{ball:?}"
    );
}

#[test]
fn folders_that_are_no_scene() {
    let folder = tempfile::tempdir().unwrap();
    refuses(
        folder.path(),
        &["empty folder", "interchange", "transforms"],
    );
    std::fs::write(folder.path().join("notes.txt"), "x").unwrap();
    refuses(
        folder.path(),
        &["expected a scene", "interchange", "transforms"],
    );
    refuses(&folder.path().join("missing"), &["missing"]);
    let both = written();
    std::fs::write(both.path().join("transforms.json"), "{}").unwrap();
    refuses(both.path(), &["interchange and transforms"]);
}

#[test]
fn images_of_the_basis() {
    let folder = written();
    let path = folder.path().join("v01_point0.exr");
    let whole = std::fs::read(&path).unwrap();

    std::fs::write(&path, &whole[..whole.len() / 2]).unwrap();
    refuses(folder.path(), &["v01_point0.exr", "EXR"]);
    std::fs::write(&path, b"garbage").unwrap();
    refuses(
        folder.path(),
        &["v01_point0.exr", "expected a PNG, JPEG, EXR or HDR"],
    );
    write_exr(&path, &LinearImage::new(SIDE, SIDE / 2)).unwrap();
    refuses(
        folder.path(),
        &["v01_point0.exr", "expected 8×8", "found 8×4"],
    );
    exr::prelude::write_rgba_file(&path, SIDE, SIDE, |x, y| {
        (
            if (x, y) == (5, 2) { f32::NAN } else { 0.0 },
            0.0_f32,
            0.0_f32,
            1.0_f32,
        )
    })
    .unwrap();
    refuses(folder.path(), &["v01_point0.exr", "pixel (5, 2)"]);
    std::fs::remove_file(&path).unwrap();
    refuses(folder.path(), &["v01_point0.exr"]);
}

#[test]
fn cameras() {
    let edits: &[Fault] = &[
        (
            |c| c["views"][1]["camera_to_world"][0][0] = json!(5.0),
            &["view `v01`", "camera_to_world", "rotation"],
        ),
        (|c| c["views"][2]["fx"] = json!(-1.0), &["view `v02`", "fx"]),
        (
            |c| c["views"][2]["width"] = json!(0),
            &["view `v02`", "width"],
        ),
        (
            |c| c["views"][2]["role"] = json!("both"),
            &["line 1", "both", "input"],
        ),
        (
            |c| c["views"][0]["name"] = json!("../x"),
            &["views[0].name", "../x"],
        ),
        (
            |c| c["views"][0]["name"] = json!("v01"),
            &["views[1].name", "twice"],
        ),
        (|c| c["views"] = json!([]), &["views", "at least one"]),
        (
            |c| c["convention"] = json!("OpenGL"),
            &["convention", "OpenCV"],
        ),
    ];
    for (edit, parts) in edits {
        let folder = written();
        change(folder.path(), "cameras.json", edit);
        refuses(folder.path(), &[*parts, &["cameras.json"]].concat());
    }
    let folder = written();
    std::fs::write(
        folder.path().join("cameras.json"),
        "{\n \"views\": [\n  {,\n",
    )
    .unwrap();
    refuses(folder.path(), &["cameras.json", "line 3"]);
}

#[test]
fn lights() {
    let edits: &[Fault] = &[
        (
            |l| l[1]["type"] = json!("laser"),
            &["lights[1] `point0`", "env, point, area, spot, sun", "laser"],
        ),
        (
            |l| drop(l[1].as_object_mut().unwrap().remove("power_watts")),
            &["lights[1] `point0`", "power_watts", "missing"],
        ),
        (
            |l| l[1]["power_watts"] = json!("many"),
            &["lights[1] `point0`: power_watts: invalid type"],
        ),
        (
            |l| l[2]["direction"] = json!([0.0, "down", 0.0]),
            &["lights[2] `area0`: direction: invalid type"],
        ),
        (
            |l| l[1]["powre"] = json!(3.0),
            &["lights[1] `point0`", "powre"],
        ),
        (
            |l| l[1]["position"] = json!([0.1, 0.2, 0.0]),
            &["lights[1] `point0`", "point.position", "outside"],
        ),
        (
            |l| l[1]["power_watts"] = json!(-4.0),
            &["lights[1] `point0`", "point.power"],
        ),
        (
            |l| l[2]["size"] = json!(0.0),
            &["lights[2] `area0`", "area.size"],
        ),
        (
            |l| l[2]["color"] = json!([0.0, 0.0, 0.0]),
            &["lights[2] `area0`", "area.color"],
        ),
        (
            |l| l[0]["strength"] = json!(0.0),
            &["lights[0] `env0`", "environment.strength"],
        ),
        (
            |l| drop(l[1].as_object_mut().unwrap().remove("name")),
            &["lights[1].name"],
        ),
        (|l| *l = json!([]), &["at least one light"]),
    ];
    for (edit, parts) in edits {
        let folder = written();
        change(folder.path(), "lights.json", edit);
        refuses(folder.path(), &[*parts, &["lights.json"]].concat());
    }
    let folder = written();
    change(folder.path(), "lights.json", |l| {
        l[0]["file"] = json!("nowhere.hdr")
    });
    refuses(folder.path(), &["nowhere.hdr"]);
    let dark = image::Rgb32FImage::from_pixel(8, 4, image::Rgb([0.0; 3]));
    dark.save(folder.path().join("nowhere.hdr")).unwrap();
    refuses(folder.path(), &["nowhere.hdr", "zero energy"]);
}

#[test]
fn outputs_that_cannot_be_written() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("file");
    std::fs::write(&file, "x").unwrap();
    let message = interchange::write(&file.join("scene"), &tiny())
        .unwrap_err()
        .to_string();
    assert!(message.contains("file"), "{message}");
    let mut tilted = tiny();
    if let Light::Environment(e) = &mut tilted.basis.as_mut().unwrap().lights[0].light {
        e.rotation = Mat3::from_rotation_x(0.5);
    }
    let message = interchange::write(&folder.path().join("scene"), &tilted)
        .unwrap_err()
        .to_string();
    assert!(
        message.contains("env0") && message.contains("about z"),
        "{message}"
    );
}

/// Four photographs with alpha, posed by one `transforms.json`.
fn photographs() -> (TempDir, Value) {
    let folder = tempfile::tempdir().unwrap();
    let frames: Vec<Value> = (0..4)
        .map(|i| {
            let image = image::RgbaImage::from_fn(16, 12, |x, y| image::Rgba([200, 100, 50, if (5..11).contains(&x) && (3..9).contains(&y) { 255 } else { 0 }]));
            image.save(folder.path().join(format!("r_{i}.png"))).unwrap();
            let pose = lumi_core::camera::opengl_to_opencv(Camera::orbit(i as f32, 0.4, 3.0, 0.9, 16).camera_to_world);
            json!({"file_path": format!("./r_{i}"), "transform_matrix": pose.transpose().to_cols_array_2d()})
        })
        .collect();
    let file = json!({"camera_angle_x": 0.9, "frames": frames});
    std::fs::write(folder.path().join("transforms.json"), file.to_string()).unwrap();
    (folder, file)
}

#[test]
fn transforms_in_blender_style_load() {
    let (folder, _) = photographs();
    let scene = open(folder.path()).unwrap();
    assert_eq!(
        scene.with_role(Role::Input).len(),
        4,
        "too few to hold any out"
    );
    let camera = &scene.views[2].camera;
    let expected = Camera::orbit(2.0, 0.4, 3.0, 0.9, 16);
    assert!((camera.fx - expected.fx).abs() < 1e-4 && camera.fy == camera.fx);
    assert_eq!((camera.cx, camera.cy), (8.0, 6.0));
    assert!(
        camera
            .camera_to_world
            .abs_diff_eq(expected.camera_to_world, 1e-5)
    );
    assert_eq!(scene.views[2].name, "r_2");
    let image = scene.views[0].image.as_ref().unwrap();
    assert_eq!(
        (image.pixels[0], image.alpha.as_ref().unwrap()[0]),
        ([1.0; 3], 0.0)
    );

    // Roles by list, intrinsics per frame, a mask as its own file, a given ball.
    change(folder.path(), "transforms.json", |t| {
        t["test_filenames"] = json!(["./r_1"]);
        t["frames"][0]["fl_x"] = json!(30.0);
        t["frames"][0]["mask_path"] = json!("mask.png");
        t["bounding_sphere_center"] = json!([0.5, 0.0, 0.0]);
        t["bounding_sphere_radius"] = json!(2.0);
    });
    image::GrayImage::from_pixel(16, 12, image::Luma([255]))
        .save(folder.path().join("mask.png"))
        .unwrap();
    let scene = open(folder.path()).unwrap();
    assert_eq!(scene.with_role(Role::Target), [1]);
    assert_eq!(
        (scene.views[0].camera.fx, scene.views[0].camera.fy),
        (30.0, 30.0)
    );
    assert_eq!(
        scene.views[0]
            .image
            .as_ref()
            .unwrap()
            .alpha
            .as_ref()
            .unwrap()[0],
        1.0
    );
    assert!(
        scene
            .to_model
            .point(Vec3::new(2.5, 0.0, 0.0))
            .distance(Vec3::X)
            < 1e-6
    );
}

#[test]
fn transforms() {
    let edits: &[Fault] = &[
        (
            |t| t["frames"][2]["file_path"] = json!("./none"),
            &["frames[2] `./none`", "file_path"],
        ),
        (
            |t| t["frames"][1]["transform_matrix"][0][0] = json!(7.0),
            &["frames[1] `./r_1`", "rotation"],
        ),
        (
            |t| t["frames"][1]["transform_matrix"] = json!([[1.0, 0.0]]),
            &["frames[1]", "transform_matrix"],
        ),
        (
            |t| t["k1"] = json!(-30.0),
            &["frames[0]", "distortion", "fold"],
        ),
        (
            |t| t["camera_model"] = json!("OPENCV_FISHEYE"),
            &["camera_model", "FISHEYE"],
        ),
        (|t| t["w"] = json!(99), &["frames[0]", "w:", "99", "16"]),
        (
            |t| drop(t.as_object_mut().unwrap().remove("camera_angle_x")),
            &["fl_x or camera_angle_x"],
        ),
        (|t| t["frames"] = json!([]), &["frames", "at least one"]),
        (
            |t| t["bounding_sphere_radius"] = json!(-1.0),
            &["bounding_sphere_radius"],
        ),
        (
            |t| t["frames"] = json!([t["frames"][0]]),
            &["bounding sphere", "two views"],
        ),
    ];
    for (edit, parts) in edits {
        let (folder, _) = photographs();
        change(folder.path(), "transforms.json", edit);
        refuses(folder.path(), parts);
    }
    let (folder, _) = photographs();
    let image = folder.path().join("r_3.png");
    let whole = std::fs::read(&image).unwrap();
    std::fs::write(&image, &whole[..whole.len() / 2]).unwrap();
    refuses(folder.path(), &["r_3.png", "Png"]);
    std::fs::write(folder.path().join("transforms.json"), "{\"frames\":\n 3}").unwrap();
    refuses(folder.path(), &["transforms.json", "line"]);
}

#[test]
fn manifests() {
    let edits: &[Fault] = &[
        (
            |m| m["objects"]["tiny"]["targets"]["a"]["sun"] = json!(1.0),
            &["object `tiny`", "target `a`", "light `sun`", "env0"],
        ),
        (
            |m| m["objects"]["tiny"]["targets"]["a"]["env0"] = json!(-1.0),
            &["target `a`", "gain"],
        ),
        (
            |m| m["objects"]["tiny"]["views"][0] = json!("v77"),
            &["object `tiny`", "view `v77`"],
        ),
        (
            |m| m["objects"]["tiny"]["progressive"]["sequence"] = json!(["b"]),
            &["progressive `b`", "target"],
        ),
        (
            |m| m["objects"]["tiny"]["source"] = json!({}),
            &["source", "at least one light"],
        ),
        (
            |m| m["objects"]["tiny"]["views"] = json!([]),
            &["object `tiny`", "views", "at least one"],
        ),
        (
            |m| m["objects"]["tiny"]["inputs"] = json!([]),
            &["object `tiny`", "inputs", "at least one"],
        ),
        (|m| m["version"] = json!(2), &["version", "found 2"]),
    ];
    let cases = json!({"source": {"env0": 1.0}, "targets": {"a": {"point0": 2.0}}, "inputs": ["v00"], "views": ["v03"],
        "progressive": {"pool": ["a"], "sequence": ["a", "a"]}, "additive": [[{"env0": 1.0}, {"area0": 0.5}]]});
    let manifest = json!({"version": 1, "resolution": SIDE, "objects": {"tiny": cases}});
    let folder = tempfile::tempdir().unwrap();
    interchange::write(&folder.path().join("tiny"), &tiny()).unwrap();
    let save = |value: &Value| {
        std::fs::write(folder.path().join("manifest.json"), value.to_string()).unwrap()
    };
    save(&manifest);
    assert!(Manifest::read(folder.path()).unwrap().open("tiny").is_ok());
    assert!(
        Manifest::read(folder.path())
            .unwrap()
            .open("cow")
            .unwrap_err()
            .to_string()
            .contains("tiny")
    );
    for (edit, parts) in edits {
        let mut changed = manifest.clone();
        edit(&mut changed);
        save(&changed);
        let message = Manifest::read(folder.path()).unwrap_err().to_string();
        for part in [*parts, &["manifest.json"]].concat() {
            assert!(message.contains(part), "`{part}` is not in: {message}");
        }
    }
}
