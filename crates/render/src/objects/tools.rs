//! Things of thin parts and holes: pierced shells, pans, forks, tripods, wheels, baskets.

use super::finish::{material, skin, surface};
use super::part::Assembly;
use super::primitives::{CREASE, cone, cylinder, lathe, rounded_box, sphere, spline, sweep, torus};
use super::sdf::{Piece, Sculpture, Shape};
use crate::draw::Draw;
use crate::material::Material;
use crate::scene::mesh::Model;
use lumi_core::glam::{Mat3, Vec2, Vec3};
use std::f32::consts::{FRAC_PI_2, TAU};

/// Shells with many holes and open cavities: cheese, sponges, colanders, baskets, skulls of a kind.
pub fn pierced(draw: &mut Draw) -> Model {
    let mut assembly = Assembly::default();
    let m = if draw.chance(0.3) {
        skin(draw)
    } else {
        material(draw)
    };
    let body = assembly.material(m);
    let m = material(draw);
    let inner = if draw.chance(0.5) {
        assembly.material(m)
    } else {
        body
    };
    let half = draw.vector(0.55, 0.9);
    let mut sculpture = Sculpture::default();
    let block = draw.chance(0.4);
    let first = if block {
        Shape::Block {
            centre: Vec3::ZERO,
            half,
            round: 0.08,
        }
    } else {
        Shape::Ellipsoid {
            centre: Vec3::ZERO,
            radii: half,
        }
    };
    let mut push = |shape, carve, material| {
        sculpture.pieces.push(Piece {
            shape,
            blend: 0.01,
            carve,
            material,
        });
    };
    push(first, false, body);
    if !block || draw.chance(0.5) {
        // Hollow, mostly open on top.
        let radii = half * draw.range(0.75, 0.86);
        let lift = if draw.chance(0.6) { 0.35 } else { 0.0 };
        push(
            Shape::Ellipsoid {
                centre: Vec3::new(0.0, 0.0, lift),
                radii,
            },
            true,
            inner,
        );
    }
    let holes = draw.count(6, 26);
    let size = draw.range(0.07, 0.2);
    for k in 0..holes {
        // A spiral spreads them evenly; jitter makes cheese.
        let z = 1.0 - (2 * k + 1) as f32 / holes as f32;
        let azimuth = 2.4 * k as f32 + draw.range(-0.2, 0.2);
        let r = (1.0 - z * z).sqrt();
        let direction = Vec3::new(r * azimuth.cos(), r * azimuth.sin(), z);
        let scale = if block {
            half / direction.abs().max_element()
        } else {
            half
        };
        let ra = size * draw.range(0.6, 1.3);
        push(
            Shape::Bone {
                a: 0.6 * scale * direction,
                b: 1.2 * scale * direction,
                ra,
                rb: ra,
            },
            true,
            inner,
        );
    }
    assembly.add_mesh(&sculpture.mesh(60));
    assembly.finish()
}

