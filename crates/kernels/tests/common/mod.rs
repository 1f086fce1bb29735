//! Random blocks, and the comparison every test uses.
#![allow(dead_code)] // Each test file uses its part.

use lumi_kernels::{BlockShape, BlockWeights, Compute, Cpu, Precision};

/// A small deterministic generator; the tests need no more than noise.
pub struct Noise(pub u64);

impl Noise {
    pub fn next(&mut self) -> f32 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        (self.0 >> 40) as f32 / (1 << 23) as f32 - 1.0
    }

    pub fn vec(&mut self, len: usize, scale: f32) -> Vec<f32> {
        (0..len).map(|_| self.next() * scale).collect()
    }

    pub fn gain(&mut self, len: usize) -> Vec<f32> {
        (0..len).map(|_| 1.0 + 0.3 * self.next()).collect()
    }
}

/// Frames of `tokens` tokens, `[tokens, 12]`: rotations about drawn axes, and steps of up to one each way.
pub fn frames(tokens: usize, seed: u64) -> Vec<f32> {
    let mut noise = Noise(seed * 2 + 1);
    let mut all = Vec::new();
    for _ in 0..tokens {
        // A quaternion, normalised.
        let q: Vec<f64> = (0..4).map(|_| f64::from(noise.next()) + 1e-3).collect();
        let norm = q.iter().map(|v| v * v).sum::<f64>().sqrt();
        let [w, x, y, z] = [0, 1, 2, 3].map(|i| q[i] / norm);
        let rotation = [
            1.0 - 2.0 * (y * y + z * z),
            2.0 * (x * y - w * z),
            2.0 * (x * z + w * y),
            2.0 * (x * y + w * z),
            1.0 - 2.0 * (x * x + z * z),
            2.0 * (y * z - w * x),
            2.0 * (x * z - w * y),
            2.0 * (y * z + w * x),
            1.0 - 2.0 * (x * x + y * y),
        ];
        all.extend(rotation.map(|v| v as f32));
        all.extend(noise.vec(3, 1.0));
    }
    all
}

/// Owned weights, in the order of `BlockWeights`.
pub struct Owned {
    pub shape: BlockShape,
    pub all: [Vec<f32>; 8],
}

pub const NAMES: [&str; 8] = [
    "norm1", "qkv", "q_norm", "k_norm", "proj", "norm2", "fc1", "fc2",
];

impl Owned {
    pub fn new(dim: usize, head_dim: usize, hidden: usize, seed: u64) -> Self {
        let mut r = Noise(seed * 2 + 0x9E37_79B9_7F4A_7C15);
        let s = (3.0 / dim as f32).sqrt();
        let all = [
            r.gain(dim),
            r.vec(3 * dim * dim, s),
            r.gain(head_dim),
            r.gain(head_dim),
            r.vec(dim * dim, s),
            r.gain(dim),
            r.vec(hidden * dim, s),
            r.vec(dim * hidden, (3.0 / hidden as f32).sqrt()),
        ];
        let shape = BlockShape {
            dim,
            head_dim,
            hidden,
        };
        Self { shape, all }
    }

    pub fn weights(&self) -> BlockWeights<'_> {
        let [norm1, qkv, q_norm, k_norm, proj, norm2, fc1, fc2] = &self.all;
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

/// Every supported combination, with the relative rms error it is allowed.
pub fn computes() -> Vec<(Compute, f64)> {
    let mut all = Vec::new();
    for (cpu, _) in Cpu::ALL {
        if cpu.is_supported() {
            // The emulation differs in bf16 products alone.
            if cpu != Cpu::AmxEmulated {
                all.push((Compute::new(Precision::F32, cpu), 1e-5));
            }
            all.push((Compute::new(Precision::Bf16, cpu), 6e-3));
        }
    }
    all
}

/// Relative root-mean-square difference.
pub fn error(got: &[f32], want: &[f64]) -> f64 {
    assert_eq!(got.len(), want.len());
    let diff: f64 = got
        .iter()
        .zip(want)
        .map(|(&g, w)| (f64::from(g) - w).powi(2))
        .sum();
    let size: f64 = want.iter().map(|w| w * w).sum();
    // The gradients that vanish exactly (a softmax over one key) are compared absolutely.
    (diff / size.max(0.1 * want.len() as f64)).sqrt()
}
