//! Renders whose answer is known in closed form.

use lumi_core::glam::{Mat3, Vec3};
use lumi_core::{
    Area, Camera, EnvMap, Environment, Light, LinearImage, NamedLight, Point, Seed, Spot, Sun,
};
use lumi_render::film::{RenderSettings, render_basis};
use lumi_render::integrator::PathSettings;
use lumi_render::material::{Material, Opacity, Surface};
use lumi_render::objects::part::{Assembly, Part};
use lumi_render::objects::{primitives, procedural};
use lumi_render::scene::{Geometry, mesh::Model};
use std::f32::consts::PI;
use std::sync::Arc;

fn settings(samples: u32) -> RenderSettings {
    RenderSettings {
        samples,
        paths: PathSettings::UNBIASED,
        denoise: false,
    }
}

fn model(part: &Part, surface: Surface) -> Model {
    let mut assembly = Assembly::default();
    let m = assembly.material(Material::Plain(surface));
    assembly.add(part, m);
    assembly.finish()
}

fn named(lights: &[Light]) -> Vec<NamedLight> {
    let name = |(i, light): (usize, &Light)| NamedLight {
        name: format!("light{i}"),
        light: light.clone(),
    };
    lights.iter().enumerate().map(name).collect()
}

fn uniform(radiance: f32) -> Light {
    let map = Arc::new(EnvMap::uniform([radiance; 3]));
    Light::Environment(Environment::new(map, 0.3, 1.0))
}

fn render(model: Model, lights: &[Light], camera: &Camera, samples: u32) -> Vec<LinearImage> {
    let geometry = Geometry::new(model);
    let basis = render_basis(
        &geometry,
        named(lights),
        &[*camera],
        &settings(samples),
        Seed(1),
    );
    basis
        .radiance
        .into_iter()
        .map(|mut v| v.remove(0))
        .collect()
}

/// Mean of straight red over the pixels that are wholly covered.
fn mean(image: &LinearImage) -> f32 {
    let covered: Vec<f32> = image
        .pixels
        .iter()
        .filter(|p| p[3] == 1.0)
        .map(|p| p[0])
        .collect();
    assert!(covered.len() > 20);
    covered.iter().sum::<f32>() / covered.len() as f32
}

fn lambert(base: f32) -> Surface {
    Surface::lambert(Vec3::splat(base))
}

/// A plane of side 2 at z = 0 in 16 × 16 cells.
fn plane() -> Part {
    let n = 17;
    let at = |i: usize| 2.0 * i as f32 / (n - 1) as f32 - 1.0;
    let positions = (0..n * n)
        .map(|i| Vec3::new(at(i % n), at(i / n), 0.0))
        .collect();
    Part::grid(positions, n, (false, false), 0.5)
}

/// A narrow camera right above the plane's centre sees only points near the origin.
fn above(side: usize) -> Camera {
    Camera::look_at(Vec3::new(0.0, 0.0, 2.0), Vec3::ZERO, 0.02, side, side)
}

#[test]
fn furnace() {
    let camera = Camera::orbit(0.4, 0.5, 2.75, 0.87, 24);
    for (name, surface, low, high) in [
        (
            "white rough",
            Surface::dielectric(Vec3::ONE, 1.0),
            0.98,
            1.02,
        ),
        (
            "white glossy",
            Surface::dielectric(Vec3::ONE, 0.1),
            0.98,
            1.02,
        ),
        ("mirror", Surface::metal(Vec3::ONE, 0.05), 0.99, 1.01),
        ("rough metal", Surface::metal(Vec3::ONE, 0.9), 0.95, 1.03),
    ] {
        let images = render(
            model(&primitives::sphere(), surface),
            &[uniform(1.0)],
            &camera,
            64,
        );
        let m = mean(&images[0]);
        assert!(m > low && m < high, "{name}: {m}");
    }
}

