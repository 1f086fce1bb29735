//! Our CPU kernels as a differentiable Burn operation on the Flex device.

use burn::backend::autodiff::checkpoint::base::Checkpointer;
use burn::backend::autodiff::checkpoint::strategy::CheckpointStrategy;
use burn::backend::autodiff::grads::Gradients;
use burn::backend::autodiff::ops::{Backward, Ops, OpsKind};
use burn::backend::tensor::FloatTensor;
use burn::backend::{
    Autodiff, Backend, Dispatch, DispatchDevice, Flex, TensorMetadata, backend_extension,
};
use burn::tensor::{Device, Shape, Tensor};
use lumi_kernels::{
    BlockGrads, BlockShape, BlockWeights, Pattern, Precision, Save, Saved, Wanted, block_backward,
    block_forward, block_forward_saved,
};
use std::sync::Arc;

type FlexTensor = FloatTensor<Flex>;

/// Operations with kernels of ours.
#[backend_extension(Flex, Autodiff)]
#[allow(clippy::too_many_arguments)]
pub(crate) trait KernelOps: Backend {
    /// A whole transformer block; see [`crate::block::Block`] for the shapes.
    fn block(
        x: FloatTensor<Self>,
        norm1: FloatTensor<Self>,
        qkv: FloatTensor<Self>,
        q_norm: FloatTensor<Self>,
        k_norm: FloatTensor<Self>,
        proj: FloatTensor<Self>,
        norm2: FloatTensor<Self>,
        fc1: FloatTensor<Self>,
        fc2: FloatTensor<Self>,
        context: usize,
        group: usize,
        bf16: bool,
    ) -> FloatTensor<Self>;
}

/// Whether tensors on `device` are plain CPU memory that the kernels can work on.
pub(crate) fn has_kernels(device: &Device) -> bool {
    matches!(
        device.clone().inner().as_dispatch(),
        DispatchDevice::Flex(_)
    )
}

/// A whole block: x `[b, n, d]` and the weights in the order of [`KernelOps::block`].
pub(crate) fn block(
    x: Tensor<3>,
    [norm1, q_norm, k_norm, norm2]: [Tensor<1>; 4],
    [qkv, proj, fc1, fc2]: [Tensor<2>; 4],
    pattern: Pattern,
    precision: Precision,
) -> Tensor<3> {
    Tensor::from_dispatch(<Dispatch as KernelOps>::block(
        x.into_dispatch(),
        norm1.into_dispatch(),
        qkv.into_dispatch(),
        q_norm.into_dispatch(),
        k_norm.into_dispatch(),
        proj.into_dispatch(),
        norm2.into_dispatch(),
        fc1.into_dispatch(),
        fc2.into_dispatch(),
        pattern.context,
        pattern.group,
        precision == Precision::Bf16,
    ))
}

/// One call's sizes and its nine tensors, contiguous: x, then the weights.
#[derive(Clone)]
struct Call {
    tensors: [FlexTensor; 9],
    pattern: Pattern,
    precision: Precision,
}

impl Call {
    fn new(tensors: [FlexTensor; 9], context: usize, group: usize, bf16: bool) -> Self {
        Self {
            tensors: tensors.map(|t| t.to_contiguous()),
            pattern: Pattern { context, group },
            precision: if bf16 {
                Precision::Bf16
            } else {
                Precision::F32
            },
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

    fn forward(&self) -> FlexTensor {
        let (batch, n, shape) = self.sizes();
        let mut out = vec![0.0; self.slice(0).len()];
        let weights = self.weights();
        block_forward(
            shape,
            &weights,
            self.precision,
            self.slice(0),
            batch,
            n,
            self.pattern,
            &mut out,
        );
        flex(out, self.tensors[0].shape())
    }

    fn forward_saved(&self) -> (FlexTensor, Saved) {
        let (batch, n, shape) = self.sizes();
        let mut out = vec![0.0; self.slice(0).len()];
        let saved = block_forward_saved(
            shape,
            &self.weights(),
            self.precision,
            Save::Activations,
            self.slice(0),
            batch,
            n,
            self.pattern,
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

fn flex(values: Vec<f32>, shape: Shape) -> FlexTensor {
    FlexTensor::from_data(burn::tensor::TensorData::new(values, shape))
}

impl KernelOps for Flex {
    fn block(
        x: FlexTensor,
        norm1: FlexTensor,
        qkv: FlexTensor,
        q_norm: FlexTensor,
        k_norm: FlexTensor,
        proj: FlexTensor,
        norm2: FlexTensor,
        fc1: FlexTensor,
        fc2: FlexTensor,
        context: usize,
        group: usize,
        bf16: bool,
    ) -> FlexTensor {
        let tensors = [x, norm1, qkv, q_norm, k_norm, proj, norm2, fc1, fc2];
        Call::new(tensors, context, group, bf16).forward()
    }
}

/// What the backward pass needs: the call and its activations.
#[derive(Clone)]
struct BlockState(Arc<(Call, Saved)>);

impl std::fmt::Debug for BlockState {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("BlockState")
    }
}

#[derive(Debug)]
struct BlockOp;

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

impl<C: CheckpointStrategy> KernelOps for Autodiff<Flex, C> {
    fn block(
        x: FloatTensor<Self>,
        norm1: FloatTensor<Self>,
        qkv: FloatTensor<Self>,
        q_norm: FloatTensor<Self>,
        k_norm: FloatTensor<Self>,
        proj: FloatTensor<Self>,
        norm2: FloatTensor<Self>,
        fc1: FloatTensor<Self>,
        fc2: FloatTensor<Self>,
        context: usize,
        group: usize,
        bf16: bool,
    ) -> FloatTensor<Self> {
        let tensors = [x, norm1, qkv, q_norm, k_norm, proj, norm2, fc1, fc2];
        let nodes = tensors.each_ref().map(|t| t.node());
        let call = Call::new(tensors.map(|t| t.into_primitive()), context, group, bf16);
        match BlockOp.prepare::<C>(nodes).compute_bound().stateful() {
            OpsKind::Tracked(prep) => {
                let (out, saved) = call.forward_saved();
                prep.finish(BlockState(Arc::new((call, saved))), out)
            }
            OpsKind::UnTracked(prep) => prep.finish(call.forward()),
        }
    }
}
