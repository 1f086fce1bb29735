//! Solid patterns that vary a material over the surface.

use crate::noise::{cells, fractal, two_cells};
use lumi_core::glam::{Vec2, Vec3, Vec3Swizzles};
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
    /// Staggered boards along x, each with its own shade and grain, 0 in the gaps.
    Planks,
    /// A random value for each square of a wall in (x, z), 0 in the joints.
    Tiles,
    /// Crossing stripes of uneven widths, as a tartan's.
    Plaid,
    /// A random value for each zigzag band.
    Zigzag,
    /// Threads over and under each other: one direction takes 0 to ½, the other ½ to 1.
    Weave,
    /// A random value for each pebble, 0 between them.
    Pebbles,
    /// 1 inside discs on a square grid, 0 outside.
    Dots,
    /// 1 on the strokes of lines of letter-like marks, 0 on the paper.
    Print,
    /// 1 in the unit square of (x, z) around the origin where y is positive, 0 elsewhere: a label on one side.
    Patch,
    /// 1 inside a flower or star of this many points in (x, z) where y is positive (0 points: a disc), 0 elsewhere.
    Emblem(u32),
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
            PatternKind::Planks => planks(on_wall(p), self.seed),
            PatternKind::Tiles => {
                let q = on_wall(p);
                let (cell, f) = (q.floor(), q - q.floor());
                if f.min_element() < 0.06 {
                    0.0
                } else {
                    0.3 + 0.7 * random(cell.x as i32, cell.y as i32, 2, self.seed)
                }
            }
            PatternKind::Plaid => {
                // Seven stripes of uneven width that repeat, the same in both directions.
                let stripe = |t: f32| {
                    let f = t - t.floor();
                    random((7.0 * f * (1.6 - 0.6 * f)) as i32, 0, 3, self.seed)
                };
                let q = on_wall(p);
                0.5 * (stripe(q.x) + stripe(q.y))
            }
            PatternKind::Zigzag => {
                let q = on_wall(p);
                let f = (q.x - q.x.floor() - 0.5).abs();
                random((q.y + 0.8 * f).floor() as i32, 0, 4, self.seed)
            }
            PatternKind::Weave => {
                let q = on_wall(p);
                let (cell, f) = (q.floor(), q - q.floor());
                let over = (cell.x as i32 + cell.y as i32) & 1 == 0;
                let across = if over { f.x } else { f.y };
                0.5 * (0.5 * TAU * across).sin() + if over { 0.0 } else { 0.5 }
            }
            PatternKind::Pebbles => {
                let ([near, next], id) = two_cells(p, self.seed);
                if next - near < 0.09 {
                    0.0
                } else {
                    0.25 + 0.75 * (id & 0xffff) as f32 / 65535.0
                }
            }
            PatternKind::Dots => {
                let q = on_wall(p);
                f32::from(u8::from((q - q.floor() - 0.5).length() < 0.31))
            }
            PatternKind::Print => print(on_wall(p), self.seed),
            PatternKind::Patch => {
                f32::from(u8::from(p.y > 0.0 && p.xz().abs().max_element() < 0.5))
            }
            PatternKind::Emblem(points) => {
                let q = p.xz();
                let wave = (points as f32 * q.y.atan2(q.x)).cos();
                let radius = if points == 0 { 0.5 } else { 0.36 + 0.14 * wave };
                f32::from(u8::from(p.y > 0.0 && q.length() < radius))
            }
        }
    }
}

/// The plane in which walls are laid: adding y to x wraps it around the object.
fn on_wall(p: Vec3) -> Vec2 {
    Vec2::new(p.x + p.y, p.z)
}

fn planks(q: Vec2, seed: u32) -> f32 {
    let row = q.y.floor();
    let along = 0.25 * q.x + random(row as i32, 0, 5, seed);
    let (board, f) = (along.floor(), along - along.floor());
    if q.y - row < 0.05 || f < 0.012 {
        return 0.0;
    }
    let shade = random(row as i32, board as i32, 6, seed);
    let grain = Vec3::new(0.5 * q.x + 9.0 * board, 6.0 * q.y, shade);
    (0.15 + 0.55 * shade + 0.3 * (0.5 + fractal(grain, 3, seed))).clamp(0.0, 1.0)
}

