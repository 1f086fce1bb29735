//! Linear and LayerNorm without biases, and how parameters are made.
//!
//! Weights are stored `[out, in]`, as PyTorch and the authors' checkpoints have them.

use burn::module::{Module, Param};
use burn::tensor::{Device, Tensor, TensorData};
use lumi_core::seed::Rng;
use rand::RngExt;

/// `y = x · Wᵀ`.
#[derive(Module, Debug)]
pub struct Linear {
    /// `[out, in]`
    pub weight: Param<Tensor<2>>,
}

/// LayerNorm with a gain and no bias; eps 1e-5, biased variance.
#[derive(Module, Debug)]
pub struct LayerNorm {
    /// `[dim]`
    pub weight: Param<Tensor<1>>,
}

/// Variance floor of every norm in the network.
pub const EPS: f64 = 1e-5;

impl Linear {
    /// Weights drawn from N(0, `std`²).
    pub fn new(output: usize, input: usize, std: f32, rng: &mut Rng, device: &Device) -> Self {
        Self {
            weight: normal([output, input], std, rng, device),
        }
    }

    /// # Shapes
    /// `[b, n, in]` → `[b, n, out]`
    #[must_use]
    pub fn forward(&self, x: Tensor<3>) -> Tensor<3> {
        linear(x, self.weight.val())
    }
}

/// `x · wᵀ`: `[b, n, in]`, `[out, in]` → `[b, n, out]`.
///
/// # Panics
/// If the inner sizes differ.
#[must_use]
pub fn linear(x: Tensor<3>, w: Tensor<2>) -> Tensor<3> {
    let [b, n, input] = x.dims();
    let [output, columns] = w.dims();
    assert_eq!(
        input, columns,
        "linear: width of the input and of the weight"
    );
    x.reshape([b * n, input])
        .matmul(w.transpose())
        .reshape([b, n, output])
}

impl LayerNorm {
    /// Gains of one.
    pub fn new(dim: usize, device: &Device) -> Self {
        Self {
            weight: ones(dim, device),
        }
    }

    /// # Shapes
    /// `[b, n, dim]` → `[b, n, dim]`
    #[must_use]
    pub fn forward(&self, x: Tensor<3>) -> Tensor<3> {
        layer_norm(x, self.weight.val())
    }
}

/// LayerNorm over the last axis with gain `w`: `[b, n, d]` → `[b, n, d]`.
#[must_use]
pub fn layer_norm(x: Tensor<3>, w: Tensor<1>) -> Tensor<3> {
    let centred = x.clone() - x.mean_dim(2);
    let variance = centred.clone().square().mean_dim(2);
    centred / (variance + EPS).sqrt() * w.unsqueeze()
}

/// RMSNorm over the last axis with gain `w`: `[b, h, n, dh]` → same.
#[must_use]
pub fn rms_norm(x: Tensor<4>, w: Tensor<1>) -> Tensor<4> {
    let mean_square = x.clone().square().mean_dim(3);
    x / (mean_square + EPS).sqrt() * w.unsqueeze()
}

/// A parameter of ones.
pub fn ones(dim: usize, device: &Device) -> Param<Tensor<1>> {
    Param::from_data(TensorData::new(vec![1.0_f32; dim], [dim]), device)
}

/// A parameter drawn from N(0, `std`²). Drawn on the CPU from our own stream, so that a seed gives
/// the same weights on every device.
pub fn normal<const D: usize>(
    shape: [usize; D],
    std: f32,
    rng: &mut Rng,
    device: &Device,
) -> Param<Tensor<D>> {
    let n = shape.iter().product();
    if std == 0.0 {
        // Weights that a file is about to replace: not worth drawing.
        return Param::from_data(TensorData::new(vec![0.0_f32; n], shape), device);
    }
    let mut values = Vec::with_capacity(n + 1);
    while values.len() < n {
        // Box–Muller, both halves.
        let u: f32 = 1.0 - rng.random::<f32>();
        let (s, c) = (std::f32::consts::TAU * rng.random::<f32>()).sin_cos();
        let r = std * (-2.0 * u.ln()).sqrt();
        values.extend([r * c, r * s]);
    }
    values.truncate(n);
    Param::from_data(TensorData::new(values, shape), device)
}

/// A parameter drawn from U(−`bound`, `bound`).
pub fn uniform<const D: usize>(
    shape: [usize; D],
    bound: f32,
    rng: &mut Rng,
    device: &Device,
) -> Param<Tensor<D>> {
    let n = shape.iter().product();
    let values = (0..n)
        .map(|_| bound * (2.0 * rng.random::<f32>() - 1.0))
        .collect::<Vec<_>>();
    Param::from_data(TensorData::new(values, shape), device)
}
