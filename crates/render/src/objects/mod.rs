//! Procedural objects: seeded, varied, inside the unit ball.

mod arrangement;
mod beings;
mod composed;
mod crafted;
mod everyday;
mod finish;
mod foliage;
mod ground;
mod made;
pub mod part;
pub mod primitives;
mod print;
mod sdf;
mod tools;

pub use arrangement::arrangement;
pub use ground::{Ground, Plane, Stage};

use crate::draw::Draw;
use crate::image_texture::Image;
use crate::scene::mesh::Model;
use lumi_core::Seed;
use lumi_core::glam::{Affine3A, Mat3};
use std::f32::consts::{PI, TAU};
use std::sync::Arc;

/// A family of objects and how often it is drawn.
struct Family {
    share: f32,
    make: fn(&mut Draw) -> Model,
}

/// All families; a new one is a row here.
const FAMILIES: [Family; 22] = [
    Family {
        share: 0.13,
        make: composed::cluster,
    },
    Family {
        share: 0.09,
        make: composed::melted,
    },
    Family {
        share: 0.06,
        make: composed::rock,
    },
    Family {
        share: 0.07,
        make: composed::knot,
    },
    Family {
        share: 0.13,
        make: made::vessel,
    },
    Family {
        share: 0.08,
        make: made::vehicle,
    },
    Family {
        share: 0.08,
        make: made::furniture,
    },
    Family {
        share: 0.06,
        make: made::tower,
    },
    Family {
        share: 0.11,
        make: beings::animal,
    },
    Family {
        share: 0.08,
        make: beings::figure,
    },
    Family {
        share: 0.05,
        make: beings::plant,
    },
    Family {
        share: 0.06,
        make: crafted::extruded,
    },
    Family {
        share: 0.05,
        make: crafted::lattice,
    },
    Family {
        share: 0.03,
        make: crafted::chain,
    },
    Family {
        share: 0.06,
        make: crafted::supershape,
    },
    Family {
        share: 0.06,
        make: crafted::carved,
    },
    Family {
        share: 0.05,
        make: crafted::machine,
    },
    Family {
        share: 0.08,
        make: foliage::foliage,
    },
    Family {
        share: 0.16,
        make: everyday::package,
    },
    Family {
        share: 0.08,
        make: everyday::toy,
    },
    Family {
        share: 0.06,
        make: tools::pierced,
    },
    Family {
        share: 0.12,
        make: tools::utensil,
    },
];

/// The object of `seed`, with crops of `pictures` on some surfaces: its box centred on the origin, its farthest vertex at distance 1, z up.
#[must_use]
pub fn procedural(seed: Seed, pictures: &Arc<[Arc<Image>]>) -> Model {
    let mut draw = Draw::new(seed, "object").with_pictures(pictures);
    let total: f32 = FAMILIES.iter().map(|f| f.share).sum();
    let mut left = draw.unit() * total;
    let mut chosen = &FAMILIES[0];
    for family in &FAMILIES {
        chosen = family;
        left -= family.share;
        if left < 0.0 {
            break;
        }
    }
    let mut model = (chosen.make)(&mut draw);
    print::unfold(&mut model);
    pose(&mut model, &mut draw);
    model
}

/// A copy of `model` in another pose and, mostly, other colours and roughness, so that few models show much.
#[must_use]
pub fn varied(model: &Model, seed: Seed) -> Model {
    let mut draw = Draw::new(seed, "object");
    let mut model = model.clone();
    if draw.chance(0.75) {
        for material in &mut model.materials {
            finish::vary(material, &mut draw);
        }
    }
    pose(&mut model, &mut draw);
    model
}

/// Turns the object about z, sometimes tips it over, and normalises it.
pub fn pose(model: &mut Model, draw: &mut Draw) {
    let turn = Mat3::from_rotation_z(draw.range(0.0, TAU));
    let rotation = if draw.chance(0.12) {
        draw.rotation()
    } else if draw.chance(0.25) {
        turn * Mat3::from_rotation_x(draw.range(-0.12, 0.12) * PI)
    } else {
        turn
    };
    model.mesh.transform(&Affine3A::from_mat3(rotation));
    model.mesh.normalise();
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::material::Coords;

    #[test]
    fn objects_are_finite_and_fill_the_unit_ball() {
        for i in 0..200 {
            let model = procedural(Seed(11).index(i), &Arc::default());
            let mesh = &model.mesh;
            assert!(!mesh.triangles.is_empty(), "object {i} is empty");
            assert!(
                mesh.triangles.len() <= 50_000,
                "object {i}: {}",
                mesh.triangles.len()
            );
            let n = mesh.positions.len();
            assert!(mesh.normals.len() == n && mesh.coords.len() == n);
            assert!(mesh.material.len() == mesh.triangles.len());
            let mut radius = 0.0_f32;
            for t in &mesh.triangles {
                for &v in t {
                    let (p, normal) = (mesh.positions[v as usize], mesh.normals[v as usize]);
                    assert!(
                        p.is_finite() && (normal.length() - 1.0).abs() < 1e-3,
                        "object {i}"
                    );
                    radius = radius.max(p.length());
                }
            }
            assert!((radius - 1.0).abs() < 1e-4, "object {i}: radius {radius}");
            for (&m, t) in mesh.material.iter().zip(&mesh.triangles) {
                let at = Coords::solid(mesh.coords[t[0] as usize]);
                let s = model.materials[m as usize].surface(&at);
                assert!(
                    s.base.min_element() >= 0.0 && s.base.max_element() <= 1.0,
                    "object {i}"
                );
                assert!(
                    (0.05..=1.0).contains(&s.roughness),
                    "object {i}: {}",
                    s.roughness
                );
            }
        }
    }
}
