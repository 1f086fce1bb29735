//! Tokens with frames, against the f64 reference and by what frames mean.
#![allow(clippy::unwrap_used, missing_docs)]

mod common;

use common::{Noise, Owned, computes, error, frames, in_order, weight, wide};
use lumi_kernels::reference::{self, Sequence, Sight, Weights};
use lumi_kernels::{
    FRAME, Frames, PackedBlock, Pattern, Save, Tokens, Wanted, block_backward, block_forward_saved,
};

/// (dim, head_dim, hidden, batch, n, pattern); heads of 6 channels have two that stay as they are.
const CASES: [(usize, usize, usize, usize, usize, Pattern); 5] = [
    (
        32,
        16,
        128,
        2,
        7,
        Pattern {
            context: 7,
            group: 0,
        },
    ),
    (
        96,
        48,
        200,
        3,
        37,
        Pattern {
            context: 37,
            group: 0,
        },
    ),
    (
        40,
        8,
        72,
        2,
        9,
        Pattern {
            context: 3,
            group: 2,
        },
    ),
    (
        30,
        6,
        33,
        1,
        11,
        Pattern {
            context: 5,
            group: 3,
        },
    ),
    (
        64,
        32,
        128,
        1,
        300,
        Pattern {
            context: 200,
            group: 25,
        },
    ),
];

fn want(
    owned: &Owned,
    w: &Weights,
    x: &[f64],
    frames: &[f64],
    n: usize,
    pattern: Pattern,
) -> Vec<f64> {
    x.chunks_exact(n * owned.shape.dim)
        .zip(frames.chunks_exact(n * FRAME))
        .flat_map(|(x, frames)| {
            let frames = Some(frames);
            let x = Sequence { x, frames };
            reference::block(owned.shape, w, x, Sight::Pattern(pattern))
        })
        .collect()
}

#[test]
fn every_pass_matches_the_reference() {
    for (d, dh, m, batch, n, pattern) in CASES {
        let owned = Owned::new(d, dh, m, 3);
        let (x, places) = (Noise(77).vec(batch * n * d, 1.5), frames(batch * n, 5));
        let w = Weights::from(&owned.weights());
        let want = want(&owned, &w, &wide(&x), &wide(&places), n, pattern);
        let tokens = Tokens {
            x: &x,
            frames: Some(Frames::new(&places)),
        };
        for (compute, allowed) in computes() {
            let packed = PackedBlock::new(owned.shape, &owned.weights(), compute);
            let mut out = vec![f32::NAN; x.len()];
            packed.forward(tokens, batch, n, pattern, &mut out);
            let e = error(&out, &want);
            assert!(e < allowed, "{compute:?} d {d} n {n} {pattern:?}: {e}");
            if batch > 1 || pattern.context == n {
                continue;
            }
            // The context kept, then the groups.
            let (context, split) = (pattern.context, pattern.context * d);
            let part = |x, places| Tokens {
                x,
                frames: Some(Frames::new(places)),
            };
            let first = part(&x[..split], &places[..context * FRAME]);
            let rest = part(&x[split..], &places[context * FRAME..]);
            let kept = packed.forward_context(first, 1, context, &mut out[..split]);
            for kept in [&kept, &packed.key_values(first, 1, context, false)] {
                let out = &mut out[split..];
                let groups = vec![pattern.group; (n - context) / pattern.group];
                packed.forward_queries(kept, rest, 1, n - context, &groups, None, out);
            }
            let e = error(&out, &want);
            assert!(e < allowed, "{compute:?} kept, d {d} n {n}: {e}");
        }
    }
}

