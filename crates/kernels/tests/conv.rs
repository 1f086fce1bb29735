//! Convolutions against their f64 reference: values, and gradients by finite differences.
#![allow(clippy::unwrap_used, missing_docs)]

mod common;

use common::{Noise, computes, error};
use lumi_kernels::{ConvGrads, ConvShape, ConvWanted, conv2d, conv2d_backward, reference};

const ALL: ConvWanted = ConvWanted {
    x: true,
    weights: true,
    bias: true,
};

fn shape([batch, input, output, kernel, height, width]: [usize; 6]) -> ConvShape {
    ConvShape {
        batch,
        input,
        output,
        kernel,
        height,
        width,
    }
}

fn wide(x: &[f32]) -> Vec<f64> {
    x.iter().map(|&x| f64::from(x)).collect()
}

struct Case {
    shape: ConvShape,
    x: Vec<f32>,
    weights: Vec<f32>,
    bias: Vec<f32>,
    grad: Vec<f32>,
}

fn case(sizes: [usize; 6]) -> Case {
    let s = shape(sizes);
    let mut r = Noise(7 + sizes.iter().sum::<usize>() as u64);
    let fan = s.input * s.kernel * s.kernel;
    Case {
        shape: s,
        x: r.vec(s.batch * s.input * s.height * s.width, 1.0),
        weights: r.vec(s.output * fan, (3.0 / fan as f32).sqrt()),
        bias: r.vec(s.output, 1.0),
        grad: r.vec(s.batch * s.output * s.height * s.width, 1.0),
    }
}

#[test]
fn forward_matches_the_reference() {
    for sizes in [
        [1, 1, 1, 1, 1, 1],
        [2, 3, 5, 3, 1, 1],
        [2, 5, 3, 3, 4, 7],
        [1, 33, 17, 3, 9, 5],
        [1, 64, 48, 3, 16, 16],
        [2, 37, 3, 3, 13, 70],
        [1, 2, 3, 5, 6, 3],
        [1, 3, 2, 7, 2, 2],
        [1, 300, 20, 1, 5, 9],
        // More than one tile, of the large size.
        [2, 6, 4, 3, 50, 47],
        [1, 40, 12, 1, 70, 61],
    ] {
        let c = case(sizes);
        for bias in [None, Some(&c.bias[..])] {
            let wide_bias = bias.map(wide);
            let want = reference::conv2d(
                c.shape,
                &wide(&c.x),
                &wide(&c.weights),
                wide_bias.as_deref(),
            );
            for (compute, allowed) in computes() {
                let mut out = vec![f32::NAN; want.len()];
                conv2d(c.shape, compute, &c.x, &c.weights, bias, &mut out);
                let e = error(&out, &want);
                assert!(e < allowed, "{compute:?} {:?}: {e}", c.shape);
            }
        }
    }
}

/// Derivatives of `sum(out * grad)` by the weights (0), the bias (1) or the input (2): the loss is
/// linear in each, so that a large step is exact.
fn finite(c: &Case, parameter: usize, at: &[usize]) -> Vec<f64> {
    let mut all = [wide(&c.weights), wide(&c.bias), wide(&c.x)];
    let loss = |[weights, bias, x]: &[Vec<f64>; 3]| -> f64 {
        let out = reference::conv2d(c.shape, x, weights, Some(bias));
        out.iter()
            .zip(&c.grad)
            .map(|(y, &g)| y * f64::from(g))
            .sum()
    };
    at.iter()
        .map(|&i| {
            all[parameter][i] += 0.5;
            let up = loss(&all);
            all[parameter][i] -= 1.0;
            let down = loss(&all);
            all[parameter][i] += 0.5;
            up - down
        })
        .collect()
}

