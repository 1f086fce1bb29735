//! What one training sample is: an object, views, a source light and a chain of edits, all drawn from a seed.

use crate::config::{StageConfig, StageKind};
use crate::object::Object;
use lumi_core::glam::{Mat3, Vec3};
use lumi_core::seed::Rng;
use lumi_core::{Camera, DisplayImage, Result, Seed, Similarity};
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
    /// Whether the targets' base colour is wanted.
    pub albedo: bool,
    /// Pixels that each picture may be moved by, each way.
    pub shift: usize,
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
    /// Base colour of the targets, `[targets, 3, r, r]`; empty if the plan does not want it.
    pub albedo: Vec<f32>,
    /// Per edit: light features `[rays, 10]` and targets after it `[targets, 3, r, r]`.
    pub edits: Vec<(Vec<f32>, Vec<f32>)>,
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
            albedo: stage.albedo > 0.0,
            shift: stage.shift,
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
    ///
    /// # Errors
    /// If one of its pictures cannot be read.
    pub fn draw(object: &Object, plan: &Plan, config: &ModelConfig, seed: Seed) -> Result<Self> {
        let rng = &mut seed.stream("sample");
        let mut views: Vec<usize> = (0..object.cameras().len()).collect();
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
        let mut seen = [inputs, &targets].concat();
        seen.sort_unstable();
        seen.dedup();

        // Augmentations that are exact for light transport: the world turned about z, colour
        // channels exchanged in the object and its lights alike, pictures moved with their principal points.
        let turn = Similarity {
            scale: 1.0,
            rotation: Mat3::from_rotation_z(rng.random::<f32>() * std::f32::consts::TAU),
            translation: Vec3::ZERO,
        };
        let mut channels = [0, 1, 2];
        channels.shuffle(rng);
        let moves = &mut seed.stream("shift");
        let mut shots = |views: &[usize]| -> Vec<Shot> {
            let shot = |&view: &usize| Shot::draw(view, plan.shift, moves);
            views.iter().map(shot).collect()
        };
        let (inputs, targets) = (shots(inputs), shots(&targets));
        let camera = |shot: &Shot| shot.camera(&object.cameras()[shot.view]).transformed(&turn);

        let mut light = object.draw_source(&seen, rng)?;
        let posed_under = |light: &Lighting| -> Result<Vec<f32>> {
            let mut posed = Vec::new();
            for shot in &inputs {
                let image = shot.picture(&object.lit(shot.view, light)?, channels);
                posed.extend(batch::posed_channels(&image, &camera(shot), config.rays));
            }
            Ok(posed)
        };
        let stacked = |picture: &dyn Fn(usize) -> Result<DisplayImage>| -> Result<Vec<f32>> {
            let mut stacked = Vec::new();
            for shot in &targets {
                let image = shot.picture(&picture(shot.view)?, channels);
                stacked.extend(batch::colours(&image));
            }
            Ok(stacked)
        };
        let pictures = |light: &Lighting| stacked(&|view| object.lit(view, light));
        let posed = posed_under(&light)?;
        let other = if plan.other_light {
            let other = object.draw_source(&seen, &mut seed.stream("other light"))?;
            posed_under(&other)?
        } else {
            Vec::new()
        };
        let rays = targets
            .iter()
            .flat_map(|shot| batch::ray_channels(&camera(shot), config.rays))
            .collect();
        let source = pictures(&light)?;
        let albedo = if plan.albedo {
            stacked(&|view| object.albedo(view))?
        } else {
            Vec::new()
        };
        let mut edits = Vec::with_capacity(plan.edits.len());
        for kind in &plan.edits {
            let brought = match kind.mode {
                Mode::Remove => object.of_kinds(&light, kind.counts),
                _ => object.draw_lights(kind.counts, &seen, rng)?,
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
            let features = features(object, &brought, &turn, channels, config)?;
            edits.push((features, pictures(&light)?));
        }
        Ok(Self {
            posed,
            other,
            rays,
            source,
            albedo,
            edits,
        })
    }
}

/// A view, moved by whole pixels to the right and down.
struct Shot {
    view: usize,
    by: [i32; 2],
}

impl Shot {
    fn draw(view: usize, most: usize, rng: &mut Rng) -> Self {
        let most = most as i32;
        let by = [(); 2].map(|()| rng.random_range(-most..=most));
        Self { view, by }
    }

    fn camera(&self, camera: &Camera) -> Camera {
        Camera {
            cx: camera.cx + self.by[0] as f32,
            cy: camera.cy + self.by[1] as f32,
            ..*camera
        }
    }

    /// The view's picture, moved and with channels exchanged. What comes in from outside is white, as behind the object.
    fn picture(&self, image: &DisplayImage, channels: [usize; 3]) -> DisplayImage {
        let (w, h) = (image.width as i32, image.height as i32);
        let [right, down] = self.by;
        let pixel = |y: i32, x: i32| {
            let (y, x) = (y - down, x - right);
            let inside = (0..h).contains(&y) && (0..w).contains(&x);
            let rgb = inside.then(|| image.pixels[(y * w + x) as usize]);
            rgb.map_or([1.0; 3], |rgb| channels.map(|c| rgb[c]))
        };
        let rows = (0..h).flat_map(|y| (0..w).map(move |x| (y, x)));
        DisplayImage {
            pixels: rows.map(|(y, x)| pixel(y, x)).collect(),
            alpha: None,
            ..*image
        }
    }
}

/// Ray features of `lighting`, turned and with channels exchanged, `[rays, 10]`.
fn features(
    object: &Object,
    lighting: &Lighting,
    turn: &Similarity,
    channels: [usize; 3],
    config: &ModelConfig,
) -> Result<Vec<f32>> {
    let moved = lighting
        .iter()
        .map(|&(i, gain)| Ok(object.light(i)?.light.scaled(gain).transformed(turn)))
        .collect::<Result<Vec<_>>>()?;
    let mut features = lights::ray_features(&moved, &config.lights.pattern());
    for row in features.chunks_exact_mut(lights::RAY_FEATURES) {
        let color = channels.map(|c| row[6 + c]);
        row[6..9].copy_from_slice(&color);
    }
    Ok(features)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_moved_picture_shows_the_same_along_its_rays() {
        let mut image = DisplayImage::filled(5, 4, [1.0; 3]);
        image.pixels[5 + 2] = [0.1, 0.2, 0.3];
        let by = [2, -1];
        let shot = Shot { view: 0, by };
        let moved = shot.picture(&image, [2, 0, 1]);
        let mut expected = DisplayImage::filled(5, 4, [1.0; 3]);
        expected.pixels[4] = [0.3, 0.1, 0.2];
        assert_eq!(moved, expected);
        let camera = Camera::orbit(0.3, 0.4, 2.75, 0.87, 5);
        let ray = shot.camera(&camera).direction(4.5, 0.5);
        assert!((ray - camera.direction(2.5, 1.5)).length() < 1e-6);
    }
}
