//! The block kernels as a differentiable Burn operation, and packed for inference.

use super::{Flex, FlexTensor, KernelOps, flex};
use crate::block::Block;
use crate::params;
use crate::places::{DEPTHS, Sight};
use burn::backend::autodiff::checkpoint::base::Checkpointer;
use burn::backend::autodiff::grads::Gradients;
use burn::backend::autodiff::ops::{Backward, Ops};
use burn::backend::{Dispatch, TensorMetadata};
use burn::module::Param;
use burn::tensor::{Shape, Tensor, TensorData};
use lumi_kernels::{
    Anchors, BlockGrads, BlockShape, BlockWeights, Frames, KeyValues, PackedBlock, Pattern,
    Precision, Save, Saved, Tokens, Wanted, block_backward, block_forward, block_forward_saved,
};
use std::sync::Arc;

/// Tensors of a block operation: x, the context (of no tokens where there is none), then the weights in the order of
/// [`BlockWeights`].
pub(crate) const TENSORS: usize = 11;

/// Matrices of one kind of all streams, one below the other.
fn stacked(streams: &[Param<Tensor<2>>]) -> Tensor<2> {
    match streams {
        [only] => only.val(),
        several => Tensor::cat(several.iter().map(Param::val).collect(), 0),
    }
}

/// Queries' and keys' matrices, one below the other.
fn queries_and_keys(block: &Block) -> Tensor<2> {
    Tensor::cat(vec![block.q.val(), block.k.val()], 0)
}

/// A whole block: x `[b, n, d]` → `[b, n, d]`, differentiable. With a context `[b, m, d]`, x is groups of `group` tokens.
pub(crate) fn block(
    block: &Block,
    x: Tensor<3>,
    context: Option<Tensor<3>>,
    group: usize,
    sight: Option<&Sight>,
) -> Tensor<3> {
    let vector = |p: &Param<Tensor<1>>| p.val().into_dispatch();
    let options = Options {
        crossed: context.is_some().then_some(group),
        precision: block.precision,
        save: block.save,
        sight: sight.cloned(),
    };
    let d = x.dims()[2];
    let context = context.unwrap_or_else(|| Tensor::zeros([1, 0, d], &x.device()));
    Tensor::from_dispatch(<Dispatch as KernelOps>::block(
        x.into_dispatch(),
        context.into_dispatch(),
        vector(&block.norm1),
        queries_and_keys(block).into_dispatch(),
        stacked(&block.v).into_dispatch(),
        vector(&block.q_norm),
        vector(&block.k_norm),
        stacked(&block.proj).into_dispatch(),
        vector(&block.norm2),
        stacked(&block.fc1).into_dispatch(),
        stacked(&block.fc2).into_dispatch(),
        options,
    ))
}

/// The block's weights in the kernels' order.
pub(crate) fn packed(block: &Block) -> PackedBlock {
    let vectors =
        [&block.norm1, &block.q_norm, &block.k_norm, &block.norm2].map(|p| params::to_vec(p.val()));
    let matrices = [
        queries_and_keys(block),
        stacked(&block.v),
        stacked(&block.proj),
        stacked(&block.fc1),
        stacked(&block.fc2),
    ]
    .map(params::to_vec);
    let [norm1, q_norm, k_norm, norm2] = &vectors;
    let [qk, v, proj, fc1, fc2] = &matrices;
    let streams = block.v.len();
    let shape = BlockShape {
        dim: norm1.len(),
        head_dim: q_norm.len(),
        hidden: streams * fc1.len() / norm1.len(),
        streams,
    };
    let weights = BlockWeights {
        norm1,
        qk,
        v,
        q_norm,
        k_norm,
        proj,
        norm2,
        fc1,
        fc2,
    };
    PackedBlock::new(shape, &weights, block.precision)
}

/// Tokens as the kernels take them.
fn tokens<'a>(x: &'a [f32], frames: Option<&'a Arc<Vec<f32>>>) -> Tokens<'a> {
    Tokens {
        x,
        frames: frames.map(|values| Frames::new(values)),
    }
}

