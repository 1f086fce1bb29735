//! Random blocks, and the comparison every test uses.
#![allow(dead_code)] // Each test file uses its part.

pub mod world;

use lumi_kernels::reference::Weights;
use lumi_kernels::{BlockGrads, BlockShape, BlockWeights, Compute, Cpu, Precision};

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
    pub all: [Vec<f32>; 9],
}

pub const NAMES: [&str; 9] = [
    "norm1", "qk", "v", "q_norm", "k_norm", "proj", "norm2", "fc1", "fc2",
];

impl Owned {
    pub fn new(dim: usize, head_dim: usize, hidden: usize, seed: u64) -> Self {
        let shape = BlockShape {
            dim,
            head_dim,
            hidden,
            streams: 1,
        };
        Self::of(shape, seed)
    }

    pub fn of(shape: BlockShape, seed: u64) -> Self {
        let BlockShape {
            dim,
            head_dim,
            hidden,
            streams,
        } = shape;
        let mut r = Noise(seed * 2 + 0x9E37_79B9_7F4A_7C15);
        let scale = |inputs: usize| (3.0 / inputs as f32).sqrt();
        let (part, hidden_part) = (dim / streams, hidden / streams);
        let all = [
            r.gain(dim),
            r.vec(2 * dim * dim, scale(dim)),
            r.vec(dim * part, scale(part)),
            r.gain(head_dim),
            r.gain(head_dim),
            r.vec(dim * part, scale(part)),
            r.gain(dim),
            r.vec(hidden * part, scale(part)),
            r.vec(dim * hidden_part, scale(hidden_part)),
        ];
        Self { shape, all }
    }

    pub fn weights(&self) -> BlockWeights<'_> {
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
}

/// The gradients of the weights, in the order of `NAMES`.
pub fn in_order(g: &BlockGrads) -> [&Vec<f32>; 9] {
    [
        &g.norm1, &g.qk, &g.v, &g.q_norm, &g.k_norm, &g.proj, &g.norm2, &g.fc1, &g.fc2,
    ]
}

/// Weight number `i` of `NAMES`.
pub fn weight(w: &mut Weights, i: usize) -> &mut Vec<f64> {
    match i {
        0 => &mut w.norm1,
        1 => &mut w.qk,
        2 => &mut w.v,
        3 => &mut w.q_norm,
        4 => &mut w.k_norm,
        5 => &mut w.proj,
        6 => &mut w.norm2,
        7 => &mut w.fc1,
        _ => &mut w.fc2,
    }
}

/// `count` rotations (cos, sin), one in eight of them the identity.
pub fn rotations(count: usize, seed: u64) -> Vec<f32> {
    let mut noise = Noise(seed * 2 + 1);
    let angles = (0..count).map(|i| if i % 8 == 5 { 0.0 } else { 4.0 * noise.next() });
    angles.flat_map(|a| [a.cos(), a.sin()]).collect()
}

pub fn wide(x: &[f32]) -> Vec<f64> {
    x.iter().map(|&x| f64::from(x)).collect()
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
