//! The three matrix products against f64 loops, over odd sizes.
#![allow(clippy::unwrap_used, missing_docs)]

mod common;

use common::{Noise, computes, error};
use lumi_kernels::{matmul, matmul_nn, matmul_tn};

#[test]
fn products_match_loops() {
    let sizes = [1, 2, 7, 16, 31, 33, 50, 97];
    let deep = [1, 3, 32, 50, 515, 1030];
    for &m in &sizes {
        for &n in &sizes {
            for &k in &deep {
                check(m, n, k);
            }
        }
    }
    check(300, 80, 700);
}

fn check(m: usize, n: usize, k: usize) {
    let mut noise = Noise((m * 1000 + n * 10 + k) as u64);
    let a = noise.vec(m * k, 1.0);
    let b = noise.vec(n * k, 1.0);
    let flip = |x: &[f32], rows: usize, cols: usize| -> Vec<f32> {
        (0..rows * cols)
            .map(|i| x[i % rows * cols + i / rows])
            .collect()
    };
    let want: Vec<f64> = (0..m * n)
        .map(|i| {
            let (a, b) = (&a[i / n * k..][..k], &b[i % n * k..][..k]);
            a.iter()
                .zip(b)
                .map(|(&a, &b)| f64::from(a) * f64::from(b))
                .sum()
        })
        .collect();
    // Few terms can cancel: measure against the size of the terms.
    let size = (k as f64 / 9.0).sqrt();
    for (compute, allowed) in computes() {
        let mut c = vec![f32::NAN; m * n];
        let test = |name: &str, c: &[f32]| {
            let scale = want.iter().map(|w| w * w).sum::<f64>() / (m * n) as f64;
            let e = error(c, &want) * scale.max(1e-3).sqrt() / size;
            assert!(e < allowed * 2.0, "{compute:?} {name} {m} {n} {k}: {e}");
        };
        matmul(compute, &a, &b, &mut c, [m, n, k]);
        test("nt", &c);
        c.fill(f32::NAN);
        matmul_nn(compute, &a, &flip(&b, n, k), &mut c, [m, n, k]);
        test("nn", &c);
        c.fill(f32::NAN);
        matmul_tn(compute, &flip(&a, m, k), &flip(&b, n, k), &mut c, [m, n, k]);
        test("tn", &c);
    }
}

#[test]
#[should_panic(expected = "matmul_nn: length of b")]
fn wrong_lengths_are_named() {
    matmul_nn(
        lumi_kernels::Precision::F32,
        &[0.0; 6],
        &[0.0; 5],
        &mut [0.0; 4],
        [2, 2, 3],
    );
}
