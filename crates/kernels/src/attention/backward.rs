//! Attention backward. Probabilities are recomputed tile by tile from the saved log-sum-exp.
//!
//! Every query adds to the gradients of all keys and values it sees, so the queries of a head are
//! cut into a few parts that sum apart, and the sums are added in a fixed order.

use super::anchors::turn_in_place;
use super::layout::Tile;
use super::operands::{Operands, Seen};
use super::*;
use crate::buffer::Buf;
use crate::gemm::Lhs;
use crate::norm::{add_assign, rms_norm_backward};
use crate::softmax::{exp_rows, score_gradient};
use crate::threads::{Shared, par_tiles};

/// Keys of a block: two f32 tiles and three operand copies of them share the second-level cache.
const BLOCK: usize = 256;

/// Tasks to have, if the heads alone are fewer.
const TASKS: usize = 32;
/// Query tiles of a part at least: zeroing and adding its sums then costs a few per cent.
const TILES: usize = 8;

/// What `forward` read and wrote, and about the gradient of its output.
pub(crate) struct Inputs<'a> {
    pub queries: Queries<'a>,
    /// k‖v of the external context.
    pub context: Option<Projected<'a>>,
    pub lse: &'a [f32],
    /// [tokens, d]
    pub grad_out: &'a [f32],
    /// [tokens, heads]: products of `grad_out` with the output.
    pub dots: &'a [f32],
}

/// Gradients to write.
pub(crate) struct Gradients<'a> {
    /// [tokens, 3d]
    pub qkv: &'a mut [f32],
    /// [context tokens, 2d]; empty without an external context.
    pub context: &'a mut [f32],
    /// [dh]
    pub q_norm: &'a mut [f32],
    /// [dh]
    pub k_norm: &'a mut [f32],
}

pub(crate) fn backward<K: Kernel>(kernel: K, layout: &Layout, inputs: &Inputs, grads: Gradients) {
    let (shape, dh) = (layout.shape, layout.shape.head_dim);
    let heads = shape.all_heads();
    let tiles = layout.tiles(K::ROWS);
    // By the sizes alone, so that threads change no bit.
    let parts = TASKS.div_ceil(heads.max(1)).min(tiles.len() / TILES).max(1);
    let (k_norm, anchored) = (inputs.queries.k_norm, layout.anchors.is_some());
    let context_keys = inputs.context.map_or(0, |x| x.rows.n);
    let whole = [Span {
        start: 0,
        len: context_keys,
    }];
    let context = inputs.context.filter(|_| context_keys > 0);
    let context = context.map(|x| Operands::pack(kernel, shape, x, &whole, k_norm, anchored));
    let own = Operands::pack(
        kernel,
        shape,
        inputs.queries.x,
        &layout.spans,
        k_norm,
        anchored,
    );

    // Per head and part: gradients of keys and values, of the context's before those of the tokens'
    // own, and of the two gains.
    let context_len = 2 * context_keys * dh;
    let (sum_len, gain_len) = (context_len + 2 * layout.n * dh, 2 * dh);
    let mut sums = Buf::new(heads * parts * sum_len);
    let mut gains = Buf::zeroed(heads * parts * gain_len);
    let (grad, context_grad) = (Shared::new(grads.qkv), Shared::new(grads.context));
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
            let (context_sums, own_sums) = sums.split_at_mut(context_len);
            let (context_sums, own_sums) = (Shared::new(context_sums), Shared::new(own_sums));
            let cut = |part: usize| part * tiles.len() / parts;
            let tiles = &tiles[cut(part)..cut(part + 1)];
            for tiles in tiles.chunk_by(|a, b| a.group == b.group) {
                let group = tiles[0].group;
                let mut seen = Vec::new();
                if let Some(context) = &context {
                    let table = layout.key_table(head, group, context_keys);
                    seen.push(context.span(kernel, (head, 0), table, context_sums));
                }
                for &s in layout.seen(group) {
                    let table = layout.own_table(head, group, layout.spans[s]);
                    seen.push(own.span(kernel, (head, s), table, own_sums));
                }
                for (i, tile) in tiles.iter().enumerate() {
                    let (first, q_gain) = (i == 0, &mut gains[..dh]);
                    query_tile(
                        kernel, layout, inputs, head, *tile, first, &seen, grad, q_gain,
                    );
                }
                for seen in seen {
                    seen.turn_back(kernel, dh);
                }
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
            let (context_sums, own_sums) = first.split_at(context_len);
            let k_gain = &mut gains[dh..];
            if let Some(context) = &context {
                key_gradients(
                    kernel,
                    context,
                    k_norm,
                    head,
                    context_sums,
                    context_grad,
                    k_gain,
                );
            }
            key_gradients(kernel, &own, k_norm, head, own_sums, grad, k_gain);
        });
    }
    // One fixed order, whoever computed the parts.
    grads.q_norm.fill(0.0);
    grads.k_norm.fill(0.0);
    for gains in gains.chunks_exact(gain_len) {
        add_assign(kernel.isa(), grads.q_norm, &gains[..dh]);
        add_assign(kernel.isa(), grads.k_norm, &gains[dh..]);
    }
}

