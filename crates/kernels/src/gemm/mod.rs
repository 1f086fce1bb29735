//! Matrix products over packed operands.
//!
//! A `Kernel` is one way to multiply: it owns the element type of operands, how they are packed
//! and the micro-kernels. All products are `C[m,n] (+)= A[m,k] · B[k,n]`, with C in f32. B is always
//! packed; A is either plain rows (activations) or packed with k as its row index, as the
//! gradients of weights need it (`Aᵀ·B` of two token-major matrices).

mod portable;

#[cfg(target_arch = "x86_64")]
pub(crate) mod amx;
#[cfg(target_arch = "x86_64")]
mod avx2;
#[cfg(target_arch = "x86_64")]
mod avx512;
#[cfg(target_arch = "x86_64")]
mod avx512f32;
#[cfg(target_arch = "x86_64")]
mod exp512;
#[cfg(target_arch = "x86_64")]
mod pack512;

#[cfg(target_arch = "x86_64")]
pub(crate) use amx::AmxBf16;
#[cfg(target_arch = "x86_64")]
pub(crate) use avx2::Avx2F32;
#[cfg(target_arch = "x86_64")]
pub(crate) use avx512::Avx512Bf16;
#[cfg(target_arch = "x86_64")]
pub(crate) use avx512f32::Avx512F32;
pub(crate) use portable::PortableF32;

use crate::buffer::{Buf, Plain};
use crate::cpu::{Compute, Isa};
use crate::threads::{Shared, par_tiles};

/// Columns of a packed panel; offsets into packed matrices are multiples of it.
pub(crate) const PANEL: usize = 32;

/// Runs `$body` with `$k` bound to the kernel that `$compute` asks for.
macro_rules! with_kernel {
    ($compute:expr, $k:ident => $body:expr) => {{
        let compute: $crate::cpu::Compute = $compute;
        match (compute.cpu(), compute.precision()) {
            #[cfg(target_arch = "x86_64")]
            ($crate::cpu::Cpu::Avx512, $crate::cpu::Precision::Bf16) => {
                // `Compute` exists only for supported instructions.
                let $k = $crate::gemm::Avx512Bf16::new(compute);
                $body
            }
            #[cfg(target_arch = "x86_64")]
            (
                $crate::cpu::Cpu::Amx | $crate::cpu::Cpu::AmxEmulated,
                $crate::cpu::Precision::Bf16,
            ) => {
                let $k = $crate::gemm::AmxBf16::new(compute);
                $body
            }
            #[cfg(target_arch = "x86_64")]
            (
                $crate::cpu::Cpu::Avx512F32
                | $crate::cpu::Cpu::Avx512
                | $crate::cpu::Cpu::Amx
                | $crate::cpu::Cpu::AmxEmulated,
                _,
            ) => {
                let $k = $crate::gemm::Avx512F32::new(compute);
                $body
            }
            #[cfg(target_arch = "x86_64")]
            ($crate::cpu::Cpu::Avx2, _) => {
                let $k = $crate::gemm::Avx2F32::new(compute);
                $body
            }
            _ => {
                let $k = $crate::gemm::PortableF32::new(compute);
                $body
            }
        }
    }};
}
pub(crate) use with_kernel;

/// A packed matrix [k, n], or a part of one. Element (k0, c0) of the packing stands at
/// `k0 * ks + c0 * ns` for even `k0` and `c0` a multiple of `PANEL`.
pub(crate) struct View<E> {
    pub ptr: *const E,
    pub ks: usize,
    pub ns: usize,
    pub k: usize,
    pub n: usize,
}

impl<E> Clone for View<E> {
    fn clone(&self) -> Self {
        *self
    }
}
impl<E> Copy for View<E> {}
// SAFETY: a view only reads; whoever makes one keeps its buffer alive and unwritten.
unsafe impl<E: Sync> Send for View<E> {}
// SAFETY: as above.
unsafe impl<E: Sync> Sync for View<E> {}

impl<E> View<E> {
    /// Rows `k0..k0 + k` and columns `c0..c0 + n`; `k0` and `c0` are multiples of 32, and so is `k`
    /// unless these are the last rows.
    pub fn part(self, k0: usize, k: usize, c0: usize, n: usize) -> Self {
        debug_assert!(k0.is_multiple_of(32) && c0.is_multiple_of(PANEL));
        debug_assert!(k0 + k <= self.k && c0 + n <= self.n);
        Self {
            ptr: self.ptr.wrapping_add(k0 * self.ks + c0 * self.ns),
            k,
            n,
            ..self
        }
    }

    pub fn cols(self, c0: usize, n: usize) -> Self {
        self.part(0, self.k, c0, n)
    }
}

