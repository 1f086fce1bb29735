//! How fast the path tracer is: `speed [--python BLENDER_PYTHON] [--side 128] [--triangles 100000]`.
//!
//! Prints rays per second, the cost of each further light and the growth with triangles; with Blender's Python module
//! (see `lumi_render::cycles`) also the time to equal error, which Cycles needs for its lights one by one.
//! Errors are root mean squares, relative to the mean, without denoising, each renderer against its own converged
//! render, so that what the two see differently is not taken for noise. `tests/cycles.rs` holds how near they are.

use anyhow::{Context, bail};
use lumi_core::glam::Vec3;
use lumi_core::{Area, Camera, Light, LightBasis, NamedLight, Point, Seed};
use lumi_render::cycles::Cycles;
use lumi_render::film::{RenderSettings, render_basis};
use lumi_render::generate::{Assets, GenerateConfig, Job};
use lumi_render::integrator::PathSettings;
use lumi_render::material::{Material, Surface};
use lumi_render::objects::part::{Assembly, Part};
use lumi_render::sampling::Sampler;
use lumi_render::scene::{Geometry, mesh::Model};
use std::f32::consts::{PI, TAU};
use std::time::Instant;

fn main() -> anyhow::Result<()> {
    let (mut python, mut side, mut triangles) = (None, 128, 100_000);
    let mut arguments = std::env::args().skip(1);
    while let Some(argument) = arguments.next() {
        let value = arguments.next().context("every option needs a value")?;
        match argument.as_str() {
            "--python" => python = Some(value),
            "--side" => side = value.parse()?,
            "--triangles" => triangles = value.parse()?,
            _ => bail!("unknown option {argument}"),
        }
    }
    println!("| triangles | build, s | camera rays, Mrays/s | random rays, Mrays/s |");
    println!("|---|---|---|---|");
    for n in [1_000, 10_000, 100_000, 1_000_000] {
        rays(n);
    }
    let job = job(side, triangles);
    let geometry = Geometry::new(job.model.clone());
    println!("\n| lights | s at 16 paths per pixel |\n|---|---|");
    for n in [1, 2, 4, 8] {
        let start = Instant::now();
        native(&geometry, &job, n, 16, 1);
        println!("| {n} | {:.2} |", start.elapsed().as_secs_f64());
    }
    let truth = native(&geometry, &job, job.lights.len(), 4096, 2);
    println!(
        "\n| renderer | paths per pixel | s for all lights | relative error |\n|---|---|---|---|"
    );
    let mut ours_cost = Vec::new();
    for samples in [4, 16, 64, 256] {
        let start = Instant::now();
        let ours = native(&geometry, &job, job.lights.len(), samples, 1);
        let seconds = start.elapsed().as_secs_f64();
        let error = error(&ours, &truth);
        ours_cost.push(seconds * error * error);
        println!("| ours | {samples} | {seconds:.2} | {error:.4} |");
    }
    if let Some(python) = python {
        let cycles = Cycles::new(&python);
        let other = Job {
            pixels: Seed(2),
            ..job.clone()
        };
        let truth = cycles.render(&other, 2048, false)?.basis;
        let mut cost = Vec::new();
        for samples in [4, 16, 64, 256] {
            let made = cycles.render(&job, samples, false)?;
            // The first image also builds the hierarchy; later ones do not, as in a long run.
            let (n, later) = (made.seconds.len(), &made.seconds[1..]);
            let seconds = later.iter().sum::<f64>() / later.len() as f64 * n as f64;
            let error = error(&made.basis, &truth);
            cost.push(seconds * error * error);
            println!("| Cycles | {samples} | {seconds:.2} | {error:.4} |");
        }
        // The square of the error falls as time grows, so their product is the price of a given error. With few paths
        // fixed costs would count, hence the last two rows.
        let mean = |cost: &[f64]| cost[2..].iter().sum::<f64>() / 2.0;
        let ratio = mean(&cost) / mean(&ours_cost);
        println!("\nAt equal error Cycles takes {ratio:.1} times as long.");
    }
    Ok(())
}

