//! f32 operands with AVX-512.
//!
//! Right operands are packed in panels of 32 columns: element (k, c) of a panel stands at `k * 32 + c`, so a step reads
//! two cache lines. A micro-kernel keeps up to 12 x 32 sums in registers; each step takes two vectors of the panel and
//! one broadcast of every left row. Sums run over k in one order, whatever the number of rows.

use std::arch::x86_64::*;

use super::pack512::{first, load, transpose};
use super::{Kernel, Lhs, PANEL, View};
use crate::cpu::{Compute, Cpu, Isa};
use crate::simd::{AHEAD, prefetch};
use crate::softmax::exp_rows;

/// Depth of a block: a right panel of this depth (24 KiB) and a step of left rows (9 KiB) share the first-level cache
/// while all left rows pass.
const DEPTH: usize = 192;
/// Rows of the largest micro-kernel: 24 sums, 2 right vectors and the broadcast fit 32 registers.
const ROWS: usize = 12;
/// Rows of a task where there are few.
const SHORT: usize = 32;
/// Steps ahead in which panels are asked for where both operands are packed: sums over all tokens read them from far,
/// and a page is the end of the hardware's own prefetching.
const FURTHER: usize = 32;
/// Columns of a vector.
const LANES: usize = 16;

/// Exists only where AVX-512 F, BW, DQ and VL do.
#[derive(Clone, Copy)]
pub(crate) struct Avx512F32(());

impl Avx512F32 {
    /// # Panics
    /// If `compute` is for a family without AVX-512.
    pub fn new(compute: Compute) -> Self {
        match compute.cpu() {
            Cpu::Avx512F32 | Cpu::Avx512 | Cpu::Amx | Cpu::AmxEmulated => Self(()),
            other @ (Cpu::Avx2 | Cpu::Portable) => panic!("AVX-512 kernel for {other:?}"),
        }
    }
}

impl Kernel for Avx512F32 {
    type Elem = f32;
    const ROWS: usize = ROWS;

    fn isa(self) -> Isa {
        Isa::Avx512
    }

    /// Few tokens in an even number of equal tiles, so that two threads end together.
    fn row_tile(self, rows: usize) -> usize {
        match rows {
            0..=512 => super::equal_tiles(rows, SHORT),
            _ => Self::TALL,
        }
    }

    fn row_len(self, k: usize) -> usize {
        k
    }

    fn packed_len(self, k: usize, n: usize) -> usize {
        k * n.next_multiple_of(PANEL)
    }

    fn view_rows(self, ptr: *const f32, k: usize, n: usize) -> View<f32> {
        let (ks, ns) = (PANEL, k);
        View { ptr, ks, ns, k, n }
    }

    fn view_transposed(self, ptr: *const f32, k: usize, n: usize) -> View<f32> {
        self.view_rows(ptr, k, n)
    }

    fn to_rows(self, src: &[f32], ld: usize, rows: usize, cols: usize, dst: &mut [f32]) {
        super::copy_rows(src, ld, rows, cols, dst);
    }

    fn widen(self, src: &[f32], rows: usize, cols: usize, dst: &mut [f32]) {
        dst.copy_from_slice(&src[..rows * cols]);
    }

    fn exp_to_rows(self, s: &[f32], cols: usize, shift: &[f32], sums: &mut [f32], dst: &mut [f32]) {
        exp_rows(self.isa(), s, cols, shift, sums, dst);
    }

    unsafe fn pack_rows(
        self,
        src: &[f32],
        ld: usize,
        rows: usize,
        cols: usize,
        dst: View<f32>,
        k0: usize,
        c0: usize,
    ) {
        // SAFETY: `Self` exists only where the instructions do; the caller owns this part of `dst`.
        unsafe { pack_rows(src, ld, rows, cols, dst, k0, c0) }
    }

    unsafe fn pack_transposed(
        self,
        src: &[f32],
        ld: usize,
        cols: usize,
        dst: View<f32>,
        c0: usize,
    ) {
        // SAFETY: as above.
        unsafe { pack_transposed(src, ld, cols, dst, c0) }
    }

