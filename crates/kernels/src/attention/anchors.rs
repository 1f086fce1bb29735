//! Depth anchors: rotary embedding of queries and keys by where they lie in each query's view (URoPE, arXiv 2604.18747).
//!
//! The last dh/2 channels of a head are dh/4 pairs, each turned by an angle of its own:
//!
//! ```text
//! (a, b) -> (a cos − b sin, a sin + b cos)
//! ```
//!
//! A query has one set of angles. A key has one for each query group and depth: where its ray's point at this depth
//! appears in the group's view. Head h reads depth h mod `depths`. So keys are normalised once, and turned and packed
//! again by every task, for a few query tiles of one group.

use crate::simd::multiversion;

/// Rotations of queries and keys as (cos, sin) of each pair; (1, 0) leaves a pair as it is. They must be rotations,
/// which nobody checks, and they get no gradient.
#[derive(Clone, Copy, Debug)]
pub struct Anchors<'a> {
    /// Key rotations to choose from; head h uses number h mod `depths`.
    pub depths: usize,
    /// `[batch, n, dh/4, 2]`, for all heads.
    pub queries: &'a [f32],
    /// `[batch, groups, depths, keys, dh/4, 2]`: of all tokens of an external context, or of the sequence where there
    /// is none. (With an external context, the tokens of a query's own group turn by `queries`.)
    pub keys: &'a [f32],
}

impl Anchors<'_> {
    /// # Panics
    /// If a length does not match, or heads of `dh` channels do not split into halves of pairs.
    pub(crate) fn check(&self, batch: usize, n: usize, groups: usize, keys: usize, dh: usize) {
        assert!(
            dh.is_multiple_of(4) && self.depths > 0,
            "anchors: head_dim {dh} is no multiple of 4, or depths {} is 0",
            self.depths
        );
        let queries = batch * n * dh / 2;
        assert_eq!(self.queries.len(), queries, "anchors: length of queries");
        let keys = batch * groups * self.depths * keys * dh / 2;
        assert_eq!(self.keys.len(), keys, "anchors: length of keys");
    }
}

/// `x` turned by a table of (cos, sin); a `sign` of -1 turns it back.
#[inline(always)]
fn turned<const N: usize>(x: &[f32; N], table: &[f32; N], sign: f32) -> [f32; N] {
    std::array::from_fn(|i| {
        let (cos, sin) = (table[i & !1], table[i | 1]);
        let sin = if i % 2 == 0 { -sin } else { sin };
        x[i] * cos + x[i ^ 1] * (sign * sin)
    })
}

/// Runs `f(into, x turned)` on the whole row, a few channels at a time.
#[inline(always)]
fn each(into: &mut [f32], x: &[f32], table: &[f32], sign: f32, f: impl Fn(&mut f32, f32)) {
    let (wide, rest) = into.as_chunks_mut::<8>();
    let ((x, x_rest), (table, table_rest)) = (x.as_chunks::<8>(), table.as_chunks::<8>());
    for ((into, x), table) in wide.iter_mut().zip(x).zip(table) {
        for (into, x) in into.iter_mut().zip(turned(x, table, sign)) {
            f(into, x);
        }
    }
    let into = rest.as_chunks_mut::<2>().0.iter_mut();
    let pairs = x_rest
        .as_chunks::<2>()
        .0
        .iter()
        .zip(table_rest.as_chunks::<2>().0);
    for (into, (x, table)) in into.zip(pairs) {
        for (into, x) in into.iter_mut().zip(turned(x, table, sign)) {
            f(into, x);
        }
    }
}

multiversion! {
    /// `out` = `x` with its last dh/2 channels turned by `table`; `x`, `out`: [rows, dh], `table`: [rows, dh/2].
    fn turn<FMA>(x: &[f32], dh: usize, table: &[f32], out: &mut [f32]) {
        let half = dh / 2;
        let rows = x.chunks_exact(dh).zip(table.chunks_exact(half));
        for ((x, table), out) in rows.zip(out.chunks_exact_mut(dh)) {
            let ((same, x), (out, turned)) = (x.split_at(half), out.split_at_mut(half));
            out.copy_from_slice(same);
            each(turned, x, table, 1.0, |out, x| *out = x);
        }
    }

    /// `acc += x` with its last dh/2 channels turned back by `table`; shapes as for `turn`.
    fn add_turned_back<FMA>(x: &[f32], dh: usize, table: &[f32], acc: &mut [f32]) {
        let half = dh / 2;
        let rows = x.chunks_exact(dh).zip(table.chunks_exact(half));
        for ((x, table), acc) in rows.zip(acc.chunks_exact_mut(dh)) {
            let ((same, x), (acc, turned)) = (x.split_at(half), acc.split_at_mut(half));
            for (acc, x) in acc.iter_mut().zip(same) {
                *acc += x;
            }
            each(turned, x, table, -1.0, |acc, x| *acc += x);
        }
    }

    /// The last dh/2 channels of `x` turned in place, or turned back with `sign` -1; shapes as for `turn`.
    fn turn_in_place<FMA>(x: &mut [f32], dh: usize, table: &[f32], sign: f32) {
        let half = dh / 2;
        for (x, table) in x.chunks_exact_mut(dh).zip(table.chunks_exact(half)) {
            for (x, table) in x[half..].as_chunks_mut::<2>().0.iter_mut().zip(table.as_chunks::<2>().0) {
                *x = turned(x, table, sign);
            }
        }
    }
}
