//! The transformer block: pre-norm, QK-normalised, exact GELU, no biases.

use crate::bridge;
use crate::bridge::attention::attend;
use crate::places::Sight;
use crate::turns::{Turns, Whose};
use crate::layers::{layer_norm, linear, normal, ones, rms_norm};
use burn::module::{Module, Param};
use burn::tensor::activation::gelu;
use burn::tensor::{Device, Tensor};
use lumi_core::seed::Rng;
use lumi_kernels::{PackedBlock, Precision, Save};
use std::sync::Arc;

/// `x += proj(attention(norm1 x))`, then `x += fc2(gelu(fc1(norm2 x)))`.
///
/// A token's d channels are S streams of d/S one after the other (split streams, arXiv 2605.18599; S = 1 is the usual
/// block). Queries and keys are made of all channels; norms, values, output projection and MLP are each stream's own. Head h
/// gathers values of the channels `h·dh/S` to `(h + 1)·dh/S` of every stream.
#[derive(Module, Debug)]
pub struct Block {
    /// `[d]`
    pub norm1: Param<Tensor<1>>,
    /// `[d, d]`; head h holds channels h·dh to (h+1)·dh.
    pub q: Param<Tensor<2>>,
    /// As `q`.
    pub k: Param<Tensor<2>>,
    /// Per stream `[d/S, d/S]`.
    pub v: Vec<Param<Tensor<2>>>,
    /// `[dh]`, shared by the heads
    pub q_norm: Param<Tensor<1>>,
    /// `[dh]`, shared by the heads
    pub k_norm: Param<Tensor<1>>,
    /// Per stream `[d/S, d/S]`.
    pub proj: Vec<Param<Tensor<2>>>,
    /// `[d]`
    pub norm2: Param<Tensor<1>>,
    /// Per stream `[4d/S, d/S]`.
    pub fc1: Vec<Param<Tensor<2>>>,
    /// Per stream `[d/S, 4d/S]`.
    pub fc2: Vec<Param<Tensor<2>>>,
    /// Precision of matrix operands where our kernels run.
    #[module(skip)]
    pub precision: Precision,
    /// What our kernels keep for the backward pass.
    #[module(skip)]
    pub save: Save,
    /// The weights in the kernels' order, for inference; see [`Block::pack`].
    #[module(skip)]
    packed: Packed,
}

/// Packed weights, if there are any.
#[derive(Clone, Default)]
struct Packed(Option<Arc<PackedBlock>>);

impl std::fmt::Debug for Packed {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(if self.0.is_some() {
            "packed"
        } else {
            "not packed"
        })
    }
}

/// Keys (normalised, not turned) and values of context tokens in one block, for [`Block::against`] of the same block.
#[derive(Clone)]
pub struct KeyValues(Kept);

#[derive(Clone)]
enum Kept {
    /// As the kernels read them.
    Packed(Arc<lumi_kernels::KeyValues>),
    /// Keys and values, `[b, h, k, dh]` each.
    Tensors(Box<[Tensor<4>; 2]>),
}

impl std::fmt::Debug for KeyValues {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("KeyValues")
    }
}

impl Block {
    /// Weights drawn from N(0, `std`²), gains of one.
    ///
    /// # Panics
    /// If `streams` does not divide `head_dim`.
    pub fn new(
        dim: usize,
        head_dim: usize,
        streams: usize,
        std: f32,
        rng: &mut Rng,
        device: &Device,
    ) -> Self {
        assert!(
            streams > 0 && head_dim.is_multiple_of(streams),
            "block: {streams} streams of heads of {head_dim}"
        );
        let part = dim / streams;
        let stack = |shape: [usize; 2], rng: &mut Rng| -> Vec<Param<Tensor<2>>> {
            (0..streams).map(|_| normal(shape, std, rng, device)).collect()
        };
        Self {
            norm1: ones(dim, device),
            q: normal([dim, dim], std, rng, device),
            k: normal([dim, dim], std, rng, device),
            v: stack([part, part], rng),
            q_norm: ones(head_dim, device),
            k_norm: ones(head_dim, device),
            proj: stack([part, part], rng),
            norm2: ones(dim, device),
            fc1: stack([4 * part, part], rng),
            fc2: stack([part, 4 * part], rng),
            precision: Precision::F32,
            save: Save::default(),
            packed: Packed::default(),
        }
    }

    /// Puts the weights into the kernels' order once, instead of at every call. They must not change afterwards.
    /// Does nothing on devices without our kernels.
    pub fn pack(&mut self) {
        if bridge::has_kernels(&self.norm1.val().device()) {
            self.packed = Packed(Some(Arc::new(bridge::block::packed(self))));
        }
    }

