//! Backward pass: the forward sweeps in reverse. Each sweep leaves the operands of the weight
//! gradients packed; those gradients are then one product each over all tokens.

use super::{Activations, BlockGrads, BlockShape, BlockWeights, CHUNK, Tokens, Wanted};
use crate::attention::{self, Inputs, Layout};
use crate::buffer::Buf;
use crate::gelu::gelu_backward;
use crate::gemm::{Element, Kernel, Packed, View, transposed_product};
use crate::norm::{add_assign, layer_norm, layer_norm_backward};
use crate::threads::{Shared, par_tiles};

/// Gradients of the block; the caller has checked all lengths.
#[allow(clippy::too_many_arguments)]
pub(super) fn backward<K: Kernel>(
    kernel: K,
    shape: BlockShape,
    w: &BlockWeights,
    layout: &Layout,
    Tokens { x, frames }: Tokens,
    saved: &Activations,
    grad_out: &[f32],
    wanted: Wanted,
) -> BlockGrads {
    let (d, m, dh) = (shape.dim, shape.hidden, shape.head_dim);
    let matrix = |n: usize| match wanted {
        Wanted::All => vec![0.0; n],
        Wanted::NoMatrices => Vec::new(),
    };
    let mut grads = BlockGrads {
        x: vec![0.0; x.len()],
        norm1: vec![0.0; d],
        qkv: matrix(3 * d * d),
        q_norm: vec![0.0; dh],
        k_norm: vec![0.0; dh],
        proj: matrix(d * d),
        norm2: vec![0.0; d],
        fc1: matrix(m * d),
        fc2: matrix(d * m),
    };
    let mut grad_x1 = Buf::new(x.len());
    let mut grad_attention = Buf::new(x.len());
    after_attention(
        kernel,
        shape,
        w,
        saved,
        grad_out,
        &mut grad_x1,
        &mut grad_attention,
        &mut grads,
    );
    let mut gathered = None;
    if let Some(frames) = frames {
        frames.tiled(&mut grad_attention, d, |frames, rows| {
            frames.leave_backward(rows, d, dh);
        });
        let gathered = gathered.insert(Buf::copy_of(&saved.attention));
        frames.tiled(gathered, d, |frames, rows| frames.undo_leave(rows, d, dh));
    }
    let mut grad_qkv = Buf::new(3 * x.len());
    let inputs = Inputs {
        qkv: &saved.qkv,
        q_norm: w.q_norm,
        k_norm: w.k_norm,
        out: gathered.as_ref().unwrap_or(&saved.attention),
        lse: &saved.lse,
        grad_out: &grad_attention,
    };
    attention::backward(
        kernel,
        layout,
        &inputs,
        &mut grad_qkv,
        &mut grads.q_norm,
        &mut grads.k_norm,
    );
    if let Some(frames) = frames {
        frames.tiled(&mut grad_qkv, 3 * d, |frames, rows| {
            frames.enter_backward(rows, d, dh);
        });
    }
    before_attention(kernel, w, x, &grad_qkv, &grad_x1, &mut grads);
    grads
}

