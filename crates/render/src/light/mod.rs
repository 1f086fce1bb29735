//! The lights of a basis as the path tracer samples them.

mod environment;
mod sun;

use crate::sampling::frame;
use environment::EnvironmentSampler;
use lumi_core::glam::{Vec2, Vec3};
use lumi_core::{Light, Point, Spot};
use std::f32::consts::{PI, TAU};
use sun::SunSampler;

pub use environment::MAP_ROWS;

/// A light that can be sampled.
pub enum Emitter {
    /// Distant radiance.
    Environment(EnvironmentSampler),
    /// A small sphere. Only ever sampled as a light: paths find it too rarely to be worth a test.
    Point(PointSampler),
    /// A one-sided square.
    Area(AreaSampler),
    /// A small sphere that shines within a cone; sampled as [`Self::Point`].
    Spot(PointSampler, Spot),
    /// A distant disc.
    Sun(SunSampler),
}

/// A direction toward a light.
#[derive(Clone, Copy, Debug)]
pub struct LightSample {
    /// Unit direction from the surface.
    pub direction: Vec3,
    /// Distance to the light; infinite for environments.
    pub distance: f32,
    /// Radiance from there.
    pub radiance: Vec3,
    /// Density per steradian.
    pub pdf: f32,
}

/// A point light with what its samples need.
pub struct PointSampler {
    position: Vec3,
    radius: f32,
    intensity: Vec3,
}

/// An area light with what its samples need.
pub struct AreaSampler {
    position: Vec3,
    direction: Vec3,
    sides: [Vec3; 2],
    size: f32,
    radiance: Vec3,
}

impl Emitter {
    /// Prepares a light.
    #[must_use]
    pub fn new(light: &Light) -> Self {
        match light {
            Light::Environment(l) => Self::Environment(EnvironmentSampler::new(l)),
            Light::Point(l) => Self::Point(PointSampler::new(l)),
            Light::Area(l) => Self::Area(AreaSampler {
                position: l.position,
                direction: l.direction(),
                sides: l.sides(),
                size: l.size,
                radiance: l.radiance().into(),
            }),
            Light::Spot(l) => Self::Spot(PointSampler::new(&l.bulb()), *l),
            Light::Sun(l) => Self::Sun(SunSampler::new(l)),
        }
    }

    /// Draws a direction toward the light from `position`; `None` where it cannot shine.
    #[must_use]
    pub fn sample(&self, position: Vec3, u: Vec2) -> Option<LightSample> {
        match self {
            Self::Environment(l) => l.sample(u),
            Self::Point(l) => l.sample(position, u),
            Self::Area(l) => l.sample(position, u),
            Self::Spot(bulb, cone) => {
                let sample = bulb.sample(position, u)?;
                let falloff = cone.falloff(-sample.direction.dot(cone.direction()));
                let radiance = falloff * sample.radiance;
                (falloff > 0.0).then_some(LightSample { radiance, ..sample })
            }
            Self::Sun(l) => Some(l.sample(u)),
        }
    }

    /// Radiance which a ray that was not aimed at the light receives from it when the ray ends at
    /// `distance`, and the density with which [`Self::sample`] would have drawn the direction.
    #[must_use]
    pub fn seen(&self, origin: Vec3, direction: Vec3, distance: f32) -> Option<(Vec3, f32)> {
        match self {
            Self::Environment(l) => distance.is_infinite().then(|| l.radiance(direction)),
            Self::Point(_) | Self::Spot(..) => None,
            Self::Sun(l) => l.seen(direction).filter(|_| distance.is_infinite()),
            Self::Area(l) => l.seen(origin, direction, distance),
        }
    }

    /// Whether the light has an extent worth more than one sample; paths that meet it by chance count it,
    /// so samples must be weighted against them.
    #[must_use]
    pub fn extended(&self) -> bool {
        match self {
            Self::Environment(_) | Self::Area(_) => true,
            Self::Point(_) | Self::Spot(..) => false,
            Self::Sun(l) => l.extended(),
        }
    }
}

impl PointSampler {
    fn new(light: &Point) -> Self {
        Self {
            position: light.position,
            radius: light.radius,
            intensity: light.intensity().into(),
        }
    }

    /// Uniform in the cone that the sphere fills. With radiance I/(πr²) it brings exactly I/d² at normal incidence.
    fn sample(&self, position: Vec3, u: Vec2) -> Option<LightSample> {
        let to = self.position - position;
        let d2 = to.length_squared();
        if d2 <= self.radius * self.radius {
            return None;
        }
        let distance = d2.sqrt();
        let axis = to / distance;
        let sin2 = self.radius * self.radius / d2;
        // 1 − cos of the cone; the quotient keeps its digits when the cone is narrow.
        let height = sin2 / (1.0 + (1.0 - sin2).sqrt());
        let z = 1.0 - u.x * height;
        let r = (u.x * height * (2.0 - u.x * height)).max(0.0).sqrt();
        let (s, c) = (TAU * u.y).sin_cos();
        let (tangent, bitangent) = frame(axis);
        let solid = TAU * height;
        if solid <= 0.0 {
            // A point without extent: all of its light comes along the axis.
            return Some(LightSample {
                direction: axis,
                distance,
                radiance: self.intensity / d2,
                pdf: 1.0,
            });
        }
        Some(LightSample {
            direction: (r * c * tangent + r * s * bitangent + z * axis).normalize(),
            distance: distance - self.radius,
            radiance: self.intensity / (PI * self.radius * self.radius),
            pdf: 1.0 / solid,
        })
    }
}

impl AreaSampler {
    fn sample(&self, position: Vec3, u: Vec2) -> Option<LightSample> {
        let [side, other] = self.sides;
        let point = self.position + self.size * ((u.x - 0.5) * side + (u.y - 0.5) * other);
        let to = point - position;
        let d2 = to.length_squared();
        let distance = d2.sqrt();
        let direction = to / distance;
        let cosine = -direction.dot(self.direction);
        (cosine > 1e-5).then(|| LightSample {
            direction,
            distance,
            radiance: self.radiance,
            pdf: d2 / (cosine * self.size * self.size),
        })
    }

    fn seen(&self, origin: Vec3, direction: Vec3, distance: f32) -> Option<(Vec3, f32)> {
        let cosine = -direction.dot(self.direction);
        if cosine <= 1e-5 {
            return None;
        }
        let t = (origin - self.position).dot(self.direction) / cosine;
        if t <= 0.0 || t >= distance {
            return None;
        }
        let offset = origin + t * direction - self.position;
        let half = 0.5 * self.size;
        let inside = self
            .sides
            .iter()
            .all(|side| offset.dot(*side).abs() <= half);
        inside.then(|| (self.radiance, t * t / (cosine * self.size * self.size)))
    }
}
