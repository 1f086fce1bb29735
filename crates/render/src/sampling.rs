//! Random numbers of a path: stratified over the samples of a pixel, the same whatever thread draws them.

use lumi_core::glam::{Vec2, Vec3};
use std::f32::consts::TAU;

/// Draws the numbers of one path. Each pair of dimensions is its own scrambled Sobol (0, 2) sequence
/// over the samples of the pixel (padding after Burley 2020), so few samples already cover each pair evenly.
#[derive(Clone, Debug)]
pub struct Sampler {
    pixel: u32,
    index: u32,
    mask: u32,
    dimension: u32,
}

/// A good 32-bit mix (finaliser of MurmurHash3).
#[must_use]
pub fn hash(mut x: u32) -> u32 {
    x ^= x >> 16;
    x = x.wrapping_mul(0x85eb_ca6b);
    x ^= x >> 13;
    x = x.wrapping_mul(0xc2b2_ae35);
    x ^ (x >> 16)
}

/// A permutation in which each bit depends on lower bits only (Laine and Karras 2011); on reversed
/// bits it is an Owen scrambling.
fn scramble_low(mut x: u32, seed: u32) -> u32 {
    x = x.wrapping_add(seed);
    x ^= x.wrapping_mul(0x6c50_b47c);
    x ^= x.wrapping_mul(0xb82f_1e52);
    x ^= x.wrapping_mul(0xc7af_e638);
    x ^ x.wrapping_mul(0x8d22_f6e6)
}

/// Second Sobol dimension of `index`, bits from the top.
fn sobol_second(mut index: u32) -> u32 {
    let (mut column, mut bits) = (1_u32 << 31, 0);
    while index != 0 {
        if index & 1 != 0 {
            bits ^= column;
        }
        index >>= 1;
        column ^= column >> 1;
    }
    bits
}

/// 24 bits as a number in [0, 1).
fn unit(bits: u32) -> f32 {
    (bits >> 8) as f32 * (1.0 / 16_777_216.0)
}

impl Sampler {
    /// The sampler of sample `index` of `count` in a pixel; `pixel` is any hash of view and pixel.
    #[must_use]
    pub fn new(pixel: u32, index: u32, count: u32) -> Self {
        Self {
            pixel,
            index,
            mask: count.max(1).next_power_of_two() - 1,
            dimension: 0,
        }
    }

    /// The next pair of numbers in [0, 1).
    pub fn pair(&mut self) -> Vec2 {
        self.dimension += 1;
        self.draw(self.index, self.mask)
    }

    /// The next dimension's pairs `0..count` of this path: stratified among each other and over the
    /// samples of the pixel.
    pub fn pairs(&mut self, count: u32) -> impl Iterator<Item = Vec2> + use<> {
        self.dimension += 1;
        let (sampler, n) = (self.clone(), count.next_power_of_two());
        let mask = (self.mask + 1) * n - 1;
        (0..count).map(move |i| sampler.draw(sampler.index * n + i, mask))
    }

    fn draw(&self, index: u32, mask: u32) -> Vec2 {
        let seed = hash(self.pixel ^ self.dimension.wrapping_mul(0x9e37_79b9));
        // Shuffling the order independently per pair keeps the pairs from being correlated.
        let shuffled = scramble_low(index.reverse_bits(), seed).reverse_bits() & mask;
        let first = scramble_low(shuffled, seed ^ 0x68bc_21eb).reverse_bits();
        let second = scramble_low(sobol_second(shuffled).reverse_bits(), seed ^ 0x02e5_be93);
        Vec2::new(unit(first), unit(second.reverse_bits()))
    }
}

/// Two unit vectors that make a right-handed frame with the unit vector `n` (Duff et al. 2017).
#[must_use]
pub fn frame(n: Vec3) -> (Vec3, Vec3) {
    let sign = 1.0_f32.copysign(n.z);
    let a = -1.0 / (sign + n.z);
    let b = n.x * n.y * a;
    (
        Vec3::new(1.0 + sign * n.x * n.x * a, sign * b, -sign * n.x),
        Vec3::new(b, sign + n.y * n.y * a, -n.y),
    )
}

/// Direction with density cosθ/π about +z.
#[must_use]
pub fn cosine_hemisphere(u: Vec2) -> Vec3 {
    let (s, c) = (TAU * u.y).sin_cos();
    let r = u.x.sqrt();
    Vec3::new(r * c, r * s, (1.0 - u.x).max(0.0).sqrt())
}

/// Weight of a sample with density `pdf` against another strategy's `other` (power heuristic).
#[must_use]
pub fn power_weight(pdf: f32, other: f32) -> f32 {
    let (a, b) = (pdf * pdf, other * other);
    if a.is_infinite() {
        1.0
    } else {
        a / (a + b).max(f32::MIN_POSITIVE)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pairs_are_stratified() {
        for pixel in 0..20 {
            for dimension in 0..5 {
                let (mut columns, mut cells) = ([0; 16], [0; 16]);
                for i in 0..16 {
                    let mut sampler = Sampler::new(hash(pixel), i, 16);
                    for _ in 0..dimension {
                        sampler.pair();
                    }
                    let p = sampler.pair();
                    columns[(p.x * 16.0) as usize] += 1;
                    cells[(p.x * 4.0) as usize * 4 + (p.y * 4.0) as usize] += 1;
                }
                assert!(columns.iter().chain(&cells).all(|&n| n == 1));
            }
        }
    }

    #[test]
    fn dimensions_are_not_correlated() {
        let mut sum = 0.0;
        for pixel in 0..200 {
            for i in 0..16 {
                let mut sampler = Sampler::new(hash(pixel), i, 16);
                let (a, b) = (sampler.pair(), sampler.pair());
                sum += (a.x - 0.5) * (b.x - 0.5);
            }
        }
        // Standard deviation of the mean of 3200 products is 1/12/√3200 = 0.0015.
        assert!((sum / 3200.0_f32).abs() < 0.006, "{}", sum / 3200.0);
    }

    #[test]
    fn frames_are_right_handed() {
        for n in [Vec3::Z, Vec3::NEG_Z, Vec3::new(0.6, -0.64, 0.48)] {
            let (t, b) = frame(n);
            assert!(t.cross(b).distance(n) < 1e-5);
        }
    }
}
