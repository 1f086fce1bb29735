//! Renders the views of a scene under each light of a basis.

use crate::integrator::{PathSettings, trace};
use crate::light::Emitter;
use crate::sampling::{Sampler, hash};
use crate::scene::Geometry;
use lumi_core::glam::Vec3;
use lumi_core::{Camera, LightBasis, LinearImage, NamedLight, Seed};
use rayon::prelude::*;

/// How images are sampled.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RenderSettings {
    /// Paths per pixel; powers of two are best stratified.
    pub samples: u32,
    /// The paths.
    pub paths: PathSettings,
}

/// One camera under every light: an image per light, with the same alpha in all of them. Lights are not visible.
///
/// Each pixel draws from its own stream of `seed`, so the result does not depend on the number of threads.
#[must_use]
pub fn render_view(
    geometry: &Geometry,
    emitters: &[Emitter],
    camera: &Camera,
    settings: &RenderSettings,
    seed: Seed,
) -> Vec<LinearImage> {
    let (width, height) = (camera.width, camera.height);
    let rows: Vec<Row> = (0..height)
        .into_par_iter()
        .map(|y| Row::render(geometry, emitters, camera, settings, seed, y))
        .collect();
    let mut images = vec![LinearImage::new(width, height); emitters.len()];
    for (y, row) in rows.iter().enumerate() {
        for x in 0..width {
            for (l, image) in images.iter_mut().enumerate() {
                let [r, g, b] = row.radiance[x * emitters.len() + l].to_array();
                image.pixels[y * width + x] = [r, g, b, row.alpha[x]];
            }
        }
    }
    images
}

/// Every camera under every light.
#[must_use]
pub fn render_basis(
    geometry: &Geometry,
    lights: Vec<NamedLight>,
    cameras: &[Camera],
    settings: &RenderSettings,
    seed: Seed,
) -> LightBasis {
    let emitters: Vec<Emitter> = lights.iter().map(|l| Emitter::new(&l.light)).collect();
    let views: Vec<Vec<LinearImage>> = cameras
        .par_iter()
        .enumerate()
        .map(|(i, camera)| render_view(geometry, &emitters, camera, settings, seed.index(i as u64)))
        .collect();
    let mut radiance: Vec<Vec<LinearImage>> = lights.iter().map(|_| Vec::new()).collect();
    for view in views {
        for (images, image) in radiance.iter_mut().zip(view) {
            images.push(image);
        }
    }
    LightBasis { lights, radiance }
}

struct Row {
    /// `[x, light]`, premultiplied.
    radiance: Vec<Vec3>,
    alpha: Vec<f32>,
}

impl Row {
    fn render(
        geometry: &Geometry,
        emitters: &[Emitter],
        camera: &Camera,
        settings: &RenderSettings,
        seed: Seed,
        y: usize,
    ) -> Self {
        let (width, lights) = (camera.width, emitters.len());
        let mut row = Self {
            radiance: vec![Vec3::ZERO; width * lights],
            alpha: vec![0.0; width],
        };
        let share = 1.0 / settings.samples as f32;
        for x in 0..width {
            let pixel = seed.index((y * width + x) as u64).0;
            let pixel = hash(pixel as u32) ^ (pixel >> 32) as u32;
            let sums = &mut row.radiance[x * lights..][..lights];
            let mut covered = 0_u32;
            for index in 0..settings.samples {
                let mut sampler = Sampler::new(pixel, index, settings.samples);
                let jitter = sampler.pair();
                let d = camera.direction(x as f32 + jitter.x, y as f32 + jitter.y);
                let ray = (camera.centre(), d);
                let hit = trace(geometry, emitters, &settings.paths, ray, &mut sampler, sums);
                covered += u32::from(hit);
            }
            for sum in sums {
                *sum *= share;
            }
            row.alpha[x] = covered as f32 * share;
        }
        row
    }
}
