//! Scenes: several objects on a textured ground.
//!
//! After the paper's supplement: 1 to 8 objects within ±3 of the centre and denser there, scales from 0.5 to 1.5,
//! any rotation, no collisions, on a textured ground. Objects come to rest on the ground as gravity has it. The
//! objects lie in the unit ball, as a single object does: with a disc just large enough for them, or without the
//! ground, which then goes on as far as cameras see. The conventions of the store (world space is model space; lights
//! stand outside the ball) hold for both.

use super::finish;
use super::ground::{self, Ground, Stage, disc};
use super::part::Assembly;
use crate::draw::Draw;
use crate::material::Material;
use crate::scene::mesh::{Mesh, Model};
use lumi_core::glam::{Affine3A, Mat3, Vec2, Vec3};
use std::f32::consts::TAU;

/// Objects stand within this distance of the centre along x and y, by their own centres; less on a ground that fills
/// the picture, where objects far apart would be small.
const EXTENT: f32 = 3.0;
/// Least and greatest radius of an object's ball.
const SCALES: [f32; 2] = [0.5, 1.5];
/// Places that are tried per object before it is left out.
const TRIES: usize = 100;
/// Steps in which an object comes to rest, and what each leaves of the last one's angle: 0.5 to 0.006 rad.
const SETTLING: (usize, f32) = (60, 0.93);

/// Where an object stands: the centre of a disc on the ground that no other object's disc meets.
struct Footprint {
    centre: Vec2,
    radius: f32,
}

