//! Living silhouettes: animals, figures and busts, plants.

use super::finish::{color, material};
use super::part::Assembly;
use super::primitives::{cone, cylinder, rounded_box, sphere, spline, sweep, torus};
use super::sdf::{Piece, Sculpture, Shape};
use crate::draw::Draw;
use crate::material::{Material, Surface};
use crate::scene::mesh::Model;
use lumi_core::glam::{Mat3, Vec3};
use std::f32::consts::{FRAC_PI_2, PI, TAU};

/// Collects pieces of a body, with mirrored limbs.
struct Body {
    sculpture: Sculpture,
    blend: f32,
}

impl Body {
    fn new(draw: &mut Draw) -> Self {
        let furry = draw.chance(0.25);
        Self {
            sculpture: Sculpture {
                bumps: if furry { draw.range(0.01, 0.03) } else { 0.0 },
                frequency: draw.range(8.0, 14.0),
                seed: draw.bits(),
                ..Sculpture::default()
            },
            blend: draw.range(0.05, 0.25),
        }
    }

    fn add(&mut self, shape: Shape, material: u16) {
        self.sculpture.pieces.push(Piece {
            shape,
            blend: self.blend,
            carve: false,
            material,
        });
    }

    fn ball(&mut self, centre: Vec3, radii: Vec3, material: u16) {
        self.add(Shape::Ellipsoid { centre, radii }, material);
    }

    fn bone(&mut self, a: Vec3, b: Vec3, ra: f32, rb: f32, material: u16) {
        self.add(Shape::Bone { a, b, ra, rb }, material);
    }

    fn limb(&mut self, a: Vec3, b: Vec3, ra: f32, rb: f32, material: u16) {
        let flip = |v: Vec3| Vec3::new(v.x, -v.y, v.z);
        self.bone(a, b, ra, rb, material);
        self.bone(flip(a), flip(b), ra, rb, material);
    }
}

/// Eyes that look along +x at both sides of a head.
fn eyes(assembly: &mut Assembly, draw: &mut Draw, head: Vec3, radii: Vec3) {
    let white = assembly.material(Material::Plain(Surface::dielectric(Vec3::splat(0.8), 0.2)));
    let tint = color(draw) * 0.3;
    let iris = assembly.material(Material::Plain(Surface::dielectric(tint, 0.15)));
    let size = radii.min_element() * draw.range(0.18, 0.3);
    let out = Vec3::new(0.75, draw.range(0.35, 0.6), draw.range(0.15, 0.45)).normalize();
    let at = head + out * radii * 0.95;
    assembly.add_pair(&sphere().scaled(Vec3::splat(size)).at(at), white);
    let ahead = (out + Vec3::X).normalize();
    assembly.add_pair(
        &sphere()
            .scaled(Vec3::splat(0.6 * size))
            .at(at + 0.55 * size * ahead),
        iris,
    );
}

/// Four-legged animals, birds and fish-like bodies; x is forward.
pub fn animal(draw: &mut Draw) -> Model {
    let mut assembly = Assembly::default();
    let m = material(draw);
    let coat = assembly.material(m);
    let m = if draw.chance(0.5) {
        material(draw)
    } else {
        Material::Plain(Surface::dielectric(color(draw), 0.6))
    };
    let mark = assembly.material(m);
    let mut body = Body::new(draw);
    let long = draw.range(0.45, 0.9);
    let girth = draw.range(0.25, 0.45);
    body.ball(
        Vec3::ZERO,
        Vec3::new(long, girth, girth * draw.range(0.8, 1.2)),
        coat,
    );
    // Neck and head.
    let neck = Vec3::new(draw.range(0.15, 0.5), 0.0, draw.range(0.1, 0.7));
    let shoulder = Vec3::new(0.75 * long, 0.0, 0.2 * girth);
    let head = shoulder + neck;
    let thick = girth * draw.range(0.35, 0.6);
    body.bone(shoulder, head, 1.2 * thick, thick, coat);
    let size = draw.range(0.2, 0.36);
    let radii = size
        * Vec3::new(
            draw.range(0.9, 1.3),
            draw.range(0.75, 1.0),
            draw.range(0.75, 1.1),
        );
    body.ball(head, radii, coat);
    let snout = head + Vec3::new(radii.x + draw.range(0.0, 0.25), 0.0, -0.25 * radii.z);
    body.bone(
        head,
        snout,
        0.55 * size,
        size * draw.range(0.2, 0.45),
        draw.pick(&[coat, mark]),
    );
    // Ears or horns.
    let ear = head + Vec3::new(-0.1 * size, 0.5 * radii.y, 0.8 * radii.z);
    let tip = ear
        + Vec3::new(
            draw.range(-0.2, 0.1),
            draw.range(0.0, 0.25),
            draw.range(0.0, 0.4),
        );
    body.limb(ear, tip, 0.3 * size, 0.12 * size, mark);
    // Legs.
    let legs = draw.count(0, 3);
    let length = draw.range(0.25, 0.8);
    let foot = draw.range(0.06, 0.13);
    for i in 0..legs.min(2) + usize::from(legs == 3) {
        let x = long * [0.6, -0.6, 0.0][i];
        let hip = Vec3::new(x, 0.65 * girth, -0.3 * girth);
        let knee = hip + Vec3::new(draw.range(-0.1, 0.1), 0.05, -0.5 * length);
        let sole = knee + Vec3::new(draw.range(-0.1, 0.1), 0.0, -0.5 * length);
        body.limb(hip, knee, 1.5 * foot, foot, coat);
        body.limb(knee, sole, foot, foot, draw.pick(&[coat, mark]));
        body.limb(
            sole,
            sole + Vec3::new(1.2 * foot, 0.0, 0.0),
            foot,
            0.8 * foot,
            mark,
        );
    }
    // Tail.
    let root = Vec3::new(-0.9 * long, 0.0, 0.1 * girth);
    let middle = root + Vec3::new(-draw.range(0.1, 0.4), 0.0, draw.range(-0.3, 0.4));
    let end = middle
        + Vec3::new(
            -draw.range(0.0, 0.3),
            draw.range(-0.2, 0.2),
            draw.range(-0.3, 0.5),
        );
    body.bone(root, middle, 0.12, 0.08, coat);
    body.bone(middle, end, 0.08, draw.range(0.03, 0.12), mark);
    assembly.add_mesh(&body.sculpture.mesh(52));
    eyes(&mut assembly, draw, head, radii);
    if draw.chance(0.25) {
        // Wings or fins.
        let half = Vec3::new(draw.range(0.15, 0.4), draw.range(0.3, 0.6), 0.03);
        let wing = rounded_box(half, 0.03).turned(Mat3::from_rotation_x(draw.range(-0.2, 0.7)));
        assembly.add_pair(
            &wing.at(Vec3::new(0.0, girth + 0.7 * half.y, 0.4 * girth)),
            mark,
        );
    }
    assembly.finish()
}

