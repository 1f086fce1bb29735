//! A lighting: which lights of a basis shine, and how strongly.

use lumi_core::{Error, Light, LightBasis, Result, Scene};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Gains by light name. A gain multiplies the radiance of the light's images and, equally, the
/// strength or power of the light itself.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Lighting(pub BTreeMap<String, f32>);

impl<S: Into<String>, const N: usize> From<[(S, f32); N]> for Lighting {
    fn from(gains: [(S, f32); N]) -> Self {
        gains.into_iter().collect()
    }
}

impl<S: Into<String>> FromIterator<(S, f32)> for Lighting {
    fn from_iter<I: IntoIterator<Item = (S, f32)>>(gains: I) -> Self {
        Self(gains.into_iter().map(|(n, g)| (n.into(), g)).collect())
    }
}

impl Lighting {
    /// One light at gain 1.
    #[must_use]
    pub fn single(name: &str) -> Self {
        Self::from([(name, 1.0)])
    }

    /// Both lightings together; gains of the same light add.
    #[must_use]
    pub fn plus(&self, other: &Self) -> Self {
        let mut sum = self.clone();
        for (name, gain) in &other.0 {
            *sum.0.entry(name.clone()).or_default() += gain;
        }
        sum
    }

    /// Index in `basis` and per-channel gain of each light, as [`LightBasis::compose`] wants them.
    ///
    /// # Errors
    /// Names an unknown light or a bad gain; an empty lighting is an error.
    pub fn resolve(&self, basis: &LightBasis) -> Result<Vec<(usize, [f32; 3])>> {
        self.check(
            |name| basis.find(name).is_some(),
            || {
                basis
                    .lights
                    .iter()
                    .map(|l| l.name.as_str())
                    .collect::<Vec<_>>()
                    .join(", ")
            },
        )?;
        let index = |(name, &gain): (&String, &f32)| Some((basis.find(name)?, [gain; 3]));
        Ok(self.0.iter().filter_map(index).collect())
    }

    /// The lights themselves in world space, with their gains applied.
    ///
    /// # Errors
    /// If the scene has no light basis, and as [`Lighting::resolve`].
    pub fn lights(&self, scene: &Scene) -> Result<Vec<Light>> {
        let basis = basis(scene)?;
        let light = |&(i, gain): &(usize, [f32; 3])| basis.lights[i].light.scaled(gain);
        Ok(self.resolve(basis)?.iter().map(light).collect())
    }

    /// Checks names and gains; `list` names the lights there are.
    pub(crate) fn check(
        &self,
        knows: impl Fn(&str) -> bool,
        list: impl Fn() -> String,
    ) -> Result<()> {
        if self.0.is_empty() {
            return Err(Error::value("lighting", "expected at least one light"));
        }
        for (name, gain) in &self.0 {
            if !knows(name) {
                let expected = format!("expected one of the lights {}", list());
                return Err(Error::value(format!("light `{name}`"), expected));
            }
            if !(gain.is_finite() && *gain >= 0.0) {
                let expected = format!("expected a gain ≥ 0, found {gain}");
                return Err(Error::value(format!("light `{name}`"), expected));
            }
        }
        Ok(())
    }
}

/// The light basis of `scene`.
pub(crate) fn basis(scene: &Scene) -> Result<&LightBasis> {
    scene.basis.as_ref().ok_or_else(|| {
        let expected = "expected one-light-at-a-time images, found only photographs";
        Error::value(format!("scene `{}`", scene.name), expected)
    })
}
