//! Exponentials of scores straight into a left operand of the bf16 kernels: one pass where exp,
//! sum and conversion would be three.

use std::arch::x86_64::*;

use super::pack512::{first, load, narrow, place, width};

/// `dst = exp(s - shift[row])` as rows of a left operand; adds each row's sum to `sums`.
/// `s`: [shift.len(), cols].
#[target_feature(enable = "avx512f,avx512bw,avx512dq,avx512vl,avx512bf16")]
pub(super) fn exp_to_rows<const TILED: bool>(
    s: &[f32],
    cols: usize,
    shift: &[f32],
    sums: &mut [f32],
    dst: &mut [u16],
) {
    let width = width::<TILED>(cols);
    assert!(s.len() >= shift.len() * cols && sums.len() == shift.len());
    for (r, (&shift, total)) in shift.iter().zip(sums).enumerate() {
        let s = &s[r * cols..][..cols];
        let (base, step) = place::<TILED>(r, width);
        let whole = cols - cols % 32;
        let scale = _mm512_set1_ps(std::f32::consts::LOG2_E);
        let shift = _mm512_set1_ps(-shift * std::f32::consts::LOG2_E);
        let (mut even, mut odd) = (_mm512_setzero_ps(), _mm512_setzero_ps());
        for c in (0..whole).step_by(32) {
            let out = &mut dst[base + c / 32 * step..][..32];
            // SAFETY: 32 values of the row, and as many of the operand.
            unsafe {
                let s = s.as_ptr().add(c);
                let low = exp2(_mm512_fmadd_ps(_mm512_loadu_ps(s), scale, shift));
                let high = exp2(_mm512_fmadd_ps(_mm512_loadu_ps(s.add(16)), scale, shift));
                even = _mm512_add_ps(even, low);
                odd = _mm512_add_ps(odd, high);
                _mm512_storeu_si512(out.as_mut_ptr().cast(), narrow(low, high));
            }
        }
        if whole < cols {
            let n = cols - whole;
            let out = &mut dst[base + whole / 32 * step..][..width - whole];
            let tail = |at: usize| {
                let n = n.saturating_sub(at);
                // SAFETY: masked to the row's values.
                let s = unsafe { load(s.as_ptr().wrapping_add(whole + at), n) };
                // Beyond the row stand zeros, not exp(0 - shift).
                _mm512_maskz_mov_ps(first(n), exp2(_mm512_fmadd_ps(s, scale, shift)))
            };
            let (low, high) = (tail(0), tail(16));
            even = _mm512_add_ps(even, low);
            odd = _mm512_add_ps(odd, high);
            let mask = ((1u64 << out.len()) - 1) as u32;
            // SAFETY: masked to the operand's row.
            unsafe {
                _mm512_mask_storeu_epi16(out.as_mut_ptr().cast(), mask, narrow(low, high));
            }
        }
        *total += _mm512_reduce_add_ps(_mm512_add_ps(even, odd));
    }
}

/// 2^y with relative error 2.6e-6 (the minimax polynomial of degree 4 on [0, 1)); 0 and infinity
/// outside f32's range, NaN stays.
#[inline]
#[target_feature(enable = "avx512f,avx512dq")]
fn exp2(y: __m512) -> __m512 {
    // y - floor(y), without exceptions.
    let f = _mm512_reduce_ps::<0x09>(y);
    let p = _mm512_set1_ps(0.013_534_168);
    let p = _mm512_fmadd_ps(p, f, _mm512_set1_ps(0.052_011_46));
    let p = _mm512_fmadd_ps(p, f, _mm512_set1_ps(0.241_442_76));
    let p = _mm512_fmadd_ps(p, f, _mm512_set1_ps(0.693_003_83));
    let p = _mm512_fmadd_ps(p, f, _mm512_set1_ps(1.000_002_6));
    // p * 2^floor(y)
    _mm512_scalef_ps(p, y)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cpu::Cpu;

    #[test]
    fn exponentials_sums_and_padding() {
        if !Cpu::Avx512.is_supported() {
            return;
        }
        for cols in [1, 15, 16, 17, 31, 32, 33, 70, 96] {
            let rows = 19;
            let s: Vec<f32> = (0..rows * cols)
                .map(|i| (i % 97) as f32 * 0.5 - 30.0)
                .collect();
            let shift: Vec<f32> = (0..rows).map(|r| r as f32 - 9.0).collect();
            check::<false>(&s, cols, &shift);
            check::<true>(&s, cols, &shift);
        }
    }

    fn check<const TILED: bool>(s: &[f32], cols: usize, shift: &[f32]) {
        let width = width::<TILED>(cols);
        let rows = shift.len();
        let mut sums = vec![1.0; rows];
        let mut dst = vec![0x7FC0; rows.next_multiple_of(16) * width];
        // SAFETY: the caller has checked the instructions.
        unsafe { exp_to_rows::<TILED>(s, cols, shift, &mut sums, &mut dst) };
        for r in 0..rows {
            let (base, step) = place::<TILED>(r, width);
            let want = |c: usize| f64::from(s[r * cols + c] - shift[r]).exp();
            let total = 1.0 + (0..cols).map(want).sum::<f64>();
            assert!((f64::from(sums[r]) / total - 1.0).abs() < 1e-5);
            for c in 0..width {
                let got = f32::from_bits(u32::from(dst[base + c / 32 * step + c % 32]) << 16);
                if c < cols {
                    // bf16 keeps 8 bits.
                    assert!((f64::from(got) / want(c) - 1.0).abs() < 4e-3);
                } else {
                    assert_eq!(got, 0.0);
                }
            }
        }
    }

    #[test]
    fn ends_of_the_range() {
        if !Cpu::Avx512.is_supported() {
            return;
        }
        let s = [
            f32::NAN,
            f32::INFINITY,
            f32::NEG_INFINITY,
            200.0,
            -200.0,
            0.0,
        ];
        let mut dst = vec![0u16; 6];
        let mut sums = [0.0];
        // SAFETY: the instructions are there.
        unsafe { exp_to_rows::<false>(&s, 6, &[0.0], &mut sums, &mut dst) };
        let got: Vec<f32> = dst
            .iter()
            .map(|&x| f32::from_bits(u32::from(x) << 16))
            .collect();
        assert!(got[0].is_nan() && sums[0].is_nan());
        assert_eq!(got[1..], [f32::INFINITY, 0.0, f32::INFINITY, 0.0, 1.0]);
    }
}
