//! Times blocks, products and convolutions: milliseconds (best and median), GFLOP/s of the median,
//! and processor time of all threads a call (on Linux). Blocks count `24 n d² + 4 n² d` FLOP a sequence (less with
//! streams), three times that with backward. Lines that begin with `ceiling` are fused multiply-adds alone, on every
//! thread of the pool.
//!
//! `cargo run --release -p lumi-kernels --example bench [seconds per line] [words of the line]`
#![allow(clippy::unwrap_used, unsafe_code)] // Of the ceiling's instructions.

use std::time::Instant;

use lumi_kernels::{
    Anchors, BlockShape, BlockWeights, Compute, ConvShape, ConvWanted, Cpu, Frames, PackedBlock,
    Pattern, Precision, Save, Sight, Tokens, Wanted, block_backward, block_forward_saved, conv2d,
    conv2d_backward, matmul, matmul_tn,
};

fn main() {
    let seconds = std::env::args().nth(1).map_or(1.0, |s| s.parse().unwrap());
    let bench = Bench {
        seconds,
        words: std::env::args().skip(2).collect(),
    };
    bench.ceiling();
    for (cpu, name) in Cpu::ALL {
        // The emulation's speed says nothing.
        if !cpu.is_supported() || cpu == Cpu::AmxEmulated {
            continue;
        }
        for (precision, operand) in [(Precision::F32, "f32"), (Precision::Bf16, "bf16")] {
            if precision == Precision::Bf16
                && matches!(cpu, Cpu::Avx512F32 | Cpu::Avx2 | Cpu::Portable)
            {
                continue;
            }
            bench.all(&format!("{operand} {name}"), Compute::new(precision, cpu));
        }
    }
}

struct Bench {
    seconds: f64,
    words: Vec<String>,
}

impl Bench {
    fn all(&self, name: &str, compute: Compute) {
        for mnk in [
            [4096, 2304, 768],
            [4096, 768, 3072],
            [320, 768, 256],
            [3584, 1024, 256],
        ] {
            self.product(&format!("{name} matmul nt {mnk:?}"), compute, mnk, false);
        }
        for mnk in [[3072, 768, 4096], [1024, 256, 3584], [192, 192, 3200]] {
            self.product(&format!("{name} matmul tn {mnk:?}"), compute, mnk, true);
        }
        for (batch, n, d) in [(1, 4096, 768), (8, 384, 256), (1, 320, 256)] {
            let block = Block::new(batch, n, d, 64);
            let sizes = format!("{batch} x n {n} d {d}");
            self.forward(&format!("{name} forward {sizes}"), compute, &block);
            self.train(&format!("{name} train {sizes}"), compute, &block);
        }
        for dh in [32, 48] {
            let line = format!("{name} train 16 x n 200 d 192 dh {dh}");
            self.train(&line, compute, &Block::new(16, 200, 192, dh));
        }
        for (what, framed) in [("plain", false), ("frames", true)] {
            let mut block = Block::new(8, 960, 128, 32);
            block.frames = framed.then(|| frames(8 * 960));
            let sizes = format!("8 x n 960 d 128 {what}");
            self.forward(&format!("{name} forward {sizes}"), compute, &block);
            self.train(&format!("{name} train {sizes}"), compute, &block);
        }
        // Encoder: learned tokens, eight views, a light. Decoder: four views of a context.
        for (dim, dh) in [(128, 32), (192, 48)] {
            for external in [None, Some(576)] {
                for (what, streams, anchored) in [
                    ("plain", 1, false),
                    ("anchors", 1, true),
                    ("streams", 2, false),
                    ("anchors streams", 2, true),
                ] {
                    let groups = if external.is_some() { 4 } else { 10 };
                    let mut block = Block::of(4, 64 * groups, dim, dh, streams);
                    block.groups = vec![64; groups];
                    block.turn(anchored, external);
                    let kind = if external.is_some() {
                        "decode"
                    } else {
                        "encode"
                    };
                    let sizes = format!("{kind} d {dim} dh {dh} {what}");
                    self.forward(&format!("{name} forward {sizes}"), compute, &block);
                    self.train(&format!("{name} train {sizes}"), compute, &block);
                }
            }
        }
        for (n, context, d) in [(1024, 3072, 768), (64, 256, 256), (64, 64, 192)] {
            let line = format!("{name} queries {n} of context {context} d {d}");
            self.cached(&line, compute, n, context, d);
        }
        for (side, input, output, kernel, batch) in [
            (64, 256, 256, 3, 1),
            (256, 64, 64, 3, 1),
            (8, 64, 64, 3, 32),
            (64, 256, 192, 1, 1),
            (256, 64, 3, 3, 1),
        ] {
            let shape = ConvShape {
                batch,
                input,
                output,
                kernel,
                height: side,
                width: side,
            };
            let sizes = format!("{kernel}x{kernel} {batch}x{side}² {input}->{output}");
            self.convolution(&format!("{name} conv {sizes}"), compute, shape);
        }
    }

