//! Forward pass: three sweeps over the tokens (projection to q‖k‖v, attention, everything after).

use super::{Activations, BlockShape, BlockWeights, CHUNK, Tokens};
use crate::attention::{self, KeyValues, Layout};
use crate::buffer::Buf;
use crate::gelu::gelu;
use crate::gemm::{Element, Kernel, Packed};
use crate::norm::layer_norm;
use crate::threads::{Shared, par_tiles};

/// A block's weights as its kernel wants them.
pub(super) struct Weights<K: Kernel> {
    kernel: K,
    shape: BlockShape,
    norm1: Vec<f32>,
    q_norm: Vec<f32>,
    k_norm: Vec<f32>,
    norm2: Vec<f32>,
    qkv: Packed<K>,
    proj: Packed<K>,
    fc1: Packed<K>,
    fc2: Packed<K>,
}

impl<K: Kernel> Weights<K> {
    /// Packs weights whose lengths the caller has checked.
    pub fn new(kernel: K, shape: BlockShape, w: &BlockWeights) -> Self {
        let (d, m) = (shape.dim, shape.hidden);
        Self {
            kernel,
            shape,
            norm1: w.norm1.to_vec(),
            q_norm: w.q_norm.to_vec(),
            k_norm: w.k_norm.to_vec(),
            norm2: w.norm2.to_vec(),
            qkv: Packed::from_transposed(kernel, w.qkv, d, 3 * d),
            proj: Packed::from_transposed(kernel, w.proj, d, d),
            fc1: Packed::from_transposed(kernel, w.fc1, d, m),
            fc2: Packed::from_transposed(kernel, w.fc2, m, d),
        }
    }
}

/// What a forward pass reads besides its tokens, and what it leaves.
#[derive(Clone, Copy, Default)]
pub(super) struct Pass<'a> {
    /// Keys and values that every token sees besides its pattern's.
    pub context: Option<&'a KeyValues>,
    /// Whether a backward pass follows.
    pub save: bool,
    /// Whether the tokens' own keys and values are wanted.
    pub keep: bool,
}

/// `out = block(x)`; returns what `pass` asks for.
pub(super) fn forward<K: Kernel>(
    w: &Weights<K>,
    layout: &Layout,
    x: Tokens,
    out: &mut [f32],
    pass: Pass,
) -> (Option<Activations>, Option<KeyValues>) {
    let (kernel, d, m) = (w.kernel, w.shape.dim, w.shape.hidden);
    let head_dim = w.shape.head_dim;
    let tokens = layout.batch * layout.n;
    let mut qkv = Buf::new(tokens * 3 * d);
    project(w, x, &mut qkv);

    let mut attended = Buf::new(tokens * d);
    let mut lse = Buf::new(tokens * layout.heads);
    let own = KeyValues::pack(kernel, layout, &qkv, &w.k_norm);
    attention::forward(
        kernel,
        layout,
        &qkv,
        &w.q_norm,
        &w.k_norm,
        pass.context,
        &own,
        &mut attended,
        &mut lse,
    );
    let own = pass.keep.then_some(own);

    let save = pass.save;
    let mut x1 = Buf::new(if save { tokens * d } else { 0 });
    let tile = kernel.row_tile(tokens);
    let kept_hidden = if save {
        kernel.tile_at(tokens, tile, m)
    } else {
        0
    };
    let mut hidden: Buf<K::Elem> = Buf::new(kept_hidden);
    let kept = save.then(|| (Shared::new(&mut x1), Shared::new(&mut hidden)));
    let (out, gathered) = (Shared::new(out), Shared::new(&mut attended));
    par_tiles(tokens, tile, |t, rows| {
        let part = t * d..(t + rows) * d;
        // SAFETY: tiles are disjoint rows.
        let (out, gathered) = unsafe {
            (
                out.slice(part.start, part.len()),
                gathered.slice(part.start, part.len()),
            )
        };
        if let Some(frames) = x.frames {
            frames.from(t).leave(gathered, d, head_dim);
        }
        // SAFETY: as above.
        let kept = kept.map(|(x1, hidden)| unsafe {
            (
                x1.slice(part.start, part.len()),
                hidden.slice(kernel.tile_at(t, tile, m), kernel.rows_len(rows, m)),
            )
        });
        finish(w, rows, &x.x[part], gathered, out, kept);
    });
    let activations = save.then(|| Activations {
        qkv,
        lse,
        attention: attended,
        x1,
        hidden: Element::wrap(hidden),
    });
    (activations, own)
}

