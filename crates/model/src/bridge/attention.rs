//! Softmax attention whose memory is linear in the number of tokens, in training too, on any Burn device.
//!
//! Under autodiff Burn keeps all n × n scores of an attention, and so would a loop over chunks of queries. Here the
//! backward pass computes each chunk's scores again.

use super::FlexTensor;
use burn::backend::autodiff::checkpoint::base::Checkpointer;
use burn::backend::autodiff::checkpoint::strategy::CheckpointStrategy;
use burn::backend::autodiff::grads::Gradients;
use burn::backend::autodiff::ops::{Backward, Ops, OpsKind};
use burn::backend::tensor::FloatTensor;
use burn::backend::{Autodiff, Backend, Dispatch, Flex, TensorMetadata, backend_extension};
use burn::tensor::{Slice, Tensor};

/// Query rows of scores held at a time.
const QUERY_CHUNK: usize = 1024;

/// softmax(q kᵀ / √dh) v, differentiable.
///
/// # Shapes
/// q `[b, h, nq, dh]`, k and v `[b, h, nk, dh]` → `[b, h, nq, dh]`
pub(crate) fn attend(q: Tensor<4>, k: Tensor<4>, v: Tensor<4>) -> Tensor<4> {
    let [q, k, v] = [q, k, v].map(Tensor::into_dispatch);
    Tensor::from_dispatch(<Dispatch as AttentionOps>::attend(q, k, v))
}

/// A backend that is listed here gets linear memory by an implementation of one line, as `Flex` below.
#[backend_extension(Flex, Cube: cfg(feature = "gpu"), Autodiff)]
pub(crate) trait AttentionOps: Backend {
    /// See [`attend`].
    fn attend(
        q: FloatTensor<Self>,
        k: FloatTensor<Self>,
        v: FloatTensor<Self>,
    ) -> FloatTensor<Self>;
}

impl AttentionOps for Flex {
    fn attend(q: FlexTensor, k: FlexTensor, v: FlexTensor) -> FlexTensor {
        Attention::<Self>::new(q, k, v).forward()
    }
}

#[cfg(feature = "gpu")]
impl AttentionOps for burn::backend::Cube {
    fn attend(
        q: FloatTensor<Self>,
        k: FloatTensor<Self>,
        v: FloatTensor<Self>,
    ) -> FloatTensor<Self> {
        Attention::<Self>::new(q, k, v).forward()
    }
}

impl<B: AttentionOps, C: CheckpointStrategy> AttentionOps for Autodiff<B, C> {
    fn attend(
        q: FloatTensor<Self>,
        k: FloatTensor<Self>,
        v: FloatTensor<Self>,
    ) -> FloatTensor<Self> {
        let nodes = [q.node(), k.node(), v.node()];
        let [q, k, v] = [q, k, v].map(|t| t.into_primitive());
        let out = B::attend(q.clone(), k.clone(), v.clone());
        match Backward::<B, 3>::prepare::<C>(AttentionOp, nodes)
            .compute_bound()
            .stateful()
        {
            OpsKind::Tracked(prep) => prep.finish(Attention::new(q, k, v), out),
            OpsKind::UnTracked(prep) => prep.finish(out),
        }
    }
}

/// One attention's inputs, which are all that its backward pass needs.
#[derive(Clone, Debug)]
struct Attention<B: Backend> {
    q: FloatTensor<B>,
    k: FloatTensor<B>,
    v: FloatTensor<B>,
}

impl<B: Backend> Attention<B> {
    fn new(q: FloatTensor<B>, k: FloatTensor<B>, v: FloatTensor<B>) -> Self {
        Self { q, k, v }
    }

    /// First rows and lengths of the chunks of queries.
    fn chunks(&self) -> impl Iterator<Item = (usize, usize)> + use<B> {
        let rows = self.q.shape()[2];
        (0..rows)
            .step_by(QUERY_CHUNK)
            .map(move |from| (from, QUERY_CHUNK.min(rows - from)))
    }

    fn scale(&self) -> f64 {
        1.0 / (self.q.shape()[3] as f64).sqrt()
    }

    /// The attention weights of a chunk of scaled queries, `[b, h, chunk, nk]`.
    fn weights(&self, queries: FloatTensor<B>) -> FloatTensor<B> {
        let keys = B::float_swap_dims(self.k.clone(), 2, 3);
        B::softmax(B::float_matmul(queries, keys), 3)
    }

    /// Scaled queries of a chunk.
    fn queries(&self, chunk: (usize, usize)) -> FloatTensor<B> {
        B::float_mul_scalar(rows::<B>(&self.q, chunk), self.scale().into())
    }

