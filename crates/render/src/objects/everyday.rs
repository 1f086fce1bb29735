//! Everyday things with print and bold colours: packages, cans, bottles, books, frames, toys.

use super::finish::{bold, material, roughness, surface};
use super::part::{Assembly, Part};
use super::primitives::{
    CREASE, capsule, cone, cuboid, cylinder, lathe, rounded_box, sphere, spline, sweep, torus,
};
use super::print;
use crate::draw::Draw;
use crate::material::{Material, Patterned, Surface};
use crate::scene::mesh::Model;
use crate::texture::PatternKind;
use lumi_core::glam::{Mat3, Vec2, Vec3};
use std::f32::consts::TAU;

/// A printed surface: mostly with a picture, a label or lettering all over.
fn printed(draw: &mut Draw) -> Material {
    match draw.count(0, 3) {
        0 => print::picture(draw, [0.5, 2.0]).unwrap_or_else(|| print::lettering(draw, 1.0)),
        1 => print::lettering(draw, 1.0),
        _ => {
            let colour = bold(draw, 1)[0];
            let below = Material::Plain(Surface::dielectric(colour, roughness(draw)));
            print::labelled(draw, below)
        }
    }
}

/// Boxes, cans, bottles, cards, stacks of books: things with print on them.
pub fn package(draw: &mut Draw) -> Model {
    let mut assembly = Assembly::default();
    match draw.count(0, 4) {
        0 => {
            let m = printed(draw);
            let m = assembly.material(m);
            let half = Vec3::new(
                draw.range(0.3, 0.8),
                draw.range(0.1, 0.6),
                draw.range(0.3, 1.0),
            );
            assembly.add(&rounded_box(half, draw.range(0.0, 0.06)), m);
        }
        1 => {
            // A can.
            let m = printed(draw);
            let m = assembly.material(m);
            let r = draw.range(0.35, 0.7);
            assembly.add(&cylinder(0.03).scaled(Vec3::new(r, r, 0.9)), m);
            let lid = Material::Plain(surface(draw, 0.8));
            let lid = assembly.material(lid);
            for side in [-1.0, 1.0] {
                let rim = torus(0.05).scaled(Vec3::splat(0.96 * r));
                assembly.add(&rim.at(Vec3::new(0.0, 0.0, 0.9 * side)), lid);
                let plate = cylinder(0.0).scaled(Vec3::new(0.95 * r, 0.95 * r, 0.01));
                assembly.add(&plate.at(Vec3::new(0.0, 0.0, 0.905 * side)), lid);
            }
        }
        2 => {
            // A bottle with a cap.
            let m = printed(draw);
            let m = assembly.material(m);
            let (r, neck) = (draw.range(0.3, 0.5), draw.range(0.1, 0.2));
            let shoulder = draw.range(0.2, 0.6);
            let profile = [
                (0.0, -1.0),
                (0.9 * r, -1.0),
                (r, -0.93),
                (r, -0.4),
                (r, shoulder - 0.1),
                (0.85 * r, shoulder),
                (neck, shoulder + 0.25),
                (neck, 1.0),
                (0.0, 1.0),
            ];
            let line: Vec<Vec2> = profile.iter().map(|&(r, z)| Vec2::new(r, z)).collect();
            assembly.add(&lathe(&line, 48, CREASE), m);
            let cap = Material::Plain(Surface::dielectric(bold(draw, 1)[0], 0.4));
            let cap = assembly.material(cap);
            let top = cylinder(0.1).scaled(Vec3::new(1.3 * neck, 1.3 * neck, 0.1));
            assembly.add(&top.at(Vec3::new(0.0, 0.0, 1.0)), cap);
        }
        3 => {
            // Books, lying on each other.
            let mut z = 0.0;
            for _ in 0..draw.count(1, 6) {
                let cover = printed(draw);
                let cover = assembly.material(cover);
                let paper = Surface::dielectric(Vec3::new(0.85, 0.8, 0.7), 0.9);
                let mut pattern = print::flat(PatternKind::Slabs, Vec3::splat(60.0), draw);
                pattern.axis = 1;
                let sheet = Surface::dielectric(0.75 * paper.base, 0.9);
                let pages = assembly.material(Material::Patterned(Patterned {
                    pattern,
                    palette: vec![paper, sheet],
                    smooth: false,
                    bump: None,
                }));
                let half = Vec3::new(
                    draw.range(0.6, 0.9),
                    draw.range(0.4, 0.65),
                    draw.range(0.05, 0.16),
                );
                let turn = Mat3::from_rotation_z(draw.range(-0.3, 0.3));
                let mut put = |part: Part, at: Vec3, m| {
                    assembly.add(&part.at(at + (z + half.z) * Vec3::Z).turned(turn), m);
                };
                put(
                    cuboid(half - Vec3::new(0.03, 0.03, 0.01)),
                    Vec3::ZERO,
                    pages,
                );
                let board = Vec3::new(half.x, half.y, 0.015);
                for side in [-1.0, 1.0] {
                    let at = Vec3::new(0.0, 0.0, side * (half.z - 0.015));
                    put(cuboid(board), at, cover);
                }
                let spine = Vec3::new(half.x, 0.015, half.z);
                put(cuboid(spine), Vec3::new(0.0, -half.y, 0.0), cover);
                z += 2.0 * half.z;
            }
        }
        _ => {
            // A poster, a screen or a card on a stand.
            let m = printed(draw);
            let face = assembly.material(m);
            let m = material(draw);
            let frame = assembly.material(m);
            let half = Vec3::new(draw.range(0.5, 1.0), 0.02, draw.range(0.4, 0.8));
            let tilt = Mat3::from_rotation_x(-draw.range(0.0, 0.4));
            assembly.add(&cuboid(half).turned(tilt), face);
            let rim = draw.range(0.02, 0.08);
            for side in [-1.0, 1.0] {
                let bar = cuboid(Vec3::new(rim, 0.04, half.z + rim));
                let at = Vec3::new(side * half.x, 0.0, 0.0);
                assembly.add(&bar.at(at).turned(tilt), frame);
                let bar = cuboid(Vec3::new(half.x + rim, 0.04, rim));
                let at = Vec3::new(0.0, 0.0, side * half.z);
                assembly.add(&bar.at(at).turned(tilt), frame);
            }
            let foot = rounded_box(Vec3::new(0.4 * half.x, 0.3, 0.03), 0.01);
            assembly.add(&foot.at(Vec3::new(0.0, 0.1, -half.z - rim)), frame);
        }
    }
    assembly.finish()
}

