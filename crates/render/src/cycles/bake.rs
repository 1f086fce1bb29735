//! Any of our materials as images: each triangle gets a square cell of an atlas in which its surface is laid out.

use crate::material::Surface;
use crate::scene::Geometry;
use lumi_core::LinearImage;
use lumi_core::glam::Vec3;
use rayon::prelude::*;

/// Side of the atlas in pixels, at most (but for meshes of more than 260,000 triangles).
const SIDE: usize = 2048;

/// A model as Blender takes it.
pub struct Baked {
    /// Number of triangles.
    pub triangles: usize,
    /// Little-endian floats: positions, then normals (3 corners · 3 numbers per triangle), then (u, v) (3 · 2), v up.
    pub mesh: Vec<u8>,
    /// Base colour, and opacity in alpha.
    pub base: LinearImage,
    /// Roughness, metallicness, Blender's specular level, coat.
    pub properties: LinearImage,
    /// Colour of a dielectric's reflection, where it is not white everywhere.
    pub tint: Option<LinearImage>,
    /// Normal (n + 1)/2, and the coat's roughness in alpha.
    pub relief: LinearImage,
    /// Whether the normals differ from the mesh's.
    pub has_relief: bool,
    /// Whether the opacity is below 1 somewhere.
    pub see_through: bool,
}

/// Material, opacity and normal of a pixel of the atlas.
type Pixel = (Surface, f32, Vec3);

/// Lays out the surface of `geometry`.
pub fn bake(geometry: &Geometry) -> Baked {
    let n = geometry.triangles();
    let columns = (n as f64).sqrt().ceil().max(1.0) as usize;
    let cell = (SIDE / columns).clamp(4, SIDE);
    let side = columns * cell;

    let (mut positions, mut normals, mut uvs) = (Vec::new(), Vec::new(), Vec::new());
    for face in 0..n {
        let (p, v) = geometry.corners(face);
        positions.extend(p.iter().flat_map(|p| p.to_array()));
        normals.extend(v.iter().flat_map(|p| p.to_array()));
        let (x, y) = ((face % columns) * cell, (face / columns) * cell);
        // The corners are centres of pixels, so that no lookup leaves the cell.
        for (dx, dy) in [(0, 0), (cell - 1, 0), (0, cell - 1)] {
            let at = |i: usize| (i as f32 + 0.5) / side as f32;
            uvs.extend([at(x + dx), 1.0 - at(y + dy)]);
        }
    }
    let mesh = positions.iter().chain(&normals).chain(&uvs);

    let pixel = |i: usize| -> Pixel {
        let (x, y) = (i % side, i / side);
        let face = y / cell * columns + x / cell;
        if face >= n {
            return (Surface::lambert(Vec3::ZERO), 1.0, Vec3::Z);
        }
        let at = |i: usize| (i % cell) as f32 / (cell - 1) as f32;
        // Beyond the long edge lies its nearest point.
        let (mut v, mut w) = (at(x), at(y));
        let over = (v + w - 1.0).max(0.0);
        (v, w) = ((v - 0.5 * over).max(0.0), (w - 0.5 * over).max(0.0));
        geometry.surface_at(face, Vec3::new(1.0 - v - w, v, w))
    };
    let pixels: Vec<Pixel> = (0..side * side).into_par_iter().map(pixel).collect();
    let image = |f: &dyn Fn(&Pixel) -> [f32; 4]| LinearImage {
        width: side,
        height: side,
        pixels: pixels.iter().map(f).collect(),
    };
    Baked {
        triangles: n,
        mesh: mesh.flat_map(|v| v.to_le_bytes()).collect(),
        base: image(&|(s, a, _)| s.base.clamp(Vec3::ZERO, Vec3::ONE).extend(*a).to_array()),
        properties: image(&|(s, _, _)| {
            let [rough, metal, coat] = [s.roughness, s.metallic, s.coat].map(|v| v.clamp(0.0, 1.0));
            // Blender knows no weight: head on, where most is seen, it does the same.
            let level = 0.5 * s.specular * s.specular_weight;
            [rough, metal, level.max(0.0), coat]
        }),
        tint: pixels
            .iter()
            .any(|(s, _, _)| s.specular_color != Vec3::ONE)
            .then(|| image(&|(s, _, _)| s.specular_color.extend(1.0).to_array())),
        relief: image(&|(s, _, n)| {
            let n = 0.5 * (*n + 1.0);
            n.extend(s.coat_roughness)
                .to_array()
                .map(|v| v.clamp(0.0, 1.0))
        }),
        has_relief: geometry.has_relief(),
        see_through: geometry.see_through(),
    }
}
