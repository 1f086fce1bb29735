//! f32 to bf16 (round to nearest even, in hardware) into the layouts of `avx512` and `amx`.
//!
//! Right operands differ in how far k is padded with zeros (`depth`); left operands are plain rows,
//! or, if `TILED`, strips of 16 rows cut into tiles of 32 k.

use std::arch::x86_64::*;

use super::{PANEL, View};
use crate::simd::{AHEAD, prefetch};

/// Padded length of a row of a left operand.
#[inline(always)]
pub(super) fn width<const TILED: bool>(cols: usize) -> usize {
    cols.next_multiple_of(if TILED { 32 } else { 2 })
}

/// Where row `r` of a left operand starts, and the distance between its groups of 32.
#[inline(always)]
pub(super) fn place<const TILED: bool>(r: usize, width: usize) -> (usize, usize) {
    if TILED {
        (r / 16 * 16 * width + r % 16 * 32, 16 * 32)
    } else {
        (r * width, 32)
    }
}

/// Two vectors as 32 bf16, `low` first.
#[inline]
#[target_feature(enable = "avx512f,avx512bf16")]
pub(super) fn narrow(low: __m512, high: __m512) -> __m512i {
    // SAFETY: both are 512 bits without invalid values.
    unsafe { std::mem::transmute(_mm512_cvtne2ps_pbh(high, low)) }
}

/// The first `n` (at most 16) values at `src`, then zeros.
///
/// # Safety
/// They are readable.
#[inline]
#[target_feature(enable = "avx512f")]
pub(super) unsafe fn load(src: *const f32, n: usize) -> __m512 {
    // SAFETY: the mask keeps the load inside the caller's values.
    unsafe { _mm512_maskz_loadu_ps(first(n), src) }
}

/// Mask of the first `n` of 16 lanes.
#[inline(always)]
pub(super) fn first(n: usize) -> u16 {
    if n >= 16 { 0xFFFF } else { (1 << n) - 1 }
}

/// Two neighbouring rows interleaved: pairs (k, k+1) of 16 columns.
#[inline]
#[target_feature(enable = "avx512f,avx512bw,avx512bf16")]
fn interleave(even: __m512, odd: __m512) -> __m512i {
    let order = _mm512_set_epi16(
        31, 15, 30, 14, 29, 13, 28, 12, 27, 11, 26, 10, 25, 9, 24, 8, 23, 7, 22, 6, 21, 5, 20, 4,
        19, 3, 18, 2, 17, 1, 16, 0,
    );
    _mm512_permutexvar_epi16(order, narrow(even, odd))
}

/// Rows of `cols` values as a left operand.
#[target_feature(enable = "avx512f,avx512bw,avx512vl,avx512bf16")]
pub(super) fn to_rows<const TILED: bool>(
    src: &[f32],
    ld: usize,
    rows: usize,
    cols: usize,
    dst: &mut [u16],
) {
    let width = width::<TILED>(cols);
    for r in 0..rows {
        let src = &src[r * ld..][..cols];
        let (base, step) = place::<TILED>(r, width);
        let whole = cols - cols % 32;
        for c in (0..whole).step_by(32) {
            let out = &mut dst[base + c / 32 * step..][..32];
            // SAFETY: 32 values of both slices.
            unsafe {
                let src = src.as_ptr().add(c);
                let both = narrow(_mm512_loadu_ps(src), _mm512_loadu_ps(src.add(16)));
                _mm512_storeu_si512(out.as_mut_ptr().cast(), both);
            }
        }
        if whole < cols {
            let out = &mut dst[base + whole / 32 * step..][..width - whole];
            let (src, n) = (src.as_ptr().wrapping_add(whole), cols - whole);
            let high = src.wrapping_add(16);
            let mask = ((1u64 << out.len()) - 1) as u32;
            // SAFETY: reads and the write are masked to the row.
            unsafe {
                let both = narrow(load(src, n), load(high, n.saturating_sub(16)));
                _mm512_mask_storeu_epi16(out.as_mut_ptr().cast(), mask, both);
            }
        }
    }
}