/// A wavy ball of about `n` triangles.
fn ball(n: usize) -> Model {
    let rows = ((n as f32 / 4.0).sqrt() as usize).max(4);
    let columns = 2 * rows;
    let mut positions = Vec::with_capacity(rows * columns);
    for i in 0..rows {
        let (s, c) = (PI * (i as f32 / (rows - 1) as f32 - 0.5)).sin_cos();
        for k in 0..columns {
            let (sa, ca) = (TAU * k as f32 / columns as f32).sin_cos();
            let p = Vec3::new(c.max(0.0) * ca, c.max(0.0) * sa, s);
            positions.push(p * (1.0 + 0.15 * (7.0 * p.x).sin() * (6.0 * p.z).cos()));
        }
    }
    let mut assembly = Assembly::default();
    let surface = Surface::dielectric(Vec3::new(0.7, 0.5, 0.3), 0.4);
    let m = assembly.material(Material::Plain(surface));
    assembly.add(&Part::grid(positions, columns, (false, true), 1.2), m);
    let mut model = assembly.finish();
    model.mesh.normalise();
    model
}

fn rays(n: usize) {
    let model = ball(n);
    let start = Instant::now();
    let geometry = Geometry::new(model);
    let build = start.elapsed().as_secs_f64();
    let count = 400_000;
    let camera = Camera::orbit(0.3, 0.4, 2.75, 0.87, 512);
    let start = Instant::now();
    let mut hits = 0;
    for i in 0..count {
        let (x, y) = (i % 512, i / 512 % 512);
        let d = camera.direction(x as f32 + 0.5, y as f32 + 0.5);
        hits += usize::from(geometry.intersect(camera.centre(), d).is_some());
    }
    let coherent = count as f64 / start.elapsed().as_secs_f64() / 1e6;
    let start = Instant::now();
    for i in 0..count as u32 {
        let mut sampler = Sampler::new(i, 0, 1);
        let (a, b) = (sampler.pair(), sampler.pair());
        let origin = 2.0 * Vec3::new(a.x - 0.5, a.y - 0.5, b.x - 0.5);
        let d = Vec3::new((b.y * 61.0).sin(), (b.y * 97.0).cos(), a.x - b.x).normalize();
        hits += usize::from(geometry.intersect(origin, d).is_some());
    }
    let random = count as f64 / start.elapsed().as_secs_f64() / 1e6;
    assert!(hits > 0);
    let triangles = geometry.triangles();
    println!("| {triangles} | {build:.3} | {coherent:.2} (one thread) | {random:.2} |");
}

/// One view of a wavy ball under two procedural skies, four point and two area lights.
fn job(side: usize, triangles: usize) -> Job {
    let config = GenerateConfig {
        resolution: side,
        views: 1,
        environments: [2, 2],
        ..GenerateConfig::default()
    };
    let mut job = config.job(5, &Assets::default()).expect("a job");
    job.model = ball(triangles);
    job.lights.truncate(2);
    let named = |i: usize, light: Light| NamedLight {
        name: format!("local{i}"),
        light,
    };
    for i in 0..6 {
        let (s, c) = (1.1 * i as f32).sin_cos();
        let at = 3.5 * Vec3::new(c, s, 0.8).normalize();
        let light = if i < 4 {
            Light::Point(Point::new(at, 800.0))
        } else {
            Light::Area(Area::facing(at, Vec3::ZERO, 1.5, 800.0))
        };
        job.lights.push(named(i, light));
    }
    job
}

fn native(geometry: &Geometry, job: &Job, lights: usize, samples: u32, seed: u64) -> LightBasis {
    let settings = RenderSettings {
        samples,
        paths: PathSettings {
            max_bounces: 12,
            ..PathSettings::UNBIASED
        },
        denoise: false,
    };
    let lights = job.lights[..lights].to_vec();
    render_basis(geometry, lights, &job.cameras, &settings, Seed(seed))
}

/// Root mean square difference over the object, relative to each light's mean, averaged over lights.
fn error(a: &LightBasis, truth: &LightBasis) -> f64 {
    let each = a.radiance.iter().zip(&truth.radiance).map(|(a, b)| {
        let (mut square, mut sum, mut n) = (0.0, 0.0, 0.0);
        for (p, q) in a[0].pixels.iter().zip(&b[0].pixels) {
            if q[3] > 0.999 {
                for c in 0..3 {
                    square += f64::from(p[c] - q[c]).powi(2);
                    sum += f64::from(q[c]);
                    n += 1.0;
                }
            }
        }
        (square / n).sqrt() / (sum / n)
    });
    each.sum::<f64>() / a.radiance.len() as f64
}