/// From the summed gradients of a head's normalised keys and of its values `sums`: [2, n, dh] to
/// those of the projection's output; adds to the gain's.
fn key_gradients<K: Kernel>(
    kernel: K,
    operands: &Operands<K>,
    gain: &[f32],
    head: usize,
    sums: &[f32],
    grad: Shared<f32>,
    grad_gain: &mut [f32],
) {
    let (x, shape) = (operands.x, operands.shape);
    let (at, dh, n) = (shape.head(head), shape.head_dim, x.rows.n);
    let (grad_k, grad_v) = sums.split_at(n * dh);
    let mut dk = Buf::new(n * dh);
    if n > 0 {
        let (k, ld) = x.from(shape, at, 0, Part::K);
        let isa = kernel.isa();
        rms_norm_backward(isa, n, k, ld, gain, 1.0, grad_k, &mut dk, dh, grad_gain);
    }
    for t in 0..n {
        // SAFETY: this head's k and v entries belong to this task alone.
        unsafe {
            grad.slice(x.rows.at(shape, at, t, Part::K), dh)
                .copy_from_slice(&dk[t * dh..][..dh]);
            grad.slice(x.rows.at(shape, at, t, Part::V), dh)
                .copy_from_slice(&grad_v[t * dh..][..dh]);
        }
    }
}

/// One tile of queries; `first` of those that share turned keys.
#[allow(clippy::too_many_arguments)]
fn query_tile<K: Kernel>(
    kernel: K,
    layout: &Layout,
    x: &Inputs,
    head: usize,
    Tile { tokens: tile, .. }: Tile,
    first: bool,
    seen: &[Seen<K>],
    grad: Shared<f32>,
    q_gain: &mut [f32],
) {
    let shape = layout.shape;
    let (isa, dh, rows, d) = (kernel.isa(), shape.head_dim, tile.len, shape.dim());
    let (b, h) = shape.head(head);
    let Queries { x: qkv, q_norm, .. } = x.queries;
    let scale = 1.0 / (dh as f32).sqrt();
    let token = (b * layout.n + tile.start) * d + h * dh;
    let dout = &x.grad_out[token..];
    let lse = &x.lse[head * layout.n + tile.start..][..rows];
    let mut dot = Buf::new(rows);
    let dots = x.dots[(b * layout.n + tile.start) * shape.heads + h..].iter();
    for (dot, &all) in dot.iter_mut().zip(dots.step_by(shape.heads)) {
        *dot = all;
    }

    // Queries and output gradients: as rows for the scores, packed for the sums over queries.
    let mut dq = Buf::new(rows * dh);
    qkv.normalised(kernel, shape, (b, h), tile, Part::Q, q_norm, scale, &mut dq);
    let table = layout.query_table(head, tile);
    if let Some(table) = table {
        turn_in_place(isa, &mut dq, dh, table, 1.0);
    }
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

    let longest = seen.iter().map(|keys| keys.values.n.min(BLOCK)).max();
    let longest = longest.unwrap_or(0);
    let mut p = Buf::new(rows * longest);
    let mut ds = Buf::new(rows * longest);
    let mut sums = Buf::zeroed(rows);
    let mut ds_rows = Buf::new(kernel.rows_len(rows, longest));
    let mut packed = Buf::new(kernel.packed_len(rows, longest));
    let mut add_queries = false;
    for keys in seen {
        // The sums of turned keys begin with the first tile.
        let add_keys = !(first && keys.is_turned());
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
                kernel.gemm(Lhs::Packed(packed), q_packed, dk, dh, add_keys);

                kernel.to_rows(ds, nk, rows, nk, &mut ds_rows);
                let ds = kernel.left(&ds_rows, rows, nk);
                kernel.gemm(
                    ds,
                    keys.rows.part(k0, nk, 0, dh),
                    dq.as_mut_ptr(),
                    dh,
                    add_queries,
                );
            }
            add_queries = true;
        }
    }

    if let Some(table) = table {
        turn_in_place(isa, &mut dq, dh, table, -1.0);
    }
    let (q, ld) = qkv.from(shape, (b, h), tile.start, Part::Q);
    let mut dx = Buf::new(rows * dh);
    rms_norm_backward(isa, rows, q, ld, q_norm, scale, &dq, &mut dx, dh, q_gain);
    for r in 0..rows {
        let at = qkv.rows.at(shape, (b, h), tile.start + r, Part::Q);
        // SAFETY: this head's q entries of these tokens belong to this task alone.
        unsafe { grad.slice(at, dh) }.copy_from_slice(&dx[r * dh..][..dh]);
    }
}
