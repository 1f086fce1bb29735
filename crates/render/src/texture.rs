//! Solid patterns that vary a material over the surface.

use crate::noise::{cells, fractal};
use lumi_core::glam::{Vec3, Vec3Swizzles};
use std::f32::consts::TAU;

/// A scalar field in [0, 1] over texture space.
#[derive(Clone, Debug)]
pub struct Pattern {
    /// Its form.
    pub kind: PatternKind,
    /// Turns the axes cyclically by this many places, 0 to 2, so that stripes may run any way.
    pub axis: usize,
    /// Texture space is multiplied by this first: how often it repeats per unit.
    pub scale: Vec3,
    /// Then shifted.
    pub offset: Vec3,
    /// Displaces the lookup by noise of this size, in periods, so that lines wobble.
    pub warp: f32,
    /// Chooses the random numbers of noise and cells.
    pub seed: u32,
}

/// The forms of a [`Pattern`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum PatternKind {
    /// Fractal noise with this many octaves, stretched to use the whole range.
    Noise(u32),
    /// Sine bands across x.
    Bands,
    /// A random value for each slab across x.
    Slabs,
    /// 3D checks: 0 or 1.
    Checks,
    /// A random value for each brick of a wall in (x, z), 0 in the joints.
    Bricks,
    /// 1 inside round spots, 0 outside.
    Spots,
    /// A random value for each Voronoi cell.
    Mosaic,
    /// Rings around the z axis, as in wood.
    Rings,
    /// 0 at the bottom to 1 at the top of a period.
    Gradient,
    /// Veins: thin lines where noise crosses zero.
    Veins,
}

impl Pattern {
    /// The field at `coords`.
    #[must_use]
    pub fn value(&self, coords: Vec3) -> f32 {
        let turned = match self.axis {
            1 => coords.yzx(),
            2 => coords.zxy(),
            _ => coords,
        };
        let mut p = turned * self.scale + self.offset;
        if self.warp > 0.0 {
            let at = 0.7 * p;
            p += self.warp
                * Vec3::new(
                    fractal(at, 2, self.seed ^ 0x51),
                    fractal(at, 2, self.seed ^ 0x52),
                    fractal(at, 2, self.seed ^ 0x53),
                );
        }
        match self.kind {
            PatternKind::Noise(octaves) => 0.5 + 0.9 * fractal(p, octaves, self.seed),
            PatternKind::Bands => 0.5 + 0.5 * (TAU * p.x).sin(),
            PatternKind::Slabs => random(p.x.floor() as i32, 0, 0, self.seed),
            PatternKind::Checks => {
                let n = p.floor().as_ivec3();
                ((n.x + n.y + n.z) & 1) as f32
            }
            PatternKind::Bricks => {
                let row = p.z.floor();
                let shift = 0.5 * (row as i32 & 1) as f32;
                // Wrapping x and y together lays the wall around the object.
                let along = p.x + p.y + shift;
                let edge = (along - along.floor()).min(p.z - row);
                if edge < 0.08 {
                    0.0
                } else {
                    0.3 + 0.7 * random(along.floor() as i32, row as i32, 1, self.seed)
                }
            }
            PatternKind::Spots => {
                let (distance, id) = cells(p, self.seed);
                let radius = 0.22 + 0.2 * (id & 0xff) as f32 / 255.0;
                1.0 - smooth_step((distance - radius) / 0.04)
            }
            PatternKind::Mosaic => (cells(p, self.seed).1 & 0xffff) as f32 / 65535.0,
            PatternKind::Rings => {
                let r = p.xy().length() + 0.15 * fractal(0.4 * p, 2, self.seed);
                let f = r - r.floor();
                f * f * (3.0 - 2.0 * f)
            }
            PatternKind::Gradient => p.z,
            PatternKind::Veins => {
                let n = fractal(p, 4, self.seed).abs();
                (1.0 - 4.0 * n).max(0.0)
            }
        }
    }
}

fn smooth_step(t: f32) -> f32 {
    let t = t.clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

fn random(x: i32, y: i32, z: i32, seed: u32) -> f32 {
    (crate::noise::lattice_hash(x, y, z, seed) & 0xffff) as f32 / 65535.0
}
