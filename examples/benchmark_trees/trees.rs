//! Data sets in the published layouts of two benchmarks, made from an object that was rendered under one light at a
//! time. Written from the benchmarks' documentation, not from our readers: see `crates/data/src/formats` for sources.

use anyhow::{Context, Result, ensure};
use image::{GrayImage, Luma, Rgb, Rgb32FImage, RgbImage};
use lumi_core::camera::opengl_to_opencv;
use lumi_core::color::srgb_encode;
use lumi_core::glam::{Mat3, Mat4, Vec3};
use lumi_core::{
    Camera, EnvMap, Environment, Light, LightBasis, LinearImage, Role, Scene, Similarity,
};
use serde_json::{Value, json};
use std::f32::consts::{PI, TAU};
use std::fs::{create_dir_all, write};
use std::path::Path;

/// Views that are photographed in each environment besides the inputs.
pub const HELD_OUT: usize = 3;
/// Mean luminance of the object in its photographs.
const BRIGHTNESS: f32 = 0.3;
/// What photographs show beside the object: the benchmarks' have their surroundings there.
const SURROUNDINGS: [f32; 3] = [0.1, 0.18, 0.06];
/// Rows of environment maps; the real ones have 512 and more.
const MAP_ROWS: usize = 64;

/// An environment of the basis, and the factor that exposes the object well in it.
pub struct Shoot<'a> {
    /// Index of the light.
    pub light: usize,
    /// The light.
    pub environment: &'a Environment,
    /// Factor on radiance.
    pub gain: f32,
    /// Indices of the held-out views that are photographed in it.
    pub held_out: Vec<usize>,
}

/// The environments of a scene's basis.
///
/// # Errors
/// If there is none, or there are too few held-out views.
pub fn shoots(scene: &Scene) -> Result<Vec<Shoot<'_>>> {
    let basis = basis(scene)?;
    let held = scene.with_role(Role::Target);
    ensure!(held.len() >= HELD_OUT, "expected {HELD_OUT} held-out views");
    let mut shoots = Vec::new();
    for (light, named) in basis.lights.iter().enumerate() {
        let Light::Environment(environment) = &named.light else {
            continue;
        };
        let (mut sum, mut area) = (0.0, 0.0);
        for [r, g, b, a] in basis.radiance[light].iter().flat_map(|i| &i.pixels) {
            sum += 0.2126 * r + 0.7152 * g + 0.0722 * b;
            area += a;
        }
        let first = HELD_OUT * shoots.len();
        shoots.push(Shoot {
            light,
            environment,
            gain: BRIGHTNESS * area / sum,
            held_out: (first..first + HELD_OUT)
                .map(|k| held[k % held.len()])
                .collect(),
        });
    }
    ensure!(!shoots.is_empty(), "expected environments in the basis");
    Ok(shoots)
}

fn basis(scene: &Scene) -> Result<&LightBasis> {
    let basis = scene.basis.as_ref();
    basis.context("expected an object under one light at a time")
}

/// Frames of captures: structure from motion gives each an orientation, a place and a size of its own.
fn world(k: usize) -> Similarity {
    let k = k as f32;
    Similarity {
        rotation: Mat3::from_rotation_x(1.1 + 0.7 * k) * Mat3::from_rotation_z(0.4 - 1.3 * k),
        translation: Vec3::new(0.3, -0.2 * k, 0.5),
        scale: 1.0 + 0.3 * k,
    }
}

