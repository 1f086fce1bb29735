//! Attention backward: one task per head and batch element. Probabilities are recomputed tile by
//! tile from the saved log-sum-exp.

use super::*;
use crate::buffer::Buf;
use crate::gemm::Lhs;
use crate::norm::{add_assign, rms_norm_backward};
use crate::softmax::{exp_rows, row_dots, score_gradient};
use crate::threads::{Shared, par_tiles};

/// Keys of a block: two f32 tiles and three operand copies of them share the second-level cache.
const BLOCK: usize = 256;

/// What `forward` read and wrote, with the gradient of its output.
pub(crate) struct Inputs<'a> {
    pub qkv: &'a [f32],
    pub q_norm: &'a [f32],
    pub k_norm: &'a [f32],
    pub out: &'a [f32],
    pub lse: &'a [f32],
    pub grad_out: &'a [f32],
}

/// Writes the gradient of `qkv` [tokens, 3d] and of the two gains [dh].
pub(crate) fn backward<K: Kernel>(
    kernel: K,
    layout: &Layout,
    inputs: &Inputs,
    grad_qkv: &mut [f32],
    grad_q_norm: &mut [f32],
    grad_k_norm: &mut [f32],
) {
    let dh = layout.head_dim;
    let heads = layout.batch * layout.heads;
    let mut gains = Buf::zeroed(heads * 2 * dh);
    {
        let (grad, gains) = (Shared::new(grad_qkv), Shared::new(&mut gains));
        par_tiles(heads, 1, |head, _| {
            // SAFETY: each head has its own two rows.
            let gains = unsafe { gains.slice(head * 2 * dh, 2 * dh) };
            one_head(kernel, layout, inputs, head, grad, gains);
        });
    }
    // One fixed order, whoever computed the parts.
    grad_q_norm.fill(0.0);
    grad_k_norm.fill(0.0);
    for gains in gains.chunks_exact(2 * dh) {
        add_assign(kernel.isa(), grad_q_norm, &gains[..dh]);
        add_assign(kernel.isa(), grad_k_norm, &gains[dh..]);
    }
}

/// One span's keys and values in every form the products need, and their gradients so far.
struct Keys<K: Kernel> {
    transposed: View<K::Elem>,
    rows: View<K::Elem>,
    values: View<K::Elem>,
    grad_keys: *mut f32,
    grad_values: *mut f32,
}

fn one_head<K: Kernel>(
    kernel: K,
    layout: &Layout,
    x: &Inputs,
    head: usize,
    grad: Shared<f32>,
    gains: &mut [f32],
) {
    let (isa, dh, n) = (kernel.isa(), layout.head_dim, layout.n);
    let at = (head / layout.heads, head % layout.heads);
    let ld3 = 3 * layout.dim();
    let (wide, wide_starts) = layout.offsets(|n| kernel.packed_len(dh, n));
    let (tall, tall_starts) = layout.offsets(|n| kernel.packed_len(n, dh));
    let mut keys_t: Buf<K::Elem> = Buf::new(wide);
    let mut values_t: Buf<K::Elem> = Buf::new(wide);
    let mut keys_r: Buf<K::Elem> = Buf::new(tall);
    let mut grad_k = Buf::zeroed(n * dh);
    let mut grad_v = Buf::zeroed(n * dh);
    let mut scratch = Buf::new(n * dh);

    let mut spans: Vec<Keys<K>> = Vec::with_capacity(layout.spans.len());
    for (s, &span) in layout.spans.iter().enumerate() {
        let (wide, tall) = (wide_starts[s], tall_starts[s]);
        let k = &mut scratch[..span.len * dh];
        normalised(kernel, layout, x.qkv, at, span, 1, x.k_norm, 1.0, k);
        let rows = kernel.view_rows(keys_r[tall..].as_mut_ptr(), span.len, dh);
        let values = kernel.view_transposed(values_t[wide..].as_mut_ptr(), dh, span.len);
        let v = &x.qkv[qkv_at(layout, at.0, span.start, 2, at.1)..];
        // SAFETY: the buffers are this task's own, and large enough for their spans.
        let transposed = unsafe {
            kernel.pack_rows(k, dh, span.len, dh, rows, 0, 0);
            kernel.pack_transposed(v, ld3, span.len, values, 0);
            pack_keys(kernel, k, dh, keys_t[wide..].as_mut_ptr())
        };
        spans.push(Keys {
            transposed,
            rows,
            values,
            grad_keys: grad_k[span.start * dh..].as_mut_ptr(),
            grad_values: grad_v[span.start * dh..].as_mut_ptr(),
        });
    }

    let (q_gain, k_gain) = gains.split_at_mut(dh);
    for (tile, seen) in layout.tiles(K::ROWS) {
        query_tile(kernel, layout, x, head, tile, &seen, &spans, grad, q_gain);
    }

    // `scratch` now takes the gradient of the keys before their norm.
    let k = &x.qkv[qkv_at(layout, at.0, 0, 1, at.1)..];
    rms_norm_backward(
        isa,
        n,
        k,
        ld3,
        x.k_norm,
        1.0,
        &grad_k,
        &mut scratch,
        dh,
        k_gain,
    );
    for t in 0..n {
        // SAFETY: this head's k and v entries belong to this task alone.
        unsafe {
            grad.slice(qkv_at(layout, at.0, t, 1, at.1), dh)
                .copy_from_slice(&scratch[t * dh..][..dh]);
            grad.slice(qkv_at(layout, at.0, t, 2, at.1), dh)
                .copy_from_slice(&grad_v[t * dh..][..dh]);
        }
    }
}

