//! LayerNorm (gain only) and RMSNorm, forward and backward, a few rows at a time.

use crate::simd::{AHEAD, fma, multiversion, prefetch, sum};

/// Added to variances and mean squares.
pub(crate) const EPS: f32 = 1e-5;

/// Mean and reciprocal standard deviation (biased) of a row.
#[inline(always)]
fn moments(row: &[f32]) -> (f32, f32) {
    let n = row.len();
    let mean = sum([row; 3], |x, _, _| x) / n as f32;
    let var = sum([row; 3], |x, _, _| (x - mean) * (x - mean)) / n as f32;
    (mean, 1.0 / (var + EPS).sqrt())
}

multiversion! {
    /// `out = LayerNorm(x) * gain`, of each stream alone; `x`, `out`: [rows, streams·d], `gain`: [streams·d].
    fn layer_norm<FMA>(x: &[f32], gain: &[f32], streams: usize, out: &mut [f32]) {
        let d = gain.len() / streams;
        let gains = gain.chunks_exact(d).cycle();
        for ((x, out), gain) in x.chunks_exact(d).zip(out.chunks_exact_mut(d)).zip(gains) {
            let (mean, rstd) = moments(x);
            for ((o, &x), &g) in out.iter_mut().zip(x).zip(gain) {
                *o = (x - mean) * rstd * g;
            }
        }
    }

    /// Adds the gradient through LayerNorm to `dx` and to `dgain`.
    /// `x`, `dy`, `dx`: [rows, streams·d]; `gain`, `dgain`: [streams·d].
    fn layer_norm_backward<FMA>(
        x: &[f32], gain: &[f32], streams: usize, dy: &[f32], dx: &mut [f32], dgain: &mut [f32],
    ) {
        let d = gain.len() / streams;
        let rows = x.chunks_exact(d).zip(dy.chunks_exact(d)).zip(dx.chunks_exact_mut(d));
        for (r, ((x, dy), dx)) in rows.enumerate() {
            let stream = r % streams * d;
            let gain = &gain[stream..][..d];
            let dgain = &mut dgain[stream..][..d];
            let (mean, rstd) = moments(x);
            let a = sum([dy, gain, dy], |dy, g, _| dy * g) / d as f32;
            let b = sum([dy, gain, x], |dy, g, x| dy * g * (x - mean)) * rstd / d as f32;
            for i in 0..d {
                let centred = (x[i] - mean) * rstd;
                dgain[i] = fma::<FMA>(dy[i], centred, dgain[i]);
                dx[i] += rstd * (dy[i] * gain[i] - a - centred * b);
            }
        }
    }

    /// `out = x / rms(x) * gain * scale` for `rows` rows of `gain.len()`, with row strides
    /// `ldx` and `ldo`.
    fn rms_norm<FMA>(rows: usize, x: &[f32], ldx: usize, gain: &[f32], scale: f32, out: &mut [f32], ldo: usize) {
        let d = gain.len();
        for r in 0..rows {
            prefetch(x.as_ptr().wrapping_add((r + AHEAD) * ldx), d);
            let x = &x[r * ldx..][..d];
            let out = &mut out[r * ldo..][..d];
            let rstd = scale / (sum([x; 3], |x, _, _| x * x) / d as f32 + EPS).sqrt();
            for ((o, &x), &g) in out.iter_mut().zip(x).zip(gain) {
                *o = x * rstd * g;
            }
        }
    }

    /// Gradient through `rms_norm` with scale 1, of `dy * scale`: writes `dx` (row stride `ldx`,
    /// as `x`), adds to `dgain`. `dy` is dense.
    fn rms_norm_backward<FMA>(
        rows: usize, x: &[f32], ldx: usize, gain: &[f32], scale: f32, dy: &[f32], dx: &mut [f32], lddx: usize,
        dgain: &mut [f32],
    ) {
        let d = gain.len();
        let dgain = &mut dgain[..d];
        for r in 0..rows {
            prefetch(x.as_ptr().wrapping_add((r + AHEAD) * ldx), d);
            let x = &x[r * ldx..][..d];
            let dy = &dy[r * d..][..d];
            let dx = &mut dx[r * lddx..][..d];
            let rstd = 1.0 / (sum([x; 3], |x, _, _| x * x) / d as f32 + EPS).sqrt();
            let b = sum([dy, gain, x], |dy, g, x| dy * g * x) * rstd / d as f32;
            for i in 0..d {
                let unit = x[i] * rstd;
                dgain[i] = fma::<FMA>(dy[i] * scale, unit, dgain[i]);
                dx[i] = scale * rstd * (dy[i] * gain[i] - unit * b);
            }
        }
    }

    /// `acc += x`, element by element.
    fn add_assign<FMA>(acc: &mut [f32], x: &[f32]) {
        for (a, &x) in acc.iter_mut().zip(x) {
            *a += x;
        }
    }
}
