//! The triangles of a glTF scene.

use super::accessor::Buffers;
use super::material::Made;
use super::nodes::{Skin, moved};
use crate::material::Material;
use crate::models::origin;
use crate::scene::mesh::Mesh;
use crate::scene::tangents;
use gltf::Semantic;
use gltf::mesh::Mode;
use lumi_core::glam::{DMat4, DVec3, Mat3, Vec2, Vec3, Vec4};

/// More triangles, instances counted, are taken for an attack.
const MOST_TRIANGLES: usize = 50_000_000;
/// More primitives, instances counted, are too.
const MOST_PRIMITIVES: usize = 5_000_000;
/// Primitives smaller than this share of the whole are less than a hundredth of a pixel of any picture.
const NOTHING: f64 = 1e-6;

/// Positions in steps of more than this share of the whole can be seen to be.
const ROUGH: f64 = 1e-4;

/// What was wrong with a primitive.
type Result<T> = std::result::Result<T, String>;

/// The scene's primitives so far.
pub struct Scene<'a> {
    buffers: &'a Buffers,
    made: &'a [Made],
    parts: Vec<Part>,
    triangles: usize,
    primitives: usize,
    /// Lines and points.
    skipped: usize,
    /// The greatest distance between neighbouring f32 in the file's positions, in the world.
    step: f64,
}

/// A primitive in the world.
struct Part {
    /// But for the positions, which are the file's.
    mesh: Mesh,
    /// In the world.
    positions: Vec<DVec3>,
}

impl Part {
    fn bounds(&self) -> (DVec3, DVec3) {
        let start = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        let grow = |(low, high): (DVec3, DVec3), p: &DVec3| (low.min(*p), high.max(*p));
        self.positions.iter().fold(start, grow)
    }
}

impl<'a> Scene<'a> {
    /// Without triangles.
    pub fn new(buffers: &'a Buffers, made: &'a [Made]) -> Self {
        Self {
            buffers,
            made,
            parts: Vec::new(),
            triangles: 0,
            primitives: 0,
            skipped: 0,
            step: 0.0,
        }
    }

    /// Appends a primitive at a node, or says what is wrong with it. Of its accessors only what its indices name is
    /// taken: thousands of primitives may share one.
    pub fn add(
        &mut self,
        primitive: &gltf::Primitive<'_>,
        transform: DMat4,
        skin: Option<&Skin>,
    ) -> Result<()> {
        self.primitives += 1;
        if self.primitives > MOST_PRIMITIVES {
            return Err(format!("expected at most {MOST_PRIMITIVES} primitives"));
        }
        let mode = primitive.mode();
        if !matches!(
            mode,
            Mode::Triangles | Mode::TriangleStrip | Mode::TriangleFan
        ) {
            self.skipped += 1;
            return Ok(());
        }
        let positions = primitive.get(&Semantic::Positions);
        let positions = self
            .buffers
            .floats(&positions.ok_or("expected POSITION, found none")?)?;
        let n = positions.len();
        let mut indices = match primitive.indices() {
            Some(accessor) => self.buffers.indices(&accessor)?,
            None => (0..u32::try_from(n).map_err(|e| e.to_string())?).collect(),
        };
        if let Some(i) = indices.iter().find(|&&i| i as usize >= n) {
            return Err(format!("expected indices below {n}, found {i}"));
        }
        let used = renumbered(&mut indices, n);
        let triangles = assembled(mode, &indices);
        drop(indices);
        self.triangles += triangles.len();
        if self.triangles > MOST_TRIANGLES {
            return Err(format!("expected at most {MOST_TRIANGLES} triangles"));
        }
        if triangles.is_empty() {
            return Ok(());
        }
        let material = primitive.material().index();
        let material = material.unwrap_or(self.made.len() - 1);
        let made = &self.made[material];
        let mut part = Mesh {
            coords: self.coords(primitive, made.sets[0], &used)?,
            material: vec![
                u16::try_from(material).map_err(|_| "expected under 65536 materials")?;
                triangles.len()
            ],
            normals: self.normals(primitive, &used)?,
            positions: used
                .iter()
                .map(|&i| {
                    positions
                        .get(i as usize)
                        .map_or(Vec3::ZERO, Vec3::from_array)
                })
                .collect(),
            triangles,
            ..Mesh::default()
        };
        if made.sets[1] != u32::MAX {
            let second = self.coords(primitive, made.sets[1], &used)?;
            part.second = second.into_iter().map(Vec3::truncate).collect();
        }
        part.colors = self.colors(primitive, &used)?;
        let transforms = self.transforms(primitive, transform, skin, &used)?;
        let place = |v: usize| transforms.get(v).unwrap_or(&transform);
        let mut world: Vec<DVec3> = (0..used.len())
            .map(|v| moved(place(v), part.positions[v]))
            .collect();
        let far = part.positions.iter().map(|p| p.abs().max_element());
        let far = f64::from(far.fold(0.0, f32::max));
        let stretch = place(0).x_axis.truncate().length();
        let step = far * f64::from(f32::EPSILON) * stretch;
        if part.normals.is_empty() {
            // Where the skin takes them, which need not be where flat faces of the mesh would go.
            let corners = flatten(&mut part, &world);
            world = corners.iter().map(|&v| world[v]).collect();
            self.relief(made, &mut part);
        } else {
            match self.tangents(primitive, &used)? {
                Some(given) => {
                    let corner = |v: u32| given[v as usize];
                    part.tangents = part.triangles.iter().map(|t| t.map(corner)).collect();
                }
                None => self.relief(made, &mut part),
            }
            turn(&mut part, place);
        }
        self.step = self.step.max(step);
        if world.iter().any(|p| !p.is_finite()) {
            return Err("expected finite positions".to_owned());
        }
        self.parts.push(Part {
            mesh: part,
            positions: world,
        });
        Ok(())
    }