/// A Stanford-ORB tree: `ROOT/blender_LDR`, `ROOT/blender_HDR` and `ROOT/ground_truth`, with one capture of the object
/// for each environment.
///
/// # Errors
/// If the scene has no environments, or a file cannot be written.
pub fn stanford_orb(scene: &Scene, root: &Path) -> Result<()> {
    let shoots = shoots(scene)?;
    let basis = basis(scene)?;
    let name = |k: usize| format!("{}_scene{:03}", scene.name, k + 1);
    let inputs = scene.with_role(Role::Input);
    for hdr in [false, true] {
        let captures = root.join(if hdr { "blender_HDR" } else { "blender_LDR" });
        // The frame of a view in the file of capture `k`: head and pose.
        let frame = |k: usize, part: &str, i: usize| -> Value {
            let pose = scene.views[i].camera.transformed(&world(k)).camera_to_world;
            let rows = opengl_to_opencv(pose).transpose().to_cols_array_2d();
            json!({"file_path": format!("./{part}/{i:04}"), "transform_matrix": rows})
        };
        let angle = |i: usize| {
            let camera = &scene.views[i].camera;
            2.0 * (0.5 * camera.width as f32 / camera.fx).atan()
        };
        for (k, shoot) in shoots.iter().enumerate() {
            let folder = captures.join(name(k));
            for (part, views) in [("train", &inputs), ("test", &shoot.held_out)] {
                create_dir_all(folder.join(part))?;
                create_dir_all(folder.join(format!("{part}_mask")))?;
                for &i in views {
                    let image = exposed(&basis.radiance[shoot.light][i], shoot.gain);
                    let place = folder.join(part).join(format!("{i:04}"));
                    if hdr {
                        write_rgb_exr(&place.with_extension("exr"), &image, |p| p)?;
                    } else {
                        let shown = |p: [f32; 3]| p.map(srgb_encode);
                        bytes(&image, shown).save(place.with_extension("png"))?;
                    }
                    let mask = folder.join(format!("{part}_mask/{i:04}.png"));
                    self::mask(&basis.radiance[shoot.light][i]).save(mask)?;
                }
                let frames: Vec<Value> = views.iter().map(|&i| frame(k, part, i)).collect();
                let first = views.first().map_or(0.0, |&i| angle(i));
                let file = json!({"camera_angle_x": first, "frames": frames});
                write(
                    folder.join(format!("transforms_{part}.json")),
                    file.to_string(),
                )?;
            }
            // Test images of the other captures, posed in the frame of this one.
            let mut frames = Vec::new();
            for (other, shoot) in shoots.iter().enumerate().filter(|(o, _)| *o != k) {
                for &i in &shoot.held_out {
                    let mut frame = frame(k, "test", i);
                    frame["scene_name"] = json!(name(other));
                    frame["camera_angle_x"] = json!(angle(i));
                    frames.push(frame);
                }
            }
            let file = json!({"frames": frames}).to_string();
            write(folder.join("transforms_novel.json"), file)?;
        }
    }
    for (k, shoot) in shoots.iter().enumerate() {
        let maps = root.join("ground_truth").join(name(k)).join("env_map");
        create_dir_all(&maps)?;
        for &i in &shoot.held_out {
            let axes = Mat3::from_mat4(opengl_to_opencv(scene.views[i].camera.camera_to_world));
            let map = camera_map(shoot.environment, shoot.gain, axes);
            write_rgb_exr(&maps.join(format!("{i:04}.exr")), &map, |p| p)?;
        }
    }
    Ok(())
}

/// A map as skylibs lays it out, in OpenGL camera axes: u = ½ + atan2(x, −z)/2π, v = acos(y)/π.
fn camera_map(environment: &Environment, gain: f32, axes: Mat3) -> LinearImage {
    let (width, height) = (2 * MAP_ROWS, MAP_ROWS);
    let mut map = LinearImage::new(width, height);
    for (i, pixel) in map.pixels.iter_mut().enumerate() {
        let u = ((i % width) as f32 + 0.5) / width as f32;
        let v = ((i / width) as f32 + 0.5) / height as f32;
        let (azimuth, polar) = ((u - 0.5) * TAU, v * PI);
        let (s, c) = azimuth.sin_cos();
        let local = Vec3::new(polar.sin() * s, polar.cos(), -polar.sin() * c);
        let [r, g, b] = environment.radiance(axes * local);
        *pixel = [gain * r, gain * g, gain * b, 1.0];
    }
    map
}

/// An Objects with Lighting tree, `ROOT/dataset/OBJECT/test`: inputs in the first environment, and [`HELD_OUT`]
/// photographs in each of the others.
///
/// # Errors
/// If the scene has no two environments, or a file cannot be written.
pub fn objects_with_lighting(scene: &Scene, root: &Path) -> Result<()> {
    let (shoots, basis) = (shoots(scene)?, basis(scene)?);
    let [first, others @ ..] = shoots.as_slice() else {
        anyhow::bail!("expected environments");
    };
    ensure!(!others.is_empty(), "expected two environments");
    let test = root.join("dataset").join(&scene.name).join("test");
    let inputs = test.join("inputs");
    create_dir_all(&inputs)?;
    // Radiance stays as it is; the photograph's exposure brings it to a good brightness.
    let world = Similarity {
        scale: 1.0,
        ..world(1)
    };
    let mut jobs: Vec<(&Shoot, usize, bool)> = Vec::new();
    jobs.extend(
        scene
            .with_role(Role::Input)
            .into_iter()
            .map(|i| (first, i, true)),
    );
    for shoot in others {
        jobs.extend(shoot.held_out.iter().map(|&i| (shoot, i, false)));
    }
    let mut counts = [0_usize; 2];
    for (shoot, i, is_input) in jobs {
        let number = counts[usize::from(is_input)];
        counts[usize::from(is_input)] += 1;
        let (folder, prefix) = if is_input {
            (&inputs, "")
        } else {
            (&test, "gt_")
        };
        let name =
            |stem: &str, ending: &str| folder.join(format!("{prefix}{stem}_{number:04}.{ending}"));
        let image = exposed(&basis.radiance[shoot.light][i], shoot.gain);
        let toned = |p: [f32; 3]| p.map(|v| v.clamp(0.0, 1.0).powf(1.0 / 2.2));
        bytes(&image, toned).save(name("image", "png"))?;
        mask(&basis.radiance[shoot.light][i]).save(name("mask", "png"))?;
        let camera = scene.views[i].camera.transformed(&world);
        write(name("camera", "txt"), camera_text(&camera))?;
        if is_input {
            continue;
        }
        write(name("exposure", "txt"), shoot.gain.log2().to_string())?;
        let to_env = Mat3::from_rotation_z(0.9) * Mat3::from_rotation_x(0.2);
        environment(
            &test,
            "gt_",
            &format!("_{number:04}"),
            shoot,
            &world,
            to_env,
        )?;
    }
    write(inputs.join("exposure.txt"), first.gain.log2().to_string())?;
    let ball = scene.to_model.inverse();
    let (centre, r) = (world.point(ball.point(Vec3::ZERO)), ball.scale);
    let sides = centre.to_array().map(|v| format!("{} {}", v - r, v + r));
    write(inputs.join("object_bounding_box.txt"), sides.join(" "))?;
    // The sphere camera of the inputs stands upright: its frame is the object's own.
    environment(&test, "", "", first, &world, world.rotation.transpose())
}