#[test]
fn point_light_on_a_plane() {
    // L = ρ/π · I · cosθ / d²; a sphere seen whole brings what its centre would.
    for (x, height) in [(0.0_f32, 3.0_f32), (2.0, 2.5), (-3.0, 1.5)] {
        let light = Point::new(Vec3::new(x, 0.0, height), 800.0);
        let d2 = x * x + height * height;
        let exact = 0.8 / PI * light.intensity()[0] * (height / d2.sqrt()) / d2;
        let lights = [Light::Point(light)];
        let found = mean(&render(model(&plane(), lambert(0.8)), &lights, &above(8), 64)[0]);
        assert!(
            (found - exact).abs() < 0.002 * exact,
            "{found} against {exact}"
        );
    }
}

#[test]
fn area_light_on_a_plane() {
    for size in [0.5, 2.0, 4.0] {
        let light = Area::facing(Vec3::new(0.0, 0.0, 3.0), Vec3::ZERO, size, 900.0);
        // Irradiance of a parallel square on its axis: L · 4 a/√(a²+h²) · atan(a/√(a²+h²)) with half side a.
        let (a, h) = (0.5 * size, 3.0_f32);
        let s = (a * a + h * h).sqrt();
        let irradiance = light.radiance()[0] * 4.0 * (a / s) * (a / s).atan();
        let exact = 0.8 / PI * irradiance;
        let lights = [Light::Area(light)];
        let found = mean(&render(model(&plane(), lambert(0.8)), &lights, &above(8), 64)[0]);
        assert!(
            (found - exact).abs() < 0.005 * exact,
            "size {size}: {found} against {exact}"
        );
    }
}

#[test]
fn sun_on_a_plane() {
    // L = ρ/π · E · cosθ, as long as the whole disc is up.
    for (degrees, angle) in [
        (0.0_f32, 0.0),
        (0.0, 0.526),
        (60.0, 0.526),
        (60.0, 40.0),
        (25.0, 120.0),
    ] {
        let (s, c) = degrees.to_radians().sin_cos();
        let light = Sun {
            angle,
            ..Sun::new(Vec3::new(0.0, 5.0 * s, 5.0 * c), 3.0)
        };
        let exact = 0.8 / PI * 3.0 * c;
        let lights = [Light::Sun(light)];
        let found = mean(&render(model(&plane(), lambert(0.8)), &lights, &above(8), 256)[0]);
        assert!(
            (found - exact).abs() < 0.005 * exact,
            "{degrees}°, disc of {angle}°: {found} against {exact}"
        );
    }
}

#[test]
fn a_sun_of_some_width_casts_a_penumbra() {
    // An edge at the height h under a sun of the angular radius a above it: the light rises from none to all over 2 h tan a, and
    // half of it arrives below the edge. Between, a chord cuts the disc: at x = t · h tan a the part ½ + (t√(1−t²) + asin t)/π.
    let (height, angle) = (1.0_f32, 20.0_f32);
    let mut assembly = Assembly::default();
    let m = assembly.material(Material::Plain(lambert(0.8)));
    assembly.add(&plane().scaled(Vec3::splat(1.5)), m);
    let cover = plane().scaled(Vec3::new(5.0, 5.0, 1.0));
    assembly.add(&cover.at(Vec3::new(-5.0, 0.0, height)), m);
    let sun = Sun {
        angle,
        ..Sun::new(Vec3::Z, 3.0)
    };
    let geometry = Geometry::new(assembly.finish());
    let mut direct = settings(1024);
    direct.paths.max_bounces = 0;
    let reach = height * (0.5 * angle).to_radians().tan();
    let full = 0.8 / PI * 3.0;
    for t in [-1.3_f32, -0.5, 0.0, 0.5, 0.8, 1.3] {
        // From below the cover, on one small place.
        let place = Vec3::new(t * reach, 0.0, 0.0);
        let camera = Camera::look_at(place + Vec3::new(0.0, -0.4, 0.4), place, 0.02, 6, 6);
        let basis = render_basis(
            &geometry,
            named(&[Light::Sun(sun)]),
            &[camera],
            &direct,
            Seed(6),
        );
        let found = mean(&basis.radiance[0][0]) / full;
        let t = t.clamp(-1.0, 1.0);
        let part = 0.5 + (t * (1.0 - t * t).sqrt() + t.asin()) / PI;
        assert!(
            (found - part).abs() < 0.02,
            "t = {t}: {found} against {part}"
        );
    }
}

