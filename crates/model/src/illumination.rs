//! Light by construction: what is exact about light transport needs no learning
//! (docs/decisions/0013-illumination-scale.md).
//!
//! A scene's state is its tokens and an illumination scale g, three numbers. Its picture is g·y per channel, with y the
//! decoder's radiance. Light transport is linear in each channel by itself, so with E the irradiance that a light brings to
//! the scene's centre and κ a constant,
//!
//! ```text
//! set:     g' = κE            share w = 1
//! add:     g' = g + κE        share w = κE / g'     y' = (1 − w) y + w y_light
//! remove:  g' = g − κE        share w = κE / g      y' = (y − w y_light) / (1 − w)
//! ```
//!
//! and the network is told each light's shape and its share alone. Captured photographs have g = 1.

use crate::config::Mode;
use lumi_core::light::LightRay;
use lumi_core::{Error, Result};

/// Radiance of a typical surface over the irradiance at the scene's centre, which brings y to the size of pictures: under
/// uniform light, where E counts all directions, y is half of the albedo.
const TYPICAL: f64 = 0.5 / std::f64::consts::PI;

/// What is left of a channel's light counts as nothing below this share of what was there: rounding.
const NOTHING: f64 = 1e-5;

/// A scene's illumination scale g, per channel: what its decoded radiance is multiplied with.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Illumination(pub [f64; 3]);

/// An edit's light, seen from the scene that it is made to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Change {
    /// The scale after the edit.
    pub after: Illumination,
    /// The light's share w of the whole, per channel, in [0, 1]: after the edit, or, for `remove`, before it.
    pub share: [f64; 3],
}

impl Illumination {
    /// That of captured photographs.
    pub const CAPTURED: Self = Self([1.0; 3]);

    /// What light with `irradiance` at the scene's centre (per channel, in model space) does.
    ///
    /// # Errors
    /// If more is removed than there is, naming the channel.
    pub fn change(self, mode: Mode, irradiance: [f64; 3]) -> Result<Change> {
        let light = irradiance.map(|e| TYPICAL * e);
        let share = |whole: [f64; 3]| {
            std::array::from_fn(|c| {
                if light[c] > 0.0 {
                    light[c] / whole[c]
                } else {
                    0.0
                }
            })
        };
        match mode {
            Mode::Set => Ok(Change {
                after: Self(light),
                share: [1.0; 3],
            }),
            Mode::Add => {
                let after = std::array::from_fn(|c| self.0[c] + light[c]);
                Ok(Change {
                    after: Self(after),
                    share: share(after),
                })
            }
            Mode::Remove => {
                let mut after = [0.0; 3];
                for (c, name) in ["red", "green", "blue"].into_iter().enumerate() {
                    let (there, gone) = (self.0[c], light[c]);
                    let left = there - gone;
                    if left < -NOTHING * there {
                        let expected = format!(
                            "expected at most the light that is there: in {name} it is {there:.4}, and {gone:.4} is to go"
                        );
                        return Err(Error::value("remove", expected));
                    }
                    after[c] = if left < NOTHING * there { 0.0 } else { left };
                }
                Ok(Change {
                    after: Self(after),
                    share: share(self.0).map(|w: f64| w.min(1.0)),
                })
            }
        }
    }

    /// The share of lights, whose rays these are, in all light that there is: that of the channel where it is largest.
    #[must_use]
    pub fn share(&self, rays: &[LightRay]) -> f32 {
        let each = irradiance(rays).into_iter().zip(self.0);
        let shares = each.map(|(e, g)| if g > 0.0 { TYPICAL * e / g } else { 0.0 });
        shares.fold(0.0, f64::max).min(1.0) as f32
    }

    /// All light so far `factor` times as strong.
    #[must_use]
    pub fn scaled(self, factor: [f64; 3]) -> Self {
        Self(std::array::from_fn(|c| self.0[c] * factor[c]))
    }
}

impl Change {
    /// How far the edit may change the tokens: the largest of its shares. Nothing, for light without power.
    #[must_use]
    pub fn reach(&self) -> f64 {
        self.share.iter().fold(0.0, |most, w| most.max(*w))
    }
}

