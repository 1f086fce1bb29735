//! Geometry ready for rays: a bounding volume hierarchy over the triangles of a model.

pub mod mesh;
mod relief;
pub mod tangents;

use crate::material::{Coords, Material, Surface};
use lumi_core::glam::{Vec2, Vec3, Vec3A, Vec4};
use mesh::{Mesh, Model};
use obvhs::cwbvh::{CwBvh, builder::build_cwbvh_from_tris};
use obvhs::ray::{Ray, RayHit};
use obvhs::{BvhBuildParams, triangle::Triangle};
use std::time::Duration;

/// Rays start this far off the surface; objects have radius 1, so it is 1/20 of a pixel at 512 px.
pub const OFFSET: f32 = 1e-4;
/// See-through surfaces that a ray passes at most.
const MAX_PASSED: usize = 64;

/// A model with its acceleration structure.
pub struct Geometry {
    bvh: CwBvh,
    /// Triangles and faces in the order of the hierarchy's leaves, which saves an indirection per test.
    triangles: Vec<Triangle>,
    faces: Vec<Face>,
    /// In the same order; empty if no material needs them.
    details: Vec<Detail>,
    materials: Vec<Material>,
    /// Whether any material may be seen through.
    see_through: bool,
}

struct Face {
    normals: [Vec3; 3],
    coords: [Vec3; 3],
    material: u16,
}

/// What only textured models have.
struct Detail {
    second: [Vec2; 3],
    colors: [Vec4; 3],
    tangents: [Vec4; 3],
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
    /// Unit normal interpolated between the vertices, on the viewer's side of the triangle; at outlines it may face away.
    pub smooth: Vec3,
    /// Unit shading normal, with relief, on the viewer's side.
    pub normal: Vec3,
    /// Unit shading normal of the coat.
    pub coat_normal: Vec3,
    /// From the flat triangle to the curved surface that its normals speak of, see [`Self::shadow_start`].
    lift: Vec3,
    /// Material there.
    pub surface: Surface,
}

/// Shadow rays this close to the triangle's plane (cosine of the angle to its normal) start at the curved surface.
const GRAZING: f32 = 0.1;

impl Shading {
    /// Where rays leave the surface.
    #[must_use]
    pub fn start(&self) -> Vec3 {
        self.position + OFFSET * self.geometric
    }

    /// Where a shadow ray toward `direction` starts. Near the terminator flat triangles would shade themselves in
    /// blocks, so rays that graze them start at the curved surface (Hanika, "Hacking the Shadow Terminator", 2021).
    #[must_use]
    pub fn shadow_start(&self, direction: Vec3) -> Vec3 {
        let share = 1.0 - direction.dot(self.geometric) / GRAZING;
        self.start() + share.clamp(0.0, 1.0) * self.lift
    }
}

/// Barycentric coordinates and how they change with position.
struct Barycentric {
    weights: Vec3,
    gradients: [Vec3; 2],
}

impl Barycentric {
    fn new(t: &Triangle, position: Vec3) -> Self {
        let (e1, e2) = (t.v1 - t.v0, t.v2 - t.v0);
        let cross = e1.cross(e2);
        let inverse = 1.0 / cross.length_squared();
        let gradients = [e2.cross(cross) * inverse, cross.cross(e1) * inverse];
        let offset = Vec3A::from(position) - t.v0;
        // Clipped against rounding.
        let v = gradients[0].dot(offset).clamp(0.0, 1.0);
        let w = gradients[1].dot(offset).clamp(0.0, 1.0 - v);
        Self {
            weights: Vec3::new(1.0 - v - w, v, w),
            gradients: gradients.map(Vec3::from),
        }
    }
}