/// The inverse of `to_rows`, into dense rows.
#[target_feature(enable = "avx512f,avx512bw,avx512vl")]
pub(super) fn widen<const TILED: bool>(src: &[u16], rows: usize, cols: usize, dst: &mut [f32]) {
    let width = width::<TILED>(cols);
    for r in 0..rows {
        let (base, step) = place::<TILED>(r, width);
        for (g, dst) in dst[r * cols..][..cols].chunks_mut(32).enumerate() {
            for (dst, &src) in dst.iter_mut().zip(&src[base + g * step..]) {
                *dst = f32::from_bits(u32::from(src) << 16);
            }
        }
    }
}

/// See `Kernel::pack_rows`; `depth` is the kernel's step of k.
#[allow(clippy::too_many_arguments)] // A matrix and a place are four numbers each.
#[target_feature(enable = "avx512f,avx512bw,avx512vl,avx512bf16")]
pub(super) unsafe fn pack_rows(
    src: &[f32],
    ld: usize,
    rows: usize,
    cols: usize,
    dst: View<u16>,
    k0: usize,
    c0: usize,
    depth: usize,
) {
    assert!(k0 + rows <= dst.k && c0 + cols <= dst.n, "outside packing");
    assert!(
        rows == 0 || src.len() >= (rows - 1) * ld + cols,
        "too few rows"
    );
    assert!(k0.is_multiple_of(2) && c0.is_multiple_of(PANEL));
    for r in (0..rows).step_by(2) {
        let even = src[r * ld..].as_ptr();
        prefetch(even.wrapping_add(AHEAD * ld), cols);
        prefetch(even.wrapping_add((AHEAD + 1) * ld), cols);
        let odd = even.wrapping_add(ld);
        let odd_cols = if r + 1 < rows { cols } else { 0 };
        // SAFETY: the caller owns these rows of the packing.
        let mut out = unsafe { dst.ptr.add((k0 + r) * dst.ks + c0 * dst.ns).cast_mut() };
        for c in (0..cols).step_by(PANEL) {
            // SAFETY: reads are masked to the rows; a panel's rows are whole even where the
            // matrix has fewer columns.
            unsafe {
                for half in [0, 16] {
                    let at = c + half;
                    let even = load(even.wrapping_add(at), cols.saturating_sub(at));
                    let odd = load(odd.wrapping_add(at), odd_cols.saturating_sub(at));
                    let pairs = interleave(even, odd);
                    _mm512_storeu_si512(out.add(2 * half).cast(), pairs);
                }
                out = out.wrapping_add(PANEL * dst.ns);
            }
        }
    }
    // After the matrix's last row, zeros up to the kernel's step.
    if k0 + rows == dst.k {
        let start = dst.k.next_multiple_of(2);
        let end = dst.k.next_multiple_of(depth);
        for c in (0..cols).step_by(PANEL) {
            // SAFETY: the padding of a panel that the caller owns.
            unsafe {
                let out = dst.ptr.add(start * dst.ks + (c0 + c) * dst.ns).cast_mut();
                out.write_bytes(0, (end - start) * PANEL);
            }
        }
    }
}

/// See `Kernel::pack_transposed`.
#[target_feature(enable = "avx512f,avx512bw,avx512vl,avx512bf16")]
pub(super) unsafe fn pack_transposed(
    src: &[f32],
    ld: usize,
    cols: usize,
    dst: View<u16>,
    c0: usize,
    depth: usize,
) {
    let k = dst.k;
    assert!(c0 + cols <= dst.n, "outside packing");
    assert!(
        cols == 0 || src.len() >= (cols - 1) * ld + k,
        "too few rows"
    );
    assert!(c0.is_multiple_of(PANEL));
    for c in (0..cols.next_multiple_of(PANEL)).step_by(16) {
        let inside = c % PANEL;
        // SAFETY: the caller owns these panels.
        let out = unsafe {
            dst.ptr
                .add((c0 + c - inside) * dst.ns + 2 * inside)
                .cast_mut()
        };
        for k0 in (0..k).step_by(32) {
            let mut block = [_mm512_setzero_si512(); 16];
            for (i, row) in block.iter_mut().enumerate().take(cols.saturating_sub(c)) {
                let src = src[(c + i) * ld + k0..].as_ptr();
                // SAFETY: masked to the k values of the row.
                *row = unsafe {
                    let high = load(src.wrapping_add(16), (k - k0).saturating_sub(16));
                    narrow(load(src, k - k0), high)
                };
            }
            let pairs = ((k - k0).next_multiple_of(depth) / 2).min(16);
            for (p, row) in transpose(block).into_iter().enumerate().take(pairs) {
                // SAFETY: pair k0/2 + p is inside the panel.
                unsafe {
                    let out = out.add((k0 / 2 + p) * 2 * PANEL);
                    _mm512_storeu_si512(out.cast(), row);
                }
            }
        }
    }
}

