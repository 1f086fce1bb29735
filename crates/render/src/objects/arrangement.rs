//! Scenes: several objects on a textured ground.
//!
//! After the paper's supplement: 1 to 8 objects within ±3 of the centre and denser there, scales from 0.5 to 1.5,
//! any rotation, no collisions, on a textured ground. Whatever is rendered lies in the unit ball, as a single object
//! does, so the ground is a disc just large enough for its objects, and the whole is scaled into the ball. The
//! conventions of the store (world space is model space; lights stand outside the ball) then hold unchanged.

use super::finish;
use super::part::{Assembly, Part};
use crate::draw::Draw;
use crate::material::Material;
use crate::scene::mesh::Model;
use lumi_core::glam::{Affine3A, Mat3, Vec2, Vec3};
use std::f32::consts::TAU;

/// Objects stand within this distance of the centre along x and y, by their own centres.
const EXTENT: f32 = 3.0;
/// Least and greatest radius of an object's ball.
const SCALES: [f32; 2] = [0.5, 1.5];
/// Places that are tried per object before it is left out.
const TRIES: usize = 100;

/// Where an object stands: the centre of a disc on the ground that no other object's disc meets.
struct Footprint {
    centre: Vec2,
    radius: f32,
}

/// Up to `count` objects of `next`, which makes them inside the unit ball, on a ground.
pub fn arrangement(draw: &mut Draw, count: usize, mut next: impl FnMut(usize) -> Model) -> Model {
    let mut scene = Model::default();
    let mut placed: Vec<Footprint> = Vec::new();
    for k in 0..count.max(1) {
        let mut object = next(k);
        let turn = if draw.chance(0.5) {
            draw.rotation()
        } else {
            Mat3::from_rotation_z(draw.range(0.0, TAU))
        };
        let scale = draw.range(SCALES[0], SCALES[1]);
        let mesh = &mut object.mesh;
        mesh.transform(&Affine3A::from_mat3(scale * turn));
        let (lo, _) = mesh.bounds();
        let across = mesh.positions.iter().map(|p| p.truncate().length());
        let radius = across.fold(0.0, f32::max);
        let Some(centre) = place(draw, &placed, radius) else {
            continue;
        };
        let down = Vec3::new(centre.x, centre.y, -lo.z);
        mesh.transform(&Affine3A::from_translation(down));
        placed.push(Footprint { centre, radius });
        let Ok(offset) = u16::try_from(scene.materials.len()) else {
            break;
        };
        scene.mesh.append(mesh, offset);
        scene.materials.append(&mut object.materials);
    }
    // The disc is centred under its objects and a little larger than they need.
    let (lo, hi) = scene.mesh.bounds();
    let middle = 0.5 * (lo + hi).truncate();
    let reach = placed.iter().map(|f| f.centre.distance(middle) + f.radius);
    let radius = draw.range(1.05, 1.3) * reach.fold(0.0, f32::max);
    let mut ground = Assembly::default();
    let m = ground_material(draw);
    let m = ground.material(m);
    let at = Vec3::new(middle.x, middle.y, 0.0);
    ground.add(&disc(radius).at(at), m);
    let ground = ground.finish();
    let offset = scene.materials.len() as u16;
    scene.mesh.append(&ground.mesh, offset);
    scene.materials.extend(ground.materials);
    scene.mesh.normalise();
    scene
}

/// A free place, denser toward the centre: uniform in the radius rather than in the area.
fn place(draw: &mut Draw, placed: &[Footprint], radius: f32) -> Option<Vec2> {
    for _ in 0..TRIES {
        let (s, c) = draw.range(0.0, TAU).sin_cos();
        let centre = EXTENT * draw.unit() * Vec2::new(c, s);
        let free = |f: &Footprint| f.centre.distance(centre) > f.radius + radius;
        if placed.iter().all(free) {
            return Some(centre);
        }
    }
    None
}

/// A flat disc in rings, so that its triangles are not needles.
fn disc(radius: f32) -> Part {
    let profile: Vec<Vec2> = (0..=12)
        .map(|i| Vec2::new(radius * (1.0 - i as f32 / 12.0), 0.0))
        .collect();
    super::primitives::lathe(&profile, 64, 0.5)
}

/// Mostly patterned and never a mirror.
fn ground_material(draw: &mut Draw) -> Material {
    let mut material = if draw.chance(0.8) {
        finish::patterned(draw, 0.05)
    } else {
        finish::material(draw)
    };
    finish::at_least(&mut material, 0.3);
    material
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::objects::procedural;
    use lumi_core::Seed;

    #[test]
    fn scenes_fill_the_unit_ball_without_collisions() {
        for i in 0..12 {
            let seed = Seed(3).index(i);
            let mut ends = Vec::new();
            let mut draw = Draw::new(seed, "scene");
            let mut total = 0;
            let model = arrangement(&mut draw, 6, |k| {
                let m = procedural(seed.index(k as u64));
                total += m.mesh.triangles.len();
                ends.push(total);
                m
            });
            let mesh = &model.mesh;
            let radius = mesh.radius(Vec3::ZERO);
            assert!((radius - 1.0).abs() < 1e-4, "{radius}");
            assert!(
                mesh.material
                    .iter()
                    .all(|&m| (m as usize) < model.materials.len())
            );
            // Nothing sinks below the ground, which is the lowest.
            let (lo, hi) = mesh.bounds();
            let ground = mesh.triangles.last().expect("ground")[0];
            assert!((mesh.positions[ground as usize].z - lo.z).abs() < 1e-4 && hi.z > lo.z);
        }
    }

    #[test]
    fn places_are_free_and_denser_in_the_middle() {
        let mut draw = Draw::new(Seed(5), "places");
        let mut inner = 0;
        for _ in 0..300 {
            let mut placed: Vec<Footprint> = Vec::new();
            for _ in 0..8 {
                if let Some(centre) = place(&mut draw, &placed, 0.7) {
                    let near = placed.iter().any(|f| f.centre.distance(centre) <= 1.4);
                    assert!(!near && centre.length() <= EXTENT);
                    placed.push(Footprint {
                        centre,
                        radius: 0.7,
                    });
                }
            }
            inner += usize::from(placed[0].centre.length() < 1.5);
        }
        // Uniform over the area would put a quarter of the first objects there.
        assert!(inner > 120, "{inner}");
    }
}
