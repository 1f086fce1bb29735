//! Triangle meshes as the path tracer takes them.

use crate::material::Material;
use lumi_core::glam::Vec3;

/// Triangles with smooth normals and texture coordinates per vertex, and a material per triangle.
#[derive(Clone, Debug, Default)]
pub struct Mesh {
    /// World positions.
    pub positions: Vec<Vec3>,
    /// Unit shading normals; their sign does not matter, surfaces are two-sided.
    pub normals: Vec<Vec3>,
    /// Where textures are evaluated: a solid texture's space, or (u, v, 0) for images.
    pub coords: Vec<Vec3>,
    /// Vertex indices.
    pub triangles: Vec<[u32; 3]>,
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

impl Mesh {
    /// Appends `other`, whose material indices are shifted by `material_offset`.
    pub fn append(&mut self, other: &Self, material_offset: u16) {
        let base = self.positions.len() as u32;
        self.positions.extend(&other.positions);
        self.normals.extend(&other.normals);
        self.coords.extend(&other.coords);
        let shifted = other.triangles.iter().map(|t| t.map(|i| i + base));
        self.triangles.extend(shifted);
        let materials = other.material.iter().map(|m| m + material_offset);
        self.material.extend(materials);
    }

    /// Smallest and largest coordinates.
    #[must_use]
    pub fn bounds(&self) -> (Vec3, Vec3) {
        let start = (Vec3::splat(f32::INFINITY), Vec3::splat(f32::NEG_INFINITY));
        let used = self.triangles.iter().flatten();
        used.map(|&i| self.positions[i as usize])
            .fold(start, |(lo, hi), p| (lo.min(p), hi.max(p)))
    }

    /// Moves the box's centre to the origin and scales the farthest vertex to distance 1, as the
    /// evaluation objects are. Meshes without extent stay as they are.
    pub fn normalise(&mut self) {
        let (lo, hi) = self.bounds();
        let centre = 0.5 * (lo + hi);
        let used = self.triangles.iter().flatten();
        let radius = used
            .map(|&i| self.positions[i as usize].distance(centre))
            .fold(0.0, f32::max);
        if radius > 0.0 && radius.is_finite() {
            for p in &mut self.positions {
                *p = (*p - centre) / radius;
            }
        }
    }
}
