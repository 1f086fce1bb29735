//! The block kernels as a differentiable Burn operation, and packed for inference.

use super::{Flex, FlexTensor, KernelOps, flex};
use crate::block::Block;
use crate::frames::Frames;
use crate::params;
use burn::backend::autodiff::checkpoint::base::Checkpointer;
use burn::backend::autodiff::grads::Gradients;
use burn::backend::autodiff::ops::{Backward, Ops};
use burn::backend::{Dispatch, TensorMetadata};
use burn::module::Param;
use burn::tensor::{Shape, Tensor, TensorData};
use lumi_kernels::{
    BlockGrads, BlockShape, BlockWeights, KeyValues, PackedBlock, Pattern, Precision, Save, Saved,
    Tokens, Wanted, block_backward, block_forward, block_forward_saved,
};
use std::sync::Arc;

/// A whole block: x `[b, n, d]` → `[b, n, d]`, differentiable.
pub(crate) fn block(
    block: &Block,
    x: Tensor<3>,
    pattern: Pattern,
    frames: Option<&Frames>,
) -> Tensor<3> {
    let vector = |p: &Param<Tensor<1>>| p.val().into_dispatch();
    let matrix = |p: &Param<Tensor<2>>| p.val().into_dispatch();
    Tensor::from_dispatch(<Dispatch as KernelOps>::block(
        x.into_dispatch(),
        vector(&block.norm1),
        matrix(&block.qkv),
        vector(&block.q_norm),
        vector(&block.k_norm),
        matrix(&block.proj),
        vector(&block.norm2),
        matrix(&block.fc1),
        matrix(&block.fc2),
        Options {
            pattern,
            precision: block.precision,
            save: block.save,
            frames: frames.and_then(Frames::host).cloned(),
        },
    ))
}

/// The block's weights in the kernels' order.
pub(crate) fn packed(block: &Block) -> PackedBlock {
    let vectors =
        [&block.norm1, &block.q_norm, &block.k_norm, &block.norm2].map(|p| params::to_vec(p.val()));
    let matrices =
        [&block.qkv, &block.proj, &block.fc1, &block.fc2].map(|p| params::to_vec(p.val()));
    let [norm1, q_norm, k_norm, norm2] = &vectors;
    let [qkv, proj, fc1, fc2] = &matrices;
    let shape = BlockShape {
        dim: norm1.len(),
        head_dim: q_norm.len(),
        hidden: fc1.len() / norm1.len(),
    };
    let weights = BlockWeights {
        norm1,
        qkv,
        q_norm,
        k_norm,
        proj,
        norm2,
        fc1,
        fc2,
    };
    PackedBlock::new(shape, &weights, block.precision)
}

/// Tokens as the kernels take them, with frames as [`Frames::host`] has them.
fn tokens<'a>(x: &'a [f32], frames: Option<&'a Arc<Vec<f32>>>) -> Tokens<'a> {
    Tokens {
        x,
        frames: frames.map(|values| lumi_kernels::Frames::new(values)),
    }
}

/// Runs `f(x, batch, n, out)` on the values of x `[b, n, d]`, for `out` of the same shape; without gradients.
fn on_slices<T>(
    x: Tensor<3>,
    frames: Option<&Frames>,
    f: impl FnOnce(Tokens, usize, usize, &mut [f32]) -> T,
) -> (Tensor<3>, T) {
    let ([b, n, d], device) = (x.dims(), x.device());
    let x = params::to_vec(x);
    let mut out = vec![0.0; x.len()];
    let frames = frames.and_then(Frames::host);
    let result = f(tokens(&x, frames), b, n, &mut out);
    let out = TensorData::new(out, [b, n, d]);
    (Tensor::from_data(out, &device), result)
}

/// A packed block: x `[b, n, d]` → `[b, n, d]`.
pub(crate) fn forward_packed(
    block: &PackedBlock,
    x: Tensor<3>,
    pattern: Pattern,
    frames: Option<&Frames>,
) -> Tensor<3> {
    let run = |x: Tokens, b, n, out: &mut [f32]| block.forward(x, b, n, pattern, out);
    on_slices(x, frames, run).0
}