/// Strokes of which letter-like marks are made, in the unit square.
const STROKES: [[Vec2; 2]; 9] = [
    [Vec2::new(0.15, 0.0), Vec2::new(0.15, 1.0)],
    [Vec2::new(0.85, 0.0), Vec2::new(0.85, 1.0)],
    [Vec2::new(0.15, 1.0), Vec2::new(0.85, 1.0)],
    [Vec2::new(0.15, 0.5), Vec2::new(0.85, 0.5)],
    [Vec2::new(0.15, 0.0), Vec2::new(0.85, 0.0)],
    [Vec2::new(0.15, 0.0), Vec2::new(0.85, 1.0)],
    [Vec2::new(0.15, 1.0), Vec2::new(0.85, 0.0)],
    [Vec2::new(0.5, 0.0), Vec2::new(0.5, 1.0)],
    [Vec2::new(0.85, 0.0), Vec2::new(0.85, 0.5)],
];

/// A page in lines of height 1: words of marks of two to four strokes each.
fn print(q: Vec2, seed: u32) -> f32 {
    let row = q.y.floor();
    let column = q.x / 0.6;
    let mark = column.floor();
    let id = crate::noise::lattice_hash(mark as i32, row as i32, 7, seed);
    // Gaps between words, and between paragraphs.
    let of_row = crate::noise::lattice_hash(0, row as i32, 8, seed);
    if id.is_multiple_of(6) || of_row.is_multiple_of(7) {
        return 0.0;
    }
    let at = Vec2::new((column - mark) * 1.35 - 0.1, (q.y - row) * 1.5 - 0.2);
    let inked = (0..4).any(|k| {
        let [a, b] = STROKES[(id >> (6 + 5 * k)) as usize % STROKES.len()];
        let t = ((at - a).dot(b - a) / (b - a).length_squared()).clamp(0.0, 1.0);
        at.distance(a.lerp(b, t)) < 0.12
    });
    f32::from(u8::from(inked))
}

fn smooth_step(t: f32) -> f32 {
    let t = t.clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

fn random(x: i32, y: i32, z: i32, seed: u32) -> f32 {
    (crate::noise::lattice_hash(x, y, z, seed) & 0xffff) as f32 / 65535.0
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::draw::Draw;
    use lumi_core::Seed;

    #[test]
    fn values_use_the_range_and_stay_in_it() {
        let kinds = [
            PatternKind::Planks,
            PatternKind::Tiles,
            PatternKind::Plaid,
            PatternKind::Zigzag,
            PatternKind::Weave,
            PatternKind::Pebbles,
            PatternKind::Dots,
            PatternKind::Print,
            PatternKind::Patch,
            PatternKind::Emblem(5),
        ];
        for kind in kinds {
            let pattern = Pattern {
                kind,
                axis: 0,
                scale: Vec3::ONE,
                offset: Vec3::ZERO,
                warp: 0.0,
                seed: 3,
            };
            let mut draw = Draw::new(Seed(4), "points");
            let values: Vec<f32> = (0..4000)
                .map(|_| {
                    let p = draw.vector(-4.0, 4.0);
                    // Figures stand around the origin, everything else everywhere.
                    pattern.value(match kind {
                        PatternKind::Patch | PatternKind::Emblem(_) => 0.25 * p,
                        _ => p,
                    })
                })
                .collect();
            assert!(values.iter().all(|v| (0.0..=1.0).contains(v)), "{kind:?}");
            let high = values.iter().filter(|v| **v > 0.6).count();
            let low = values.iter().filter(|v| **v < 0.4).count();
            assert!(high > 200 && low > 200, "{kind:?}: {low} low, {high} high");
        }
    }

    #[test]
    fn labels_are_on_one_side() {
        for kind in [PatternKind::Patch, PatternKind::Emblem(0)] {
            let label = Pattern {
                kind,
                axis: 0,
                scale: Vec3::splat(2.0),
                offset: Vec3::ZERO,
                warp: 0.0,
                seed: 0,
            };
            let at = |x: f32, y: f32| label.value(Vec3::new(x, y, 0.1));
            assert_eq!([at(0.0, 1.0), at(0.0, -1.0)], [1.0, 0.0]);
            assert_eq!([at(0.2, 1.0), at(0.3, 1.0)], [1.0, 0.0]);
        }
    }
}
