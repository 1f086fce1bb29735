//! Paths of light: one camera path serves every light of the basis.

use crate::bsdf::{Bsdf, Normals, Scattering};
use crate::light::Emitter;
use crate::sampling::{Sampler, power_weight};
use crate::scene::{Geometry, OFFSET, Shading};
use lumi_core::glam::Vec3;

/// How far paths are followed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PathSettings {
    /// Reflections after the first visible surface.
    pub max_bounces: u32,
    /// Largest radiance that one indirect contribution may have; cuts fireflies at the price of a
    /// slight loss of energy. `None` is unbiased.
    pub clamp_indirect: Option<f32>,
    /// Smallest GGX α after a diffuse bounce, and four times the smallest after a specular one (as Cycles'
    /// "filter glossy"): caustics that sampling would find as single bright pixels become soft. 0 is unbiased.
    pub glossy_floor: f32,
    /// Samples of each environment and area light at the first surface, where most of their noise arises.
    pub light_samples: u32,
    /// What rough surfaces do with light that bounces between their microfacets.
    pub scattering: Scattering,
}

impl Default for PathSettings {
    fn default() -> Self {
        Self {
            max_bounces: 4,
            clamp_indirect: Some(30.0),
            glossy_floor: 0.25,
            light_samples: 4,
            scattering: Scattering::Multiple,
        }
    }
}

impl PathSettings {
    /// Without any approximation but the number of bounces.
    pub const UNBIASED: Self = Self {
        max_bounces: 16,
        clamp_indirect: None,
        glossy_floor: 0.0,
        light_samples: 1,
        scattering: Scattering::Multiple,
    };
}

/// Indirect shadow rays that could add less than this radiance are traced only with a probability
/// in proportion (and weighted up): most of them would not be visible.
const SHADOW_ROULETTE: f32 = 0.05;

/// Radiance per emitter, gathered along paths.
pub struct Gathered<'a> {
    /// Light that reached the first surface straight from the emitter.
    pub direct: &'a mut [Vec3],
    /// Light that was reflected before.
    pub indirect: &'a mut [Vec3],
}

/// Follows the path that starts with the ray from `origin` along `direction` and adds the radiance which each
/// emitter sends along it to `gathered`. Returns the first surface; nothing is added where the ray misses,
/// since lights are not visible.
pub fn trace(
    geometry: &Geometry,
    emitters: &[Emitter],
    settings: &PathSettings,
    (mut origin, mut direction): (Vec3, Vec3),
    sampler: &mut Sampler,
    gathered: &mut Gathered<'_>,
) -> Option<Shading> {
    let mut hit = geometry.visible(origin, direction, || sampler.pair().x)?;
    let mut first = None;
    let mut throughput = Vec3::ONE;
    let mut alpha_floor = 0.0;
    for bounce in 0..=settings.max_bounces {
        let limit = if bounce == 0 {
            None
        } else {
            settings.clamp_indirect
        };
        let shading = geometry.shading(origin, direction, &hit);
        first.get_or_insert(shading);
        let radiance = if bounce == 0 {
            &mut *gathered.direct
        } else {
            &mut *gathered.indirect
        };
        let normals = Normals::from(&shading);
        let bsdf = Bsdf::new(
            &shading.surface,
            normals,
            -direction,
            alpha_floor,
            settings.scattering,
        );

        // Light that comes straight from each emitter.
        for (emitter, sum) in emitters.iter().zip(radiance.iter_mut()) {
            let count = if bounce == 0 && emitter.extended() {
                settings.light_samples
            } else {
                1
            };
            for u in sampler.pairs(count) {
                let Some(light) = emitter.sample(shading.position, u) else {
                    continue;
                };
                if light.direction.dot(shading.smooth) <= 0.0 {
                    continue;
                }
                let (value, pdf) = bsdf.evaluate(light.direction);
                if pdf == 0.0 {
                    continue;
                }
                let density = light.pdf * count as f32;
                // Paths do not go where the triangle hides the light, so nothing is to be weighed there.
                let met = emitter.extended() && light.direction.dot(shading.geometric) > 0.0;
                let weight = if met { power_weight(density, pdf) } else { 1.0 };
                let mut contribution = throughput * value * light.radiance * (weight / density);
                let largest = contribution.max_element();
                if largest <= 0.0 {
                    continue;
                }
                if bounce > 0 && largest < SHADOW_ROULETTE {
                    let survival = largest / SHADOW_ROULETTE;
                    if sampler.pair().x >= survival {
                        continue;
                    }
                    contribution /= survival;
                }
                let start = shading.shadow_start(light.direction);
                let length = light.distance - 2.0 * OFFSET;
                let passed = geometry.transmittance(start, light.direction, length);
                if passed > 0.0 {
                    *sum += clamped(passed * contribution, limit);
                }
            }
        }

        // The next direction, and the emitters that it meets by chance.
        let (choice, u) = (sampler.pair(), sampler.pair());
        let Some(next) = bsdf.sample(choice.x, u) else {
            break;
        };
        if next.direction.dot(shading.geometric) <= 0.0 {
            break;
        }
        throughput *= next.weight;
        if bounce > 0 {
            let survival = throughput.max_element().min(0.95);
            if choice.y >= survival {
                break;
            }
            throughput /= survival;
        }
        (origin, direction) = (shading.start(), next.direction);
        let found = geometry.visible(origin, direction, || sampler.pair().x);
        let distance = found.map_or(f32::INFINITY, |h| h.distance);
        for (emitter, sum) in emitters.iter().zip(radiance.iter_mut()) {
            if let Some((light, pdf)) = emitter.seen(origin, direction, distance) {
                let count = if bounce == 0 {
                    settings.light_samples
                } else {
                    1
                };
                let weight = power_weight(next.pdf, pdf * count as f32);
                let contribution = throughput * light * weight;
                *sum += clamped(contribution, limit);
            }
        }
        let Some(next_hit) = found else {
            break;
        };
        hit = next_hit;
        let share = if next.specular { 0.25 } else { 1.0 };
        alpha_floor = f32::max(alpha_floor, share * settings.glossy_floor);
    }
    first
}

/// A contribution within the limit. What degenerate geometry made infinite or undefined counts as black:
/// one such path must not spoil an image, let alone a set.
fn clamped(contribution: Vec3, limit: Option<f32>) -> Vec3 {
    let largest = contribution.max_element();
    match limit {
        _ if !contribution.is_finite() => Vec3::ZERO,
        Some(limit) if largest > limit => contribution * (limit / largest),
        _ => contribution,
    }
}