/// Up to `count` objects of `next`, which makes them inside the unit ball, on a ground; and where that leaves cameras
/// and lights.
pub fn arrangement(
    draw: &mut Draw,
    count: usize,
    ground: Ground,
    mut next: impl FnMut(usize) -> Model,
) -> (Model, Stage) {
    let mut scene = Model::default();
    let mut placed: Vec<Footprint> = Vec::new();
    let extent = match ground {
        Ground::Disc => EXTENT,
        Ground::Filling { .. } => draw.range(0.15, 0.7) * EXTENT,
    };
    for k in 0..count.max(1) {
        let mut object = next(k);
        if draw.chance(0.4) {
            object.mesh.transform(&Affine3A::from_mat3(draw.rotation()));
        }
        let mesh = &mut object.mesh;
        let turn = Mat3::from_rotation_z(draw.range(0.0, TAU));
        let scale = draw.range(SCALES[0], SCALES[1]);
        let rest = rest(mesh, draw);
        mesh.transform(&Affine3A::from_mat3(scale * turn * rest));
        let (lo, _) = mesh.bounds();
        let across = mesh.positions.iter().map(|p| p.truncate().length());
        let radius = across.fold(0.0, f32::max);
        let Some(centre) = place(draw, &placed, radius, extent) else {
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
    match ground {
        Ground::Disc => {
            add_disc(draw, &mut scene, &placed);
            (scene, Stage::default())
        }
        Ground::Filling { walls } => {
            scene.mesh.normalise();
            let stage = ground::fill(draw, &mut scene, walls);
            (scene, stage)
        }
    }
}

/// A disc centred under the objects and a little larger than they need; the whole is scaled into the unit ball.
fn add_disc(draw: &mut Draw, scene: &mut Model, placed: &[Footprint]) {
    let (lo, hi) = scene.mesh.bounds();
    let middle = 0.5 * (lo + hi).truncate();
    let reach = placed.iter().map(|f| f.centre.distance(middle) + f.radius);
    let radius = draw.range(1.05, 1.3) * reach.fold(0.0, f32::max);
    let mut ground = Assembly::default();
    let m = disc_material(draw);
    let m = ground.material(m);
    let at = Vec3::new(middle.x, middle.y, 0.0);
    ground.add(&disc(radius).at(at), m);
    let ground = ground.finish();
    let offset = scene.materials.len() as u16;
    scene.mesh.append(&ground.mesh, offset);
    scene.materials.extend(ground.materials);
    scene.mesh.normalise();
}

/// The rotation that lets the mean of the vertices sink as low over the lowest of them as small turns can: on a face, an edge or
/// a foot on which the object is stable.
fn rest(mesh: &Mesh, draw: &mut Draw) -> Mat3 {
    let n = mesh.positions.len().max(1) as f32;
    let middle: Vec3 = mesh.positions.iter().sum::<Vec3>() / n;
    let height = |turn: Mat3| {
        // The third row is what rotates into z.
        let up = turn.transpose().z_axis;
        let lowest = mesh.positions.iter().map(|p| up.dot(*p));
        up.dot(middle) - lowest.fold(f32::INFINITY, f32::min)
    };
    let mut best = Mat3::IDENTITY;
    let mut least = height(best);
    let mut angle = 0.5;
    for _ in 0..SETTLING.0 {
        let azimuth = draw.range(0.0, TAU);
        let axis = Vec3::new(azimuth.cos(), azimuth.sin(), 0.0);
        let tried = Mat3::from_axis_angle(axis, angle) * best;
        let found = height(tried);
        if found < least {
            (best, least) = (tried, found);
        }
        angle *= SETTLING.1;
    }
    best
}

/// A free place, denser toward the centre: uniform in the radius rather than in the area. What does not fit within
/// `extent` stands up to twice as far out.
fn place(draw: &mut Draw, placed: &[Footprint], radius: f32, extent: f32) -> Option<Vec2> {
    for attempt in 0..TRIES {
        let reach = extent * (1.0 + attempt as f32 / TRIES as f32);
        let (s, c) = draw.range(0.0, TAU).sin_cos();
        let centre = reach * draw.unit() * Vec2::new(c, s);
        let free = |f: &Footprint| f.centre.distance(centre) > f.radius + radius;
        if placed.iter().all(free) {
            return Some(centre);
        }
    }
    None
}

/// Mostly patterned and never a mirror.
fn disc_material(draw: &mut Draw) -> Material {
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
    use std::sync::Arc;

    #[test]
    fn scenes_fill_the_unit_ball_without_collisions() {
        for i in 0..12 {
            let seed = Seed(3).index(i);
            let mut ends = Vec::new();
            let mut draw = Draw::new(seed, "scene");
            let mut total = 0;
            let (model, stage) = arrangement(&mut draw, 6, Ground::Disc, |k| {
                let m = procedural(seed.index(k as u64), &Arc::default());
                total += m.mesh.triangles.len();
                ends.push(total);
                m
            });
            assert_eq!(stage, Stage::default());
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
                if let Some(centre) = place(&mut draw, &placed, 0.7, EXTENT) {
                    let near = placed.iter().any(|f| f.centre.distance(centre) <= 1.4);
                    assert!(!near && centre.length() <= 2.0 * EXTENT);
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

    #[test]
    fn objects_on_a_filling_ground_stand_on_it_in_the_unit_ball() {
        for i in 0..12 {
            let seed = Seed(4).index(i);
            let mut draw = Draw::new(seed, "scene");
            let walls = i as usize % 3;
            let (model, stage) = arrangement(&mut draw, 4, Ground::Filling { walls }, |k| {
                procedural(seed.index(k as u64), &Arc::default())
            });
            assert_eq!(stage.planes.len(), 1 + walls);
            let level = stage.planes[0].offset;
            // The ground and the walls come last, with a material each.
            let mut objects = model.mesh.clone();
            let own = model.materials.len() - 1 - walls;
            let of_objects = objects.material.iter().filter(|m| usize::from(**m) < own);
            let count = of_objects.count();
            objects.triangles.truncate(count);
            let (lo, _) = objects.bounds();
            assert!((lo.z - level).abs() < 1e-4, "{} {level}", lo.z);
            assert!((objects.radius(Vec3::ZERO) - 1.0).abs() < 1e-4);
        }
    }

    #[test]
    fn a_tipped_plate_lies_down() {
        let mut draw = Draw::new(Seed(6), "rest");
        let plate = crate::objects::primitives::rounded_box(Vec3::new(1.0, 0.8, 0.05), 0.0);
        let mut mesh = plate.mesh(0);
        mesh.transform(&Affine3A::from_rotation_x(0.9));
        let turn = rest(&mesh, &mut draw);
        mesh.transform(&Affine3A::from_mat3(turn));
        let (lo, hi) = mesh.bounds();
        assert!(hi.z - lo.z < 0.2, "{}", hi.z - lo.z);
    }
}
