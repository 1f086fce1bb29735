//! Made shapes: extruded outlines, lattices, chains, supershapes, carved solids, machines.

use super::finish::{material, surface};
use super::part::{Assembly, Part};
use super::primitives::{cylinder, lathe, rounded_box, sphere, spline, sweep, torus};
use super::sdf::{Piece, Sculpture, Shape};
use crate::draw::Draw;
use crate::material::Material;
use crate::noise::fractal;
use crate::scene::mesh::Model;
use lumi_core::glam::{Mat3, Vec2, Vec3};
use std::f32::consts::{FRAC_PI_2, PI, TAU};

/// A closed outline of `n` points around the origin, about 1 in radius and seen whole from there.
fn outline(draw: &mut Draw, n: usize) -> Vec<Vec2> {
    let kind = draw.count(0, 4);
    let corners = draw.count(3, 9) as f32;
    let (depth, sharp) = (draw.range(0.1, 0.5), draw.range(0.3, 3.0));
    let seed = draw.bits();
    let frequency = draw.range(0.8, 2.0);
    let radius = |a: f32| match kind {
        // A star or a flower.
        0 => 1.0 - depth * (0.5 + 0.5 * (corners * a).cos()).powf(sharp),
        // A gear: smooth steps.
        1 => 1.0 - 0.35 * depth * (1.0 + (4.0 * (2.0 * corners * a).sin()).clamp(-1.0, 1.0)),
        // A polygon.
        2 => {
            let step = TAU / corners;
            let b = (a.rem_euclid(step)) - 0.5 * step;
            (0.5 * step).cos() / b.cos()
        }
        // A blob.
        3 => 0.8 + depth * fractal(frequency * Vec3::new(a.cos(), a.sin(), 0.0), 2, seed),
        // An ellipse-like squircle.
        _ => {
            let p = 2.0 + 2.0 * sharp;
            let (s, c) = a.sin_cos();
            (c.abs().powf(p) + (s.abs() / (1.0 - depth)).powf(p)).powf(-1.0 / p)
        }
    };
    (0..n)
        .map(|i| {
            let a = TAU * i as f32 / n as f32;
            radius(a).max(0.15) * Vec2::new(a.cos(), a.sin())
        })
        .collect()
}

/// Rings of an outline along z, each scaled, turned and shifted by `place`; caps at both ends.
fn extrude(outline: &[Vec2], rings: usize, place: impl Fn(f32) -> (f32, f32, Vec3)) -> Part {
    let mut positions = Vec::new();
    let mut ring = |t: f32, shrink: f32| {
        let (scale, turn, shift) = place(t);
        let turned = Vec2::from_angle(turn);
        for p in outline {
            let q = turned.rotate(*p) * scale * shrink;
            positions.push(shift + Vec3::new(q.x, q.y, 0.0));
        }
    };
    for shrink in [0.0, 0.5, 0.97] {
        ring(0.0, shrink);
    }
    for i in 0..rings {
        ring(i as f32 / (rings - 1) as f32, 1.0);
    }
    for shrink in [0.97, 0.5, 0.0] {
        ring(1.0, shrink);
    }
    Part::grid(positions, outline.len(), (false, true), 0.7)
}

/// Stars, gears, prisms and vases of any outline, straight, tapered, twisted or bent.
pub fn extruded(draw: &mut Draw) -> Model {
    let mut assembly = Assembly::default();
    for k in 0..draw.count(1, 3) {
        let m = material(draw);
        let m = assembly.material(m);
        let shape = outline(draw, 96);
        let height = if draw.chance(0.4) {
            draw.range(0.1, 0.4)
        } else {
            draw.range(0.6, 2.4)
        };
        let twist = if draw.chance(0.5) {
            draw.range(-2.5, 2.5)
        } else {
            0.0
        };
        let (taper, belly) = (draw.range(-0.6, 0.3), draw.range(-0.3, 0.5));
        let bend = if draw.chance(0.3) {
            draw.range(-0.8, 0.8)
        } else {
            0.0
        };
        let part = extrude(&shape, 36, |t| {
            let scale = 1.0 + taper * t + belly * (PI * t).sin();
            let shift = Vec3::new(bend * t * t * height, 0.0, t * height);
            (scale.max(0.1), twist * t, shift)
        });
        let size = if k == 0 { 1.0 } else { draw.range(0.3, 0.8) };
        let mut part = part.scaled(Vec3::splat(size));
        if k > 0 {
            part = part.at(Vec3::new(0.0, 0.0, draw.range(-0.2, 1.0) * height));
        }
        assembly.add(&part, m);
    }
    assembly.finish()
}

