//! What one training sample is: an object, views, a source light and a chain of edits, all drawn from a seed.

use crate::augment::{Shot, World};
use crate::object::{Lighting, Object};
use crate::plan::Plan;
use lumi_core::light::{LightRay, LightRays};
use lumi_core::seed::Rng;
use lumi_core::{Camera, DisplayImage, LinearImage, Reprojection, Result, Seed};
use lumi_model::batch::{self, Given};
use lumi_model::config::{Mode, Output};
use lumi_model::lights::{self, LightShape};
use lumi_model::radiance::CURVE;
use lumi_model::{Illumination, ModelConfig, illumination};
use rand::RngExt;
use rand::seq::SliceRandom;

/// Pictures that a sample asks for, channel-first, as the model's output is compared with them.
///
/// Display-encoded over white, `[targets, 3, r, r]`; or, for models that make radiance, `[targets, 4, r, r]`: what
/// [`shown`] makes of the truth's radiance, times alpha, and alpha.
pub type Truth = Vec<f32>;

/// One edit of a sample.
pub struct EditSample {
    /// What the network is told of the light.
    pub light: EditLights,
    /// What it would be told of all light after it, set at once, for models told lights by their shape; where the plan asks for
    /// short ways and that light is known.
    pub at_once: Option<EditLights>,
    /// The light that it adds, by itself; where the plan asks for that.
    pub alone: Option<Alone>,
    /// Targets after it.
    pub truth: Truth,
    /// What the network's colours are multiplied with before they are compared; 1 for display-encoded pictures.
    pub exposure: f32,
    /// How the light after it falls on the targets, `[targets, DIRECT, r, r]`; empty for models that are not told.
    pub direct: Vec<f32>,
}

/// Light that is added, as if it were all there is.
pub struct Alone {
    /// What the network is told of it.
    pub light: EditLights,
    /// How it falls on the targets, as [`EditSample::direct`].
    pub direct: Vec<f32>,
    /// Its share of all light after it, per channel.
    pub share: [f32; 3],
}

/// What a network is told of the light of one sample's edit.
pub enum EditLights {
    /// Ray features with power, `[rays, 10]`.
    Rays(Vec<f32>),
    /// Its shape.
    Shape(LightShape),
}

/// One sample as flat channel-first arrays; concatenated over a batch they become tensors.
pub struct Sample {
    /// `[inputs, c, r, r]`, c = [`ModelConfig::posed_channels`]
    pub posed: Vec<f32>,
    /// The inputs under another light, as `posed`; empty if the plan wants none.
    pub other: Vec<f32>,
    /// `[targets, c, r, r]`, c = [`ModelConfig::target_channels`]
    pub targets: Vec<f32>,
    /// Cameras of the inputs and of the targets, in model space.
    pub cameras: [Vec<Camera>; 2],
    /// Targets under the source light; empty if the plan does not want them.
    pub source: Truth,
    /// As [`EditSample::exposure`].
    pub exposure: f32,
    /// Background that pictures are compared over.
    pub background: [f32; 3],
    /// Base colour of the targets, `[targets, 3, r, r]`; empty if the plan does not want it.
    pub albedo: Vec<f32>,
    /// The light of the edits that go before, in order.
    pub before: Vec<EditLights>,
    /// Edits, in order.
    pub edits: Vec<EditSample>,
}

