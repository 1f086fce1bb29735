//! What the samples of a batch have in common: how many views, and which edits.

use crate::config::{StageConfig, StageKind};
use lumi_core::seed::Rng;
use lumi_model::ModelConfig;
use lumi_model::config::Mode;
use rand::RngExt;

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
    /// Side of the pictures.
    pub resolution: usize,
    /// Whether the targets are wanted under the light of the inputs.
    pub reconstruct: bool,
    /// Whether the inputs are wanted under a second lighting, too.
    pub other_light: bool,
    /// Whether what edits lead to is wanted the short way, too, where there is one.
    pub short_ways: bool,
    /// Whether lights that are added to others of the chain are wanted by themselves, too.
    pub alone: bool,
    /// Whether the targets' base colour is wanted.
    pub albedo: bool,
    /// Whether more is shown than was rendered.
    pub augment: bool,
    /// Pixels that each picture may be moved by, each way.
    pub shift: usize,
    /// Edits that lead to where the chain begins, in order; none of them is shown.
    pub before: Vec<EditKind>,
    /// Edits, in order; empty for reconstruction.
    pub edits: Vec<EditKind>,
}

/// Most views of a held-out sample that are scored: no more than objects have beside their inputs.
const VALIDATED_VIEWS: usize = 4;
/// Edits that are scored.
const VALIDATED_EDITS: usize = 2;

impl Plan {
    /// What held-out samples are scored by, whatever a stage trains, so that the curve of a run is one curve: its most inputs, novel
    /// views that are not moved, and two edits if it trains any.
    pub fn of_validation(rng: &mut Rng, stage: &StageConfig, model: &ModelConfig) -> Self {
        let edits = match stage.kind {
            StageKind::Reconstruction => 0,
            StageKind::Relight | StageKind::Joint => VALIDATED_EDITS,
        };
        Self {
            inputs: stage.inputs[1],
            targets: stage.targets.min(VALIDATED_VIEWS),
            resolution: stage.resolution(model),
            input_targets: 0,
            reconstruct: true,
            other_light: false,
            short_ways: false,
            alone: false,
            albedo: false,
            augment: stage.augment,
            shift: 0,
            before: Vec::new(),
            edits: EditKind::chain(rng, edits, model.lights.modes(), On::SOURCE),
        }
    }

    /// Draws a plan for a stage.
    pub fn draw(rng: &mut Rng, stage: &StageConfig, model: &ModelConfig) -> Self {
        let chain = (stage.kind != StageKind::Reconstruction).then_some(stage.chain);
        let inputs = rng.random_range(stage.inputs[0]..=stage.inputs[1]);
        let length = chain.map_or(0, |[least, most]| rng.random_range(least..=most));
        let mut on = On::SOURCE;
        let mut before = Vec::new();
        if length > 0 && stage.wander > 0 && rng.random::<bool>() {
            let many = rng.random_range(1..=stage.wander);
            before.extend((0..many).map(|_| EditKind::set(rng)));
        }
        if let Some(last) = before.last() {
            on = on.after(last);
        }
        let edits = EditKind::chain(rng, length, model.lights.modes(), on);
        let targets = stage.targets;
        let input_targets = (stage.input_targets * targets as f32).round() as usize;
        Self {
            inputs,
            targets,
            resolution: stage.resolution(model),
            input_targets,
            reconstruct: stage.reconstructs(edits.len()),
            other_light: stage.invariance > 0.0,
            short_ways: stage.consistency > 0.0,
            alone: stage.additivity > 0.0,
            albedo: stage.albedo > 0.0,
            augment: stage.augment,
            shift: stage.shift,
            before,
            edits,
        }
    }
}

impl EditKind {
    /// Whether it takes away just what `before` has added: of a kind, the lights that came last are those that go.
    #[must_use]
    pub fn undoes(&self, before: &Self) -> bool {
        self.mode == Mode::Remove && before.mode == Mode::Add && self.counts == before.counts
    }

    /// Edits one after the other.
    fn chain(rng: &mut Rng, length: usize, modes: &[Mode], mut on: On) -> Vec<Self> {
        let next = |_| {
            let edit = Self::draw(rng, modes, &on);
            on = on.after(&edit);
            edit
        };
        (0..length).map(next).collect()
    }

