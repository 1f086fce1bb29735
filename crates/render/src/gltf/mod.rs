//! glTF and GLB models: geometry, node transforms and metallic-roughness materials.
//!
//! Read as Blender's importer does: y-up becomes z-up by (x, y, z) ↦ (x, −z, y); both sides of every surface are
//! shown, whatever `doubleSided` says; occlusion textures change nothing, since paths find occlusion themselves.
//! Tangents are those of the file or else MikkTSpace's. Not shown, and warned about by name: a material's own light
//! (it is none of the lights of a basis), skins and morph targets (the rest pose is used), lines and points,
//! extensions other than [`KNOWN`].

mod accessor;
mod material;
mod source;
#[cfg(test)]
mod tests;

use crate::models::Import;
use crate::scene::mesh::{Mesh, Model};
use crate::scene::tangents;
use accessor::Buffers;
use gltf::Semantic;
use gltf::mesh::Mode;
use lumi_core::glam::{Affine3A, Mat4, Vec2, Vec3, Vec4};
use lumi_core::{Error, Result};
use material::{Made, Maker};
use std::collections::{HashMap, HashSet};
use std::path::Path;

pub(crate) use source::decode as decode_image;

/// Extensions that are shown.
pub const KNOWN: [&str; 6] = [
    "KHR_materials_clearcoat",
    "KHR_materials_ior",
    "KHR_materials_pbrSpecularGlossiness",
    "KHR_materials_specular",
    "KHR_mesh_quantization",
    "KHR_texture_transform",
];
/// More triangles, instances counted, are taken for an attack.
const MOST_TRIANGLES: usize = 50_000_000;

/// Reads a model; its scale is the file's.
///
/// # Errors
/// Names the file and what in it could not be read, or that it has no triangles.
pub fn read(path: &Path) -> Result<Import> {
    let bytes = lumi_core::fs::read_bytes(path)?;
    let invalid = |field: &str, e: String| Error::invalid(path, field, e);
    let (mut root, blob) = parse(&bytes).map_err(|e| invalid("glTF", e))?;
    let mut warnings = unknown(&mut root);
    let document = gltf::Document::from_json(root).map_err(|e| invalid("glTF", e.to_string()))?;
    let buffers = buffers(path, &document, blob)?;

    let mut maker = Maker {
        path,
        buffers: &buffers,
        images: HashMap::new(),
        warnings: Vec::new(),
    };
    let mut made: Vec<Made> = Vec::new();
    for source in document.materials() {
        let field = format!("materials[{}]", made.len());
        let material = maker.make(&document, &source);
        made.push(material.map_err(|e| invalid(&field, e))?);
    }
    warnings.append(&mut maker.warnings);
    // Triangles without a material: glTF's default is a white rough metal, which Blender shows as a
    // grey dielectric; so do we.
    let grey = crate::material::Surface::dielectric(Vec3::splat(0.8), 0.5);
    made.push(Made {
        material: crate::material::Material::Textured(Box::new(crate::material::Textured::new(
            grey,
        ))),
        sets: [0, u32::MAX],
    });

    let mut scene = Scene {
        buffers: &buffers,
        made: &made,
        mesh: Mesh::default(),
        skipped: 0,
    };
    for (node, transform) in nodes(path, &document)? {
        for primitive in node.mesh().iter().flat_map(gltf::Mesh::primitives) {
            let mesh = node.mesh().map_or(0, |m| m.index());
            let field = format!("meshes[{mesh}].primitives[{}]", primitive.index());
            scene
                .add(&primitive, transform)
                .map_err(|e| invalid(&field, e))?;
        }
    }
    let (mut mesh, skipped) = (scene.mesh, scene.skipped);
    if mesh.triangles.is_empty() {
        let expected = "expected at least one triangle, found none";
        return Err(Error::invalid(path, "meshes", expected));
    }
    if skipped > 0 {
        warnings.push(format!("{skipped} primitives are lines or points"));
    }
    if document.skins().len() > 0 {
        warnings.push("skins: the rest pose is shown".to_owned());
    }
    if document.meshes().any(|m| m.weights().is_some()) {
        warnings.push("morph targets: the rest shape is shown".to_owned());
    }
    mesh.transform(&Affine3A::from_cols_array_2d(&Z_UP));
    Ok(Import {
        model: Model {
            mesh,
            materials: made.into_iter().map(|m| m.material).collect(),
        },
        warnings,
    })
}

/// glTF's y-up world to ours: columns of (x, y, z) ↦ (x, −z, y).
pub(crate) const Z_UP: [[f32; 3]; 4] = [
    [1.0, 0.0, 0.0],
    [0.0, 0.0, 1.0],
    [0.0, -1.0, 0.0],
    [0.0, 0.0, 0.0],
];

