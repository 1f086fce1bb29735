//! The authors' encodings against values that their own code produced.
#![allow(clippy::unwrap_used)]

use lumi_core::camera::opengl_to_opencv;
use lumi_core::glam::{Mat3, Mat4, Vec3};
use lumi_core::image::authors::{Bytes, prepare};
use lumi_core::light::{authors as light, fibonacci_sphere};
use lumi_core::{Area, Camera, EnvMap, Light, Point, Similarity, authors};
use lumi_testkit::{Tensor, golden};
use std::collections::BTreeMap;

type Golden = BTreeMap<String, Tensor>;

fn data() -> Golden {
    golden("reference/golden/data.safetensors")
}

fn matrices(t: &Tensor) -> Vec<Mat4> {
    t.rows::<16>()
        .iter()
        .map(|m| Mat4::from_cols_array(m).transpose())
        .collect()
}

fn close(name: &str, tensor: &Tensor, found: &[f32], tolerance: f32) {
    let difference = tensor.max_difference(found);
    println!("{name}: largest difference {difference:.2e} (allowed {tolerance:.0e})");
    assert!(difference <= tolerance, "{name}: {difference}");
}

#[test]
fn poses_are_normalised() {
    let g = data();
    let c2w = matrices(&g["poses.c2w"]);
    let flipped: Vec<Mat4> = matrices(&g["poses.c2w_blender"])
        .into_iter()
        .map(opengl_to_opencv)
        .collect();
    let flat = |poses: &[Mat4]| {
        poses
            .iter()
            .flat_map(|m| m.transpose().to_cols_array())
            .collect::<Vec<_>>()
    };
    close("poses.c2w", &g["poses.c2w"], &flat(&flipped), 1e-6);
    let inverse: Vec<Mat4> = c2w.iter().map(Mat4::inverse).collect();
    close("poses.w2c", &g["poses.w2c"], &flat(&inverse), 1e-6);
    for (name, poses, scale) in [
        ("poses.c2w_normalised_1p35", &c2w[..], authors::SCENE_SCALE),
        ("poses.c2w_normalised_1p0_first4", &c2w[..4], 1.0),
    ] {
        let s = authors::normalise(poses, scale).unwrap();
        let moved: Vec<Mat4> = poses.iter().map(|p| s.pose(p)).collect();
        close(name, &g[name], &flat(&moved), 1e-6);
    }
    assert!(authors::normalise(&[], 1.0).is_err());
    assert!(authors::normalise(&c2w[..1], 1.0).is_err());
}

#[test]
fn intrinsics_follow_the_field_of_view() {
    let g = data();
    for (name, fov, w, h) in [
        ("fov30_512x512", 30.0, 512, 512),
        ("fov50_640x480", 50.0, 640, 480),
    ] {
        let c = authors::camera(fov, w, h, Mat4::IDENTITY);
        close(
            name,
            &g[&format!("intrinsics.{name}")],
            &[c.fx, c.fy, c.cx, c.cy],
            1e-4,
        );
    }
}

