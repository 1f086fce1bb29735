//! Cases for scenes that state none: views, lightings and chains of edits, drawn from the scene's name alone.

use crate::Result;
use lumi_core::{Error, LinearImage, Scene, Seed};
use lumi_data::Lighting;
use lumi_data::manifest::{ObjectCases, Progressive};
use lumi_data::views::spread;
use std::collections::BTreeMap;

/// Version of [`draw_cases`].
pub(crate) const DRAWN: u32 = 2;
/// Mean luminance of the object that drawn lightings give it.
const BRIGHTNESS: f32 = 0.2;
/// Most input views that are drawn; a protocol chooses among them.
const INPUTS: usize = 32;
/// Most held-out views that are drawn.
const VIEWS: usize = 8;

/// Cases of a scene that states none, by its name alone: half of the views (at most 32, evenly spread) are inputs,
/// others (at most 8) are held out; the source is the first environment (else the first light); targets are every
/// other light alone and mixtures of two and three; the chain replaces the light ten times out of a pool of five.
/// Every lighting gives the object a mean luminance of 0.2.
///
/// # Errors
/// If the scene has no light basis, or too few lights or views.
pub fn draw_cases(scene: &Scene) -> Result<ObjectCases> {
    use chance::Draw;
    let refuse = |expected: &str| {
        let place = format!("scene `{}`", scene.name);
        Err(Error::value(place, expected).into())
    };
    let Some(basis) = &scene.basis else {
        return refuse(
            "expected one-light-at-a-time images to compare with, found only photographs",
        );
    };
    let gains: Vec<Option<f32>> = basis.radiance.iter().map(|images| gain(images)).collect();
    let lights: Vec<(String, f32)> = basis
        .lights
        .iter()
        .zip(gains)
        .filter_map(|(light, gain)| Some((light.name.clone(), gain?)))
        .collect();
    if lights.len() < 3 || scene.views.len() < 2 {
        return refuse("expected at least three lights that reach the object, and two views");
    }
    let is_environment = |name: &str| {
        let light = basis.find(name).map(|i| basis.lights[i].light.kind());
        light == Some("environment")
    };
    let first = lights
        .iter()
        .position(|(name, _)| is_environment(name))
        .unwrap_or(0);
    let alone = |i: usize| Lighting::from([lights[i].clone()]);
    let others: Vec<usize> = (0..lights.len()).filter(|i| *i != first).collect();
    let mut draw = Draw::new(Seed(0).child(&scene.name).child("cases"));
    let mut targets: BTreeMap<String, Lighting> = others
        .iter()
        .map(|&i| (lights[i].0.clone(), alone(i)))
        .collect();
    for count in [2, 3] {
        let chosen = draw.choose(&others, count);
        if chosen.len() < count {
            continue;
        }
        let share = 1.0 / count as f32;
        let mixture = chosen
            .iter()
            .map(|&i| (lights[i].0.clone(), lights[i].1 * share));
        let name: Vec<&str> = chosen.iter().map(|&i| lights[i].0.as_str()).collect();
        targets.insert(name.join("+"), mixture.collect());
    }
    let names: Vec<String> = targets.keys().cloned().collect();
    let all: Vec<usize> = (0..names.len()).collect();
    let pool: Vec<String> = draw
        .choose(&all, 5)
        .into_iter()
        .map(|i| names[i].clone())
        .collect();
    let mut sequence: Vec<String> = Vec::new();
    while sequence.len() < 10 {
        let next = &pool[draw.below(pool.len())];
        if pool.len() == 1 || sequence.last() != Some(next) {
            sequence.push(next.clone());
        }
    }
    let steps = draw.choose(&others, 4);
    let share = 1.0 / steps.len() as f32;
    let additive = steps
        .iter()
        .map(|&i| Lighting::from([(lights[i].0.clone(), lights[i].1 * share)]));
    let (inputs, views) = split(scene);
    Ok(ObjectCases {
        source: alone(first),
        inputs,
        views,
        targets,
        progressive: Progressive { pool, sequence },
        additive: vec![additive.collect()],
    })
}

/// Factor that brings the object's mean luminance to [`BRIGHTNESS`]; `None` for a light that does not reach it.
fn gain(images: &[LinearImage]) -> Option<f32> {
    let (mut light, mut area) = (0.0_f64, 0.0_f64);
    for [r, g, b, a] in images.iter().flat_map(|i| &i.pixels) {
        light += f64::from(0.2126 * r + 0.7152 * g + 0.0722 * b);
        area += f64::from(*a);
    }
    let mean = light / area;
    (mean.is_finite() && mean > 1e-6).then(|| (f64::from(BRIGHTNESS) / mean) as f32)
}

/// Names of inputs (even positions) and held-out views (odd ones).
fn split(scene: &Scene) -> (Vec<String>, Vec<String>) {
    let of = |parity: usize, most: usize| {
        let names = scene.views.iter().skip(parity).step_by(2);
        let names: Vec<String> = names.map(|v| v.name.clone()).collect();
        spread(&names, most)
    };
    (of(0, INPUTS), of(1, VIEWS))
}

/// Draws from a seed; child seeds are already well mixed, so no generator is needed.
mod chance {
    use lumi_core::Seed;

    pub struct Draw(Seed, u64);

    impl Draw {
        pub fn new(seed: Seed) -> Self {
            Self(seed, 0)
        }

        /// A number below `n`.
        pub fn below(&mut self, n: usize) -> usize {
            self.1 += 1;
            (self.0.index(self.1).0 % n as u64) as usize
        }

        /// At most `n` different items, in the order in which they were drawn.
        pub fn choose(&mut self, items: &[usize], n: usize) -> Vec<usize> {
            let mut left = items.to_vec();
            let n = n.min(left.len());
            (0..n)
                .map(|_| left.remove(self.below(left.len())))
                .collect()
        }
    }
}