/// Keys and values of tokens whose outputs nobody needs.
pub(super) fn key_values<K: Kernel>(w: &Weights<K>, layout: &Layout, x: Tokens) -> KeyValues {
    let mut qkv = Buf::new(3 * x.x.len());
    project(w, x, &mut qkv);
    KeyValues::pack(w.kernel, layout, &qkv, &w.k_norm)
}

/// `qkv = LayerNorm(x) Wqkvᵀ`, in the world.
fn project<K: Kernel>(w: &Weights<K>, Tokens { x, frames }: Tokens, qkv: &mut [f32]) {
    let (kernel, d) = (w.kernel, w.shape.dim);
    let tokens = x.len() / d;
    let qkv = Shared::new(qkv);
    par_tiles(tokens, kernel.row_tile(tokens), |t, rows| {
        let mut normed = Buf::new(rows * d);
        let mut operand = Buf::new(kernel.rows_len(rows, d));
        layer_norm(kernel.isa(), &x[t * d..][..rows * d], &w.norm1, &mut normed);
        kernel.to_rows(&normed, d, rows, d, &mut operand);
        let operand = kernel.left(&operand, rows, d);
        // SAFETY: tiles are disjoint rows.
        unsafe { kernel.gemm(operand, w.qkv.view, qkv.at(t * 3 * d), 3 * d, false) };
        if let Some(frames) = frames {
            // SAFETY: as above.
            let rows = unsafe { qkv.slice(t * 3 * d, rows * 3 * d) };
            frames.from(t).enter(rows, d, w.shape.head_dim);
        }
    });
}

/// Projection of the attention, residuals and MLP of one tile of rows.
fn finish<K: Kernel>(
    w: &Weights<K>,
    rows: usize,
    x: &[f32],
    attended: &[f32],
    out: &mut [f32],
    mut kept: Option<(&mut [f32], &mut [K::Elem])>,
) {
    let (kernel, d, m) = (w.kernel, w.shape.dim, w.shape.hidden);
    let mut operand = Buf::new(kernel.rows_len(rows, d));
    kernel.to_rows(attended, d, rows, d, &mut operand);
    out.copy_from_slice(x);
    // SAFETY: `out` holds rows x d values.
    unsafe {
        kernel.gemm(
            kernel.left(&operand, rows, d),
            w.proj.view,
            out.as_mut_ptr(),
            d,
            true,
        )
    };
    if let Some((x1, _)) = &mut kept {
        x1.copy_from_slice(out);
    }

    let mut normed = Buf::new(rows * d);
    layer_norm(kernel.isa(), out, &w.norm2, &mut normed);
    kernel.to_rows(&normed, d, rows, d, &mut operand);
    let width = m.min(CHUNK);
    let mut hidden = Buf::new(rows * width);
    let mut activated = Buf::new(kernel.rows_len(rows, width));
    for c0 in (0..m).step_by(CHUNK) {
        let cols = CHUNK.min(m - c0);
        let hidden = &mut hidden[..rows * cols];
        let left = kernel.left(&operand, rows, d);
        // SAFETY: `hidden` holds rows x cols values.
        unsafe {
            kernel.gemm(
                left,
                w.fc1.view.cols(c0, cols),
                hidden.as_mut_ptr(),
                cols,
                false,
            )
        };
        if let Some((_, saved)) = &mut kept {
            // One chunk after the other, each dense: backward reads them the same way.
            let saved = &mut saved[kernel.rows_len(rows, c0)..];
            kernel.to_rows(hidden, cols, rows, cols, saved);
        }
        gelu(kernel.isa(), hidden);
        kernel.to_rows(hidden, cols, rows, cols, &mut activated);
        let left = kernel.left(&activated, rows, cols);
        let right = w.fc2.view.part(c0, cols, 0, d);
        // SAFETY: `out` holds rows x d values.
        unsafe { kernel.gemm(left, right, out.as_mut_ptr(), d, true) };
    }
}
