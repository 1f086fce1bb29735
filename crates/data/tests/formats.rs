//! Every format reads trees in its published layout, and what can be written reads back.
#![allow(clippy::unwrap_used)]

mod trees;

use lumi_core::glam::{Mat3, Mat4, Vec3};
use lumi_core::{
    Area, EnvMap, Environment, Light, LightBasis, LinearImage, NamedLight, Point, Role, Scene,
    Similarity,
};
use lumi_data::formats::{self, FORMATS};
use lumi_data::open;
use lumi_data::store::ObjectRecord;
use std::sync::Arc;
use tempfile::tempdir;
use trees::{RADIUS, ball, camera, shows_the_ball, tipped};

/// The turn that levelled the scene's world: the tree's cameras against the scene's.
fn turn_of(scene: &Scene, i: usize, in_file: Mat4) -> Similarity {
    let rotation = Mat3::from_mat4(scene.views[i].camera.camera_to_world)
        * Mat3::from_mat4(in_file).transpose();
    Similarity {
        rotation,
        ..Similarity::IDENTITY
    }
}

/// Up in the upright world must be up in the scene's.
fn is_level(turn: &Similarity) {
    let up = turn.direction(Vec3::Z);
    assert!(up.distance(Vec3::Z) < 0.02, "{up}");
}

#[test]
fn colmap_text_and_binary() {
    let f = f64::from(camera(0).fx);
    let c = f64::from(camera(0).cx);
    let models: [(u32, &str, Vec<f64>); 5] = [
        (0, "SIMPLE_PINHOLE", vec![f, c, c]),
        (1, "PINHOLE", vec![f, f, c, c]),
        (2, "SIMPLE_RADIAL", vec![f, c, c, 0.01]),
        (3, "RADIAL", vec![f, c, c, 0.01, 0.002]),
        (4, "OPENCV", vec![f, f, c, c, 0.01, 0.002, 0.001, -0.001]),
    ];
    for (number, name, params) in models {
        for binary in [false, true] {
            let folder = tempdir().unwrap();
            trees::colmap(folder.path(), binary, (number, name), &params);
            let scene = open(folder.path()).unwrap();
            assert_eq!(scene.views.len(), 9);
            assert_eq!(scene.with_role(Role::Target), [7]);
            assert_eq!(scene.views[3].name, "pic 3");
            let in_file = camera(3).camera_to_world;
            let turn = turn_of(&scene, 3, in_file);
            is_level(&turn);
            for view in &scene.views {
                shows_the_ball(view, &turn);
            }
            let ball = scene.to_model.inverse();
            assert!(
                ball.translation.length() < 0.05 && (ball.scale - RADIUS).abs() < 0.08,
                "{name}: {ball:?}"
            );
        }
    }
}

#[test]
fn colmap_faults() {
    let folder = tempdir().unwrap();
    trees::colmap(
        folder.path(),
        true,
        (1, "PINHOLE"),
        &[60.0, 60.0, 24.0, 24.0],
    );
    let refuses = |parts: &[&str]| {
        let message = open(folder.path()).unwrap_err().to_string();
        for part in parts {
            assert!(message.contains(part), "`{part}` is not in: {message}");
        }
    };
    let images = folder.path().join("sparse/0/images.bin");
    let cameras = folder.path().join("sparse/0/cameras.bin");
    let (whole, whole_cameras) = (
        std::fs::read(&images).unwrap(),
        std::fs::read(&cameras).unwrap(),
    );
    std::fs::write(&images, &whole[..whole.len() - 3]).unwrap();
    refuses(&["images.bin", "image 8", "expected more"]);
    let mut huge = whole.clone();
    huge[..8].copy_from_slice(&u64::MAX.to_le_bytes());
    std::fs::write(&images, &huge).unwrap();
    refuses(&["images.bin", "image 9"]);
    std::fs::write(&images, []).unwrap();
    refuses(&["images.bin", "byte 0"]);
    let mut elsewhere = whole.clone();
    let at = whole.windows(9).position(|w| w == b"pic 4.png").unwrap();
    elsewhere[at..at + 9].copy_from_slice(b"../4x.png");
    std::fs::write(&images, &elsewhere).unwrap();
    refuses(&["images.bin", "../4x.png", "below the folder of images"]);
    std::fs::write(&images, &whole).unwrap();
    let mut fisheye = whole_cameras.clone();
    fisheye[12] = 5;
    std::fs::write(&cameras, &fisheye).unwrap();
    refuses(&["cameras.bin", "camera 0", "number 5", "image_undistorter"]);
    std::fs::write(&cameras, &whole_cameras).unwrap();
    std::fs::remove_file(folder.path().join("images/pic 4.png")).unwrap();
    refuses(&["images.bin", "image `pic 4.png`", "expected an image"]);
}

