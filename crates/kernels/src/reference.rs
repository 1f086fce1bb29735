//! The block in f64, token by token, and convolutions, pixel by pixel, as the formulas say: what the kernels are tested against.

use crate::attention::Pattern;
use crate::block::{BlockShape, BlockWeights};
use crate::conv::ConvShape;
use crate::frames::FRAME;

const EPS: f64 = 1e-5;

/// Weights in f64, named and shaped as `BlockWeights`.
#[derive(Clone, Debug)]
#[allow(missing_docs)]
pub struct Weights {
    pub norm1: Vec<f64>,
    pub qkv: Vec<f64>,
    pub q_norm: Vec<f64>,
    pub k_norm: Vec<f64>,
    pub proj: Vec<f64>,
    pub norm2: Vec<f64>,
    pub fc1: Vec<f64>,
    pub fc2: Vec<f64>,
}

impl From<&BlockWeights<'_>> for Weights {
    fn from(w: &BlockWeights) -> Self {
        let wide = |x: &[f32]| x.iter().map(|&x| f64::from(x)).collect();
        Self {
            norm1: wide(w.norm1),
            qkv: wide(w.qkv),
            q_norm: wide(w.q_norm),
            k_norm: wide(w.k_norm),
            proj: wide(w.proj),
            norm2: wide(w.norm2),
            fc1: wide(w.fc1),
            fc2: wide(w.fc2),
        }
    }
}

/// `block(x)` for one sequence `x` [n, dim] of tokens with frames [n, 12], or without any.
pub fn block(
    shape: BlockShape,
    w: &Weights,
    x: &[f64],
    frames: Option<&[f64]>,
    pattern: Pattern,
) -> Vec<f64> {
    let (d, dh) = (shape.dim, shape.head_dim);
    let n = x.len() / d;
    let tokens: Vec<&[f64]> = x.chunks_exact(d).collect();
    let mut qkv: Vec<Vec<f64>> = tokens
        .iter()
        .map(|x| linear(&w.qkv, &layer_norm(x, &w.norm1)))
        .collect();
    // M, M⁻¹ and M⁻ᵀ of a token.
    let motions = |t: usize| {
        frames.map(|frames| {
            let to_world = matrix(&frames[t * FRAME..][..FRAME]);
            let back = rigid_inverse(&to_world);
            [to_world, back, transposed(&back)]
        })
    };
    for (t, row) in qkv.iter_mut().enumerate() {
        if let Some([to_world, _, of_queries]) = motions(t) {
            for (part, m) in row
                .chunks_exact_mut(d)
                .zip([of_queries, to_world, to_world])
            {
                turn(part, dh, &m);
            }
        }
    }
    let head = |t: usize, part: usize, h: usize| &qkv[t][part * d + h * dh..][..dh];
    let mut out = Vec::with_capacity(x.len());
    for (t, x) in tokens.iter().enumerate() {
        let mut attended = vec![0.0; d];
        for h in 0..d / dh {
            let q = rms_norm(head(t, 0, h), &w.q_norm);
            let seen: Vec<usize> = (0..n).filter(|&s| sees(t, s, pattern)).collect();
            let scores: Vec<f64> = seen
                .iter()
                .map(|&s| dot(&q, &rms_norm(head(s, 1, h), &w.k_norm)) / (dh as f64).sqrt())
                .collect();
            let max = scores.iter().copied().fold(f64::NEG_INFINITY, f64::max);
            let sum: f64 = scores.iter().map(|s| (s - max).exp()).sum();
            for (&s, score) in seen.iter().zip(&scores) {
                let p = (score - max).exp() / sum;
                for (o, v) in attended[h * dh..].iter_mut().zip(head(s, 2, h)) {
                    *o += p * v;
                }
            }
        }
        if let Some([_, back, _]) = motions(t) {
            turn(&mut attended, dh, &back);
        }
        let x1 = add(x, &linear(&w.proj, &attended));
        let mut hidden = linear(&w.fc1, &layer_norm(&x1, &w.norm2));
        for h in &mut hidden {
            *h *= 0.5 * (1.0 + erf(*h / 2f64.sqrt()));
        }
        out.extend(add(&x1, &linear(&w.fc2, &hidden)));
    }
    out
}