/// Through the MLP, the residuals and the projection: fills the gradients of x1 and of the
/// attention's output, and those of `fc2`, `fc1`, `norm2` and `proj`.
#[allow(clippy::too_many_arguments)]
fn after_attention<K: Kernel>(
    kernel: K,
    shape: BlockShape,
    w: &BlockWeights,
    saved: &Activations,
    grad_out: &[f32],
    grad_x1: &mut [f32],
    grad_attention: &mut [f32],
    grads: &mut BlockGrads,
) {
    let (d, m) = (shape.dim, shape.hidden);
    let tokens = grad_out.len() / d;
    let isa = kernel.isa();
    let hidden: &[K::Elem] = Element::unwrap(&saved.hidden);
    let fc1 = Packed::from_rows(kernel, w.fc1, m, d);
    let fc2 = Packed::from_rows(kernel, w.fc2, d, m);
    let proj = Packed::from_rows(kernel, w.proj, d, d);
    // Operands of the weight gradients.
    let operand = |n| Packed::rows(kernel, tokens, n);
    let (p_dy, p_act, p_dh, p_z) = (operand(d), operand(m), operand(m), operand(d));
    let (p_dx1, p_att) = (operand(d), operand(d));

    let tile = kernel.row_tile(tokens);
    let mut gains = Buf::zeroed(tokens.div_ceil(tile) * d);
    let shared = (
        Shared::new(grad_x1),
        Shared::new(grad_attention),
        Shared::new(&mut gains),
    );
    par_tiles(tokens, tile, |t, rows| {
        let part = t * d..(t + rows) * d;
        // SAFETY: tiles are disjoint rows.
        let (dx1, datt, gain) = unsafe {
            (
                shared.0.slice(part.start, part.len()),
                shared.1.slice(part.start, part.len()),
                shared.2.slice(t / tile * d, d),
            )
        };
        let dy = &grad_out[part.clone()];
        let x1 = &saved.x1[part.clone()];
        let width = m.min(CHUNK);
        let mut left = Buf::new(kernel.rows_len(rows, d));
        let mut tmp = Buf::new(rows * d);
        kernel.to_rows(dy, d, rows, d, &mut left);
        pack(kernel, dy, d, rows, d, &p_dy, t, 0);
        layer_norm(isa, x1, w.norm2, &mut tmp);
        pack(kernel, &tmp, d, rows, d, &p_z, t, 0);

        let mut act = Buf::new(rows * width);
        let mut dh = Buf::new(rows * width);
        let mut dh_rows = Buf::new(kernel.rows_len(rows, width));
        for c0 in (0..m).step_by(CHUNK) {
            let cols = CHUNK.min(m - c0);
            let (act, dh) = (&mut act[..rows * cols], &mut dh[..rows * cols]);
            let start = kernel.tile_at(t, tile, m) + kernel.rows_len(rows, c0);
            kernel.widen(&hidden[start..], rows, cols, act);
            let right = fc2.view.cols(c0, cols);
            // SAFETY: `dh` holds rows x cols values.
            unsafe {
                kernel.gemm(
                    kernel.left(&left, rows, d),
                    right,
                    dh.as_mut_ptr(),
                    cols,
                    false,
                )
            };
            gelu_backward(isa, act, dh);
            pack(kernel, act, cols, rows, cols, &p_act, t, c0);
            pack(kernel, dh, cols, rows, cols, &p_dh, t, c0);
            kernel.to_rows(dh, cols, rows, cols, &mut dh_rows);
            let right = fc1.view.part(c0, cols, 0, d);
            let dh = kernel.left(&dh_rows, rows, cols);
            // SAFETY: `tmp` holds rows x d values.
            unsafe { kernel.gemm(dh, right, tmp.as_mut_ptr(), d, c0 > 0) };
        }
        dx1.copy_from_slice(dy);
        layer_norm_backward(isa, x1, w.norm2, &tmp, dx1, gain);
        kernel.to_rows(dx1, d, rows, d, &mut left);
        pack(kernel, dx1, d, rows, d, &p_dx1, t, 0);
        pack(kernel, &saved.attention[part], d, rows, d, &p_att, t, 0);
        let left = kernel.left(&left, rows, d);
        // SAFETY: `datt` holds rows x d values.
        unsafe { kernel.gemm(left, proj.view, datt.as_mut_ptr(), d, false) };
    });
    for gain in gains.chunks_exact(d) {
        add_assign(isa, &mut grads.norm2, gain);
    }
    if !grads.fc2.is_empty() {
        transposed_product(kernel, p_dy.view, p_act.view, &mut grads.fc2);
        transposed_product(kernel, p_dh.view, p_z.view, &mut grads.fc1);
        transposed_product(kernel, p_dx1.view, p_att.view, &mut grads.proj);
    }
}

/// Through the q‖k‖v projection and the first norm: gradients of `qkv`, `norm1` and x.
fn before_attention<K: Kernel>(
    kernel: K,
    w: &BlockWeights,
    x: &[f32],
    grad_qkv: &[f32],
    grad_x1: &[f32],
    grads: &mut BlockGrads,
) {
    let d = w.norm1.len();
    let tokens = x.len() / d;
    let isa = kernel.isa();
    let qkv = Packed::from_rows(kernel, w.qkv, 3 * d, d);
    let p_dqkv = Packed::rows(kernel, tokens, 3 * d);
    let p_normed = Packed::rows(kernel, tokens, d);
    let tile = kernel.row_tile(tokens);
    let mut gains = Buf::zeroed(tokens.div_ceil(tile) * d);
    let shared = (Shared::new(&mut grads.x), Shared::new(&mut gains));
    par_tiles(tokens, tile, |t, rows| {
        let part = t * d..(t + rows) * d;
        // SAFETY: tiles are disjoint rows.
        let (dx, gain) = unsafe {
            (
                shared.0.slice(part.start, part.len()),
                shared.1.slice(t / tile * d, d),
            )
        };
        let x = &x[part.clone()];
        let dqkv = &grad_qkv[3 * part.start..][..3 * part.len()];
        let mut tmp = Buf::new(rows * d);
        let mut left = Buf::new(kernel.rows_len(rows, 3 * d));
        layer_norm(isa, x, w.norm1, &mut tmp);
        pack(kernel, &tmp, d, rows, d, &p_normed, t, 0);
        pack(kernel, dqkv, 3 * d, rows, 3 * d, &p_dqkv, t, 0);
        kernel.to_rows(dqkv, 3 * d, rows, 3 * d, &mut left);
        let left = kernel.left(&left, rows, 3 * d);
        // SAFETY: `tmp` holds rows x d values.
        unsafe { kernel.gemm(left, qkv.view, tmp.as_mut_ptr(), d, false) };
        dx.copy_from_slice(&grad_x1[part]);
        layer_norm_backward(isa, x, w.norm1, &tmp, dx, gain);
    });
    for gain in gains.chunks_exact(d) {
        add_assign(isa, &mut grads.norm1, gain);
    }
    if !grads.qkv.is_empty() {
        transposed_product(kernel, p_dqkv.view, p_normed.view, &mut grads.qkv);
    }
}

/// Packs a tile of rows starting at token `t`, columns from `c0`.
#[allow(clippy::too_many_arguments)]
fn pack<K: Kernel>(
    kernel: K,
    src: &[f32],
    ld: usize,
    rows: usize,
    cols: usize,
    dst: &Packed<K>,
    t: usize,
    c0: usize,
) {
    let dst: View<K::Elem> = dst.view;
    // SAFETY: every task packs the rows of its own tile; tiles are even, so pairs are not shared.
    unsafe { kernel.pack_rows(src, ld, rows, cols, dst, t, c0) };
}
