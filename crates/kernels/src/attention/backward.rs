//! Attention backward. Probabilities are recomputed tile by tile from the saved log-sum-exp.
//!
//! Every query adds to the gradients of all keys and values it sees, so the queries of a head are
//! cut into a few parts that sum apart, and the sums are added in a fixed order.

use super::*;
use crate::buffer::Buf;
use crate::gemm::Lhs;
use crate::norm::{add_assign, rms_norm_backward};
use crate::softmax::{exp_rows, row_dots, score_gradient};
use crate::threads::{Shared, par_tiles};

/// Keys of a block: two f32 tiles and three operand copies of them share the second-level cache.
const BLOCK: usize = 256;

/// Tasks to have, if the heads alone are fewer.
const TASKS: usize = 32;
/// Query tiles of a part at least: zeroing and adding its sums then costs a few per cent.
const TILES: usize = 8;

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
    let (dh, n) = (layout.head_dim, layout.n);
    let heads = layout.batch * layout.heads;
    let tiles = layout.tiles(K::ROWS);
    // By the sizes alone, so that threads change no bit.
    let parts = TASKS.div_ceil(heads.max(1)).min(tiles.len() / TILES).max(1);
    let operands = Operands::pack(kernel, layout, inputs);

    // Per head and part: gradients of keys and values, and of the two gains.
    let (sum_len, gain_len) = (2 * n * dh, 2 * dh);
    let mut sums = Buf::new(heads * parts * sum_len);
    let mut gains = Buf::zeroed(heads * parts * gain_len);
    let grad = Shared::new(grad_qkv);
    {
        let (sums, gains) = (Shared::new(&mut sums), Shared::new(&mut gains));
        par_tiles(heads * parts, 1, |task, _| {
            let (head, part) = (task / parts, task % parts);
            // SAFETY: each task has its own sums and gains.
            let (sums, gains) = unsafe {
                (
                    sums.slice(task * sum_len, sum_len),
                    gains.slice(task * gain_len, gain_len),
                )
            };
            sums.fill(0.0);
            let spans = operands.spans(kernel, layout, head, sums);
            let cut = |part: usize| part * tiles.len() / parts;
            for (tile, seen) in &tiles[cut(part)..cut(part + 1)] {
                let q_gain = &mut gains[..dh];
                query_tile(
                    kernel, layout, inputs, head, *tile, seen, &spans, grad, q_gain,
                );
            }
        });
        par_tiles(heads, 1, |head, _| {
            let task = head * parts;
            // SAFETY: each head's sums and gains, after all of its parts.
            let (sums, gains) = unsafe {
                (
                    sums.slice(task * sum_len, parts * sum_len),
                    gains.slice(task * gain_len, gain_len),
                )
            };
            let (first, others) = sums.split_at_mut(sum_len);
            for other in others.chunks_exact(sum_len) {
                add_assign(kernel.isa(), first, other);
            }
            key_gradients(kernel, layout, inputs, head, first, grad, &mut gains[dh..]);
        });
    }
    // One fixed order, whoever computed the parts.
    grad_q_norm.fill(0.0);
    grad_k_norm.fill(0.0);
    for gains in gains.chunks_exact(gain_len) {
        add_assign(kernel.isa(), grad_q_norm, &gains[..dh]);
        add_assign(kernel.isa(), grad_k_norm, &gains[dh..]);
    }
}

/// Keys and values of all heads in every form the products need.
struct Operands<K: Kernel> {
    keys_t: Buf<K::Elem>,
    values_t: Buf<K::Elem>,
    keys_r: Buf<K::Elem>,
    /// Elements of a head and starts of its spans: in the first two, and in the third.
    wide: (usize, Vec<usize>),
    tall: (usize, Vec<usize>),
}

/// One span's keys and values, and where their gradients are summed.
struct Keys<K: Kernel> {
    transposed: View<K::Elem>,
    rows: View<K::Elem>,
    values: View<K::Elem>,
    grad_keys: *mut f32,
    grad_values: *mut f32,
}

