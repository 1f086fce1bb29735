//! Abstract compositions: clusters of primitives, melted blobs, rocks, knots.

use super::finish::material;
use super::part::{Assembly, Part};
use super::primitives::{
    capsule, cone, cylinder, rounded_box, sphere, spline, superellipsoid, sweep, torus,
};
use super::sdf::{Piece, Sculpture, Shape};
use crate::draw::Draw;
use crate::noise::fractal;
use crate::scene::mesh::Model;
use lumi_core::glam::Vec3;
use std::f32::consts::TAU;

/// A random primitive of about unit size, upright.
fn primitive(draw: &mut Draw) -> Part {
    match draw.count(0, 9) {
        0 => sphere().scaled(draw.vector(0.5, 1.0)),
        1 | 2 => {
            let bevel = if draw.chance(0.3) {
                0.0
            } else {
                draw.range(0.02, 0.3)
            };
            rounded_box(draw.vector(0.25, 0.9), bevel)
        }
        3 => {
            let (r, h) = (draw.range(0.25, 0.8), draw.range(0.15, 1.0));
            cylinder(draw.range(0.0, 0.25)).scaled(Vec3::new(r, r, h))
        }
        4 => cone(
            draw.range(0.4, 0.9),
            draw.range(0.0, 0.5),
            draw.range(0.0, 0.1),
            40,
        ),
        5 => torus(draw.range(0.15, 0.45)).scaled(Vec3::splat(0.7)),
        6 => capsule(draw.range(0.15, 0.5), draw.range(0.15, 0.5)).scaled(Vec3::splat(0.7)),
        7 => superellipsoid(draw.range(0.25, 2.2), draw.range(0.25, 2.2))
            .scaled(draw.vector(0.5, 1.0)),
        8 => {
            // A prism or a pyramid.
            let sides = draw.count(3, 8);
            let top = if draw.chance(0.4) {
                0.0
            } else {
                draw.range(0.3, 0.8)
            };
            cone(draw.range(0.4, 0.8), top, 0.0, sides).scaled(Vec3::new(
                1.0,
                1.0,
                draw.range(0.3, 1.0),
            ))
        }
        _ => {
            let knots: Vec<Vec3> = (0..draw.count(3, 5))
                .map(|_| 0.9 * draw.vector(-1.0, 1.0))
                .collect();
            let (a, b) = (draw.range(0.06, 0.3), draw.range(0.06, 0.3));
            let flat = draw.range(0.3, 1.0);
            sweep(
                &spline(&knots, 40, false),
                |t| a + t * (b - a),
                |_| flat,
                20,
                false,
            )
        }
    }
}

/// One to eight primitives, each grown from the surface of an earlier one; sometimes mirrored.
pub fn cluster(draw: &mut Draw) -> Model {
    let mut assembly = Assembly::default();
    let materials: Vec<u16> = (0..draw.count(1, 4))
        .map(|_| {
            let m = material(draw);
            assembly.material(m)
        })
        .collect();
    let symmetric = draw.chance(0.4);
    let mut placed: Vec<Vec3> = Vec::new();
    for i in 0..draw.count(1, 8) {
        let size = if i == 0 {
            1.0
        } else {
            draw.log_range(0.25, 0.9)
        };
        let mut part = primitive(draw).scaled(Vec3::splat(size));
        let upright = draw.chance(0.5);
        if !upright {
            part = part.turned(draw.rotation());
        }
        if !placed.is_empty() {
            let anchor = placed[draw.count(0, placed.len() - 1)];
            let outward = anchor.normalize_or(Vec3::Z);
            let shift = anchor + 0.4 * size * outward;
            part = part.at(shift);
        }
        for _ in 0..12 {
            placed.push(part.positions[draw.count(0, part.positions.len() - 1)]);
        }
        let m = draw.pick(&materials);
        if symmetric && i > 0 {
            assembly.add_pair(&part, m);
        } else {
            assembly.add(&part, m);
        }
    }
    assembly.finish()
}

fn shape(draw: &mut Draw, centre: Vec3, size: f32) -> Shape {
    match draw.count(0, 3) {
        0 => Shape::Ellipsoid {
            centre,
            radii: size * draw.vector(0.5, 1.0),
        },
        1 => Shape::Bone {
            a: centre,
            b: centre + 1.4 * size * draw.direction(),
            ra: size * draw.range(0.3, 0.7),
            rb: size * draw.range(0.2, 0.6),
        },
        2 => Shape::Block {
            centre,
            half: size * draw.vector(0.4, 0.9),
            round: 0.3 * size * draw.range(0.2, 1.0),
        },
        _ => Shape::Ring {
            centre,
            axis: draw.direction(),
            radius: 0.8 * size,
            tube: size * draw.range(0.2, 0.35),
        },
    }
}

