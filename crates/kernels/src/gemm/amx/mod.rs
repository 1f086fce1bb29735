//! bf16 operands, f32 sums, with AMX tiles (`tdpbf16ps`).
//!
//! Right operands are packed as for AVX-512 (`avx512.rs`), with k padded to a step of 32. Left rows
//! stand in strips of 16, each strip a run of tiles of 16 rows by 32 k, so that every tile load
//! reads one kilobyte from end to end.

mod detect;
mod tiles;
#[cfg(all(test, target_os = "linux"))]
mod trap;

pub(crate) use detect::available;

use super::{Kernel, Lhs, PANEL, View, exp512, pack512};
use crate::buffer::Buf;
use crate::cpu::{Compute, Cpu, Isa};
use tiles::{Block, LEFT, RIGHT, STEP, TILE, TileFn};

/// Steps of k between visits of C: two strips of rows and a panel of this depth (16 KiB each) share
/// the first-level cache.
const STEPS: usize = 8;
/// Side of a block.
const SIDE: usize = 2 * TILE;

/// Exists only where `Cpu::Amx` or `Cpu::AmxEmulated` is supported.
#[derive(Clone, Copy)]
pub(crate) struct AmxBf16 {
    tiles: TileFn,
    hardware: bool,
}

impl AmxBf16 {
    /// # Panics
    /// If `compute` is for another family of instructions.
    pub fn new(compute: Compute) -> Self {
        let hardware = match compute.cpu() {
            Cpu::Amx => true,
            Cpu::AmxEmulated => false,
            other => panic!("AMX kernel for {other:?}"),
        };
        let tiles = if hardware {
            tiles::hardware
        } else {
            tiles::emulated
        };
        Self { tiles, hardware }
    }

    /// C's rows from the strips of `a` (each `strip` elements), against one panel.
    ///
    /// # Safety
    /// As for `Kernel::gemm`, with `m` rows and `cols` columns of C.
    #[allow(clippy::too_many_arguments)]
    unsafe fn column(
        self,
        a: *const u16,
        strip: usize,
        m: usize,
        b: *const u16,
        steps: usize,
        cols: usize,
        c: *mut f32,
        ldc: usize,
        add: bool,
    ) {
        for r in (0..m).step_by(SIDE) {
            let rows = SIDE.min(m - r);
            // SAFETY: strips up to the one that holds row m - 1 exist; C's part is inside.
            unsafe {
                let first = a.add(r / TILE * strip);
                let rows2 = rows > TILE;
                let block = Block {
                    a: [first, if rows2 { first.add(strip) } else { first }],
                    b,
                    c: c.add(r * ldc),
                    ldc,
                    steps,
                    add,
                    rows2,
                    cols2: cols > TILE,
                };
                if rows.is_multiple_of(TILE) && cols.is_multiple_of(TILE) {
                    (self.tiles)(&block);
                } else {
                    self.edge(block, rows, cols);
                }
            }
        }
    }

    /// A block of which C holds only `rows` x `cols`: computed aside, in the order of a whole
    /// block, so that an element has the same bits wherever the edges are.
    #[cold]
    unsafe fn edge(self, block: Block, rows: usize, cols: usize) {
        let mut side = [0.0f32; SIDE * SIDE];
        // SAFETY: the operands are padded to whole tiles; C's part is the caller's.
        let line =
            |r: usize| unsafe { std::slice::from_raw_parts_mut(block.c.add(r * block.ldc), cols) };
        if block.add {
            for (r, side) in side.chunks_exact_mut(SIDE).enumerate().take(rows) {
                side[..cols].copy_from_slice(line(r));
            }
        }
        let whole = Block {
            c: side.as_mut_ptr(),
            ldc: SIDE,
            ..block
        };
        // SAFETY: as above; `side` is a whole block.
        unsafe { (self.tiles)(&whole) };
        for (r, side) in side.chunks_exact(SIDE).enumerate().take(rows) {
            line(r).copy_from_slice(&side[..cols]);
        }
    }
}

impl Kernel for AmxBf16 {
    type Elem = u16;
    const ROWS: usize = SIDE;
    const TALL: usize = 128;

    fn isa(self) -> Isa {
        Isa::Avx512
    }

    fn row_len(self, k: usize) -> usize {
        k.next_multiple_of(STEP)
    }

    fn rows_len(self, rows: usize, k: usize) -> usize {
        rows.next_multiple_of(TILE) * self.row_len(k)
    }

    fn packed_len(self, k: usize, n: usize) -> usize {
        k.next_multiple_of(STEP) * n.next_multiple_of(PANEL)
    }

    fn view_rows(self, ptr: *const u16, k: usize, n: usize) -> View<u16> {
        let (ks, ns) = (PANEL, k.next_multiple_of(STEP));
        View { ptr, ks, ns, k, n }
    }

    fn view_transposed(self, ptr: *const u16, k: usize, n: usize) -> View<u16> {
        self.view_rows(ptr, k, n)
    }

    fn to_rows(self, src: &[f32], ld: usize, rows: usize, cols: usize, dst: &mut [u16]) {
        // SAFETY: `Self` exists only where the AVX-512 instructions do.
        unsafe { pack512::to_rows::<true>(src, ld, rows, cols, dst) }
    }

    fn widen(self, src: &[u16], rows: usize, cols: usize, dst: &mut [f32]) {
        // SAFETY: as above.
        unsafe { pack512::widen::<true>(src, rows, cols, dst) }
    }

    fn exp_to_rows(self, s: &[f32], cols: usize, shift: &[f32], sums: &mut [f32], dst: &mut [u16]) {
        // SAFETY: as above.
        unsafe { exp512::exp_to_rows::<true>(s, cols, shift, sums, dst) }
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
        unsafe { pack512::pack_rows(src, ld, rows, cols, dst, k0, c0, STEP) }
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
        unsafe { pack512::pack_transposed(src, ld, cols, dst, c0, STEP) }
    }

    unsafe fn gemm(self, a: Lhs<u16>, b: View<u16>, c: *mut f32, ldc: usize, add: bool) {
        if self.hardware {
            // SAFETY: `Self` with `hardware` exists only after detection.
            unsafe { detect::prepare_thread() };
        }
        // Equal runs of steps, rather than full ones and a rest.
        let all = b.k.div_ceil(STEP);
        let run = all.div_ceil(all.div_ceil(STEPS).max(1));
        let mut turned = match a {
            Lhs::Rows { .. } => None,
            Lhs::Packed(view) => Some(Buf::new(self.rows_len(view.n, run * STEP))),
        };
        for first in (0..all).step_by(run.max(1)) {
            let steps = run.min(all - first);
            // SAFETY: inside the operands that the caller describes.
            unsafe {
                let (left, strip, m) = match a {
                    Lhs::Rows { ptr, ld, m } => (ptr.add(first * LEFT), TILE * ld, m),
                    Lhs::Packed(view) => {
                        let dst = turned.as_mut().expect("made for packed operands");
                        pack512::turn(view, first * STEP, steps * STEP, dst);
                        (dst.as_ptr(), TILE * steps * STEP, view.n)
                    }
                };
                for c0 in (0..b.n).step_by(PANEL) {
                    let panel = b.ptr.add(first * RIGHT + c0 * b.ns);
                    let cols = PANEL.min(b.n - c0);
                    let add = add || first > 0;
                    self.column(left, strip, m, panel, steps, cols, c.add(c0), ldc, add);
                }
            }
        }
    }
}