#[test]
fn a_spot_on_a_plane() {
    // L = ρ/π · I · falloff(cosθ) · cos³θ / h² on a plane at right angles to the axis, and nothing outside the cone.
    let (height, side) = (2.5_f32, 128_usize);
    // Far away, so that pixels are evenly spaced on the plane: two metres in all.
    let eye = Vec3::new(0.0, 0.0, 100.0);
    let camera = Camera::look_at(eye, Vec3::ZERO, 2.0 * 0.01_f32.atan(), side, side);
    let geometry = Geometry::new(model(&plane().scaled(Vec3::splat(1.5)), lambert(0.8)));
    let mut direct = settings(16);
    direct.paths.max_bounces = 0;
    for (angle, blend) in [(20.0_f32, 0.0), (30.0, 0.15), (40.0, 1.0)] {
        let light = Spot {
            angle,
            blend,
            radius: 0.0,
            ..Spot::facing(Vec3::new(0.0, 0.0, height), Vec3::ZERO, 800.0)
        };
        let lights = named(&[Light::Spot(light)]);
        let basis = render_basis(&geometry, lights, &[camera], &direct, Seed(6));
        let intensity = 800.0 / (4.0 * PI);
        let edge = height * (0.5 * angle).to_radians().tan();
        let pixel = 2.0 / side as f32;
        let place = |i: usize| (i as f32 + 0.5) * pixel - 1.0;
        let mut power = 0.0;
        for (i, p) in basis.radiance[0][0].pixels.iter().enumerate() {
            let irradiance = p[0] * PI / 0.8;
            power += irradiance * pixel * pixel;
            let off = place(i % side).hypot(place(i / side));
            // It falls from the axis outward: a pixel has what lies between its nearest and its farthest place.
            let exact = |off: f32| {
                let cosine = height / off.hypot(height);
                intensity * light.falloff(cosine) * cosine.powi(3) / (height * height)
            };
            let (least, most) = (exact(off + pixel), exact((off - pixel).max(0.0)));
            assert!(
                (0.998 * least..=1.002 * most).contains(&irradiance),
                "{angle}° at {off}: {irradiance} not of {least} to {most}"
            );
            assert!(off < edge + pixel || irradiance == 0.0);
        }
        // All of the cone falls on the plane.
        let half = (0.5 * angle).to_radians();
        let exact = 2.0 * PI * intensity * (1.0 - half.cos()) * (1.0 - 0.5 * blend);
        assert!(
            (power / exact - 1.0).abs() < 0.01,
            "{power} W against {exact}"
        );
    }
}

#[test]
fn sky_on_a_plane() {
    let found = mean(
        &render(
            model(&plane(), lambert(0.8)),
            &[uniform(1.5)],
            &above(8),
            64,
        )[0],
    );
    assert!((found - 1.2).abs() < 0.005, "{found}");
}