/// A bar with round ends.
fn bar(a: Vec3, b: Vec3, thick: f32) -> Part {
    let path: Vec<Vec3> = (0..4).map(|i| a.lerp(b, i as f32 / 3.0)).collect();
    sweep(&path, |_| thick, |_| 1.0, 10, false)
}

/// Thin structures: cages, grids, domes of bars, nests of wire; often with something inside.
pub fn lattice(draw: &mut Draw) -> Model {
    let mut assembly = Assembly::default();
    let m = if draw.chance(0.5) {
        Material::Plain(surface(draw, 0.6))
    } else {
        material(draw)
    };
    let wire = assembly.material(m);
    let thick = draw.range(0.018, 0.05);
    match draw.count(0, 3) {
        0 => {
            // A box of bars.
            let n = [draw.count(1, 3), draw.count(1, 3), draw.count(1, 4)];
            let half = draw.vector(0.4, 0.9);
            for axis in 0..3 {
                let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
                for i in 0..=n[u] {
                    for j in 0..=n[v] {
                        let mut a = -half;
                        a[u] = half[u] * (2.0 * i as f32 / n[u] as f32 - 1.0);
                        a[v] = half[v] * (2.0 * j as f32 / n[v] as f32 - 1.0);
                        let mut b = a;
                        b[axis] = half[axis];
                        assembly.add(&bar(a, b, thick), wire);
                    }
                }
            }
        }
        1 => {
            // Meridians and parallels of a ball or a barrel.
            let (columns, rows) = (draw.count(5, 12), draw.count(1, 4));
            let tall = draw.range(0.6, 1.3);
            let flat = draw.chance(0.4);
            let profile = |t: f32| {
                let a = PI * (t - 0.5);
                let r = if flat { a.cos().powf(0.3) } else { a.cos() };
                (r.max(0.05), tall * a.sin())
            };
            for k in 0..columns {
                let (s, c) = (TAU * k as f32 / columns as f32).sin_cos();
                let path: Vec<Vec3> = (0..24)
                    .map(|i| {
                        let (r, z) = profile(0.04 + 0.92 * i as f32 / 23.0);
                        Vec3::new(r * c, r * s, z)
                    })
                    .collect();
                assembly.add(&sweep(&path, |_| thick, |_| 1.0, 10, false), wire);
            }
            for i in 1..=rows {
                let (r, z) = profile(i as f32 / (rows + 1) as f32);
                let ring = torus(thick / r).scaled(Vec3::splat(r));
                assembly.add(&ring.at(Vec3::new(0.0, 0.0, z)), wire);
            }
        }
        2 => {
            // A tangle of smooth wires over a ball.
            for _ in 0..draw.count(3, 7) {
                let knots: Vec<Vec3> = (0..draw.count(4, 7))
                    .map(|_| draw.direction() * draw.range(0.7, 1.0))
                    .collect();
                let path = spline(&knots, 90, true);
                assembly.add(&sweep(&path, |_| thick, |_| 1.0, 10, true), wire);
            }
        }
        _ => {
            // Branches that fork.
            let mut open = vec![(Vec3::NEG_Z, Vec3::Z, 0.5_f32, 2.2 * thick)];
            for _ in 0..draw.count(20, 60) {
                let k = draw.count(0, open.len() - 1);
                let (from, along, length, radius) = open[k];
                let to = from + length * along;
                assembly.add(&bar(from, to, radius), wire);
                open.swap_remove(k);
                for _ in 0..2 {
                    let turned = (along + 0.8 * draw.direction()).normalize_or(along);
                    open.push((to, turned, 0.82 * length, 0.8 * radius));
                }
            }
        }
    }
    if draw.chance(0.55) {
        let m = material(draw);
        let m = assembly.material(m);
        let size = draw.range(0.25, 0.55);
        let part = if draw.chance(0.5) {
            sphere().scaled(size * draw.vector(0.6, 1.0))
        } else {
            rounded_box(size * draw.vector(0.5, 1.0), 0.1 * size)
        };
        assembly.add(&part, m);
    }
    assembly.finish()
}