/// Standing figures, busts and helmets; x is forward.
pub fn figure(draw: &mut Draw) -> Model {
    let mut assembly = Assembly::default();
    let skin = Material::Plain(Surface::dielectric(color(draw), draw.range(0.35, 0.8)));
    let skin = assembly.material(skin);
    let m = material(draw);
    let cloth = assembly.material(m);
    let m = material(draw);
    let extra = assembly.material(m);
    let mut body = Body::new(draw);
    let bust = draw.chance(0.4);
    let size = if bust {
        draw.range(0.4, 0.6)
    } else {
        draw.range(0.18, 0.34)
    };
    let radii = size
        * Vec3::new(
            draw.range(0.85, 1.1),
            draw.range(0.75, 1.0),
            draw.range(0.95, 1.3),
        );
    let head = Vec3::new(0.0, 0.0, 1.0);
    let chest = head - Vec3::new(0.0, 0.0, radii.z + draw.range(0.3, 0.5));
    body.ball(head, radii, skin);
    body.ball(
        head + Vec3::new(radii.x, 0.0, -0.1 * radii.z),
        size * Vec3::new(0.22, 0.14, 0.22),
        skin,
    );
    body.bone(head, chest, 0.45 * size, 0.5 * size, skin);
    let wide = if bust {
        draw.range(0.4, 0.7)
    } else {
        draw.range(0.25, 0.45)
    };
    body.ball(
        chest,
        Vec3::new(0.6 * wide, wide, draw.range(0.25, 0.45)),
        cloth,
    );
    if !bust {
        let hips = chest - Vec3::new(0.0, 0.0, draw.range(0.3, 0.5));
        body.bone(chest, hips, 0.6 * wide, 0.55 * wide, cloth);
        let thick = draw.range(0.08, 0.16);
        let stride = draw.range(0.0, 0.35);
        for side in [-1.0, 1.0] {
            let hip = hips + Vec3::new(0.0, side * 0.45 * wide, -0.1);
            let foot = hip
                + Vec3::new(
                    side * stride,
                    side * draw.range(0.0, 0.15),
                    -draw.range(0.5, 0.8),
                );
            body.bone(hip, foot, 1.2 * thick, thick, extra);
            body.bone(
                foot,
                foot + Vec3::new(1.6 * thick, 0.0, 0.0),
                thick,
                0.8 * thick,
                extra,
            );
            let shoulder = chest + Vec3::new(0.0, side * 0.95 * wide, 0.15);
            let elbow = shoulder
                + 0.38
                    * Vec3::new(
                        draw.range(-0.6, 0.8),
                        side * draw.range(0.2, 1.0),
                        draw.range(-1.0, 0.6),
                    )
                    .normalize();
            let hand = elbow
                + 0.34
                    * Vec3::new(
                        draw.range(-0.2, 1.0),
                        side * draw.range(-0.3, 0.8),
                        draw.range(-1.0, 0.8),
                    )
                    .normalize();
            body.bone(shoulder, elbow, thick, 0.8 * thick, cloth);
            body.bone(elbow, hand, 0.8 * thick, 0.7 * thick, skin);
        }
    }
    assembly.add_mesh(&body.sculpture.mesh(52));
    if draw.chance(0.85) {
        eyes(&mut assembly, draw, head, radii);
    }
    // Hat, hair or helmet.
    let top = head + Vec3::new(0.0, 0.0, 0.35 * radii.z);
    match draw.count(0, 4) {
        0 => {
            let r = 1.12 * radii.x.max(radii.y);
            let brim = cylinder(0.3)
                .scaled(Vec3::new(1.6 * r, 1.6 * r, 0.05))
                .at(top);
            assembly.add(&brim, extra);
            let crown = cone(1.0, draw.range(0.1, 1.0), 0.1, 40).scaled(Vec3::new(
                r,
                r,
                draw.range(0.2, 0.5),
            ));
            assembly.add(&crown.at(top + Vec3::new(0.0, 0.0, 0.3)), extra);
        }
        1 | 2 => {
            // A cap or helmet that leaves the face free.
            let shell = sphere().scaled(radii * draw.range(1.1, 1.25));
            assembly.add(
                &shell.at(head + Vec3::new(-0.25 * radii.x, 0.0, 0.22 * radii.z)),
                extra,
            );
            if draw.chance(0.5) {
                let ring = torus(0.1)
                    .scaled(radii * 1.15)
                    .turned(Mat3::from_rotation_y(draw.range(-0.4, 0.4)));
                assembly.add(&ring.at(head + Vec3::new(0.0, 0.0, 0.25 * radii.z)), cloth);
            }
            if draw.chance(0.4) {
                let cup = cylinder(0.3).scaled(size * Vec3::new(0.35, 0.35, 0.15));
                let cup = cup.turned(Mat3::from_rotation_x(FRAC_PI_2));
                assembly.add_pair(&cup.at(head + Vec3::new(0.0, 1.1 * radii.y, 0.0)), cloth);
            }
        }
        _ => {}
    }
    if bust && draw.chance(0.6) {
        let base = cylinder(0.1).scaled(Vec3::new(0.4, 0.4, 0.15));
        assembly.add(&base.at(chest - Vec3::new(0.0, 0.0, 0.4)), extra);
    }
    assembly.finish()
}

