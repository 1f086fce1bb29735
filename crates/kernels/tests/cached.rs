//! A context kept and queried again gives what the joint computation gives.
#![allow(clippy::unwrap_used, missing_docs)]

mod common;

use common::{Noise, Owned, computes, error};
use lumi_kernels::{Compute, Cpu, PackedBlock, Pattern, Precision};

/// Tokens `start..start + len` of every batch element of x [batch, n, d].
fn tokens(x: &[f32], batch: usize, d: usize, start: usize, len: usize) -> Vec<f32> {
    let per = x.len() / batch;
    x.chunks_exact(per)
        .flat_map(|x| &x[start * d..][..len * d])
        .copied()
        .collect()
}

/// Equal to the bit with packed kernels. The portable path's library adds in an order that may
/// depend on the number of rows, so there only to rounding.
fn assert_same(compute: Compute, got: &[f32], want: &[f32], what: &str) {
    if compute.cpu() == Cpu::Portable {
        let want: Vec<f64> = want.iter().map(|&x| f64::from(x)).collect();
        let e = if want.is_empty() {
            0.0
        } else {
            error(got, &want)
        };
        assert!(e < 2e-6, "{compute:?} {what}: {e}");
    } else {
        assert!(got == want, "{compute:?} {what}: bits differ");
    }
}

#[test]
fn queries_match_the_joint_computation() {
    // (dim, head_dim, hidden, batch, context, group, groups)
    for (d, dh, m, batch, context, group, groups) in [
        (32, 16, 128, 2, 7, 3, 4),
        (64, 32, 256, 1, 40, 15, 2),
        (40, 8, 72, 2, 3, 2, 3),
        (30, 5, 33, 1, 5, 1, 6),
        (48, 48, 96, 3, 1, 37, 1),
        // Fewer queries than keys, over several key blocks; more queries than keys.
        (64, 64, 256, 1, 1100, 5, 1),
        (64, 32, 256, 1, 33, 530, 2),
        (128, 64, 600, 2, 97, 33, 5),
        // No context at all.
        (32, 16, 64, 2, 0, 5, 3),
    ] {
        let owned = Owned::new(d, dh, m, 3);
        let n = context + group * groups;
        let x = Noise(77).vec(batch * n * d, 1.5);
        for (compute, _) in computes() {
            let block = PackedBlock::new(owned.shape, &owned.weights(), compute);
            let mut joint = vec![f32::NAN; x.len()];
            block.forward(&x, batch, n, Pattern { context, group }, &mut joint);

            let first = tokens(&x, batch, d, 0, context);
            let mut out = vec![f32::NAN; first.len()];
            let kept = block.forward_context(&first, batch, context, &mut out);
            let want = tokens(&joint, batch, d, 0, context);
            assert_same(compute, &out, &want, "context");
            let operand = match (compute.precision(), compute.cpu()) {
                (Precision::F32, _) | (_, Cpu::Portable | Cpu::Avx2 | Cpu::Avx512F32) => 4,
                (Precision::Bf16, _) => 2,
            };
            assert!(kept.bytes() >= 2 * batch * context * d * operand);
            assert_eq!((kept.batch(), kept.context()), (batch, context));

            let alone = block.key_values(&first, batch, context, false);
            for kept in [&kept, &alone] {
                // All groups in one call, then one by one.
                let rest = tokens(&x, batch, d, context, group * groups);
                let mut out = vec![f32::NAN; rest.len()];
                let all = vec![group; groups];
                block.forward_queries(kept, &rest, batch, group * groups, &all, None, &mut out);
                let want = tokens(&joint, batch, d, context, group * groups);
                assert_same(compute, &out, &want, "all groups");
                for g in 0..groups {
                    let start = context + g * group;
                    let one = tokens(&x, batch, d, start, group);
                    let mut out = vec![f32::NAN; one.len()];
                    block.forward_queries(kept, &one, batch, group, &[group], None, &mut out);
                    let want = tokens(&joint, batch, d, start, group);
                    assert_same(compute, &out, &want, "one group");
                }
            }
        }
    }
}

#[test]
fn a_bad_context_spoils_every_query() {
    let (d, context, group) = (64, 20, 6);
    let owned = Owned::new(d, 32, 128, 37);
    let query = Noise(5).vec(group * d, 1.0);
    for (compute, _) in computes() {
        let block = PackedBlock::new(owned.shape, &owned.weights(), compute);
        let mut x = Noise(41).vec(context * d, 1.0);
        x[7] = f32::NAN;
        let kept = block.key_values(&x, 1, context, false);
        let mut out = vec![0.0; query.len()];
        block.forward_queries(&kept, &query, 1, group, &[group], None, &mut out);
        assert!(out.iter().all(|y| y.is_nan()), "{compute:?}");
    }
}

#[test]
#[should_panic(expected = "queries: batch size of the keys and values")]
fn another_batch_is_refused() {
    let owned = Owned::new(32, 16, 64, 1);
    let block = PackedBlock::new(owned.shape, &owned.weights(), Precision::F32);
    let kept = block.key_values(&[0.5; 4 * 32], 1, 4, false);
    let mut out = vec![0.0; 4 * 32];
    block.forward_queries(&kept, &[0.5; 4 * 32], 2, 2, &[2], None, &mut out);
}

#[test]
#[should_panic(expected = "queries: keys and values of another block")]
fn another_block_is_refused() {
    let [a, b] = [64, 96].map(|hidden| {
        let owned = Owned::new(32, 16, hidden, 1);
        PackedBlock::new(owned.shape, &owned.weights(), Precision::F32)
    });
    let kept = a.key_values(&[0.5; 4 * 32], 1, 4, false);
    b.forward_queries(&kept, &[0.5; 64], 1, 2, &[2], None, &mut [0.0; 64]);
}
