//! f32 operands with AVX2 and FMA.
//!
//! Right operands are packed in panels of 16 columns: element (k, c) of a panel stands at `k * 16 + c`, so a step reads
//! one cache line. A micro-kernel keeps up to 6 x 16 sums in registers; each step takes two vectors of the panel and one
//! broadcast of every left row. Sums run over k in one order, whatever the number of rows.

use std::arch::x86_64::*;

use super::{Kernel, Lhs, View};
use crate::cpu::{Compute, Cpu, Isa};
use crate::softmax::exp_rows;

/// Depth of a block: a right panel of this depth (16 KiB) stays in the first-level cache while all left rows pass.
const DEPTH: usize = 256;
/// Rows of the largest micro-kernel: 12 sums, 2 right vectors and the broadcast fit 16 registers.
const ROWS: usize = 6;
/// Rows of a task where there are few.
const SHORT: usize = 32;
/// Columns of a panel.
const WIDTH: usize = 16;
/// Columns of a vector.
const LANES: usize = 8;

/// Exists only where AVX2 and FMA do.
#[derive(Clone, Copy)]
pub(crate) struct Avx2F32(());

impl Avx2F32 {
    /// # Panics
    /// If `compute` is for another family of instructions.
    pub fn new(compute: Compute) -> Self {
        assert_eq!(compute.cpu(), Cpu::Avx2);
        Self(())
    }
}

impl Kernel for Avx2F32 {
    type Elem = f32;
    const ROWS: usize = ROWS;

    fn isa(self) -> Isa {
        Isa::Avx2
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
        k * n.next_multiple_of(WIDTH)
    }

    fn view_rows(self, ptr: *const f32, k: usize, n: usize) -> View<f32> {
        let (ks, ns) = (WIDTH, k);
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
        assert!(k0 + rows <= dst.k && c0 + cols <= dst.n, "outside packing");
        for c in (0..cols).step_by(WIDTH) {
            let width = WIDTH.min(cols - c);
            for r in 0..rows {
                let src = &src[r * ld + c..][..width];
                // SAFETY: a row of a panel inside the packing, by the assertion; writable by the caller's promise.
                let dst = unsafe { panel_row(dst, k0 + r, c0 + c) };
                if width == WIDTH {
                    dst.copy_from_slice(src);
                } else {
                    dst[..width].copy_from_slice(src);
                    dst[width..].fill(0.0);
                }
            }
        }
    }

    unsafe fn pack_transposed(
        self,
        src: &[f32],
        ld: usize,
        cols: usize,
        dst: View<f32>,
        c0: usize,
    ) {
        assert!(c0 + cols <= dst.n, "outside packing");
        for c in (0..cols).step_by(WIDTH) {
            let width = WIDTH.min(cols - c);
            // In squares, so that every source line is used up while it is in cache.
            for k0 in (0..dst.k).step_by(WIDTH) {
                let depth = WIDTH.min(dst.k - k0);
                let mut square = [[0.0; WIDTH]; WIDTH];
                for i in 0..width {
                    let src = &src[(c + i) * ld + k0..][..depth];
                    for (row, &x) in square.iter_mut().zip(src) {
                        row[i] = x;
                    }
                }
                for (k, row) in square[..depth].iter().enumerate() {
                    // SAFETY: as above.
                    unsafe { panel_row(dst, k0 + k, c0 + c) }.copy_from_slice(row);
                }
            }
        }
    }

    unsafe fn gemm(self, a: Lhs<f32>, b: View<f32>, c: *mut f32, ldc: usize, add: bool) {
        // Equal blocks of k, rather than full ones and a rest; within a panel, so that its columns of C stay in cache.
        let blocks = b.k.div_ceil(DEPTH).max(1);
        let depth = b.k.div_ceil(blocks).max(1);
        for c0 in (0..b.n).step_by(WIDTH) {
            let cols = WIDTH.min(b.n - c0);
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

/// Row `k` of the panel that begins with column `c`.
///
/// # Safety
/// It is inside the packing, writable, and no other thread touches it.
unsafe fn panel_row<'a>(dst: View<f32>, k: usize, c: usize) -> &'a mut [f32; WIDTH] {
    // SAFETY: the caller's promise; panels are whole, whatever the number of columns.
    unsafe { &mut *dst.ptr.add(k * dst.ks + c * dst.ns).cast_mut().cast() }
}

/// All rows of C against one panel of at most 16 columns.
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
            // Equal steps, rather than full ones and a rest: sums of two rows wait for each other.
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
                // A panel's 16 rows as 6 + 5 + 5.
                let inside = i % WIDTH;
                let rows = if inside == 0 { 6 } else { 5 };
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
                _ => unreachable!("at most 6 rows"),
            }
        };
    }
    by_rows!(1 2 3 4 5 6)
}

/// C[MR, cols] (+)= A[MR, k] · panel, with `8 (NV-1) < cols <= 8 NV`. Rows of A are `lda` apart or, if packed,
/// neighbours.
#[allow(clippy::too_many_arguments)]
#[target_feature(enable = "avx2,fma")]
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
    let mut sums = [[_mm256_setzero_ps(); NV]; MR];
    // SAFETY: the operands hold k values of MR rows and k rows of a panel; C has MR rows of `cols`.
    unsafe {
        for i in 0..MR {
            _mm_prefetch::<_MM_HINT_T0>(c.add(i * ldc).cast());
        }
        for p in 0..k {
            let mut right = [_mm256_setzero_ps(); NV];
            for (j, right) in right.iter_mut().enumerate() {
                *right = _mm256_loadu_ps(panel.add(p * WIDTH + j * LANES));
            }
            for (i, sums) in sums.iter_mut().enumerate() {
                let at = if PACKED { p * WIDTH + i } else { i * lda + p };
                let left = _mm256_broadcast_ss(&*a.add(at));
                for (sum, right) in sums.iter_mut().zip(right) {
                    *sum = _mm256_fmadd_ps(left, right, *sum);
                }
            }
        }
        let lanes = _mm256_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7);
        for (i, sums) in sums.iter().enumerate() {
            for (j, &sum) in sums.iter().enumerate() {
                let (c, left) = (c.add(i * ldc + j * LANES), cols - j * LANES);
                if left >= LANES {
                    let sum = if add {
                        _mm256_add_ps(_mm256_loadu_ps(c), sum)
                    } else {
                        sum
                    };
                    _mm256_storeu_ps(c, sum);
                } else {
                    // Masks only where they must be: they are slow on some CPUs.
                    let mask = _mm256_cmpgt_epi32(_mm256_set1_epi32(left as i32), lanes);
                    let sum = if add {
                        _mm256_add_ps(_mm256_maskload_ps(c, mask), sum)
                    } else {
                        sum
                    };
                    _mm256_maskstore_ps(c, mask, sum);
                }
            }
        }
    }
}
