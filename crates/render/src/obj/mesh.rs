//! Faces as triangles with a normal per corner.

use super::parse::{Corner, NONE, Shape};
use super::polygon::{Clipper, normal};
use crate::models::{Place, origin};
use crate::objects::primitives::CREASE;
use crate::scene::mesh::Mesh;
use crate::scene::tangents;
use lumi_core::color::srgb_decode;
use lumi_core::glam::{DVec3, Vec2, Vec3, Vec4};
use std::collections::HashMap;

/// Vertices with more faces than this are smooth all around: comparing all pairs would take for ever.
const CROWDED: usize = 64;

/// The mesh, y up as in the file; `materials` has for each of the shape's names, and then for none, the index of its
/// material and whether that has relief.
pub fn build(
    shape: &Shape,
    materials: &[(u16, bool)],
    warnings: &mut Vec<String>,
) -> Result<Mesh, Place> {
    let positions = placed(shape)?;
    let (mut clipper, mut cut) = (Clipper::new(), Vec::new());
    // Triangles as corners, with the place of their material.
    let mut triangles: Vec<([usize; 3], usize)> = Vec::new();
    let mut first = 0;
    for (face, corners) in shape.polygons() {
        let points: Vec<DVec3> = corners
            .iter()
            .map(|c| shape.positions[c.position as usize])
            .collect();
        cut.clear();
        clipper.triangulate(&points, &mut cut);
        let place = (face.material as usize).min(materials.len() - 1);
        triangles.extend(cut.iter().map(|t| (t.map(|i| first + i), place)));
        first = face.end;
    }
    if clipper.rough > 0 {
        warnings.push(format!(
            "{} polygons have so many corners that they may be filled wrongly",
            clipper.rough
        ));
    }
    // One range per material, so that tangents are made for those that need them.
    triangles.sort_by_key(|t| materials[t.1].0);

    let normals = normals(shape, &positions);
    let colors = colors(shape, warnings);
    let mut mesh = Mesh::default();
    let mut made: HashMap<(u32, u32, [u32; 3]), u32> = HashMap::new();
    for (corners, place) in &triangles {
        let triangle = corners.map(|c| {
            let corner = shape.corners[c];
            let normal = normals[c];
            let key = (
                corner.position,
                corner.coord,
                normal.to_array().map(f32::to_bits),
            );
            *made.entry(key).or_insert_with(|| {
                mesh.positions.push(positions[corner.position as usize]);
                mesh.normals.push(normal);
                mesh.coords.push(coord(shape, corner));
                if !colors.is_empty() {
                    mesh.colors.push(colors[corner.position as usize]);
                }
                mesh.positions.len() as u32 - 1
            })
        });
        mesh.triangles.push(triangle);
        mesh.material.push(materials[*place].0);
    }
    if materials.iter().any(|m| m.1) {
        relief(&mut mesh, materials);
    }
    Ok(mesh)
}

/// Positions in f32, moved to the origin if they are far away; those that no face uses may be anything.
fn placed(shape: &Shape) -> Result<Vec<Vec3>, Place> {
    let (mut low, mut high) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
    for (face, corners) in shape.polygons() {
        for corner in corners {
            let p = shape.positions[corner.position as usize];
            if !p.is_finite() {
                let place = format!("line {}", face.line);
                let vertex = corner.position + 1;
                return Err((
                    place,
                    format!("expected finite positions, vertex {vertex} has none"),
                ));
            }
            (low, high) = (low.min(p), high.max(p));
        }
    }
    let origin = origin(low, high);
    let moved: Vec<Vec3> = shape
        .positions
        .iter()
        .map(|p| (p - origin).as_vec3())
        .collect();
    let wide = (high - origin).as_vec3().is_finite() && (low - origin).as_vec3().is_finite();
    if shape.faces.is_empty() || wide {
        Ok(moved)
    } else {
        Err((
            "vertices".to_owned(),
            "expected positions below 3e38".to_owned(),
        ))
    }
}

/// Texture coordinates with v down, as images are; (0, 0) of the file without.
fn coord(shape: &Shape, corner: Corner) -> Vec3 {
    let uv = shape.coords.get(corner.coord as usize);
    let uv = uv
        .filter(|uv| uv.is_finite())
        .copied()
        .unwrap_or(Vec2::ZERO);
    Vec3::new(uv.x, 1.0 - uv.y, 0.0)
}

/// Linear colours per vertex, white for those without; empty if none has one.
fn colors(shape: &Shape, warnings: &mut Vec<String>) -> Vec<Vec4> {
    let most = shape
        .colors
        .iter()
        .map(|c| c.max_element())
        .fold(0.0, f32::max);
    // A little over 1 is rounding, and becomes 1.
    let scale = if most > 2.0 {
        warnings.push("colours of vertices are over 2; taken as 0 to 255".to_owned());
        1.0 / 255.0
    } else {
        1.0
    };
    let linear = shape.colors.iter().map(|c| {
        let [r, g, b] = (*c * scale).to_array().map(srgb_decode);
        Vec4::new(r, g, b, 1.0)
    });
    let mut all: Vec<Vec4> = linear.collect();
    if !all.is_empty() {
        all.resize(shape.positions.len(), Vec4::ONE);
    }
    all
}