/// The left operand.
pub(crate) enum Lhs<E> {
    /// [m, k] as `Kernel::to_rows` writes it, with rows of `ld` elements.
    Rows { ptr: *const E, ld: usize, m: usize },
    /// Packed [k, m].
    Packed(View<E>),
}

impl<E> Lhs<E> {
    /// What is left from depth `k0` on; where the kernel packs k in steps, `k0` is a multiple of them.
    ///
    /// # Safety
    /// `k0` is inside the operand.
    unsafe fn below(&self, k0: usize) -> Self {
        // SAFETY: the caller's promise.
        unsafe {
            match *self {
                Self::Rows { ptr, ld, m } => Self::Rows {
                    ptr: ptr.add(k0),
                    ld,
                    m,
                },
                Self::Packed(view) => Self::Packed(View {
                    ptr: view.ptr.add(k0 * view.ks),
                    ..view
                }),
            }
        }
    }
}

/// One way to multiply matrices.
pub(crate) trait Kernel: Copy + Send + Sync + 'static {
    /// Element of packed operands.
    type Elem: Element;

    /// Rows of the largest micro-kernel.
    const ROWS: usize;

    /// Rows of tokens per task where there are many: what the weights, read once per task, and the
    /// second-level cache ask for.
    const TALL: usize = 96;

    /// Instruction set for the row-wise passes around the products.
    fn isa(self) -> Isa;

    /// Elements of a row of k values of a left operand, zero-padded as the micro-kernels need it.
    fn row_len(self, k: usize) -> usize;

    /// Elements of a left operand [rows, k].
    fn rows_len(self, rows: usize, k: usize) -> usize {
        rows * self.row_len(k)
    }

    /// The left operand [m, k] that `to_rows` wrote.
    fn left(self, rows: &[Self::Elem], m: usize, k: usize) -> Lhs<Self::Elem> {
        assert!(rows.len() >= self.rows_len(m, k), "left operand: too short");
        Lhs::Rows {
            ptr: rows.as_ptr(),
            ld: self.row_len(k),
            m,
        }
    }

    /// Rows of tokens per task: enough to reuse the weights from cache, few enough to share out.
    /// Even, because bf16 packs rows in pairs.
    fn row_tile(self, rows: usize) -> usize {
        match rows {
            0..=512 => 24usize.next_multiple_of(Self::ROWS),
            _ => Self::TALL,
        }
    }

    /// Elements of a packed [k, n].
    fn packed_len(self, k: usize, n: usize) -> usize;

    /// The packing of [k, n] that `pack_rows` fills.
    fn view_rows(self, buf: *const Self::Elem, k: usize, n: usize) -> View<Self::Elem>;

    /// The packing of [k, n] that `pack_transposed` fills.
    fn view_transposed(self, buf: *const Self::Elem, k: usize, n: usize) -> View<Self::Elem>;

    /// Where the left operand of rows `t..` starts when tiles of `tile` rows of k values follow each
    /// other.
    fn tile_at(self, t: usize, tile: usize, k: usize) -> usize {
        t / tile * self.rows_len(tile, k) + self.rows_len(t % tile, k)
    }

    /// Converts `rows` rows of `cols` values (stride `ld`) to a left operand of
    /// `rows_len(rows, cols)` elements.
    fn to_rows(self, src: &[f32], ld: usize, rows: usize, cols: usize, dst: &mut [Self::Elem]);

    /// Converts what `to_rows` wrote back to dense rows.
    fn widen(self, src: &[Self::Elem], rows: usize, cols: usize, dst: &mut [f32]);

    /// `dst = exp(s - shift[row])` as a left operand; adds each row's sum to `sums`, one per row. `s`: [rows, cols].
    fn exp_to_rows(
        self,
        s: &[f32],
        cols: usize,
        shift: &[f32],
        sums: &mut [f32],
        dst: &mut [Self::Elem],
    );

    /// Packs `rows` x `cols` values (stride `ld`) as rows `k0..`, columns `c0..` of the matrix
    /// seen by `dst`. `k0` is even; so is `rows` unless these are the last rows, after which
    /// zeros fill the kernel's step. `c0` is a multiple of `PANEL`.
    ///
    /// # Safety
    /// `dst` is a `view_rows` of a writable buffer, and no other thread touches these elements.
    #[allow(clippy::too_many_arguments)] // A matrix and a place are four numbers each.
    unsafe fn pack_rows(
        self,
        src: &[f32],
        ld: usize,
        rows: usize,
        cols: usize,
        dst: View<Self::Elem>,
        k0: usize,
        c0: usize,
    );

    /// Packs columns `c0..c0 + cols` of the [k, n] matrix seen by `dst` from its transpose:
    /// `src` holds these `cols` rows of k values with stride `ld`.
    ///
    /// # Safety
    /// As for `pack_rows`, with a `view_transposed`.
    unsafe fn pack_transposed(
        self,
        src: &[f32],
        ld: usize,
        cols: usize,
        dst: View<Self::Elem>,
        c0: usize,
    );

    /// `C = A·B`, or `C += A·B` if `add`. C has `b.n` columns and row stride `ldc`.
    ///
    /// # Safety
    /// The operands describe live memory, C's rows are writable and not shared.
    unsafe fn gemm(
        self,
        a: Lhs<Self::Elem>,
        b: View<Self::Elem>,
        c: *mut f32,
        ldc: usize,
        add: bool,
    );
}