#[test]
fn stanford_orb() {
    let root = tempdir().unwrap();
    let bright = Vec3::new(0.3, -0.8, 0.5).normalize();
    trees::stanford_orb(root.path(), bright);
    let folder = root.path().join("blender_LDR/ball_scene001");
    assert_eq!(formats::detect(&folder).unwrap().name, "stanford-orb");
    let scene = open(&folder).unwrap();
    assert_eq!(scene.name, "ball_scene001");
    assert_eq!(
        (
            scene.with_role(Role::Input).len(),
            scene.with_role(Role::Target).len()
        ),
        (6, 6)
    );
    for (i, view) in scene.views.iter().enumerate() {
        shows_the_ball(view, &Similarity::IDENTITY);
        // The maps are in their cameras' frames, and yet all say the same of the world.
        let lights = scene.lights_of(i);
        assert_eq!(
            lights.len(),
            usize::from(view.role == Role::Target),
            "{}",
            view.name
        );
        for light in lights {
            let Light::Environment(map) = &light.light else {
                panic!("a map")
            };
            assert!(map.radiance(bright)[0] > 9.0, "{}", light.name);
            assert!(map.radiance(-bright)[0] < 0.2 && map.radiance(Vec3::Z)[0] < 0.2);
        }
    }
    assert_eq!(
        scene.views[9].name,
        "test_0006".replace("test_0006", "ball_scene002_test_0006")
    );
    assert_eq!(scene.lights_of(9)[0].name, "ball_scene002");

    // Without the ground truth the light is unknown; without the other capture a frame has no image.
    std::fs::remove_dir_all(root.path().join("ground_truth")).unwrap();
    assert!(open(&folder).unwrap().lit_by.is_empty());
    std::fs::remove_dir_all(root.path().join("blender_LDR/ball_scene002")).unwrap();
    let message = open(&folder).unwrap_err().to_string();
    assert!(
        message.contains("transforms_novel.json: frames[0]") && message.contains("ball_scene002"),
        "{message}"
    );
}