/// Weighted sum of the values at three corners.
fn blend<T>(w: Vec3, p: &[T; 3]) -> T
where
    T: Copy + std::ops::Mul<f32, Output = T> + std::ops::Add<Output = T>,
{
    p[0] * w.x + p[1] * w.y + p[2] * w.z
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
        let plain = mesh.second.is_empty() && mesh.colors.is_empty() && mesh.tangents.is_empty();
        let details = if plain {
            Vec::new()
        } else {
            order.clone().map(|i| Detail::new(&mesh, kept[i])).collect()
        };
        Self {
            faces: faces.collect(),
            details,
            triangles: order.map(|i| source[i]).collect(),
            see_through: materials.iter().any(Material::see_through),
            bvh,
            materials,
        }
    }

    /// Number of triangles.
    #[must_use]
    pub fn triangles(&self) -> usize {
        self.triangles.len()
    }

    /// Positions and unit normals of the corners of a triangle, by its index here.
    #[must_use]
    pub fn corners(&self, triangle: usize) -> ([Vec3; 3], [Vec3; 3]) {
        let t = &self.triangles[triangle];
        (
            [t.v0, t.v1, t.v2].map(Vec3::from),
            self.faces[triangle].normals,
        )
    }

    /// Material, opacity and shading normal, seen from outside, at the barycentric `weights` of a triangle.
    #[must_use]
    pub fn surface_at(&self, triangle: usize, weights: Vec3) -> (Surface, f32, Vec3) {
        let (corners, normals) = self.corners(triangle);
        let position = blend(weights, &corners);
        let outside = blend(weights, &normals).normalize_or(Vec3::Z);
        let hit = Hit {
            distance: 1.0,
            face: triangle as u32,
        };
        let shading = self.shading(position + outside, -outside, &hit);
        let opacity = self.opacity(position, hit.face);
        (shading.surface, opacity, shading.normal)
    }

    /// Whether any material turns normals.
    #[must_use]
    pub fn has_relief(&self) -> bool {
        self.materials.iter().any(|m| match m {
            Material::Textured(t) => t.normal.is_some(),
            m => m.bumpy(),
        })
    }

    /// Whether any material may be seen through.
    #[must_use]
    pub fn see_through(&self) -> bool {
        self.see_through
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

    /// The nearest surface along a ray that is there: each see-through surface is, with the probability of its
    /// opacity, if `chance` (uniform in [0, 1)) says so.
    #[must_use]
    pub fn visible(
        &self,
        origin: Vec3,
        direction: Vec3,
        mut chance: impl FnMut() -> f32,
    ) -> Option<Hit> {
        let mut hit = self.intersect(origin, direction)?;
        if !self.see_through {
            return Some(hit);
        }
        for _ in 0..MAX_PASSED {
            let opacity = self.opacity(origin + hit.distance * direction, hit.face);
            if opacity >= 1.0 || (opacity > 0.0 && chance() < opacity) {
                return Some(hit);
            }
            let passed = hit.distance + OFFSET;
            hit = self.intersect(origin + passed * direction, direction)?;
            hit.distance += passed;
        }
        None
    }

    /// How much light passes from `origin` to the point `distance` further along `direction`.
    #[must_use]
    pub fn transmittance(&self, origin: Vec3, direction: Vec3, distance: f32) -> f32 {
        if !self.see_through {
            return f32::from(u8::from(!self.occluded(origin, direction, distance)));
        }
        let (mut through, mut passed) = (1.0, 0.0);
        for _ in 0..MAX_PASSED {
            let Some(hit) = self.intersect(origin + passed * direction, direction) else {
                return through;
            };
            passed += hit.distance;
            if passed >= distance {
                return through;
            }
            through *= 1.0 - self.opacity(origin + passed * direction, hit.face);
            if through <= 0.0 {
                return 0.0;
            }
            passed += OFFSET;
        }
        0.0
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
        let index = hit.face as usize;
        let (face, triangle) = (&self.faces[index], &self.triangles[index]);
        let material = &self.materials[face.material as usize];
        let position = origin + hit.distance * direction;
        let barycentric = Barycentric::new(triangle, position);
        let weights = barycentric.weights;
        let (e1, e2) = (triangle.v1 - triangle.v0, triangle.v2 - triangle.v0);
        let mut geometric: Vec3 = e1.cross(e2).normalize().into();
        if geometric.dot(direction) > 0.0 {
            geometric = -geometric;
        }
        let outside = blend(weights, &face.normals).normalize_or(geometric);
        let side = if outside.dot(geometric) < 0.0 {
            -1.0
        } else {
            1.0
        };
        let smooth = side * outside;
        let coords = self.coords(index, weights);
        let mut shading = Shading {
            position,
            geometric,
            smooth,
            normal: smooth,
            coat_normal: smooth,
            lift: lift(triangle, face, position, weights, side),
            surface: material.surface(&coords),
        };
        match material {
            Material::Textured(t) if t.normal.is_some() || t.coat_normal.is_some() => {
                let tangents = self.details.get(index).map(|d| &d.tangents);
                let tangent = tangents.map_or(Vec4::ZERO, |t| blend(weights, t));
                let turned = |map: &Option<_>| match map {
                    Some(map) => {
                        let n = relief::mapped(map, &coords.uv, outside, tangent);
                        relief::reflecting(side * n, geometric, direction)
                    }
                    None => smooth,
                };
                shading.normal = turned(&t.normal);
                shading.coat_normal = turned(&t.coat_normal);
            }
            _ if material.bumpy() => {
                let [v, w] = barycentric.gradients;
                let c = &face.coords;
                let along = |d: Vec3| v.dot(d) * (c[1] - c[0]) + w.dot(d) * (c[2] - c[0]);
                let n = relief::bumped(material, coords.solid, along, smooth);
                shading.normal = relief::reflecting(n, geometric, direction);
                shading.coat_normal = shading.normal;
            }
            _ => {}
        }
        shading
    }

    fn opacity(&self, position: Vec3, face: u32) -> f32 {
        let index = face as usize;
        let material = &self.materials[self.faces[index].material as usize];
        if !material.see_through() {
            return 1.0;
        }
        let barycentric = Barycentric::new(&self.triangles[index], position);
        material.opacity(&self.coords(index, barycentric.weights))
    }

    fn coords(&self, face: usize, weights: Vec3) -> Coords {
        let mut coords = Coords::solid(blend(weights, &self.faces[face].coords));
        if let Some(detail) = self.details.get(face) {
            coords.uv[1] = blend(weights, &detail.second);
            coords.color = blend(weights, &detail.colors);
        }
        coords
    }
}

impl Detail {
    fn new(mesh: &Mesh, triangle: usize) -> Self {
        let corners = mesh.triangles[triangle].map(|v| v as usize);
        Self {
            second: corners.map(|v| mesh.second.get(v).copied().unwrap_or_default()),
            colors: corners.map(|v| mesh.colors.get(v).copied().unwrap_or(Vec4::ONE)),
            tangents: mesh.tangents.get(triangle).copied().unwrap_or_default(),
        }
    }
}

/// From a point of the triangle to the surface that is tangent to the normals at its corners.
fn lift(t: &Triangle, face: &Face, position: Vec3, weights: Vec3, side: f32) -> Vec3 {
    let corners = [t.v0, t.v1, t.v2].map(Vec3::from);
    let offset = |i: usize| {
        let n = side * face.normals[i];
        -(position - corners[i]).dot(n).min(0.0) * n
    };
    blend(weights, &[offset(0), offset(1), offset(2)])
}