/// A sight's turns as the kernels take them.
fn anchors(sight: &Sight) -> Anchors<'_> {
    Anchors {
        depths: DEPTHS.len(),
        queries: &sight.queries,
        keys: &sight.keys,
    }
}

/// What tokens that all see each other attend to.
fn among_themselves(n: usize, sight: Option<&Sight>) -> lumi_kernels::Sight<'_> {
    match sight {
        Some(sight) => lumi_kernels::Sight::Anchored {
            groups: &sight.groups,
            anchors: anchors(sight),
        },
        None => Pattern::full(n).into(),
    }
}

/// Runs `f(x, batch, n, out)` on the values of x `[b, n, d]`, for `out` of the same shape; without gradients.
fn on_slices(
    x: Tensor<3>,
    sight: Option<&Sight>,
    f: impl FnOnce(Tokens, usize, usize, &mut [f32]),
) -> Tensor<3> {
    let ([b, n, d], device) = (x.dims(), x.device());
    let x = params::to_vec(x);
    let mut out = vec![0.0; x.len()];
    f(tokens(&x, sight.map(|s| &s.frames)), b, n, &mut out);
    Tensor::from_data(TensorData::new(out, [b, n, d]), &device)
}

/// A packed block over tokens that all see each other: x `[b, n, d]` → `[b, n, d]`.
pub(crate) fn forward_packed(
    block: &PackedBlock,
    x: Tensor<3>,
    sight: Option<&Sight>,
) -> Tensor<3> {
    on_slices(x, sight, |x, b, n, out| {
        block.forward(x, b, n, among_themselves(n, sight), out)
    })
}

/// Keys and values of a context `[b, k, d]` with these frames.
pub(crate) fn key_values_packed(
    block: &PackedBlock,
    x: Tensor<3>,
    frames: Option<&Arc<Vec<f32>>>,
) -> KeyValues {
    let [b, n, _] = x.dims();
    block.key_values(tokens(&params::to_vec(x), frames), b, n, frames.is_some())
}

/// A packed block over groups of queries `[b, n, d]` that see a context.
pub(crate) fn queries_packed(
    block: &PackedBlock,
    context: &KeyValues,
    x: Tensor<3>,
    group: usize,
    sight: Option<&Sight>,
) -> Tensor<3> {
    on_slices(x, sight, |x, b, n, out| {
        let groups = vec![group; n / group.max(1)];
        block.forward_queries(context, x, b, n, &groups, sight.map(anchors), out)
    })
}

/// One call's sizes and its tensors, contiguous.
#[derive(Clone)]
pub(super) struct Call {
    tensors: [FlexTensor; TENSORS],
    options: Options,
    /// Lengths of the groups of queries that see a context.
    groups: Vec<usize>,
}

/// How a block is to be computed.
#[derive(Clone, Debug)]
pub(crate) struct Options {
    /// Queries of a group, where they see a context.
    crossed: Option<usize>,
    precision: Precision,
    save: Save,
    sight: Option<Sight>,
}

impl Call {
    pub(super) fn new(tensors: [FlexTensor; TENSORS], options: Options) -> Self {
        let n = tensors[0].shape()[1];
        let groups = options.crossed.map(|group| vec![group; n / group.max(1)]);
        Self {
            tensors: tensors.map(|t| t.to_contiguous()),
            groups: groups.unwrap_or_default(),
            options,
        }
    }

    fn slice(&self, i: usize) -> &[f32] {
        self.tensors[i].storage()
    }

    /// Batch, tokens, and the block's sizes.
    fn sizes(&self) -> (usize, usize, BlockShape) {
        let [x, v, q_norm, fc1] = [0, 4, 5, 9].map(|i| self.tensors[i].shape());
        (
            x[0],
            x[1],
            BlockShape {
                dim: x[2],
                head_dim: q_norm[0],
                hidden: fc1[0],
                streams: x[2] / v[1],
            },
        )
    }

