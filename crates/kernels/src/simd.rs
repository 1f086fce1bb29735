//! One source for row-wise passes, compiled once per instruction set.
//!
//! The bodies are plain loops that the compiler vectorises; sums run over `LANES` independent
//! partial sums, because a compiler may not reorder floating-point addition by itself.

/// Independent partial sums: one AVX-512 register.
pub(crate) const LANES: usize = 16;

/// Defines functions `name(isa, args...)` whose body is compiled for every instruction set.
/// The body sees a constant (named in `<>`) that says whether fused multiply-add is one
/// instruction rather than a library call.
macro_rules! multiversion {
    ($($(#[$meta:meta])* fn $name:ident<$fma:ident>($($arg:ident: $ty:ty),* $(,)?) $body:block)*) => {$(
        $(#[$meta])*
        #[allow(clippy::too_many_arguments)]
        pub(crate) fn $name(isa: $crate::cpu::Isa, $($arg: $ty),*) {
            #[inline(always)]
            #[allow(clippy::too_many_arguments)]
            fn body<const $fma: bool>($($arg: $ty),*) $body
            #[cfg(target_arch = "x86_64")]
            {
                #[target_feature(enable = "avx2,fma")]
                #[allow(clippy::too_many_arguments)]
                fn avx2($($arg: $ty),*) { body::<true>($($arg),*) }
                #[target_feature(enable = "avx512f,avx512bw,avx512dq,avx512vl,avx2,fma")]
                #[allow(clippy::too_many_arguments)]
                fn avx512($($arg: $ty),*) { body::<true>($($arg),*) }
                match isa {
                    // SAFETY: an `Isa` other than `Base` exists only after detection.
                    $crate::cpu::Isa::Avx512 => return unsafe { avx512($($arg),*) },
                    // SAFETY: as above.
                    $crate::cpu::Isa::Avx2 => return unsafe { avx2($($arg),*) },
                    $crate::cpu::Isa::Base => {}
                }
            }
            #[cfg(not(target_arch = "x86_64"))]
            let _ = isa;
            body::<{ cfg!(target_arch = "aarch64") }>($($arg),*)
        }
    )*};
}
pub(crate) use multiversion;

/// `a * b + c`, fused where that is one instruction.
#[inline(always)]
pub(crate) fn fma<const FMA: bool>(a: f32, b: f32, c: f32) -> f32 {
    if FMA { a.mul_add(b, c) } else { a * b + c }
}

/// Sum of `f(a, b, c)` over three rows of one length, in an order that depends on it alone.
/// (Rows a caller has no use for may be repeated; they cost nothing.)
#[inline(always)]
pub(crate) fn sum([a, b, c]: [&[f32]; 3], f: impl Fn(f32, f32, f32) -> f32) -> f32 {
    let mut lanes = [0.0f32; LANES];
    let (a, a_tail) = a.as_chunks::<LANES>();
    let (b, b_tail) = b.as_chunks::<LANES>();
    let (c, c_tail) = c.as_chunks::<LANES>();
    // Arrays rather than indices: a bounds check would keep the loop scalar.
    for ((a, b), c) in a.iter().zip(b).zip(c) {
        for l in 0..LANES {
            lanes[l] += f(a[l], b[l], c[l]);
        }
    }
    let mut tail = 0.0;
    for ((&a, &b), &c) in a_tail.iter().zip(b_tail).zip(c_tail) {
        tail += f(a, b, c);
    }
    fold(lanes) + tail
}

/// Rows to ask for in advance when one head's channels are read from rows of all heads: strides
/// of a page or so are beyond the hardware's own prefetching.
pub(crate) const AHEAD: usize = 8;

/// Asks for `len` values at `x` to be brought into cache; any address is harmless.
#[inline(always)]
pub(crate) fn prefetch(x: *const f32, len: usize) {
    #[cfg(target_arch = "x86_64")]
    for i in (0..len).step_by(LANES) {
        use std::arch::x86_64::{_MM_HINT_T0, _mm_prefetch};
        // SAFETY: a prefetch does not access memory.
        unsafe { _mm_prefetch::<_MM_HINT_T0>(x.wrapping_add(i).cast()) };
    }
    #[cfg(not(target_arch = "x86_64"))]
    let _ = (x, len);
}

/// Sum of the lanes, pairwise.
#[inline(always)]
pub(crate) fn fold(mut lanes: [f32; LANES]) -> f32 {
    let mut half = LANES / 2;
    while half > 0 {
        for l in 0..half {
            lanes[l] += lanes[l + half];
        }
        half /= 2;
    }
    lanes[0]
}

/// `e^x` with relative error about 1e-7, for |x| < 87; saturates outside, keeps NaN.
#[inline(always)]
pub(crate) fn exp<const FMA: bool>(x: f32) -> f32 {
    // 1.5 * 2^23: adding it rounds to an integer that stands in the low bits.
    const ROUND: f32 = 12_582_912.0;
    const LN2_HIGH: f32 = 0.693_359_4;
    const LN2_LOW: f32 = -2.121_944_4e-4;
    // Comparisons written so that NaN passes through.
    let x = if x < -87.0 { -87.0 } else { x };
    let x = if x > 88.0 { 88.0 } else { x };
    let shifted = fma::<FMA>(x, std::f32::consts::LOG2_E, ROUND);
    let n = shifted - ROUND;
    let f = fma::<FMA>(n, -LN2_LOW, fma::<FMA>(n, -LN2_HIGH, x));
    // Taylor on |f| <= ln2/2; the first left-out term is below 1.2e-7 of the result.
    let p = fma::<FMA>(f, 1.0 / 720.0, 1.0 / 120.0);
    let p = fma::<FMA>(f, p, 1.0 / 24.0);
    let p = fma::<FMA>(f, p, 1.0 / 6.0);
    let p = fma::<FMA>(f, p, 0.5);
    let p = fma::<FMA>(f, p, 1.0);
    let p = fma::<FMA>(f, p, 1.0);
    let bits = (shifted.to_bits() as i32).wrapping_sub(ROUND.to_bits() as i32);
    p * f32::from_bits((bits.wrapping_add(127) as u32) << 23)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exp_is_accurate_and_keeps_nan() {
        for i in -8600..8700 {
            let x = i as f32 * 0.01;
            let want = f64::from(x).exp();
            for got in [exp::<true>(x), exp::<false>(x)] {
                assert!(
                    (f64::from(got) / want - 1.0).abs() < 4e-7,
                    "{x}: {got} {want}"
                );
            }
        }
        assert!(exp::<true>(f32::NAN).is_nan());
        assert!(exp::<true>(f32::NEG_INFINITY) < 1e-37);
        assert_eq!(exp::<true>(0.0), 1.0);
    }

    #[test]
    fn sums_tails() {
        for n in [0usize, 1, 15, 16, 17, 50] {
            let x: Vec<f32> = (0..n).map(|i| i as f32).collect();
            let want = (n * n.saturating_sub(1) / 2) as f32;
            assert_eq!(sum([&x; 3], |x, _, _| x), want);
        }
    }
}
