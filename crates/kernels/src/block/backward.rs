//! Backward pass: the forward sweeps in reverse. Each sweep leaves the operands of the weight
//! gradients packed; those gradients are then one product each over all tokens.

use super::forward::hidden_at;
use super::projection::{Operand, Projection};
use super::{Activations, BlockGrads, BlockShape, BlockWeights, CHUNK, Tokens, Wanted};
use crate::attention::{self, Gradients, Inputs, Layout, Projected, Queries, Rows};
use crate::buffer::Buf;
use crate::gelu::gelu_backward;
use crate::gemm::{Element, Kernel, Packed};
use crate::norm::{add_assign, layer_norm, layer_norm_backward};
use crate::softmax::row_dots;
use crate::threads::{Shared, par_tiles};

/// What the forward pass was called with; the lengths are checked.
#[derive(Clone, Copy)]
pub(super) struct Call<'a> {
    pub shape: BlockShape,
    pub weights: &'a BlockWeights<'a>,
    pub layout: &'a Layout<'a>,
    pub x: Tokens<'a>,
    /// With its number of tokens in each batch element.
    pub context: Option<(Tokens<'a>, usize)>,
}

/// Gradients of the block.
pub(super) fn backward<K: Kernel>(
    kernel: K,
    call: Call,
    saved: &Activations,
    grad_out: &[f32],
    wanted: Wanted,
) -> BlockGrads {
    let Call {
        shape,
        weights: w,
        layout,
        x,
        context,
    } = call;
    let matrix = |w: &[f32]| match wanted {
        Wanted::All => vec![0.0; w.len()],
        Wanted::NoMatrices => Vec::new(),
    };
    let mut grads = BlockGrads {
        x: vec![0.0; x.x.len()],
        context: vec![0.0; context.map_or(0, |(context, _)| context.x.len())],
        norm1: vec![0.0; w.norm1.len()],
        qk: matrix(w.qk),
        v: matrix(w.v),
        q_norm: vec![0.0; w.q_norm.len()],
        k_norm: vec![0.0; w.k_norm.len()],
        proj: matrix(w.proj),
        norm2: vec![0.0; w.norm2.len()],
        fc1: matrix(w.fc1),
        fc2: matrix(w.fc2),
    };
    let mut attention = Attended {
        grad: Buf::new(x.x.len()),
        dots: Buf::new(x.x.len() / shape.head_dim),
    };
    after_attention(kernel, call, saved, grad_out, &mut attention, &mut grads);

    let mut grad_qkv = Buf::new(3 * x.x.len());
    let mut grad_kv = Buf::new(2 * grads.context.len());
    let rows = |n, asks| Rows { n, asks };
    let (own, m) = (rows(layout.n, true), context.map_or(0, |(_, m)| m));
    let inputs = Inputs {
        queries: Queries {
            x: Projected {
                values: &saved.qkv,
                rows: own,
            },
            q_norm: w.q_norm,
            k_norm: w.k_norm,
        },
        context: saved.context.as_deref().map(|values| Projected {
            values,
            rows: rows(m, false),
        }),
        lse: &saved.lse,
        grad_out: &attention.grad,
        dots: &attention.dots,
    };
    let into = Gradients {
        qkv: &mut grad_qkv,
        context: &mut grad_kv,
        q_norm: &mut grads.q_norm,
        k_norm: &mut grads.k_norm,
    };
    attention::backward(kernel, layout, &inputs, into);
    drop(attention);

    let weights = Projection::new(kernel, shape, w);
    let mut of_x = std::mem::take(&mut grads.x);
    weights.backward(call, x, own, &mut grad_qkv, &mut of_x, &mut grads);
    grads.x = of_x;
    if let Some((context, m)) = context {
        let mut of_context = std::mem::take(&mut grads.context);
        let rows = rows(m, false);
        weights.backward(
            call,
            context,
            rows,
            &mut grad_kv,
            &mut of_context,
            &mut grads,
        );
        grads.context = of_context;
    }
    grads
}

/// Gradients of what the softmax gathered.
struct Attended {
    /// [tokens, d], in the world, where tokens have frames.
    grad: Buf<f32>,
    /// [tokens, heads]: products with what was gathered, in whichever space.
    dots: Buf<f32>,
}

