//! Man-made things: vessels, vehicles, furniture, towers.

use super::finish::{material, surface};
use super::part::Assembly;
use super::primitives::{
    CREASE, capsule, cone, cylinder, lathe, rounded_box, sphere, spline, sweep, torus,
};
use crate::draw::Draw;
use crate::material::Material;
use crate::scene::mesh::Model;
use lumi_core::glam::{Mat3, Vec2, Vec3};
use std::f32::consts::{FRAC_PI_2, TAU};

/// Smooth curve through (radius, z) points.
fn profile(points: &[Vec2], n: usize) -> Vec<Vec2> {
    let knots: Vec<Vec3> = points.iter().map(|p| Vec3::new(p.x, p.y, 0.0)).collect();
    spline(&knots, n, false)
        .into_iter()
        .map(|p| Vec2::new(p.x.max(0.02), p.y))
        .collect()
}

/// Vases, bottles, cups, bowls, goblets and chess pieces: a random profile on a lathe, with handles, lid and bands.
pub fn vessel(draw: &mut Draw) -> Model {
    let mut assembly = Assembly::default();
    let m = material(draw);
    let body = assembly.material(m);
    let m = material(draw);
    let trim = assembly.material(m);
    let height = draw.range(0.5, 1.5);
    let steps = draw.count(3, 7);
    let mut outer = vec![];
    for i in 0..=steps {
        let t = i as f32 / steps as f32;
        outer.push(Vec2::new(draw.range(0.2, 0.8), height * (2.0 * t - 1.0)));
    }
    let curve = if draw.chance(0.8) {
        profile(&outer, 48)
    } else {
        outer
    };
    let open = draw.chance(0.55);
    let mut line = vec![Vec2::new(0.0, curve[0].y)];
    line.extend(&curve);
    let rim = curve[curve.len() - 1];
    if open {
        // Back down inside, with a wall.
        let wall = 0.06;
        line.push(Vec2::new(
            (rim.x - 0.5 * wall).max(0.01),
            rim.y + 0.3 * wall,
        ));
        for p in curve.iter().rev() {
            line.push(Vec2::new(
                (p.x - wall).max(0.012),
                p.y.max(curve[0].y + wall),
            ));
        }
        line.push(Vec2::new(0.0, curve[0].y + wall));
    } else {
        line.push(Vec2::new(0.0, rim.y));
    }
    let around = if draw.chance(0.15) {
        draw.count(4, 9)
    } else {
        56
    };
    assembly.add(&lathe(&line, around, CREASE), body);
    if !open && draw.chance(0.6) {
        // A stopper or lid.
        let r = rim.x * draw.range(0.6, 1.1);
        let lid = if draw.chance(0.5) {
            sphere().scaled(Vec3::new(r, r, r * draw.range(0.5, 1.2)))
        } else {
            cylinder(0.1).scaled(Vec3::new(r, r, draw.range(0.05, 0.25)))
        };
        assembly.add(&lid.at(Vec3::new(0.0, 0.0, rim.y)), trim);
    }
    for _ in 0..draw.count(0, 2) {
        let p = curve[draw.count(0, curve.len() - 1)];
        let band = torus(draw.range(0.04, 0.1)).scaled(Vec3::new(p.x, p.x, p.x));
        assembly.add(&band.at(Vec3::new(0.0, 0.0, p.y)), trim);
    }
    if draw.chance(0.45) {
        let (low, high) = (draw.range(0.15, 0.4), draw.range(0.6, 0.9));
        let at = |t: f32| curve[((t * curve.len() as f32) as usize).min(curve.len() - 1)];
        let (a, b) = (at(low), at(high));
        let reach = a.x.max(b.x) + draw.range(0.2, 0.5);
        let point = |r: f32, z: f32| Vec3::new(0.0, r, z);
        let knots = [
            point(a.x - 0.05, a.y),
            point(reach, a.y + 0.2 * (b.y - a.y)),
            point(reach, b.y - 0.1 * (b.y - a.y)),
            point(b.x - 0.05, b.y),
        ];
        let thick = draw.range(0.05, 0.1);
        let handle = sweep(&spline(&knots, 32, false), |_| thick, |_| 1.0, 16, false);
        let m = draw.pick(&[body, trim]);
        if draw.chance(0.35) {
            assembly.add_pair(&handle, m);
        } else {
            assembly.add(&handle, m);
        }
    }
    assembly.finish()
}