    /// What no f32 product on this machine can pass.
    fn ceiling(&self) {
        #[cfg(target_arch = "x86_64")]
        {
            const STEPS: usize = 1 << 20;
            let threads = rayon::current_num_threads();
            let flop = |lanes: usize| (threads * STEPS * ceiling::SUMS * lanes * 2) as f64;
            let line = "ceiling f32 avx2";
            if is_x86_feature_detected!("fma") && !self.skips(line) {
                self.time(line, flop(8), || {
                    // SAFETY: the instructions are there.
                    rayon::broadcast(|_| unsafe { ceiling::fma256(STEPS) });
                });
            }
            let line = "ceiling f32 avx512";
            if is_x86_feature_detected!("avx512f") && !self.skips(line) {
                self.time(line, flop(16), || {
                    // SAFETY: as above.
                    rayon::broadcast(|_| unsafe { ceiling::fma512(STEPS) });
                });
            }
        }
    }

    /// Only the lines that contain every word are run.
    fn skips(&self, line: &str) -> bool {
        self.words.iter().any(|word| !line.contains(word))
    }

    fn time(&self, line: &str, flop: f64, mut f: impl FnMut()) {
        f();
        let (start, cpu) = (Instant::now(), processor_seconds());
        let mut times = Vec::new();
        while start.elapsed().as_secs_f64() < self.seconds || times.len() < 3 {
            let once = Instant::now();
            f();
            times.push(once.elapsed().as_secs_f64());
        }
        let cpu = (processor_seconds() - cpu) / times.len() as f64;
        times.sort_by(f64::total_cmp);
        let (best, median) = (times[0], times[times.len() / 2]);
        println!(
            "{line:48} {:9.3} {:9.3} ms {:7.0} GFLOP/s {:9.3} ms cpu",
            best * 1e3,
            median * 1e3,
            flop / median * 1e-9,
            cpu * 1e3
        );
    }

    fn product(&self, line: &str, compute: Compute, mnk: [usize; 3], tn: bool) {
        if self.skips(line) {
            return;
        }
        let [m, n, k] = mnk;
        let (a, b) = (noise(m * k, 1.0), noise(n * k, 1.0));
        let mut c = vec![0.0; m * n];
        self.time(line, 2.0 * (m * n * k) as f64, || {
            let f = if tn { matmul_tn } else { matmul };
            f(compute, &a, &b, &mut c, mnk);
        });
    }

    fn forward(&self, line: &str, compute: Compute, block: &Block) {
        if self.skips(line) {
            return;
        }
        let packed = PackedBlock::new(block.shape, &block.weights(), compute);
        let mut out = block.x.clone();
        self.time(line, block.flop(), || {
            let (x, sight) = (block.tokens(), block.sight());
            packed.forward(x, block.batch, block.n, sight, &mut out);
        });
    }

