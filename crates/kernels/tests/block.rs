//! The block against its f64 reference: values, gradients by finite differences, both patterns.
#![allow(clippy::unwrap_used, missing_docs)]

mod common;

use common::{NAMES, Noise, Owned, computes, error, in_order, weight, wide};
use lumi_kernels::reference::{self, Sequence, Sight, Weights};
use lumi_kernels::{
    BlockGrads, PackedBlock, Pattern, Save, Wanted, block_backward, block_forward,
    block_forward_saved,
};

/// (dim, head_dim, hidden, batch, n, pattern)
type Case = (usize, usize, usize, usize, usize, Pattern);

fn cached(context: usize, group: usize) -> Pattern {
    Pattern { context, group }
}

fn cases() -> Vec<Case> {
    vec![
        (32, 16, 128, 2, 7, Pattern::full(7)),
        (48, 48, 96, 1, 1, Pattern::full(1)),
        (96, 48, 200, 3, 37, Pattern::full(37)),
        (40, 8, 72, 2, 9, cached(3, 2)),
        (64, 32, 256, 1, 70, cached(40, 15)),
        (64, 64, 600, 2, 12, cached(0, 4)),
        (30, 5, 33, 1, 11, cached(5, 3)),
        (64, 32, 128, 1, 600, Pattern::full(600)),
        (32, 16, 64, 1, 700, cached(550, 75)),
        (128, 64, 1100, 1, 130, cached(97, 33)),
    ]
}

fn want(owned: &Owned, x: &[f32], n: usize, pattern: Pattern) -> Vec<f64> {
    let w = Weights::from(&owned.weights());
    sequences(owned, &w, &wide(x), n, pattern)
}

fn sequences(owned: &Owned, w: &Weights, x: &[f64], n: usize, pattern: Pattern) -> Vec<f64> {
    x.chunks_exact(n * owned.shape.dim)
        .flat_map(|x| {
            let x = Sequence { x, frames: None };
            reference::block(owned.shape, w, x, Sight::Pattern(pattern))
        })
        .collect()
}

#[test]
fn forward_matches_the_reference() {
    for (d, dh, m, batch, n, pattern) in cases() {
        let owned = Owned::new(d, dh, m, 3);
        let x = Noise(77).vec(batch * n * d, 1.5);
        let want = want(&owned, &x, n, pattern);
        for (compute, allowed) in computes() {
            let mut out = vec![f32::NAN; x.len()];
            block_forward(
                owned.shape,
                &owned.weights(),
                compute,
                &x,
                batch,
                n,
                pattern,
                &mut out,
            );
            let e = error(&out, &want);
            assert!(
                e < allowed,
                "{compute:?} d {d} dh {dh} n {n} {pattern:?}: {e}"
            );

            // Packed weights and saved activations change nothing, not even a bit.
            let mut again = vec![f32::NAN; x.len()];
            PackedBlock::new(owned.shape, &owned.weights(), compute)
                .forward(&x, batch, n, pattern, &mut again);
            assert_eq!(out, again);
            block_forward_saved(
                owned.shape,
                &owned.weights(),
                compute,
                Save::Activations,
                &x,
                batch,
                n,
                pattern,
                &mut again,
            );
            assert_eq!(out, again);
        }
    }
}

#[test]
fn large_gains_take_the_maximum() {
    let mut owned = Owned::new(64, 32, 64, 5);
    for gain in [3, 4] {
        owned.all[gain].iter_mut().for_each(|g| *g *= 6.0);
    }
    let (n, pattern) = (600, cached(520, 40));
    let x = Noise(5).vec(n * 64, 1.0);
    let want = want(&owned, &x, n, pattern);
    for (compute, allowed) in computes() {
        let mut out = vec![0.0; x.len()];
        block_forward(
            owned.shape,
            &owned.weights(),
            compute,
            &x,
            1,
            n,
            pattern,
            &mut out,
        );
        // Scores near 200: their own rounding is amplified.
        let e = error(&out, &want);
        assert!(e < 10.0 * allowed, "{compute:?}: {e}");
    }
}

fn grads(
    owned: &Owned,
    x: &[f32],
    g: &[f32],
    case: Case,
    save: Save,
    compute: lumi_kernels::Compute,
) -> BlockGrads {
    wanted_grads(owned, x, g, case, save, compute, Wanted::All)
}