/// Cars, trucks, carts and planes of boxes and wheels; x is forward.
pub fn vehicle(draw: &mut Draw) -> Model {
    let mut assembly = Assembly::default();
    let m = material(draw);
    let paint = assembly.material(m);
    let m = material(draw);
    let second = assembly.material(m);
    let dark = Vec3::splat(draw.range(0.01, 0.06));
    let tyre = assembly.material(Material::Plain(crate::material::Surface::dielectric(
        dark, 0.8,
    )));
    let m = Material::Plain(surface(draw, 0.7));
    let hub = assembly.material(m);
    let half = Vec3::new(
        draw.range(0.8, 1.4),
        draw.range(0.35, 0.6),
        draw.range(0.15, 0.35),
    );
    let bevel = draw.range(0.03, 0.2);
    assembly.add(&rounded_box(half, bevel), paint);
    // Cabin, hood, load.
    let cabin = Vec3::new(
        draw.range(0.25, 0.6) * half.x,
        draw.range(0.7, 0.98) * half.y,
        draw.range(0.15, 0.4),
    );
    let x = draw.range(-0.4, 0.5) * half.x;
    let cabin_part = rounded_box(cabin, draw.range(0.03, 0.2));
    assembly.add(
        &cabin_part.at(Vec3::new(x, 0.0, half.z + 0.8 * cabin.z)),
        second,
    );
    if draw.chance(0.5) {
        let load = Vec3::new(0.4 * half.x, 0.9 * half.y, draw.range(0.1, 0.5));
        let part = rounded_box(load, draw.range(0.0, 0.1));
        assembly.add(
            &part.at(Vec3::new(-0.5 * half.x, 0.0, half.z + load.z)),
            paint,
        );
    }
    let wheel = draw.range(0.2, 0.38);
    let width = draw.range(0.06, 0.16);
    for i in 0..draw.count(2, 4) {
        let x = half.x * [0.65, -0.65, -0.2, 0.2][i];
        let upright = Mat3::from_rotation_x(FRAC_PI_2);
        let at = Vec3::new(x, half.y + 0.3 * width, -half.z);
        let round = cylinder(0.25).scaled(Vec3::new(wheel, wheel, width));
        assembly.add_pair(&round.turned(upright).at(at), tyre);
        let cap = cylinder(0.2).scaled(Vec3::new(0.55 * wheel, 0.55 * wheel, 1.08 * width));
        assembly.add_pair(&cap.turned(upright).at(at), hub);
    }
    for _ in 0..draw.count(0, 2) {
        // Lamps, pipes, bumpers.
        let lamp = sphere().scaled(Vec3::splat(draw.range(0.05, 0.12)));
        let at = Vec3::new(
            half.x,
            draw.range(0.3, 0.8) * half.y,
            draw.range(-0.3, 0.7) * half.z,
        );
        assembly.add_pair(&lamp.at(at), hub);
    }
    if draw.chance(0.2) {
        let wing = rounded_box(Vec3::new(0.3 * half.x, draw.range(0.8, 1.5), 0.04), 0.04);
        assembly.add(&wing.at(Vec3::new(0.0, 0.0, 0.5 * half.z)), second);
    }
    assembly.finish()
}

