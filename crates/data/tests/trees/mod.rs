//! Tiny captures of a coloured ball in each published layout, written by code of its own: from the formats'
//! documentation, not from the readers.
#![allow(dead_code)]

use image::{GrayImage, Luma, Rgba, RgbaImage};
use lumi_core::color::{srgb_decode, srgb_encode};
use lumi_core::glam::{DMat4, DQuat, Mat3, Mat4, Vec3};
use lumi_core::image::write_exr;
use lumi_core::{
    Area, Camera, DisplayImage, EnvMap, Environment, Light, LightBasis, LinearImage, NamedLight,
    Point, Role, Scene, Similarity, View,
};
use lumi_data::store::ObjectRecord;
use serde_json::{Value, json};
use std::path::Path;
use std::sync::Arc;

/// Radius of the ball at the origin.
pub const RADIUS: f32 = 0.8;
/// Side of the photographs.
pub const SIDE: usize = 48;

/// Camera `i` of a ring in two heights.
pub fn camera(i: usize) -> Camera {
    Camera::orbit(0.6 * i as f32, 0.2 + 0.3 * (i % 2) as f32, 3.0, 0.8, SIDE)
}

/// Linear colour and coverage along a ray: each side of the ball has a colour of its own.
pub fn look(camera: &Camera, direction: Vec3) -> Option<[f32; 3]> {
    let centre = camera.centre();
    let along = -centre.dot(direction);
    let off = (centre + along * direction).length_squared();
    let half = (RADIUS * RADIUS - off).max(0.0).sqrt();
    let normal = (centre + (along - half) * direction) / RADIUS;
    (off < RADIUS * RADIUS).then(|| (0.5 + 0.4 * normal).to_array())
}

/// The photograph of `camera`, sRGB with alpha.
pub fn photograph(camera: &Camera) -> RgbaImage {
    let byte = |v: f32| (255.0 * srgb_encode(v)).round() as u8;
    let pixels = camera.directions();
    RgbaImage::from_fn(
        camera.width as u32,
        camera.height as u32,
        |x, y| match look(camera, pixels[y as usize * camera.width + x as usize]) {
            Some([r, g, b]) => Rgba([byte(r), byte(g), byte(b), 255]),
            None => Rgba([0; 4]),
        },
    )
}

/// A ball photographed `count` times, as a scene in memory.
pub fn ball(count: usize) -> Scene {
    let view = |i: usize| {
        let camera = camera(i);
        let shown = photograph(&camera);
        let over = |p: &Rgba<u8>| {
            let a = f32::from(p.0[3]) / 255.0;
            [0, 1, 2].map(|c| f32::from(p.0[c]) / 255.0 * a + 1.0 - a)
        };
        View {
            name: format!("v{i:02}"),
            role: if i % 4 == 3 {
                Role::Target
            } else {
                Role::Input
            },
            camera,
            image: Some(DisplayImage {
                width: SIDE,
                height: SIDE,
                pixels: shown.pixels().map(over).collect(),
                alpha: Some(shown.pixels().map(|p| f32::from(p.0[3]) / 255.0).collect()),
            }),
        }
    };
    Scene {
        name: "ball".to_owned(),
        views: (0..count).map(view).collect(),
        to_model: Similarity::to_unit_ball(Vec3::ZERO, RADIUS),
        basis: None,
        lit_by: Vec::new(),
        radiance: Vec::new(),
        warnings: Vec::new(),
    }
}

/// The ball in two views, the same under a light of each kind.
pub fn record() -> ObjectRecord {
    let scene = ball(2);
    let image = |view: &View| {
        let shown = view.image.as_ref().unwrap();
        let pixels = shown.pixels.iter().map(|p| [p[0], p[1], p[2], 1.0]);
        LinearImage {
            width: shown.width,
            height: shown.height,
            pixels: pixels.collect(),
        }
    };
    let images: Vec<_> = scene.views.iter().map(image).collect();
    let sky = Environment::new(Arc::new(EnvMap::uniform([1.0; 3])), 0.0, 1.0);
    let at = Vec3::new(0.0, 3.0, 2.0);
    let lights = [
        ("sky", Light::Environment(sky)),
        ("lamp", Light::Point(Point::new(at, 800.0))),
        (
            "panel",
            Light::Area(Area::facing(at, Vec3::ZERO, 1.5, 900.0)),
        ),
    ];
    let lights = lights.map(|(name, light)| NamedLight {
        name: name.to_owned(),
        light,
    });
    let basis = LightBasis {
        radiance: vec![images; lights.len()],
        lights: lights.into(),
    };
    let cameras = scene.views.iter().map(|v| v.camera).collect();
    ObjectRecord::pack("ball", cameras, &basis).unwrap()
}

