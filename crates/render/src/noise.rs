//! Gradient noise and cells on the integer lattice.

use crate::sampling::hash;
use lumi_core::glam::{IVec3, Vec3};

/// A hash of a lattice point.
#[must_use]
pub fn lattice_hash(x: i32, y: i32, z: i32, seed: u32) -> u32 {
    let h = hash(seed ^ (x as u32).wrapping_mul(0x8da6_b343));
    let h = hash(h ^ (y as u32).wrapping_mul(0xd816_3841));
    hash(h ^ (z as u32).wrapping_mul(0xcb1a_b31f))
}

/// Gradient noise, about −0.7 to 0.7, zero at lattice points.
#[must_use]
pub fn noise(p: Vec3, seed: u32) -> f32 {
    let base = p.floor();
    let f = p - base;
    let cell = base.as_ivec3();
    let fade = f * f * f * (f * (f * 6.0 - 15.0) + 10.0);
    let corner = |dx: i32, dy: i32, dz: i32| {
        let h = lattice_hash(cell.x + dx, cell.y + dy, cell.z + dz, seed);
        let d = f - IVec3::new(dx, dy, dz).as_vec3();
        // A gradient of length near 1 with three independent components out of one hash.
        let g = Vec3::new(
            (h & 0x3ff) as f32,
            (h >> 10 & 0x3ff) as f32,
            (h >> 20 & 0x3ff) as f32,
        ) / 511.5
            - 1.0;
        g.dot(d)
    };
    let mix = |a: f32, b: f32, t: f32| a + t * (b - a);
    let plane = |dz: i32| {
        mix(
            mix(corner(0, 0, dz), corner(1, 0, dz), fade.x),
            mix(corner(0, 1, dz), corner(1, 1, dz), fade.x),
            fade.y,
        )
    };
    mix(plane(0), plane(1), fade.z)
}

/// Octaves of [`noise`], each twice as fine and half as strong.
#[must_use]
pub fn fractal(p: Vec3, octaves: u32, seed: u32) -> f32 {
    let (mut sum, mut amplitude, mut q) = (0.0, 1.0, p);
    for octave in 0..octaves {
        sum += amplitude * noise(q, seed.wrapping_add(octave));
        amplitude *= 0.5;
        q = 2.0 * q + 17.3;
    }
    sum
}

/// Distance to the nearest of the jittered lattice points, and that point's hash.
#[must_use]
pub fn cells(p: Vec3, seed: u32) -> (f32, u32) {
    let ([nearest, _], id) = two_cells(p, seed);
    (nearest, id)
}

/// Distances to the nearest two of the jittered lattice points, and the nearest one's hash.
#[must_use]
pub fn two_cells(p: Vec3, seed: u32) -> ([f32; 2], u32) {
    let cell = p.floor().as_ivec3();
    let (mut best, mut second, mut id) = (f32::INFINITY, f32::INFINITY, 0);
    for dz in -1..=1 {
        for dy in -1..=1 {
            for dx in -1..=1 {
                let c = cell + IVec3::new(dx, dy, dz);
                let h = lattice_hash(c.x, c.y, c.z, seed);
                let jitter = Vec3::new(
                    (h & 0x3ff) as f32,
                    (h >> 10 & 0x3ff) as f32,
                    (h >> 20 & 0x3ff) as f32,
                ) / 1024.0;
                let distance = p.distance_squared(c.as_vec3() + 0.15 + 0.7 * jitter);
                if distance < best {
                    second = best;
                    (best, id) = (distance, hash(h));
                } else {
                    second = second.min(distance);
                }
            }
        }
    }
    ([best.sqrt(), second.sqrt()], id)
}