impl Sample {
    /// Draws a sample of `object` for `plan`.
    ///
    /// # Errors
    /// If one of its pictures cannot be read.
    pub fn draw(object: &Object, plan: &Plan, config: &ModelConfig, seed: Seed) -> Result<Self> {
        let rng = &mut seed.stream("sample");
        let mut views: Vec<usize> = (0..object.cameras().len()).collect();
        views.shuffle(rng);
        let (inputs, rest) = views.split_at(plan.inputs.min(views.len()));
        // Objects with few views repeat inputs as targets rather than fail.
        let given = inputs.iter().cycle().take(plan.input_targets);
        let novel = rest
            .iter()
            .chain(inputs)
            .cycle()
            .take(plan.targets - plan.input_targets);
        let targets: Vec<usize> = given.chain(novel).copied().collect();
        let mut seen = [inputs, &targets].concat();
        seen.sort_unstable();
        seen.dedup();

        let world = if plan.augment {
            World::draw(rng)
        } else {
            World::as_rendered()
        };
        let moves = &mut seed.stream("shift");
        let mut shots = |views: &[usize]| -> Vec<Shot> {
            let shot = |&view: &usize| Shot::draw(view, plan.shift, moves);
            views.iter().map(shot).collect()
        };
        let (inputs, targets) = (shots(inputs), shots(&targets));
        let camera = |shot: &Shot| world.camera(&shot.camera(&object.cameras()[shot.view]));
        let picture = |shot: &Shot, image| world.picture(shot.picture(&image));

        let mut light = object.draw_source(&seen, plan.augment, rng)?;
        let photographs_under = |light: &Lighting| -> Result<Vec<DisplayImage>> {
            let photograph =
                |shot: &Shot| Ok(picture(shot, object.lit(shot.view, light)?).to_display());
            inputs.iter().map(photograph).collect()
        };
        let stacked = |view: &dyn Fn(usize) -> Result<LinearImage>| -> Result<Vec<LinearImage>> {
            let images = targets
                .iter()
                .map(|shot| Ok(picture(shot, view(shot.view)?)));
            images.collect()
        };
        let exposures = &mut seed.stream("exposure");
        let mut truth = |light: &Lighting, scale: Illumination| -> Result<(Truth, f32)> {
            let images = stacked(&|view| object.lit(view, light))?;
            Ok(match config.output {
                Output::Display => (displayed(&images), 1.0),
                Output::Radiance => exposed(images, scale, exposures),
            })
        };
        let photographs = photographs_under(&light)?;
        let cameras = [&inputs, &targets].map(|shots| shots.iter().map(camera).collect::<Vec<_>>());
        let carried = config
            .reprojection
            .then(|| Reprojection::new(photographs.iter().zip(&cameras[0])));
        let posed = |photographs: &[DisplayImage]| -> Vec<f32> {
            let each = photographs.iter().zip(&cameras[0]).enumerate();
            let channels = |(i, (image, camera)): (usize, (&DisplayImage, &Camera))| {
                let photograph = carried.as_ref().map(|all| (all, i));
                batch::posed_channels(image, camera, photograph, config)
            };
            each.flat_map(channels).collect()
        };
        let other = if plan.other_light {
            let other = object.draw_source(&seen, plan.augment, &mut seed.stream("other light"))?;
            posed(&photographs_under(&other)?)
        } else {
            Vec::new()
        };
        let captured = carried.as_ref().map(Given::captured);
        let target = |camera: &Camera| batch::target_channels(camera, captured, config);
        let given = cameras[1].iter().flat_map(target).collect();
        let mut surfaces = Vec::new();
        if let Some(photographs) = carried.as_ref().filter(|_| config.direct)
            && !plan.edits.is_empty()
        {
            surfaces.extend(cameras[1].iter().map(|c| photographs.surface(c)));
        }
        // All light but the source's, which a first `set` replaces.
        let (mut known, mut all_known) = (Vec::new(), false);
        let mut scale = Illumination::CAPTURED;
        let (source, exposure) = match plan.reconstruct {
            true => truth(&light, scale)?,
            false => (Truth::new(), 1.0),
        };
        let albedo = if plan.albedo {
            displayed(&stacked(&|view| object.albedo(view))?)
        } else {
            Vec::new()
        };
        let (mut before, mut edits) = (Vec::new(), Vec::with_capacity(plan.edits.len()));
        for (i, kind) in plan.before.iter().chain(&plan.edits).enumerate() {
            let brought = match kind.mode {
                Mode::Remove => object.of_kinds(&light, kind.counts),
                _ => object.draw_lights(kind.counts, &seen, plan.augment, rng)?,
            };
            light = match kind.mode {
                Mode::Set => brought.clone(),
                Mode::Add => [&light[..], &brought].concat(),
                Mode::Remove => {
                    light.retain(|mixture| !brought.contains(mixture));
                    light
                }
            };
            let rays = rays_of(object, &brought, &world, config)?;
            known = illumination::known_rays(&known, kind.mode, &rays);
            all_known |= kind.mode == Mode::Set;
            let (told, share) = match config.output {
                Output::Display => {
                    let features = lights::features_of(rays.clone());
                    (EditLights::Rays(features), None)
                }
                Output::Radiance => {
                    let (shape, change) = LightShape::new(&rays, kind.mode, scale)?;
                    scale = change.after;
                    (EditLights::Shape(shape), Some(change.share))
                }
            };
            if i < plan.before.len() {
                before.push(told);
                continue;
            }
            let short = plan.short_ways && all_known && kind.mode != Mode::Set;
            let at_once = match (config.output, short) {
                (Output::Radiance, true) => {
                    let (shape, _) = LightShape::new(&known, Mode::Set, scale)?;
                    Some(EditLights::Shape(shape))
                }
                _ => None,
            };
            let falls = |rays: &[LightRay], scale| {
                let each = surfaces.iter();
                each.flat_map(|s| batch::direct(s, rays, scale)).collect()
            };
            let adds = kind.mode == Mode::Add && i > plan.before.len();
            let alone = match share.filter(|_| plan.alone && adds) {
                Some(share) => {
                    let (shape, change) = LightShape::new(&rays, Mode::Set, scale)?;
                    Some(Alone {
                        light: EditLights::Shape(shape),
                        direct: falls(&rays, change.after),
                        share: share.map(|w| w as f32),
                    })
                }
                None => None,
            };
            let (truth, exposure) = truth(&light, scale)?;
            edits.push(EditSample {
                light: told,
                at_once,
                alone,
                truth,
                exposure,
                direct: falls(&known, scale),
            });
        }
        Ok(Self {
            posed: posed(&photographs),
            other,
            targets: given,
            cameras,
            source,
            exposure,
            background: background(&mut seed.stream("background")),
            albedo,
            before,
            edits,
        })
    }
}