/// The mean colour of the photograph must be that of the ball from its camera, in the file's own world.
pub fn shows_the_ball(view: &View, turn: &Similarity) {
    let camera = view.camera.transformed(&turn.inverse());
    let image = view.image.as_ref().unwrap();
    let alpha = image.alpha.as_ref().unwrap();
    let (mut worst, mut seen) = (0.0_f32, 0);
    for (i, direction) in camera.directions().into_iter().enumerate() {
        let Some(color) = look(&camera, direction) else {
            continue;
        };
        // Edges are off by up to a pixel after resampling; the inside must fit.
        if look(
            &camera,
            (direction * 3.0 + camera.centre() * 0.02).normalize(),
        )
        .is_some()
            && alpha[i] > 0.99
        {
            for (shown, truth) in image.pixels[i].iter().zip(color) {
                worst = worst.max((srgb_decode(*shown) - truth).abs());
            }
            seen += 1;
        }
    }
    assert!(seen > SIDE * SIDE / 8, "{}: {seen} pixels", view.name);
    assert!(worst < 0.08, "{}: {worst}", view.name);
}

pub fn rows(m: Mat4) -> Value {
    json!(m.transpose().to_cols_array_2d())
}

/// A world in which up is −y, as structure from motion likes it.
pub fn tipped() -> Similarity {
    Similarity {
        rotation: Mat3::from_rotation_x(std::f32::consts::FRAC_PI_2 + 0.1)
            * Mat3::from_rotation_z(0.4),
        ..Similarity::IDENTITY
    }
}

/// A COLMAP capture, text or binary, whose lens is `params` of `model` after the pinhole.
pub fn colmap(folder: &Path, binary: bool, model: (u32, &str), params: &[f64]) {
    std::fs::create_dir_all(folder.join("images")).unwrap();
    std::fs::create_dir_all(folder.join("sparse/0")).unwrap();
    let (mut text, mut bytes) = (String::from("# images\n"), Vec::new());
    bytes.extend(9_u64.to_le_bytes());
    for i in 0..9 {
        let shown = camera(i);
        let name = format!("pic {i}.png");
        photograph(&shown)
            .save(folder.join("images").join(&name))
            .unwrap();
        let pose = shown.transformed(&tipped()).camera_to_world;
        let to_camera: DMat4 = pose.as_dmat4().inverse();
        let q = DQuat::from_mat4(&to_camera).normalize();
        let t = to_camera.w_axis;
        let numbers = [q.w, q.x, q.y, q.z, t.x, t.y, t.z];
        let words: Vec<_> = numbers.iter().map(f64::to_string).collect();
        let points = if i % 2 == 0 { "" } else { "1.5 2.5 -1 3 4 7" };
        text += &format!("{} {} 3 {name}\n{points}\n", i + 1, words.join(" "));
        bytes.extend((i as u32 + 1).to_le_bytes());
        bytes.extend(numbers.iter().flat_map(|v| v.to_le_bytes()));
        bytes.extend(3_u32.to_le_bytes());
        bytes.extend(name.bytes().chain([0]));
        bytes.extend(2_u64.to_le_bytes());
        bytes.extend([0_u8; 48]);
    }
    let sparse = folder.join("sparse/0");
    if binary {
        let mut cameras = 1_u64.to_le_bytes().to_vec();
        cameras.extend(3_u32.to_le_bytes());
        cameras.extend(model.0.to_le_bytes());
        cameras.extend([SIDE as u64; 2].iter().flat_map(|v| v.to_le_bytes()));
        cameras.extend(params.iter().flat_map(|v| v.to_le_bytes()));
        std::fs::write(sparse.join("cameras.bin"), cameras).unwrap();
        std::fs::write(sparse.join("images.bin"), bytes).unwrap();
    } else {
        let words: Vec<_> = params.iter().map(f64::to_string).collect();
        let line = format!(
            "# cameras\n3 {} {SIDE} {SIDE} {}\n",
            model.1,
            words.join(" ")
        );
        std::fs::write(sparse.join("cameras.txt"), line).unwrap();
        std::fs::write(sparse.join("images.txt"), text).unwrap();
    }
}

