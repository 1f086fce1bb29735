//! Forward pass: three sweeps over the tokens (projection to q‖k‖v, attention, everything after), and before these one
//! over an external context (projection to k‖v).

use super::{Activations, BlockShape, BlockWeights, CHUNK, Tokens};
use crate::attention::{self, KeyValues, Keys, Layout, Projected, Queries, Rows, Span};
use crate::buffer::Buf;
use crate::gelu::gelu;
use crate::gemm::{Element, Kernel, PANEL, Packed, View};
use crate::norm::layer_norm;
use crate::threads::{Shared, par_tiles};

/// A block's weights as its kernel wants them; one matrix for each stream where streams have their own.
pub(super) struct Weights<K: Kernel> {
    kernel: K,
    shape: BlockShape,
    norm1: Vec<f32>,
    q_norm: Vec<f32>,
    k_norm: Vec<f32>,
    norm2: Vec<f32>,
    qk: Packed<K>,
    /// Where k's columns of `qk` do not begin a panel.
    k: Option<Packed<K>>,
    v: Vec<Packed<K>>,
    proj: Vec<Packed<K>>,
    fc1: Vec<Packed<K>>,
    fc2: Vec<Packed<K>>,
}

impl<K: Kernel> Weights<K> {
    /// Packs weights whose lengths the caller has checked.
    pub fn new(kernel: K, shape: BlockShape, w: &BlockWeights) -> Self {
        let d = shape.dim;
        let (stream, hidden) = (shape.stream(), shape.stream_hidden());
        let of_streams = |w: &[f32], k: usize, n: usize| {
            let parts = w.chunks_exact(k * n);
            parts
                .map(|w| Packed::from_transposed(kernel, w, k, n))
                .collect()
        };
        Self {
            kernel,
            shape,
            norm1: w.norm1.to_vec(),
            q_norm: w.q_norm.to_vec(),
            k_norm: w.k_norm.to_vec(),
            norm2: w.norm2.to_vec(),
            qk: Packed::from_transposed(kernel, w.qk, d, 2 * d),
            k: (!d.is_multiple_of(PANEL))
                .then(|| Packed::from_transposed(kernel, &w.qk[d * d..], d, d)),
            v: of_streams(w.v, stream, stream),
            proj: of_streams(w.proj, stream, stream),
            fc1: of_streams(w.fc1, stream, hidden),
            fc2: of_streams(w.fc2, hidden, stream),
        }
    }

    /// [dim, dim]
    fn keys(&self) -> View<K::Elem> {
        let d = self.shape.dim;
        match &self.k {
            Some(k) => k.view,
            None => self.qk.view.cols(d, d),
        }
    }
}

/// What a forward pass reads besides its tokens, and what it leaves.
#[derive(Clone, Copy, Default)]
pub(super) struct Pass<'a> {
    /// Tokens of an external context, and their number in each batch element.
    pub context: Option<(Tokens<'a>, usize)>,
    /// Keys and values of one that were kept.
    pub kept: Option<&'a KeyValues>,
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
    let (kernel, shape, d) = (w.kernel, w.shape, w.shape.dim);
    let tokens = layout.shape.batch * layout.n;
    let anchored = layout.anchors.is_some();
    let external = pass.context.map(|(context, m)| {
        let rows = Rows { n: m, asks: false };
        let (kv, keys) = key_values(w, layout.shape.batch, context, m, anchored);
        (kv, rows, keys)
    });
    let rows = Rows {
        n: layout.n,
        asks: true,
    };
    let mut qkv = Buf::new(tokens * 3 * d);
    project(w, x, rows, anchored, &mut qkv);

    let mut attended = Buf::new(tokens * d);
    let mut lse = Buf::new(tokens * shape.heads());
    let projected = Projected { values: &qkv, rows };
    let own = KeyValues::pack(
        kernel,
        layout.shape,
        &layout.spans,
        projected,
        &w.k_norm,
        anchored,
    );
    let queries = Queries {
        x: projected,
        q_norm: &w.q_norm,
        k_norm: &w.k_norm,
    };
    let keys = Keys {
        context: pass.kept.or(external.as_ref().map(|(_, _, keys)| keys)),
        own: &own,
    };
    attention::forward(kernel, layout, queries, keys, &mut attended, &mut lse);
    let own = pass.keep.then_some(own);

    let save = pass.save;
    let mut x1 = Buf::new(if save { tokens * d } else { 0 });
    let tile = kernel.row_tile(tokens);
    let mut hidden: Buf<K::Elem> = Buf::new(if save {
        hidden_at(kernel, shape, tokens, tile)
    } else {
        0
    });
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
            frames.from(t).leave(gathered, d, shape.head_dim);
        }
        // SAFETY: as above.
        let kept = kept.map(|(x1, hidden)| unsafe {
            let len = hidden_at(kernel, shape, rows, tile);
            (
                x1.slice(part.start, part.len()),
                hidden.slice(hidden_at(kernel, shape, t, tile), len),
            )
        });
        finish(w, rows, &x.x[part], gathered, out, kept);
    });
    let activations = save.then(|| Activations {
        qkv,
        context: external.map(|(kv, _, _)| kv),
        lse,
        attention: attended,
        x1,
        hidden: Element::wrap(hidden),
    });
    (activations, own)
}

/// Where the hidden layers of rows `t..` start when tiles of `tile` rows follow each other, each stream after stream.
pub(super) fn hidden_at<K: Kernel>(kernel: K, shape: BlockShape, t: usize, tile: usize) -> usize {
    shape.streams * kernel.tile_at(t, tile, shape.stream_hidden())
}

