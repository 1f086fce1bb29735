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
    pub qk: Vec<f64>,
    pub v: Vec<f64>,
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
            qk: wide(w.qk),
            v: wide(w.v),
            q_norm: wide(w.q_norm),
            k_norm: wide(w.k_norm),
            proj: wide(w.proj),
            norm2: wide(w.norm2),
            fc1: wide(w.fc1),
            fc2: wide(w.fc2),
        }
    }
}

/// Tokens [n, dim] of one sequence with frames [n, 12], or without any.
#[derive(Clone, Copy, Debug)]
#[allow(missing_docs)]
pub struct Sequence<'a> {
    pub x: &'a [f64],
    pub frames: Option<&'a [f64]>,
}

/// What the tokens of one sequence attend to, as [`crate::Sight`]; the groups are lengths.
#[derive(Clone, Copy, Debug)]
pub enum Sight<'a> {
    /// Tokens of their own sequence.
    Pattern(Pattern),
    /// All tokens of their own sequence.
    Anchored(&'a [usize], Anchors<'a>),
    /// An external context and their own group.
    Context(Sequence<'a>, &'a [usize], Option<Anchors<'a>>),
}

/// As [`crate::Anchors`], for one sequence.
#[derive(Clone, Copy, Debug)]
#[allow(missing_docs)]
pub struct Anchors<'a> {
    pub depths: usize,
    /// [n, dh/4, 2]
    pub queries: &'a [f64],
    /// [groups, depths, keys, dh/4, 2]
    pub keys: &'a [f64],
}

/// `block(x)` for one sequence.
pub fn block(shape: BlockShape, w: &Weights, x: Sequence, sight: Sight) -> Vec<f64> {
    let (d, dh, streams) = (shape.dim, shape.head_dim, shape.streams);
    let half = dh / 2;
    let n = x.x.len() / d;
    let (context, anchors) = match sight {
        Sight::Pattern(_) => (None, None),
        Sight::Anchored(_, anchors) => (None, Some(anchors)),
        Sight::Context(context, _, anchors) => (Some(context), anchors),
    };
    let turned = if anchors.is_some() { half } else { dh };
    let own = projected(shape, w, x, turned);
    let context = context.map_or(Vec::new(), |context| projected(shape, w, context, turned));
    let mut out = Vec::with_capacity(x.x.len());
    for (t, x_t) in x.x.chunks_exact(d).enumerate() {
        let mut attended = vec![0.0; d];
        for h in 0..d / dh {
            let turn_last = |mut x: Vec<f64>, angles: Option<&[f64]>| {
                if let Some(angles) = angles {
                    rotate(&mut x[half..], &angles[..half]);
                }
                x
            };
            let angles_of = |t: usize| anchors.map(|anchors| &anchors.queries[t * half..]);
            let key_angles = |group: usize, keys: usize, s: usize| {
                anchors.map(|anchors| {
                    let set = group * anchors.depths + h % anchors.depths;
                    &anchors.keys[(set * keys + s) * half..]
                })
            };
            // Tokens that t sees, and how their keys turn for it.
            let seen: Vec<(&[f64], Option<&[f64]>)> = match sight {
                Sight::Pattern(pattern) => {
                    let seen = (0..n).filter(|&s| sees(t, s, pattern));
                    seen.map(|s| (&own[s][..], None)).collect()
                }
                Sight::Anchored(groups, _) => {
                    let (group, _) = group_of(groups, t);
                    let all = own.iter().enumerate();
                    all.map(|(s, row)| (&row[..], key_angles(group, n, s)))
                        .collect()
                }
                Sight::Context(_, groups, _) => {
                    let (group, tokens) = group_of(groups, t);
                    let all = context.iter().enumerate();
                    all.map(|(s, row)| (&row[..], key_angles(group, context.len(), s)))
                        .chain(tokens.map(|s| (&own[s][..], angles_of(s))))
                        .collect()
                }
            };
            let q = rms_norm(&own[t][h * dh..][..dh], &w.q_norm);
            let q = turn_last(q, angles_of(t));
            let scores: Vec<f64> = seen
                .iter()
                .map(|(row, angles)| {
                    let k = rms_norm(&row[d + h * dh..][..dh], &w.k_norm);
                    dot(&q, &turn_last(k, *angles)) / (dh as f64).sqrt()
                })
                .collect();
            let max = scores.iter().copied().fold(f64::NEG_INFINITY, f64::max);
            let sum: f64 = scores.iter().map(|s| (s - max).exp()).sum();
            for ((row, _), score) in seen.iter().zip(&scores) {
                let p = (score - max).exp() / sum;
                for stream in 0..streams {
                    let part = dh / streams;
                    for c in 0..part {
                        let channel = stream * d / streams + h * part + c;
                        attended[channel] += p * row[2 * d + channel];
                    }
                }
            }
        }
        if let Some([_, back, _]) = motions(x, t) {
            turn(&mut attended, dh / streams, dh, &back);
        }
        let x1 = add(x_t, &linear(&w.proj, &attended, streams));
        let mut hidden = linear(&w.fc1, &layer_norm(&x1, &w.norm2, streams), streams);
        for h in &mut hidden {
            *h *= 0.5 * (1.0 + erf(*h / 2f64.sqrt()));
        }
        out.extend(add(&x1, &linear(&w.fc2, &hidden, streams)));
    }
    out
}

