//! Blocks with split streams, anchors and external contexts, and all that they read.

use super::{Noise, Owned, frames, rotations, wide};
use lumi_kernels::reference::{self, Sequence, Weights};
use lumi_kernels::{
    Anchors, BlockGrads, BlockShape, Compute, Frames, Save, Sight, Tokens, Wanted, block_backward,
    block_forward, block_forward_saved,
};

#[derive(Clone, Copy, Debug)]
pub struct Case {
    pub dim: usize,
    pub head_dim: usize,
    pub hidden: usize,
    pub streams: usize,
    pub batch: usize,
    pub groups: &'static [usize],
    /// Tokens of an external context.
    pub context: Option<usize>,
    /// Depths of the anchors.
    pub depths: Option<usize>,
    pub frames: bool,
}

#[allow(clippy::too_many_arguments)]
pub const fn case(
    dim: usize,
    head_dim: usize,
    hidden: usize,
    streams: usize,
    batch: usize,
    groups: &'static [usize],
    context: Option<usize>,
    depths: Option<usize>,
    frames: bool,
) -> Case {
    Case {
        dim,
        head_dim,
        hidden,
        streams,
        batch,
        groups,
        context,
        depths,
        frames,
    }
}

/// A case with its numbers.
pub struct World {
    pub case: Case,
    pub n: usize,
    pub owned: Owned,
    pub x: Vec<f32>,
    pub places: Vec<f32>,
    pub context: Vec<f32>,
    pub context_places: Vec<f32>,
    pub queries: Vec<f32>,
    pub keys: Vec<f32>,
    /// Gradient of the output.
    pub g: Vec<f32>,
}

impl World {
    pub fn new(case: Case) -> Self {
        let Case {
            dim,
            head_dim,
            batch,
            ..
        } = case;
        let shape = BlockShape {
            dim,
            head_dim,
            hidden: case.hidden,
            streams: case.streams,
        };
        let n = case.groups.iter().sum();
        let m = case.context.unwrap_or(0);
        let (pairs, depths) = (head_dim / 4, case.depths.unwrap_or(0));
        let keys = case.context.unwrap_or(n);
        let turns = batch * case.groups.len() * depths * keys * pairs;
        let mut noise = Noise(77);
        Self {
            case,
            n,
            owned: Owned::of(shape, 3),
            x: noise.vec(batch * n * dim, 1.2),
            places: frames(batch * n, 5),
            context: noise.vec(batch * m * dim, 1.2),
            context_places: frames(batch * m, 6),
            queries: rotations(batch * n * pairs, 7),
            keys: rotations(turns, 8),
            g: noise.vec(batch * n * dim, 1.0),
        }
    }

    pub fn tokens<'a>(&self, x: &'a [f32], places: &'a [f32]) -> Tokens<'a> {
        Tokens {
            x,
            frames: self.case.frames.then(|| Frames::new(places)),
        }
    }

    pub fn x(&self) -> Tokens<'_> {
        self.tokens(&self.x, &self.places)
    }

    pub fn context(&self) -> Tokens<'_> {
        self.tokens(&self.context, &self.context_places)
    }

    pub fn anchors(&self) -> Option<Anchors<'_>> {
        let (queries, keys) = (&self.queries, &self.keys);
        self.case.depths.map(|depths| Anchors {
            depths,
            queries,
            keys,
        })
    }

    pub fn sight(&self) -> Sight<'_> {
        let (groups, anchors) = (self.case.groups, self.anchors());
        match (self.case.context, anchors) {
            (Some(_), anchors) => Sight::Context {
                context: self.context(),
                groups,
                anchors,
            },
            (None, Some(anchors)) => Sight::Anchored { groups, anchors },
            (None, None) => panic!("a case of other tests"),
        }
    }

    pub fn forward(&self, compute: Compute) -> Vec<f32> {
        let Case { batch, .. } = self.case;
        let mut out = vec![f32::NAN; self.x.len()];
        let (shape, weights) = (self.owned.shape, self.owned.weights());
        let sight = self.sight();
        block_forward(
            shape,
            &weights,
            compute,
            self.x(),
            batch,
            self.n,
            sight,
            &mut out,
        );
        out
    }

    pub fn grads(&self, compute: Compute, save: Save, wanted: Wanted) -> (Vec<f32>, BlockGrads) {
        let mut out = vec![f32::NAN; self.x.len()];
        let (shape, weights) = (self.owned.shape, self.owned.weights());
        let (x, sight, batch) = (self.x(), self.sight(), self.case.batch);
        let saved = block_forward_saved(
            shape, &weights, compute, save, x, batch, self.n, sight, &mut out,
        );
        let grads = block_backward(shape, &weights, &saved, x, sight, &self.g, wanted);
        (out, grads)
    }

    /// The reference with other weights and tokens.
    pub fn want(&self, w: &Weights, x: &[f64], context: &[f64]) -> Vec<f64> {
        let Case { dim, batch, .. } = self.case;
        let [places, context_places, queries, keys] = [
            &self.places,
            &self.context_places,
            &self.queries,
            &self.keys,
        ]
        .map(|x| wide(x));
        fn part(all: &[f64], b: usize, batch: usize) -> &[f64] {
            let len = all.len() / batch;
            &all[b * len..][..len]
        }
        let sequence = |x, places| Sequence {
            x,
            frames: self.case.frames.then_some(places),
        };
        assert_eq!(x.len(), batch * self.n * dim);
        let all = (0..batch).map(|b| {
            let part = |all| part(all, b, batch);
            let groups = self.case.groups;
            let anchors = self.case.depths.map(|depths| reference::Anchors {
                depths,
                queries: part(&queries),
                keys: part(&keys),
            });
            let sight = match self.case.context {
                Some(_) => {
                    let context = sequence(part(context), part(&context_places));
                    reference::Sight::Context(context, groups, anchors)
                }
                None => reference::Sight::Anchored(groups, anchors.unwrap()),
            };
            let x = sequence(part(x), part(&places));
            reference::block(self.owned.shape, w, x, sight)
        });
        all.collect::<Vec<_>>().concat()
    }
}
