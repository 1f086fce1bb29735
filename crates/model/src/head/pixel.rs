//! What finishes each pixel by itself: tokens see a patch as a whole, and their few numbers cannot say of each of its pixels which
//! photograph shows it best and where the silhouette runs.

use super::convolve;
use crate::ModelConfig;
use crate::layers::Linear;
use burn::module::{Module, Param};
use burn::tensor::activation::relu;
use burn::tensor::{Device, Tensor};
use lumi_core::reprojection::{NEAREST, OF_NEAREST};
use lumi_core::seed::Rng;
use lumi_kernels::Precision;

/// Numbers per pixel that tokens tell it, besides those that it corrects.
pub const FEATURES: usize = 16;

/// Most convolutions of [`PixelMlp::context`].
pub const CONTEXT: usize = 2;

/// Three linear layers with ReLU between, the same for every pixel; and, where the config has `pixel_context`, convolutions
/// through which a pixel sees its neighbours.
#[derive(Module, Debug)]
pub struct PixelMlp {
    /// `[width, inputs]`, inputs = the head's numbers, how direct light falls, what photographs show, and 1
    pub first: Linear,
    /// `[width, width]`
    pub second: Linear,
    /// `[corrections + NEAREST, width]`
    pub last: Linear,
    /// `[width, width, 3, 3]` each: the first adds to the second layer's sum, the other to what comes of it. In larger pictures
    /// than the network has learnt on, neighbours are as far apart as they were there.
    pub context: Vec<Param<Tensor<4>>>,
}

impl PixelMlp {
    /// For a config with `pixel_mlp`. The last layer and the convolutions begin at zero: nothing is corrected, and no neighbour
    /// counts, until they learn.
    #[must_use]
    pub fn new(config: &ModelConfig, rng: &mut Rng, device: &Device) -> Self {
        let width = config.pixel_mlp;
        let [_, direct, carried] = config.target_parts();
        let inputs = config.head_channels() + direct + carried + 1;
        let outputs = config.head_channels() - FEATURES + NEAREST;
        let mut layer = |output: usize, input: usize, gain: f32| {
            let std = gain * (2.0 / input as f32).sqrt();
            Linear::new(output, input, std, rng, device)
        };
        Self {
            first: layer(width, inputs, 1.0),
            second: layer(width, width, 1.0),
            last: layer(outputs, width, 0.0),
            context: blank_context(config, device),
        }
    }

    /// Corrected numbers, and what the photographs show with the surface's colour corrected toward the nearest photographs', in
    /// pictures `finer` times as large each way as those that the network has learnt on.
    ///
    /// # Shapes
    /// numbers `[m, n + FEATURES, h, w]`, given (direct light, then what photographs show, as of the config) `[m, c, h, w]` →
    /// `[m, n, h, w]` and `[m, 4, h, w]`
    #[must_use]
    pub fn forward(
        &self,
        numbers: Tensor<4>,
        given: Tensor<4>,
        finer: usize,
        precision: Precision,
        config: &ModelConfig,
    ) -> (Tensor<4>, Tensor<4>) {
        let (told, known) = (numbers.dims()[1], given.dims()[1]);
        let n = told - FEATURES;
        let ([_, direct, _], surface) = (config.target_parts(), config.surface_channels());
        let carried = given
            .clone()
            .narrow(1, direct, surface + NEAREST * OF_NEAREST);
        let layer = |weight: Tensor<2>, x: Tensor<4>| -> Tensor<4> {
            let [m, inputs, h, w] = x.dims();
            let outputs = weight.dims()[0];
            let y = weight.unsqueeze().matmul(x.reshape([m, inputs, h * w]));
            y.reshape([m, outputs, h, w])
        };
        let [first, second, last] =
            [&self.first, &self.second, &self.last].map(|linear| linear.weight.val());
        // Part by part: nothing is copied to stand together, and what is given needs no gradient.
        let of = |at: usize, inputs: usize| first.clone().narrow(1, at, inputs);
        let constant = of(told + known, 1).reshape([1, config.pixel_mlp, 1, 1]);
        let x = layer(of(0, told), numbers.clone()) + layer(of(told, known), given) + constant;
        let with_neighbours = |i: usize, sum: Tensor<4>, x: Tensor<4>| match self.context.get(i) {
            Some(kernel) => sum + apart(x, finer, |x| convolve(x, kernel, precision)),
            None => sum,
        };
        let x = relu(x);
        let x = relu(with_neighbours(0, layer(second, x.clone()), x));
        let x = relu(with_neighbours(1, x.clone(), x));
        let change = layer(last, x);
        let mut colour = carried.clone().narrow(1, 0, 3);
        for k in 0..NEAREST {
            let difference = carried.clone().narrow(1, surface + k * OF_NEAREST, 3);
            colour = colour + difference * change.clone().narrow(1, n + k, 1);
        }
        let coverage = carried.narrow(1, 3, 1);
        (
            numbers.narrow(1, 0, n) + change.narrow(1, 0, n),
            Tensor::cat(vec![colour, coverage], 1),
        )
    }
}

/// As many convolutions as the config asks for, through which no neighbour counts yet.
pub(crate) fn blank_context(config: &ModelConfig, device: &Device) -> Vec<Param<Tensor<4>>> {
    let width = config.pixel_mlp;
    let blank = || Param::from_tensor(Tensor::zeros([width, width, 3, 3], device));
    (0..config.pixel_context).map(|_| blank()).collect()
}

/// What `change` makes of the pictures that every `step`-th pixel each way makes up, put together again.
///
/// # Shapes
/// `[m, c, h, w]` → `[m, c, h, w]`, h and w multiples of `step`; `change` takes and gives `[m·step², c, h/step, w/step]`
fn apart(x: Tensor<4>, step: usize, change: impl FnOnce(Tensor<4>) -> Tensor<4>) -> Tensor<4> {
    if step == 1 {
        return change(x);
    }
    let [m, c, h, w] = x.dims();
    let (rows, columns) = (h / step, w / step);
    let parts = x.reshape([m, c, rows, step, columns, step]);
    let parts = parts.permute([0, 3, 5, 1, 2, 4]);
    let changed = change(parts.reshape([m * step * step, c, rows, columns]));
    let parts = changed.reshape([m, step, step, c, rows, columns]);
    parts.permute([0, 3, 4, 1, 5, 2]).reshape([m, c, h, w])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_nth_pixel_makes_a_picture_and_they_come_together_again() {
        let device = Device::flex();
        let data = (0..2 * 3 * 4 * 6).map(|i| i as f32).collect::<Vec<_>>();
        let x = Tensor::<4>::from_data(burn::tensor::TensorData::new(data, [2, 3, 4, 6]), &device);
        let again = apart(x.clone(), 2, |parts| {
            assert_eq!(parts.dims(), [8, 3, 2, 3]);
            let first: Vec<f32> =
                crate::params::to_vec(parts.clone().narrow(0, 1, 1).narrow(1, 0, 1));
            // Of the first row, every second pixel from the second on.
            assert_eq!(first, [1.0, 3.0, 5.0, 13.0, 15.0, 17.0]);
            parts
        });
        let [again, x] = [again, x].map(crate::params::to_vec);
        assert_eq!(again, x);
    }
}
