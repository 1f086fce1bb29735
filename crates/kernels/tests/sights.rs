//! Split streams, depth anchors and external contexts, alone and together, against the f64 reference.
#![allow(clippy::unwrap_used, missing_docs)]

mod common;

use common::world::{Case, World, case};
use common::{NAMES, Noise, computes, error, in_order, weight, wide};
use lumi_kernels::reference::Weights;
use lumi_kernels::{Anchors, BlockGrads, FRAME, PackedBlock, Save, Wanted};

const CASES: [Case; 11] = [
    // Each alone.
    case(32, 16, 64, 2, 2, &[7], Some(0), None, false),
    case(40, 8, 72, 1, 2, &[3, 1, 4], Some(11), None, false),
    case(32, 16, 64, 1, 2, &[2, 5, 3], None, Some(2), false),
    case(32, 16, 64, 1, 2, &[4, 4], Some(6), Some(3), false),
    // All together; heads of 20 channels: anchors turn 10 and the frames 8 of the others.
    case(64, 16, 130, 2, 2, &[4, 4, 4], Some(9), Some(3), true),
    case(40, 20, 66, 1, 1, &[5, 2], None, Some(2), true),
    case(96, 48, 96, 2, 1, &[6, 7], Some(37), Some(1), true),
    case(96, 24, 200, 2, 1, &[5, 5, 3], None, Some(3), true),
    case(192, 48, 1100, 2, 1, &[3, 2], Some(5), Some(3), true),
    // Several key blocks, tiles and parts.
    case(32, 16, 48, 2, 1, &[130, 40, 1], Some(530), Some(2), false),
    case(32, 32, 40, 1, 1, &[400, 64, 64, 64, 2], None, Some(1), true),
];

#[test]
fn forward_matches_the_reference() {
    for case in CASES {
        let world = World::new(case);
        let w = Weights::from(&world.owned.weights());
        let want = world.want(&w, &wide(&world.x), &wide(&world.context));
        for (compute, allowed) in computes() {
            let out = world.forward(compute);
            let e = error(&out, &want);
            assert!(e < allowed, "{compute:?} {case:?}: {e}");
        }
    }
}

#[test]
fn large_gains_take_the_maximum() {
    let mut world = World::new(case(64, 32, 64, 2, 1, &[30, 30], Some(520), Some(2), false));
    for gain in [3, 4] {
        world.owned.all[gain].iter_mut().for_each(|g| *g *= 6.0);
    }
    let w = Weights::from(&world.owned.weights());
    let want = world.want(&w, &wide(&world.x), &wide(&world.context));
    for (compute, allowed) in computes() {
        let e = error(&world.forward(compute), &want);
        // Scores near 200: their own rounding is amplified.
        assert!(e < 10.0 * allowed, "{compute:?}: {e}");
    }
}