    unsafe fn gemm(self, a: Lhs<f32>, b: View<f32>, c: *mut f32, ldc: usize, add: bool) {
        // Equal blocks of k, rather than full ones and a rest; within a panel, so that its columns of C stay in cache.
        let blocks = b.k.div_ceil(DEPTH).max(1);
        let depth = b.k.div_ceil(blocks).max(1);
        for c0 in (0..b.n).step_by(PANEL) {
            let cols = PANEL.min(b.n - c0);
            for k0 in (0..b.k).step_by(depth) {
                let k = depth.min(b.k - k0);
                // SAFETY: inside the operands that the caller describes.
                unsafe {
                    let panel = b.ptr.add(k0 * b.ks + c0 * b.ns);
                    column(a.below(k0), k, panel, cols, c.add(c0), ldc, add || k0 > 0);
                }
            }
        }
    }
}

/// See `Kernel::pack_rows`.
#[target_feature(enable = "avx512f")]
unsafe fn pack_rows(
    src: &[f32],
    ld: usize,
    rows: usize,
    cols: usize,
    dst: View<f32>,
    k0: usize,
    c0: usize,
) {
    assert!(k0 + rows <= dst.k && c0 + cols <= dst.n, "outside packing");
    assert!(
        rows == 0 || src.len() >= (rows - 1) * ld + cols,
        "too few rows"
    );
    assert!(c0.is_multiple_of(PANEL));
    for c in (0..cols).step_by(PANEL) {
        let width = PANEL.min(cols - c);
        let mut from = src.as_ptr().wrapping_add(c);
        // SAFETY: inside the packing by the assertion.
        let mut to = unsafe { dst.ptr.add(k0 * dst.ks + (c0 + c) * dst.ns).cast_mut() };
        for _ in 0..rows {
            prefetch(from.wrapping_add(AHEAD * ld), width);
            // SAFETY: reads are masked to the row; a panel's rows are whole even where the matrix has fewer columns.
            unsafe {
                let high = load(from.wrapping_add(LANES), width.saturating_sub(LANES));
                _mm512_storeu_ps(to, load(from, width));
                _mm512_storeu_ps(to.add(LANES), high);
            }
            from = from.wrapping_add(ld);
            to = to.wrapping_add(PANEL);
        }
    }
}

/// See `Kernel::pack_transposed`.
#[target_feature(enable = "avx512f")]
unsafe fn pack_transposed(src: &[f32], ld: usize, cols: usize, dst: View<f32>, c0: usize) {
    let k = dst.k;
    assert!(c0 + cols <= dst.n, "outside packing");
    assert!(
        cols == 0 || src.len() >= (cols - 1) * ld + k,
        "too few rows"
    );
    assert!(c0.is_multiple_of(PANEL));
    for c in (0..cols).step_by(LANES) {
        let inside = c % PANEL;
        let from = src.as_ptr().wrapping_add(c * ld);
        // SAFETY: inside the packing by the assertion.
        let to = unsafe { dst.ptr.add((c0 + c - inside) * dst.ns + inside).cast_mut() };
        for k0 in (0..k).step_by(LANES) {
            let mut square = [_mm512_setzero_si512(); LANES];
            for (i, row) in square.iter_mut().enumerate().take(cols - c) {
                // SAFETY: masked to the k values of the row.
                *row = _mm512_castps_si512(unsafe { load(from.wrapping_add(i * ld + k0), k - k0) });
            }
            for (p, row) in transpose(square).into_iter().enumerate().take(k - k0) {
                // SAFETY: row k0 + p of the panel, which the caller owns.
                unsafe { _mm512_storeu_si512(to.add((k0 + p) * PANEL).cast(), row) };
            }
        }
    }
}

