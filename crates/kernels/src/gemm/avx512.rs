//! bf16 operands, f32 sums, with AVX-512 `vdpbf16ps`.
//!
//! Operands are packed in panels of 32 columns whose rows are pairs of k (the order `vdpbf16ps`
//! reads): element (k, c) of a panel stands at `k/2 * 64 + c * 2 + k%2`. A micro-kernel keeps up to
//! 12 x 32 sums in registers; each step takes two vectors of the right panel and one broadcast
//! pair of every left row.

use std::arch::x86_64::*;

use super::{Kernel, Lhs, PANEL, View};
use super::{exp512, pack512};
use crate::cpu::{Compute, Cpu, Isa};

/// Depth of a block: a right panel of this depth (24 KiB) stays in the first-level cache while all
/// left rows pass.
const DEPTH: usize = 384;
/// Rows of the largest micro-kernel: 24 sums, 2 right vectors and the broadcast fit 32 registers.
const ROWS: usize = 12;
/// u16 elements between pairs of k in a panel.
const PAIR: usize = 2 * PANEL;

/// Exists only where AVX-512 BF16 does.
#[derive(Clone, Copy)]
pub(crate) struct Avx512Bf16(());

impl Avx512Bf16 {
    /// # Panics
    /// If `compute` is for another family of instructions.
    pub fn new(compute: Compute) -> Self {
        assert_eq!(compute.cpu(), Cpu::Avx512);
        Self(())
    }
}

impl Kernel for Avx512Bf16 {
    type Elem = u16;
    const ROWS: usize = ROWS;

    fn isa(self) -> Isa {
        Isa::Avx512
    }

    fn row_len(self, k: usize) -> usize {
        k.next_multiple_of(2)
    }

    fn packed_len(self, k: usize, n: usize) -> usize {
        k.next_multiple_of(2) * n.next_multiple_of(PANEL)
    }

    fn view_rows(self, ptr: *const u16, k: usize, n: usize) -> View<u16> {
        let (ks, ns) = (PANEL, k.next_multiple_of(2));
        View { ptr, ks, ns, k, n }
    }

    fn view_transposed(self, ptr: *const u16, k: usize, n: usize) -> View<u16> {
        self.view_rows(ptr, k, n)
    }

    fn to_rows(self, src: &[f32], ld: usize, rows: usize, cols: usize, dst: &mut [u16]) {
        // SAFETY: `Self` exists only where the instructions do.
        unsafe { pack512::to_rows::<false>(src, ld, rows, cols, dst) }
    }

    fn widen(self, src: &[u16], rows: usize, cols: usize, dst: &mut [f32]) {
        // SAFETY: as above.
        unsafe { pack512::widen::<false>(src, rows, cols, dst) }
    }

    fn exp_to_rows(self, s: &[f32], cols: usize, shift: &[f32], sums: &mut [f32], dst: &mut [u16]) {
        // SAFETY: as above.
        unsafe { exp512::exp_to_rows::<false>(s, cols, shift, sums, dst) }
    }

    unsafe fn pack_rows(
        self,
        src: &[f32],
        ld: usize,
        rows: usize,
        cols: usize,
        dst: View<u16>,
        k0: usize,
        c0: usize,
    ) {
        // SAFETY: as above; the caller owns this part of `dst`.
        unsafe { pack512::pack_rows(src, ld, rows, cols, dst, k0, c0, 2) }
    }

    unsafe fn pack_transposed(
        self,
        src: &[f32],
        ld: usize,
        cols: usize,
        dst: View<u16>,
        c0: usize,
    ) {
        // SAFETY: as above; the caller owns this part of `dst`.
        unsafe { pack512::pack_transposed(src, ld, cols, dst, c0, 2) }
    }

    unsafe fn gemm(self, a: Lhs<u16>, b: View<u16>, c: *mut f32, ldc: usize, add: bool) {
        // Equal blocks of k, rather than full ones and a rest.
        let blocks = b.k.div_ceil(DEPTH).max(1);
        let depth = b.k.div_ceil(blocks).next_multiple_of(2);
        let mut k0 = 0;
        while k0 < b.k {
            let k = depth.min(b.k - k0);
            let add = add || k0 > 0;
            for c0 in (0..b.n).step_by(PANEL) {
                // SAFETY: inside the operands that the caller describes.
                unsafe {
                    let panel = b.ptr.add(k0 * b.ks + c0 * b.ns);
                    column(
                        a.below(k0),
                        k,
                        panel,
                        (b.n - c0).min(PANEL),
                        c.add(c0),
                        ldc,
                        add,
                    );
                }
            }
            k0 += k;
        }
    }
}

