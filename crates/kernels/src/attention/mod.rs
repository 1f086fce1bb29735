//! Attention of QK-normalised heads, tiled over queries and keys.
//!
//! Works on the `[tokens, 3d]` output of the q‖k‖v projection. Scores exist only as tiles of at
//! most `TILE` queries by one key block, so memory is linear in the number of tokens.

mod backward;
mod forward;

pub(crate) use backward::{Inputs, backward};
pub(crate) use forward::{KeyValues, forward};

use crate::gemm::{Kernel, View};
use crate::norm::rms_norm;

/// Largest number of query rows a task holds.
const TILE: usize = 96;

/// Which tokens of a sequence see which: the first `context` tokens see each other only; the
/// others are consecutive groups of `group` tokens, which see the context and their own group.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Pattern {
    /// Number of leading context tokens.
    pub context: usize,
    /// Tokens of one group; not read if all tokens are context.
    pub group: usize,
}

impl Pattern {
    /// All `n` tokens see each other.
    pub fn full(n: usize) -> Self {
        Self {
            context: n,
            group: 0,
        }
    }

    /// # Panics
    /// If `n` tokens do not split into the context and whole groups.
    pub(crate) fn check(self, n: usize) {
        let Self { context, group } = self;
        assert!(
            context <= n,
            "pattern: context {context} of only {n} tokens"
        );
        assert!(
            context == n || (group > 0 && (n - context).is_multiple_of(group)),
            "pattern: {} tokens after the context are not whole groups of {group}",
            n - context
        );
    }
}

/// Consecutive tokens of a sequence.
#[derive(Clone, Copy)]
pub(crate) struct Span {
    pub start: usize,
    pub len: usize,
}

/// Everything the two passes need to know about shapes.
pub(crate) struct Layout {
    pub batch: usize,
    pub n: usize,
    pub heads: usize,
    pub head_dim: usize,
    /// Context (if any), then the groups.
    spans: Vec<Span>,
    has_context: bool,
}

impl Layout {
    pub fn new(batch: usize, n: usize, heads: usize, head_dim: usize, pattern: Pattern) -> Self {
        pattern.check(n);
        let has_context = pattern.context > 0;
        let mut spans = Vec::new();
        let mut start = 0;
        while start < n {
            let len = if start < pattern.context {
                pattern.context
            } else {
                pattern.group
            };
            spans.push(Span { start, len });
            start += len;
        }
        Self {
            batch,
            n,
            heads,
            head_dim,
            spans,
            has_context,
        }
    }

    pub fn dim(&self) -> usize {
        self.heads * self.head_dim
    }

    /// Query tiles, multiples of a micro-kernel's `unit` rows: (tokens, the spans they see).
    fn tiles(&self, unit: usize) -> Vec<(Span, Vec<usize>)> {
        let mut tiles = Vec::new();
        for (i, span) in self.spans.iter().enumerate() {
            let seen = if i > 0 && self.has_context {
                vec![0, i]
            } else {
                vec![i]
            };
            // Equal tiles, rather than full ones and a rest.
            let len = span.len.div_ceil(span.len.div_ceil(TILE));
            let len = len.next_multiple_of(unit).min(TILE);
            let mut start = 0;
            while start < span.len {
                let rows = len.min(span.len - start);
                let tile = Span {
                    start: span.start + start,
                    len: rows,
                };
                tiles.push((tile, seen.clone()));
                start += rows;
            }
        }
        tiles
    }

    /// Longest key block when spans are cut at `max`.
    fn longest_block(&self, max: usize) -> usize {
        self.spans.iter().map(|s| s.len.min(max)).max().unwrap_or(0)
    }

    /// The spans packed one after the other: elements of the packing and where each starts.
    fn offsets(&self, len_of: impl Fn(usize) -> usize) -> (usize, Vec<usize>) {
        let mut total = 0;
        let starts = self.spans.iter().map(|s| {
            let start = total;
            // Keeps every span's packing on a cache line.
            total += len_of(s.len).next_multiple_of(PANEL_ALIGN);
            start
        });
        let starts = starts.collect();
        (total, starts)
    }
}

/// Key blocks of at most `max` of `len` tokens.
fn blocks(len: usize, max: usize) -> impl Iterator<Item = Span> {
    (0..len).step_by(max).map(move |start| Span {
        start,
        len: max.min(len - start),
    })
}

/// Elements of a cache line, for the narrowest element.
const PANEL_ALIGN: usize = 32;

/// `exp(score)` needs no maximum subtracted while |score| stays below this: RMS-normalised
/// queries and keys are bounded by their gains. e^60 keeps sums over 1e10 keys finite in f32, and
/// e^-60 keeps them normal.
const SAFE_SCORE: f32 = 60.0;

/// Bound of |score| from the gains alone; NaN gains give a bound that is not safe.
fn scores_are_bounded(q_norm: &[f32], k_norm: &[f32]) -> bool {
    // |Σ gq q̂ gk k̂| <= max|gq gk| |q̂||k̂| <= max|gq gk| dh, and the scale is 1/sqrt(dh).
    let gains = q_norm.iter().zip(k_norm).map(|(q, k)| (q * k).abs());
    let largest = gains.fold(0.0f32, |max, g| if g <= max { max } else { g });
    largest * (q_norm.len() as f32).sqrt() < SAFE_SCORE
}

/// Where head `h` of token `t` of batch element `b` starts in `[tokens, 3d]`; `part` 0, 1, 2 is
/// q, k, v.
fn qkv_at(layout: &Layout, b: usize, t: usize, part: usize, h: usize) -> usize {
    let d = layout.dim();
    (b * layout.n + t) * 3 * d + part * d + h * layout.head_dim
}

/// Packs the keys of one span, normalised, transposed: a [dh, keys] operand.
///
/// # Safety
/// As `Kernel::pack_transposed`.
unsafe fn pack_keys<K: Kernel>(
    kernel: K,
    keys: &[f32],
    dh: usize,
    dst: *mut K::Elem,
) -> View<K::Elem> {
    let n = keys.len() / dh;
    let view = kernel.view_transposed(dst, dh, n);
    // SAFETY: the caller's promise.
    unsafe { kernel.pack_transposed(keys, dh, n, view, 0) };
    view
}

/// Normalised rows of one head: `rows` tokens from `t`, dense.
#[allow(clippy::too_many_arguments)]
fn normalised<K: Kernel>(
    kernel: K,
    layout: &Layout,
    qkv: &[f32],
    (b, h): (usize, usize),
    span: Span,
    part: usize,
    gain: &[f32],
    scale: f32,
    out: &mut [f32],
) {
    let dh = layout.head_dim;
    let at = qkv_at(layout, b, span.start, part, h);
    let ld = 3 * layout.dim();
    rms_norm(kernel.isa(), span.len, &qkv[at..], ld, gain, scale, out, dh);
}