/// All rows of C against one panel of at most 32 columns.
unsafe fn column(
    a: Lhs<f32>,
    k: usize,
    panel: *const f32,
    cols: usize,
    c: *mut f32,
    ldc: usize,
    add: bool,
) {
    let mut i = 0;
    match a {
        Lhs::Rows { ptr, ld, m } => {
            // Equal steps, rather than full ones and a rest: sums of few rows wait for each other.
            let steps = m.div_ceil(ROWS);
            for step in 0..steps {
                let rows = m / steps + usize::from(step < m % steps);
                // SAFETY: rows i.. of the operands.
                unsafe {
                    let a = ptr.add(i * ld);
                    dispatch::<false>(rows, k, a, ld, panel, cols, c.add(i * ldc), ldc, add);
                }
                i += rows;
            }
        }
        Lhs::Packed(view) => {
            while i < view.n {
                // A panel's 32 rows as 11 + 11 + 10.
                let inside = i % PANEL;
                let rows = if inside < 22 { 11 } else { 10 };
                let rows = rows.min(view.n - i);
                // SAFETY: rows i.. of the operands.
                unsafe {
                    let a = view.ptr.add((i - inside) * view.ns + inside);
                    dispatch::<true>(rows, k, a, 0, panel, cols, c.add(i * ldc), ldc, add);
                }
                i += rows;
            }
        }
    }
}

#[allow(clippy::too_many_arguments)]
#[inline(always)]
unsafe fn dispatch<const PACKED: bool>(
    rows: usize,
    k: usize,
    a: *const f32,
    lda: usize,
    panel: *const f32,
    cols: usize,
    c: *mut f32,
    ldc: usize,
    add: bool,
) {
    macro_rules! by_rows {
        ($($n:literal)*) => {
            match (rows, cols > LANES) {
                // SAFETY: the caller's promise; the kernel exists only with the instructions.
                $(($n, true) => unsafe { micro::<$n, 2, PACKED>(k, a, lda, panel, cols, c, ldc, add) },
                ($n, false) => unsafe { micro::<$n, 1, PACKED>(k, a, lda, panel, cols, c, ldc, add) },)*
                _ => unreachable!("at most 12 rows"),
            }
        };
    }
    by_rows!(1 2 3 4 5 6 7 8 9 10 11 12)
}

/// C[MR, cols] (+)= A[MR, k] · panel, with `16 (NV-1) < cols <= 16 NV`. Rows of A are `lda` apart or, if packed,
/// neighbours.
#[allow(clippy::too_many_arguments)]
#[target_feature(enable = "avx512f")]
unsafe fn micro<const MR: usize, const NV: usize, const PACKED: bool>(
    k: usize,
    a: *const f32,
    lda: usize,
    panel: *const f32,
    cols: usize,
    c: *mut f32,
    ldc: usize,
    add: bool,
) {
    let mut sums = [[_mm512_setzero_ps(); NV]; MR];
    // SAFETY: the operands hold k values of MR rows and k rows of a panel; C has MR rows of `cols`.
    unsafe {
        for i in 0..MR {
            for j in 0..NV {
                _mm_prefetch::<_MM_HINT_T0>(c.wrapping_add(i * ldc + j * LANES).cast());
            }
        }
        for p in 0..k {
            let mut right = [_mm512_setzero_ps(); NV];
            for (j, right) in right.iter_mut().enumerate() {
                let panel = panel.wrapping_add(p * PANEL + j * LANES);
                *right = _mm512_loadu_ps(panel);
                if PACKED {
                    _mm_prefetch::<_MM_HINT_T0>(panel.wrapping_add(FURTHER * PANEL).cast());
                }
            }
            if PACKED {
                _mm_prefetch::<_MM_HINT_T0>(a.wrapping_add((p + FURTHER) * PANEL).cast());
            }
            for (i, sums) in sums.iter_mut().enumerate() {
                let at = if PACKED { p * PANEL + i } else { i * lda + p };
                let left = _mm512_set1_ps(*a.add(at));
                for (sum, right) in sums.iter_mut().zip(right) {
                    *sum = _mm512_fmadd_ps(left, right, *sum);
                }
            }
        }
        for (i, sums) in sums.iter().enumerate() {
            for (j, &sum) in sums.iter().enumerate() {
                let mask = first(cols - j * LANES);
                let c = c.add(i * ldc + j * LANES);
                let sum = if add {
                    _mm512_add_ps(sum, _mm512_maskz_loadu_ps(mask, c))
                } else {
                    sum
                };
                _mm512_mask_storeu_ps(c, mask, sum);
            }
        }
    }
}