impl<K: Kernel> Operands<K> {
    fn pack(kernel: K, layout: &Layout, x: &Inputs) -> Self {
        let dh = layout.head_dim;
        let heads = layout.batch * layout.heads;
        let wide = layout.offsets(|n| kernel.packed_len(dh, n));
        let tall = layout.offsets(|n| kernel.packed_len(n, dh));
        let mut all = Self {
            keys_t: Buf::new(heads * wide.0),
            values_t: Buf::new(heads * wide.0),
            keys_r: Buf::new(heads * tall.0),
            wide,
            tall,
        };
        let (wide, tall) = (&all.wide, &all.tall);
        let keys_t = Shared::new(&mut all.keys_t);
        let values_t = Shared::new(&mut all.values_t);
        let keys_r = Shared::new(&mut all.keys_r);
        par_tiles(heads * layout.spans.len(), 1, |task, _| {
            let (head, s) = (task / layout.spans.len(), task % layout.spans.len());
            let at = (head / layout.heads, head % layout.heads);
            let span = layout.spans[s];
            let mut k = Buf::new(span.len * dh);
            normalised(kernel, layout, x.qkv, at, span, 1, x.k_norm, 1.0, &mut k);
            let v = &x.qkv[qkv_at(layout, at.0, span.start, 2, at.1)..];
            let (w, t) = (head * wide.0 + wide.1[s], head * tall.0 + tall.1[s]);
            let rows = kernel.view_rows(keys_r.at(t), span.len, dh);
            let values = kernel.view_transposed(values_t.at(w), dh, span.len);
            // SAFETY: every task packs its own span of its own head.
            unsafe {
                pack_keys(kernel, &k, dh, keys_t.at(w));
                kernel.pack_rows(&k, dh, span.len, dh, rows, 0, 0);
                kernel.pack_transposed(v, 3 * layout.dim(), span.len, values, 0);
            }
        });
        all
    }

    /// The spans of a head; their gradients are parts of `sums`: [2, n, dh].
    fn spans(&self, kernel: K, layout: &Layout, head: usize, sums: &mut [f32]) -> Vec<Keys<K>> {
        let dh = layout.head_dim;
        let (grad_keys, grad_values) = sums.split_at_mut(layout.n * dh);
        let spans = layout.spans.iter().enumerate();
        spans
            .map(|(s, span)| {
                let wide = head * self.wide.0 + self.wide.1[s];
                let tall = head * self.tall.0 + self.tall.1[s];
                let (keys, values) = (&self.keys_t[wide..], &self.values_t[wide..]);
                Keys {
                    transposed: kernel.view_transposed(keys.as_ptr(), dh, span.len),
                    rows: kernel.view_rows(self.keys_r[tall..].as_ptr(), span.len, dh),
                    values: kernel.view_transposed(values.as_ptr(), dh, span.len),
                    grad_keys: grad_keys[span.start * dh..].as_mut_ptr(),
                    grad_values: grad_values[span.start * dh..].as_mut_ptr(),
                }
            })
            .collect()
    }
}

/// From the summed gradients of a head's normalised keys and of its values `sums`: [2, n, dh] to
/// those of `qkv`.
fn key_gradients<K: Kernel>(
    kernel: K,
    layout: &Layout,
    x: &Inputs,
    head: usize,
    sums: &[f32],
    grad: Shared<f32>,
    k_gain: &mut [f32],
) {
    let (dh, n) = (layout.head_dim, layout.n);
    let (b, h) = (head / layout.heads, head % layout.heads);
    let (grad_k, grad_v) = sums.split_at(n * dh);
    let k = &x.qkv[qkv_at(layout, b, 0, 1, h)..];
    let mut dk = Buf::new(n * dh);
    rms_norm_backward(
        kernel.isa(),
        n,
        k,
        3 * layout.dim(),
        x.k_norm,
        1.0,
        grad_k,
        &mut dk,
        dh,
        k_gain,
    );
    for t in 0..n {
        // SAFETY: this head's k and v entries belong to this task alone.
        unsafe {
            grad.slice(qkv_at(layout, b, t, 1, h), dh)
                .copy_from_slice(&dk[t * dh..][..dh]);
            grad.slice(qkv_at(layout, b, t, 2, h), dh)
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
                kernel.gemm(q, keys.transposed.cols(k0, nk), ds.as_mut_ptr(), nk, false);
                exp_rows(isa, ds, nk, lse, &mut sums, p);
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
