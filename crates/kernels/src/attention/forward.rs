//! Attention forward: pack keys and values of every head, then one task per query tile.

use super::*;
use crate::buffer::Buf;
use crate::gemm::{AnyBuf, Element};
use crate::softmax::{divide_rows, max_rows};
use crate::threads::{Shared, par_tiles};

/// Keys of a block: its scores and probabilities stay in the second-level cache.
const BLOCK: usize = 512;

/// Normalised keys and values of a layout's spans for every head, packed as the products read
/// them.
pub(crate) struct KeyValues {
    keys: AnyBuf,
    values: AnyBuf,
    /// Per span: tokens, where its keys start among its head's, where its values do.
    spans: Vec<[usize; 3]>,
    /// Elements of a head's keys and of its values.
    lens: [usize; 2],
}

impl KeyValues {
    /// Packs all spans of `layout` from `qkv` [tokens, 3d].
    pub fn pack<K: Kernel>(kernel: K, layout: &Layout, qkv: &[f32], k_norm: &[f32]) -> Self {
        let dh = layout.head_dim;
        let (key_len, key_starts) = layout.offsets(|n| kernel.packed_len(dh, n));
        let (value_len, value_starts) = layout.offsets(|n| kernel.packed_len(n, dh));
        let heads = layout.batch * layout.heads;
        let starts = key_starts.into_iter().zip(value_starts);
        let spans = layout.spans.iter().zip(starts);
        let spans: Vec<_> = spans.map(|(s, (k, v))| [s.len, k, v]).collect();
        let mut all_keys: Buf<K::Elem> = Buf::new(heads * key_len);
        let mut all_values: Buf<K::Elem> = Buf::new(heads * value_len);
        let (keys, values) = (Shared::new(&mut all_keys), Shared::new(&mut all_values));
        par_tiles(heads * layout.spans.len(), 1, |task, _| {
            let (head, s) = (task / layout.spans.len(), task % layout.spans.len());
            let (b, h) = (head / layout.heads, head % layout.heads);
            let span = layout.spans[s];
            let [_, key_start, value_start] = spans[s];
            let mut k = Buf::new(span.len * dh);
            normalised(kernel, layout, qkv, (b, h), span, 1, k_norm, 1.0, &mut k);
            let value = kernel.view_rows(values.at(head * value_len + value_start), span.len, dh);
            let v = &qkv[qkv_at(layout, b, span.start, 2, h)..];
            // SAFETY: every task packs its own span of its own head.
            unsafe {
                pack_keys(kernel, &k, dh, keys.at(head * key_len + key_start));
                kernel.pack_rows(v, 3 * layout.dim(), span.len, dh, value, 0, 0);
            }
        });
        Self {
            keys: Element::wrap(all_keys),
            values: Element::wrap(all_values),
            spans,
            lens: [key_len, value_len],
        }
    }

    /// Span `s` of head `head` (of all batch elements): keys [dh, n] and values [n, dh].
    fn span<K: Kernel>(
        &self,
        kernel: K,
        dh: usize,
        head: usize,
        s: usize,
    ) -> (View<K::Elem>, View<K::Elem>) {
        let [n, key, value] = self.spans[s];
        let (keys, values) = (K::Elem::unwrap(&self.keys), K::Elem::unwrap(&self.values));
        let key = keys[head * self.lens[0] + key..].as_ptr();
        let value = values[head * self.lens[1] + value..].as_ptr();
        (
            kernel.view_transposed(key, dh, n),
            kernel.view_rows(value, n, dh),
        )
    }

    /// Memory held.
    pub fn bytes(&self) -> usize {
        self.keys.bytes() + self.values.bytes()
    }
}