    /// The block over tokens that all see each other.
    ///
    /// # Shapes
    /// `[b, n, d]` → `[b, n, d]`; `sight` says where the tokens are, if that is to matter.
    #[must_use]
    pub fn forward(&self, x: Tensor<3>, sight: Option<&Sight>) -> Tensor<3> {
        match self.packed_for(&x) {
            Some(packed) => bridge::block::forward_packed(packed, x, sight),
            None if bridge::has_kernels(&x.device()) => {
                bridge::block::block(self, x, None, 0, sight)
            }
            None => self.forward_composed(x, sight),
        }
    }

    /// The same from Burn's own operations: every device, and the slow reference of the kernels.
    #[must_use]
    pub fn forward_composed(&self, x: Tensor<3>, sight: Option<&Sight>) -> Tensor<3> {
        let attention = self.attention(self.norm(&x, &self.norm1), sight);
        self.after_attention(x, attention)
    }

    /// The block over tokens in groups of `group`, which see the context and their own group. Nothing becomes of the
    /// context's tokens.
    ///
    /// # Shapes
    /// x `[b, n, d]`, context `[b, m, d]` → `[b, n, d]`, n a multiple of `group`
    #[must_use]
    pub fn cross(
        &self,
        x: Tensor<3>,
        context: Tensor<3>,
        group: usize,
        sight: Option<&Sight>,
    ) -> Tensor<3> {
        if self.packed_for(&x).is_none() && bridge::has_kernels(&x.device()) {
            return bridge::block::block(self, x, Some(context), group, sight);
        }
        let cache = self.key_values(context, sight);
        self.against(x, group, &cache, sight)
    }

    /// [`Self::cross`] from Burn's own operations.
    #[must_use]
    pub fn cross_composed(
        &self,
        x: Tensor<3>,
        context: Tensor<3>,
        group: usize,
        sight: Option<&Sight>,
    ) -> Tensor<3> {
        let [keys, values] = self.context_heads(context, sight);
        self.against_composed(x, group, &keys, &values, sight)
    }

    /// Keys and values of context tokens `[b, m, d]` for [`Self::against`].
    ///
    /// # Shapes
    /// `[b, m, d]`
    #[must_use]
    pub fn key_values(&self, context: Tensor<3>, sight: Option<&Sight>) -> KeyValues {
        KeyValues(match self.packed_for(&context) {
            Some(packed) => {
                let frames = sight.map(Sight::keys_frames);
                let kept = bridge::block::key_values_packed(packed, context, frames);
                Kept::Packed(Arc::new(kept))
            }
            None => Kept::Tensors(Box::new(self.context_heads(context, sight))),
        })
    }

    fn context_heads(&self, context: Tensor<3>, sight: Option<&Sight>) -> [Tensor<4>; 2] {
        let context = self.norm(&context, &self.norm1);
        let [_, k, v] = self.heads(context, sight.map(|sight| (sight, Whose::Context)));
        [k, v]
    }

    /// What [`Self::cross`] makes of x, with the context's part done before.
    ///
    /// # Shapes
    /// `[b, n, d]` → `[b, n, d]`, n a multiple of `group`
    ///
    /// # Panics
    /// If `cache` is of another block, or of this one before it was packed.
    #[must_use]
    pub fn against(
        &self,
        x: Tensor<3>,
        group: usize,
        cache: &KeyValues,
        sight: Option<&Sight>,
    ) -> Tensor<3> {
        match (&cache.0, self.packed_for(&x)) {
            (Kept::Packed(cache), Some(packed)) => {
                bridge::block::queries_packed(packed, cache, x, group, sight)
            }
            (Kept::Tensors(both), _) => {
                let [keys, values] = &**both;
                self.against_composed(x, group, keys, values, sight)
            }
            (Kept::Packed(_), None) => panic!("keys and values of a packed block"),
        }
    }

    fn against_composed(
        &self,
        x: Tensor<3>,
        group: usize,
        keys: &Tensor<4>,
        values: &Tensor<4>,
        sight: Option<&Sight>,
    ) -> Tensor<3> {
        let normed = self.norm(&x, &self.norm1);
        let [q, k, v] = self.heads(normed, sight.map(|sight| (sight, Whose::Own)));
        let turns = sight.map(|sight| sight.turns(&x.device()));
        let (q, k) = match turns {
            Some(turns) => (turns.own(q, 0), turns.own(k, 0)),
            None => (q, k),
        };
        let n = q.dims()[2];
        let outputs = (0..n).step_by(group.max(1)).enumerate().map(|(g, from)| {
            let part = |t: &Tensor<4>| t.clone().narrow(2, from, group);
            let seen = match turns {
                Some(turns) => turns.keys(keys.clone(), g),
                None => keys.clone(),
            };
            let k = Tensor::cat(vec![seen, part(&k)], 2);
            let v = Tensor::cat(vec![values.clone(), part(&v)], 2);
            attend(part(&q), k, v)
        });
        let gathered = Tensor::cat(outputs.collect(), 2);
        let attention = self.project(gathered, turns);
        self.after_attention(x, attention)
    }

