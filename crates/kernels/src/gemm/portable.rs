//! f32 operands through the `gemm` crate; "packing" keeps plain rows, which it packs itself.

use super::{Kernel, Lhs, View};
use crate::cpu::{Compute, Isa};
use crate::softmax::exp_rows;

/// Side of the squares in which matrices are transposed.
const SQUARE: usize = 16;

#[derive(Clone, Copy)]
pub(crate) struct PortableF32 {
    isa: Isa,
}

impl PortableF32 {
    pub fn new(compute: Compute) -> Self {
        Self { isa: compute.isa() }
    }
}

impl Kernel for PortableF32 {
    type Elem = f32;
    const ROWS: usize = 12;

    fn isa(self) -> Isa {
        self.isa
    }

    fn row_len(self, k: usize) -> usize {
        k
    }

    fn packed_len(self, k: usize, n: usize) -> usize {
        k * n
    }

    fn view_rows(self, ptr: *const f32, k: usize, n: usize) -> View<f32> {
        let (ks, ns) = (n, 1);
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
        for r in 0..rows {
            let src = &src[r * ld..][..cols];
            // SAFETY: inside the packing by the assertion; writable by the caller's promise.
            unsafe {
                let dst = dst.ptr.add((k0 + r) * dst.ks + c0).cast_mut();
                src.as_ptr().copy_to_nonoverlapping(dst, cols);
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
        // In squares that stay in cache. The library would read [n, k] as well, but would then
        // reorder it on every call.
        for k0 in (0..dst.k).step_by(SQUARE) {
            for s0 in (0..cols).step_by(SQUARE) {
                for k in k0..dst.k.min(k0 + SQUARE) {
                    for c in s0..cols.min(s0 + SQUARE) {
                        // SAFETY: inside the packing by the assertion; writable by the caller's
                        // promise.
                        unsafe {
                            let dst = dst.ptr.add(k * dst.ks + c0 + c).cast_mut();
                            dst.write(src[c * ld + k]);
                        }
                    }
                }
            }
        }
    }

    unsafe fn gemm(self, a: Lhs<f32>, b: View<f32>, c: *mut f32, ldc: usize, add: bool) {
        let (a, lhs_rs, lhs_cs, m) = match a {
            Lhs::Rows { ptr, ld, m } => (ptr, ld, 1, m),
            Lhs::Packed(view) => (view.ptr, view.ns, view.ks, view.n),
        };
        if m == 0 || b.n == 0 {
            return;
        }
        // SAFETY: shapes and strides describe live memory by the caller's promise.
        unsafe {
            gemm::gemm(
                m,
                b.n,
                b.k,
                c,
                1,
                ldc as isize,
                add,
                a,
                lhs_cs as isize,
                lhs_rs as isize,
                b.ptr,
                b.ns as isize,
                b.ks as isize,
                1.0,
                1.0,
                false,
                false,
                false,
                gemm::Parallelism::None,
            );
        }
    }
}
