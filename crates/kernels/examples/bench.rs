//! Times blocks and products: milliseconds (best and median) and GFLOP/s of the median.
//!
//! `cargo run --release -p lumi-kernels --example bench [seconds per line] [words of the line]`
#![allow(clippy::unwrap_used)]

use std::time::Instant;

use lumi_kernels::{
    BlockShape, BlockWeights, Compute, Cpu, PackedBlock, Pattern, Precision, Save, Wanted,
    block_backward, block_forward_saved, matmul, matmul_tn,
};

fn main() {
    let seconds = std::env::args().nth(1).map_or(1.0, |s| s.parse().unwrap());
    let mut computes = vec![("f32 portable", Compute::new(Precision::F32, Cpu::Portable))];
    if Cpu::Avx512.is_supported() {
        computes.push(("f32 avx512", Compute::new(Precision::F32, Cpu::Avx512)));
        computes.push(("bf16 avx512", Compute::new(Precision::Bf16, Cpu::Avx512)));
    }
    for (name, compute) in computes {
        for mnk in [
            [4096, 2304, 768],
            [4096, 768, 3072],
            [320, 768, 256],
            [3584, 1024, 256],
        ] {
            product(
                &format!("{name} matmul nt {mnk:?}"),
                seconds,
                compute,
                mnk,
                false,
            );
        }
        for mnk in [[1024, 256, 3584], [192, 192, 3200]] {
            product(
                &format!("{name} matmul tn {mnk:?}"),
                seconds,
                compute,
                mnk,
                true,
            );
        }
        forward(
            &format!("{name} forward n 4096 d 768"),
            seconds,
            compute,
            4096,
            768,
            64,
        );
        forward(
            &format!("{name} forward n 320 d 256"),
            seconds,
            compute,
            320,
            256,
            64,
        );
        for (batch, n, d, dh) in [
            (16, 224, 256, 64),
            (16, 200, 192, 32),
            (16, 200, 192, 48),
            (16, 200, 192, 64),
        ] {
            let line = format!("{name} train {batch} x n {n} d {d} dh {dh}");
            train(&line, seconds, compute, batch, n, d, dh);
        }
    }
}

fn noise(len: usize, scale: f32) -> Vec<f32> {
    let mut state = len as u64 + 0x9E37_79B9;
    let mut next = || {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        ((state >> 40) as f32 / (1 << 23) as f32 - 1.0) * scale
    };
    (0..len).map(|_| next()).collect()
}

/// Only the lines that contain every further argument are run.
fn skipped(line: &str) -> bool {
    std::env::args().skip(2).any(|word| !line.contains(&word))
}

fn time(line: &str, seconds: f64, flop: f64, mut f: impl FnMut()) {
    f();
    let start = Instant::now();
    let mut times = Vec::new();
    while start.elapsed().as_secs_f64() < seconds || times.len() < 3 {
        let once = Instant::now();
        f();
        times.push(once.elapsed().as_secs_f64());
    }
    times.sort_by(f64::total_cmp);
    let (best, median) = (times[0], times[times.len() / 2]);
    println!(
        "{line:44} {:9.3} {:9.3} ms {:7.0} GFLOP/s",
        best * 1e3,
        median * 1e3,
        flop / median * 1e-9
    );
}

fn product(line: &str, seconds: f64, compute: Compute, mnk: [usize; 3], tn: bool) {
    if skipped(line) {
        return;
    }
    let [m, n, k] = mnk;
    let (a, b) = (noise(m * k, 1.0), noise(n * k, 1.0));
    let mut c = vec![0.0; m * n];
    time(line, seconds, 2.0 * (m * n * k) as f64, || {
        let f = if tn { matmul_tn } else { matmul };
        f(compute, &a, &b, &mut c, mnk);
    });
}

struct Owned(BlockShape, [Vec<f32>; 8]);

impl Owned {
    fn new(dim: usize, head_dim: usize) -> Self {
        let hidden = 4 * dim;
        let s = 1.0 / (dim as f32).sqrt();
        let gain = |n: usize| vec![1.0; n];
        let shape = BlockShape {
            dim,
            head_dim,
            hidden,
        };
        let all = [
            gain(dim),
            noise(3 * dim * dim, s),
            gain(head_dim),
            gain(head_dim),
            noise(dim * dim, s),
            gain(dim),
            noise(hidden * dim, s),
            noise(dim * hidden, s),
        ];
        Self(shape, all)
    }

    fn weights(&self) -> BlockWeights<'_> {
        let [norm1, qkv, q_norm, k_norm, proj, norm2, fc1, fc2] = &self.1;
        BlockWeights {
            norm1,
            qkv,
            q_norm,
            k_norm,
            proj,
            norm2,
            fc1,
            fc2,
        }
    }
}

fn flop(n: usize, d: usize) -> f64 {
    (24 * n * d * d + 4 * n * n * d) as f64
}

fn forward(line: &str, seconds: f64, compute: Compute, n: usize, d: usize, dh: usize) {
    if skipped(line) {
        return;
    }
    let owned = Owned::new(d, dh);
    let packed = PackedBlock::new(owned.0, &owned.weights(), compute);
    let x = noise(n * d, 1.0);
    let mut out = x.clone();
    time(line, seconds, flop(n, d), || {
        packed.forward(&x, 1, n, Pattern::full(n), &mut out);
    });
}

fn train(line: &str, seconds: f64, compute: Compute, batch: usize, n: usize, d: usize, dh: usize) {
    if skipped(line) {
        return;
    }
    let owned = Owned::new(d, dh);
    let (shape, w) = (owned.0, owned.weights());
    let x = noise(batch * n * d, 1.0);
    let g = noise(batch * n * d, 1.0);
    let mut out = x.clone();
    time(line, seconds, 3.0 * batch as f64 * flop(n, d), || {
        let saved = block_forward_saved(
            shape,
            &w,
            compute,
            Save::Activations,
            &x,
            batch,
            n,
            Pattern::full(n),
            &mut out,
        );
        block_backward(shape, &w, &saved, &g, Wanted::All);
    });
}