#[test]
fn gradients_match_finite_differences() {
    let step = 1e-5;
    for case in CASES {
        let world = World::new(case);
        let w = Weights::from(&world.owned.weights());
        let (x, context) = (wide(&world.x), wide(&world.context));
        let loss = |w: &Weights, x: &[f64], context: &[f64]| -> f64 {
            let out = world.want(w, x, context);
            out.iter()
                .zip(&world.g)
                .map(|(y, &g)| y * f64::from(g))
                .sum()
        };
        let samples = if world.n > 60 || case.dim > 100 {
            4
        } else {
            24
        };
        let mut random = Noise(19);
        // Weights, then x, then the context.
        let wants: Vec<(Vec<usize>, Vec<f64>)> = (0..11)
            .map(|parameter| {
                let len = match parameter {
                    9 => x.len(),
                    10 => context.len(),
                    p => world.owned.all[p].len(),
                };
                let samples = if len == 0 { 0 } else { samples };
                let at: Vec<usize> = (0..samples)
                    .map(|_| ((random.next() + 1.0) * 0.5 * len as f32) as usize % len)
                    .collect();
                let slopes = at.iter().map(|&i| {
                    let moved = |delta: f64| {
                        let (mut w, mut x, mut context) = (w.clone(), x.clone(), context.clone());
                        match parameter {
                            9 => x[i] += delta,
                            10 => context[i] += delta,
                            p => weight(&mut w, p)[i] += delta,
                        }
                        loss(&w, &x, &context)
                    };
                    (moved(step) - moved(-step)) / (2.0 * step)
                });
                let slopes = slopes.collect();
                (at, slopes)
            })
            .collect();
        for (compute, allowed) in computes() {
            let (out, got) = world.grads(compute, Save::Activations, Wanted::All);
            assert_eq!(out, world.forward(compute));
            assert_eq!(got.context.len(), context.len());
            let names = NAMES.iter().chain(&["x", "context"]);
            let all = in_order(&got).into_iter().chain([&got.x, &got.context]);
            for ((name, all), (at, want)) in names.zip(all).zip(&wants) {
                let picked: Vec<f32> = at.iter().map(|&i| all[i]).collect();
                let e = if at.is_empty() {
                    0.0
                } else {
                    error(&picked, want)
                };
                // Few samples, and sums that cancel: looser than the values themselves.
                assert!(e < 8.0 * allowed, "{compute:?} {case:?} {name}: {e}");
            }
            let (_, again) = world.grads(compute, Save::Input, Wanted::All);
            assert_same(&got, &again);
            // A frozen block: the same gradients, without those of the matrices.
            let (_, frozen) = world.grads(compute, Save::Activations, Wanted::NoMatrices);
            assert!((&got.x, &got.context) == (&frozen.x, &frozen.context));
            for (i, (a, b)) in in_order(&got).iter().zip(in_order(&frozen)).enumerate() {
                let matrix = [1, 2, 5, 7, 8].contains(&i);
                assert!(if matrix { b.is_empty() } else { *a == b });
            }
        }
    }
}

fn assert_same(a: &BlockGrads, b: &BlockGrads) {
    assert!(a.x == b.x && a.context == b.context);
    assert_eq!(in_order(a), in_order(b));
}

#[test]
fn threads_change_no_bit() {
    for case in [
        case(64, 16, 128, 2, 2, &[20, 20, 31], Some(77), Some(3), true),
        case(32, 16, 64, 1, 1, &[500, 64, 64, 300], None, Some(2), false),
        case(32, 16, 64, 2, 1, &[64; 12], Some(150), None, false),
    ] {
        let world = World::new(case);
        for (compute, _) in computes() {
            let run = |threads| {
                let pool = rayon::ThreadPoolBuilder::new().num_threads(threads);
                let pool = pool.build().unwrap();
                pool.install(|| world.grads(compute, Save::Activations, Wanted::All))
            };
            let ((out, one), (again, two)) = (run(1), run(2));
            assert!(out == again, "{compute:?} {case:?}");
            assert_same(&one, &two);
        }
    }
}

#[test]
fn kept_keys_give_the_same() {
    for case in CASES {
        let Some(m) = case.context else { continue };
        let world = World::new(case);
        for (compute, _) in computes() {
            let joint = world.forward(compute);
            let block = PackedBlock::new(world.owned.shape, &world.owned.weights(), compute);
            let anchored = case.depths.is_some();
            let kept = block.key_values(world.context(), case.batch, m, anchored);
            let mut out = vec![f32::NAN; joint.len()];
            block.forward_queries(
                &kept,
                world.x(),
                case.batch,
                world.n,
                case.groups,
                world.anchors(),
                &mut out,
            );
            assert!(out == joint, "{compute:?} {case:?}");

            // The first group alone, with its part of the tables.
            if case.batch > 1 {
                continue;
            }
            let first = case.groups[0];
            let (d, dh) = (case.dim, case.head_dim);
            let x = world.tokens(&world.x[..first * d], &world.places[..first * FRAME]);
            let anchors = case.depths.map(|depths| Anchors {
                depths,
                queries: &world.queries[..first * dh / 2],
                keys: &world.keys[..depths * m * dh / 2],
            });
            let out = &mut out[..first * d];
            block.forward_queries(&kept, x, 1, first, &[first], anchors, out);
            // The portable path's library adds in an order that may depend on the number of rows.
            let e = error(out, &wide(&joint[..first * d]));
            assert!(e < 2e-6, "{compute:?} {case:?}: {e}");
        }
    }
}