    /// The packed weights, where `x` can and may go through them: they give no gradients.
    fn packed_for(&self, x: &Tensor<3>) -> Option<&PackedBlock> {
        let device = x.device();
        let usable = bridge::has_kernels(&device) && !device.is_autodiff();
        self.packed.0.as_deref().filter(|_| usable)
    }

    /// Residual of the attention branch, then the MLP branch; both `[b, n, d]`.
    fn after_attention(&self, x: Tensor<3>, attention: Tensor<3>) -> Tensor<3> {
        let x = x + attention;
        let hidden = gelu(by_stream(self.norm(&x, &self.norm2), &self.fc1));
        x + by_stream(hidden, &self.fc2)
    }

    /// LayerNorm of each stream.
    fn norm(&self, x: &Tensor<3>, gain: &Param<Tensor<1>>) -> Tensor<3> {
        let [b, n, d] = x.dims();
        let streams = self.v.len();
        let each = x.clone().reshape([b, n * streams, d / streams]);
        let plain = Tensor::ones([d / streams], &x.device());
        layer_norm(each, plain).reshape([b, n, d]) * gain.val().unsqueeze::<3>()
    }

    /// The attention branch after its norm, over tokens that all see each other.
    ///
    /// # Shapes
    /// `[b, n, d]` → `[b, n, d]`
    #[must_use]
    pub fn attention(&self, x: Tensor<3>, sight: Option<&Sight>) -> Tensor<3> {
        let turns = sight.map(|sight| sight.turns(&x.device()));
        let [q, k, v] = self.heads(x, sight.map(|sight| (sight, Whose::Own)));
        let (Some(turns), Some(sight)) = (turns, sight) else {
            return self.project(attend(q, k, v), None);
        };
        let q = turns.own(q, 0);
        let mut from = 0;
        let outputs = sight.groups.iter().enumerate().map(|(g, &len)| {
            let part = q.clone().narrow(2, from, len);
            from += len;
            attend(part, turns.keys(k.clone(), g), v.clone())
        });
        let gathered = Tensor::cat(outputs.collect(), 2);
        self.project(gathered, Some(turns))
    }

    /// Heads merged and projected, in the tokens' own spaces: `[b, h, n, dh]` → `[b, n, d]`.
    fn project(&self, heads: Tensor<4>, turns: Option<&Turns>) -> Tensor<3> {
        let [b, h, n, dh] = heads.dims();
        let heads = match turns {
            Some(turns) => turns.leave(heads),
            None => heads,
        };
        let s = self.v.len();
        let merged = heads
            .reshape([b, h, n, s, dh / s])
            .permute([0, 2, 3, 1, 4])
            .reshape([b, n, h * dh]);
        by_stream(merged, &self.proj)
    }

    /// Normalised queries and keys, and values; in model space, where tokens have places. Queries and keys are not turned yet.
    ///
    /// # Shapes
    /// `[b, n, d]` → three `[b, heads, n, dh]`
    #[must_use]
    pub(crate) fn heads(&self, x: Tensor<3>, sight: Option<(&Sight, Whose)>) -> [Tensor<4>; 3] {
        let [b, n, d] = x.dims();
        let (dh, s) = (self.q_norm.val().dims()[0], self.v.len());
        let h = d / dh;
        let [q, k] = [&self.q, &self.k].map(|w| {
            linear(x.clone(), w.val())
                .reshape([b, n, h, dh])
                .swap_dims(1, 2)
        });
        let v = by_stream(x.clone(), &self.v)
            .reshape([b, n, s, h, dh / s])
            .permute([0, 3, 1, 2, 4])
            .reshape([b, h, n, dh]);
        let [q, k, v] = match sight {
            Some((sight, whose)) => sight.turns(&x.device()).enter(whose, [q, k, v]),
            None => [q, k, v],
        };
        [
            rms_norm(q, self.q_norm.val()),
            rms_norm(k, self.k_norm.val()),
            v,
        ]
    }
}

/// Each stream of `x` `[b, n, in]` times its own matrix `[out/S, in/S]`: `[b, n, out]`.
fn by_stream(x: Tensor<3>, weights: &[Param<Tensor<2>>]) -> Tensor<3> {
    let part = x.dims()[2] / weights.len();
    let streams = weights.iter().enumerate().map(|(s, weight)| {
        linear(x.clone().narrow(2, s * part, part), weight.val())
    });
    Tensor::cat(streams.collect(), 2)
}
