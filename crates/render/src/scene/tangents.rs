//! Tangents for normal maps, as all tools that bake such maps compute them (MikkTSpace).

use super::mesh::Mesh;
use bevy_mikktspace::{Geometry, TangentSpace, generate_tangents};
use lumi_core::glam::{Vec2, Vec4};
use std::ops::Range;

/// Tangents of the triangles `range` for the texture coordinates `uv` (per vertex, v up), one per corner.
/// Corners without a tangent, because their texture coordinates are degenerate, are zero.
#[must_use]
pub fn derive(mesh: &Mesh, range: Range<usize>, uv: impl Fn(usize) -> Vec2) -> Vec<[Vec4; 3]> {
    let mut part = Part {
        mesh,
        first: range.start,
        made: vec![[Vec4::ZERO; 3]; range.len()],
        uv,
    };
    // Its error type has no values.
    let _ = generate_tangents(&mut part);
    part.made
}

struct Part<'a, F> {
    mesh: &'a Mesh,
    first: usize,
    made: Vec<[Vec4; 3]>,
    uv: F,
}

impl<F> Part<'_, F> {
    fn vertex(&self, face: usize, corner: usize) -> usize {
        self.mesh.triangles[self.first + face][corner] as usize
    }
}

impl<F: Fn(usize) -> Vec2> Geometry for Part<'_, F> {
    fn num_faces(&self) -> usize {
        self.made.len()
    }

    fn num_vertices_of_face(&self, _: usize) -> usize {
        3
    }

    fn position(&self, face: usize, corner: usize) -> [f32; 3] {
        self.mesh.positions[self.vertex(face, corner)].into()
    }

    fn normal(&self, face: usize, corner: usize) -> [f32; 3] {
        self.mesh.normals[self.vertex(face, corner)].into()
    }

    fn tex_coord(&self, face: usize, corner: usize) -> [f32; 2] {
        (self.uv)(self.vertex(face, corner)).into()
    }

    fn set_tangent(&mut self, space: Option<TangentSpace>, face: usize, corner: usize) {
        if let Some(space) = space {
            let tangent = Vec4::from(space.tangent_encoded());
            if tangent.is_finite() {
                self.made[face][corner] = tangent;
            }
        }
    }
}
