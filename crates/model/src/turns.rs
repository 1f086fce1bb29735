//! Frames and depth anchors by Burn's own operations: every device, and the slow reference of the kernels.

use crate::places::{DEPTHS, Sight};
use burn::tensor::{Device, Tensor, TensorData};
use lumi_kernels::FRAME;

/// A [`Sight`] as tensors.
#[derive(Clone, Debug)]
pub(crate) struct Turns {
    /// M and M⁻¹ of the queries' tokens with `M = [R t; 0 1]`, `[b, n, 4, 4]` each.
    own: [Tensor<4>; 2],
    /// The same of the context's.
    context: Option<[Tensor<4>; 2]>,
    /// Cosines and sines, `[b, 1, n, pairs]` each.
    queries: [Tensor<4>; 2],
    /// The same for each group, `[b, 4, m, pairs]` each.
    keys: Vec<[Tensor<4>; 2]>,
}

/// Whose tokens keys and values are made of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Whose {
    /// The queries'.
    Own,
    /// The context's.
    Context,
}

impl Turns {
    pub(crate) fn new(sight: &Sight, device: &Device) -> Self {
        let (b, groups) = (sight.batch, sight.groups.len());
        let own = motions(&sight.frames, b, device);
        let context = sight.context.as_ref().map(|f| motions(f, b, device));
        if groups == 0 {
            let none = Tensor::zeros([1, 1, 1, 1], device);
            return Self {
                own,
                context,
                queries: [none.clone(), none],
                keys: Vec::new(),
            };
        }
        let total = sight.frames.len() / (FRAME * b);
        let pairs = sight.queries.len() / (2 * b * total);
        let m = sight.keys.len() / (b * groups * DEPTHS.len() * pairs * 2).max(1);
        let data = |values: &[f32], shape: [usize; 5]| {
            Tensor::<5>::from_data(TensorData::new(values.to_vec(), shape), device)
        };
        let split = |turns: Tensor<5>| {
            let [b, h, n, pairs, _] = turns.dims();
            let part = |i| turns.clone().narrow(4, i, 1).reshape([b, h, n, pairs]);
            [part(0), part(1)]
        };
        let all = data(&sight.keys, [b * groups, DEPTHS.len(), m, pairs, 2]);
        let of_group = |g: usize| {
            let each = (0..b).map(|b| all.clone().narrow(0, b * groups + g, 1));
            split(Tensor::cat(each.collect(), 0))
        };
        Self {
            own,
            context,
            queries: split(data(&sight.queries, [b, 1, total, pairs, 2])),
            keys: (0..groups).map(of_group).collect(),
        }
    }

    fn motions(&self, whose: Whose) -> &[Tensor<4>; 2] {
        match (whose, &self.context) {
            (Whose::Context, Some(motions)) => motions,
            _ => &self.own,
        }
    }

    /// Queries, keys and values, `[b, h, n, dh]` each, into model space: `M⁻ᵀ q`, `M k`, `M v`, the first half of q's and k's
    /// channels.
    pub(crate) fn enter(&self, whose: Whose, [q, k, v]: [Tensor<4>; 3]) -> [Tensor<4>; 3] {
        let [to_model, back] = self.motions(whose);
        let to_model = to_model.clone().swap_dims(2, 3);
        // Rows times matrices, so each matrix stands transposed.
        let half = |x: Tensor<4>, m: &Tensor<4>| {
            let dh = x.dims()[3];
            let first = moved(x.clone().narrow(3, 0, dh / 2), m);
            Tensor::cat(vec![first, x.narrow(3, dh / 2, dh - dh / 2)], 3)
        };
        [half(q, back), half(k, &to_model), moved(v, &to_model)]
    }

    /// What tokens gathered, `[b, h, n, dh]`, into their own spaces: `M⁻¹ o`.
    pub(crate) fn leave(&self, gathered: Tensor<4>) -> Tensor<4> {
        let [_, back] = &self.own;
        moved(gathered, &back.clone().swap_dims(2, 3))
    }

    /// Queries, or keys of their own groups, turned by where they are in their own views: `[b, h, n, dh]`, from token `from`.
    pub(crate) fn own(&self, x: Tensor<4>, from: usize) -> Tensor<4> {
        let n = x.dims()[2];
        let part = |t: &Tensor<4>| t.clone().narrow(2, from, n);
        turned(x, &self.queries.each_ref().map(part))
    }

    /// All keys `[b, h, m, dh]` as group `g` sees them.
    pub(crate) fn keys(&self, k: Tensor<4>, g: usize) -> Tensor<4> {
        let heads = k.dims()[1];
        let of_heads = |t: &Tensor<4>| {
            let heads = (0..heads).map(|h| t.clone().narrow(1, h % DEPTHS.len(), 1));
            Tensor::cat(heads.collect(), 1)
        };
        turned(k, &self.keys[g].each_ref().map(of_heads))
    }
}

/// M and M⁻¹ of `[b, n, 12]` frames.
fn motions(frames: &[f32], b: usize, device: &Device) -> [Tensor<4>; 2] {
    let n = frames.len() / (FRAME * b.max(1));
    let frames = Tensor::<3>::from_data(TensorData::new(frames.to_vec(), [b, n, FRAME]), device);
    let part = |from: usize, columns: usize| {
        let part = frames.clone().narrow(2, from, 3 * columns);
        part.reshape([b, n, 3, columns])
    };
    let (rotation, translation) = (part(0, 3), part(9, 1));
    let last = Tensor::<1>::from_floats([0.0, 0.0, 0.0, 1.0], device);
    let last = last.reshape([1, 1, 1, 4]).expand([b, n, 1, 4]);
    let whole = |r: Tensor<4>, t: Tensor<4>| {
        Tensor::cat(vec![Tensor::cat(vec![r, t], 3), last.clone()], 2)
    };
    let back = rotation.clone().swap_dims(2, 3);
    let origin = back.clone().matmul(translation.clone()).neg();
    [whole(rotation, translation), whole(back, origin)]
}

/// Every four channels of `x` `[b, h, n, c]` times the token's matrix `[b, n, 4, 4]`.
fn moved(x: Tensor<4>, matrices: &Tensor<4>) -> Tensor<4> {
    let [b, h, n, c] = x.dims();
    let rows = x
        .reshape([b, h, n, c / 4, 4])
        .permute([0, 2, 1, 3, 4])
        .reshape([b, n, h * c / 4, 4]);
    rows.matmul(matrices.clone())
        .reshape([b, n, h, c / 4, 4])
        .permute([0, 2, 1, 3, 4])
        .reshape([b, h, n, c])
}

/// The last half of the channels of `x` `[b, h, n, dh]` turned pair by pair.
fn turned(x: Tensor<4>, [cosines, sines]: &[Tensor<4>; 2]) -> Tensor<4> {
    let [b, h, n, dh] = x.dims();
    let half = dh / 2;
    let first = x.clone().narrow(3, 0, half);
    let pairs = x.narrow(3, half, half).reshape([b, h, n, half / 2, 2]);
    let part = |i| pairs.clone().narrow(4, i, 1).reshape([b, h, n, half / 2]);
    let (a, e) = (part(0), part(1));
    let (c, s) = (cosines.clone(), sines.clone());
    let (p, q) = (
        a.clone() * c.clone() - e.clone() * s.clone(),
        a * s + e * c,
    );
    let both = Tensor::stack::<5>(vec![p, q], 4).reshape([b, h, n, half]);
    Tensor::cat(vec![first, both], 3)
}