/// Through the MLP, the residuals and the projection: fills the gradients of x1 (in those of x) and of the
/// attention's output, and those of `fc2`, `fc1`, `norm2` and `proj`.
fn after_attention<K: Kernel>(
    kernel: K,
    call: Call,
    saved: &Activations,
    grad_out: &[f32],
    attended: &mut Attended,
    grads: &mut BlockGrads,
) {
    let Call {
        shape, weights: w, ..
    } = call;
    let (d, dh, streams) = (shape.dim, shape.head_dim, shape.streams);
    let (stream, m) = (shape.stream(), shape.stream_hidden());
    let tokens = grad_out.len() / d;
    let isa = kernel.isa();
    let hidden: &[K::Elem] = Element::unwrap(&saved.hidden);
    let of_streams = |w: &[f32], k: usize, n: usize| -> Vec<_> {
        let parts = w.chunks_exact(k * n);
        parts.map(|w| Packed::from_rows(kernel, w, k, n)).collect()
    };
    let fc1 = of_streams(w.fc1, m, stream);
    let fc2 = of_streams(w.fc2, stream, m);
    let proj = of_streams(w.proj, stream, stream);
    // Operands of the weight gradients.
    let operand = |n| Operand::new(kernel, streams, tokens, n);
    let (p_dy, p_act, p_dh, p_z) = (operand(stream), operand(m), operand(m), operand(stream));
    let (p_dx1, p_att) = (operand(stream), operand(stream));

    let tile = kernel.row_tile(tokens);
    let mut gains = Buf::zeroed(tokens.div_ceil(tile) * d);
    let shared = (
        Shared::new(&mut grads.x),
        Shared::new(&mut attended.grad),
        Shared::new(&mut attended.dots),
        Shared::new(&mut gains),
    );
    par_tiles(tokens, tile, |t, rows| {
        let part = t * d..(t + rows) * d;
        let heads = shape.heads();
        // SAFETY: tiles are disjoint rows.
        let (dx1, datt, dots, gain) = unsafe {
            (
                shared.0.slice(part.start, part.len()),
                shared.1.slice(part.start, part.len()),
                shared.2.slice(t * heads, rows * heads),
                shared.3.slice(t / tile * d, d),
            )
        };
        let dy = &grad_out[part.clone()];
        let x1 = &saved.x1[part.clone()];
        let attention = &saved.attention[part];
        let width = m.min(CHUNK);
        let mut left = Buf::new(kernel.rows_len(rows, stream));
        let mut tmp = Buf::new(rows * d);
        let mut act = Buf::new(rows * width);
        let mut dh_chunk = Buf::new(rows * width);
        let mut dh_rows = Buf::new(kernel.rows_len(rows, width));
        layer_norm(isa, x1, w.norm2, streams, &mut tmp);
        for s in 0..streams {
            let dy = &dy[s * stream..];
            kernel.to_rows(dy, d, rows, stream, &mut left);
            p_dy.pack(s, dy, d, rows, stream, t, 0);
            p_z.pack(s, &tmp[s * stream..], d, rows, stream, t, 0);
            let hidden =
                &hidden[hidden_at(kernel, shape, t, tile) + s * kernel.rows_len(rows, m)..];
            for c0 in (0..m).step_by(CHUNK) {
                let cols = CHUNK.min(m - c0);
                let (act, dh) = (&mut act[..rows * cols], &mut dh_chunk[..rows * cols]);
                kernel.widen(&hidden[kernel.rows_len(rows, c0)..], rows, cols, act);
                let right = fc2[s].view.cols(c0, cols);
                let dy = kernel.left(&left, rows, stream);
                // SAFETY: `dh` holds rows x cols values.
                unsafe { kernel.gemm(dy, right, dh.as_mut_ptr(), cols, false) };
                gelu_backward(isa, act, dh);
                p_act.pack(s, act, cols, rows, cols, t, c0);
                p_dh.pack(s, dh, cols, rows, cols, t, c0);
                kernel.to_rows(dh, cols, rows, cols, &mut dh_rows);
                let right = fc1[s].view.part(c0, cols, 0, stream);
                let dh = kernel.left(&dh_rows, rows, cols);
                let into = tmp[s * stream..].as_mut_ptr();
                // SAFETY: `tmp` holds rows x d values.
                unsafe { kernel.gemm(dh, right, into, d, c0 > 0) };
            }
        }
        dx1.copy_from_slice(dy);
        layer_norm_backward(isa, x1, w.norm2, streams, &tmp, dx1, gain);
        let own = &mut tmp[..rows * stream];
        for s in 0..streams {
            let dx1 = &dx1[s * stream..];
            kernel.to_rows(dx1, d, rows, stream, &mut left);
            p_dx1.pack(s, dx1, d, rows, stream, t, 0);
            let left = kernel.left(&left, rows, stream);
            if streams == 1 {
                p_att.pack(s, attention, d, rows, d, t, 0);
                // SAFETY: `datt` holds rows x d values.
                unsafe { kernel.gemm(left, proj[s].view, datt.as_mut_ptr(), d, false) };
            } else {
                shape.gather_stream(s, attention, d, own);
                p_att.pack(s, own, stream, rows, stream, t, 0);
                // SAFETY: `own` holds rows x stream values.
                unsafe { kernel.gemm(left, proj[s].view, own.as_mut_ptr(), stream, false) };
                shape.scatter_stream(s, own, datt, d);
            }
        }
        // A frame's turn of one is undone by that of the other, so these need none.
        row_dots(isa, attention, dh, datt, dh, dh, dots);
        if let Some(frames) = call.x.frames {
            frames.from(t).leave_backward(datt, d, dh);
        }
    });
    for gain in gains.chunks_exact(d) {
        add_assign(isa, &mut grads.norm2, gain);
    }
    if !grads.fc2.is_empty() {
        p_dy.product(&p_act, &mut grads.fc2);
        p_dh.product(&p_z, &mut grads.fc1);
        p_dx1.product(&p_att, &mut grads.proj);
    }
}