#[test]
fn gradients_match_finite_differences() {
    let step = 1e-5;
    for (d, dh, m, batch, n, pattern) in CASES {
        if n > 100 {
            continue;
        }
        let owned = Owned::new(d, dh, m, 7);
        let mut noise = Noise(13);
        let (x, g) = (noise.vec(batch * n * d, 1.0), noise.vec(batch * n * d, 1.0));
        let places = frames(batch * n, 9);
        let tokens = Tokens {
            x: &x,
            frames: Some(Frames::new(&places)),
        };
        let places = wide(&places);
        let loss = |w: &Weights, x: &[f64]| -> f64 {
            want(&owned, w, x, &places, n, pattern)
                .iter()
                .zip(&g)
                .map(|(y, &g)| y * f64::from(g))
                .sum()
        };
        let at = |len: usize| (0..8).map(move |i| i * 7919 % len);
        let (w, x64) = (Weights::from(&owned.weights()), wide(&x));
        let slope = |up: f64, down: f64| (up - down) / (2.0 * step);
        let of_x: Vec<f64> = at(x.len())
            .map(|i| {
                let moved = |delta: f64| {
                    let mut x = x64.clone();
                    x[i] += delta;
                    loss(&w, &x)
                };
                slope(moved(step), moved(-step))
            })
            .collect();
        // qk, v, q_norm, k_norm, proj
        let of_weights = [1, 2, 3, 4, 5].map(|part| -> Vec<f64> {
            let len = weight(&mut w.clone(), part).len();
            at(len)
                .map(|i| {
                    let moved = |delta: f64| {
                        let mut w = w.clone();
                        weight(&mut w, part)[i] += delta;
                        loss(&w, &x64)
                    };
                    slope(moved(step), moved(-step))
                })
                .collect()
        });
        for (compute, allowed) in computes() {
            for save in [Save::Activations, Save::Input] {
                let mut out = vec![0.0; x.len()];
                let weights = owned.weights();
                let saved = block_forward_saved(
                    owned.shape,
                    &weights,
                    compute,
                    save,
                    tokens,
                    batch,
                    n,
                    pattern,
                    &mut out,
                );
                let all = Wanted::All;
                let found = block_backward(owned.shape, &weights, &saved, tokens, pattern, &g, all);
                let of_all = in_order(&found);
                let of_all = of_all[1..6].iter().copied().zip(&of_weights);
                let pairs = [(&found.x, &of_x)].into_iter().chain(of_all);
                for (i, (found, want)) in pairs.enumerate() {
                    let picked: Vec<f32> = at(found.len()).map(|i| found[i]).collect();
                    let e = error(&picked, want);
                    assert!(e < 10.0 * allowed, "{compute:?} {save:?} d {d}, {i}: {e}");
                }
            }
        }
    }
}

/// What frames are for: the same motion of all of them changes nothing but for the norms of queries and keys, which a
/// rotation leaves alone.
#[test]
fn a_turned_world_is_the_same() {
    let (d, dh, n) = (32, 16, 9);
    let mut owned = Owned::new(d, dh, 64, 11);
    // Gains differ from channel to channel, which no rotation of channels survives.
    for gain in [3, 4] {
        owned.all[gain].fill(1.2);
    }
    let (x, places) = (Noise(3).vec(n * d, 1.0), frames(n, 21));
    let turn = &frames(1, 40)[..9];
    let turned: Vec<f32> = places
        .chunks_exact(FRAME)
        .flat_map(|frame| {
            let at = |i: usize, column: &dyn Fn(usize) -> f32| -> f32 {
                (0..3).map(|k| turn[3 * i + k] * column(k)).sum()
            };
            let mut moved = [0.0; FRAME];
            for i in 0..3 {
                for j in 0..3 {
                    moved[3 * i + j] = at(i, &|k| frame[3 * k + j]);
                }
                moved[9 + i] = at(i, &|k| frame[9 + k]);
            }
            moved
        })
        .collect();
    for (compute, allowed) in computes() {
        let packed = PackedBlock::new(owned.shape, &owned.weights(), compute);
        let [here, there] = [&places, &turned].map(|places| {
            let mut out = vec![0.0; x.len()];
            let tokens = Tokens {
                x: &x,
                frames: Some(Frames::new(places)),
            };
            packed.forward(tokens, 1, n, Pattern::full(n), &mut out);
            out
        });
        let mut plain = vec![0.0; x.len()];
        packed.forward(&x, 1, n, Pattern::full(n), &mut plain);
        assert!(error(&there, &wide(&here)) < allowed, "{compute:?}");
        assert!(
            error(&plain, &wide(&here)) > 0.01,
            "{compute:?}: frames do nothing"
        );
    }
}

#[test]
#[should_panic(expected = "block: number of frames")]
fn missing_frames_are_refused() {
    let owned = Owned::new(32, 16, 64, 1);
    let packed = PackedBlock::new(owned.shape, &owned.weights(), computes()[0].0);
    let (x, places) = (vec![0.5; 4 * 32], frames(3, 1));
    let tokens = Tokens {
        x: &x,
        frames: Some(Frames::new(&places)),
    };
    packed.forward(tokens, 1, 4, Pattern::full(4), &mut vec![0.0; 4 * 32]);
}