/// All rows of C against one panel of at most 32 columns.
unsafe fn column(
    a: Lhs<u16>,
    k: usize,
    panel: *const u16,
    cols: usize,
    c: *mut f32,
    ldc: usize,
    add: bool,
) {
    let pairs = k.div_ceil(2);
    let mut i = 0;
    match a {
        Lhs::Rows { ptr, ld, m } => {
            while i < m {
                let rows = ROWS.min(m - i);
                // SAFETY: rows i.. of the operands.
                unsafe {
                    let a = Left {
                        ptr: ptr.add(i * ld).cast(),
                        row: ld / 2,
                    };
                    dispatch::<false>(rows, pairs, a, panel, cols, c.add(i * ldc), ldc, add);
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
                    let ptr = view.ptr.add((i - inside) * view.ns + inside * 2);
                    let a = Left {
                        ptr: ptr.cast(),
                        row: 0,
                    };
                    dispatch::<true>(rows, pairs, a, panel, cols, c.add(i * ldc), ldc, add);
                }
                i += rows;
            }
        }
    }
}

/// Rows of the left operand, as pairs of bf16.
#[derive(Clone, Copy)]
struct Left {
    ptr: *const i32,
    /// Pairs between rows; not read if packed, where rows are neighbours.
    row: usize,
}

#[allow(clippy::too_many_arguments)]
#[inline(always)]
unsafe fn dispatch<const PACKED: bool>(
    rows: usize,
    pairs: usize,
    a: Left,
    panel: *const u16,
    cols: usize,
    c: *mut f32,
    ldc: usize,
    add: bool,
) {
    macro_rules! by_rows {
        ($($n:literal)*) => {
            match (rows, cols > 16) {
                // SAFETY: the caller's promise; the kernel exists only with the instructions.
                $(($n, true) => unsafe { micro::<$n, 2, PACKED>(pairs, a, panel, cols, c, ldc, add) },
                ($n, false) => unsafe { micro::<$n, 1, PACKED>(pairs, a, panel, cols, c, ldc, add) },)*
                _ => unreachable!("at most 12 rows"),
            }
        };
    }
    by_rows!(1 2 3 4 5 6 7 8 9 10 11 12)
}

/// C[MR, cols] (+)= A[MR, 2 pairs] · panel, with `16 (NV-1) < cols <= 16 NV`.
#[target_feature(enable = "avx512f,avx512bw,avx512vl,avx512bf16")]
unsafe fn micro<const MR: usize, const NV: usize, const PACKED: bool>(
    pairs: usize,
    a: Left,
    panel: *const u16,
    cols: usize,
    c: *mut f32,
    ldc: usize,
    add: bool,
) {
    let mut sums = [[_mm512_setzero_ps(); NV]; MR];
    // SAFETY: the operands hold `pairs` pairs of MR rows and of a panel; C has MR rows of `cols`.
    unsafe {
        for p in 0..pairs {
            let mut right = [_mm512_setzero_si512(); NV];
            for (j, right) in right.iter_mut().enumerate() {
                *right = _mm512_load_si512(panel.add(p * PAIR + j * 32).cast());
            }
            for (i, sums) in sums.iter_mut().enumerate() {
                let at = if PACKED { p * PANEL + i } else { i * a.row + p };
                let left = _mm512_set1_epi32(a.ptr.add(at).read_unaligned());
                for (sum, right) in sums.iter_mut().zip(right) {
                    *sum = _mm512_dpbf16_ps(*sum, bf16(left), bf16(right));
                }
            }
        }
        let last = 0xFFFF_u16 >> (16 * NV - cols);
        for (i, sums) in sums.iter().enumerate() {
            for (j, sum) in sums.iter().enumerate() {
                let mask = if j + 1 == NV { last } else { 0xFFFF };
                let c = c.add(i * ldc + j * 16);
                let sum = if add {
                    _mm512_add_ps(*sum, _mm512_maskz_loadu_ps(mask, c))
                } else {
                    *sum
                };
                _mm512_mask_storeu_ps(c, mask, sum);
            }
        }
    }
}

#[inline]
#[target_feature(enable = "avx512f")]
fn bf16(x: __m512i) -> __m512bh {
    // SAFETY: both are 512 bits without invalid values.
    unsafe { std::mem::transmute(x) }
}
