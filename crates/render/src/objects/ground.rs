//! What arrangements stand on: a disc, or ground and walls that fill the picture of every camera.

use super::finish;
use super::part::{Assembly, Part};
use super::print::{self, flat};
use crate::draw::Draw;
use crate::material::{Bump, Material, Patterned, Surface};
use crate::scene::mesh::Model;
use crate::texture::PatternKind;
use lumi_core::glam::{Vec2, Vec3};
use std::f32::consts::TAU;

/// How much ground there is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ground {
    /// A disc just large enough for its objects, in the unit ball with them.
    Disc,
    /// As far as cameras see, with none to two walls that meet at a right angle behind the objects, which alone fill
    /// the unit ball.
    Filling {
        /// Number of walls.
        walls: usize,
    },
}

/// The side of a plane where cameras and lights may be: `normal · p ≥ offset`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Plane {
    /// Unit normal toward the open side.
    pub normal: Vec3,
    /// Distance from the origin, mostly negative.
    pub offset: f32,
}

/// Where cameras and lights may be; everywhere by default.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Stage {
    /// Ground and walls.
    pub planes: Vec<Plane>,
    /// Start and width of the azimuths in front of the walls, in radians; none is all around.
    pub azimuths: Option<[f32; 2]>,
}

/// Least angle in radians from the horizon down to what cameras see of a ground without walls: it ends within
/// [`REACH`] for cameras up to 6 away.
const HORIZON: f32 = 0.07;
/// Radius of the ground, and half width and height of walls.
const REACH: f32 = 60.0;

impl Stage {
    /// An azimuth that cameras may have: folded into the open ones, so that arcs stay arcs.
    #[must_use]
    pub fn azimuth(&self, any: f32) -> f32 {
        match self.azimuths {
            None => any,
            Some([start, width]) => {
                let turns = (any / TAU).rem_euclid(2.0);
                start + width * if turns > 1.0 { 2.0 - turns } else { turns }
            }
        }
    }

    /// Elevations that cameras with a field of view of `fov` radians may have, of those from `low` to `high`: without
    /// a wall, the upper edge of the picture must be below the horizon.
    #[must_use]
    pub fn elevations(&self, [low, high]: [f32; 2], fov: f32) -> [f32; 2] {
        if self.planes.is_empty() {
            return [low, high];
        }
        let least = if self.azimuths.is_some() {
            HORIZON
        } else {
            0.5 * fov + HORIZON
        };
        [low.max(least), high.max(least)]
    }

    /// Whether light from far away along `direction` can reach the stage.
    #[must_use]
    pub fn open_toward(&self, direction: Vec3) -> bool {
        self.planes.iter().all(|p| p.normal.dot(direction) > 0.0)
    }

    /// Whether a ball is on the open side of all planes.
    #[must_use]
    pub fn admits(&self, centre: Vec3, radius: f32) -> bool {
        let open = |p: &Plane| p.normal.dot(centre) - p.offset >= radius;
        self.planes.iter().all(open)
    }
}

/// Ground under the lowest point of `scene`, which fills the unit ball, and walls behind it; says where that leaves
/// cameras and lights.
pub fn fill(draw: &mut Draw, scene: &mut Model, walls: usize) -> Stage {
    let level = scene.mesh.bounds().0.z;
    let mut assembly = Assembly::default();
    let m = material(draw);
    let m = assembly.material(m);
    let turn = draw.range(0.0, TAU);
    let floor = disc(REACH).at(Vec3::new(0.0, 0.0, level));
    assembly.add(&laid(floor, turn), m);
    let mut stage = Stage {
        planes: vec![Plane {
            normal: Vec3::Z,
            offset: level,
        }],
        azimuths: None,
    };
    let facing = draw.range(0.0, TAU);
    for k in 0..walls {
        let m = material(draw);
        let m = assembly.material(m);
        let azimuth = facing + 0.25 * TAU * k as f32;
        let normal = Vec3::new(azimuth.cos(), azimuth.sin(), 0.0);
        let offset = -draw.range(1.02, 1.7);
        let along = Vec3::Z.cross(normal);
        let origin = offset * normal + level * Vec3::Z;
        let (columns, rows) = (24, 12);
        let mut part = Part::grid(
            (0..=rows)
                .flat_map(|j| (0..=columns).map(move |i| (i, j)))
                .map(|(i, j)| {
                    let u = spread(2.0 * i as f32 / columns as f32 - 1.0);
                    let v = spread(j as f32 / rows as f32);
                    origin + u * along + v * Vec3::Z
                })
                .collect(),
            columns + 1,
            (false, false),
            0.5,
        );
        for (c, p) in part.coords.iter_mut().zip(&part.positions) {
            *c = Vec3::new(p.dot(along), 0.5, p.z - level);
        }
        assembly.add(&part, m);
        stage.planes.push(Plane { normal, offset });
    }
    if walls > 0 {
        // 45° to either side of one wall's normal; between two walls 10° clear of each.
        stage.azimuths = Some(if walls == 1 {
            [facing - 0.125 * TAU, 0.25 * TAU]
        } else {
            [facing + TAU / 36.0, 0.25 * TAU - TAU / 18.0]
        });
    }
    let mut ground = assembly.finish();
    print::unfold(&mut ground);
    let offset = scene.materials.len() as u16;
    scene.mesh.append(&ground.mesh, offset);
    scene.materials.extend(ground.materials);
    stage
}

/// From −1 to 1 to −[`REACH`] to [`REACH`], dense around 0.
fn spread(t: f32) -> f32 {
    REACH * t * t.abs() * t.abs().sqrt()
}