#[test]
fn environment_directions_and_maps() {
    let g = data();
    let (h, w) = (32, 64);
    let flat = |d: Vec<Vec3>| {
        d.into_iter()
            .flat_map(|d| d.to_array())
            .collect::<Vec<f32>>()
    };
    // The stored local grid is in its own axes, z up.
    let local = light::camera_directions(h, w)
        .into_iter()
        .map(|d| Vec3::new(d.x, d.z, -d.y))
        .collect();
    close("env.local_dirs", &g["env.local_dirs"], &flat(local), 1e-6);

    let raw = matrices(&g["poses.c2w"]);
    // [view, channel, row, column] in the file.
    let mut planar = Vec::new();
    for pose in &raw[..3] {
        let directions = light::world_directions(Mat3::from_mat4(*pose), h, w);
        (0..3).for_each(|c| planar.extend(directions.iter().map(|d| d[c])));
    }
    close(
        "env.env_dir_first3",
        &g["env.env_dir_first3"],
        &planar,
        2e-6,
    );

    let source = EnvMap {
        width: w,
        height: h,
        pixels: g["env.source_hdr"].rows(),
    };
    for (i, pose) in raw.iter().enumerate().take(2) {
        let rotation = g["env.z_rotation_rad"].data[i];
        let aligned = light::align(&source, rotation, Mat3::from_mat4(*pose));
        let name = format!("env.{i}.rotated_linear");
        close(&name, &g[&name], aligned.pixels.as_flattened(), 2e-4);
        let images = light::encode(&aligned);
        for (name, bytes) in [("ldr_u8", &images.ldr), ("hdr_u8", &images.hdr)] {
            let name = format!("env.{i}.{name}");
            let values: Vec<f32> = bytes.as_flattened().iter().map(|b| f32::from(*b)).collect();
            // Values that fall on a step of the 8-bit floor may land on either side.
            close(&name, &g[&name], &values, 1.0);
            let off = values
                .iter()
                .zip(&g[&name].data)
                .filter(|(a, b)| a != b)
                .count();
            println!("{name}: {off} of {} bytes differ", values.len());
            assert!(off * 500 <= values.len(), "{name}: {off}");
        }
    }
    // "Identity" is meant in Blender's axes: the camera looks along −z.
    let identity = Mat3::from_mat4(opengl_to_opencv(Mat4::IDENTITY));
    let aligned = light::align(&source, 0.0, identity);
    let name = "env.identity_camera.rotated_linear";
    close(name, &g[name], aligned.pixels.as_flattened(), 2e-4);
}

#[test]
fn camera_paths_turn_evenly() {
    let g = data();
    let poses = matrices(&g["poses.c2w"]);
    let cameras: Vec<Camera> = [50.0, 60.0, 70.0]
        .iter()
        .zip(&poses)
        .map(|(f, pose)| Camera {
            fx: *f,
            camera_to_world: *pose,
            ..Camera::orbit(0.0, 0.0, 2.0, 1.0, 8)
        })
        .collect();
    let steps = |pair: &[Camera]| {
        let (a, b) = (pair[0], pair[1]);
        (0..5).map(move |i| a.interpolated(&b, i as f32 / 4.0))
    };
    let path: Vec<Camera> = cameras.windows(2).flat_map(steps).collect();
    let flat: Vec<f32> = path
        .iter()
        .flat_map(|c| c.camera_to_world.transpose().to_cols_array()[..12].to_vec())
        .collect();
    close(
        "interp.poses",
        &g["interp.poses_in_first3_steps5"],
        &flat,
        2e-6,
    );
    for (camera, k) in path.iter().zip(g["interp.K"].rows::<9>()) {
        assert_eq!(camera.fx, k[0]);
    }
}

fn point(row: &[f32]) -> Point {
    Point {
        color: [row[3], row[4], row[5]],
        ..Point::new(Vec3::new(row[0], row[1], row[2]), row[6])
    }
}

fn area(row: &[f32]) -> Area {
    let position = Vec3::new(row[0], row[1], row[2]);
    Area {
        color: [row[3], row[4], row[5]],
        ..Area::facing(position, Vec3::ZERO, row[7], row[6])
    }
}

/// The random places on the square that stored rays started from.
fn samples(area: &Area, rows: &[[f32; 10]]) -> Vec<[f32; 2]> {
    let place = |r: &[f32; 10]| {
        let offset = (Vec3::new(r[4], r[5], r[6]) - area.position) / area.size;
        area.sides().map(|side| offset.dot(side))
    };
    rows.iter().map(place).collect()
}