#[test]
fn see_through_surfaces_cover_and_shade_by_their_opacity() {
    // A sheet of opacity 0.3 before and above a plane: alpha is 0.3 where only the sheet is, and the plane in the
    // sheet's shadow keeps 0.7 of its light.
    let mut sheet = lumi_render::material::Textured::new(lambert(0.0));
    sheet.opacity = Opacity::Blend { factor: 0.3 };
    let mut assembly = Assembly::default();
    let white = assembly.material(Material::Plain(lambert(0.8)));
    let glass = assembly.material(Material::Textured(Box::new(sheet)));
    assembly.add(&plane().scaled(Vec3::splat(0.5)), white);
    let over = plane().at(Vec3::new(0.0, 0.0, 0.5));
    assembly.add(&over, glass);
    let geometry = Geometry::new(assembly.finish());
    let light = Point::new(Vec3::new(0.0, 0.0, 3.0), 800.0);
    let aside = Camera::look_at(
        Vec3::new(0.9, 0.0, 2.0),
        Vec3::new(0.9, 0.0, 0.0),
        0.02,
        8,
        8,
    );
    let under = Camera::look_at(Vec3::new(2.0, 0.0, 0.25), Vec3::ZERO, 0.02, 8, 8);
    let lights = named(&[Light::Point(light)]);
    let mut direct = settings(256);
    direct.paths.max_bounces = 0;
    let basis = render_basis(&geometry, lights, &[aside, under], &direct, Seed(4));
    let alpha: f32 = basis.radiance[0][0].pixels.iter().map(|p| p[3]).sum();
    assert!((alpha / 64.0 - 0.3).abs() < 0.01, "{}", alpha / 64.0);
    let exact = 0.7 * 0.8 / PI * light.intensity()[0] / 9.0;
    let found = mean(&basis.radiance[0][1]);
    assert!((found - exact).abs() < 0.01 * exact, "{found} {exact}");
}

#[test]
fn area_lights_shine_one_way_and_shadows_are_black() {
    let mut away = Area::facing(Vec3::new(0.0, 0.0, 3.0), Vec3::ZERO, 2.0, 900.0);
    away.target = 2.0 * away.position - away.target;
    // A disc between the light and the plane.
    let mut assembly = Assembly::default();
    let m = assembly.material(Material::Plain(lambert(0.8)));
    assembly.add(&plane(), m);
    let blocked = Point::new(Vec3::new(3.0, 0.0, 0.3), 900.0);
    let wall = plane()
        .scaled(Vec3::splat(0.9))
        .turned(Mat3::from_rotation_y(PI / 2.0));
    assembly.add(&wall.at(Vec3::new(0.5, 0.0, 0.0)), m);
    let camera = above(8);
    let lights = [Light::Area(away), Light::Point(blocked)];
    let geometry = Geometry::new(assembly.finish());
    let mut direct = settings(16);
    direct.paths.max_bounces = 0;
    let basis = render_basis(&geometry, named(&lights), &[camera], &direct, Seed(2));
    for images in &basis.radiance {
        assert!(images[0].pixels.iter().all(|p| p[0] == 0.0 && p[3] == 1.0));
    }
}

#[test]
fn sphere_covers_its_cone() {
    let camera = Camera::orbit(1.0, 0.4, 2.75, 0.87, 64);
    let geometry = Geometry::new(model(&primitives::sphere(), lambert(0.5)));
    let basis = render_basis(
        &geometry,
        named(&[uniform(1.0)]),
        &[camera],
        &settings(64),
        Seed(3),
    );
    let image = &basis.radiance[0][0];
    let alpha: f32 = image.pixels.iter().map(|p| p[3]).sum();
    // On the axis the outline is a circle of radius f · tan(asin(1/d)).
    let radius = camera.fx * (1.0_f32 / 2.75).asin().tan();
    let exact = PI * radius * radius;
    assert!(
        (alpha - exact).abs() < 0.01 * exact,
        "{alpha} against {exact}"
    );
    // Lights are not visible: nothing but the object has colour.
    assert!(
        image
            .pixels
            .iter()
            .all(|p| p[3] > 0.0 || p[..3] == [0.0; 3])
    );
}