    /// All triangles, around the origin if they are far from it.
    pub fn finish(self, warnings: &mut Vec<String>) -> Result<Mesh> {
        if self.skipped > 0 {
            warnings.push(format!("{} primitives are lines or points", self.skipped));
        }
        let boxes: Vec<(DVec3, DVec3)> = self.parts.iter().map(Part::bounds).collect();
        let start = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        let join = |a: (DVec3, DVec3), b: &(DVec3, DVec3)| (a.0.min(b.0), a.1.max(b.1));
        let (low, high) = boxes.iter().fold(start, join);
        // Hidden things are often scaled to zero, and would count for the size of the whole.
        let least = NOTHING * (high - low).length();
        let seen = |b: &(DVec3, DVec3)| (b.1 - b.0).length() > least;
        let (low, high) = boxes.iter().filter(|b| seen(b)).fold(start, join);
        let hidden = boxes.iter().filter(|b| !seen(b)).count();
        if hidden > 0 {
            let text = format!("{hidden} primitives are scaled to nothing; they are left out");
            warnings.push(text);
        }
        if self.step > ROUGH * (high - low).length() {
            warnings.push(format!(
                "positions are so far from their origin that the file holds them in steps of {:.2}",
                self.step
            ));
        }
        let origin = origin(low, high);
        let mut all = Mesh::default();
        for (part, bounds) in self.parts.into_iter().zip(&boxes) {
            if !seen(bounds) {
                continue;
            }
            let mut mesh = part.mesh;
            let placed = part.positions.iter().map(|p| (p - origin).as_vec3());
            mesh.positions = placed.collect();
            if mesh.positions.iter().any(|p| !p.is_finite()) {
                return Err("expected positions below 3e38".to_owned());
            }
            all.append(&mesh, 0);
        }
        Ok(all)
    }

    /// Per vertex the transform to the world, if they differ.
    fn transforms(
        &self,
        primitive: &gltf::Primitive<'_>,
        node: DMat4,
        skin: Option<&Skin>,
        used: &[u32],
    ) -> Result<Vec<DMat4>> {
        let Some(skin) = skin else {
            return Ok(Vec::new());
        };
        let bound = Skin::bound(self.buffers, primitive)?;
        if bound.is_empty() {
            return Ok(vec![node; used.len()]);
        }
        used.iter().map(|&i| skin.at(&bound, i as usize)).collect()
    }

    fn relief(&self, made: &Made, part: &mut Mesh) {
        let Some(set) = relief_set(made) else { return };
        part.tangents = tangents::derive(part, 0..part.triangles.len(), |v| {
            let uv = if set == 0 {
                part.coords[v].truncate()
            } else {
                part.second[v]
            };
            Vec2::new(uv.x, 1.0 - uv.y)
        });
    }

    /// Unit vectors per vertex; empty if there are none.
    fn normals(&self, primitive: &gltf::Primitive<'_>, used: &[u32]) -> Result<Vec<Vec3>> {
        let Some(accessor) = primitive.get(&Semantic::Normals) else {
            return Ok(Vec::new());
        };
        let all = self.buffers.floats(&accessor)?;
        let unit = |&i: &u32| {
            let given = all.get(i as usize).map(Vec3::from_array);
            given.unwrap_or(Vec3::Y).normalize_or(Vec3::Y)
        };
        Ok(used.iter().map(unit).collect())
    }

    fn tangents(&self, primitive: &gltf::Primitive<'_>, used: &[u32]) -> Result<Option<Vec<Vec4>>> {
        let Some(accessor) = primitive.get(&Semantic::Tangents) else {
            return Ok(None);
        };
        let all = self.buffers.floats(&accessor)?;
        let tangent = |&i: &u32| {
            let given = all.get(i as usize).map(Vec4::from_array);
            given.filter(|t| t.is_finite()).unwrap_or(Vec4::ZERO)
        };
        Ok(Some(used.iter().map(tangent).collect()))
    }