/// Rings that hang in each other, along a curve.
pub fn chain(draw: &mut Draw) -> Model {
    let mut assembly = Assembly::default();
    let mut materials = Vec::new();
    for _ in 0..draw.count(1, 2) {
        let m = material(draw);
        materials.push(assembly.material(m));
    }
    let links = draw.count(3, 9);
    let knots: Vec<Vec3> = (0..4).map(|_| draw.vector(-1.0, 1.0)).collect();
    let path = spline(&knots, links + 1, false);
    let tube = draw.range(0.16, 0.28);
    for i in 0..links {
        let (a, b) = (path[i], path[i + 1]);
        let length = a.distance(b).max(0.1);
        let along = (b - a).normalize_or(Vec3::X);
        let (u, v) = crate::sampling::frame(along);
        let normal = if i % 2 == 0 { u } else { v };
        // An oval that reaches into its neighbours.
        let basis = Mat3::from_cols(along, normal.cross(along), normal);
        let link = torus(tube).scaled(Vec3::new(0.78, 0.5, 0.55) * length);
        let m = materials[i % materials.len()];
        assembly.add(&link.turned(basis).at(0.5 * (a + b)), m);
    }
    assembly.finish()
}

/// Supershapes (Gielis 2003), sometimes displaced: shells, stars, seeds, cushions.
pub fn supershape(draw: &mut Draw) -> Model {
    let mut assembly = Assembly::default();
    let m = material(draw);
    let m = assembly.material(m);
    let formula = |draw: &mut Draw| {
        let m = draw.count(0, 8) as f32;
        let n1 = draw.log_range(0.5, 6.0);
        let (n2, n3) = (draw.log_range(0.7, 5.0), draw.log_range(0.7, 5.0));
        move |a: f32| {
            let b = 0.25 * m * a;
            let sum = b.cos().abs().powf(n2) + b.sin().abs().powf(n3);
            sum.powf(-1.0 / n1).clamp(0.25, 1.6)
        }
    };
    let (around, up) = (formula(draw), formula(draw));
    let (seed, frequency) = (draw.bits(), draw.range(1.5, 6.0));
    let rough = if draw.chance(0.45) {
        draw.range(0.03, 0.2)
    } else {
        0.0
    };
    let (rows, columns) = (72, 112);
    let mut positions = Vec::with_capacity(rows * columns);
    for i in 0..rows {
        let latitude = PI * (i as f32 / (rows - 1) as f32 - 0.5);
        for k in 0..columns {
            let longitude = TAU * k as f32 / columns as f32 - PI;
            let (r, q) = (around(longitude), up(latitude));
            let across = r * q * latitude.cos().max(0.0);
            let p = Vec3::new(
                across * longitude.cos(),
                across * longitude.sin(),
                q * latitude.sin(),
            );
            positions.push(p * (1.0 + rough * fractal(frequency * p, 4, seed)));
        }
    }
    let part = Part::grid(positions, columns, (false, true), 0.8);
    assembly.add(&part.scaled(draw.vector(0.6, 1.0)), m);
    assembly.finish()
}

/// A block, a ball or a drum from which holes, grooves and corners are cut.
pub fn carved(draw: &mut Draw) -> Model {
    let mut assembly = Assembly::default();
    let m = material(draw);
    let body = assembly.material(m);
    let m = material(draw);
    let inside = assembly.material(m);
    let half = draw.vector(0.5, 0.9);
    let first = match draw.count(0, 2) {
        0 => Shape::Block {
            centre: Vec3::ZERO,
            half,
            round: draw.range(0.02, 0.2),
        },
        1 => Shape::Ellipsoid {
            centre: Vec3::ZERO,
            radii: half,
        },
        _ => Shape::Ring {
            centre: Vec3::ZERO,
            axis: draw.direction(),
            radius: 0.75,
            tube: draw.range(0.25, 0.4),
        },
    };
    let piece = |shape, blend, carve, material| Piece {
        shape,
        blend,
        carve,
        material,
    };
    let mut sculpture = Sculpture {
        pieces: vec![piece(first, 0.0, false, body)],
        ..Sculpture::default()
    };
    let blend = if draw.chance(0.5) {
        draw.range(0.02, 0.15)
    } else {
        0.0
    };
    for _ in 0..draw.count(1, 5) {
        let centre = half * draw.vector(-1.0, 1.0);
        let shape = match draw.count(0, 3) {
            0 => {
                // A hole right through.
                let axis = draw.pick(&[Vec3::X, Vec3::Y, Vec3::Z]);
                let r = draw.range(0.12, 0.35);
                Shape::Bone {
                    a: 0.6 * centre - 1.5 * axis,
                    b: 0.6 * centre + 1.5 * axis,
                    ra: r,
                    rb: r,
                }
            }
            1 => Shape::Block {
                centre,
                half: draw.vector(0.1, 0.6),
                round: 0.02,
            },
            2 => Shape::Ellipsoid {
                centre,
                radii: Vec3::splat(draw.range(0.25, 0.55)),
            },
            _ => Shape::Ring {
                centre: Vec3::new(0.0, 0.0, centre.z),
                axis: Vec3::Z,
                radius: draw.range(0.5, 0.9),
                tube: draw.range(0.06, 0.15),
            },
        };
        sculpture.pieces.push(piece(shape, blend, true, inside));
    }
    for _ in 0..draw.count(0, 3) {
        let ball = Shape::Ellipsoid {
            centre: half * draw.vector(-0.9, 0.9),
            radii: draw.vector(0.1, 0.3),
        };
        sculpture.pieces.push(piece(ball, blend, false, inside));
    }
    let mesh = sculpture.mesh(56);
    // What was carved may have swallowed nearly everything.
    if mesh.triangles.len() < 400 {
        return extruded(draw);
    }
    assembly.add_mesh(&mesh);
    assembly.finish()
}