/// The knob of a toy brick.
fn stud() -> Part {
    let line = [(0.075, -0.03), (0.075, 0.03), (0.0, 0.03)];
    lathe(&line.map(|(r, z)| Vec2::new(r, z)), 14, CREASE)
}

/// Toys of bold colours: bricks with studs, stacked rings, blocks, balls, beads on a string.
pub fn toy(draw: &mut Draw) -> Model {
    let mut assembly = Assembly::default();
    let shine = draw.range(0.1, 0.5);
    let materials: Vec<u16> = bold(draw, 5)
        .into_iter()
        .map(|c| {
            let plain = Material::Plain(Surface::dielectric(c, shine));
            let m = if draw.chance(0.3) {
                print::labelled(draw, plain)
            } else {
                plain
            };
            assembly.material(m)
        })
        .collect();
    match draw.count(0, 3) {
        0 => {
            // Bricks with studs in layers.
            for level in 0..draw.count(2, 6) {
                for _ in 0..draw.count(1, 3) {
                    let m = draw.pick(&materials);
                    let (nx, ny) = (draw.count(1, 4), draw.count(1, 3));
                    let corner = Vec3::new(
                        0.25 * draw.count(0, 4) as f32 - 0.5,
                        0.25 * draw.count(0, 4) as f32 - 0.5,
                        0.3 * level as f32,
                    );
                    let half = Vec3::new(0.125 * nx as f32, 0.125 * ny as f32, 0.15);
                    let gap = Vec3::splat(0.004);
                    assembly.add(&cuboid(half - gap).at(corner + half), m);
                    for i in 0..nx {
                        for j in 0..ny {
                            let stud = stud();
                            let at =
                                Vec3::new(0.25 * i as f32 + 0.125, 0.25 * j as f32 + 0.125, 0.33);
                            assembly.add(&stud.at(corner + at), m);
                        }
                    }
                }
            }
        }
        1 => {
            // Rings on a stick.
            let n = draw.count(3, 7);
            let mut z = 0.0;
            for i in 0..n {
                let r = 0.8 - 0.55 * i as f32 / n as f32;
                let tube = draw.range(0.12, 0.2);
                let ring = torus(tube / r).scaled(Vec3::splat(r));
                z += tube;
                assembly.add(&ring.at(Vec3::new(0.0, 0.0, z)), materials[i % 5]);
                z += tube;
            }
            let stick = cylinder(0.2).scaled(Vec3::new(0.12, 0.12, 0.55 * z));
            assembly.add(
                &stick.at(Vec3::new(0.0, 0.0, 0.55 * z)),
                draw.pick(&materials),
            );
            let ball = sphere().scaled(Vec3::splat(0.2));
            assembly.add(
                &ball.at(Vec3::new(0.0, 0.0, 1.15 * z)),
                draw.pick(&materials),
            );
        }
        2 => {
            // Building blocks.
            for level in 0..draw.count(2, 4) {
                for k in 0..draw.count(1, 3) {
                    let m = draw.pick(&materials);
                    let part = match draw.count(0, 3) {
                        0 => cylinder(0.05),
                        1 => cone(1.0, 0.0, 0.0, if draw.chance(0.5) { 4 } else { 40 }),
                        _ => rounded_box(Vec3::ONE, 0.06),
                    };
                    let at = Vec3::new(
                        0.62 * k as f32 - 0.5 + draw.range(-0.05, 0.05),
                        draw.range(-0.3, 0.3),
                        0.56 * level as f32,
                    );
                    let turn = Mat3::from_rotation_z(draw.range(0.0, TAU));
                    assembly.add(&part.scaled(Vec3::splat(0.28)).turned(turn).at(at), m);
                }
            }
        }
        _ => {
            // Beads on a string.
            let knots: Vec<Vec3> = (0..draw.count(3, 6))
                .map(|_| draw.vector(-1.0, 1.0))
                .collect();
            let beads = draw.count(8, 18);
            let path = spline(&knots, beads, true);
            assembly.add(
                &sweep(&spline(&knots, 80, true), |_| 0.02, |_| 1.0, 8, true),
                materials[0],
            );
            let size = draw.range(0.09, 0.16);
            let capsules = draw.chance(0.3);
            for (i, p) in path.iter().enumerate() {
                let part = if capsules {
                    let along = path[(i + 1) % beads] - *p;
                    capsule(0.6, 0.6)
                        .scaled(Vec3::splat(0.7 * size))
                        .aimed(along)
                } else {
                    sphere().scaled(Vec3::splat(size))
                };
                assembly.add(&part.at(*p), materials[i % 5]);
            }
        }
    }
    assembly.finish()
}