/// OpenGL axes from OpenCV ones.
fn opengl(pose: Mat4) -> Mat4 {
    Mat4::from_cols(pose.x_axis, -pose.y_axis, -pose.z_axis, pose.w_axis)
}

/// A Stanford-ORB tree of two captures of one object, `ball_scene001` and `ball_scene002`. The environment of
/// every test image is bright where world direction `bright` (in capture 1's world) lies.
pub fn stanford_orb(root: &Path, bright: Vec3) {
    for scene in ["ball_scene001", "ball_scene002"] {
        let folder = root.join("blender_LDR").join(scene);
        let maps = root.join("ground_truth").join(scene).join("env_map");
        std::fs::create_dir_all(&maps).unwrap();
        let mut files = Vec::new();
        for (part, indices) in [("train", 0..6), ("test", 6..9)] {
            let (images, masks) = (folder.join(part), folder.join(format!("{part}_mask")));
            std::fs::create_dir_all(&images).unwrap();
            std::fs::create_dir_all(&masks).unwrap();
            let mut frames = Vec::new();
            for i in indices {
                let camera = camera(i);
                let shown = photograph(&camera);
                // The published pictures have their background; the mask is a file of its own.
                let rgb = image::RgbImage::from_fn(SIDE as u32, SIDE as u32, |x, y| {
                    let p = shown.get_pixel(x, y).0;
                    image::Rgb(if p[3] > 0 {
                        [p[0], p[1], p[2]]
                    } else {
                        [90, 120, 70]
                    })
                });
                rgb.save(images.join(format!("{i:04}.png"))).unwrap();
                let mask = GrayImage::from_fn(SIDE as u32, SIDE as u32, |x, y| {
                    Luma([shown.get_pixel(x, y).0[3]])
                });
                mask.save(masks.join(format!("{i:04}.png"))).unwrap();
                frames.push(json!({"file_path": format!("./{part}/{i:04}"), "transform_matrix": rows(opengl(camera.camera_to_world))}));
                if part == "test" {
                    camera_map(
                        &maps.join(format!("{i:04}.exr")),
                        camera.camera_to_world,
                        bright,
                    );
                }
            }
            let file = json!({"camera_angle_x": 0.8, "frames": frames});
            std::fs::write(
                folder.join(format!("transforms_{part}.json")),
                file.to_string(),
            )
            .unwrap();
            files.push(file);
        }
        let other = if scene == "ball_scene001" {
            "ball_scene002"
        } else {
            "ball_scene001"
        };
        let mut novel = files[1].clone();
        for frame in novel["frames"].as_array_mut().unwrap() {
            frame["scene_name"] = json!(other);
            frame["camera_angle_x"] = json!(0.8);
        }
        novel.as_object_mut().unwrap().remove("camera_angle_x");
        std::fs::write(folder.join("transforms_novel.json"), novel.to_string()).unwrap();
    }
}

/// A map in skylibs' convention and OpenGL camera axes: u = ½ + atan2(x, −z)/2π, v = acos(y)/π.
fn camera_map(path: &Path, pose: Mat4, bright: Vec3) {
    let (width, height) = (64, 32);
    let axes = Mat3::from_mat4(opengl(pose));
    let pixel = |i: usize| {
        let u = ((i % width) as f32 + 0.5) / width as f32;
        let v = ((i / width) as f32 + 0.5) / height as f32;
        let (azimuth, polar) = ((u - 0.5) * std::f32::consts::TAU, v * std::f32::consts::PI);
        let local = Vec3::new(
            polar.sin() * azimuth.sin(),
            polar.cos(),
            -polar.sin() * azimuth.cos(),
        );
        let near = (axes * local).dot(bright);
        let v = if near > 0.95 { 10.0 } else { 0.1 };
        [v, v, v, 1.0]
    };
    let pixels = (0..width * height).map(pixel).collect();
    write_exr(
        path,
        &LinearImage {
            width,
            height,
            pixels,
        },
    )
    .unwrap();
}