#[test]
fn light_rays() {
    let g = data();
    let sphere: Vec<f32> = fibonacci_sphere(64)
        .into_iter()
        .flat_map(|s| (light::SPHERE_RADIUS * s).to_array())
        .collect();
    close(
        "lights.fibonacci_sphere",
        &g["lights.fibonacci_sphere_r3_64"],
        &sphere,
        2e-6,
    );

    let single = point(&g["lights.point.pos_color_power"].data);
    for (name, power, n) in [
        ("rays", single.power, 64),
        ("rays_power5", 5.0, 4),
        ("rays_power4000", 4000.0, 4),
    ] {
        let rows = light::point_rays(&Point { power, ..single }, n);
        let name = format!("lights.point.{name}");
        close(&name, &g[&name], rows.as_flattened(), 2e-6);
    }

    let square = area(&g["lights.area.pos_color_power_size"].data);
    let stored = &g["lights.area.rays"];
    let places = samples(&square, &stored.rows());
    assert!(
        places.iter().flatten().all(|v| v.abs() <= 0.5 + 1e-5),
        "on the square"
    );
    close(
        "lights.area.rays",
        stored,
        light::area_rays(&square, &places).as_flattened(),
        3e-6,
    );

    // Three points and the area light, 128 rays shared out by power.
    let stored = &g["lights.multi.rays"];
    let rows = stored.rows::<10>();
    let mut lights = vec![Light::Area(square)];
    lights.extend(
        g["lights.multi.points_pos_color_power"]
            .rows::<7>()
            .iter()
            .map(|r| Light::Point(point(r))),
    );
    let first_area = rows.len() - 32;
    let places = samples(&square, &rows[first_area..]);
    let found = light::rays(&lights, 128, |i, n| {
        assert_eq!(n, 32);
        places[i]
    });
    close(
        "lights.multi.rays",
        stored,
        found.unwrap().as_flattened(),
        3e-6,
    );
    assert!(light::rays(&[], 8, |_, _| [0.0; 2]).is_err());
    assert!(light::rays(&lights, 3, |_, _| [0.0; 2]).is_err());
}

#[test]
fn images_are_loaded_as_pillow_does() {
    let g = data();
    for name in ["rgb_up", "rgba_square", "rgba_wide"] {
        let bytes = &g[&format!("image.{name}.u8_hwc")];
        let [height, width, channels] = bytes.shape[..] else {
            panic!("shape")
        };
        let image = Bytes {
            width,
            height,
            channels,
            data: bytes.data.iter().map(|v| *v as u8).collect(),
        };
        let k = &g[&format!("image.{name}.fxfycxcy_in")].data;
        let camera = Camera {
            width,
            height,
            fx: k[0],
            fy: k[1],
            cx: k[2],
            cy: k[3],
            camera_to_world: Mat4::IDENTITY,
        };
        let stored = &g[&format!("image.{name}.out_chw")];
        let (shown, camera) = prepare(&image, &camera, stored.shape[1], 8).unwrap();
        let planar: Vec<f32> = (0..3)
            .flat_map(|c| shown.pixels.iter().map(move |p| p[c]))
            .collect();
        close(&format!("image.{name}"), stored, &planar, 1e-6);
        let k = [camera.fx, camera.fy, camera.cx, camera.cy];
        close(
            &format!("image.{name}.fxfycxcy"),
            &g[&format!("image.{name}.fxfycxcy_out")],
            &k,
            1e-5,
        );
        assert_eq!((camera.width, camera.height), (32, 32));
    }
    let tall = Bytes {
        width: 4,
        height: 8,
        channels: 3,
        data: vec![0; 96],
    };
    let error = prepare(&tall, &Camera::orbit(0.0, 0.0, 2.0, 1.0, 8), 32, 8)
        .unwrap_err()
        .to_string();
    assert!(error.contains("image width"), "{error}");
}

#[test]
fn normalisation_keeps_what_light_does() {
    // The same similarity serves lights, which the authors' code forgets.
    let s = authors::normalise(&matrices(&data()["poses.c2w"]), authors::SCENE_SCALE).unwrap();
    let light = Light::Point(Point::new(Vec3::new(2.0, 1.0, 3.0), 900.0));
    let Light::Point(moved) = light.transformed(&s) else {
        panic!("kind")
    };
    let before = 900.0 / 14.0;
    let after = moved.power / moved.position.distance_squared(s.point(Vec3::ZERO));
    assert!((before - after).abs() < 1e-3);
    assert!(
        s.then(&s.inverse())
            .point(Vec3::X)
            .distance(Similarity::IDENTITY.point(Vec3::X))
            < 1e-5
    );
}