    fn tokens(&self) -> Tokens<'_> {
        tokens(self.slice(0), self.options.sight.as_ref().map(|s| &s.frames))
    }

    fn sight(&self) -> lumi_kernels::Sight<'_> {
        let sight = self.options.sight.as_ref();
        if self.options.crossed.is_none() {
            return among_themselves(self.sizes().1, sight);
        }
        lumi_kernels::Sight::Context {
            context: tokens(self.slice(1), sight.map(Sight::keys_frames)),
            groups: &self.groups,
            anchors: sight.map(anchors),
        }
    }

    fn weights(&self) -> BlockWeights<'_> {
        BlockWeights {
            norm1: self.slice(2),
            qk: self.slice(3),
            v: self.slice(4),
            q_norm: self.slice(5),
            k_norm: self.slice(6),
            proj: self.slice(7),
            norm2: self.slice(8),
            fc1: self.slice(9),
            fc2: self.slice(10),
        }
    }

    pub(super) fn forward(&self) -> FlexTensor {
        let (batch, n, shape) = self.sizes();
        let mut out = vec![0.0; self.slice(0).len()];
        let weights = self.weights();
        let (x, sight) = (self.tokens(), self.sight());
        block_forward(
            shape,
            &weights,
            self.options.precision,
            x,
            batch,
            n,
            sight,
            &mut out,
        );
        flex(out, self.tensors[0].shape())
    }

    pub(super) fn forward_saved(&self) -> (FlexTensor, Saved) {
        let (batch, n, shape) = self.sizes();
        let mut out = vec![0.0; self.slice(0).len()];
        let saved = block_forward_saved(
            shape,
            &self.weights(),
            self.options.precision,
            self.options.save,
            self.tokens(),
            batch,
            n,
            self.sight(),
            &mut out,
        );
        (flex(out, self.tensors[0].shape()), saved)
    }

    /// Gradients in the order of the tensors.
    fn backward(&self, saved: &Saved, grad: &FlexTensor, wanted: Wanted) -> [FlexTensor; TENSORS] {
        let grad = grad.to_contiguous();
        let (_, _, shape) = self.sizes();
        let (x, sight) = (self.tokens(), self.sight());
        let g = block_backward(shape, &self.weights(), saved, x, sight, grad.storage(), wanted);
        let BlockGrads {
            x,
            context,
            norm1,
            qk,
            v,
            q_norm,
            k_norm,
            proj,
            norm2,
            fc1,
            fc2,
        } = g;
        let values = [
            x, context, norm1, qk, v, q_norm, k_norm, proj, norm2, fc1, fc2,
        ];
        let mut tensors = self.tensors.each_ref().into_iter();
        values.map(|v| match tensors.next() {
            // What was not wanted is empty, and nobody asks for it.
            Some(_) if v.is_empty() => flex(v, Shape::from([0])),
            Some(tensor) => flex(v, tensor.shape()),
            None => unreachable!("as many gradients as tensors"),
        })
    }
}

/// What the backward pass needs: the call and its activations.
#[derive(Clone)]
pub(super) struct BlockState(Arc<(Call, Saved)>);

impl BlockState {
    pub(super) fn new(call: Call, saved: Saved) -> Self {
        Self(Arc::new((call, saved)))
    }
}

impl std::fmt::Debug for BlockState {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("BlockState")
    }
}

#[derive(Debug)]
pub(super) struct BlockOp;

impl Backward<Flex, TENSORS> for BlockOp {
    type State = BlockState;

    fn backward(self, ops: Ops<Self::State, TENSORS>, grads: &mut Gradients, _: &mut Checkpointer) {
        let grad = grads.consume::<Flex>(&ops.node);
        let (call, saved) = &*ops.state.0;
        // Positions of the matrices among the parents.
        let frozen = [3, 4, 7, 9, 10].iter().all(|i| ops.parents[*i].is_none());
        let wanted = if frozen {
            Wanted::NoMatrices
        } else {
            Wanted::All
        };
        for (parent, gradient) in ops.parents.iter().zip(call.backward(saved, &grad, wanted)) {
            if let Some(node) = parent {
                grads.register::<Flex>(node.id, gradient);
            }
        }
    }
}
