//! Plants of many small leaves.

use super::finish::{bold, color, material};
use super::part::{Assembly, Part};
use super::primitives::{cone, spline, sweep};
use super::print;
use crate::draw::Draw;
use crate::material::{Material, Patterned, Surface};
use crate::scene::mesh::Model;
use crate::texture::PatternKind;
use lumi_core::glam::{Mat3, Vec3};
use std::f32::consts::{PI, TAU};

/// A leaf along x from the origin, 1 long and `wide` wide, bent down by `droop`; two-sided.
fn leaf(wide: f32, droop: f32) -> Part {
    let rows = 6;
    let mut positions = Vec::new();
    for i in 0..=rows {
        let t = i as f32 / rows as f32;
        let half = 0.5 * wide * (PI * t.powf(0.8)).sin().max(0.01);
        let z = -droop * t * t;
        // Folded along the middle.
        for (y, fold) in [(-half, 0.25), (0.0, 0.0), (half, 0.25)] {
            positions.push(Vec3::new(t, y, z + fold * half));
        }
    }
    Part::grid(positions, 3, (false, false), 1.0)
}

/// Twigs with many small leaves, of a bush, a fern, a palm or a houseplant.
pub fn foliage(draw: &mut Draw) -> Model {
    let mut assembly = Assembly::default();
    let bark = assembly.material(Material::Plain(Surface::dielectric(color(draw), 0.8)));
    let green = |draw: &mut Draw| {
        let base = Vec3::new(
            draw.range(0.02, 0.25),
            draw.range(0.08, 0.35),
            draw.range(0.01, 0.08),
        );
        Surface::dielectric(base, draw.range(0.25, 0.7))
    };
    let mut leaves = Vec::new();
    let autumn = draw.chance(0.25);
    for _ in 0..draw.count(1, 3) {
        let m = match draw.count(0, 2) {
            _ if autumn => Material::Plain(Surface::dielectric(bold(draw, 1)[0], 0.5)),
            0 => {
                // Variegated.
                let pattern = print::flat(PatternKind::Bands, Vec3::splat(6.0), draw);
                Material::Patterned(Patterned {
                    pattern,
                    palette: vec![green(draw), green(draw)],
                    smooth: true,
                    bump: None,
                })
            }
            _ => Material::Plain(green(draw)),
        };
        leaves.push(assembly.material(m));
    }
    let wide = draw.range(0.12, 0.6);
    let blade = leaf(wide, draw.range(0.0, 0.5));
    let size = draw.log_range(0.1, 0.45);
    let stems = draw.count(3, 16);
    let per_stem = draw.count(8, 30).min(360 / stems);
    let upright = draw.range(0.3, 1.2);
    for k in 0..stems {
        let azimuth = TAU * (k as f32 + draw.unit()) / stems as f32;
        let out = Vec3::new(azimuth.cos(), azimuth.sin(), 0.0);
        let length = draw.range(0.7, 1.3);
        let lean = draw.range(0.1, 1.0) / upright;
        let knots = [
            0.05 * out,
            0.4 * length * (Vec3::Z + 0.5 * lean * out),
            length * (draw.range(0.2, 1.0) * Vec3::Z + lean * out),
        ];
        let path = spline(&knots, 12, false);
        let thick = draw.range(0.008, 0.025);
        assembly.add(
            &sweep(&path, |t| thick * (1.2 - t), |_| 1.0, 6, false),
            bark,
        );
        let m = draw.pick(&leaves);
        for i in 0..per_stem {
            let t = 0.15 + 0.85 * i as f32 / per_stem as f32;
            let at = path[((t * 11.0) as usize).min(11)]
                .lerp(path[((t * 11.0) as usize + 1).min(11)], (t * 11.0).fract());
            let turn = Mat3::from_rotation_z(azimuth + 2.4 * i as f32 + draw.range(-0.4, 0.4))
                * Mat3::from_rotation_y(-draw.range(-0.2, 0.9));
            let one = size * draw.range(0.6, 1.2);
            let part = blade.clone().scaled(Vec3::splat(one)).turned(turn).at(at);
            assembly.add(&part, m);
        }
    }
    if draw.chance(0.5) {
        let m = material(draw);
        let m = assembly.material(m);
        let r = draw.range(0.2, 0.4);
        let pot = cone(0.7, 1.0, 0.05, 40).scaled(Vec3::new(r, r, r));
        assembly.add(&pot.at(Vec3::new(0.0, 0.0, -0.9 * r)), m);
    }
    assembly.finish()
}