/// Pans, spoons, brushes, tripods, spectacles, wheels with spokes: long thin parts and a head.
pub fn utensil(draw: &mut Draw) -> Model {
    let mut assembly = Assembly::default();
    let m = Material::Plain(surface(draw, 0.6));
    let metal = assembly.material(m);
    let m = material(draw);
    let grip = assembly.material(m);
    let thick = draw.range(0.015, 0.05);
    let rod = |a: Vec3, b: Vec3, r: f32| sweep(&[a, a.lerp(b, 0.5), b], |_| r, |_| 1.0, 10, false);
    match draw.count(0, 4) {
        0 => {
            // A pan or a spoon.
            let (r, deep) = (draw.range(0.25, 0.7), draw.range(0.06, 0.4));
            let wall = 0.025;
            let profile = [
                (0.0, 0.0),
                (0.8 * r, 0.0),
                (r, deep),
                (r - wall, deep),
                (0.8 * r - wall, wall),
                (0.0, wall),
            ];
            let line: Vec<Vec2> = profile.iter().map(|&(r, z)| Vec2::new(r, z)).collect();
            let oval = Vec3::new(draw.range(1.0, 1.5), 1.0, 1.0);
            assembly.add(&lathe(&line, 48, CREASE).scaled(oval), metal);
            let start = Vec3::new(0.97 * r * oval.x, 0.0, deep - 0.02);
            let end = start + Vec3::new(draw.range(0.7, 1.5), 0.0, draw.range(-0.1, 0.4));
            assembly.add(&rod(start, end, thick), metal);
            assembly.add(&rod(start.lerp(end, 0.5), end, 1.5 * thick), grip);
        }
        1 => {
            // A fork, a rake, a comb or a brush.
            let tines = draw.count(3, 12);
            let width = draw.range(0.2, 0.6);
            let length = draw.range(0.3, 0.8);
            for k in 0..tines {
                let y = width * (2.0 * k as f32 / (tines - 1) as f32 - 1.0);
                let a = Vec3::new(0.0, y, 0.0);
                let path = spline(
                    &[
                        a,
                        a + Vec3::new(0.5 * length, 0.0, -0.05),
                        a + Vec3::new(length, 0.0, 0.06),
                    ],
                    8,
                    false,
                );
                let r = (0.5 * thick).max(0.012);
                assembly.add(
                    &sweep(&path, |t| r * (1.1 - 0.4 * t), |_| 1.0, 8, false),
                    metal,
                );
            }
            assembly.add(&rod(-width * Vec3::Y, width * Vec3::Y, thick), metal);
            assembly.add(
                &rod(Vec3::ZERO, -draw.range(0.8, 1.6) * Vec3::X, thick),
                grip,
            );
        }
        2 => {
            // A tripod or a floor lamp.
            let top = Vec3::new(0.0, 0.0, draw.range(0.8, 1.4));
            let legs = draw.count(3, 5);
            let spread = draw.range(0.3, 0.7);
            let knee = top * draw.range(0.2, 1.0);
            for k in 0..legs {
                let (s, c) = (TAU * k as f32 / legs as f32).sin_cos();
                assembly.add(&rod(knee, spread * Vec3::new(c, s, 0.0), thick), metal);
            }
            assembly.add(&rod(knee, top, thick), metal);
            let r = draw.range(0.2, 0.45);
            let head = match draw.count(0, 2) {
                0 => cone(r, 0.5 * r, 0.0, 40).scaled(Vec3::new(1.0, 1.0, 0.8 * r)),
                1 => rounded_box(r * draw.vector(0.5, 1.0), 0.1 * r),
                _ => sphere().scaled(Vec3::splat(r)),
            };
            assembly.add(&head.at(top), grip);
        }
        3 => {
            // Wheels with spokes on an axle, as of a bicycle.
            let spokes = draw.count(5, 20);
            let r = draw.range(0.5, 0.8);
            let upright = Mat3::from_rotation_x(FRAC_PI_2);
            let apart = if draw.chance(0.5) { 0.35 } else { 0.0 };
            let mut wheel = |at: Vec3| {
                let tyre = torus(draw.range(0.05, 0.1)).scaled(Vec3::splat(r));
                assembly.add(&tyre.turned(upright).at(at), grip);
                for k in 0..spokes {
                    let (s, c) = (TAU * k as f32 / spokes as f32).sin_cos();
                    let to = at + 0.97 * r * Vec3::new(c, 0.0, s);
                    assembly.add(&rod(at, to, 0.6 * thick), metal);
                }
                let hub = cylinder(0.2).scaled(Vec3::new(0.08, 0.08, 0.1));
                assembly.add(&hub.turned(upright).at(at), metal);
            };
            if apart > 0.0 {
                wheel(apart * Vec3::Y);
                wheel(-apart * Vec3::Y);
                assembly.add(&rod(-apart * Vec3::Y, apart * Vec3::Y, thick), metal);
            } else {
                wheel(r * Vec3::X);
                wheel(-1.25 * r * Vec3::X);
                let (a, b) = (r * Vec3::X, -1.25 * r * Vec3::X);
                let seat = Vec3::new(-0.4 * r, 0.0, draw.range(0.6, 1.0));
                let bar = Vec3::new(0.75 * r, 0.0, draw.range(0.6, 1.1));
                let pedal = Vec3::new(-0.2 * r, 0.0, 0.0);
                for (p, q) in [
                    (b, seat),
                    (b, pedal),
                    (pedal, seat),
                    (pedal, bar),
                    (seat, bar),
                    (a, bar),
                ] {
                    assembly.add(&rod(p, q, thick), grip);
                }
                assembly.add(&rod(bar - 0.3 * Vec3::Y, bar + 0.3 * Vec3::Y, thick), metal);
                let saddle = sphere().scaled(Vec3::new(0.18, 0.09, 0.05));
                assembly.add(&saddle.at(seat + 0.05 * Vec3::Z), grip);
            }
        }
        _ => {
            // A wire basket or a rack with something in it.
            let (bottom, top) = (draw.range(0.4, 0.7), draw.range(0.6, 0.9));
            let (wires, rings) = (draw.count(10, 28), draw.count(2, 5));
            let height = draw.range(0.3, 0.9);
            for k in 0..wires {
                let (s, c) = (TAU * k as f32 / wires as f32).sin_cos();
                let out = Vec3::new(c, s, 0.0);
                let wire = rod(bottom * out, top * out + height * Vec3::Z, 0.5 * thick);
                assembly.add(&wire, metal);
            }
            for i in 0..=rings {
                let t = i as f32 / rings as f32;
                let r = bottom + t * (top - bottom);
                let ring = torus(0.7 * thick / r).scaled(Vec3::splat(r));
                assembly.add(&ring.at(Vec3::new(0.0, 0.0, t * height)), metal);
            }
            for _ in 0..draw.count(2, 8) {
                let size = draw.range(0.12, 0.28);
                let m = if draw.chance(0.5) {
                    skin(draw)
                } else {
                    material(draw)
                };
                let m = assembly.material(m);
                let azimuth = draw.range(0.0, TAU);
                let out = 0.6 * bottom * draw.unit();
                let at = Vec3::new(
                    out * azimuth.cos(),
                    out * azimuth.sin(),
                    size + 0.5 * height * draw.unit(),
                );
                assembly.add(&sphere().scaled(size * draw.vector(0.8, 1.1)).at(at), m);
            }
        }
    }
    assembly.finish()
}
