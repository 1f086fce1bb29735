//! Protocol `light`: whether a model's pictures obey what is known about light. No truth is needed: power and colour are
//! linear in each channel, what is replaced is gone, and lights add up.

use crate::Result;
use crate::cases::Subject;
use lumi_core::glam::Vec3;
use lumi_core::seed::Rng;
use lumi_core::{Light, LinearImage, Point, Seed};
use lumi_data::Orbit;
use lumi_model::{Edit, Relighter, SceneTokens};
use rand::RngExt;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::f32::consts::TAU;

/// Views that are looked at.
const VIEWS: usize = 4;
/// Pairs of lamps that should add up.
const PAIRS: usize = 10;
/// Edits before the one that should undo them all.
const EDITS: usize = 11;

/// What was measured, means over the objects.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct LawsReport {
    /// [`crate::report::SCHEMA`].
    pub schema: String,
    /// `light`.
    pub protocol: String,
    /// Fingerprint and origin.
    pub model: String,
    /// Data set.
    pub data: String,
    /// Means over the objects.
    pub laws: Laws,
    /// By object.
    pub per_object: BTreeMap<String, Laws>,
}

/// How far one scene is from each law. Differences are mean absolute differences of radiance over the mean radiance.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Laws {
    /// Mean radiance of the object under a lamp of 0.001 W over that under 1000 W; should be 10⁻⁶.
    pub darkness: f64,
    /// Mean radiance under 1000 W over that under 250 W; should be 4.
    pub power: f64,
    /// (R + G) / 2 over B under a blue lamp; should be 0.
    pub colour: f64,
    /// All light dimmed to a quarter against a lamp of a quarter of the power; should be 0.
    pub dimming: f64,
    /// Eleven lamps added, then all light replaced, against that replacement alone; should be 0.
    pub replacement: f64,
    /// A lamp set and another added in token space, against the sum of both alone, over ten random pairs; should be 0.
    pub addition: f64,
    /// A lamp added and taken away again, against before; should be 0.
    pub removal: f64,
    /// Two lamps set at once and one of them taken away, against the other alone; should be 0.
    #[serde(default)]
    pub part: f64,
    /// Environments and lamps of the object's own targets by light groups (a `set` each), against one `set` with all of
    /// them; should be 0.
    pub groups: f64,
}

impl Laws {
    /// Names, what should be, and what is.
    #[must_use]
    pub fn rows(&self) -> [(&'static str, f64, f64); 9] {
        [
            (
                "radiance at 0.001 W over that at 1000 W",
                1e-6,
                self.darkness,
            ),
            ("radiance at 1000 W over that at 250 W", 4.0, self.power),
            ("blue lamp: (R + G) / 2 over B", 0.0, self.colour),
            (
                "dimmed to a quarter, against a quarter of the power",
                0.0,
                self.dimming,
            ),
            (
                "eleven adds, then `set`, against that `set`",
                0.0,
                self.replacement,
            ),
            (
                "`set A`, `add B` in token space, against A + B",
                0.0,
                self.addition,
            ),
            ("`add B`, `remove B`, against before", 0.0, self.removal),
            ("`set A + B`, `remove B`, against `set A`", 0.0, self.part),
            (
                "one `set` with several lights, against the sum of groups",
                0.0,
                self.groups,
            ),
        ]
    }

    fn mean<'a>(all: impl Iterator<Item = &'a Self> + Clone) -> Self {
        let n = all.clone().count().max(1) as f64;
        let of = |f: fn(&Self) -> f64| all.clone().map(f).sum::<f64>() / n;
        Self {
            darkness: of(|l| l.darkness),
            power: of(|l| l.power),
            colour: of(|l| l.colour),
            dimming: of(|l| l.dimming),
            replacement: of(|l| l.replacement),
            addition: of(|l| l.addition),
            removal: of(|l| l.removal),
            part: of(|l| l.part),
            groups: of(|l| l.groups),
        }
    }
}

impl LawsReport {
    /// Of the objects' measurements.
    #[must_use]
    pub fn new(model: &Relighter, data: String, per_object: BTreeMap<String, Laws>) -> Self {
        Self {
            schema: crate::report::SCHEMA.to_owned(),
            protocol: "light".to_owned(),
            model: format!("{} ({})", model.fingerprint, model.provenance.origin),
            data,
            laws: Laws::mean(per_object.values()),
            per_object,
        }
    }

    /// The table.
    #[must_use]
    pub fn markdown(&self) -> String {
        let mut out = format!(
            "# light: {}\n\n| law | should be | is |\n|---|---|---|\n",
            self.model
        );
        for (name, should, is) in self.laws.rows() {
            out.push_str(&format!("| {name} | {should} | {is:.3e} |\n"));
        }
        out
    }
}

