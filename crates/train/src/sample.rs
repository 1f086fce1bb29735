//! What one training sample is: an object, views, a source light and a chain of edits, all drawn from a seed.

use crate::config::{StageConfig, StageKind};
use half::f16;
use lumi_core::glam::{Mat3, Vec3};
use lumi_core::seed::Rng;
use lumi_core::{Light, Seed, Similarity};
use lumi_data::store::ObjectRecord;
use lumi_model::config::Mode;
use lumi_model::{ModelConfig, batch, lights};
use rand::RngExt;
use rand::seq::SliceRandom;

/// Lights of a record with their per-channel gains.
pub type Lighting = Vec<(usize, [f32; 3])>;

/// What an edit brings, the same for all samples of a batch so that their light tokens are equally many.
#[derive(Clone, Debug, PartialEq)]
pub struct EditKind {
    /// Set, add or remove.
    pub mode: Mode,
    /// Numbers of environment, point and area lights.
    pub counts: [usize; 3],
}

/// The part of a batch's plan that all its samples share.
#[derive(Clone, Debug)]
pub struct Plan {
    /// Input views.
    pub inputs: usize,
    /// Target views.
    pub targets: usize,
    /// How many of them are input views.
    pub input_targets: usize,
    /// Whether the inputs are wanted under a second lighting, too.
    pub other_light: bool,
    /// Edits, in order; empty for reconstruction.
    pub edits: Vec<EditKind>,
}

/// One sample as flat channel-first arrays; concatenated over a batch they become tensors.
pub struct Sample {
    /// `[inputs, 3 + c, r, r]`
    pub posed: Vec<f32>,
    /// The inputs under another light, as `posed`; empty if the plan wants none.
    pub other: Vec<f32>,
    /// `[targets, c, r, r]`
    pub rays: Vec<f32>,
    /// Targets under the source light, `[targets, 3, r, r]`
    pub source: Vec<f32>,
    /// Per edit: light features `[rays, 10]` and targets after it `[targets, 3, r, r]`.
    pub edits: Vec<(Vec<f32>, Vec<f32>)>,
}

/// An object ready to sample from: a record at the training resolution and how bright each light makes it.
pub struct Object {
    /// The record.
    pub record: ObjectRecord,
    /// Mean luminance over the object's pixels per light.
    brightness: Vec<f32>,
    /// Lights by kind: environments, points, areas.
    kinds: [Vec<usize>; 3],
}

impl Object {
    /// Prepares a record.
    ///
    /// # Errors
    /// If it lacks a kind of light, without which samples of a batch could not bring equally many.
    pub fn new(record: ObjectRecord) -> lumi_core::Result<Self> {
        let coverage: f32 = record.alpha.iter().map(|a| a.to_f32()).sum();
        let per_light = record.radiance.len() / record.lights.len().max(1);
        let brightness = record
            .radiance
            .chunks(per_light.max(1))
            .map(|values| {
                let sum: f32 = values.chunks_exact(3).map(luminance).sum();
                (sum / coverage.max(1.0)).max(1e-4)
            })
            .collect();
        let mut kinds = [Vec::new(), Vec::new(), Vec::new()];
        for (i, named) in record.lights.iter().enumerate() {
            let kind = match named.light {
                Light::Environment(_) => 0,
                Light::Point(_) => 1,
                Light::Area(_) => 2,
            };
            kinds[kind].push(i);
        }
        if kinds.iter().any(Vec::is_empty) {
            let found = kinds.map(|k| k.len());
            let expected = format!(
                "expected at least one environment, point and area light, found {found:?} of them"
            );
            return Err(lumi_core::Error::value("lights", expected));
        }
        Ok(Self {
            record,
            brightness,
            kinds,
        })
    }
}

fn luminance(rgb: &[f16]) -> f32 {
    0.2126 * rgb[0].to_f32() + 0.7152 * rgb[1].to_f32() + 0.0722 * rgb[2].to_f32()
}