    fn forward(&self) -> FloatTensor<B> {
        let parts = self.chunks().map(|chunk| {
            let weights = self.weights(self.queries(chunk));
            B::float_matmul(weights, self.v.clone())
        });
        B::float_cat(parts.collect(), 2)
    }

    /// Gradients of q, k and v. With weights P and scores S of a chunk: dV += Pᵀ dO, dP = dO Vᵀ,
    /// dS = P ∘ (dP − rowsum(P ∘ dP)), dQ = dS K / √dh, dK += dSᵀ Q / √dh.
    fn backward(&self, grad: &FloatTensor<B>) -> [FloatTensor<B>; 3] {
        let turned = |t: FloatTensor<B>| B::float_swap_dims(t, 2, 3);
        let mut dq = Vec::new();
        let mut sums: Option<[FloatTensor<B>; 2]> = None;
        for chunk in self.chunks() {
            let (queries, out) = (self.queries(chunk), rows::<B>(grad, chunk));
            let weights = self.weights(queries.clone());
            let dv = B::float_matmul(turned(weights.clone()), out.clone());
            let dp = B::float_matmul(out, turned(self.v.clone()));
            let inner = B::float_sum_dim(B::float_mul(weights.clone(), dp.clone()), 3);
            let ds = B::float_mul(weights, B::float_sub(dp, inner));
            let dk = B::float_matmul(turned(ds.clone()), queries);
            let unscaled = B::float_matmul(ds, self.k.clone());
            dq.push(B::float_mul_scalar(unscaled, self.scale().into()));
            sums = Some(match sums {
                None => [dk, dv],
                Some([k, v]) => [B::float_add(k, dk), B::float_add(v, dv)],
            });
        }
        let [dk, dv] = sums.unwrap_or_else(|| [self.k.clone(), self.v.clone()]);
        [B::float_cat(dq, 2), dk, dv]
    }
}

/// Rows of `[b, h, n, dh]`: `(first, count)`.
fn rows<B: Backend>(t: &FloatTensor<B>, (from, count): (usize, usize)) -> FloatTensor<B> {
    let shape = t.shape();
    let slices = [0..shape[0], 0..shape[1], from..from + count, 0..shape[3]];
    B::float_slice(t.clone(), &slices.map(Slice::from))
}

#[derive(Debug)]
struct AttentionOp;

impl<B: Backend> Backward<B, 3> for AttentionOp {
    type State = Attention<B>;

    fn backward(self, ops: Ops<Self::State, 3>, grads: &mut Gradients, _: &mut Checkpointer) {
        let grad = grads.consume::<B>(&ops.node);
        for (parent, gradient) in ops.parents.iter().zip(ops.state.backward(&grad)) {
            if let Some(node) = parent {
                grads.register::<B>(node.id, gradient);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::layers::normal;
    use burn::tensor::Device;
    use burn::tensor::activation::softmax;
    use lumi_core::Seed;

    /// Attention and gradients as Burn's own autodiff has them, on more queries than one chunk.
    #[test]
    fn equals_the_composition_that_keeps_all_scores() {
        let device = Device::flex().autodiff();
        let mut rng = Seed(8).stream("attention");
        let (queries, keys, dh) = (QUERY_CHUNK + 37, 61, 8);
        let mut draw = |n: usize| normal([2, 3, n, dh], 1.0, &mut rng, &device).val().detach();
        let inputs = [draw(queries), draw(keys), draw(keys)];
        let weight = draw(queries);
        let run = |f: fn(Tensor<4>, Tensor<4>, Tensor<4>) -> Tensor<4>| {
            let [q, k, v] = inputs.clone().map(|t| t.require_grad());
            let out = f(q.clone(), k.clone(), v.clone());
            let grads = (out.clone() * weight.clone()).sum().backward();
            let of = |t: &Tensor<4>| t.grad(&grads);
            (out.inner(), [of(&q), of(&k), of(&v)])
        };
        let (out, grads) = run(attend);
        let (plain, expected) = run(|q, k, v| {
            let scale = 1.0 / (q.dims()[3] as f64).sqrt();
            softmax((q * scale).matmul(k.swap_dims(2, 3)), 3).matmul(v)
        });
        let off = |a: Tensor<4>, b: Tensor<4>| (a - b).abs().max().into_scalar::<f32>();
        assert!(off(out, plain) < 1e-5);
        for (found, expected) in grads.into_iter().zip(expected) {
            let (Some(found), Some(expected)) = (found, expected) else {
                panic!("expected gradients of all three");
            };
            let size = expected.clone().abs().max().into_scalar::<f32>();
            assert!(off(found, expected) < 1e-5 * size.max(1.0));
        }
    }
}