/// Rows of a tile where there are few, in an even number of equal tiles of about `short`; even itself.
#[cfg(target_arch = "x86_64")]
fn equal_tiles(rows: usize, short: usize) -> usize {
    let rows = rows.max(1);
    let pairs = rows.div_ceil(2 * short);
    rows.div_ceil(2 * pairs).next_multiple_of(2)
}

/// `to_rows` where operands are plain rows of f32.
fn copy_rows(src: &[f32], ld: usize, rows: usize, cols: usize, dst: &mut [f32]) {
    if ld == cols {
        return dst[..rows * cols].copy_from_slice(&src[..rows * cols]);
    }
    for r in 0..rows {
        dst[r * cols..][..cols].copy_from_slice(&src[r * ld..][..cols]);
    }
}

/// Operand elements, and the way a value of unknown precision holds a buffer of them.
pub(crate) trait Element: Plain {
    fn wrap(buf: Buf<Self>) -> AnyBuf;
    fn unwrap(buf: &AnyBuf) -> &Buf<Self>;
}

/// A buffer of either element type.
pub(crate) enum AnyBuf {
    F32(Buf<f32>),
    Bf16(Buf<u16>),
}

impl AnyBuf {
    /// Memory held.
    pub fn bytes(&self) -> usize {
        match self {
            Self::F32(buf) => buf.bytes(),
            Self::Bf16(buf) => buf.bytes(),
        }
    }
}

impl Element for f32 {
    fn wrap(buf: Buf<Self>) -> AnyBuf {
        AnyBuf::F32(buf)
    }
    fn unwrap(buf: &AnyBuf) -> &Buf<Self> {
        match buf {
            AnyBuf::F32(buf) => buf,
            AnyBuf::Bf16(_) => unreachable!("saved by another kernel"),
        }
    }
}

impl Element for u16 {
    fn wrap(buf: Buf<Self>) -> AnyBuf {
        AnyBuf::Bf16(buf)
    }
    fn unwrap(buf: &AnyBuf) -> &Buf<Self> {
        match buf {
            AnyBuf::Bf16(buf) => buf,
            AnyBuf::F32(_) => unreachable!("saved by another kernel"),
        }
    }
}

/// An owned packed matrix.
pub(crate) struct Packed<K: Kernel> {
    _buf: Buf<K::Elem>,
    pub view: View<K::Elem>,
}

impl<K: Kernel> Packed<K> {
    /// A matrix [k, n] to be filled with `pack_rows`.
    pub fn rows(kernel: K, k: usize, n: usize) -> Self {
        let mut buf = Buf::new(kernel.packed_len(k, n));
        let view = kernel.view_rows(buf.as_mut_ptr(), k, n);
        Self { _buf: buf, view }
    }

    /// Packs a row-major [k, n] in parallel.
    pub fn from_rows(kernel: K, src: &[f32], k: usize, n: usize) -> Self {
        let packed = Self::rows(kernel, k, n);
        let view = packed.view;
        par_tiles(k, 64, |k0, rows| {
            // SAFETY: tiles are disjoint rows of a fresh buffer.
            unsafe { kernel.pack_rows(&src[k0 * n..], n, rows, n, view, k0, 0) };
        });
        packed
    }

    /// Packs a row-major [n, k] in parallel, as a matrix [k, n].
    pub fn from_transposed(kernel: K, src: &[f32], k: usize, n: usize) -> Self {
        let mut buf = Buf::new(kernel.packed_len(k, n));
        let view = kernel.view_transposed(buf.as_mut_ptr(), k, n);
        par_tiles(n, 2 * PANEL, |c0, cols| {
            // SAFETY: tiles are disjoint columns of a fresh buffer.
            unsafe { kernel.pack_transposed(&src[c0 * k..], k, cols, view, c0) };
        });
        Self { _buf: buf, view }
    }
}