#[test]
fn gradients_match_finite_differences() {
    for sizes in [
        [1, 1, 1, 3, 1, 1],
        [2, 5, 3, 3, 4, 7],
        [1, 35, 18, 3, 9, 5],
        [3, 4, 6, 1, 5, 5],
        [1, 270, 9, 1, 3, 4],
        [1, 2, 3, 5, 6, 3],
        [2, 3, 4, 3, 50, 47],
    ] {
        let c = case(sizes);
        let mut r = Noise(19);
        let lens = [c.weights.len(), c.bias.len(), c.x.len()];
        let wants: Vec<(Vec<f64>, Vec<usize>)> = (0..3)
            .map(|p| {
                let pick = |r: &mut Noise| ((r.next() + 1.0) * 0.5 * lens[p] as f32) as usize;
                let at: Vec<usize> = (0..20).map(|_| pick(&mut r) % lens[p]).collect();
                (finite(&c, p, &at), at)
            })
            .collect();
        for (compute, allowed) in computes() {
            let g = conv2d_backward(c.shape, compute, &c.x, &c.weights, &c.grad, ALL);
            for (p, got) in [&g.weights, &g.bias, &g.x].into_iter().enumerate() {
                assert_eq!(got.len(), lens[p]);
                let (want, at) = &wants[p];
                let picked: Vec<f32> = at.iter().map(|&i| got[i]).collect();
                let e = error(&picked, want);
                assert!(e < 2.0 * allowed, "{compute:?} {:?} {p}: {e}", c.shape);
            }
            // Each alone is the same, and nothing else is computed.
            let only = |x, weights, bias| -> ConvGrads {
                let wanted = ConvWanted { x, weights, bias };
                conv2d_backward(c.shape, compute, &c.x, &c.weights, &c.grad, wanted)
            };
            let x = only(true, false, false);
            assert!(x.x == g.x && x.weights.is_empty() && x.bias.is_empty());
            let w = only(false, true, false);
            assert!(w.weights == g.weights && w.x.is_empty());
            assert!(only(false, false, true).bias == g.bias);
        }
    }
}

#[test]
fn threads_change_no_bit() {
    let c = case([2, 40, 24, 3, 60, 50]);
    for (compute, _) in computes() {
        let run = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads);
            pool.build().unwrap().install(|| {
                let mut out = vec![0.0; c.grad.len()];
                conv2d(c.shape, compute, &c.x, &c.weights, Some(&c.bias), &mut out);
                let g = conv2d_backward(c.shape, compute, &c.x, &c.weights, &c.grad, ALL);
                (out, g.x, g.weights, g.bias)
            })
        };
        assert!(run(1) == run(2), "{compute:?}");
    }
}

#[test]
fn nan_spoils_its_neighbourhood_only() {
    let mut c = case([1, 3, 4, 3, 12, 12]);
    c.x[144 + 5 * 12 + 6] = f32::NAN;
    for (compute, _) in computes() {
        let mut out = vec![0.0; c.grad.len()];
        conv2d(c.shape, compute, &c.x, &c.weights, None, &mut out);
        for (i, y) in out.iter().enumerate() {
            let (row, column) = (i / 12 % 12, i % 12);
            let near = (4..=6).contains(&row) && (5..=7).contains(&column);
            assert_eq!(y.is_nan(), near, "{compute:?} ({row}, {column})");
        }
        let g = conv2d_backward(c.shape, compute, &c.x, &c.weights, &c.grad, ALL);
        assert!(g.weights.iter().any(|g| g.is_nan()) && g.x.iter().all(|g| g.is_finite()));
        assert!(g.weights[..9].iter().all(|g| g.is_finite()), "channel 0");
    }
}

#[test]
#[should_panic(expected = "conv2d: length of weights")]
fn wrong_lengths_are_named() {
    let s = shape([1, 2, 3, 3, 4, 4]);
    let x = [0.0; 32];
    conv2d(
        s,
        lumi_kernels::Precision::F32,
        &x,
        &[0.0; 53],
        None,
        &mut [0.0; 48],
    );
}

#[test]
#[should_panic(expected = "conv2d: kernel 2, expected an odd side")]
fn even_kernels_are_refused() {
    let s = shape([1, 1, 1, 2, 2, 2]);
    let x = [0.0; 4];
    conv2d(s, lumi_kernels::Precision::F32, &x, &x, None, &mut [0.0; 4]);
}