    fn draw(rng: &mut Rng, modes: &[Mode], on: &On) -> Self {
        const ADD: [([usize; 3], f32); 3] = [([0, 1, 0], 0.6), ([0, 0, 1], 0.3), ([1, 0, 0], 0.1)];
        let u = rng.random::<f32>();
        // What is on from an edit before is more often gone on from than replaced.
        let [add, remove] = if on.known == [0; 3] {
            [0.3, 0.3]
        } else {
            [0.4, 0.8]
        };
        if modes.contains(&Mode::Add) && u < add {
            return Self {
                mode: Mode::Add,
                counts: pick(&ADD, rng),
            };
        }
        let removes = modes.contains(&Mode::Remove) && on.removable();
        if removes && u < remove {
            let kinds: Vec<usize> = (0..3).filter(|k| on.known[*k] > 0).collect();
            let mut counts = [0; 3];
            counts[kinds[rng.random_range(0..kinds.len())]] = 1;
            return Self {
                mode: Mode::Remove,
                counts,
            };
        }
        Self::set(rng)
    }

    /// All light replaced.
    fn set(rng: &mut Rng) -> Self {
        // What an edit usually is: one light, sometimes an environment with local lights.
        const SET: [([usize; 3], f32); 7] = [
            ([1, 0, 0], 0.28),
            ([0, 1, 0], 0.30),
            ([0, 0, 1], 0.14),
            ([1, 1, 0], 0.12),
            ([1, 1, 1], 0.08),
            ([1, 3, 1], 0.04),
            ([0, 2, 0], 0.04),
        ];
        Self {
            mode: Mode::Set,
            counts: pick(&SET, rng),
        }
    }
}

/// What a plan knows of the lights that are on.
struct On {
    /// How many of each kind it put there.
    known: [usize; 3],
    /// Whether the source light is still among them, which is each sample's own.
    source: bool,
}

impl On {
    const SOURCE: Self = Self {
        known: [0; 3],
        source: true,
    };

    /// Whether one of them can be taken away and something stay on.
    fn removable(&self) -> bool {
        let known: usize = self.known.iter().sum();
        known > usize::from(!self.source)
    }

    fn after(&self, edit: &EditKind) -> Self {
        let counted = |f: fn(usize, usize) -> usize| {
            std::array::from_fn(|k| f(self.known[k], edit.counts[k]))
        };
        match edit.mode {
            Mode::Set => Self {
                known: edit.counts,
                source: false,
            },
            Mode::Add => Self {
                known: counted(|known, more| known + more),
                ..*self
            },
            Mode::Remove => Self {
                known: counted(|known, fewer| known - fewer),
                ..*self
            },
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

#[cfg(test)]
mod tests {
    use super::*;
    use lumi_core::Seed;

    #[test]
    fn only_lights_that_a_plan_put_there_are_taken_away_and_some_stay_on() {
        let rng = &mut Seed(7).stream("plan");
        let mut removed = 0;
        for _ in 0..500 {
            let mut on = On::SOURCE;
            for _ in 0..4 {
                let edit = EditKind::draw(rng, &Mode::ALL, &on);
                if edit.mode == Mode::Remove {
                    removed += 1;
                    assert!((0..3).all(|k| edit.counts[k] <= on.known[k]));
                }
                on = on.after(&edit);
                assert!(on.source || on.known.iter().sum::<usize>() > 0);
            }
        }
        assert!(removed > 200, "{removed} of 2000");
    }

    #[test]
    fn half_of_the_plans_wander_before_their_chain() {
        let rng = &mut Seed(3).stream("plan");
        let stage = |wander: usize| -> StageConfig {
            let text = format!(
                "kind = \"joint\"\nsteps = 1\nlearning_rate = 1.0\ninputs = [4, 8]\ntargets = 2\nchain = [0, 2]\nwander = {wander}"
            );
            toml::from_str(&text).expect("a stage")
        };
        let model = ModelConfig::preset("mini").expect("mini");
        let plain = Plan::draw(rng, &stage(0), &model);
        assert!(plain.before.is_empty());
        let (mut wandered, mut longest) = (0, 0);
        for _ in 0..300 {
            let plan = Plan::draw(rng, &stage(5), &model);
            assert!(plan.before.iter().all(|edit| edit.mode == Mode::Set));
            // What it takes away must be there.
            let removes = |edit: &EditKind| edit.mode == Mode::Remove;
            if let (Some(last), Some(first)) = (plan.before.last(), plan.edits.first())
                && removes(first)
            {
                assert!((0..3).all(|k| first.counts[k] <= last.counts[k]));
            }
            assert!(plan.before.is_empty() || !plan.edits.is_empty());
            wandered += usize::from(!plan.before.is_empty());
            longest = longest.max(plan.before.len());
        }
        assert!(
            (60..140).contains(&wandered) && longest == 5,
            "{wandered} {longest}"
        );
    }
}
