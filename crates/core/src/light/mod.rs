//! Lights: environment, point, area. A new light is one file here plus one variant.

mod area;
mod environment;
mod point;
mod rays;
pub mod release;
mod spec;

pub use area::Area;
pub use environment::{EnvMap, Environment};
pub use point::Point;
pub use rays::{LightRay, LightRays, RayPattern, fibonacci_sphere};
pub use spec::LightSpec;

use crate::{Result, Similarity};

/// A source of light, in Blender's units.
#[derive(Clone, Debug, PartialEq)]
pub enum Light {
    /// Distant radiance from a lat-long map.
    Environment(Environment),
    /// A small sphere that shines equally in all directions.
    Point(Point),
    /// A one-sided Lambertian square.
    Area(Area),
}

impl Light {
    /// The same light `gain` times as strong, per colour channel.
    #[must_use]
    pub fn scaled(&self, gain: [f32; 3]) -> Self {
        match self {
            Self::Environment(l) => Self::Environment(l.scaled(gain)),
            Self::Point(l) => Self::Point(l.scaled(gain)),
            Self::Area(l) => Self::Area(l.scaled(gain)),
        }
    }

    /// The light as seen after `s` moved the whole scene: radiance that reaches corresponding points is unchanged,
    /// so watts grow with the square of the scale.
    #[must_use]
    pub fn transformed(&self, s: &Similarity) -> Self {
        match self {
            Self::Environment(l) => Self::Environment(l.transformed(s)),
            Self::Point(l) => Self::Point(l.transformed(s)),
            Self::Area(l) => Self::Area(l.transformed(s)),
        }
    }

    /// The light as rays toward the unit ball at the origin (model space), in a fixed number per light.
    #[must_use]
    pub fn rays(&self, pattern: &RayPattern) -> LightRays {
        match self {
            Self::Environment(l) => l.rays(pattern),
            Self::Point(l) => l.rays(pattern),
            Self::Area(l) => l.rays(pattern),
        }
    }

    /// Checks ranges: finite, non-negative, something greater than zero, outside the unit ball where it has a place.
    /// Call it in model space.
    ///
    /// # Errors
    /// Names the field and what was expected.
    pub fn validate(&self) -> Result<()> {
        match self {
            Self::Environment(l) => l.validate(),
            Self::Point(l) => l.validate(),
            Self::Area(l) => l.validate(),
        }
    }

    /// `environment`, `point` or `area`.
    #[must_use]
    pub fn kind(&self) -> &'static str {
        match self {
            Self::Environment(_) => "environment",
            Self::Point(_) => "point",
            Self::Area(_) => "area",
        }
    }
}