/// A map in a frame of its own with the matrix that leads into it, and the same in the world's frame.
fn environment(
    folder: &Path,
    prefix: &str,
    number: &str,
    shoot: &Shoot,
    world: &Similarity,
    to_env: Mat3,
) -> Result<()> {
    let in_world = |d: Vec3| shoot.environment.radiance(world.rotation.transpose() * d);
    let save = |name: String, look: &dyn Fn(Vec3) -> [f32; 3]| -> Result<()> {
        let (width, height) = (2 * MAP_ROWS as u32, MAP_ROWS as u32);
        let map = Rgb32FImage::from_fn(width, height, |x, y| {
            let (u, v) = (x as f32 + 0.5, y as f32 + 0.5);
            Rgb(look(EnvMap::direction(u / width as f32, v / height as f32)))
        });
        Ok(map.save(folder.join(name))?)
    };
    let own = |d: Vec3| in_world(to_env.transpose() * d);
    save(format!("{prefix}env{number}.hdr"), &own)?;
    save(format!("{prefix}env_512_rotated{number}.hdr"), &in_world)?;
    let rows = Mat4::from_mat3(to_env).transpose().to_cols_array_2d();
    let text: Vec<String> = rows
        .iter()
        .map(|r| r.map(|v| v.to_string()).join(" "))
        .collect();
    let name = format!("{prefix}world_to_env{number}.txt");
    Ok(write(folder.join(name), text.join("\n"))?)
}

/// Rows of K, R and t of x = K (R X + t), and the image's size.
fn camera_text(camera: &Camera) -> String {
    let to_camera = camera.camera_to_world.inverse();
    let r = Mat3::from_mat4(to_camera).transpose().to_cols_array_2d();
    let t = to_camera.w_axis.truncate().to_array();
    let size = [camera.width as f32, camera.height as f32, 3.0];
    let k = [
        [camera.fx, 0.0, camera.cx],
        [0.0, camera.fy, camera.cy],
        [0.0, 0.0, 1.0],
    ];
    let rows = k.into_iter().chain(r).chain([t, size]);
    let lines: Vec<String> = rows
        .map(|row| row.map(|v| v.to_string()).join(" "))
        .collect();
    lines.join("\n")
}

/// A photograph in its surroundings, opaque.
fn exposed(image: &LinearImage, gain: f32) -> LinearImage {
    let over = |&[r, g, b, a]: &[f32; 4]| {
        let [x, y, z] = SURROUNDINGS.map(|v| (1.0 - a) * v);
        [gain * r + x, gain * g + y, gain * b + z, 1.0]
    };
    LinearImage {
        pixels: image.pixels.iter().map(over).collect(),
        ..*image
    }
}

fn mask(image: &LinearImage) -> GrayImage {
    let (width, height) = (image.width as u32, image.height as u32);
    GrayImage::from_fn(width, height, |x, y| {
        let a = image.pixels[(y * width + x) as usize][3];
        Luma([(255.0 * a).round() as u8])
    })
}

fn bytes(image: &LinearImage, tone: impl Fn([f32; 3]) -> [f32; 3]) -> RgbImage {
    let (width, height) = (image.width as u32, image.height as u32);
    RgbImage::from_fn(width, height, |x, y| {
        let [r, g, b, _] = image.pixels[(y * width + x) as usize];
        Rgb(tone([r, g, b]).map(|v| (255.0 * v).round() as u8))
    })
}

/// RGB without alpha, as both benchmarks have it.
///
/// # Errors
/// If the file cannot be written.
pub fn write_rgb_exr(
    path: &Path,
    image: &LinearImage,
    value: impl Fn([f32; 3]) -> [f32; 3] + Sync,
) -> Result<()> {
    let at = |x: usize, y: usize| {
        let [r, g, b, _] = image.pixels[y * image.width + x];
        let [r, g, b] = value([r, g, b]);
        (r, g, b)
    };
    Ok(exr::prelude::write_rgb_file(
        path,
        image.width,
        image.height,
        at,
    )?)
}