/// What anchors are for: turning all queries and keys of a group alike changes nothing.
#[test]
fn turns_in_common_cancel() {
    let mut world = World::new(case(32, 16, 64, 1, 1, &[5, 4], Some(9), Some(2), false));
    let pairs = 4;
    let turned = |table: &mut [f32], angles: &[f32]| {
        for (pair, a) in table.chunks_exact_mut(2).zip(angles.iter().cycle()) {
            let ([c, s], (cos, sin)) = ([pair[0], pair[1]], (a.cos(), a.sin()));
            pair.copy_from_slice(&[c * cos - s * sin, c * sin + s * cos]);
        }
    };
    for (compute, allowed) in computes() {
        let before = world.forward(compute);
        let angles = Noise(9).vec(2 * pairs, 3.0);
        let (first, second) = angles.split_at(pairs);
        let (keys, queries) = (world.keys.len() / 2, 5 * pairs * 2);
        turned(&mut world.keys[..keys], first);
        turned(&mut world.keys[keys..], second);
        let moved = wide(&world.forward(compute));
        assert!(error(&before, &moved) > 0.01, "anchors do nothing");
        turned(&mut world.queries[..queries], first);
        turned(&mut world.queries[queries..], second);
        let after = wide(&world.forward(compute));
        assert!(error(&before, &after) < allowed, "{compute:?}");
    }
}

#[test]
fn nan_reaches_who_sees_it() {
    for depths in [None, Some(2)] {
        let case = case(64, 16, 128, 2, 1, &[5, 5, 5], Some(12), depths, false);
        for (compute, _) in computes() {
            let all_nan = |x: &[f32]| x.iter().all(|y| y.is_nan());
            let mut world = World::new(case);
            world.context[70] = f32::NAN;
            assert!(all_nan(&world.forward(compute)), "{compute:?}");
            let (_, grads) = world.grads(compute, Save::Activations, Wanted::All);
            assert!(all_nan(&grads.x) && all_nan(&grads.context), "{compute:?}");

            // In a group of tokens, that group alone.
            let mut world = World::new(case);
            world.x[6 * 64 + 40] = f32::NAN;
            let out = world.forward(compute);
            let spoilt = out.chunks_exact(5 * 64).map(all_nan);
            assert_eq!(spoilt.collect::<Vec<_>>(), [false, true, false]);
        }
    }
}

#[test]
#[should_panic(expected = "anchors: length of keys")]
fn short_tables_are_named() {
    let mut world = World::new(CASES[3]);
    world.keys.pop();
    world.forward(computes()[0].0);
}

#[test]
#[should_panic(expected = "groups: lengths [4, 4] are not 7 tokens")]
fn other_groups_are_named() {
    let mut world = World::new(CASES[3]);
    world.n = 7;
    world.x.truncate(2 * 7 * 32);
    world.forward(computes()[0].0);
}

#[test]
#[should_panic(expected = "queries: anchors, and keys and values for anchors")]
fn kept_keys_know_of_anchors() {
    let world = World::new(CASES[3]);
    let compute = computes()[0].0;
    let block = PackedBlock::new(world.owned.shape, &world.owned.weights(), compute);
    let kept = block.key_values(world.context(), 2, 6, false);
    let mut out = world.x.clone();
    let groups = world.case.groups;
    block.forward_queries(&kept, world.x(), 2, 8, groups, world.anchors(), &mut out);
}