/// A packed block over a context `[b, k, d]`, and its keys and values.
pub(crate) fn context_packed(
    block: &PackedBlock,
    x: Tensor<3>,
    frames: Option<&Frames>,
) -> (Tensor<3>, KeyValues) {
    let run = |x: Tokens, b, n, out: &mut [f32]| block.forward_context(x, b, n, out);
    on_slices(x, frames, run)
}

/// Keys and values of a context `[b, k, d]` alone.
pub(crate) fn key_values_packed(
    block: &PackedBlock,
    x: Tensor<3>,
    frames: Option<&Frames>,
) -> KeyValues {
    let [b, n, _] = x.dims();
    let frames = frames.and_then(Frames::host);
    block.key_values(tokens(&params::to_vec(x), frames), b, n)
}

/// A packed block over groups of queries `[b, n, d]` that see a context.
pub(crate) fn queries_packed(
    block: &PackedBlock,
    context: &KeyValues,
    x: Tensor<3>,
    group: usize,
    frames: Option<&Frames>,
) -> Tensor<3> {
    on_slices(x, frames, |x, b, n, out| {
        block.forward_queries(context, x, b, n, group, out)
    })
    .0
}

/// One call's sizes and its nine tensors, contiguous: x, then the weights.
#[derive(Clone)]
pub(super) struct Call {
    tensors: [FlexTensor; 9],
    options: Options,
}

/// How a block is to be computed.
#[derive(Clone, Debug)]
pub(crate) struct Options {
    pattern: Pattern,
    precision: Precision,
    save: Save,
    /// `[b, n, 12]`, where tokens have frames.
    frames: Option<Arc<Vec<f32>>>,
}

impl Call {
    pub(super) fn new(tensors: [FlexTensor; 9], options: Options) -> Self {
        Self {
            tensors: tensors.map(|t| t.to_contiguous()),
            options,
        }
    }

    fn slice(&self, i: usize) -> &[f32] {
        self.tensors[i].storage()
    }

    /// Batch, tokens, and the block's sizes.
    fn sizes(&self) -> (usize, usize, BlockShape) {
        let [x, q_norm, fc1] = [0, 3, 7].map(|i| self.tensors[i].shape());
        (
            x[0],
            x[1],
            BlockShape {
                dim: x[2],
                head_dim: q_norm[0],
                hidden: fc1[0],
            },
        )
    }

    fn tokens(&self) -> Tokens<'_> {
        tokens(self.slice(0), self.options.frames.as_ref())
    }

    fn weights(&self) -> BlockWeights<'_> {
        BlockWeights {
            norm1: self.slice(1),
            qkv: self.slice(2),
            q_norm: self.slice(3),
            k_norm: self.slice(4),
            proj: self.slice(5),
            norm2: self.slice(6),
            fc1: self.slice(7),
            fc2: self.slice(8),
        }
    }

    pub(super) fn forward(&self) -> FlexTensor {
        let (batch, n, shape) = self.sizes();
        let mut out = vec![0.0; self.slice(0).len()];
        let weights = self.weights();
        block_forward(
            shape,
            &weights,
            self.options.precision,
            self.tokens(),
            batch,
            n,
            self.options.pattern,
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
            self.options.pattern,
            &mut out,
        );
        (flex(out, self.tensors[0].shape()), saved)
    }

    /// Gradients in the order of the tensors.
    fn backward(&self, saved: &Saved, grad: &FlexTensor, wanted: Wanted) -> [FlexTensor; 9] {
        let grad = grad.to_contiguous();
        let (_, _, shape) = self.sizes();
        let g = block_backward(shape, &self.weights(), saved, grad.storage(), wanted);
        let BlockGrads {
            x,
            norm1,
            qkv,
            q_norm,
            k_norm,
            proj,
            norm2,
            fc1,
            fc2,
        } = g;
        let values = [x, norm1, qkv, q_norm, k_norm, proj, norm2, fc1, fc2];
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

impl Backward<Flex, 9> for BlockOp {
    type State = BlockState;

    fn backward(self, ops: Ops<Self::State, 9>, grads: &mut Gradients, _: &mut Checkpointer) {
        let grad = grads.consume::<Flex>(&ops.node);
        let (call, saved) = &*ops.state.0;
        // Positions of the four matrices among the parents.
        let frozen = [2, 5, 7, 8].iter().all(|i| ops.parents[*i].is_none());
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
