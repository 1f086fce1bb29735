//! Gradients of a convolution: of the input, by convolving with the turned weights; of the weights,
//! by products of the output's gradient with the gathered input.

use super::columns::{Columns, Part};
use super::{ConvGrads, ConvShape, ConvWanted, forward};
use crate::buffer::Buf;
use crate::cpu::Compute;
use crate::gemm::{Kernel, with_kernel};
use crate::norm::add_assign;
use crate::simd::sum;
use crate::threads::{Shared, par_tiles};

/// Tasks that the gradient of the weights is cut into, where there are so many tiles.
const TASKS: usize = 32;

/// The gradients that are `wanted`, from `x` and `weights` as [`super::conv2d`] had them and
/// `grad_out`: [batch, output, height, width].
///
/// # Panics
/// If a length does not match, the kernel's side is even or there are no channels.
pub fn conv2d_backward(
    shape: ConvShape,
    compute: impl Into<Compute>,
    x: &[f32],
    weights: &[f32],
    grad_out: &[f32],
    wanted: ConvWanted,
) -> ConvGrads {
    shape.check();
    assert_eq!(x.len(), shape.input_len(), "conv2d: length of x");
    assert_eq!(
        weights.len(),
        shape.weights_len(),
        "conv2d: length of weights"
    );
    assert_eq!(
        grad_out.len(),
        shape.output_len(),
        "conv2d: length of grad_out"
    );
    let asked = |wanted: bool, len: usize| vec![0.0; if wanted { len } else { 0 }];
    let mut grads = ConvGrads {
        x: asked(wanted.x, x.len()),
        weights: asked(wanted.weights, weights.len()),
        bias: asked(wanted.bias, shape.output),
    };
    with_kernel!(compute.into(), kernel => {
        if wanted.x {
            let turned = ConvShape {
                input: shape.output,
                output: shape.input,
                ..shape
            };
            let weights = turn(shape, weights);
            forward(kernel, turned, grad_out, &weights, None, &mut grads.x);
        }
        if wanted.weights {
            weights_gradient(kernel, shape, x, grad_out, &mut grads.weights);
        }
    });
    let planes = || grad_out.chunks_exact(shape.pixels().max(1)).enumerate();
    if wanted.bias {
        for (i, plane) in planes() {
            grads.bias[i % shape.output] += sum([plane; 3], |g, _, _| g);
        }
    }
    grads
}

/// [output, input, k, k] to [input, output, k, k], each kernel turned by half a turn.
fn turn(shape: ConvShape, weights: &[f32]) -> Vec<f32> {
    let taps = shape.taps();
    let mut turned = Vec::with_capacity(weights.len());
    for i in 0..shape.input {
        for o in 0..shape.output {
            let kernel = &weights[(o * shape.input + i) * taps..][..taps];
            turned.extend(kernel.iter().rev());
        }
    }
    turned
}

/// `grads[o, (c, tap)] = Σ over pixels of grad_out[o] · columns[(c, tap)]`.
fn weights_gradient<K: Kernel>(
    kernel: K,
    shape: ConvShape,
    x: &[f32],
    grad_out: &[f32],
    grads: &mut [f32],
) {
    let (pixels, taps) = (shape.pixels(), shape.taps());
    let runs: Vec<_> = shape.runs().collect();
    let tiles = shape.batch * shape.tiles();
    // Parts of the sum over pixels, by the sizes alone, so that threads change no bit.
    let per_part = tiles.div_ceil(TASKS.div_ceil(runs.len())).max(1);
    let parts = tiles.div_ceil(per_part);
    let mut sums = Buf::zeroed(parts * grads.len());
    let shared = Shared::new(&mut sums);
    par_tiles(parts * runs.len(), 1, |task, _| {
        let (part, (c0, count)) = (task / runs.len(), runs[task % runs.len()]);
        let n = count * taps;
        let len = shape.tile().min(pixels);
        let mut columns = Columns::default();
        let mut left = Buf::new(kernel.rows_len(shape.output, len));
        let mut right = Buf::new(kernel.packed_len(len, n));
        for tile in part * per_part..tiles.min((part + 1) * per_part) {
            let (image, start, len) = shape.at(tile);
            let grad = &grad_out[image * shape.output * pixels + start..];
            kernel.to_rows(grad, pixels, shape.output, len, &mut left);
            let from = Part {
                image,
                channels: c0..c0 + count,
                start,
                len,
            };
            let (rows, ld) = columns.gather(shape, x, &from);
            let view = kernel.view_transposed(right.as_mut_ptr(), len, n);
            let sums = shared.at(part * grads.len() + c0 * taps);
            // SAFETY: own operands; these columns of this part's sums belong to this task alone.
            unsafe {
                kernel.pack_transposed(rows, ld, n, view, 0);
                let left = kernel.left(&left, shape.output, len);
                kernel.gemm(left, view, sums, shape.input * taps, true);
            }
        }
    });
    for part in sums.chunks_exact(grads.len()) {
        add_assign(kernel.isa(), grads, part);
    }
}