/// Gears on shafts, pipes with flanges, boxes with knobs.
pub fn machine(draw: &mut Draw) -> Model {
    let mut assembly = Assembly::default();
    let mut materials = Vec::new();
    for k in 0..draw.count(2, 4) {
        let m = if k == 0 || draw.chance(0.4) {
            Material::Plain(surface(draw, 0.7))
        } else {
            material(draw)
        };
        materials.push(assembly.material(m));
    }
    let half = draw.vector(0.3, 0.8);
    let body = draw.pick(&materials);
    assembly.add(&rounded_box(half, draw.range(0.01, 0.15)), body);
    for _ in 0..draw.count(2, 6) {
        let m = draw.pick(&materials);
        let axis = draw.count(0, 2);
        let sign = if draw.chance(0.5) { 1.0 } else { -1.0 };
        let mut normal = Vec3::ZERO;
        normal[axis] = sign;
        let mut at = half * draw.vector(-0.6, 0.6);
        at[axis] = sign * half[axis];
        let size = draw.range(0.12, 0.4);
        let part = match draw.count(0, 4) {
            0 => {
                let teeth = draw.count(8, 18) as f32;
                let gear: Vec<Vec2> = (0..192)
                    .map(|i| {
                        let a = TAU * i as f32 / 192.0;
                        let r = 1.0 + 0.1 * (5.0 * (teeth * a).sin()).clamp(-1.0, 1.0);
                        r * Vec2::from_angle(a)
                    })
                    .collect();
                extrude(&gear, 4, |t| (1.0, 0.0, Vec3::new(0.0, 0.0, 0.4 * t)))
            }
            1 => cylinder(0.15).scaled(Vec3::new(0.6, 0.6, draw.range(0.2, 1.0))),
            2 => sphere(),
            3 => {
                // A flange on a pipe.
                let profile = [
                    (0.0, 0.0),
                    (1.0, 0.0),
                    (1.0, 0.15),
                    (0.55, 0.2),
                    (0.5, 1.2),
                    (0.7, 1.25),
                    (0.7, 1.45),
                    (0.4, 1.45),
                    (0.4, 1.0),
                    (0.0, 1.0),
                ];
                let line: Vec<Vec2> = profile.iter().map(|&(r, z)| Vec2::new(r, z)).collect();
                lathe(&line, 40, 0.61)
            }
            _ => torus(0.25),
        };
        assembly.add(&part.scaled(Vec3::splat(size)).aimed(normal).at(at), m);
    }
    if draw.chance(0.5) {
        // Pipes from face to face.
        for _ in 0..draw.count(1, 3) {
            let end = |draw: &mut Draw| {
                let d = draw.direction();
                (half * 1.02 * d / d.abs().max_element(), d)
            };
            let ((a, da), (b, db)) = (end(draw), end(draw));
            let path = spline(&[a, a + 0.4 * da, b + 0.4 * db, b], 40, false);
            let thick = draw.range(0.03, 0.08);
            let m = draw.pick(&materials);
            assembly.add(&sweep(&path, |_| thick, |_| 1.0, 12, false), m);
        }
    }
    if draw.chance(0.3) {
        let m = draw.pick(&materials);
        let wheel = torus(0.12)
            .scaled(Vec3::splat(draw.range(0.3, 0.6)))
            .turned(Mat3::from_rotation_x(FRAC_PI_2));
        assembly.add_pair(&wheel.at(Vec3::new(0.0, half.y + 0.1, 0.0)), m);
    }
    assembly.finish()
}