/// An Objects-With-Lighting object, `ROOT/ball/test`, in a tipped world. The environment of the inputs is
/// bright toward `bright` of the upright world; that of held-out views at +z of it.
pub fn objects_with_lighting(root: &Path, bright: Vec3) {
    let test = root.join("ball/test");
    let inputs = test.join("inputs");
    std::fs::create_dir_all(&inputs).unwrap();
    let (exposure, tipped) = (-1.0_f32, tipped());
    std::fs::write(inputs.join("exposure.txt"), "-1.0\n").unwrap();
    std::fs::write(
        inputs.join("object_bounding_box.txt"),
        "-0.8 0.8 -0.8 0.8 -0.8 0.8\n",
    )
    .unwrap();
    for i in 0..8 {
        let (folder, prefix, number) = if i < 6 {
            (&inputs, "", i)
        } else {
            (&test, "gt_", i - 6)
        };
        let name = |stem: &str, extension: &str| {
            folder.join(format!("{prefix}{stem}_{number:04}.{extension}"))
        };
        let shown = camera(i);
        let rays = shown.directions();
        let byte = |v: f32| {
            (255.0 * (v * exposure.exp2()).powf(1.0 / 2.2))
                .clamp(0.0, 255.0)
                .round() as u8
        };
        let at = |x: u32, y: u32| look(&shown, rays[y as usize * SIDE + x as usize]);
        let rgb = image::RgbImage::from_fn(SIDE as u32, SIDE as u32, |x, y| {
            image::Rgb(at(x, y).map_or([33, 44, 55], |c| c.map(byte)))
        });
        rgb.save(name("image", "png")).unwrap();
        let mask = GrayImage::from_fn(SIDE as u32, SIDE as u32, |x, y| {
            Luma([if at(x, y).is_some() { 255 } else { 0 }])
        });
        mask.save(name("mask", "png")).unwrap();
        let to_camera = shown.transformed(&tipped).camera_to_world.inverse();
        let r = Mat3::from_mat4(to_camera).transpose().to_cols_array_2d();
        let t = to_camera.w_axis;
        let line = |v: [f32; 3]| format!("{:e} {:e} {:e}\n", v[0], v[1], v[2]);
        let text = line([shown.fx, 0.0, shown.cx])
            + &line([0.0, shown.fy, shown.cy])
            + &line([0.0, 0.0, 1.0])
            + &line(r[0])
            + &line(r[1])
            + &line(r[2])
            + &line([t.x, t.y, t.z])
            + &line([SIDE as f32, SIDE as f32, 3.0]);
        std::fs::write(name("camera", "txt"), text).unwrap();
        if i >= 6 {
            std::fs::write(name("exposure", "txt"), "0.5").unwrap();
            hdr(&name("env_512_rotated", "hdr"), |d| {
                tipped.inverse().direction(d).dot(Vec3::Z) > 0.9
            });
        }
    }
    // The environment's frame: turned about the vertical against the upright world.
    let to_env = Mat4::from_rotation_z(1.1) * Mat4::from_mat3(tipped.rotation.transpose());
    let text: String = to_env
        .transpose()
        .to_cols_array_2d()
        .iter()
        .map(|row| format!("{} {} {} {}\n", row[0], row[1], row[2], row[3]))
        .collect();
    std::fs::write(test.join("world_to_env.txt"), text).unwrap();
    hdr(&test.join("env.hdr"), |d| {
        (Mat3::from_rotation_z(-1.1) * d).dot(bright) > 0.95
    });
}

/// A map in the data set's layout, which is ours, bright where `lit` says.
fn hdr(path: &Path, lit: impl Fn(Vec3) -> bool) {
    let image = image::Rgb32FImage::from_fn(64, 32, |x, y| {
        let d = EnvMap::direction((x as f32 + 0.5) / 64.0, (y as f32 + 0.5) / 32.0);
        image::Rgb([if lit(d) { 10.0 } else { 0.1 }; 3])
    });
    image.save(path).unwrap();
}