/// k‖v of tokens whose outputs nobody needs, [batch, n, 2d], and packed; `anchored` says whether the keys are to be
/// turned.
pub(super) fn key_values<K: Kernel>(
    w: &Weights<K>,
    batch: usize,
    x: Tokens,
    n: usize,
    anchored: bool,
) -> (Buf<f32>, KeyValues) {
    let rows = Rows { n, asks: false };
    let mut kv = Buf::new(2 * x.x.len());
    project(w, x, rows, anchored, &mut kv);
    let whole = [Span { start: 0, len: n }];
    let spans = &whole[..usize::from(n > 0)];
    let projected = Projected { values: &kv, rows };
    let shape = w.shape.attention(batch);
    let packed = KeyValues::pack(w.kernel, shape, spans, projected, &w.k_norm, anchored);
    (kv, packed)
}

/// Rows q‖k‖v, or k‖v, of LayerNorm(x), in the world. Heads of v hold their channels of stream after stream.
fn project<K: Kernel>(
    w: &Weights<K>,
    Tokens { x, frames }: Tokens,
    parts: Rows,
    anchored: bool,
    out: &mut [f32],
) {
    let (kernel, shape, d) = (w.kernel, w.shape, w.shape.dim);
    let (width, stream) = (parts.width(d), shape.stream());
    let first = if parts.asks { w.qk.view } else { w.keys() };
    let tokens = x.len() / d;
    let out = Shared::new(out);
    par_tiles(tokens, kernel.row_tile(tokens), |t, rows| {
        let mut normed = Buf::new(rows * d);
        let mut operand = Buf::new(kernel.rows_len(rows, d));
        let x = &x[t * d..][..rows * d];
        layer_norm(kernel.isa(), x, &w.norm1, shape.streams, &mut normed);
        kernel.to_rows(&normed, d, rows, d, &mut operand);
        // SAFETY: tiles are disjoint rows.
        let out = unsafe { out.slice(t * width, rows * width) };
        let v = width - d;
        // SAFETY: `out` holds rows x width values.
        unsafe {
            let left = kernel.left(&operand, rows, d);
            kernel.gemm(left, first, out.as_mut_ptr(), width, false);
        }
        if let [all] = &w.v[..] {
            // SAFETY: as above.
            unsafe {
                let left = kernel.left(&operand, rows, d);
                kernel.gemm(left, all.view, out[v..].as_mut_ptr(), width, false);
            }
        } else {
            let mut values = Buf::new(rows * stream);
            for (s, weights) in w.v.iter().enumerate() {
                kernel.to_rows(&normed[s * stream..], d, rows, stream, &mut operand);
                let left = kernel.left(&operand, rows, stream);
                // SAFETY: `values` holds rows x stream values.
                unsafe { kernel.gemm(left, weights.view, values.as_mut_ptr(), stream, false) };
                shape.scatter_stream(s, &values, &mut out[v..], width);
            }
        }
        if let Some(frames) = frames {
            let turned = shape.turned_by_frames(anchored);
            let frames = frames.from(t);
            frames.enter(out, parts.asks, d, shape.head_dim, turned);
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
    let (kernel, shape, d) = (w.kernel, w.shape, w.shape.dim);
    let (stream, m) = (shape.stream(), shape.stream_hidden());
    let mut operand = Buf::new(kernel.rows_len(rows, stream));
    let mut tmp = Buf::new(rows * d);
    out.copy_from_slice(x);
    for (s, proj) in w.proj.iter().enumerate() {
        if shape.streams == 1 {
            kernel.to_rows(attended, d, rows, d, &mut operand);
        } else {
            let own = &mut tmp[..rows * stream];
            shape.gather_stream(s, attended, d, own);
            kernel.to_rows(own, stream, rows, stream, &mut operand);
        }
        let left = kernel.left(&operand, rows, stream);
        // SAFETY: `out` holds rows x d values.
        unsafe { kernel.gemm(left, proj.view, out[s * stream..].as_mut_ptr(), d, true) };
    }
    if let Some((x1, _)) = &mut kept {
        x1.copy_from_slice(out);
    }

    let normed = &mut tmp;
    layer_norm(kernel.isa(), out, &w.norm2, shape.streams, normed);
    let width = m.min(CHUNK);
    let mut hidden = Buf::new(rows * width);
    let mut activated = Buf::new(kernel.rows_len(rows, width));
    for (s, (fc1, fc2)) in w.fc1.iter().zip(&w.fc2).enumerate() {
        kernel.to_rows(&normed[s * stream..], d, rows, stream, &mut operand);
        for c0 in (0..m).step_by(CHUNK) {
            let cols = CHUNK.min(m - c0);
            let hidden = &mut hidden[..rows * cols];
            let left = kernel.left(&operand, rows, stream);
            let right = fc1.view.cols(c0, cols);
            // SAFETY: `hidden` holds rows x cols values.
            unsafe { kernel.gemm(left, right, hidden.as_mut_ptr(), cols, false) };
            if let Some((_, saved)) = &mut kept {
                // One chunk after the other, each dense: backward reads them the same way.
                let start = s * kernel.rows_len(rows, m) + kernel.rows_len(rows, c0);
                kernel.to_rows(hidden, cols, rows, cols, &mut saved[start..]);
            }
            gelu(kernel.isa(), hidden);
            kernel.to_rows(hidden, cols, rows, cols, &mut activated);
            let left = kernel.left(&activated, rows, cols);
            let right = fc2.view.part(c0, cols, 0, stream);
            // SAFETY: `out` holds rows x d values.
            unsafe { kernel.gemm(left, right, out[s * stream..].as_mut_ptr(), d, true) };
        }
    }
}