/// Blobs that melt into each other, some carved away.
pub fn melted(draw: &mut Draw) -> Model {
    let mut assembly = Assembly::default();
    let materials: Vec<u16> = (0..draw.count(1, 3))
        .map(|_| {
            let m = material(draw);
            assembly.material(m)
        })
        .collect();
    let mut sculpture = Sculpture {
        bumps: if draw.chance(0.3) {
            draw.range(0.02, 0.12)
        } else {
            0.0
        },
        frequency: draw.range(2.0, 7.0),
        seed: draw.bits(),
        ..Sculpture::default()
    };
    let blend = draw.range(0.0, 0.5);
    for i in 0..draw.count(2, 7) {
        let centre = if i == 0 {
            Vec3::ZERO
        } else {
            0.8 * draw.vector(-1.0, 1.0)
        };
        let size = draw.range(0.35, 0.8);
        sculpture.pieces.push(Piece {
            shape: shape(draw, centre, size),
            blend,
            carve: false,
            material: draw.pick(&materials),
        });
    }
    for _ in 0..draw.count(0, 3) {
        let centre = 0.9 * draw.direction();
        let size = draw.range(0.25, 0.5);
        sculpture.pieces.push(Piece {
            shape: shape(draw, centre, size),
            blend: 0.3 * blend,
            carve: true,
            material: draw.pick(&materials),
        });
    }
    let mesh = sculpture.mesh(44);
    // What was carved may have swallowed everything.
    if mesh.triangles.len() < 100 {
        return cluster(draw);
    }
    assembly.add_mesh(&mesh);
    assembly.finish()
}

/// A ball displaced by noise: stones, fruit, asteroids.
pub fn rock(draw: &mut Draw) -> Model {
    let mut assembly = Assembly::default();
    let m = material(draw);
    let m = assembly.material(m);
    let mut part = sphere_grid();
    let (seed, frequency, size) = (draw.bits(), draw.range(0.8, 3.0), draw.range(0.08, 0.6));
    let ridged = draw.chance(0.35);
    let facets = draw.chance(0.25);
    let lobes = if draw.chance(0.25) {
        draw.count(3, 9) as f32
    } else {
        0.0
    };
    let stretch = draw.vector(0.55, 1.0);
    for p in &mut part.positions {
        let n = fractal(frequency * *p, 4, seed);
        let relief = if ridged { 0.4 - n.abs() * 1.6 } else { n };
        let lobe = 0.12 * (lobes * p.y.atan2(p.x)).cos() * (1.0 - p.z * p.z);
        *p *= stretch * (1.0 + size * relief + lobe).max(0.2);
    }
    part.coords.clone_from(&part.positions);
    part.crease = if facets { 0.15 } else { 1.2 };
    assembly.add(&part, m);
    assembly.finish()
}

/// A finer sphere than the primitive.
fn sphere_grid() -> Part {
    let mut part = superellipsoid_fine();
    part.crease = 1.2;
    part
}

fn superellipsoid_fine() -> Part {
    let (rows, columns) = (64, 96);
    let mut positions = Vec::with_capacity(rows * columns);
    for r in 0..rows {
        let (s, c) = (std::f32::consts::PI * (r as f32 / (rows - 1) as f32 - 0.5)).sin_cos();
        for k in 0..columns {
            let (sa, ca) = (TAU * k as f32 / columns as f32).sin_cos();
            positions.push(Vec3::new(c.max(0.0) * ca, c.max(0.0) * sa, s));
        }
    }
    Part::grid(positions, columns, (false, true), 1.2)
}

/// Tubes that wind: torus knots, coils and closed random curves.
pub fn knot(draw: &mut Draw) -> Model {
    let mut assembly = Assembly::default();
    for _ in 0..draw.count(1, 2) {
        let m = material(draw);
        let m = assembly.material(m);
        let n = 220;
        let tube = draw.range(0.09, 0.28);
        let closed;
        let path: Vec<Vec3> = match draw.count(0, 2) {
            0 => {
                closed = true;
                let (p, q) =
                    draw.pick(&[(2.0, 3.0), (3.0, 2.0), (2.0, 5.0), (1.0, 3.0), (3.0, 4.0)]);
                (0..n)
                    .map(|i| {
                        let t = TAU * i as f32 / n as f32;
                        let r = 0.75 + 0.3 * (q * t).cos();
                        Vec3::new(r * (p * t).cos(), r * (p * t).sin(), 0.35 * (q * t).sin())
                    })
                    .collect()
            }
            1 => {
                closed = false;
                let (turns, shrink) = (draw.range(1.5, 5.0), draw.range(-0.5, 0.5));
                let height = draw.range(0.5, 1.2);
                (0..n)
                    .map(|i| {
                        let t = i as f32 / n as f32;
                        let (s, c) = (TAU * turns * t).sin_cos();
                        let r = 0.7 * (1.0 + shrink * (2.0 * t - 1.0));
                        Vec3::new(r * c, r * s, height * (2.0 * t - 1.0))
                    })
                    .collect()
            }
            _ => {
                closed = true;
                let knots: Vec<Vec3> = (0..draw.count(4, 8))
                    .map(|_| draw.vector(-1.0, 1.0))
                    .collect();
                spline(&knots, n, true)
            }
        };
        let (beads, depth) = (draw.count(0, 14) as f32, draw.range(0.0, 0.5));
        let flat = draw.range(0.4, 1.0);
        let part = sweep(
            &path,
            |t| tube * (1.0 + depth * (TAU * beads * t).sin()),
            |_| flat,
            20,
            closed,
        );
        assembly.add(&part, m);
    }
    assembly.finish()
}