#[test]
fn objects_with_lighting() {
    let root = tempdir().unwrap();
    let bright = Vec3::new(-0.6, 0.5, 0.4).normalize();
    trees::objects_with_lighting(root.path(), bright);
    let folder = root.path().join("ball/test");
    let scene = open(&folder).unwrap();
    assert_eq!((scene.name.as_str(), scene.views.len()), ("ball", 8));
    assert_eq!(scene.with_role(Role::Target), [6, 7]);
    let turn = turn_of(&scene, 0, camera(0).camera_to_world);
    is_level(&turn);
    let in_scene = |d: Vec3| turn.direction(d);
    for i in 0..8 {
        let Light::Environment(map) = &scene.lights_of(i)[0].light else {
            panic!("a map")
        };
        let (lit, exposure) = if i < 6 {
            (bright, -1.0_f32)
        } else {
            (Vec3::Z, 0.5)
        };
        let found = map.radiance(in_scene(lit))[0];
        assert!(
            (found / (10.0 * exposure.exp2()) - 1.0).abs() < 0.02,
            "{i}: {found}"
        );
        assert!(map.radiance(in_scene(-lit))[0] < 0.2);
    }
    // 255 (x 2^e)^(1/2.2) became sRGB of x 2^e: half the ball's radiance for the inputs.
    let view = &scene.views[2];
    let image = view.image.as_ref().unwrap();
    let at = 24 * 48 + 24;
    let upright = camera(2);
    let truth = trees::look(&upright, upright.directions()[at]).unwrap();
    for (shown, truth) in image.pixels[at].iter().zip(truth) {
        let linear = lumi_core::color::srgb_decode(*shown);
        assert!((linear - 0.5 * truth).abs() < 0.01, "{linear} {}", truth);
    }
    // The masks' ball; without masks, the one around the box's corners.
    assert!((scene.to_model.inverse().scale - RADIUS).abs() < 0.08);
    for i in 0..6 {
        std::fs::remove_file(folder.join(format!("inputs/mask_{i:04}.png"))).unwrap();
    }
    let sphere = open(&folder).unwrap().to_model.inverse();
    assert!((sphere.scale - RADIUS * 3.0_f32.sqrt()).abs() < 1e-4);
    for (file, text, part) in [
        ("inputs/camera_0003.txt", "1 2 3", "expected 24, found 3"),
        ("inputs/exposure.txt", "NaN", "finite"),
        (
            "inputs/object_bounding_box.txt",
            "1 0 0 1 0 1",
            "xmin < xmax",
        ),
        (
            "world_to_env.txt",
            "2 0 0 0 0 2 0 0 0 0 2 0 0 0 0 1",
            "rotation",
        ),
    ] {
        let path = folder.join(file);
        let whole = std::fs::read(&path).unwrap();
        std::fs::write(&path, text).unwrap();
        let message = open(&folder).unwrap_err().to_string();
        assert!(
            message.contains(part) && message.contains(path.file_name().unwrap().to_str().unwrap()),
            "{message}"
        );
        std::fs::write(&path, whole).unwrap();
    }
}

#[test]
fn transforms_with_a_lens_and_a_tipped_world() {
    let folder = tempdir().unwrap();
    let frames: Vec<_> = (0..9)
        .map(|i| {
            trees::photograph(&camera(i)).save(folder.path().join(format!("{i}.png"))).unwrap();
            let c = camera(i).transformed(&tipped()).camera_to_world;
            let opengl = Mat4::from_cols(c.x_axis, -c.y_axis, -c.z_axis, c.w_axis);
            serde_json::json!({"file_path": format!("{i}"), "transform_matrix": trees::rows(opengl), "fl_x": camera(i).fx, "cx": 24.0, "cy": 24.0})
        })
        .collect();
    let mut file = serde_json::json!({"camera_model": "OPENCV", "w": 48, "h": 48, "k1": 0.01, "k2": 0.001, "p1": 0.001, "p2": 0.0,
        "applied_transform": [[1, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0]], "applied_scale": 1.0, "frames": frames});
    let path = folder.path().join("transforms.json");
    std::fs::write(&path, file.to_string()).unwrap();
    let scene = open(folder.path()).unwrap();
    let turn = turn_of(&scene, 0, camera(0).camera_to_world);
    is_level(&turn);
    scene.views.iter().for_each(|v| shows_the_ball(v, &turn));

    // `none` keeps the world as it is.
    file["orientation_override"] = "none".into();
    std::fs::write(&path, file.to_string()).unwrap();
    let kept = open(folder.path()).unwrap();
    let pose = camera(0).transformed(&tipped()).camera_to_world;
    assert!(kept.views[0].camera.camera_to_world.abs_diff_eq(pose, 1e-5));
    file["applied_scale"] = (-2.0).into();
    std::fs::write(&path, file.to_string()).unwrap();
    let message = open(folder.path()).unwrap_err().to_string();
    assert!(message.contains("applied_scale"), "{message}");
}

