//! Lights: each is one type, which is also its JSON, its command-line syntax and its schema.
//!
//! A new light is one file here, a variant of [`LightSource`], and what the compiler then asks for (CONTRIBUTING.md).

mod area;
pub mod authors;
mod environment;
mod field;
mod point;
mod rays;
mod spec;
mod spot;
mod sun;

pub use area::Area;
pub use environment::{EnvMap, Environment};
pub use point::Point;
pub use rays::{LightRay, LightRays, RayPattern, fibonacci_sphere};
pub use spec::LightEntry;
pub use spot::Spot;
pub use sun::Sun;

use crate::{Result, Similarity};
use glam::Vec3;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::convert::Infallible;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// A source of light, in Blender's units. `M` is an environment's map, or what stands for it where the light is written down.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(tag = "kind", rename_all = "snake_case")]
#[schemars(rename = "Light")]
pub enum LightSource<M> {
    /// Distant radiance from a lat-long map.
    Environment(Environment<M>),
    /// A small sphere that shines equally in all directions.
    Point(Point),
    /// A one-sided Lambertian square.
    Area(Area),
    /// A small sphere that shines within a cone.
    Spot(Spot),
    /// A distant disc.
    Sun(Sun),
}

/// A light with its map: what renderers and networks take.
pub type Light = LightSource<Arc<EnvMap>>;

/// A light as it is written on the command line and in files of edits, its map a file that is not read yet.
pub type LightSpec = LightSource<PathBuf>;

/// What a light at `position` that shines along `direction` points at: a place as far ahead as its coordinates are large, so that
/// rounding leaves the direction as it is.
#[must_use]
pub fn ahead(position: Vec3, direction: Vec3) -> Vec3 {
    position + position.length().max(1.0) * direction.normalize_or_zero()
}

/// `match` with the same expression for every kind.
macro_rules! each {
    ($light:expr, $l:ident => $value:expr) => {
        match $light {
            LightSource::Environment($l) => $value,
            LightSource::Point($l) => $value,
            LightSource::Area($l) => $value,
            LightSource::Spot($l) => $value,
            LightSource::Sun($l) => $value,
        }
    };
}

/// `match` that makes of each kind another light of that kind.
macro_rules! map_each {
    ($light:expr, $l:ident => $value:expr) => {
        match $light {
            LightSource::Environment($l) => LightSource::Environment($value),
            LightSource::Point($l) => LightSource::Point($value),
            LightSource::Area($l) => LightSource::Area($value),
            LightSource::Spot($l) => LightSource::Spot($value),
            LightSource::Sun($l) => LightSource::Sun($value),
        }
    };
}

impl<M> LightSource<M> {
    /// `environment`, `point`, `area`, `spot` or `sun`, as in JSON.
    #[must_use]
    pub fn kind(&self) -> &'static str {
        match self {
            Self::Environment(_) => "environment",
            Self::Point(_) => "point",
            Self::Area(_) => "area",
            Self::Spot(_) => "spot",
            Self::Sun(_) => "sun",
        }
    }

    /// Where it stands; `None` for distant light.
    #[must_use]
    pub fn position(&self) -> Option<Vec3> {
        match self {
            Self::Point(l) => Some(l.position),
            Self::Area(l) => Some(l.position),
            Self::Spot(l) => Some(l.position),
            Self::Environment(_) | Self::Sun(_) => None,
        }
    }

    /// Its power in watts; `None` for distant light.
    #[must_use]
    pub fn power(&self) -> Option<f32> {
        match self {
            Self::Point(l) => Some(l.power),
            Self::Area(l) => Some(l.power),
            Self::Spot(l) => Some(l.power),
            Self::Environment(_) | Self::Sun(_) => None,
        }
    }

    /// What an environment has for its map; `None` for all other lights.
    #[must_use]
    pub fn map(&self) -> Option<&M> {
        match self {
            Self::Environment(l) => Some(&l.map),
            _ => None,
        }
    }

    /// The same light with another thing for its map; `map` is asked for environments only.
    #[must_use]
    pub fn with_map<N>(self, map: impl FnOnce(M) -> N) -> LightSource<N> {
        let Ok(light) = self.try_with_map(|m| Ok::<_, Infallible>(map(m)));
        light
    }

    /// [`Self::with_map`] where there may be none.
    ///
    /// # Errors
    /// Those of `map`.
    pub fn try_with_map<N, E>(
        self,
        map: impl FnOnce(M) -> std::result::Result<N, E>,
    ) -> std::result::Result<LightSource<N>, E> {
        Ok(match self {
            Self::Environment(l) => LightSource::Environment(Environment {
                map: map(l.map)?,
                rotate: l.rotate,
                rotation: l.rotation,
                strength: l.strength,
            }),
            Self::Point(l) => LightSource::Point(l),
            Self::Area(l) => LightSource::Area(l),
            Self::Spot(l) => LightSource::Spot(l),
            Self::Sun(l) => LightSource::Sun(l),
        })
    }

    /// Checks what can be told without the map and the scene: finite numbers within their ranges, something greater than zero.
    ///
    /// # Errors
    /// Names the field and what was expected.
    pub fn check(&self) -> Result<()> {
        each!(self, l => l.check())
    }
}

impl Light {
    /// The same light `gain` times as strong, per colour channel.
    #[must_use]
    pub fn scaled(&self, gain: [f32; 3]) -> Self {
        map_each!(self, l => l.scaled(gain))
    }

    /// The light as seen after `s` moved the whole scene: radiance that reaches corresponding points is unchanged,
    /// so watts grow with the square of the scale.
    #[must_use]
    pub fn transformed(&self, s: &Similarity) -> Self {
        map_each!(self, l => l.transformed(s))
    }

    /// The light as rays toward the unit ball at the origin (model space), in a fixed number per light.
    #[must_use]
    pub fn rays(&self, pattern: &RayPattern) -> LightRays {
        each!(self, l => l.rays(pattern))
    }

    /// [`Self::check`], and whether the map is one and the light shines on the unit ball, from outside where it has a place.
    /// Call it in model space.
    ///
    /// # Errors
    /// Names the field and what was expected.
    pub fn validate(&self) -> Result<()> {
        self.check()?;
        match self {
            Self::Environment(l) => l.map.validate(),
            Self::Point(l) => field::outside("point", l.position),
            Self::Area(l) => field::outside("area", l.position),
            Self::Spot(l) => field::outside("spot", l.position).and_then(|()| l.reaches()),
            Self::Sun(_) => Ok(()),
        }
    }
}

impl LightSpec {
    /// Reads what there is to read; relative files are relative to `base`.
    ///
    /// # Errors
    /// If an environment map cannot be read or holds no light.
    pub fn open(&self, base: &Path) -> Result<Light> {
        Ok(self.open_with_warnings(base)?.0)
    }

    /// [`LightSpec::open`], and what there is to say of the map, by its file.
    ///
    /// # Errors
    /// As [`LightSpec::open`].
    pub fn open_with_warnings(&self, base: &Path) -> Result<(Light, Vec<String>)> {
        let mut warnings = Vec::new();
        let light = self.clone().try_with_map(|file| {
            let (map, said) = EnvMap::read_with_warnings(base.join(&file))?;
            let named = said
                .iter()
                .map(|text| format!("{}: {text}", file.display()));
            warnings.extend(named);
            Ok(Arc::new(map))
        });
        light.map(|light: Light| (light, warnings))
    }
}
