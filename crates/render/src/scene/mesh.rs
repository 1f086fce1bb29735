//! Triangle meshes as the path tracer takes them.

use crate::material::Material;
use lumi_core::glam::{Affine3A, Mat3, Vec2, Vec3, Vec4};

/// Triangles with smooth normals and texture coordinates per vertex, and a material per triangle.
#[derive(Clone, Debug, Default)]
pub struct Mesh {
    /// World positions.
    pub positions: Vec<Vec3>,
    /// Unit shading normals; their sign does not matter, surfaces are two-sided.
    pub normals: Vec<Vec3>,
    /// Where textures are evaluated: a solid texture's space, or (u, v, 0) for images.
    pub coords: Vec<Vec3>,
    /// A second set of (u, v) per vertex; empty if no material needs it.
    pub second: Vec<Vec2>,
    /// Linear colour and opacity per vertex; empty means white.
    pub colors: Vec<Vec4>,
    /// Vertex indices.
    pub triangles: Vec<[u32; 3]>,
    /// Per corner of each triangle the unit tangent along u, and the sign with which its cross product with the
    /// normal runs along v (up the image); empty if no material has a normal map.
    pub tangents: Vec<[Vec4; 3]>,
    /// Index into [`Model::materials`] per triangle.
    pub material: Vec<u16>,
}

/// A mesh and its materials.
#[derive(Clone, Debug, Default)]
pub struct Model {
    /// Geometry.
    pub mesh: Mesh,
    /// What it is made of.
    pub materials: Vec<Material>,
}

/// Appends `other` to `own`, of which either may be empty and then stands for `n` defaults.
fn extend<T: Copy>(own: &mut Vec<T>, n: usize, other: &[T], other_n: usize, default: T) {
    if own.is_empty() && other.is_empty() {
        return;
    }
    own.resize(n, default);
    own.extend(other);
    own.resize(n + other_n, default);
}

impl Mesh {
    /// Appends `other`, whose material indices are shifted by `material_offset`.
    pub fn append(&mut self, other: &Self, material_offset: u16) {
        let (n, m) = (self.positions.len(), other.positions.len());
        extend(&mut self.second, n, &other.second, m, Vec2::ZERO);
        extend(&mut self.colors, n, &other.colors, m, Vec4::ONE);
        let (faces, more) = (self.triangles.len(), other.triangles.len());
        let none = [Vec4::ZERO; 3];
        extend(&mut self.tangents, faces, &other.tangents, more, none);
        self.positions.extend(&other.positions);
        self.normals.extend(&other.normals);
        self.coords.extend(&other.coords);
        let base = n as u32;
        let shifted = other.triangles.iter().map(|t| t.map(|i| i + base));
        self.triangles.extend(shifted);
        let materials = other.material.iter().map(|m| m + material_offset);
        self.material.extend(materials);
    }

    /// Moves, turns and stretches the mesh; textures stay attached.
    pub fn transform(&mut self, t: &Affine3A) {
        for p in &mut self.positions {
            *p = t.transform_point3(*p);
        }
        let linear = Mat3::from(t.matrix3);
        let to_normal = linear.inverse().transpose();
        for n in &mut self.normals {
            *n = (to_normal * *n).normalize_or(*n);
        }
        let flip = linear.determinant().signum();
        for tangent in self.tangents.iter_mut().flatten() {
            let d = (linear * tangent.truncate()).normalize_or_zero();
            *tangent = d.extend(tangent.w * flip);
        }
    }

    /// Smallest and largest coordinates.
    #[must_use]
    pub fn bounds(&self) -> (Vec3, Vec3) {
        let start = (Vec3::splat(f32::INFINITY), Vec3::splat(f32::NEG_INFINITY));
        let used = self.triangles.iter().flatten();
        used.map(|&i| self.positions[i as usize])
            .fold(start, |(lo, hi), p| (lo.min(p), hi.max(p)))
    }

    /// Distance from `centre` to the farthest vertex.
    #[must_use]
    pub fn radius(&self, centre: Vec3) -> f32 {
        let used = self.triangles.iter().flatten();
        used.map(|&i| self.positions[i as usize].distance(centre))
            .fold(0.0, f32::max)
    }

    /// Moves the box's centre to the origin and scales the farthest vertex to distance 1, as the
    /// evaluation objects are. Meshes without extent stay as they are.
    pub fn normalise(&mut self) {
        let (lo, hi) = self.bounds();
        let centre = 0.5 * (lo + hi);
        let radius = self.radius(centre);
        if radius > 0.0 && radius.is_finite() {
            for p in &mut self.positions {
                *p = (*p - centre) / radius;
            }
        }
    }
}