/// `out` [tokens, d] = attention of the queries in `qkv` [tokens, 3d] to `own`, the keys and values
/// of the same tokens, and before these to all of `context`; `lse` [batch, heads, n] is the
/// logarithm of each softmax denominator.
#[allow(clippy::too_many_arguments)]
pub(crate) fn forward<K: Kernel>(
    kernel: K,
    layout: &Layout,
    qkv: &[f32],
    q_norm: &[f32],
    k_norm: &[f32],
    context: Option<&KeyValues>,
    own: &KeyValues,
    out: &mut [f32],
    lse: &mut [f32],
) {
    let tiles = layout.tiles(K::ROWS);
    let heads = layout.batch * layout.heads;
    let bounded = scores_are_bounded(q_norm, k_norm);
    let (out, lse) = (Shared::new(out), Shared::new(lse));
    par_tiles(heads * tiles.len(), 1, |task, _| {
        let (head, tile) = (task / tiles.len(), &tiles[task % tiles.len()]);
        let context = context.iter().filter(|context| !context.spans.is_empty());
        let context = context.map(|context| (*context, 0));
        let seen = context.chain(tile.1.iter().map(|&s| (own, s)));
        let seen: Vec<_> = seen
            .map(|(from, s)| from.span(kernel, layout.head_dim, head, s))
            .collect();
        query_tile(
            kernel, layout, qkv, q_norm, head, tile.0, &seen, bounded, out, lse,
        );
    });
}

/// Packed keys [dh, n] and values [n, dh] that a tile sees.
type Seen<K> = (View<<K as Kernel>::Elem>, View<<K as Kernel>::Elem>);

#[allow(clippy::too_many_arguments)]
fn query_tile<K: Kernel>(
    kernel: K,
    layout: &Layout,
    qkv: &[f32],
    q_norm: &[f32],
    head: usize,
    tile: Span,
    seen: &[Seen<K>],
    bounded: bool,
    out: Shared<f32>,
    lse: Shared<f32>,
) {
    let (isa, dh, rows) = (kernel.isa(), layout.head_dim, tile.len);
    let (b, h) = (head / layout.heads, head % layout.heads);
    let scale = 1.0 / (dh as f32).sqrt();
    let mut o = Buf::new(rows * dh);
    normalised(kernel, layout, qkv, (b, h), tile, 0, q_norm, scale, &mut o);
    let mut q = Buf::new(kernel.rows_len(rows, dh));
    kernel.to_rows(&o, dh, rows, dh, &mut q);

    let longest = seen.iter().map(|(keys, _)| keys.n.min(BLOCK)).max();
    let longest = longest.unwrap_or(0);
    let mut s = Buf::new(rows * longest);
    let mut p = Buf::new(kernel.rows_len(rows, longest));
    let mut shift = Buf::zeroed(rows);
    let mut sums = Buf::zeroed(rows);
    let scores = |keys: View<K::Elem>, block: Span, s: &mut [f32]| {
        let keys = keys.cols(block.start, block.len);
        // SAFETY: `s` holds rows x block scores.
        unsafe {
            kernel.gemm(
                kernel.left(&q, rows, dh),
                keys,
                s.as_mut_ptr(),
                block.len,
                false,
            )
        };
    };

    if !bounded {
        // Unbounded scores are rare: a first pass finds each row's maximum.
        shift.fill(f32::NEG_INFINITY);
        for &(keys, _) in seen {
            for block in blocks(keys.n, BLOCK) {
                let s = &mut s[..rows * block.len];
                scores(keys, block, s);
                max_rows(isa, s, block.len, &mut shift);
            }
        }
    }
    let mut first = true;
    for &(keys, values) in seen {
        for block in blocks(keys.n, BLOCK) {
            let s = &mut s[..rows * block.len];
            scores(keys, block, s);
            kernel.exp_to_rows(s, block.len, &shift, &mut sums, &mut p);
            let p = kernel.left(&p, rows, block.len);
            let values = values.part(block.start, block.len, 0, dh);
            // SAFETY: `o` holds rows x dh values.
            unsafe { kernel.gemm(p, values, o.as_mut_ptr(), dh, !first) };
            first = false;
        }
    }
    divide_rows(isa, &mut o, dh, dh, &sums);

    // SAFETY: this head's entries of these tokens belong to this task alone.
    unsafe {
        let lse = lse.slice(head * layout.n + tile.start, rows);
        for ((lse, &sum), &shift) in lse.iter_mut().zip(sums.iter()).zip(shift.iter()) {
            *lse = sum.ln() + shift;
        }
        for r in 0..rows {
            let at = (b * layout.n + tile.start + r) * layout.dim() + h * dh;
            out.slice(at, dh).copy_from_slice(&o[r * dh..][..dh]);
        }
    }
}