/// `c = aᵀ·b` of packed matrices [k, m] and [k, n]: the gradient of a weight.
pub(crate) fn transposed_product<K: Kernel>(
    kernel: K,
    a: View<K::Elem>,
    b: View<K::Elem>,
    c: &mut [f32],
) {
    let n = b.n;
    assert_eq!(c.len(), a.n * n, "transposed product: c");
    transposed_product_at(kernel, a, b, c, n, false);
}

/// `c = aᵀ·b`, or `c += aᵀ·b` if `add`, where rows of `c` are `ldc` apart.
pub(crate) fn transposed_product_at<K: Kernel>(
    kernel: K,
    a: View<K::Elem>,
    b: View<K::Elem>,
    c: &mut [f32],
    ldc: usize,
    add: bool,
) {
    let (m, n) = (a.n, b.n);
    assert!(
        m == 0 || c.len() >= (m - 1) * ldc + n,
        "transposed product: c"
    );
    if a.k == 0 {
        if !add {
            c.chunks_mut(ldc).take(m).for_each(|row| row[..n].fill(0.0));
        }
        return;
    }
    let c = Shared::new(c);
    // Small enough tiles that even a [192, 192] gradient shares out among a few threads; large ones
    // read (and for tiles of AMX turn) `a` less often.
    let wide = if m * n < 1 << 19 { 4 } else { 16 } * PANEL;
    let tall = 2 * PANEL;
    let columns = n.div_ceil(wide).max(1);
    par_tiles(m.div_ceil(tall) * columns, 1, |tile, _| {
        let (i, j) = (tile / columns * tall, tile % columns * wide);
        let a = Lhs::Packed(a.cols(i, tall.min(m - i)));
        let b = b.cols(j, wide.min(n - j));
        // SAFETY: tiles are disjoint parts of `c`.
        unsafe { kernel.gemm(a, b, c.at(i * ldc + j), ldc, add) };
    });
}

/// `c = a·bᵀ`: `a` [m, k], `b` [n, k], `c` [m, n].
///
/// # Panics
/// If a slice's length does not match its shape.
pub fn matmul(
    compute: impl Into<Compute>,
    a: &[f32],
    b: &[f32],
    c: &mut [f32],
    [m, n, k]: [usize; 3],
) {
    check("matmul", a, m * k, b, n * k, c, m * n);
    with_kernel!(compute.into(), kernel => {
        rows_times(kernel, a, &Packed::from_transposed(kernel, b, k, n), c)
    });
}

/// `c = a·b`: `a` [m, k], `b` [k, n], `c` [m, n].
///
/// # Panics
/// If a slice's length does not match its shape.
pub fn matmul_nn(
    compute: impl Into<Compute>,
    a: &[f32],
    b: &[f32],
    c: &mut [f32],
    [m, n, k]: [usize; 3],
) {
    check("matmul_nn", a, m * k, b, k * n, c, m * n);
    with_kernel!(compute.into(), kernel => {
        rows_times(kernel, a, &Packed::from_rows(kernel, b, k, n), c)
    });
}

/// `c = aᵀ·b`: `a` [k, m], `b` [k, n], `c` [m, n].
///
/// # Panics
/// If a slice's length does not match its shape.
pub fn matmul_tn(
    compute: impl Into<Compute>,
    a: &[f32],
    b: &[f32],
    c: &mut [f32],
    [m, n, k]: [usize; 3],
) {
    check("matmul_tn", a, k * m, b, k * n, c, m * n);
    with_kernel!(compute.into(), kernel => {
        let a = Packed::from_rows(kernel, a, k, m);
        let b = Packed::from_rows(kernel, b, k, n);
        transposed_product(kernel, a.view, b.view, c)
    });
}

fn check(name: &str, a: &[f32], la: usize, b: &[f32], lb: usize, c: &[f32], lc: usize) {
    assert_eq!(a.len(), la, "{name}: length of a");
    assert_eq!(b.len(), lb, "{name}: length of b");
    assert_eq!(c.len(), lc, "{name}: length of c");
}

fn rows_times<K: Kernel>(kernel: K, a: &[f32], b: &Packed<K>, c: &mut [f32]) {
    let (k, n) = (b.view.k, b.view.n);
    if k == 0 || c.is_empty() {
        return c.fill(0.0);
    }
    let m = c.len() / n;
    let c = Shared::new(c);
    par_tiles(m, kernel.row_tile(m), |i, rows| {
        let mut left = Buf::new(kernel.rows_len(rows, k));
        kernel.to_rows(&a[i * k..], k, rows, k, &mut left);
        let left = kernel.left(&left, rows, k);
        // SAFETY: tiles are disjoint rows of `c`.
        unsafe { kernel.gemm(left, b.view, c.at(i * n), n, false) };
    });
}