impl Plan {
    /// Draws a plan for a stage of a model trained for `modes`.
    pub fn draw(rng: &mut Rng, stage: &StageConfig, modes: &[Mode]) -> Self {
        let chain = (stage.kind != StageKind::Reconstruction).then_some(stage.chain);
        let inputs = rng.random_range(stage.inputs[0]..=stage.inputs[1]);
        let length = chain.map_or(0, |[least, most]| rng.random_range(least..=most));
        // Lights that are on after each edit, where the plan knows: the source light is each sample's own.
        let mut present = None;
        let edits = (0..length).map(|_| {
            let edit = EditKind::draw(rng, modes, present);
            present = edit.after(present);
            edit
        });
        let edits = edits.collect();
        let targets = stage.targets;
        let input_targets = (stage.input_targets * targets as f32).round() as usize;
        Self {
            inputs,
            targets,
            input_targets,
            other_light: stage.invariance > 0.0,
            edits,
        }
    }
}

impl EditKind {
    fn draw(rng: &mut Rng, modes: &[Mode], present: Option<[usize; 3]>) -> Self {
        // What an edit usually is: one light, sometimes an environment with local lights.
        const SET: [([usize; 3], f32); 6] = [
            ([1, 0, 0], 0.28),
            ([0, 1, 0], 0.30),
            ([0, 0, 1], 0.14),
            ([1, 1, 0], 0.12),
            ([1, 1, 1], 0.12),
            ([0, 2, 0], 0.04),
        ];
        const ADD: [([usize; 3], f32); 3] = [([0, 1, 0], 0.6), ([0, 0, 1], 0.3), ([1, 0, 0], 0.1)];
        let u = rng.random::<f32>();
        if modes.contains(&Mode::Add) && u < 0.3 {
            return Self {
                mode: Mode::Add,
                counts: pick(&ADD, rng),
            };
        }
        // Something must stay on.
        let several = present.filter(|p| p.iter().sum::<usize>() > 1);
        if let (true, Some(present)) = (modes.contains(&Mode::Remove) && u < 0.5, several) {
            let kinds: Vec<usize> = (0..3).filter(|k| present[*k] > 0).collect();
            let mut counts = [0; 3];
            counts[kinds[rng.random_range(0..kinds.len())]] = 1;
            return Self {
                mode: Mode::Remove,
                counts,
            };
        }
        Self {
            mode: Mode::Set,
            counts: pick(&SET, rng),
        }
    }

    /// Lights of each kind after the edit, given those before it.
    fn after(&self, present: Option<[usize; 3]>) -> Option<[usize; 3]> {
        let combine = |f: fn(usize, usize) -> usize| {
            present.map(|p| std::array::from_fn(|k| f(p[k], self.counts[k])))
        };
        match self.mode {
            Mode::Set => Some(self.counts),
            Mode::Add => combine(|p, c| p + c),
            Mode::Remove => combine(|p, c| p - c),
        }
    }
}

/// A row of a table of shares that add up to one.
fn pick(table: &[([usize; 3], f32)], rng: &mut Rng) -> [usize; 3] {
    let mut left = rng.random::<f32>();
    for (counts, share) in table {
        left -= share;
        if left <= 0.0 {
            return *counts;
        }
    }
    table[0].0
}

impl Sample {
    /// Draws a sample of `object` for `plan`.
    #[must_use]
    pub fn draw(object: &Object, plan: &Plan, config: &ModelConfig, seed: Seed) -> Self {
        let rng = &mut seed.stream("sample");
        let mut views: Vec<usize> = (0..object.record.cameras.len()).collect();
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

        // Augmentations that are exact for light transport: the world turned about z, colour
        // channels exchanged in the object and its lights alike.
        let turn = Similarity {
            scale: 1.0,
            rotation: Mat3::from_rotation_z(rng.random::<f32>() * std::f32::consts::TAU),
            translation: Vec3::ZERO,
        };
        let mut channels = [0, 1, 2];
        channels.shuffle(rng);
        let camera = |view: usize| object.record.cameras[view].transformed(&turn);

        let mut light = object.draw_source(rng);
        let posed_under = |light: &Lighting| -> Vec<f32> {
            let posed = inputs.iter().flat_map(|&v| {
                let image = object.record.compose(v, light).to_display();
                batch::posed_channels(&permuted(image, channels), &camera(v), config.rays)
            });
            posed.collect()
        };
        let posed = posed_under(&light);
        let other = if plan.other_light {
            posed_under(&object.draw_source(&mut seed.stream("other light")))
        } else {
            Vec::new()
        };
        let rays = targets
            .iter()
            .flat_map(|&v| batch::ray_channels(&camera(v), config.rays))
            .collect();
        let source = object.pictures(&targets, &light, channels);
        let edits = plan.edits.iter().map(|kind| {
            let brought = match kind.mode {
                Mode::Remove => object.of_kinds(&light, kind.counts),
                _ => object.draw_lights(kind.counts, rng),
            };
            light = match kind.mode {
                Mode::Set => brought.clone(),
                Mode::Add => light.iter().chain(&brought).copied().collect(),
                Mode::Remove => light
                    .iter()
                    .filter(|l| !brought.contains(l))
                    .copied()
                    .collect(),
            };
            let features = object.features(&brought, &turn, channels, config);
            (features, object.pictures(&targets, &light, channels))
        });
        let edits = edits.collect();
        Self {
            posed,
            other,
            rays,
            source,
            edits,
        }
    }
}

