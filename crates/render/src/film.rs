//! Renders the views of a scene under each light of a basis.

use crate::denoise::{Feature, demodulated, smooth, smooth_direct};
use crate::integrator::{Gathered, PathSettings, trace};
use crate::light::Emitter;
use crate::sampling::{Sampler, hash};
use crate::scene::{Geometry, Shading};
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
    /// Whether to smooth indirect light, see [`crate::denoise`].
    pub denoise: bool,
}

/// What a camera sees besides light.
#[derive(Clone, Debug)]
pub struct Guides {
    /// Base colour and coverage, premultiplied.
    pub albedo: LinearImage,
    /// Unit shading normal in the world per covered pixel, row-major; zero where nothing is.
    pub normal: Vec<Vec3>,
    /// Mean depth of what covers the pixel along the camera's axis, row-major; infinite where nothing is.
    pub depth: Vec<f32>,
}

/// One camera under every light.
#[derive(Clone, Debug)]
pub struct RenderedView {
    /// An image per light, with the same alpha in all of them. Lights are not visible.
    pub images: Vec<LinearImage>,
    /// Albedo, normals and depth.
    pub guides: Guides,
}

/// Every camera under every light.
#[derive(Clone, Debug)]
pub struct Rendered {
    /// The images.
    pub basis: LightBasis,
    /// Per view.
    pub guides: Vec<Guides>,
}

/// Renders one camera under every light.
///
/// Each pixel draws from its own stream of `seed`, so the result does not depend on the number of threads.
#[must_use]
pub fn render_view(
    geometry: &Geometry,
    emitters: &[Emitter],
    camera: &Camera,
    settings: &RenderSettings,
    seed: Seed,
) -> RenderedView {
    let (width, height) = (camera.width, camera.height);
    let rows: Vec<Row> = (0..height)
        .into_par_iter()
        .map(|y| Row::render(geometry, emitters, camera, settings, seed, y))
        .collect();
    let lights = emitters.len();
    let mut film = Row::default();
    for row in rows {
        film.direct.extend(row.direct);
        film.squares.extend(row.squares);
        film.indirect.extend(row.indirect);
        film.features.extend(row.features);
    }
    if settings.denoise {
        let (eye, pixel) = (camera.centre(), 1.0 / camera.fx);
        smooth(&mut film.indirect, &film.features, width, eye, pixel);
        let extended: Vec<bool> = emitters.iter().map(Emitter::extended).collect();
        let (features, squares) = (&film.features, &film.squares);
        smooth_direct(
            &mut film.direct,
            squares,
            features,
            &extended,
            width,
            eye,
            pixel,
        );
    }
    let share = 1.0 / settings.samples as f32;
    let image = |l: usize| {
        let pixels = film.features.iter().enumerate().map(|(p, feature)| {
            let sum = film.direct[p * lights + l] + film.indirect[p * lights + l];
            (sum * share).extend(feature.hits * share).to_array()
        });
        LinearImage {
            width,
            height,
            pixels: pixels.collect(),
        }
    };
    RenderedView {
        images: (0..lights).map(image).collect(),
        guides: guides(camera, &film.features, share),
    }
}

fn guides(camera: &Camera, features: &[Feature], share: f32) -> Guides {
    let (centre, forward) = (camera.centre(), camera.forward());
    let depth = |f: &Feature| {
        if f.hits > 0.0 {
            (f.position / f.hits - centre).dot(forward)
        } else {
            f32::INFINITY
        }
    };
    let albedo = |f: &Feature| (f.base * share).extend(f.hits * share).to_array();
    Guides {
        albedo: LinearImage {
            width: camera.width,
            height: camera.height,
            pixels: features.iter().map(albedo).collect(),
        },
        normal: features
            .iter()
            .map(|f| f.normal.normalize_or_zero())
            .collect(),
        depth: features.iter().map(depth).collect(),
    }
}

/// Every camera under every light, without the guides.
#[must_use]
pub fn render_basis(
    geometry: &Geometry,
    lights: Vec<NamedLight>,
    cameras: &[Camera],
    settings: &RenderSettings,
    seed: Seed,
) -> LightBasis {
    render(geometry, lights, cameras, settings, seed).basis
}

/// Every camera under every light.
#[must_use]
pub fn render(
    geometry: &Geometry,
    lights: Vec<NamedLight>,
    cameras: &[Camera],
    settings: &RenderSettings,
    seed: Seed,
) -> Rendered {
    let emitters: Vec<Emitter> = lights.iter().map(|l| Emitter::new(&l.light)).collect();
    let views: Vec<RenderedView> = cameras
        .par_iter()
        .enumerate()
        .map(|(i, camera)| render_view(geometry, &emitters, camera, settings, seed.index(i as u64)))
        .collect();
    let mut radiance: Vec<Vec<LinearImage>> = lights.iter().map(|_| Vec::new()).collect();
    let mut guides = Vec::new();
    for view in views {
        for (images, image) in radiance.iter_mut().zip(view.images) {
            images.push(image);
        }
        guides.push(view.guides);
    }
    Rendered {
        basis: LightBasis { lights, radiance },
        guides,
    }
}

/// A row of pixels, or several; sums over the samples.
#[derive(Default)]
struct Row {
    /// `[x, light]`.
    direct: Vec<Vec3>,
    /// `[x, light]`: of the luminance of each sample's direct light over its base colour.
    squares: Vec<f32>,
    /// `[x, light]`.
    indirect: Vec<Vec3>,
    features: Vec<Feature>,
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
            direct: vec![Vec3::ZERO; width * lights],
            squares: vec![0.0; width * lights],
            indirect: vec![Vec3::ZERO; width * lights],
            features: vec![Feature::default(); width],
        };
        let mut sample = vec![Vec3::ZERO; lights];
        for x in 0..width {
            let pixel = seed.index((y * width + x) as u64).0;
            let pixel = hash(pixel as u32) ^ (pixel >> 32) as u32;
            let own = x * lights..(x + 1) * lights;
            for index in 0..settings.samples {
                let mut sampler = Sampler::new(pixel, index, settings.samples);
                let jitter = sampler.pair();
                let d = camera.direction(x as f32 + jitter.x, y as f32 + jitter.y);
                let ray = (camera.centre(), d);
                let paths = &settings.paths;
                sample.fill(Vec3::ZERO);
                let mut gathered = Gathered {
                    direct: &mut sample,
                    indirect: &mut row.indirect[own.clone()],
                };
                let hit = trace(geometry, emitters, paths, ray, &mut sampler, &mut gathered);
                let Some(first) = hit else {
                    continue;
                };
                add_feature(&mut row.features[x], &first);
                for ((v, sum), square) in sample
                    .iter()
                    .zip(&mut row.direct[own.clone()])
                    .zip(&mut row.squares[own.clone()])
                {
                    *sum += *v;
                    *square += demodulated(*v, first.surface.base).powi(2);
                }
            }
        }
        row
    }
}

fn add_feature(feature: &mut Feature, first: &Shading) {
    let surface = &first.surface;
    feature.position += first.position;
    feature.normal += first.normal;
    feature.base += surface.base;
    feature.hits += 1.0;
    // What a metal reflects is as sharp as it is smooth; full blur from roughness 0.5.
    let rough = (4.0 * surface.roughness * surface.roughness).min(1.0);
    feature.blur += 1.0 - surface.metallic * (1.0 - rough);
}