/// A unit normal per corner: the file's, or else one that is smooth over flat edges and not over sharp ones.
fn normals(shape: &Shape, positions: &[Vec3]) -> Vec<Vec3> {
    let given = |c: &Corner| {
        let n = shape.normals.get(c.normal as usize)?;
        n.is_finite().then(|| n.try_normalize())?
    };
    let missing = shape.corners.iter().any(|c| given(c).is_none());
    let around = missing.then(|| Around::new(shape, positions));
    let mut all = Vec::with_capacity(shape.corners.len());
    for (face, (_, corners)) in shape.polygons().enumerate() {
        for corner in corners {
            let own = given(corner);
            let made = own.or_else(|| Some(around.as_ref()?.normal(face, corner.position)));
            all.push(made.unwrap_or(Vec3::Y));
        }
    }
    all
}

/// Which faces meet where.
struct Around {
    /// Normals of the faces, as long as twice their area.
    faces: Vec<Vec3>,
    /// Per vertex the first one in the same place.
    same: Vec<u32>,
    /// Per vertex where its faces begin in `list`.
    starts: Vec<usize>,
    list: Vec<u32>,
    /// Sums for vertices with many faces.
    crowds: HashMap<u32, Vec3>,
}

impl Around {
    fn new(shape: &Shape, positions: &[Vec3]) -> Self {
        let faces: Vec<Vec3> = shape
            .polygons()
            .map(|(_, corners)| {
                let points: Vec<DVec3> = corners
                    .iter()
                    .map(|c| shape.positions[c.position as usize])
                    .collect();
                normal(&points).as_vec3()
            })
            .collect();
        let mut firsts: HashMap<[u32; 3], u32> = HashMap::new();
        let same: Vec<u32> = (0..NONE)
            .zip(positions)
            .map(|(i, p)| {
                let key = p.to_array().map(|v| (v + 0.0).to_bits());
                *firsts.entry(key).or_insert(i)
            })
            .collect();
        let of = |c: &Corner| same[c.position as usize];
        let mut starts = vec![0; positions.len() + 1];
        for corner in &shape.corners {
            starts[of(corner) as usize + 1] += 1;
        }
        for i in 1..starts.len() {
            starts[i] += starts[i - 1];
        }
        let mut list = vec![0; shape.corners.len()];
        let mut ends = starts.clone();
        for (face, (_, corners)) in (0..NONE).zip(shape.polygons()) {
            for corner in corners {
                let end = &mut ends[of(corner) as usize];
                list[*end] = face;
                *end += 1;
            }
        }
        let mut this = Self {
            faces,
            starts,
            list,
            crowds: HashMap::new(),
            same: Vec::new(),
        };
        for i in 0..positions.len() {
            let near = this.at(i);
            if near.len() > CROWDED {
                let sum = near.iter().map(|&f| this.faces[f as usize]).sum();
                this.crowds.insert(i as u32, sum);
            }
        }
        this.same = same;
        this
    }

    /// Faces around the first vertex of a place.
    fn at(&self, first: usize) -> &[u32] {
        &self.list[self.starts[first]..self.starts[first + 1]]
    }

    fn normal(&self, face: usize, position: u32) -> Vec3 {
        let first = self.same[position as usize];
        let own = self.faces[face].normalize_or_zero();
        let limit = CREASE.cos();
        let sum = self.crowds.get(&first).copied().unwrap_or_else(|| {
            let near = self
                .at(first as usize)
                .iter()
                .map(|&f| self.faces[f as usize]);
            near.filter(|n| n.dot(own) >= limit * n.length()).sum()
        });
        sum.normalize_or(own.normalize_or(Vec3::Y))
    }
}

/// Tangents for the triangles whose material has relief.
fn relief(mesh: &mut Mesh, materials: &[(u16, bool)]) {
    let mut all = vec![[Vec4::ZERO; 3]; mesh.triangles.len()];
    let mut first = 0;
    for run in mesh.material.chunk_by(|a, b| a == b) {
        let range = first..first + run.len();
        first = range.end;
        if materials.iter().any(|m| m.1 && m.0 == run[0]) {
            let up = |v: usize| {
                let uv = mesh.coords[v];
                Vec2::new(uv.x, 1.0 - uv.y)
            };
            all[range.clone()].copy_from_slice(&tangents::derive(mesh, range, up));
        }
    }
    mesh.tangents = all;
}