fn permuted(mut image: lumi_core::DisplayImage, channels: [usize; 3]) -> lumi_core::DisplayImage {
    for pixel in &mut image.pixels {
        *pixel = channels.map(|c| pixel[c]);
    }
    image
}

impl Object {
    /// The light of the inputs: usually an environment, as captures have it.
    fn draw_source(&self, rng: &mut Rng) -> Lighting {
        let counts = match rng.random::<f32>() {
            u if u < 0.65 => [1, 0, 0],
            u if u < 0.85 => [1, 1, 0],
            u if u < 0.93 => [0, 0, 1],
            _ => [0, 2, 0],
        };
        self.draw_lights(counts, rng)
    }

    /// The first lights of each kind in a lighting.
    fn of_kinds(&self, lighting: &Lighting, counts: [usize; 3]) -> Lighting {
        let mut chosen = Lighting::new();
        for (kind, count) in self.kinds.iter().zip(counts) {
            let of_kind = lighting.iter().filter(|(light, _)| kind.contains(light));
            chosen.extend(of_kind.take(count));
        }
        chosen
    }

    /// Different lights of each kind, with gains such that the object's mean luminance is between
    /// 0.06 and 0.5, shared between the lights at random; local lights are tinted half of the time.
    fn draw_lights(&self, counts: [usize; 3], rng: &mut Rng) -> Lighting {
        let mut chosen = Vec::new();
        for (kind, &count) in self.kinds.iter().zip(&counts) {
            let mut kind = kind.clone();
            kind.shuffle(rng);
            // A record with too few lights of a kind repeats one.
            let available = kind.len();
            chosen.extend((0..count).map(|i| kind[i % available]));
        }
        let total = 0.06 * (0.5_f32 / 0.06).powf(rng.random::<f32>());
        let shares: Vec<f32> = chosen.iter().map(|_| 0.15 + rng.random::<f32>()).collect();
        let sum: f32 = shares.iter().sum();
        let mut lighting = Lighting::new();
        for (&light, share) in chosen.iter().zip(&shares) {
            let gain = (total * share / sum / self.brightness[light]).min(50.0);
            let local = !self.kinds[0].contains(&light);
            let tint = if local && rng.random::<bool>() {
                let tint = [(); 3].map(|()| 0.15 + 0.85 * rng.random::<f32>());
                let most = tint[0].max(tint[1]).max(tint[2]);
                tint.map(|t| t / most)
            } else {
                [1.0; 3]
            };
            lighting.push((light, tint.map(|t| t * gain)));
        }
        lighting
    }

    /// `[views, 3, r, r]` under `lighting`.
    fn pictures(&self, views: &[usize], lighting: &Lighting, channels: [usize; 3]) -> Vec<f32> {
        let mut out = Vec::new();
        for &view in views {
            let image = self.record.compose(view, lighting).to_display();
            for c in channels {
                out.extend(image.pixels.iter().map(|p| p[c]));
            }
        }
        out
    }

    /// Ray features of `lighting`, turned and with channels exchanged, `[rays, 10]`.
    fn features(
        &self,
        lighting: &Lighting,
        turn: &Similarity,
        channels: [usize; 3],
        config: &ModelConfig,
    ) -> Vec<f32> {
        let moved: Vec<Light> = lighting
            .iter()
            .map(|&(i, gain)| self.record.lights[i].light.scaled(gain).transformed(turn))
            .collect();
        let mut features = lights::ray_features(&moved, &config.lights.pattern());
        for row in features.chunks_exact_mut(lights::RAY_FEATURES) {
            let color = channels.map(|c| row[6 + c]);
            row[6..9].copy_from_slice(&color);
        }
        features
    }
}