/// The JSON and the binary chunk of either kind of file.
fn parse(bytes: &[u8]) -> std::result::Result<(gltf::json::Root, Option<Vec<u8>>), String> {
    if bytes.is_empty() {
        return Err("expected a model, found an empty file".to_owned());
    }
    let (json, blob) = if bytes.starts_with(b"glTF") {
        let glb = gltf::binary::Glb::from_slice(bytes).map_err(|e| e.to_string())?;
        (glb.json, glb.bin.map(|b| b.into_owned()))
    } else {
        (bytes.into(), None)
    };
    let root = gltf::json::Root::from_slice(&json).map_err(|e| e.to_string())?;
    // The parser's own checks look at these accessors before they have checked the indices.
    let primitives = root.meshes.iter().flat_map(|m| &m.primitives);
    let used = primitives.flat_map(|p| p.attributes.values());
    let n = root.accessors.len();
    if let Some(index) = used.map(|a| a.value()).find(|&a| a >= n) {
        return Err(format!(
            "expected attributes below accessors[{n}], found {index}"
        ));
    }
    // Nor does it check that an image says what it is and where.
    for (i, image) in root.images.iter().enumerate() {
        let (view, kind) = (image.buffer_view.is_some(), image.mime_type.is_some());
        if (view && !kind) || (!view && image.uri.is_none()) {
            return Err(format!(
                "images[{i}]: expected a uri, or a bufferView with a mimeType"
            ));
        }
    }
    Ok((root, blob))
}

/// Takes the extensions that we read ourselves from those that the parser must know, and names the unknown ones.
fn unknown(root: &mut gltf::json::Root) -> Vec<String> {
    let ours = |name: &String| KNOWN.contains(&name.as_str());
    root.extensions_required.retain(|e| !ours(e));
    let used = root.extensions_used.iter().filter(|e| !ours(e));
    used.filter(|e| *e != "KHR_materials_unlit")
        .map(|e| format!("{e} is not supported and left out"))
        .collect()
}

fn buffers(path: &Path, document: &gltf::Document, mut blob: Option<Vec<u8>>) -> Result<Buffers> {
    let mut buffers = Vec::new();
    for buffer in document.buffers() {
        let field = format!("buffers[{}]", buffer.index());
        let data = match buffer.source() {
            gltf::buffer::Source::Bin => blob.take().ok_or_else(|| {
                Error::invalid(path, &field, "expected the GLB's binary chunk, found none")
            })?,
            gltf::buffer::Source::Uri(uri) => {
                source::resolve(path, uri).map_err(|e| Error::invalid(path, &field, e))?
            }
        };
        if data.len() < buffer.length() {
            let expected = format!("expected {} bytes, found {}", buffer.length(), data.len());
            return Err(Error::invalid(path, field, expected));
        }
        buffers.push(data);
    }
    Ok(Buffers(buffers))
}

/// The nodes of the scene with their transforms to the world.
fn nodes<'a>(path: &Path, document: &'a gltf::Document) -> Result<Vec<(gltf::Node<'a>, Mat4)>> {
    let scene = document.default_scene();
    let scene = scene.or_else(|| document.scenes().next());
    let mut open: Vec<(gltf::Node<'a>, Mat4)> = match &scene {
        Some(scene) => scene.nodes().map(|n| (n, Mat4::IDENTITY)).collect(),
        // Without a scene: from the nodes that are nobody's child.
        None => {
            let nodes = document.nodes().flat_map(|n| n.children());
            let children: HashSet<usize> = nodes.map(|child| child.index()).collect();
            let roots = document.nodes().filter(|n| !children.contains(&n.index()));
            roots.map(|n| (n, Mat4::IDENTITY)).collect()
        }
    };
    open.reverse();
    let mut seen = vec![false; document.nodes().len()];
    let mut found = Vec::new();
    while let Some((node, parent)) = open.pop() {
        let index = node.index();
        if std::mem::replace(&mut seen[index], true) {
            let expected = "expected a tree, found a node with two parents";
            return Err(Error::invalid(path, format!("nodes[{index}]"), expected));
        }
        let transform = parent * Mat4::from_cols_array_2d(&node.transform().matrix());
        let first = open.len();
        open.extend(node.children().map(|c| (c, transform)));
        open[first..].reverse();
        found.push((node, transform));
    }
    Ok(found)
}

/// The scene's triangles so far.
struct Scene<'a> {
    buffers: &'a Buffers,
    made: &'a [Made],
    mesh: Mesh,
    skipped: usize,
}

