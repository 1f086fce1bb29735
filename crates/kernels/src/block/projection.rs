//! Backward pass through the projection to q‖k‖v, or to an external context's k‖v.

use super::backward::Call;
use super::{BlockGrads, BlockShape, BlockWeights, Tokens};
use crate::attention::Rows;
use crate::buffer::Buf;
use crate::gemm::{Kernel, PANEL, Packed, transposed_product_at};
use crate::norm::{add_assign, layer_norm, layer_norm_backward};
use crate::threads::{Shared, par_tiles};

/// The weights of the projection to q‖k‖v, packed for the way back.
pub(super) struct Projection<K: Kernel> {
    kernel: K,
    shape: BlockShape,
    /// [2d, d]
    qk: Packed<K>,
    /// [d, d], where an operand cannot begin inside `qk`.
    k: Option<Packed<K>>,
    v: Vec<Packed<K>>,
}

impl<K: Kernel> Projection<K> {
    pub fn new(kernel: K, shape: BlockShape, w: &BlockWeights) -> Self {
        let (d, stream) = (shape.dim, shape.stream());
        let v = w.v.chunks_exact(stream * stream);
        Self {
            kernel,
            shape,
            qk: Packed::from_rows(kernel, w.qk, 2 * d, d),
            k: (!d.is_multiple_of(PANEL)).then(|| Packed::from_rows(kernel, &w.qk[d * d..], d, d)),
            v: v.map(|w| Packed::from_rows(kernel, w, stream, stream))
                .collect(),
        }
    }

    /// Through the projection and the first norm: from the gradients of `rows` in the world (which are turned back), to
    /// those of x, which are added to `grad_x`, and of `qk`, `v` and `norm1`: set for tokens that ask, and added for others
    /// after them.
    pub fn backward(
        &self,
        call: Call,
        Tokens { x, frames }: Tokens,
        rows: Rows,
        grad_rows: &mut [f32],
        grad_x: &mut [f32],
        grads: &mut BlockGrads,
    ) {
        let (kernel, shape) = (self.kernel, self.shape);
        let (d, stream, streams) = (shape.dim, shape.stream(), shape.streams);
        let (isa, norm1, width) = (kernel.isa(), call.weights.norm1, rows.width(d));
        let turned = shape.turned_by_frames(call.layout.anchors.is_some());
        // Of q‖k, or k.
        let (first, asks) = (width - d, rows.asks);
        let right = match &self.k {
            _ if asks => self.qk.view,
            Some(k) => k.view,
            None => self.qk.view.part(d, d, 0, d),
        };
        let tokens = x.len() / d;
        let p_first = Packed::rows(kernel, tokens, first);
        let p_dv = Operand::new(kernel, streams, tokens, stream);
        let p_normed = Operand::new(kernel, streams, tokens, stream);
        let tile = kernel.row_tile(tokens);
        let mut gains = Buf::zeroed(tokens.div_ceil(tile) * d);
        let shared = (
            Shared::new(grad_x),
            Shared::new(&mut gains),
            Shared::new(grad_rows),
        );
        par_tiles(tokens, tile, |t, n| {
            let part = t * d..(t + n) * d;
            // SAFETY: tiles are disjoint rows.
            let (dx, gain, dparts) = unsafe {
                (
                    shared.0.slice(part.start, part.len()),
                    shared.1.slice(t / tile * d, d),
                    shared.2.slice(t * width, n * width),
                )
            };
            if let Some(frames) = frames {
                let frames = frames.from(t);
                frames.enter_backward(dparts, asks, d, shape.head_dim, turned);
            }
            let x = &x[part];
            let mut tmp = Buf::new(n * d);
            let mut left = Buf::new(kernel.rows_len(n, first));
            layer_norm(isa, x, norm1, streams, &mut tmp);
            for s in 0..streams {
                p_normed.pack(s, &tmp[s * stream..], d, n, stream, t, 0);
            }
            // SAFETY: every task packs the rows of its own tile; tiles are even, so pairs are not shared. `tmp` holds n x
            // d values.
            unsafe {
                kernel.pack_rows(dparts, width, n, first, p_first.view, t, 0);
                kernel.to_rows(dparts, width, n, first, &mut left);
                let left = kernel.left(&left, n, first);
                kernel.gemm(left, right, tmp.as_mut_ptr(), d, false);
            }
            let mut own = Buf::new(if streams == 1 { 0 } else { n * stream });
            for (s, v) in self.v.iter().enumerate() {
                let dv = &dparts[first..];
                let (dv, ld) = if streams == 1 {
                    (dv, width)
                } else {
                    shape.gather_stream(s, dv, width, &mut own);
                    (&own[..], stream)
                };
                p_dv.pack(s, dv, ld, n, stream, t, 0);
                kernel.to_rows(dv, ld, n, stream, &mut left);
                let left = kernel.left(&left, n, stream);
                // SAFETY: `tmp` holds n x d values.
                unsafe { kernel.gemm(left, v.view, tmp[s * stream..].as_mut_ptr(), d, true) };
            }
            layer_norm_backward(isa, x, norm1, streams, &tmp, dx, gain);
        });
        for gain in gains.chunks_exact(d) {
            add_assign(isa, &mut grads.norm1, gain);
        }
        if !grads.v.is_empty() {
            let skipped = 2 * d - first;
            for (s, normed) in p_normed.streams.iter().enumerate() {
                let qk = &mut grads.qk[skipped * d + s * stream..];
                transposed_product_at(kernel, p_first.view, normed.view, qk, d, !asks);
            }
            p_dv.product_onto(&p_normed, &mut grads.v, !asks);
        }
    }
}

/// An operand of a weight's gradient, [tokens, n] for each stream.
pub(super) struct Operand<K: Kernel> {
    kernel: K,
    streams: Vec<Packed<K>>,
}

impl<K: Kernel> Operand<K> {
    pub fn new(kernel: K, streams: usize, tokens: usize, n: usize) -> Self {
        Self {
            kernel,
            streams: (0..streams)
                .map(|_| Packed::rows(kernel, tokens, n))
                .collect(),
        }
    }

    /// Packs a tile of rows starting at token `t`, columns from `c0`.
    #[allow(clippy::too_many_arguments)]
    pub fn pack(
        &self,
        stream: usize,
        src: &[f32],
        ld: usize,
        rows: usize,
        cols: usize,
        t: usize,
        c0: usize,
    ) {
        let dst = self.streams[stream].view;
        // SAFETY: every task packs the rows of its own tile; tiles are even, so pairs are not shared.
        unsafe { self.kernel.pack_rows(src, ld, rows, cols, dst, t, c0) };
    }

    /// Each stream's part of a weight's gradient, `selfᵀ·right`.
    pub fn product(&self, right: &Self, grad: &mut [f32]) {
        self.product_onto(right, grad, false);
    }

    /// That, added to what is there if `add`.
    fn product_onto(&self, right: &Self, grad: &mut [f32], add: bool) {
        let len = grad.len() / self.streams.len();
        let parts = grad.chunks_exact_mut(len);
        for ((left, right), grad) in self.streams.iter().zip(&right.streams).zip(parts) {
            let n = right.view.n;
            transposed_product_at(self.kernel, left.view, right.view, grad, n, add);
        }
    }
}