#[allow(clippy::too_many_arguments)]
fn query_tile<K: Kernel>(
    kernel: K,
    layout: &Layout,
    x: &Inputs,
    head: usize,
    tile: Span,
    seen: &[usize],
    spans: &[Keys<K>],
    grad: Shared<f32>,
    q_gain: &mut [f32],
) {
    let (isa, dh, rows, d) = (kernel.isa(), layout.head_dim, tile.len, layout.dim());
    let (b, h) = (head / layout.heads, head % layout.heads);
    let scale = 1.0 / (dh as f32).sqrt();
    let token = (b * layout.n + tile.start) * d + h * dh;
    let (out, dout) = (&x.out[token..], &x.grad_out[token..]);
    let lse = &x.lse[head * layout.n + tile.start..][..rows];
    let mut dot = Buf::zeroed(rows);
    row_dots(isa, out, d, dout, d, dh, &mut dot);

    // Queries and output gradients: as rows for the scores, packed for the sums over queries.
    let mut dq = Buf::new(rows * dh);
    normalised(
        kernel,
        layout,
        x.qkv,
        (b, h),
        tile,
        0,
        x.q_norm,
        scale,
        &mut dq,
    );
    let mut q_rows = Buf::new(kernel.rows_len(rows, dh));
    let mut do_rows = Buf::new(kernel.rows_len(rows, dh));
    let mut q_packed = Buf::new(kernel.packed_len(rows, dh));
    let mut do_packed = Buf::new(kernel.packed_len(rows, dh));
    kernel.to_rows(&dq, dh, rows, dh, &mut q_rows);
    kernel.to_rows(dout, d, rows, dh, &mut do_rows);
    let q_packed = kernel.view_rows(q_packed.as_mut_ptr(), rows, dh);
    let do_packed = kernel.view_rows(do_packed.as_mut_ptr(), rows, dh);
    // SAFETY: own buffers of the right size.
    unsafe {
        kernel.pack_rows(&dq, dh, rows, dh, q_packed, 0, 0);
        kernel.pack_rows(dout, d, rows, dh, do_packed, 0, 0);
    }

    let longest = layout.longest_block(BLOCK);
    let mut p = Buf::new(rows * longest);
    let mut ds = Buf::new(rows * longest);
    let mut sums = Buf::zeroed(rows);
    let mut ds_rows = Buf::new(kernel.rows_len(rows, longest));
    let mut packed = Buf::new(kernel.packed_len(rows, longest));
    let mut first = true;
    for &s in seen {
        let keys = &spans[s];
        for block in blocks(keys.values.n, BLOCK) {
            let (k0, nk) = (block.start, block.len);
            let (p, ds) = (&mut p[..rows * nk], &mut ds[..rows * nk]);
            let packed = kernel.view_rows(packed.as_mut_ptr(), rows, nk);
            // SAFETY: all buffers are this task's own and hold rows x nk, rows x dh or the
            // span's keys x dh values.
            unsafe {
                let q = kernel.left(&q_rows, rows, dh);
                kernel.gemm(q, keys.transposed.cols(k0, nk), p.as_mut_ptr(), nk, false);
                exp_rows(isa, p, nk, lse, &mut sums);
                kernel.pack_rows(p, nk, rows, nk, packed, 0, 0);
                let dv = keys.grad_values.add(k0 * dh);
                kernel.gemm(Lhs::Packed(packed), do_packed, dv, dh, true);

                let dout = kernel.left(&do_rows, rows, dh);
                kernel.gemm(dout, keys.values.cols(k0, nk), ds.as_mut_ptr(), nk, false);
                score_gradient(isa, p, ds, nk, &dot);
                kernel.pack_rows(ds, nk, rows, nk, packed, 0, 0);
                let dk = keys.grad_keys.add(k0 * dh);
                kernel.gemm(Lhs::Packed(packed), q_packed, dk, dh, true);

                kernel.to_rows(ds, nk, rows, nk, &mut ds_rows);
                let ds = kernel.left(&ds_rows, rows, nk);
                kernel.gemm(
                    ds,
                    keys.rows.part(k0, nk, 0, dh),
                    dq.as_mut_ptr(),
                    dh,
                    !first,
                );
            }
            first = false;
        }
    }

    let at = qkv_at(layout, b, tile.start, 0, h);
    let ld3 = 3 * d;
    let mut dx = Buf::new(rows * dh);
    rms_norm_backward(
        isa,
        rows,
        &x.qkv[at..],
        ld3,
        x.q_norm,
        scale,
        &dq,
        &mut dx,
        dh,
        q_gain,
    );
    for r in 0..rows {
        // SAFETY: this head's q entries of these tokens belong to this task alone.
        unsafe { grad.slice(at + r * ld3, dh) }.copy_from_slice(&dx[r * dh..][..dh]);
    }
}