/// White as often as not, which most pictures are shown on; else any colour.
fn background(rng: &mut Rng) -> [f32; 3] {
    match rng.random::<bool>() {
        true => [1.0; 3],
        false => rng.random(),
    }
}

/// Display-encoded over white, channel-first.
fn displayed(images: &[LinearImage]) -> Vec<f32> {
    let shown = images.iter().map(LinearImage::to_display);
    shown
        .flat_map(|image| batch::colours(&image).collect::<Vec<_>>())
        .collect()
}

/// Least and greatest mean luminance of the object in the pictures that are compared.
const EXPOSED: [f32; 2] = [0.08, 0.45];

/// What a viewer sees of a colour on the network's curve: beyond white it goes on as a logarithm, so that highlights count
/// without outweighing all else.
#[must_use]
pub fn shown(colour: f32) -> f32 {
    colour.min(1.0) + BEYOND_WHITE * colour.max(1.0).ln()
}

/// Share of what is beyond white in [`shown`].
pub const BEYOND_WHITE: f32 = 0.25;

/// Radiance under an illumination as the network is to make it, at a drawn exposure; and the factor that the exposure is on
/// the network's curve.
fn exposed(mut images: Vec<LinearImage>, scale: Illumination, rng: &mut Rng) -> (Truth, f32) {
    let gain = scale
        .0
        .map(|g| if g > 0.0 { (1.0 / g) as f32 } else { 0.0 });
    let (mut sum, mut coverage) = (0.0_f64, 0.0_f64);
    for pixel in images.iter_mut().flat_map(|image| &mut image.pixels) {
        for (value, gain) in pixel.iter_mut().zip(gain) {
            *value *= gain;
        }
        sum += f64::from(0.2126 * pixel[0] + 0.7152 * pixel[1] + 0.0722 * pixel[2]);
        coverage += f64::from(pixel[3]);
    }
    let mean = (sum / coverage.max(1.0)).max(1e-4) as f32;
    let [least, most] = EXPOSED;
    let wanted = least * (most / least).powf(rng.random::<f32>());
    let exposure = (wanted / mean).powf(1.0 / CURVE);
    let mut truth = Vec::new();
    for image in &images {
        for c in 0..3 {
            truth.extend(image.pixels.iter().map(|pixel| {
                let alpha = pixel[3].clamp(0.0, 1.0);
                if alpha <= 0.0 {
                    return 0.0;
                }
                let colour = (pixel[c] / alpha).max(0.0).powf(1.0 / CURVE);
                alpha * shown(exposure * colour)
            }));
        }
        truth.extend(image.pixels.iter().map(|pixel| pixel[3].clamp(0.0, 1.0)));
    }
    (truth, exposure)
}