    fn train(&self, line: &str, compute: Compute, block: &Block) {
        if self.skips(line) {
            return;
        }
        let weights = block.weights();
        let grad = noise(block.x.len(), 1.0);
        let mut out = block.x.clone();
        self.time(line, 3.0 * block.flop(), || {
            let (x, sight) = (block.tokens(), block.sight());
            let saved = block_forward_saved(
                block.shape,
                &weights,
                compute,
                Save::Activations,
                x,
                block.batch,
                block.n,
                sight,
                &mut out,
            );
            let all = Wanted::All;
            block_backward(block.shape, &weights, &saved, x, sight, &grad, all);
        });
    }

    /// One view's tokens against a context that is kept.
    fn cached(&self, line: &str, compute: Compute, n: usize, context: usize, d: usize) {
        if self.skips(line) {
            return;
        }
        let block = Block::new(1, context, d, 64);
        let packed = PackedBlock::new(block.shape, &block.weights(), compute);
        let kept = packed.key_values(&block.x, 1, context, false);
        let x = noise(n * d, 1.0);
        let mut out = x.clone();
        let flop = 24 * n * d * d + 4 * n * (n + context) * d;
        self.time(line, flop as f64, || {
            packed.forward_queries(&kept, &x, 1, n, &[n], None, &mut out);
        });
    }

    fn convolution(&self, line: &str, compute: Compute, shape: ConvShape) {
        if self.skips(line) {
            return;
        }
        let pixels = shape.batch * shape.height * shape.width;
        let x = noise(pixels * shape.input, 1.0);
        let grad = noise(pixels * shape.output, 1.0);
        let weights = noise(shape.output * shape.input * shape.kernel.pow(2), 0.1);
        let mut out = grad.clone();
        let flop = 2.0 * (pixels * weights.len()) as f64;
        self.time(&format!("{line} fwd"), flop, || {
            conv2d(shape, compute, &x, &weights, None, &mut out);
        });
        let wanted = ConvWanted {
            x: true,
            weights: true,
            bias: false,
        };
        self.time(&format!("{line} bwd"), 2.0 * flop, || {
            conv2d_backward(shape, compute, &x, &weights, &grad, wanted);
        });
    }
}