fn wanted_grads(
    owned: &Owned,
    x: &[f32],
    g: &[f32],
    case: Case,
    save: Save,
    compute: lumi_kernels::Compute,
    wanted: Wanted,
) -> BlockGrads {
    let (_, _, _, batch, n, pattern) = case;
    let mut out = vec![0.0; x.len()];
    let saved = block_forward_saved(
        owned.shape,
        &owned.weights(),
        compute,
        save,
        x,
        batch,
        n,
        pattern,
        &mut out,
    );
    let weights = owned.weights();
    block_backward(owned.shape, &weights, &saved, x, pattern, g, wanted)
}

/// Derivative of `sum(out * g)` by central differences on the f64 reference, at some entries of
/// x (parameter 9) or of a weight.
fn finite(
    owned: &Owned,
    x: &[f32],
    g: &[f32],
    n: usize,
    pattern: Pattern,
    parameter: usize,
    at: &[usize],
) -> Vec<f64> {
    let mut w = Weights::from(&owned.weights());
    let mut x = wide(x);
    let step = 1e-5;
    let mut entry = |i: usize, delta: f64| {
        match parameter {
            0..9 => weight(&mut w, parameter)[i] += delta,
            _ => x[i] += delta,
        }
        let out = sequences(owned, &w, &x, n, pattern);
        out.iter()
            .zip(g)
            .map(|(y, &g)| y * f64::from(g))
            .sum::<f64>()
    };
    at.iter()
        .map(|&i| {
            let up = entry(i, step);
            let down = entry(i, -2.0 * step);
            entry(i, step);
            (up - down) / (2.0 * step)
        })
        .collect()
}

#[test]
fn gradients_match_finite_differences() {
    for case in [
        (32, 16, 64, 2, 5, Pattern::full(5)),
        (24, 12, 40, 1, 1, Pattern::full(1)),
        (32, 16, 70, 2, 9, cached(3, 3)),
        (30, 5, 33, 1, 11, cached(5, 2)),
        (48, 48, 96, 1, 37, Pattern::full(37)),
        (32, 16, 560, 1, 6, cached(0, 2)),
        (16, 8, 32, 1, 330, cached(270, 20)),
        // So many query tiles that a head's are summed in parts.
        (32, 16, 40, 1, 68, cached(2, 2)),
    ] {
        check_gradients(case);
    }
}

#[test]
fn head_sizes_from_8_to_128() {
    for dh in (8..=128).step_by(8) {
        let case = (2 * dh, dh, 3 * dh, 1, 7, cached(3, 2));
        let (d, _, m, _, n, pattern) = case;
        let owned = Owned::new(d, dh, m, 3);
        let x = Noise(77).vec(n * d, 1.5);
        let want = want(&owned, &x, n, pattern);
        for (compute, allowed) in computes() {
            let mut out = vec![f32::NAN; x.len()];
            PackedBlock::new(owned.shape, &owned.weights(), compute)
                .forward(&x, 1, n, pattern, &mut out);
            let e = error(&out, &want);
            assert!(e < allowed, "{compute:?} dh {dh}: {e}");
        }
        if dh % 24 == 0 || dh == 128 {
            check_gradients(case);
        }
    }
}

fn check_gradients(case: Case) {
    let (d, dh, m, batch, n, pattern) = case;
    let owned = Owned::new(d, dh, m, 11);
    let x = Noise(13).vec(batch * n * d, 1.2);
    let g = Noise(17).vec(x.len(), 1.0);
    let samples = if n > 60 || d > 60 { 6 } else { 40 };
    let mut random = Noise(19);
    let mut wants = Vec::new();
    for parameter in 0..10 {
        let len = if parameter < 9 {
            owned.all[parameter].len()
        } else {
            x.len()
        };
        let at: Vec<usize> = (0..samples)
            .map(|_| ((random.next() + 1.0) * 0.5 * len as f32) as usize % len)
            .collect();
        wants.push((finite(&owned, &x, &g, n, pattern, parameter, &at), at));
    }
    for (compute, allowed) in computes() {
        let got = grads(&owned, &x, &g, case, Save::Activations, compute);
        for (parameter, (want, at)) in wants.iter().enumerate() {
            let (name, all) = match parameter {
                9 => ("x", &got.x),
                p => (NAMES[p], in_order(&got)[p]),
            };
            let picked: Vec<f32> = at.iter().map(|&i| all[i]).collect();
            let e = error(&picked, want);
            // Few samples, and sums that cancel: looser than the values themselves.
            assert!(e < 6.0 * allowed, "{compute:?} {case:?} {name}: {e}");
        }
        let again = grads(&owned, &x, &g, case, Save::Input, compute);
        assert_eq!(got.x, again.x);
        for (a, b) in in_order(&got).iter().zip(in_order(&again)) {
            assert_eq!(*a, b);
        }
        // A frozen block: the same gradients, without those of the matrices.
        let wanted = Wanted::NoMatrices;
        let frozen = wanted_grads(&owned, &x, &g, case, Save::Activations, compute, wanted);
        assert_eq!(got.x, frozen.x);
        for (a, b) in in_order(&got).iter().zip(in_order(&frozen)) {
            assert!(b.is_empty() || *a == b);
        }
        assert!(frozen.qk.is_empty() && frozen.v.is_empty() && frozen.fc2.is_empty());
    }
}