/// Trees, bushes, mushrooms, flowers in pots.
pub fn plant(draw: &mut Draw) -> Model {
    let mut assembly = Assembly::default();
    let m = material(draw);
    let stem_material = assembly.material(m);
    let m = material(draw);
    let crown_material = assembly.material(m);
    let height = draw.range(0.8, 1.8);
    let bend = draw.vector(-0.2, 0.2);
    let knots = [
        Vec3::ZERO,
        Vec3::new(bend.x, bend.y, 0.5 * height),
        Vec3::new(0.0, bend.z, height),
    ];
    let thick = draw.range(0.05, 0.18);
    let stem = sweep(
        &spline(&knots, 24, false),
        |t| thick * (1.3 - 0.6 * t),
        |_| 1.0,
        18,
        false,
    );
    assembly.add(&stem, stem_material);
    let top = knots[2];
    if draw.chance(0.3) {
        // A mushroom or an umbrella.
        let r = draw.range(0.4, 0.9);
        let cap = sphere().scaled(Vec3::new(r, r, r * draw.range(0.4, 0.8)));
        assembly.add(&cap.at(top), crown_material);
    } else {
        let mut crown = Sculpture {
            bumps: draw.range(0.03, 0.15),
            frequency: draw.range(3.0, 7.0),
            seed: draw.bits(),
            ..Sculpture::default()
        };
        for i in 0..draw.count(1, 6) {
            let spread = if i == 0 { 0.0 } else { 0.5 };
            let centre = top + spread * draw.vector(-1.0, 1.0);
            let radii = draw.vector(0.3, 0.6);
            crown.pieces.push(Piece {
                shape: Shape::Ellipsoid { centre, radii },
                blend: 0.1,
                carve: false,
                material: crown_material,
            });
        }
        assembly.add_mesh(&crown.mesh(44));
    }
    let petals = draw.count(0, 9);
    if petals >= 4 {
        let m = Material::Plain(Surface::dielectric(color(draw), 0.6));
        let m = assembly.material(m);
        let at = Vec3::new(0.0, 0.0, draw.range(0.3, 0.6) * height);
        for k in 0..petals {
            let angle = TAU * k as f32 / petals as f32;
            let leaf = sphere()
                .scaled(Vec3::new(0.35, 0.12, 0.04))
                .at(Vec3::new(0.4, 0.0, 0.0))
                .turned(Mat3::from_rotation_z(angle) * Mat3::from_rotation_y(-0.15 * PI));
            assembly.add(&leaf.at(at), m);
        }
    }
    if draw.chance(0.5) {
        let m = material(draw);
        let m = assembly.material(m);
        let r = draw.range(0.25, 0.5);
        let pot = cone(0.7, 1.0, 0.05, 40).scaled(Vec3::new(r, r, draw.range(0.15, 0.35)));
        assembly.add(&pot, m);
    }
    assembly.finish()
}
