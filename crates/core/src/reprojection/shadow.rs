//! Lamps, the cones that they shine in, and what the surface leaves visible of them.

use super::direct::Spot;
use super::ray::{Line, Ray};
use super::{RADIUS, Reprojection};
use crate::light::LightRay;
use glam::Vec3;

/// Where a shadow ray begins and how far above the surface it runs: of a hull, and of a surface that was found, which is less even.
const BEGIN: [[f32; 2]; 2] = [[0.06, 0.03], [0.1, 0.08]];
/// How long its steps are.
const STEP: f32 = 0.07;
/// Steps of a shadow ray.
const SHADOW_STEPS: usize = 14;
/// Visibility at which a shadow is as dark as can be told.
const DARK: f32 = 0.05;

/// Distant rays within this angle's cosine of another one are of one sun.
const SUN: f32 = 0.9995;

/// Rays of a lamp from which its cone can be told.
const CONE_RAYS: usize = 4;
/// Share of the rays' solid angle in that of the scene beyond which a lamp has no cone.
const WHOLE: f32 = 0.9;
/// How far a cone's edge reaches, each way, as a share of its height on the unit sphere.
const SOFT: f32 = 0.1;

/// Light from one place or from one direction.
pub(super) struct Lamp {
    pub from: From,
    /// At the scene's centre.
    pub irradiance: [f32; 3],
}

/// Where a lamp is.
pub(super) enum From {
    /// There, with its cone if it has one.
    Place(Vec3, Option<Cone>),
    /// Infinitely far away, that way.
    Direction(Vec3),
}

/// The cone of a spot, as its rays show it.
pub(super) struct Cone {
    axis: Vec3,
    /// Cosine of the angle to its edge.
    edge: f32,
    /// Irradiance on the axis over the mean over the scene.
    gain: f32,
}

/// Consecutive rays from one place are one lamp, and those from almost one direction one sun; other rays from infinity are sky.
pub(super) fn sorted(rays: &[LightRay]) -> (Vec<Lamp>, Vec<&LightRay>) {
    let (mut lamps, mut sky) = (Vec::new(), Vec::new());
    let together = |a: &LightRay, b: &LightRay| match (a.origin, b.origin) {
        (None, None) => a.direction.dot(b.direction) > SUN,
        (a, b) => a == b,
    };
    for rays in rays.chunk_by(together) {
        let sum = |f: fn(&LightRay) -> Vec3| rays.iter().map(f).sum::<Vec3>();
        let irradiance = sum(|ray| Vec3::from_array(ray.irradiance)).to_array();
        let direction = sum(|ray| ray.direction);
        let from = match rays[0].origin {
            Some(place) => From::Place(place, Cone::of(place, direction, rays.len())),
            None if rays.len() > 1 => From::Direction(-direction.normalize_or_zero()),
            None => {
                sky.push(&rays[0]);
                continue;
            }
        };
        lamps.push(Lamp { from, irradiance });
    }
    (lamps, sky)
}

impl Cone {
    /// `sum` is that of the directions of `n` rays. Over a cone whose edge has the cosine e, the mean of evenly spread directions is
    /// (1 + e) / 2 long, and its solid angle 2π (1 − e). `None` if they go to all of the unit ball.
    fn of(place: Vec3, sum: Vec3, n: usize) -> Option<Self> {
        if n < CONE_RAYS {
            return None;
        }
        let mean = sum / n as f32;
        let edge = 2.0 * mean.length() - 1.0;
        let ball = (1.0 - 1.0 / place.length_squared()).max(0.0).sqrt();
        let part = (1.0 - edge) / (1.0 - ball).max(f32::MIN_POSITIVE);
        (part < WHOLE).then(|| Self {
            axis: mean.normalize_or_zero(),
            edge,
            gain: 1.0 / part.max(1e-3),
        })
    }

    fn toward(&self, direction: Vec3) -> f32 {
        let soft = (SOFT * (1.0 - self.edge)).max(1e-6);
        let x = ((direction.dot(self.axis) - self.edge) / soft).clamp(-1.0, 1.0);
        let x = 0.5 + 0.5 * x;
        self.gain * x * x * (3.0 - 2.0 * x)
    }
}

impl Lamp {
    /// The way toward it from a place, how far it is, and how much more light it brings there than to the scene's centre.
    pub fn at(&self, here: Vec3) -> (Vec3, f32, f32) {
        match &self.from {
            From::Direction(toward) => (*toward, f32::INFINITY, 1.0),
            From::Place(place, cone) => {
                let way = *place - here;
                let toward = way.normalize_or_zero();
                let fall = place.length_squared() / way.length_squared().max(1e-4);
                let within = cone.as_ref().map_or(1.0, |cone| cone.toward(-toward));
                (toward, way.length(), fall * within)
            }
        }
    }
}

impl Reprojection {
    /// How much of a light that way and so far off the surface leaves visible.
    pub(super) fn visible(&self, spot: &Spot, toward: Vec3, far: f32, lines: &mut [Line]) -> f32 {
        let [begin, above] = BEGIN[usize::from(self.swept)];
        let from = spot.place + above * spot.normal;
        let ray = Ray::new(from, toward);
        self.aim(lines, &ray);
        let span = self.covered(&ray, lines);
        let mut visible = 1.0_f32;
        for k in 0..SHADOW_STEPS {
            let t = begin + STEP * k as f32;
            if t > far || (from + t * toward).length() > RADIUS {
                break;
            }
            let t = t - ray.to_nearest;
            if t < span[0] || t > span[1] {
                continue;
            }
            let coverage = self.solid(t, lines);
            visible = visible.min(1.0 - coverage);
            if visible < DARK {
                break;
            }
        }
        visible
    }
}