#[test]
fn large_photographs_are_reduced() {
    let folder = tempdir().unwrap();
    let mut scene = ball(2);
    for view in &mut scene.views {
        view.image = Some(view.image.take().unwrap().resized(1536, 1536));
        view.camera = view.camera.resized(1536, 1536);
    }
    formats::transforms::write(folder.path(), &scene).unwrap();
    let back = open(folder.path()).unwrap();
    let camera = &back.views[0].camera;
    assert_eq!(
        (camera.width, camera.cx),
        (formats::photo::LONGEST_SIDE, 512.0)
    );
    let (full, reduced) = (&scene.views[0].image, &back.views[0].image);
    let expected = full.as_ref().unwrap().resized(1024, 1024);
    let pairs = expected
        .pixels
        .iter()
        .zip(&reduced.as_ref().unwrap().pixels);
    let worst = pairs.map(|(a, b)| (a[1] - b[1]).abs()).fold(0.0, f32::max);
    assert!(worst < 2.0 / 255.0, "{worst}");
}

#[test]
fn photographs_round_trip_through_transforms() {
    let (folder, scene) = (tempdir().unwrap(), ball(9));
    formats::transforms::write(folder.path(), &scene).unwrap();
    let back = open(folder.path()).unwrap();
    assert!((back.to_model.scale - scene.to_model.scale).abs() < 1e-5);
    for (a, b) in scene.views.iter().zip(&back.views) {
        assert_eq!((&a.name, a.role), (&b.name, b.role));
        assert!(
            a.camera
                .camera_to_world
                .abs_diff_eq(b.camera.camera_to_world, 1e-6)
        );
        assert_eq!((a.camera.fx, a.camera.cy), (b.camera.fx, b.camera.cy));
        let (x, y) = (a.image.as_ref().unwrap(), b.image.as_ref().unwrap());
        assert_eq!(x.alpha, y.alpha);
        for (p, q) in x.pixels.iter().flatten().zip(y.pixels.iter().flatten()) {
            assert!((p - q).abs() < 1.5 / 255.0, "{p} {q}");
        }
    }
}

/// The ball under a map that is bright on one side, a lamp and a square.
fn basis() -> Scene {
    let mut scene = ball(4);
    let map = EnvMap {
        width: 64,
        height: 32,
        pixels: (0..2048)
            .map(|i| {
                [
                    if i % 64 < 16 { 6.0 } else { 0.3 },
                    0.4,
                    0.2 + (i / 64) as f32 / 64.0,
                ]
            })
            .collect(),
    };
    let tilted = Environment::new(Arc::new(map), 0.8, 1.5);
    let lamp = Point {
        color: [1.0, 0.5, 0.25],
        ..Point::new(Vec3::new(1.0, 2.5, 3.0), 700.0)
    };
    let square = Area::facing(Vec3::new(3.0, -1.0, 2.0), Vec3::ZERO, 1.5, 900.0);
    let lights = [
        ("sky", Light::Environment(tilted)),
        ("lamp", Light::Point(lamp)),
        ("square", Light::Area(square)),
    ];
    let lights: Vec<_> = lights
        .map(|(name, light)| NamedLight {
            name: name.to_owned(),
            light,
        })
        .into();
    let radiance = (0..3)
        .map(|k| {
            scene
                .views
                .iter()
                .map(|view| {
                    let shade = |d: Vec3| {
                        trees::look(&view.camera, d)
                            .map_or([0.0; 4], |c| [c[0] * (k + 1) as f32 / 3.0, c[1], c[2], 1.0])
                    };
                    LinearImage {
                        width: 48,
                        height: 48,
                        pixels: view.camera.directions().into_iter().map(shade).collect(),
                    }
                })
                .collect()
        })
        .collect();
    scene.views.iter_mut().for_each(|v| v.image = None);
    scene.basis = Some(LightBasis { lights, radiance });
    scene
}