#[test]
fn threads_change_no_bit() {
    for case in [
        (96, 32, 384, 3, 101, Pattern::full(101)),
        (64, 16, 256, 2, 150, cached(90, 20)),
        (64, 64, 256, 1, 1100, Pattern::full(1100)),
        (16, 8, 16, 1, 1601, Pattern::full(1601)),
    ] {
        let (d, dh, m, batch, n, _) = case;
        let owned = Owned::new(d, dh, m, 23);
        let x = Noise(29).vec(batch * n * d, 1.0);
        let g = Noise(31).vec(x.len(), 1.0);
        for (compute, _) in computes() {
            let run = |threads| {
                let pool = rayon::ThreadPoolBuilder::new().num_threads(threads);
                let pool = pool.build().unwrap();
                pool.install(|| grads(&owned, &x, &g, case, Save::Activations, compute))
            };
            let (one, two) = (run(1), run(2));
            assert_eq!(one.x, two.x);
            for (a, b) in in_order(&one).iter().zip(in_order(&two)) {
                assert_eq!(*a, b);
            }
        }
    }
}

#[test]
fn nan_and_infinity_propagate() {
    let (d, n) = (64, 20);
    let owned = Owned::new(d, 32, 128, 37);
    for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
        let mut x = Noise(41).vec(n * d, 1.0);
        x[5 * d + 3] = bad;
        for (compute, _) in computes() {
            let case = (d, 32, 128, 1, n, Pattern::full(n));
            let mut out = vec![0.0; x.len()];
            block_forward(
                owned.shape,
                &owned.weights(),
                compute,
                &x,
                1,
                n,
                Pattern::full(n),
                &mut out,
            );
            // Every token attends to the bad one.
            assert!(out.iter().all(|y| y.is_nan()), "{compute:?} {bad}");
            // Of independent groups only the bad one's is spoilt.
            block_forward(
                owned.shape,
                &owned.weights(),
                compute,
                &x,
                1,
                n,
                cached(0, 5),
                &mut out,
            );
            let spoilt = |t: usize| out[t * d..][..d].iter().all(|y| y.is_nan());
            assert!(
                (0..n).all(|t| spoilt(t) == (5..10).contains(&t)),
                "{compute:?}"
            );
            let g = vec![1.0; x.len()];
            let got = grads(&owned, &x, &g, case, Save::Activations, compute);
            assert!(got.qk.iter().any(|y| y.is_nan()), "{compute:?}");
        }
        // A bad weight reaches every token too.
        let mut owned = Owned::new(d, 32, 128, 37);
        owned.all[3][1] = bad;
        let x = Noise(41).vec(n * d, 1.0);
        for (compute, _) in computes() {
            let mut out = vec![0.0; x.len()];
            block_forward(
                owned.shape,
                &owned.weights(),
                compute,
                &x,
                1,
                n,
                Pattern::full(n),
                &mut out,
            );
            assert!(out.iter().any(|y| y.is_nan()), "{compute:?} {bad}");
        }
    }
}

#[test]
#[should_panic(expected = "block weights: length of fc1")]
fn wrong_weights_are_named() {
    let mut owned = Owned::new(32, 16, 64, 1);
    owned.all[7].pop();
    PackedBlock::new(owned.shape, &owned.weights(), lumi_kernels::Precision::F32);
}

#[test]
#[should_panic(expected = "pattern: 5 tokens after the context are not whole groups of 2")]
fn broken_groups_are_named() {
    let owned = Owned::new(32, 16, 64, 1);
    let x = vec![0.0; 8 * 32];
    let mut out = x.clone();
    block_forward(
        owned.shape,
        &owned.weights(),
        lumi_kernels::Precision::F32,
        &x,
        1,
        8,
        cached(3, 2),
        &mut out,
    );
}
