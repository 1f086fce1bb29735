//! The transformer block: pre-norm, QK-normalised, exact GELU, no biases.

use crate::bridge;
use crate::bridge::attention::attend;
use crate::frames::Frames;
use crate::layers::{layer_norm, linear, normal, ones, rms_norm};
use burn::module::{Module, Param};
use burn::tensor::activation::gelu;
use burn::tensor::{Device, Tensor};
use lumi_core::seed::Rng;
use lumi_kernels::{PackedBlock, Pattern, Precision, Save};
use std::sync::Arc;

/// `x += proj(attention(norm1 x))`, then `x += fc2(gelu(fc1(norm2 x)))`.
#[derive(Module, Debug)]
pub struct Block {
    /// `[d]`
    pub norm1: Param<Tensor<1>>,
    /// `[3d, d]`, rows q ‖ k ‖ v; head h holds channels h·dh to (h+1)·dh of each.
    pub qkv: Param<Tensor<2>>,
    /// `[dh]`, shared by the heads
    pub q_norm: Param<Tensor<1>>,
    /// `[dh]`, shared by the heads
    pub k_norm: Param<Tensor<1>>,
    /// `[d, d]`
    pub proj: Param<Tensor<2>>,
    /// `[d]`
    pub norm2: Param<Tensor<1>>,
    /// `[4d, d]`
    pub fc1: Param<Tensor<2>>,
    /// `[d, 4d]`
    pub fc2: Param<Tensor<2>>,
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

/// Keys (normalised) and values of context tokens in one block, for [`Block::against`] of the same block.
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
    pub fn new(dim: usize, head_dim: usize, std: f32, rng: &mut Rng, device: &Device) -> Self {
        Self {
            norm1: ones(dim, device),
            qkv: normal([3 * dim, dim], std, rng, device),
            q_norm: ones(head_dim, device),
            k_norm: ones(head_dim, device),
            proj: normal([dim, dim], std, rng, device),
            norm2: ones(dim, device),
            fc1: normal([4 * dim, dim], std, rng, device),
            fc2: normal([dim, 4 * dim], std, rng, device),
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

    /// # Shapes
    /// `[b, n, d]` → `[b, n, d]`; `pattern` says which of the n tokens see which, `frames` where they are, if that is to matter.
    #[must_use]
    pub fn forward(&self, x: Tensor<3>, pattern: Pattern, frames: Option<&Frames>) -> Tensor<3> {
        match self.packed_for(&x) {
            Some(packed) => bridge::block::forward_packed(packed, x, pattern, frames),
            None if bridge::has_kernels(&x.device()) => {
                bridge::block::block(self, x, pattern, frames)
            }
            None => self.forward_composed(x, pattern, frames),
        }
    }

    /// The same from Burn's own operations: every device, and the slow reference of the kernels.
    #[must_use]
    pub fn forward_composed(
        &self,
        x: Tensor<3>,
        pattern: Pattern,
        frames: Option<&Frames>,
    ) -> Tensor<3> {
        let normed = layer_norm(x.clone(), self.norm1.val());
        let attention = self.attention(normed, pattern, frames);
        self.after_attention(x, attention)
    }

    /// The block over context tokens alone, and their keys and values for [`Self::against`].
    ///
    /// # Shapes
    /// `[b, k, d]` → `[b, k, d]`
    #[must_use]
    pub fn context(&self, x: Tensor<3>, frames: Option<&Frames>) -> (Tensor<3>, KeyValues) {
        if let Some(packed) = self.packed_for(&x) {
            let (y, cache) = bridge::block::context_packed(packed, x, frames);
            return (y, KeyValues(Kept::Packed(Arc::new(cache))));
        }
        let [q, k, v] = self.heads(layer_norm(x.clone(), self.norm1.val()), frames);
        let attention = self.project(attend(q, k.clone(), v.clone()), frames);
        let y = self.after_attention(x, attention);
        (y, KeyValues(Kept::Tensors(Box::new([k, v]))))
    }

    /// The keys and values of [`Self::context`] alone, for the last block of a stack.
    ///
    /// # Shapes
    /// `[b, k, d]`
    #[must_use]
    pub fn key_values(&self, x: Tensor<3>, frames: Option<&Frames>) -> KeyValues {
        KeyValues(match self.packed_for(&x) {
            Some(packed) => {
                let kept = bridge::block::key_values_packed(packed, x, frames);
                Kept::Packed(Arc::new(kept))
            }
            None => {
                let [_, k, v] = self.heads(layer_norm(x, self.norm1.val()), frames);
                Kept::Tensors(Box::new([k, v]))
            }
        })
    }

    /// The block over tokens in groups of `group`, each seeing the context behind `cache` and its own group:
    /// what [`Self::forward`] makes of the tokens after the context.
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
        frames: Option<&Frames>,
    ) -> Tensor<3> {
        match (&cache.0, self.packed_for(&x)) {
            (Kept::Packed(cache), Some(packed)) => {
                bridge::block::queries_packed(packed, cache, x, group, frames)
            }
            (Kept::Tensors(both), _) => {
                let [keys, values] = &**both;
                let [q, k, v] = self.heads(layer_norm(x.clone(), self.norm1.val()), frames);
                let attention = attend_groups(&q, &k, &v, group, Some((keys, values)));
                self.after_attention(x, self.project(attention, frames))
            }
            (Kept::Packed(_), None) => panic!("keys and values of a packed block"),
        }
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
        let hidden = gelu(linear(
            layer_norm(x.clone(), self.norm2.val()),
            self.fc1.val(),
        ));
        x + linear(hidden, self.fc2.val())
    }

    /// The attention branch after its norm.
    ///
    /// # Shapes
    /// `[b, n, d]` → `[b, n, d]`
    #[must_use]
    pub fn attention(&self, x: Tensor<3>, pattern: Pattern, frames: Option<&Frames>) -> Tensor<3> {
        let heads = self.heads(x, frames);
        let n = heads[0].dims()[2];
        let Pattern { context, group } = pattern;
        let part = |from: usize, to: usize| {
            heads
                .each_ref()
                .map(|t| t.clone().narrow(2, from, to - from))
        };
        if context == n {
            let [q, k, v] = heads;
            return self.project(attend(q, k, v), frames);
        }
        let [q, k, v] = part(context, n);
        if context == 0 {
            return self.project(attend_groups(&q, &k, &v, group, None), frames);
        }
        let [context_q, context_k, context_v] = part(0, context);
        let first = attend(context_q, context_k.clone(), context_v.clone());
        let groups = attend_groups(&q, &k, &v, group, Some((&context_k, &context_v)));
        self.project(Tensor::cat(vec![first, groups], 2), frames)
    }

    /// Heads merged and projected, in the tokens' own spaces: `[b, h, n, dh]` → `[b, n, d]`.
    fn project(&self, heads: Tensor<4>, frames: Option<&Frames>) -> Tensor<3> {
        let [b, h, n, dh] = heads.dims();
        let heads = match frames {
            Some(frames) => frames.leave(heads),
            None => heads,
        };
        linear(
            heads.swap_dims(1, 2).reshape([b, n, h * dh]),
            self.proj.val(),
        )
    }

    /// Normalised queries and keys, and values; in model space, where tokens have frames.
    ///
    /// # Shapes
    /// `[b, n, d]` → three `[b, heads, n, dh]`
    #[must_use]
    pub fn heads(&self, x: Tensor<3>, frames: Option<&Frames>) -> [Tensor<4>; 3] {
        let [b, n, d] = x.dims();
        let dh = self.q_norm.val().dims()[0];
        let qkv = linear(x, self.qkv.val());
        let parts = [0, 1, 2].map(|i| {
            qkv.clone()
                .narrow(2, i * d, d)
                .reshape([b, n, d / dh, dh])
                .swap_dims(1, 2)
        });
        let [q, k, v] = match frames {
            Some(frames) => frames.enter(parts),
            None => parts,
        };
        [
            rms_norm(q, self.q_norm.val()),
            rms_norm(k, self.k_norm.val()),
            v,
        ]
    }
}

/// Attention inside each group of tokens and from it to the keys and values of a context.
///
/// # Shapes
/// q, k, v `[b, h, n, dh]`, context `[b, h, k, dh]` → `[b, h, n, dh]`
fn attend_groups(
    q: &Tensor<4>,
    k: &Tensor<4>,
    v: &Tensor<4>,
    group: usize,
    context: Option<(&Tensor<4>, &Tensor<4>)>,
) -> Tensor<4> {
    let n = q.dims()[2];
    let outputs = (0..n).step_by(group.max(1)).map(|from| {
        let part = |t: &Tensor<4>| t.clone().narrow(2, from, group);
        let (k, v) = match context {
            None => (part(k), part(v)),
            Some((keys, values)) => (
                Tensor::cat(vec![keys.clone(), part(k)], 2),
                Tensor::cat(vec![values.clone(), part(v)], 2),
            ),
        };
        attend(part(q), k, v)
    });
    Tensor::cat(outputs.collect(), 2)
}
