//! Geometry ready for rays: a bounding volume hierarchy over the triangles of a model.

pub mod mesh;

use crate::material::{Material, Surface};
use lumi_core::glam::{Vec3, Vec3A};
use mesh::Model;
use obvhs::cwbvh::{CwBvh, builder::build_cwbvh_from_tris};
use obvhs::ray::{Ray, RayHit};
use obvhs::{BvhBuildParams, triangle::Triangle};
use std::time::Duration;

/// Rays start this far off the surface; objects have radius 1, so it is 1/20 of a pixel at 512 px.
pub const OFFSET: f32 = 1e-4;

/// A model with its acceleration structure.
pub struct Geometry {
    bvh: CwBvh,
    /// Triangles and faces in the order of the hierarchy's leaves, which saves an indirection per test.
    triangles: Vec<Triangle>,
    faces: Vec<Face>,
    materials: Vec<Material>,
}

struct Face {
    normals: [Vec3; 3],
    coords: [Vec3; 3],
    material: u16,
}

/// Where a ray met the surface.
#[derive(Clone, Copy, Debug)]
pub struct Hit {
    /// Distance along the ray.
    pub distance: f32,
    face: u32,
}

/// The surface at a hit, turned toward the viewer.
#[derive(Clone, Copy, Debug)]
pub struct Shading {
    /// World position.
    pub position: Vec3,
    /// Unit geometric normal on the viewer's side.
    pub geometric: Vec3,
    /// Unit shading normal on the viewer's side.
    pub normal: Vec3,
    /// Material there.
    pub surface: Surface,
}

impl Geometry {
    /// Builds the hierarchy. Triangles without area are left out: they have no normal.
    #[must_use]
    pub fn new(model: Model) -> Self {
        let Model { mesh, materials } = model;
        let corner = |t: &[u32; 3], k: usize| Vec3A::from(mesh.positions[t[k] as usize]);
        let kept: Vec<usize> = (0..mesh.triangles.len())
            .filter(|&i| {
                let t = &mesh.triangles[i];
                let (a, b, c) = (corner(t, 0), corner(t, 1), corner(t, 2));
                let area = (b - a).cross(c - a).length();
                area.is_finite() && area > 1e-12
            })
            .collect();
        let source: Vec<Triangle> = kept
            .iter()
            .map(|&i| {
                let t = &mesh.triangles[i];
                Triangle {
                    v0: corner(t, 0),
                    v1: corner(t, 1),
                    v2: corner(t, 2),
                }
            })
            .collect();
        let bvh = build_cwbvh_from_tris(
            &source,
            BvhBuildParams::medium_build(),
            &mut Duration::default(),
        );
        let order = bvh.primitive_indices.iter().map(|&i| i as usize);
        let faces = order.clone().map(|i| {
            let t = mesh.triangles[kept[i]];
            Face {
                normals: t.map(|v| mesh.normals[v as usize]),
                coords: t.map(|v| mesh.coords[v as usize]),
                material: mesh.material[kept[i]],
            }
        });
        Self {
            faces: faces.collect(),
            triangles: order.map(|i| source[i]).collect(),
            bvh,
            materials,
        }
    }

    /// Number of triangles.
    #[must_use]
    pub fn triangles(&self) -> usize {
        self.triangles.len()
    }

    /// The nearest surface along a ray.
    #[must_use]
    pub fn intersect(&self, origin: Vec3, direction: Vec3) -> Option<Hit> {
        let ray = Ray::new(origin.into(), direction.into(), 0.0, f32::INFINITY);
        let mut hit = RayHit::none();
        let triangles = &self.triangles;
        self.bvh
            .ray_traverse(ray, &mut hit, |ray, i| triangles[i].intersect(ray))
            .then_some(Hit {
                distance: hit.t,
                face: hit.primitive_id,
            })
    }

    /// Whether anything stands between `origin` and the point `distance` further along `direction`.
    #[must_use]
    pub fn occluded(&self, origin: Vec3, direction: Vec3, distance: f32) -> bool {
        let ray = Ray::new(origin.into(), direction.into(), 0.0, distance);
        let triangles = &self.triangles;
        !self
            .bvh
            .ray_traverse_miss(ray, |ray, i| triangles[i].intersect(ray))
    }

    /// The surface at `hit` of the ray from `origin` along `direction`.
    #[must_use]
    pub fn shading(&self, origin: Vec3, direction: Vec3, hit: &Hit) -> Shading {
        let (face, t) = (
            &self.faces[hit.face as usize],
            &self.triangles[hit.face as usize],
        );
        let position = origin + hit.distance * direction;
        let (e1, e2) = (t.v1 - t.v0, t.v2 - t.v0);
        let cross = e1.cross(e2);
        let inverse = 1.0 / cross.length_squared();
        let offset = Vec3A::from(position) - t.v0;
        // Barycentric coordinates by areas, clipped against rounding.
        let v = (cross.dot(offset.cross(e2)) * inverse).clamp(0.0, 1.0);
        let w = (cross.dot(e1.cross(offset)) * inverse).clamp(0.0, 1.0 - v);
        let u = 1.0 - v - w;
        let blend = |p: &[Vec3; 3]| u * p[0] + v * p[1] + w * p[2];
        let mut geometric: Vec3 = (cross * inverse.sqrt()).into();
        if geometric.dot(direction) > 0.0 {
            geometric = -geometric;
        }
        let mut normal = blend(&face.normals).normalize_or(geometric);
        if normal.dot(geometric) < 0.0 {
            normal = -normal;
        }
        // A smooth normal may face away at grazing angles; bend it just enough to be seen.
        let facing = normal.dot(direction);
        if facing > -0.01 {
            normal = (normal - (facing + 0.01) * direction).normalize_or(geometric);
        }
        Shading {
            position,
            geometric,
            normal,
            surface: self.materials[face.material as usize].surface(blend(&face.coords)),
        }
    }
}
