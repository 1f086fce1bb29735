//! Attention forward: one task per query tile, or per few tiles of a group whose keys it turns.

use super::anchors::turn_in_place;
use super::keys::Seen;
use super::layout::Tile;
use super::*;
use crate::buffer::Buf;
use crate::gemm::View;
use crate::softmax::{divide_rows, max_rows};
use crate::threads::{Shared, par_tiles};

/// Keys of a block: its scores and probabilities stay in the second-level cache.
const BLOCK: usize = 512;

/// Who asks.
#[derive(Clone, Copy)]
pub(crate) struct Queries<'a> {
    /// q‖k‖v
    pub x: Projected<'a>,
    pub q_norm: &'a [f32],
    pub k_norm: &'a [f32],
}

/// What is asked.
#[derive(Clone, Copy)]
pub(crate) struct Keys<'a> {
    /// One span that every query sees.
    pub context: Option<&'a KeyValues>,
    /// The spans of the layout.
    pub own: &'a KeyValues,
}

/// `out` [tokens, d] = attention of the queries to all of the context and to the own spans they see; `lse`
/// [batch, heads, n] is the logarithm of each softmax denominator.
pub(crate) fn forward<K: Kernel>(
    kernel: K,
    layout: &Layout,
    queries: Queries,
    keys: Keys,
    out: &mut [f32],
    lse: &mut [f32],
) {
    let tiles = layout.tiles(K::ROWS);
    let tasks = layout.tasks(&tiles);
    let shape = layout.shape;
    let context = keys.context.filter(|context| !context.is_empty());
    let anchored = layout.anchors.is_some();
    let bounded = scores_are_bounded(queries.q_norm, queries.k_norm, anchored);
    let (out, lse) = (Shared::new(out), Shared::new(lse));
    par_tiles(shape.all_heads() * tasks.len(), 1, |task, _| {
        let (head, tiles) = (task / tasks.len(), tasks[task % tasks.len()]);
        let group = tiles[0].group;
        let mut turned = Vec::new();
        let mut seen: Vec<Seen<K>> = Vec::new();
        if let Some(context) = context {
            let table = |keys| layout.key_table(head, group, keys);
            seen.push(context.span(kernel, shape.head_dim, (head, 0), table, &mut turned));
        }
        for &s in layout.seen(group) {
            let table = |_| layout.own_table(head, group, layout.spans[s]);
            let span = keys
                .own
                .span(kernel, shape.head_dim, (head, s), table, &mut turned);
            seen.push(span);
        }
        for tile in tiles {
            query_tile(
                kernel, layout, queries, head, *tile, &seen, bounded, out, lse,
            );
        }
    });
}

#[allow(clippy::too_many_arguments)]
fn query_tile<K: Kernel>(
    kernel: K,
    layout: &Layout,
    queries: Queries,
    head: usize,
    Tile { tokens: tile, .. }: Tile,
    seen: &[Seen<K>],
    bounded: bool,
    out: Shared<f32>,
    lse: Shared<f32>,
) {
    let shape = layout.shape;
    let (isa, dh, rows) = (kernel.isa(), shape.head_dim, tile.len);
    let (b, h) = shape.head(head);
    let scale = 1.0 / (dh as f32).sqrt();
    let mut o = Buf::new(rows * dh);
    let (x, gain) = (queries.x, queries.q_norm);
    x.normalised(kernel, shape, (b, h), tile, Part::Q, gain, scale, &mut o);
    if let Some(table) = layout.query_table(head, tile) {
        turn_in_place(isa, &mut o, dh, table, 1.0);
    }
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
            let at = (b * layout.n + tile.start + r) * shape.dim() + h * dh;
            out.slice(at, dh).copy_from_slice(&o[r * dh..][..dh]);
        }
    }
}
