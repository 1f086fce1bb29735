//! The convolution kernels as a differentiable Burn operation.

use super::{Flex, FlexTensor, KernelOps, flex};
use burn::backend::autodiff::checkpoint::base::Checkpointer;
use burn::backend::autodiff::grads::Gradients;
use burn::backend::autodiff::ops::{Backward, Ops};
use burn::backend::{Dispatch, TensorMetadata};
use burn::tensor::{Shape, Tensor};
use lumi_kernels::{ConvShape, ConvWanted, Precision, conv2d, conv2d_backward};

/// A convolution that keeps the size: x `[m, in, h, w]`, weights `[out, in, k, k]` with k odd → `[m, out, h, w]`,
/// differentiable.
pub(crate) fn convolve(x: Tensor<4>, weights: Tensor<4>, precision: Precision) -> Tensor<4> {
    Tensor::from_dispatch(<Dispatch as KernelOps>::convolve(
        x.into_dispatch(),
        weights.into_dispatch(),
        precision,
    ))
}

/// One call's input and weights, contiguous; all that its backward pass needs.
#[derive(Clone, Debug)]
pub(super) struct ConvCall {
    tensors: [FlexTensor; 2],
    shape: ConvShape,
    precision: Precision,
}

impl ConvCall {
    pub(super) fn new(tensors: [FlexTensor; 2], precision: Precision) -> Self {
        let [x, weights] = tensors.each_ref().map(|t| t.shape());
        assert_eq!(x[1], weights[1], "convolve: channels of x and of weights");
        assert_eq!(weights[2], weights[3], "convolve: sides of the kernel");
        let shape = ConvShape {
            batch: x[0],
            input: x[1],
            output: weights[0],
            kernel: weights[2],
            height: x[2],
            width: x[3],
        };
        Self {
            tensors: tensors.map(|t| t.to_contiguous()),
            shape,
            precision,
        }
    }

    pub(super) fn forward(&self) -> FlexTensor {
        let [x, weights] = self.tensors.each_ref().map(|t| t.storage::<f32>());
        let s = self.shape;
        let mut out = vec![0.0; s.batch * s.output * s.height * s.width];
        conv2d(s, self.precision, x, weights, None, &mut out);
        flex(out, Shape::from([s.batch, s.output, s.height, s.width]))
    }
}

#[derive(Debug)]
pub(super) struct ConvOp;

impl Backward<Flex, 2> for ConvOp {
    type State = ConvCall;

    fn backward(self, ops: Ops<Self::State, 2>, grads: &mut Gradients, _: &mut Checkpointer) {
        let grad = grads.consume::<Flex>(&ops.node).to_contiguous();
        let ConvCall {
            tensors,
            shape,
            precision,
        } = &ops.state;
        let [x, weights] = tensors.each_ref().map(|t| t.storage::<f32>());
        let wanted = ConvWanted {
            x: ops.parents[0].is_some(),
            weights: ops.parents[1].is_some(),
            bias: false,
        };
        let found = conv2d_backward(*shape, *precision, x, weights, grad.storage(), wanted);
        let both = [found.x, found.weights].into_iter().zip(tensors);
        for (parent, (values, tensor)) in ops.parents.iter().zip(both) {
            if let Some(node) = parent {
                grads.register::<Flex>(node.id, flex(values, tensor.shape()));
            }
        }
    }
}
