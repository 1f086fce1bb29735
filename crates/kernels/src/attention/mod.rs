//! Attention of QK-normalised heads, tiled over queries and keys.
//!
//! Works on the output of the projection to q‖k‖v. Scores exist only as tiles of at most `TILE` queries by one key
//! block, so memory is linear in the number of tokens.

mod anchors;
mod backward;
mod forward;
mod keys;
mod layout;
mod operands;

pub use anchors::Anchors;
pub(crate) use backward::{Gradients, Inputs, backward};
pub(crate) use forward::{Keys, Queries, forward};
pub(crate) use keys::KeyValues;
pub use layout::Pattern;
pub(crate) use layout::{Layout, Shape, Span};

use crate::gemm::Kernel;
use crate::norm::rms_norm;

/// Key blocks of at most `max` of `len` tokens.
fn blocks(len: usize, max: usize) -> impl Iterator<Item = Span> {
    (0..len).step_by(max).map(move |start| Span {
        start,
        len: max.min(len - start),
    })
}

/// `exp(score)` needs no maximum subtracted while |score| stays below this: RMS-normalised
/// queries and keys are bounded by their gains. e^60 keeps sums over 1e10 keys finite in f32, and
/// e^-60 keeps them normal.
const SAFE_SCORE: f32 = 60.0;

/// Bound of |score| from the gains alone; NaN gains give a bound that is not safe.
fn scores_are_bounded(q_norm: &[f32], k_norm: &[f32], anchored: bool) -> bool {
    let max = |max: f32, g: f32| if g <= max || max.is_nan() { max } else { g };
    let largest = if anchored {
        // Channels that turn meet one another's gains.
        let largest = |gains: &[f32]| gains.iter().map(|g| g.abs()).fold(0.0, max);
        largest(q_norm) * largest(k_norm)
    } else {
        // |Σ gq q̂ gk k̂| <= max|gq gk| |q̂||k̂| <= max|gq gk| dh, and the scale is 1/sqrt(dh).
        let gains = q_norm.iter().zip(k_norm).map(|(q, k)| (q * k).abs());
        gains.fold(0.0, max)
    };
    largest * (q_norm.len() as f32).sqrt() < SAFE_SCORE
}

/// Parts of a projection's rows.
#[derive(Clone, Copy)]
pub(crate) enum Part {
    Q,
    K,
    V,
}

/// Where parts and heads stand in the rows `[batch, n, parts·d]` of a projection: q‖k‖v, or k‖v of
/// tokens that ask nothing.
#[derive(Clone, Copy)]
pub(crate) struct Rows {
    /// Tokens of a batch element.
    pub n: usize,
    pub asks: bool,
}

impl Rows {
    /// Numbers of a row.
    pub fn width(self, d: usize) -> usize {
        if self.asks { 3 * d } else { 2 * d }
    }

    /// Start of a part of a head of token `t`.
    fn at(self, shape: Shape, (b, h): (usize, usize), t: usize, part: Part) -> usize {
        let d = shape.dim();
        let part = match part {
            Part::Q => 0,
            Part::K => usize::from(self.asks),
            Part::V => 1 + usize::from(self.asks),
        };
        (b * self.n + t) * self.width(d) + part * d + h * shape.head_dim
    }
}

/// A projection's output.
#[derive(Clone, Copy)]
pub(crate) struct Projected<'a> {
    pub values: &'a [f32],
    pub rows: Rows,
}

impl<'a> Projected<'a> {
    /// From token `t`'s part on, and the distance to the next token's.
    fn from(self, shape: Shape, head: (usize, usize), t: usize, part: Part) -> (&'a [f32], usize) {
        let at = self.rows.at(shape, head, t, part);
        (&self.values[at..], self.rows.width(shape.dim()))
    }

    /// Normalised queries or keys of one head and the tokens of `span`, dense.
    #[allow(clippy::too_many_arguments)]
    fn normalised<K: Kernel>(
        self,
        kernel: K,
        shape: Shape,
        head: (usize, usize),
        span: Span,
        part: Part,
        gain: &[f32],
        scale: f32,
        out: &mut [f32],
    ) {
        let (x, ld) = self.from(shape, head, span.start, part);
        let isa = kernel.isa();
        rms_norm(isa, span.len, x, ld, gain, scale, out, shape.head_dim);
    }
}