/// A convolution of one or more images, pixel by pixel; see [`crate::conv2d`] for the shapes.
pub fn conv2d(shape: ConvShape, x: &[f64], weights: &[f64], bias: Option<&[f64]>) -> Vec<f64> {
    let (h, w, k) = (shape.height, shape.width, shape.kernel);
    let mut out = Vec::new();
    for image in x.chunks_exact(shape.input * h * w) {
        for o in 0..shape.output {
            for (y, x) in (0..h).flat_map(|y| (0..w).map(move |x| (y, x))) {
                let mut sum = bias.map_or(0.0, |bias| bias[o]);
                for c in 0..shape.input {
                    for (ky, kx) in (0..k).flat_map(|y| (0..k).map(move |x| (y, x))) {
                        let (y, x) = (y + ky, x + kx);
                        if (k / 2..h + k / 2).contains(&y) && (k / 2..w + k / 2).contains(&x) {
                            let pixel = (c * h + y - k / 2) * w + x - k / 2;
                            let weight = ((o * shape.input + c) * k + ky) * k + kx;
                            sum += image[pixel] * weights[weight];
                        }
                    }
                }
                out.push(sum);
            }
        }
    }
    out
}

/// Whether token `t` attends to token `s`.
pub fn sees(t: usize, s: usize, pattern: Pattern) -> bool {
    let Pattern { context, group } = pattern;
    s < context || (t >= context && (t - context) / group == (s - context) / group)
}

/// The error function: its Taylor series near zero, a continued fraction in the tails.
pub fn erf(x: f64) -> f64 {
    let a = x.abs();
    let value = if a < 2.5 {
        let (mut term, mut sum, mut n) = (a, a, 0.0);
        while term.abs() > 1e-18 * sum.abs() {
            n += 1.0;
            term *= -a * a / n;
            sum += term / (2.0 * n + 1.0);
        }
        sum * 2.0 / std::f64::consts::PI.sqrt()
    } else {
        let fraction = (1..=60).rev().fold(a, |f, k| a + 0.5 * f64::from(k) / f);
        1.0 - (-a * a).exp() / (fraction * std::f64::consts::PI.sqrt())
    };
    value.copysign(x)
}

type Matrix = [[f64; 4]; 4];

/// A frame's motion, row by row.
fn matrix(frame: &[f64]) -> Matrix {
    let row = |i: usize| {
        [
            frame[3 * i],
            frame[3 * i + 1],
            frame[3 * i + 2],
            frame[9 + i],
        ]
    };
    [row(0), row(1), row(2), [0.0, 0.0, 0.0, 1.0]]
}

fn rigid_inverse(m: &Matrix) -> Matrix {
    let row = |i: usize| {
        let turned = [m[0][i], m[1][i], m[2][i]];
        let t = [m[0][3], m[1][3], m[2][3]];
        [turned[0], turned[1], turned[2], -dot(&turned, &t)]
    };
    [row(0), row(1), row(2), [0.0, 0.0, 0.0, 1.0]]
}

fn transposed(m: &Matrix) -> Matrix {
    [0, 1, 2, 3].map(|i| [0, 1, 2, 3].map(|j| m[j][i]))
}

/// `m·v` for every four channels `v` of each head.
fn turn(row: &mut [f64], head_dim: usize, m: &Matrix) {
    for head in row.chunks_exact_mut(head_dim) {
        for v in head.chunks_exact_mut(4) {
            let turned: Vec<f64> = m.iter().map(|row| dot(row, v)).collect();
            v.copy_from_slice(&turned);
        }
    }
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

fn add(a: &[f64], b: &[f64]) -> Vec<f64> {
    a.iter().zip(b).map(|(a, b)| a + b).collect()
}

/// `w·x` for `w` [out, in].
fn linear(w: &[f64], x: &[f64]) -> Vec<f64> {
    w.chunks_exact(x.len()).map(|row| dot(row, x)).collect()
}

fn layer_norm(x: &[f64], gain: &[f64]) -> Vec<f64> {
    let mean = x.iter().sum::<f64>() / x.len() as f64;
    let var = x.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / x.len() as f64;
    let normed = x.iter().map(|x| (x - mean) / (var + EPS).sqrt());
    normed.zip(gain).map(|(x, g)| x * g).collect()
}

fn rms_norm(x: &[f64], gain: &[f64]) -> Vec<f64> {
    let rms = (dot(x, x) / x.len() as f64 + EPS).sqrt();
    x.iter().zip(gain).map(|(x, g)| x / rms * g).collect()
}