/// A horizontal part with its texture in the plane that [`PatternKind`]s have walls in, turned.
fn laid(mut part: Part, turn: f32) -> Part {
    let turn = Vec2::from_angle(turn);
    for (c, p) in part.coords.iter_mut().zip(&part.positions) {
        let q = turn.rotate(p.truncate());
        *c = Vec3::new(q.x, 0.5, q.y);
    }
    part
}

/// A flat disc in rings, denser inside, so that its triangles are not needles.
pub fn disc(radius: f32) -> Part {
    let profile: Vec<Vec2> = (0..=12)
        .map(|i| {
            let t = 1.0 - i as f32 / 12.0;
            Vec2::new(radius * t * t.sqrt(), 0.0)
        })
        .collect();
    super::primitives::lathe(&profile, 64, 0.5)
}

/// Of floors, tables and walls: pictures, boards, tiles, cloth, gravel and bold patterns, plain at times, some
/// polished. Lengths are those of the unit ball.
pub fn material(draw: &mut Draw) -> Material {
    let mut material = match draw.unit() {
        k if k < 0.36 => print::picture(draw, [0.7, 4.0]).unwrap_or_else(|| covering(draw)),
        k if k < 0.39 => print::lettering(draw, 1.5),
        k if k < 0.52 => Material::Plain(Surface::dielectric(
            finish::color(draw),
            finish::roughness(draw),
        )),
        _ => covering(draw),
    };
    let polished = draw.chance(0.3);
    finish::at_least(&mut material, if polished { 0.1 } else { 0.35 });
    if polished {
        // Sharper coats would show a sun as single bright pixels.
        finish::lacquer(&mut material, draw.range(0.06, 0.25));
    }
    material
}

/// A pattern as floors have them.
fn covering(draw: &mut Draw) -> Material {
    let kinds = [
        PatternKind::Planks,
        PatternKind::Planks,
        PatternKind::Tiles,
        PatternKind::Checks,
        PatternKind::Noise(5),
        PatternKind::Slabs,
        PatternKind::Pebbles,
        PatternKind::Weave,
        PatternKind::Plaid,
        PatternKind::Zigzag,
        PatternKind::Bricks,
        PatternKind::Veins,
        PatternKind::Dots,
        PatternKind::Mosaic,
    ];
    let kind = draw.pick(&kinds);
    let per_unit = match kind {
        PatternKind::Noise(_) | PatternKind::Veins => draw.log_range(0.8, 6.0),
        PatternKind::Plaid => draw.log_range(0.6, 2.5),
        PatternKind::Weave | PatternKind::Pebbles => draw.log_range(3.0, 14.0),
        _ => draw.log_range(1.2, 8.0),
    };
    let mut pattern = flat(kind, Vec3::splat(per_unit), draw);
    pattern.offset = draw.vector(-5.0, 5.0);
    if draw.chance(0.2) {
        pattern.warp = draw.range(0.03, 0.3);
    }
    let rough = finish::roughness(draw);
    let count = draw.count(2, 4);
    let mut colors = if draw.chance(0.45) {
        finish::bold(draw, count)
    } else {
        let base = finish::color(draw);
        let shades = (0..count).map(|_| {
            if draw.chance(0.5) {
                base * draw.range(0.25, 1.0)
            } else {
                base.lerp(Vec3::ONE, draw.range(0.1, 0.6))
            }
        });
        shades.collect()
    };
    let jointed = matches!(
        kind,
        PatternKind::Planks | PatternKind::Tiles | PatternKind::Bricks | PatternKind::Pebbles
    );
    if jointed && draw.chance(0.7) {
        // Joints are the lowest values.
        let joint = if draw.chance(0.6) { 0.1 } else { 0.7 };
        colors[0] = colors[0] * 0.2 + 0.8 * Vec3::splat(joint);
    }
    let smooth = match kind {
        PatternKind::Noise(_) | PatternKind::Planks | PatternKind::Plaid => draw.chance(0.8),
        PatternKind::Weave | PatternKind::Veins => draw.chance(0.6),
        _ => false,
    };
    let raised = jointed || kind == PatternKind::Weave;
    let bump = (raised && draw.chance(0.5)).then(|| Bump {
        height: draw.range(0.03, 0.2) / per_unit,
        pattern: pattern.clone(),
    });
    Material::Patterned(Patterned {
        pattern,
        palette: colors
            .into_iter()
            .map(|c| Surface::dielectric(c.min(Vec3::splat(0.95)), rough))
            .collect(),
        smooth,
        bump,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn azimuths_fold_into_the_open_ones_and_edges_stay_below_the_horizon() {
        let open = Stage::default();
        assert_eq!(open.azimuth(5.0), 5.0);
        assert_eq!(open.elevations([0.1, 1.0], 0.9), [0.1, 1.0]);
        assert!(open.admits(Vec3::splat(-9.0), 1.0));
        let ground = Plane {
            normal: Vec3::Z,
            offset: -0.5,
        };
        let flat = Stage {
            planes: vec![ground],
            azimuths: None,
        };
        assert_eq!(flat.elevations([0.1, 1.0], 0.8), [0.4 + HORIZON, 1.0]);
        assert!(flat.admits(Vec3::ZERO, 0.5) && !flat.admits(Vec3::ZERO, 0.6));
        assert!(flat.open_toward(Vec3::Z) && !flat.open_toward(Vec3::NEG_Z));
        let walled = Stage {
            azimuths: Some([1.0, 0.5]),
            ..flat
        };
        assert_eq!(walled.elevations([0.1, 1.0], 0.8), [0.1, 1.0]);
        for (any, folded) in [
            (0.0, 1.0),
            (0.5, 1.25),
            (1.0, 1.5),
            (1.25, 1.375),
            (-0.5, 1.25),
        ] {
            let found = walled.azimuth(any * TAU);
            assert!((found - folded).abs() < 1e-5, "{any}: {found}");
        }
    }
}
