//! Convolutions of image heads on the same matrix products: k × k, stride 1, zero padding that keeps
//! the size.
//!
//! Maps are `[batch, channels, height, width]` (NCHW, as tensor libraries hold them). The output of
//! a tile of pixels is `W[out, in·k²] · X[in·k², pixels]`, where X gathers the shifted input: it
//! exists for one tile and some channels at a time, so memory does not grow by k².

mod backward;
mod columns;

pub use backward::conv2d_backward;

use crate::buffer::Buf;
use crate::cpu::Compute;
use crate::gemm::{Kernel, with_kernel};
use crate::threads::{Shared, par_tiles};
use columns::{Columns, Part};

/// Sizes of a convolution.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ConvShape {
    /// Images.
    pub batch: usize,
    /// Channels of the input.
    pub input: usize,
    /// Channels of the output.
    pub output: usize,
    /// Side of the kernel: odd; the padding is half of it.
    pub kernel: usize,
    /// Rows of both maps.
    pub height: usize,
    /// Columns of both maps.
    pub width: usize,
}

/// Which gradients [`conv2d_backward`] computes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ConvWanted {
    /// Of the input.
    pub x: bool,
    /// Of the weights.
    pub weights: bool,
    /// Of the bias.
    pub bias: bool,
}

/// Gradients of a convolution; those not wanted are empty.
#[derive(Clone, Debug)]
pub struct ConvGrads {
    /// `[batch, input, height, width]`
    pub x: Vec<f32>,
    /// `[output, input, kernel, kernel]`
    pub weights: Vec<f32>,
    /// `[output]`
    pub bias: Vec<f32>,
}

impl ConvShape {
    fn pixels(self) -> usize {
        self.height * self.width
    }

    /// Weights of one output for one input channel.
    fn taps(self) -> usize {
        self.kernel * self.kernel
    }

    fn input_len(self) -> usize {
        self.batch * self.input * self.pixels()
    }

    fn output_len(self) -> usize {
        self.batch * self.output * self.pixels()
    }

    fn weights_len(self) -> usize {
        self.output * self.input * self.taps()
    }

    fn check(self) {
        let k = self.kernel;
        assert!(k % 2 == 1, "conv2d: kernel {k}, expected an odd side");
        assert!(
            self.input > 0 && self.output > 0,
            "conv2d: {} input and {} output channels",
            self.input,
            self.output
        );
    }

    /// The input channels in runs, each of a depth that the products like: (first, count).
    fn runs(self) -> impl Iterator<Item = (usize, usize)> {
        let run = if self.kernel == 1 { 256 } else { 32 };
        let input = self.input;
        (0..input)
            .step_by(run)
            .map(move |c| (c, run.min(input - c)))
    }

    /// Pixels of a tile: few enough that its gathered input stays in the second-level cache, and
    /// that small maps share out among threads.
    fn tile(self) -> usize {
        if self.batch * self.pixels() <= 4096 {
            64
        } else {
            256
        }
    }

    /// Tiles of one image.
    fn tiles(self) -> usize {
        self.pixels().div_ceil(self.tile())
    }

    /// Image and pixels of tile `i` of all images.
    fn at(self, i: usize) -> (usize, usize, usize) {
        let start = i % self.tiles() * self.tile();
        let len = self.tile().min(self.pixels() - start);
        (i / self.tiles(), start, len)
    }
}

/// `out = x * weights (+ bias)`: cross-correlation, as in every deep-learning library.
///
/// `x`: [batch, input, height, width]; `weights`: [output, input, kernel, kernel]; `bias`:
/// [output]; `out`: [batch, output, height, width]. Besides the packed weights it holds one tile's
/// gathered input per thread.
///
/// # Panics
/// If a length does not match, the kernel's side is even or there are no channels.
pub fn conv2d(
    shape: ConvShape,
    compute: impl Into<Compute>,
    x: &[f32],
    weights: &[f32],
    bias: Option<&[f32]>,
    out: &mut [f32],
) {
    shape.check();
    assert_eq!(x.len(), shape.input_len(), "conv2d: length of x");
    assert_eq!(
        weights.len(),
        shape.weights_len(),
        "conv2d: length of weights"
    );
    assert_eq!(out.len(), shape.output_len(), "conv2d: length of out");
    if let Some(bias) = bias {
        assert_eq!(bias.len(), shape.output, "conv2d: length of bias");
    }
    with_kernel!(compute.into(), kernel => forward(kernel, shape, x, weights, bias, out));
}

fn forward<K: Kernel>(
    kernel: K,
    shape: ConvShape,
    x: &[f32],
    weights: &[f32],
    bias: Option<&[f32]>,
    out: &mut [f32],
) {
    let (pixels, taps) = (shape.pixels(), shape.taps());
    // One left operand per run of channels.
    let mut packed = Vec::new();
    for (c0, count) in shape.runs() {
        let k = count * taps;
        let mut left = Buf::new(kernel.rows_len(shape.output, k));
        let ld = shape.input * taps;
        kernel.to_rows(&weights[c0 * taps..], ld, shape.output, k, &mut left);
        packed.push(left);
    }
    let out = Shared::new(out);
    par_tiles(shape.batch * shape.tiles(), 1, |tile, _| {
        let (image, start, len) = shape.at(tile);
        let at = image * shape.output * pixels + start;
        if let Some(bias) = bias {
            for (o, &bias) in bias.iter().enumerate() {
                // SAFETY: these pixels of this image belong to this task alone.
                unsafe { out.slice(at + o * pixels, len) }.fill(bias);
            }
        }
        let mut columns = Columns::default();
        let deepest = shape.runs().map(|(_, n)| n).max().unwrap_or(0) * taps;
        let mut right = Buf::new(kernel.packed_len(deepest, len));
        for ((c0, count), left) in shape.runs().zip(&packed) {
            let k = count * taps;
            let part = Part {
                image,
                channels: c0..c0 + count,
                start,
                len,
            };
            let (rows, ld) = columns.gather(shape, x, &part);
            let view = kernel.view_rows(right.as_mut_ptr(), k, len);
            // SAFETY: own buffers of the right size; these pixels belong to this task alone.
            unsafe {
                kernel.pack_rows(rows, ld, k, len, view, 0, 0);
                let left = kernel.left(left, shape.output, k);
                kernel.gemm(left, view, out.at(at), pixels, bias.is_some() || c0 > 0);
            }
        }
    });
}
