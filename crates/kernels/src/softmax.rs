//! Exponentials of score tiles, and the softmax gradient.

use crate::simd::{AHEAD, LANES, exp, multiversion, prefetch, sum};

multiversion! {
    /// `dst = exp(s - shift[row])`; adds each row's sum to `sums`. `s`, `dst`: [rows, cols].
    fn exp_rows<FMA>(s: &[f32], cols: usize, shift: &[f32], sums: &mut [f32], dst: &mut [f32]) {
        let rows = s.chunks_exact(cols).zip(dst.chunks_exact_mut(cols));
        for (((s, dst), &shift), total) in rows.zip(shift).zip(sums) {
            for (dst, &s) in dst.iter_mut().zip(s) {
                *dst = exp::<FMA>(s - shift);
            }
            *total += sum([&*dst; 3], |x, _, _| x);
        }
    }

    /// `max = max(max, row maximum)`. NaN may be dropped: the exponentials bring it back.
    fn max_rows<FMA>(s: &[f32], cols: usize, max: &mut [f32]) {
        for (row, max) in s.chunks_exact(cols).zip(max) {
            let mut lanes = [f32::NEG_INFINITY; LANES];
            let chunks = row.chunks_exact(LANES);
            for &x in chunks.remainder() {
                *max = if x > *max { x } else { *max };
            }
            for chunk in chunks {
                for (lane, &x) in lanes.iter_mut().zip(chunk) {
                    *lane = if x > *lane { x } else { *lane };
                }
            }
            for x in lanes {
                *max = if x > *max { x } else { *max };
            }
        }
    }

    /// Divides rows of `o` (stride `ldo`) of length `cols` by `sums`.
    fn divide_rows<FMA>(o: &mut [f32], ldo: usize, cols: usize, sums: &[f32]) {
        for (r, &s) in sums.iter().enumerate() {
            let inverse = 1.0 / s;
            for o in &mut o[r * ldo..][..cols] {
                *o *= inverse;
            }
        }
    }

    /// `dp = p * (dp - dot[row])`: the gradient of the scores. `p`, `dp`: [rows, cols].
    fn score_gradient<FMA>(p: &[f32], dp: &mut [f32], cols: usize, dot: &[f32]) {
        for ((p, dp), &dot) in p.chunks_exact(cols).zip(dp.chunks_exact_mut(cols)).zip(dot) {
            for (dp, &p) in dp.iter_mut().zip(p) {
                *dp = p * (*dp - dot);
            }
        }
    }

    /// `dot[r] = a[r]·b[r]` for rows of length `cols` with strides `lda`, `ldb`.
    fn row_dots<FMA>(a: &[f32], lda: usize, b: &[f32], ldb: usize, cols: usize, dot: &mut [f32]) {
        for (r, dot) in dot.iter_mut().enumerate() {
            prefetch(a.as_ptr().wrapping_add((r + AHEAD) * lda), cols);
            prefetch(b.as_ptr().wrapping_add((r + AHEAD) * ldb), cols);
            let a = &a[r * lda..][..cols];
            let b = &b[r * ldb..][..cols];
            *dot = sum([a, b, a], |a, b, _| a * b);
        }
    }
}