/// The rays of `lighting` in a changed world.
fn rays_of(
    object: &Object,
    lighting: &Lighting,
    world: &World,
    config: &ModelConfig,
) -> Result<LightRays> {
    let pattern = config.lights.pattern();
    let mut rays = Vec::new();
    for mixture in lighting {
        let parts = mixture.parts.iter().map(|&(i, gain)| {
            let light = world.light(&object.light(i)?.light.scaled(gain));
            Ok(light.rays(&pattern))
        });
        rays.extend(summed(parts.collect::<Result<Vec<_>>>()?));
    }
    Ok(rays.into_iter().map(|ray| world.ray(ray)).collect())
}

/// The rays of several environments together, which all have those of one grid; or one light's own.
fn summed(parts: Vec<LightRays>) -> LightRays {
    let mut parts = parts.into_iter();
    let mut sum = parts.next().unwrap_or_default();
    for part in parts {
        for (sum, ray) in sum.iter_mut().zip(part) {
            let both = sum.irradiance.iter_mut().zip(ray.irradiance);
            both.for_each(|(sum, more)| *sum += more);
        }
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::*;
    use lumi_core::light::RayPattern;
    use lumi_core::{EnvMap, Environment, Light};
    use std::sync::Arc;

    #[test]
    fn two_environments_are_the_one_with_both_maps() {
        let map = |f: fn(usize) -> f32| EnvMap {
            width: 16,
            height: 8,
            pixels: (0..128).map(|i| [f(i), 1.0, f(i + 1)]).collect(),
        };
        let (a, b) = (map(|i| (i % 5) as f32), map(|i| (i % 7) as f32));
        let mut both = a.clone();
        for (sum, more) in both.pixels.iter_mut().zip(&b.pixels) {
            *sum = std::array::from_fn(|k| 0.5 * sum[k] + 2.0 * more[k]);
        }
        let pattern = RayPattern {
            environment_rows: 8,
            environment_columns: 16,
            local_rays: 8,
        };
        let rays = |map, strength| {
            Light::Environment(Environment::new(Arc::new(map), 0.7, strength)).rays(&pattern)
        };
        let sum = summed(vec![rays(a, 0.5), rays(b, 2.0)]);
        let expected = rays(both, 1.0);
        assert_eq!(sum.len(), expected.len());
        for (sum, expected) in sum.iter().zip(&expected) {
            assert_eq!(sum.direction, expected.direction);
            for (a, b) in sum.irradiance.iter().zip(expected.irradiance) {
                assert!((a - b).abs() < 1e-5 * b.max(1.0), "{a} instead of {b}");
            }
        }
    }
}