#[test]
fn a_basis_becomes_a_split_of_the_authors_and_reads_back() {
    let (folder, scene) = (tempdir().unwrap(), basis());
    formats::authors::write(folder.path(), &scene).unwrap();
    let message = open(folder.path()).unwrap_err().to_string();
    assert!(
        message.contains("expected one scene, found 3") && message.contains("ball_env_0.json"),
        "{message}"
    );
    let list = std::fs::read_to_string(folder.path().join("full_list.txt")).unwrap();
    assert_eq!(list.lines().count(), 3);
    let basis = scene.basis.as_ref().unwrap();
    for (k, line) in list.lines().enumerate() {
        let back = open(line).unwrap();
        assert!(back.name.starts_with("ball_") && back.views.len() == 4);
        for (i, view) in back.views.iter().enumerate() {
            assert!(
                view.camera
                    .camera_to_world
                    .abs_diff_eq(scene.views[i].camera.camera_to_world, 1e-5)
            );
            let shown = basis.radiance[k][i].to_display();
            let image = view.image.as_ref().unwrap();
            let worst = shown
                .pixels
                .as_flattened()
                .iter()
                .zip(image.pixels.as_flattened())
                .map(|(a, b)| (a - b).abs())
                .fold(0.0, f32::max);
            assert!(worst < 1.5 / 255.0, "{worst}");
        }
        match (&basis.lights[k].light, &back.lights_of(2)[0].light) {
            (Light::Environment(a), Light::Environment(b)) => {
                for d in [
                    Vec3::X,
                    Vec3::Y,
                    Vec3::new(-0.6, 0.5, 0.6).normalize(),
                    -Vec3::X,
                    Vec3::new(0.5, -0.6, 0.3).normalize(),
                ] {
                    let (p, q) = (a.radiance(d), b.radiance(d));
                    for c in 0..3 {
                        assert!((p[c] - q[c]).abs() < 0.06 * p[c] + 0.02, "{d} {p:?} {q:?}");
                    }
                }
            }
            (Light::Point(a), Light::Point(b)) => {
                assert!(
                    a.position.distance(b.position) < 1e-5
                        && (a.power / b.power - 1.0).abs() < 1e-3
                );
                assert_eq!(a.color, b.color);
            }
            (Light::Area(a), Light::Area(b)) => {
                assert!(
                    a.position.distance(b.position) < 0.02 && (a.size / b.size - 1.0).abs() < 0.02
                );
                assert!(
                    a.direction().distance(b.direction()) < 0.02
                        && (a.power / b.power - 1.0).abs() < 1e-3
                );
            }
            (a, b) => panic!("{} became {}", a.kind(), b.kind()),
        }
    }
}

/// A basis with pictures and lights, as a store keeps it, in both of its layouts.
#[test]
fn records_of_a_store_are_scenes() {
    let folder = tempdir().unwrap();
    let written = basis();
    let cameras = written.views.iter().map(|v| v.camera).collect();
    let record = ObjectRecord::pack("thing", cameras, written.basis.as_ref().unwrap()).unwrap();
    for name in ["thing", "thing.safetensors"] {
        let path = folder.path().join(name);
        record.write(&path).unwrap();
        assert_eq!(formats::detect(&path).unwrap().name, "record");
        let scene = open(&path).unwrap();
        assert_eq!(scene.views.len(), written.views.len());
        let lights = lumi_data::input_light(&scene, None).unwrap().unwrap();
        let basis = scene.basis.unwrap();
        assert_eq!(basis.lights.len(), record.lights.len());
        let environment = basis
            .lights
            .iter()
            .find(|l| l.light.kind() == "environment");
        assert_eq!(
            lights,
            [environment.or(basis.lights.first()).unwrap().light.clone()]
        );
    }
    // A store is not one scene, and other safetensors files are none.
    assert!(formats::detect(folder.path()).is_err());
    std::fs::write(folder.path().join("other.safetensors"), b"12345678").unwrap();
    assert!(formats::detect(folder.path().join("other.safetensors")).is_err());
}

#[test]
fn what_cannot_be_written_says_so() {
    let folder = tempdir().unwrap();
    let message = formats::transforms::write(folder.path(), &basis())
        .unwrap_err()
        .to_string();
    assert!(
        message.contains("v00") && message.contains("name a light"),
        "{message}"
    );
    let message = formats::interchange::write(folder.path(), &ball(3))
        .unwrap_err()
        .to_string();
    assert!(message.contains("only photographs"), "{message}");
    assert!(
        formats::named("obj")
            .err()
            .unwrap()
            .to_string()
            .contains("colmap")
    );
    assert_eq!(FORMATS.iter().filter(|f| f.write.is_some()).count(), 3);
}