/// Rows `k0..k0 + depth` of a packed [k, n] as the tiled left operand [n, depth] of its transpose;
/// `k0` and `depth` are multiples of 32.
///
/// # Safety
/// `src` describes live memory, padded to 32 in k.
#[target_feature(enable = "avx512f")]
pub(super) unsafe fn turn(src: View<u16>, k0: usize, depth: usize, dst: &mut [u16]) {
    assert!(dst.len() >= src.n.next_multiple_of(16) * depth);
    for c in (0..src.n).step_by(16) {
        let inside = c % PANEL;
        for k in (0..depth).step_by(32) {
            let mut block = [_mm512_setzero_si512(); 16];
            // SAFETY: 16 pairs of 16 columns of a panel; 16 rows of 32 of a tile.
            unsafe {
                let from = src
                    .ptr
                    .add((k0 + k) * src.ks + (c - inside) * src.ns + 2 * inside);
                for (p, row) in block.iter_mut().enumerate() {
                    *row = _mm512_loadu_si512(from.add(p * 2 * PANEL).cast());
                }
                let to = dst.as_mut_ptr().add(c * depth + k * 16);
                for (r, row) in transpose(block).into_iter().enumerate() {
                    _mm512_storeu_si512(to.add(r * 32).cast(), row);
                }
            }
        }
    }
}

/// Transposes 16 x 16 values of 32 bits.
#[inline]
#[target_feature(enable = "avx512f")]
pub(super) fn transpose(x: [__m512i; 16]) -> [__m512i; 16] {
    let zero = _mm512_setzero_si512();
    // Within 128-bit lanes: pairs of rows, then fours.
    let mut y = [zero; 16];
    for i in 0..8 {
        y[2 * i] = _mm512_unpacklo_epi32(x[2 * i], x[2 * i + 1]);
        y[2 * i + 1] = _mm512_unpackhi_epi32(x[2 * i], x[2 * i + 1]);
    }
    // z[4g + c], lane l: column 4l + c of rows 4g..4g+4.
    let mut z = [zero; 16];
    for g in 0..4 {
        let y = &y[4 * g..4 * g + 4];
        z[4 * g] = _mm512_unpacklo_epi64(y[0], y[2]);
        z[4 * g + 1] = _mm512_unpackhi_epi64(y[0], y[2]);
        z[4 * g + 2] = _mm512_unpacklo_epi64(y[1], y[3]);
        z[4 * g + 3] = _mm512_unpackhi_epi64(y[1], y[3]);
    }
    // A 4 x 4 transpose of whole lanes for every c.
    let mut out = [zero; 16];
    for c in 0..4 {
        let (a, b, d, e) = (z[c], z[4 + c], z[8 + c], z[12 + c]);
        let ab_low = _mm512_shuffle_i32x4::<0x88>(a, b);
        let ab_high = _mm512_shuffle_i32x4::<0xDD>(a, b);
        let de_low = _mm512_shuffle_i32x4::<0x88>(d, e);
        let de_high = _mm512_shuffle_i32x4::<0xDD>(d, e);
        out[c] = _mm512_shuffle_i32x4::<0x88>(ab_low, de_low);
        out[8 + c] = _mm512_shuffle_i32x4::<0xDD>(ab_low, de_low);
        out[4 + c] = _mm512_shuffle_i32x4::<0x88>(ab_high, de_high);
        out[12 + c] = _mm512_shuffle_i32x4::<0xDD>(ab_high, de_high);
    }
    out
}