/// Measures one object.
///
/// # Errors
/// If the model makes no radiance, or refuses the object's views.
pub fn object(model: &Relighter, subject: &Subject, seed: Seed) -> Result<Laws> {
    let rng = &mut seed.stream("laws");
    let to_world = subject.to_model.inverse();
    let lamp = |position: Vec3, power: f32, color: [f32; 3]| -> Light {
        let mut point = Point::new(position, power);
        point.color = color;
        Light::Point(point).transformed(&to_world)
    };
    let white = |rng: &mut Rng| lamp(place(rng), 800.0, [1.0; 3]);
    let start = subject.encode(model)?;
    let cameras = Orbit {
        elevation: 0.5,
        distance: 2.75,
        fov: 0.87,
    }
    .cameras(VIEWS, model.config.resolution, &subject.to_model);
    let see = |tokens: &SceneTokens| Ok(Seen(model.render_radiance(tokens, &cameras)?));
    let set = |light: Light| model.edit(&start, &Edit::set([light]));
    let lit = |light: Light| -> Result<Seen> { see(&set(light)?) };

    let here = Vec3::new(3.0, -2.0, 2.0);
    let strong = lit(lamp(here, 1000.0, [1.0; 3]))?;
    let weak = lit(lamp(here, 250.0, [1.0; 3]))?;
    let [red, green, blue] = lit(lamp(here, 1000.0, [0.0, 0.0, 1.0]))?.means();
    let dimmed = set(lamp(here, 1000.0, [1.0; 3]))?.scaled([0.25; 3]);

    let mut later = start.clone();
    for _ in 0..EDITS {
        later = model.edit(&later, &Edit::add([white(rng)]))?;
    }
    let b = white(rng);
    let replaced = see(&model.edit(&later, &Edit::set([b.clone()]))?)?;
    let alone = lit(b)?;

    let (mut addition, mut removal, mut part) = (0.0, 0.0, 0.0);
    for _ in 0..PAIRS {
        let (a, b) = (white(rng), white(rng));
        let first = set(a.clone())?;
        let both = model.edit(&first, &Edit::add([b.clone()]))?;
        let before = see(&first)?;
        addition += see(&both)?.off(&before.plus(&lit(b.clone())?));
        let after = model.edit(&both, &Edit::remove([b.clone()]))?;
        removal += see(&after)?.off(&before);
        let at_once = model.edit(&start, &Edit::set([a, b.clone()]))?;
        let after = model.edit(&at_once, &Edit::remove([b]))?;
        part += see(&after)?.off(&before);
    }

    let (mut groups, mut counted) = (0.0, 0);
    for name in &subject.targets {
        let target = subject.target(name)?;
        let lights = target.lights_of(0);
        if lights.len() < 2 {
            continue;
        }
        let whole = see(&model.edit(&start, &Edit::set(lights))?)?;
        let mut sum = lit(lights[0].clone())?;
        for light in &lights[1..] {
            sum = sum.plus(&lit(light.clone())?);
        }
        groups += whole.off(&sum);
        counted += 1;
    }
    Ok(Laws {
        darkness: lit(lamp(here, 1e-3, [1.0; 3]))?.mean() / strong.mean(),
        power: strong.mean() / weak.mean(),
        colour: 0.5 * (red + green) / blue,
        dimming: see(&dimmed)?.off(&weak),
        replacement: replaced.off(&alone),
        addition: addition / PAIRS as f64,
        removal: removal / PAIRS as f64,
        part: part / PAIRS as f64,
        groups: groups / f64::from(counted.max(1)),
    })
}

/// A lamp's place in model space, where training has them: 3 to 5 from the centre, above the ground.
fn place(rng: &mut Rng) -> Vec3 {
    let (azimuth, up) = (TAU * rng.random::<f32>(), rng.random_range(0.1..0.95_f32));
    let across = (1.0 - up * up).sqrt();
    let direction = Vec3::new(across * azimuth.cos(), across * azimuth.sin(), up);
    rng.random_range(3.0..5.0_f32) * direction
}

/// Views of one scene.
struct Seen(Vec<LinearImage>);

impl Seen {
    fn pixels(&self) -> impl Iterator<Item = &[f32; 4]> {
        self.0.iter().flat_map(|image| &image.pixels)
    }

    /// Mean of each channel over the object.
    fn means(&self) -> [f64; 3] {
        let coverage: f64 = self.pixels().map(|p| f64::from(p[3])).sum();
        let sum = |c: usize| self.pixels().map(|p| f64::from(p[c])).sum::<f64>();
        [0, 1, 2].map(|c| sum(c) / coverage.max(1e-9))
    }

    fn mean(&self) -> f64 {
        self.means().iter().sum::<f64>() / 3.0
    }

    /// Both lights together.
    fn plus(&self, other: &Self) -> Self {
        let mut sum = self.0.clone();
        for (sum, other) in sum.iter_mut().zip(&other.0) {
            sum.add_light(other, [1.0; 3]);
        }
        Self(sum)
    }

    /// Mean absolute difference over the mean of what it should be.
    fn off(&self, should: &Self) -> f64 {
        let (mut difference, mut whole) = (0.0, 0.0);
        for (a, b) in self.pixels().zip(should.pixels()) {
            for c in 0..3 {
                difference += f64::from((a[c] - b[c]).abs());
                whole += f64::from(b[c].abs());
            }
        }
        difference / whole.max(1e-12)
    }
}