#[test]
fn basis_sums_to_the_joint_render() {
    // The same light cut in two halves of the sky, and both local lights, against another seed's renders.
    let camera = Camera::orbit(0.3, 0.6, 2.75, 0.87, 24);
    let half = |top: bool| {
        let pixels = (0..32)
            .map(|i| [f32::from(u8::from((i < 16) == top)); 3])
            .collect();
        let map = EnvMap {
            width: 8,
            height: 4,
            pixels,
        };
        Light::Environment(Environment::new(Arc::new(map), 0.0, 1.0))
    };
    let parts = [half(true), half(false)];
    // One without smooth metal, whose caustics are fireflies.
    let object = || procedural(Seed(11).index(7), &Default::default());
    let images = render(object(), &parts, &camera, 256);
    let joint = render(object(), &[uniform(1.0)], &camera, 256);
    let sum = mean(&images[0]) + mean(&images[1]);
    let whole = mean(&joint[0]);
    assert!((sum - whole).abs() < 0.01 * whole, "{sum} against {whole}");
}

#[test]
fn lights_do_not_disturb_each_other() {
    // A light's image in a basis of three agrees with its image alone.
    let object = || {
        let surface = Surface::dielectric(Vec3::new(0.7, 0.5, 0.3), 0.5);
        model(&primitives::torus(0.5).scaled(Vec3::splat(0.6)), surface)
    };
    let camera = Camera::orbit(0.3, 0.6, 2.75, 0.87, 24);
    let lights = [
        uniform(0.7),
        Light::Point(Point::new(Vec3::new(2.0, 1.0, 3.0), 900.0)),
        Light::Area(Area::facing(
            Vec3::new(-2.0, 2.0, 2.5),
            Vec3::ZERO,
            2.0,
            900.0,
        )),
    ];
    let together = render(object(), &lights, &camera, 256);
    for (light, image) in lights.iter().zip(&together) {
        let alone = render(object(), std::slice::from_ref(light), &camera, 256);
        let (a, b) = (mean(image), mean(&alone[0]));
        assert!(
            (a - b).abs() < 0.01 * b,
            "{}: {a} against {b}",
            light.kind()
        );
    }
}

#[test]
fn strategies_agree() {
    // Area light and environment found by light sampling and by chance must carry the same energy: a glossy
    // floor mixes both, a rough one is mostly light samples; compare with brute force over a fine sky.
    let sky_patch = |size: usize| {
        let mut map = EnvMap {
            width: 2 * size,
            height: size,
            pixels: vec![[0.0; 3]; 2 * size * size],
        };
        // A bright cap around +z of 1/8 of the polar range.
        for p in &mut map.pixels[..2 * size * size / 8] {
            *p = [5.0; 3];
        }
        Light::Environment(Environment::new(Arc::new(map), 0.0, 1.0))
    };
    let camera = Camera::look_at(Vec3::new(0.0, 0.2, 2.0), Vec3::ZERO, 0.02, 8, 8);
    for roughness in [0.1, 0.3, 0.8] {
        let surface = Surface::metal(Vec3::ONE, roughness);
        let found = mean(&render(model(&plane(), surface), &[sky_patch(16)], &camera, 256)[0]);
        let fine = mean(&render(model(&plane(), surface), &[sky_patch(64)], &camera, 1024)[0]);
        assert!(
            (found - fine).abs() < 0.01 * fine,
            "roughness {roughness}: {found} {fine}"
        );
        if roughness == 0.1 {
            // The reflected cone lies wholly inside the cap.
            assert!((found - 5.0).abs() < 0.1, "{found}");
        }
    }
}

#[test]
fn threads_do_not_matter() {
    let camera = Camera::orbit(0.3, 0.6, 2.75, 0.87, 16);
    let lights = [
        uniform(0.7),
        Light::Point(Point::new(Vec3::new(2.0, 1.0, 3.0), 900.0)),
    ];
    let with = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .expect("pool");
        pool.install(|| {
            render(
                procedural(Seed(5), &Default::default()),
                &lights,
                &camera,
                4,
            )
        })
    };
    assert_eq!(with(1), with(2));
}