impl Scene<'_> {
    /// Appends a primitive, or says what is wrong with it.
    fn add(
        &mut self,
        primitive: &gltf::Primitive<'_>,
        transform: Mat4,
    ) -> std::result::Result<(), String> {
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
        let positions: Vec<Vec3> = positions.into_iter().map(Vec3::from_array).collect();
        let n = positions.len();
        let indices = match primitive.indices() {
            Some(accessor) => self.buffers.indices(&accessor)?,
            None => (0..u32::try_from(n).map_err(|e| e.to_string())?).collect(),
        };
        if let Some(i) = indices.iter().find(|&&i| i as usize >= n) {
            return Err(format!("expected indices below {n}, found {i}"));
        }
        let triangles = assembled(mode, &indices);
        let total = self.mesh.triangles.len() + triangles.len();
        if total > MOST_TRIANGLES {
            return Err(format!("expected at most {MOST_TRIANGLES} triangles"));
        }
        let material = primitive.material().index();
        let material = material.unwrap_or(self.made.len() - 1);
        let made = &self.made[material];
        let mut part = Mesh {
            coords: self.coords(primitive, made.sets[0], n)?,
            material: vec![
                u16::try_from(material).map_err(|_| "expected under 65536 materials")?;
                triangles.len()
            ],
            normals: self.vectors(primitive, &Semantic::Normals, n)?,
            positions,
            triangles,
            ..Mesh::default()
        };
        if made.sets[1] != u32::MAX {
            let second = self.coords(primitive, made.sets[1], n)?;
            part.second = second.into_iter().map(Vec3::truncate).collect();
        }
        part.colors = self.colors(primitive, n)?;
        let given = self.tangents(primitive, n)?;
        if part.normals.is_empty() {
            flatten(&mut part);
        } else if let Some(given) = given {
            let corner = |v: u32| given[v as usize];
            part.tangents = part.triangles.iter().map(|t| t.map(corner)).collect();
        }
        if part.tangents.is_empty()
            && let Some(set) = relief_set(made)
        {
            part.tangents = tangents::derive(&part, 0..part.triangles.len(), |v| {
                let uv = if set == 0 {
                    part.coords[v].truncate()
                } else {
                    part.second[v]
                };
                Vec2::new(uv.x, 1.0 - uv.y)
            });
        }
        part.transform(&Affine3A::from_mat4(transform));
        if part.positions.iter().any(|p| !p.is_finite()) {
            return Err("expected finite positions".to_owned());
        }
        self.mesh.append(&part, 0);
        Ok(())
    }

    /// Unit vectors per vertex; empty if there are none.
    fn vectors(
        &self,
        primitive: &gltf::Primitive<'_>,
        semantic: &Semantic,
        n: usize,
    ) -> std::result::Result<Vec<Vec3>, String> {
        let Some(accessor) = primitive.get(semantic) else {
            return Ok(Vec::new());
        };
        let mut all: Vec<Vec3> = self
            .buffers
            .floats(&accessor)?
            .into_iter()
            .map(|v| Vec3::from_array(v).normalize_or(Vec3::Y))
            .collect();
        all.resize(n, Vec3::Y);
        Ok(all)
    }

    fn tangents(
        &self,
        primitive: &gltf::Primitive<'_>,
        n: usize,
    ) -> std::result::Result<Option<Vec<Vec4>>, String> {
        let Some(accessor) = primitive.get(&Semantic::Tangents) else {
            return Ok(None);
        };
        let all = self.buffers.floats(&accessor)?;
        let mut all: Vec<Vec4> = all.into_iter().map(Vec4::from_array).collect();
        all.resize(n, Vec4::ZERO);
        for t in &mut all {
            if !t.is_finite() {
                *t = Vec4::ZERO;
            }
        }
        Ok(Some(all))
    }

    fn colors(
        &self,
        primitive: &gltf::Primitive<'_>,
        n: usize,
    ) -> std::result::Result<Vec<Vec4>, String> {
        let Some(accessor) = primitive.get(&Semantic::Colors(0)) else {
            return Ok(Vec::new());
        };
        let mut all: Vec<Vec4> = if accessor.dimensions().multiplicity() == 3 {
            let all = self.buffers.floats::<3>(&accessor)?;
            all.into_iter()
                .map(|[r, g, b]| Vec4::new(r, g, b, 1.0))
                .collect()
        } else {
            let all = self.buffers.floats(&accessor)?;
            all.into_iter().map(Vec4::from_array).collect()
        };
        for c in &mut all {
            *c = if c.is_finite() {
                c.clamp(Vec4::ZERO, Vec4::ONE)
            } else {
                Vec4::ONE
            };
        }
        all.resize(n, Vec4::ONE);
        Ok(all)
    }

    /// (u, v, 0) per vertex of one of the file's sets; zero without it.
    fn coords(
        &self,
        primitive: &gltf::Primitive<'_>,
        set: u32,
        n: usize,
    ) -> std::result::Result<Vec<Vec3>, String> {
        let mut all = match primitive.get(&Semantic::TexCoords(set)) {
            Some(accessor) => {
                let uvs = self.buffers.floats(&accessor)?;
                let finite = |uv: Vec2| if uv.is_finite() { uv } else { Vec2::ZERO };
                uvs.into_iter()
                    .map(|uv| finite(Vec2::from_array(uv)).extend(0.0))
                    .collect()
            }
            None => Vec::new(),
        };
        all.resize(n, Vec3::ZERO);
        Ok(all)
    }
}

/// Our set of texture coordinates that the material's relief uses, if it has any.
fn relief_set(made: &Made) -> Option<usize> {
    let crate::material::Material::Textured(t) = &made.material else {
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

/// Gives each triangle its own vertices and their normal: glTF's rule for meshes without normals.
fn flatten(part: &mut Mesh) {
    let corners: Vec<usize> = part
        .triangles
        .iter()
        .flatten()
        .map(|&v| v as usize)
        .collect();
    part.positions = corners.iter().map(|&v| part.positions[v]).collect();
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
}
