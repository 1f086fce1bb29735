//! The transformer block: pre-norm, QK-normalised, exact GELU, no biases.

use crate::layers::{layer_norm, linear, normal, ones, rms_norm};
use burn::module::{Module, Param};
use burn::tensor::activation::{gelu, softmax};
use burn::tensor::{Device, Tensor};
use lumi_core::seed::Rng;
use lumi_kernels::{Pattern, Precision};

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
}

/// Query rows of attention scores held at a time on devices without our kernels.
const QUERY_CHUNK: usize = 1024;

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
        }
    }

    /// # Shapes
    /// `[b, n, d]` → `[b, n, d]`; `pattern` says which of the n tokens see which.
    #[must_use]
    pub fn forward(&self, x: Tensor<3>, pattern: Pattern) -> Tensor<3> {
        if !crate::bridge::has_kernels(&x.device()) {
            return self.forward_composed(x, pattern);
        }
        let gains = [&self.norm1, &self.q_norm, &self.k_norm, &self.norm2].map(Param::val);
        let matrices = [&self.qkv, &self.proj, &self.fc1, &self.fc2].map(Param::val);
        crate::bridge::block(x, gains, matrices, pattern, self.precision)
    }

    /// The same from Burn's own operations: every device, and the slow reference of the kernels.
    #[must_use]
    pub fn forward_composed(&self, x: Tensor<3>, pattern: Pattern) -> Tensor<3> {
        let x = x.clone() + self.attention(layer_norm(x, self.norm1.val()), pattern);
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
    pub fn attention(&self, x: Tensor<3>, pattern: Pattern) -> Tensor<3> {
        let [b, n, d] = x.dims();
        let [q, k, v] = self.heads(x);
        let Pattern { context, group } = pattern;
        let part = |t: &Tensor<4>, from: usize, to: usize| t.clone().narrow(2, from, to - from);
        let mut outputs = Vec::new();
        if context > 0 {
            let keys = (part(&k, 0, context), part(&v, 0, context));
            outputs.push(attend(part(&q, 0, context), keys.0, keys.1));
        }
        for from in (context..n).step_by(group.max(1)) {
            let to = from + group;
            let with_context = |t: &Tensor<4>| {
                if context == 0 {
                    part(t, from, to)
                } else {
                    Tensor::cat(vec![part(t, 0, context), part(t, from, to)], 2)
                }
            };
            outputs.push(attend(
                part(&q, from, to),
                with_context(&k),
                with_context(&v),
            ));
        }
        let merged = Tensor::cat(outputs, 2).swap_dims(1, 2).reshape([b, n, d]);
        linear(merged, self.proj.val())
    }

    /// Normalised queries and keys, and values.
    ///
    /// # Shapes
    /// `[b, n, d]` → three `[b, heads, n, dh]`
    #[must_use]
    pub fn heads(&self, x: Tensor<3>) -> [Tensor<4>; 3] {
        let [b, n, d] = x.dims();
        let dh = self.q_norm.val().dims()[0];
        let qkv = linear(x, self.qkv.val());
        let [q, k, v] = [0, 1, 2].map(|i| {
            qkv.clone()
                .narrow(2, i * d, d)
                .reshape([b, n, d / dh, dh])
                .swap_dims(1, 2)
        });
        [
            rms_norm(q, self.q_norm.val()),
            rms_norm(k, self.k_norm.val()),
            v,
        ]
    }
}

/// Softmax attention, a chunk of queries at a time so that memory stays linear in the keys.
///
/// # Shapes
/// q `[b, h, nq, dh]`, k and v `[b, h, nk, dh]` → `[b, h, nq, dh]`
fn attend(q: Tensor<4>, k: Tensor<4>, v: Tensor<4>) -> Tensor<4> {
    let [_, _, rows, dh] = q.dims();
    let scale = 1.0 / (dh as f64).sqrt();
    let keys = k.swap_dims(2, 3);
    let chunks = (0..rows).step_by(QUERY_CHUNK).map(|from| {
        let chunk = q.clone().narrow(2, from, QUERY_CHUNK.min(rows - from)) * scale;
        softmax(chunk.matmul(keys.clone()), 3).matmul(v.clone())
    });
    Tensor::cat(chunks.collect(), 2)
}
