//! The exact (erf) GELU and its derivative.

use crate::simd::{exp, fma, multiversion};

/// Normal cumulative distribution and density at `x`.
///
/// erf by Abramowitz and Stegun 7.1.26 (absolute error 1.5e-7); its factor exp(-x²/2) is the
/// density's too, so the derivative of GELU costs no second exponential.
#[inline(always)]
fn normal<const FMA: bool>(x: f32) -> (f32, f32) {
    const P: f32 = 0.327_591_1 * std::f32::consts::FRAC_1_SQRT_2;
    let e = exp::<FMA>(-0.5 * x * x);
    let t = 1.0 / fma::<FMA>(x.abs(), P, 1.0);
    let q = fma::<FMA>(t, 1.061_405_4, -1.453_152_1);
    let q = fma::<FMA>(t, q, 1.421_413_8);
    let q = fma::<FMA>(t, q, -0.284_496_72);
    let q = fma::<FMA>(t, q, 0.254_829_6);
    let tail = 0.5 * t * q * e;
    let cdf = if x < 0.0 { tail } else { 1.0 - tail };
    (cdf, e * 0.398_942_3)
}

multiversion! {
    /// `x = gelu(x)`.
    fn gelu<FMA>(x: &mut [f32]) {
        for x in x {
            *x *= normal::<FMA>(*x).0;
        }
    }

    /// From pre-activations `h` and the gradient `d` after GELU: `h = gelu(h)`, `d *= gelu'(h)`.
    fn gelu_backward<FMA>(h: &mut [f32], d: &mut [f32]) {
        for (h, d) in h.iter_mut().zip(d) {
            let (cdf, density) = normal::<FMA>(*h);
            *d *= fma::<FMA>(*h, density, cdf);
            *h *= cdf;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cpu::{Compute, Cpu, Precision};
    use crate::reference::erf;

    #[test]
    fn absolute_error_below_1e_6() {
        let xs: Vec<f32> = (-12_000..12_000).map(|i| i as f32 * 1e-3).collect();
        for (cpu, _) in Cpu::ALL {
            if !cpu.is_supported() {
                continue;
            }
            let isa = Compute::new(Precision::F32, cpu).isa();
            let mut h = xs.clone();
            let mut d = vec![1.0; xs.len()];
            gelu_backward(isa, &mut h, &mut d);
            let mut g = xs.clone();
            gelu(isa, &mut g);
            for (i, &x) in xs.iter().enumerate() {
                let x = f64::from(x);
                let cdf = 0.5 * (1.0 + erf(x / 2f64.sqrt()));
                let slope = cdf + x * (-0.5 * x * x).exp() / (2.0 * std::f64::consts::PI).sqrt();
                assert!((f64::from(h[i]) - x * cdf).abs() < 1e-6, "gelu({x})");
                assert!((f64::from(d[i]) - slope).abs() < 1e-6, "gelu'({x})");
                assert_eq!(h[i], g[i]);
            }
        }
    }
}