/// Rows q‖k‖v of tokens, in the world; frames turn the first `turned` channels of each head of q and k.
fn projected(shape: BlockShape, w: &Weights, x: Sequence, turned: usize) -> Vec<Vec<f64>> {
    let (d, dh, streams) = (shape.dim, shape.head_dim, shape.streams);
    let rows = x.x.chunks_exact(d).enumerate().map(|(t, token)| {
        let normed = layer_norm(token, &w.norm1, streams);
        let mut row = linear(&w.qk, &normed, 1);
        row.extend(linear(&w.v, &normed, streams));
        if let Some([to_world, _, of_queries]) = motions(x, t) {
            turn(&mut row[..d], dh, turned, &of_queries);
            turn(&mut row[d..2 * d], dh, turned, &to_world);
            turn(&mut row[2 * d..], dh / streams, dh, &to_world);
        }
        row
    });
    rows.collect()
}

/// M, M⁻¹ and M⁻ᵀ of a token.
fn motions(x: Sequence, t: usize) -> Option<[Matrix; 3]> {
    x.frames.map(|frames| {
        let to_world = matrix(&frames[t * FRAME..][..FRAME]);
        let back = rigid_inverse(&to_world);
        [to_world, back, transposed(&back)]
    })
}

/// Index and tokens of the group that token `t` is in.
fn group_of(groups: &[usize], t: usize) -> (usize, std::ops::Range<usize>) {
    let mut start = 0;
    for (i, len) in groups.iter().enumerate() {
        if t < start + len {
            return (i, start..start + len);
        }
        start += len;
    }
    panic!("token {t} is in no group of {groups:?}");
}

/// Pairs of `x` by their (cos, sin).
fn rotate(x: &mut [f64], angles: &[f64]) {
    for (pair, angle) in x.chunks_exact_mut(2).zip(angles.chunks_exact(2)) {
        let ([a, b], [cos, sin]) = ([pair[0], pair[1]], [angle[0], angle[1]]);
        pair.copy_from_slice(&[a * cos - b * sin, a * sin + b * cos]);
    }
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

/// `m·v` for every four channels `v` among the first `turned` of every `head_dim`.
fn turn(row: &mut [f64], head_dim: usize, turned: usize, m: &Matrix) {
    for head in row.chunks_exact_mut(head_dim) {
        for v in head[..turned.min(head_dim)].chunks_exact_mut(4) {
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

/// `w·x` for `w` [out, in/S], whose rows are of stream after stream, each reading its own part of x.
fn linear(w: &[f64], x: &[f64], streams: usize) -> Vec<f64> {
    let parts = w.chunks_exact(w.len() / streams);
    let parts = parts.zip(x.chunks_exact(x.len() / streams));
    parts
        .flat_map(|(w, x)| w.chunks_exact(x.len()).map(move |row| dot(row, x)))
        .collect()
}

/// Of each stream alone.
fn layer_norm(x: &[f64], gain: &[f64], streams: usize) -> Vec<f64> {
    let len = x.len() / streams;
    let mut out = Vec::with_capacity(x.len());
    for (x, gain) in x.chunks_exact(len).zip(gain.chunks_exact(len)) {
        let mean = x.iter().sum::<f64>() / len as f64;
        let var = x.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / len as f64;
        let normed = x.iter().map(|x| (x - mean) / (var + EPS).sqrt());
        out.extend(normed.zip(gain).map(|(x, g)| x * g));
    }
    out
}

fn rms_norm(x: &[f64], gain: &[f64]) -> Vec<f64> {
    let rms = (dot(x, x) / x.len() as f64 + EPS).sqrt();
    x.iter().zip(gain).map(|(x, g)| x / rms * g).collect()
}