/// The irradiance that rays bring to the scene's centre together, per channel.
#[must_use]
pub fn irradiance(rays: &[LightRay]) -> [f64; 3] {
    let mut sum = [0.0; 3];
    for ray in rays {
        for (sum, e) in sum.iter_mut().zip(ray.irradiance) {
            *sum += f64::from(e);
        }
    }
    sum
}

/// The rays of all known light after an edit that brings or takes away `rays`; what was not known before it is taken away counts
/// as negative.
#[must_use]
pub fn known_rays(known: &[LightRay], mode: Mode, rays: &[LightRay]) -> Vec<LightRay> {
    match mode {
        Mode::Set => rays.to_vec(),
        Mode::Add => [known, rays].concat(),
        Mode::Remove => {
            let mut left = known.to_vec();
            for ray in rays {
                match left.iter().position(|known| known == ray) {
                    Some(i) => drop(left.remove(i)),
                    None => left.push(LightRay {
                        irradiance: ray.irradiance.map(|e| -e),
                        ..*ray
                    }),
                }
            }
            left
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use lumi_core::glam::Vec3;

    fn close(a: [f64; 3], b: [f64; 3]) {
        for (a, b) in a.iter().zip(b) {
            assert!((a - b).abs() < 1e-12, "{a} and {b}");
        }
    }

    #[test]
    fn power_is_linear_and_light_adds_up() {
        let (a, b) = ([2.0, 1.0, 0.5], [0.3, 0.0, 4.0]);
        let start = Illumination([0.7, 3.0, 1.0]);
        let set = |e: [f64; 3]| start.change(Mode::Set, e).expect("set").after.0;
        close(set(a.map(|e| 4.0 * e)), set(a).map(|g| 4.0 * g));
        let both = Illumination(set(a)).change(Mode::Add, b).expect("add");
        close(both.after.0, std::array::from_fn(|c| set(a)[c] + set(b)[c]));
        // Shares say how much of the whole is new.
        close(
            std::array::from_fn(|c| both.share[c] * both.after.0[c]),
            set(b),
        );
        let back = both.after.change(Mode::Remove, b).expect("remove");
        close(back.after.0, set(a));
        close(back.share, both.share);
    }

    #[test]
    fn light_that_is_taken_away_again_leaves_what_was_there() {
        let ray = |x: f32| LightRay {
            origin: None,
            direction: Vec3::X,
            irradiance: [x; 3],
        };
        let set = known_rays(&[ray(9.0)], Mode::Set, &[ray(1.0), ray(2.0)]);
        assert_eq!(set, [ray(1.0), ray(2.0)]);
        let added = known_rays(&set, Mode::Add, &[ray(3.0)]);
        assert_eq!(added.len(), 3);
        assert_eq!(known_rays(&added, Mode::Remove, &[ray(3.0)]), set);
        let unknown = known_rays(&set, Mode::Remove, &[ray(0.5)]);
        assert!((irradiance(&unknown)[0] - 2.5).abs() < 1e-6);
    }

    #[test]
    fn nothing_changes_nothing_and_the_last_light_leaves_darkness() {
        let start = Illumination([0.7, 3.0, 1.0]);
        for mode in [Mode::Add, Mode::Remove] {
            let none = start.change(mode, [0.0; 3]).expect("nothing");
            assert_eq!((none.after, none.reach()), (start, 0.0));
        }
        let light = [0.7, 3.0, 1.0].map(|g| g / TYPICAL);
        let dark = start.change(Mode::Remove, light).expect("all of it");
        assert_eq!(dark.after, Illumination([0.0; 3]));
        let more = light.map(|e| 1.1 * e);
        let error = start.change(Mode::Remove, more).expect_err("more than all");
        assert!(error.to_string().contains("red"), "{error}");
        // A channel without light is black, whatever the others do.
        let blue = start.change(Mode::Set, [0.0, 0.0, 5.0]).expect("blue");
        assert_eq!(blue.after.0[..2], [0.0, 0.0]);
    }
}