/// Tables, chairs, stools, shelves, lamps.
pub fn furniture(draw: &mut Draw) -> Model {
    let mut assembly = Assembly::default();
    let m = material(draw);
    let frame = assembly.material(m);
    let m = material(draw);
    let cover = assembly.material(m);
    let half = Vec3::new(
        draw.range(0.4, 1.0),
        draw.range(0.4, 0.8),
        draw.range(0.03, 0.15),
    );
    let tall = draw.range(0.4, 1.0);
    let round = draw.chance(0.3);
    let seat = if round {
        cylinder(0.2).scaled(half)
    } else {
        rounded_box(half, draw.range(0.01, 0.1))
    };
    assembly.add(&seat, cover);
    if draw.chance(0.25) {
        // One column on a foot.
        let r = draw.range(0.05, 0.15);
        let column = cylinder(0.0).scaled(Vec3::new(r, r, 0.5 * tall));
        assembly.add(&column.at(Vec3::new(0.0, 0.0, -0.5 * tall)), frame);
        let foot = 0.6 * half.x;
        let plate = cylinder(0.3).scaled(Vec3::new(foot, foot, 0.05));
        assembly.add(&plate.at(Vec3::new(0.0, 0.0, -tall)), frame);
    } else {
        let (thick, splay) = (draw.range(0.03, 0.1), draw.range(0.0, 0.3));
        let inset = if round { 0.62 } else { 0.88 };
        for sx in [-1.0, 1.0] {
            let top = Vec3::new(sx * inset * half.x, inset * half.y, 0.0);
            let foot = top + Vec3::new(sx * splay, splay, -tall);
            let leg = sweep(
                &[top, 0.5 * (top + foot), foot],
                |t| thick * (1.0 - 0.4 * t),
                |_| 1.0,
                12,
                false,
            );
            assembly.add_pair(&leg, frame);
        }
    }
    if draw.chance(0.5) {
        let back = Vec3::new(0.06, half.y * 0.95, draw.range(0.3, 0.7));
        let part = rounded_box(back, 0.05).turned(Mat3::from_rotation_y(-draw.range(0.0, 0.25)));
        assembly.add(
            &part.at(Vec3::new(-half.x + 0.05, 0.0, back.z)),
            draw.pick(&[frame, cover]),
        );
        if draw.chance(0.5) {
            let arm = rounded_box(Vec3::new(0.9 * half.x, 0.06, 0.05), 0.04);
            assembly.add_pair(&arm.at(Vec3::new(0.0, half.y, 0.35)), frame);
        }
    } else {
        // Something stands on it.
        for _ in 0..draw.count(0, 3) {
            let size = draw.range(0.12, 0.3);
            let m = material(draw);
            let m = assembly.material(m);
            let at = Vec3::new(
                draw.range(-0.6, 0.6) * half.x,
                draw.range(-0.6, 0.6) * half.y,
                half.z + 0.9 * size,
            );
            let part = match draw.count(0, 3) {
                0 => sphere().scaled(Vec3::splat(size)),
                1 => rounded_box(Vec3::splat(0.9 * size), 0.1 * size),
                2 => cone(0.7, 0.3, 0.05, 32).scaled(Vec3::splat(size)),
                _ => cylinder(0.1).scaled(Vec3::new(0.6 * size, 0.6 * size, size)),
            };
            assembly.add(&part.at(at), m);
        }
    }
    assembly.finish()
}

/// Stacks that narrow upward: buildings, lighthouses, cakes, rockets.
pub fn tower(draw: &mut Draw) -> Model {
    let mut assembly = Assembly::default();
    let square = draw.chance(0.4);
    let (mut z, mut r) = (0.0, draw.range(0.5, 0.9));
    let levels = draw.count(2, 6);
    let mut materials = Vec::new();
    for _ in 0..draw.count(1, 3) {
        let m = material(draw);
        materials.push(assembly.material(m));
    }
    for level in 0..levels {
        let h = draw.range(0.1, 0.5);
        let next = r * draw.range(0.65, 1.05);
        let m = materials[level % materials.len()];
        let part = if square {
            rounded_box(
                Vec3::new(r, r * draw.range(0.7, 1.0), h),
                draw.range(0.0, 0.08),
            )
        } else {
            cone(r, next, draw.range(0.0, 0.06), 44).scaled(Vec3::new(1.0, 1.0, h))
        };
        assembly.add(&part.at(Vec3::new(0.0, 0.0, z + h)), m);
        if draw.chance(0.4) {
            // Columns or fins around this level.
            let n = draw.count(3, 8);
            let size = draw.range(0.04, 0.1);
            let pillar = capsule(1.0, 1.0).scaled(Vec3::new(size, size, 0.45 * h));
            let m = draw.pick(&materials);
            for k in 0..n {
                let (s, c) = (TAU * k as f32 / n as f32).sin_cos();
                assembly.add(&pillar.clone().at(Vec3::new(r * c, r * s, z + h)), m);
            }
        }
        z += 2.0 * h;
        r = next;
    }
    let m = draw.pick(&materials);
    let top = match draw.count(0, 2) {
        0 => cone(r, 0.0, 0.0, if square { 4 } else { 44 }).scaled(Vec3::new(
            1.1,
            1.1,
            draw.range(0.15, 0.5),
        )),
        1 => sphere().scaled(Vec3::new(r, r, r * draw.range(0.6, 1.3))),
        _ => torus(0.3).scaled(Vec3::splat(0.8 * r)),
    };
    assembly.add(&top.at(Vec3::new(0.0, 0.0, z)), m);
    assembly.finish()
}