/// Time that all threads of this process have run; unlike elapsed time it means something on a
/// machine that is busy with other things. NaN where the system does not say.
fn processor_seconds() -> f64 {
    let Ok(threads) = std::fs::read_dir("/proc/self/task") else {
        return f64::NAN;
    };
    let nanoseconds = threads.flatten().map(|thread| {
        let line = std::fs::read_to_string(thread.path().join("schedstat")).unwrap_or_default();
        let first = line.split(' ').next().and_then(|n| n.parse::<f64>().ok());
        first.unwrap_or(f64::NAN)
    });
    nanoseconds.sum::<f64>() * 1e-9
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

/// Fused multiply-adds of registers: enough independent sums that none waits for another.
#[cfg(target_arch = "x86_64")]
mod ceiling {
    use std::arch::x86_64::*;
    use std::hint::black_box;

    pub const SUMS: usize = 12;

    #[target_feature(enable = "avx,fma")]
    pub fn fma256(steps: usize) {
        let x = _mm256_set1_ps(black_box(0.5));
        let mut sums = [x; SUMS];
        for _ in 0..steps {
            for sum in &mut sums {
                *sum = _mm256_fmadd_ps(*sum, x, x);
            }
        }
        black_box(sums);
    }

    #[target_feature(enable = "avx512f")]
    pub fn fma512(steps: usize) {
        let x = _mm512_set1_ps(black_box(0.5));
        let mut sums = [x; SUMS];
        for _ in 0..steps {
            for sum in &mut sums {
                *sum = _mm512_fmadd_ps(*sum, x, x);
            }
        }
        black_box(sums);
    }
}

/// A random block and its input.
struct Block {
    shape: BlockShape,
    all: [Vec<f32>; 9],
    batch: usize,
    n: usize,
    x: Vec<f32>,
    /// Tokens of an external context.
    context: Option<Vec<f32>>,
    /// Query groups, where there is a context or there are anchors.
    groups: Vec<usize>,
    /// Tables of queries and keys, of three depths.
    anchors: Option<[Vec<f32>; 2]>,
    /// Of the tokens, if they have any.
    frames: Option<Vec<f32>>,
}

/// A frame of one turn and one step for every token.
fn frames(tokens: usize) -> Vec<f32> {
    let frame = [0.6, -0.8, 0.0, 0.8, 0.6, 0.0, 0.0, 0.0, 1.0, 0.2, 0.1, -0.3];
    frame.repeat(tokens)
}

impl Block {
    fn new(batch: usize, n: usize, dim: usize, head_dim: usize) -> Self {
        Self::of(batch, n, dim, head_dim, 1)
    }

    fn of(batch: usize, n: usize, dim: usize, head_dim: usize, streams: usize) -> Self {
        let hidden = 4 * dim;
        let s = 1.0 / (dim as f32).sqrt();
        let gain = |n: usize| vec![1.0; n];
        let all = [
            gain(dim),
            noise(2 * dim * dim, s),
            noise(dim * dim / streams, s),
            gain(head_dim),
            gain(head_dim),
            noise(dim * dim / streams, s),
            gain(dim),
            noise(hidden * dim / streams, s),
            noise(dim * hidden / streams, s),
        ];
        let shape = BlockShape {
            dim,
            head_dim,
            hidden,
            streams,
        };
        let x = noise(batch * n * dim, 1.0);
        Self {
            shape,
            all,
            batch,
            n,
            x,
            context: None,
            groups: Vec::new(),
            anchors: None,
            frames: None,
        }
    }

    fn weights(&self) -> BlockWeights<'_> {
        let [norm1, qk, v, q_norm, k_norm, proj, norm2, fc1, fc2] = &self.all;
        BlockWeights {
            norm1,
            qk,
            v,
            q_norm,
            k_norm,
            proj,
            norm2,
            fc1,
            fc2,
        }
    }

    fn tokens(&self) -> Tokens<'_> {
        Tokens {
            x: &self.x,
            frames: self.frames.as_deref().map(Frames::new),
        }
    }

    /// Sets anchors and an external context of `context` tokens.
    fn turn(&mut self, anchored: bool, context: Option<usize>) {
        let pairs = self.shape.head_dim / 4;
        let keys = context.unwrap_or(self.n);
        let all = [self.n, self.groups.len() * 3 * keys];
        let table = |tokens: usize| [0.6, -0.8].repeat(self.batch * tokens * pairs);
        self.anchors = anchored.then(|| all.map(table));
        self.context = context.map(|m| noise(self.batch * m * self.shape.dim, 1.0));
    }

    fn sight(&self) -> Sight<'_> {
        let groups = &self.groups;
        let anchors = self.anchors.as_ref().map(|[queries, keys]| Anchors {
            depths: 3,
            queries,
            keys,
        });
        match (&self.context, anchors) {
            (Some(context), anchors) => Sight::Context {
                context: context.into(),
                groups,
                anchors,
            },
            (None, Some(anchors)) => Sight::Anchored { groups, anchors },
            (None, None) => Pattern::full(self.n).into(),
        }
    }

    fn flop(&self) -> f64 {
        let (n, d, streams) = (self.n, self.shape.dim, self.shape.streams);
        let m = self
            .context
            .as_ref()
            .map_or(0, |c| c.len() / (self.batch * d));
        let seen = if m > 0 { m + self.groups[0] } else { n };
        let matrices = 4 * n * d * d + 20 * n * d * d / streams + (2 + 2 / streams) * m * d * d;
        (self.batch * (matrices + 4 * n * seen * d)) as f64
    }
}
