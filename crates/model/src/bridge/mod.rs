//! Burn operations of our own with hand-written gradients: our CPU kernels on the Flex device, and attention with little
//! memory on any device.

pub(crate) mod attention;
pub(crate) mod block;
pub(crate) mod conv;

use block::{BlockOp, BlockState, Call, Options};
use burn::backend::autodiff::checkpoint::strategy::CheckpointStrategy;
use burn::backend::autodiff::ops::{Backward, OpsKind};
use burn::backend::tensor::FloatTensor;
use burn::backend::{Autodiff, Backend, DispatchDevice, Flex, backend_extension};
use burn::tensor::{Device, Shape, TensorData};
use conv::{ConvCall, ConvOp};
use lumi_kernels::Precision;

type FlexTensor = FloatTensor<Flex>;

/// Operations with kernels of ours.
#[backend_extension(Flex, Autodiff)]
#[allow(clippy::too_many_arguments)]
pub(crate) trait KernelOps: Backend {
    /// A whole transformer block; see [`crate::block::Block`] for the shapes.
    fn block(
        x: FloatTensor<Self>,
        context: FloatTensor<Self>,
        norm1: FloatTensor<Self>,
        qk: FloatTensor<Self>,
        v: FloatTensor<Self>,
        q_norm: FloatTensor<Self>,
        k_norm: FloatTensor<Self>,
        proj: FloatTensor<Self>,
        norm2: FloatTensor<Self>,
        fc1: FloatTensor<Self>,
        fc2: FloatTensor<Self>,
        options: Options,
    ) -> FloatTensor<Self>;

    /// A convolution that keeps the size: x `[m, in, h, w]`, weights `[out, in, k, k]` → `[m, out, h, w]`.
    fn convolve(
        x: FloatTensor<Self>,
        weights: FloatTensor<Self>,
        precision: Precision,
    ) -> FloatTensor<Self>;
}

/// Whether tensors on `device` are plain CPU memory that the kernels can work on.
pub(crate) fn has_kernels(device: &Device) -> bool {
    matches!(
        device.clone().inner().as_dispatch(),
        DispatchDevice::Flex(_)
    )
}

fn flex(values: Vec<f32>, shape: Shape) -> FlexTensor {
    FlexTensor::from_data(TensorData::new(values, shape))
}

impl KernelOps for Flex {
    fn block(
        x: FlexTensor,
        context: FlexTensor,
        norm1: FlexTensor,
        qk: FlexTensor,
        v: FlexTensor,
        q_norm: FlexTensor,
        k_norm: FlexTensor,
        proj: FlexTensor,
        norm2: FlexTensor,
        fc1: FlexTensor,
        fc2: FlexTensor,
        options: Options,
    ) -> FlexTensor {
        let tensors = [
            x, context, norm1, qk, v, q_norm, k_norm, proj, norm2, fc1, fc2,
        ];
        Call::new(tensors, options).forward()
    }

    fn convolve(x: FlexTensor, weights: FlexTensor, precision: Precision) -> FlexTensor {
        ConvCall::new([x, weights], precision).forward()
    }
}

impl<C: CheckpointStrategy> KernelOps for Autodiff<Flex, C> {
    fn block(
        x: FloatTensor<Self>,
        context: FloatTensor<Self>,
        norm1: FloatTensor<Self>,
        qk: FloatTensor<Self>,
        v: FloatTensor<Self>,
        q_norm: FloatTensor<Self>,
        k_norm: FloatTensor<Self>,
        proj: FloatTensor<Self>,
        norm2: FloatTensor<Self>,
        fc1: FloatTensor<Self>,
        fc2: FloatTensor<Self>,
        options: Options,
    ) -> FloatTensor<Self> {
        let tensors = [
            x, context, norm1, qk, v, q_norm, k_norm, proj, norm2, fc1, fc2,
        ];
        let nodes = tensors.each_ref().map(|t| t.node());
        let call = Call::new(tensors.map(|t| t.into_primitive()), options);
        match BlockOp.prepare::<C>(nodes).compute_bound().stateful() {
            OpsKind::Tracked(prep) => {
                let (out, saved) = call.forward_saved();
                prep.finish(BlockState::new(call, saved), out)
            }
            OpsKind::UnTracked(prep) => prep.finish(call.forward()),
        }
    }

    fn convolve(
        x: FloatTensor<Self>,
        weights: FloatTensor<Self>,
        precision: Precision,
    ) -> FloatTensor<Self> {
        let tensors = [x, weights];
        let nodes = tensors.each_ref().map(|t| t.node());
        let call = ConvCall::new(tensors.map(|t| t.into_primitive()), precision);
        let out = call.forward();
        match ConvOp.prepare::<C>(nodes).compute_bound().stateful() {
            OpsKind::Tracked(prep) => prep.finish(call, out),
            OpsKind::UnTracked(prep) => prep.finish(out),
        }
    }
}