    fn colors(&self, primitive: &gltf::Primitive<'_>, used: &[u32]) -> Result<Vec<Vec4>> {
        let Some(accessor) = primitive.get(&Semantic::Colors(0)) else {
            return Ok(Vec::new());
        };
        let clean = |c: Option<Vec4>| {
            c.filter(|c| c.is_finite())
                .map_or(Vec4::ONE, |c| c.clamp(Vec4::ZERO, Vec4::ONE))
        };
        let indices = used.iter().map(|&i| i as usize);
        Ok(if accessor.dimensions().multiplicity() == 3 {
            let all = self.buffers.floats::<3>(&accessor)?;
            let opaque = |c: [f32; 3]| Vec3::from_array(c).extend(1.0);
            indices.map(|i| clean(all.get(i).map(opaque))).collect()
        } else {
            let all = self.buffers.floats::<4>(&accessor)?;
            indices
                .map(|i| clean(all.get(i).map(Vec4::from_array)))
                .collect()
        })
    }

    /// (u, v, 0) per vertex of one of the file's sets; zero without it.
    fn coords(&self, primitive: &gltf::Primitive<'_>, set: u32, used: &[u32]) -> Result<Vec<Vec3>> {
        let Some(accessor) = primitive.get(&Semantic::TexCoords(set)) else {
            return Ok(vec![Vec3::ZERO; used.len()]);
        };
        let all = self.buffers.floats(&accessor)?;
        let coord = |&i: &u32| {
            let uv = all.get(i as usize).map(Vec2::from_array);
            uv.filter(|uv| uv.is_finite()).unwrap_or(Vec2::ZERO)
        };
        Ok(used.iter().map(|i| coord(i).extend(0.0)).collect())
    }
}

/// Renumbers indices without gaps, and returns which of `n` vertices each new number stands for.
fn renumbered(indices: &mut [u32], n: usize) -> Vec<u32> {
    // Either takes memory in proportion to the indices, however many vertices there are.
    if n / 4 <= indices.len() {
        let mut new = vec![u32::MAX; n];
        let mut used = Vec::new();
        for i in indices {
            let slot = &mut new[*i as usize];
            if *slot == u32::MAX {
                *slot = used.len() as u32;
                used.push(*i);
            }
            *i = *slot;
        }
        used
    } else {
        let mut used = indices.to_vec();
        used.sort_unstable();
        used.dedup();
        for i in indices {
            *i = used.partition_point(|u| u < i) as u32;
        }
        used
    }
}

/// Turns normals and tangents, which are still the file's, as the transform of each vertex does.
fn turn<'t>(part: &mut Mesh, transform: impl Fn(usize) -> &'t DMat4) {
    let linear = |v: usize| Mat3::from_mat4(transform(v).as_mat4());
    for (v, n) in part.normals.iter_mut().enumerate() {
        let to_normal = linear(v).inverse().transpose();
        *n = (to_normal * *n).normalize_or(*n);
    }
    for (corners, triangle) in part.tangents.iter_mut().zip(&part.triangles) {
        for (tangent, &v) in corners.iter_mut().zip(triangle) {
            let linear = linear(v as usize);
            let d = (linear * tangent.truncate()).normalize_or_zero();
            *tangent = d.extend(tangent.w * linear.determinant().signum());
        }
    }
}

/// Our set of texture coordinates that the material's relief uses, if it has any.
fn relief_set(made: &Made) -> Option<usize> {
    let Material::Textured(t) = &made.material else {
        return None;
    };
    let map = t.normal.as_ref().or(t.coat_normal.as_ref())?;
    Some(map.texture.set)
}

fn assembled(mode: Mode, indices: &[u32]) -> Vec<[u32; 3]> {
    match mode {
        Mode::TriangleStrip => (2..indices.len())
            .map(|i| {
                let (a, b) = (indices[i - 2], indices[i - 1]);
                let (a, b) = if i % 2 == 0 { (a, b) } else { (b, a) };
                [a, b, indices[i]]
            })
            .collect(),
        Mode::TriangleFan => (2..indices.len())
            .map(|i| [indices[0], indices[i - 1], indices[i]])
            .collect(),
        _ => indices
            .chunks_exact(3)
            .map(|t| [t[0], t[1], t[2]])
            .collect(),
    }
}

/// Gives each triangle its own vertices and their normal in the world: glTF's rule for meshes without normals. Returns
/// the old number of each new vertex.
fn flatten(part: &mut Mesh, world: &[DVec3]) -> Vec<usize> {
    let corners: Vec<usize> = part
        .triangles
        .iter()
        .flatten()
        .map(|&v| v as usize)
        .collect();
    // Of positions that are in the world already; tangents are made from them.
    part.positions = corners
        .iter()
        .map(|&v| (world[v] - world[corners[0]]).as_vec3())
        .collect();
    part.coords = corners.iter().map(|&v| part.coords[v]).collect();
    if !part.second.is_empty() {
        part.second = corners.iter().map(|&v| part.second[v]).collect();
    }
    if !part.colors.is_empty() {
        part.colors = corners.iter().map(|&v| part.colors[v]).collect();
    }
    part.normals = part
        .positions
        .chunks_exact(3)
        .flat_map(|p| [(p[1] - p[0]).cross(p[2] - p[0]).normalize_or(Vec3::Y); 3])
        .collect();
    part.triangles = (0..part.triangles.len() as u32)
        .map(|i| [3 * i, 3 * i + 1, 3 * i + 2])
        .collect();
    corners
}
