//! glTF and GLB models: geometry, node transforms and metallic-roughness materials.
//!
//! Read as Blender's importer does: y-up becomes z-up by (x, y, z) ↦ (x, −z, y); both sides of every surface are
//! shown, whatever `doubleSided` says; occlusion textures change nothing, since paths find occlusion themselves.
//! Tangents are those of the file or else MikkTSpace's. Skinned meshes are shown in the pose in which the nodes are;
//! their own node's transform does nothing, as the format says. Transforms are applied in f64. Not shown, and warned
//! about by name: a material's own light (it is none of the lights of a basis), morph targets and animations, lines and
//! points, primitives without positions or scaled to nothing, images that are not there, extensions other than
//! [`KNOWN`].

mod accessor;
mod document;
mod material;
mod nodes;
mod scene;
mod source;
#[cfg(test)]
mod tests;

use crate::models::Import;
use crate::scene::mesh::Model;
use lumi_core::glam::{Affine3A, Vec3};
use lumi_core::{Error, Result};
use material::{Made, Maker};
use nodes::{Nodes, Skin};
use scene::Scene;
use std::collections::HashMap;
use std::path::Path;

/// Extensions that are shown.
pub const KNOWN: [&str; 8] = [
    "EXT_texture_webp",
    "KHR_materials_clearcoat",
    "KHR_materials_ior",
    "KHR_materials_pbrSpecularGlossiness",
    "KHR_materials_specular",
    "KHR_mesh_quantization",
    "KHR_node_visibility",
    "KHR_texture_transform",
];

/// Reads a model; its scale is the file's.
///
/// # Errors
/// Names the file and what in it could not be read, or that it has no triangles.
pub fn read(path: &Path) -> Result<Import> {
    let bytes = lumi_core::fs::read_bytes(path)?;
    let invalid = |field: &str, e: String| Error::invalid(path, field, e);
    let mut parsed = document::parse(&bytes).map_err(|e| invalid("glTF", e))?;
    drop(bytes);
    let mut warnings = document::prune(&mut parsed.root);
    let document = gltf::Document::from_json(parsed.root);
    let document = document.map_err(|e| invalid("glTF", e.to_string()))?;
    let buffers = document::buffers(path, &document, parsed.blob)?;

    let mut maker = Maker {
        path,
        document: &document,
        buffers: &buffers,
        images: HashMap::new(),
        rough: HashMap::new(),
        warnings: Vec::new(),
    };
    let mut made: Vec<Made> = Vec::new();
    for source in document.materials() {
        let field = format!("materials[{}]", made.len());
        let material = maker.make(&source);
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

    let nodes = Nodes::new(path, &document, &parsed.local)?;
    let mut scene = Scene::new(&buffers, &made);
    for node in &nodes.shown {
        let Some(mesh) = node.mesh() else { continue };
        let skin = node.skin().map(|s| {
            let field = format!("skins[{}]", s.index());
            Skin::new(&buffers, &s, &nodes).map_err(|e| invalid(&field, e))
        });
        let skin = skin.transpose()?;
        for primitive in mesh.primitives() {
            let field = format!("meshes[{}].primitives[{}]", mesh.index(), primitive.index());
            scene
                .add(&primitive, nodes.world[node.index()], skin.as_ref())
                .map_err(|e| invalid(&field, e))?;
        }
    }
    let mut mesh = scene
        .finish(&mut warnings)
        .map_err(|e| invalid("meshes", e))?;
    if mesh.triangles.is_empty() {
        let expected = "expected at least one triangle, found none";
        return Err(Error::invalid(path, "meshes", expected));
    }
    warnings.extend(still(&document));
    mesh.transform(&Affine3A::from_cols_array_2d(&Z_UP));
    Ok(Import {
        model: Model {
            mesh,
            materials: made.into_iter().map(|m| m.material).collect(),
        },
        warnings,
    })
}

/// What would move, and does not.
fn still(document: &gltf::Document) -> Vec<String> {
    let mut warnings = Vec::new();
    let set = |weights: Option<&[f32]>| weights.is_some_and(|w| w.iter().any(|&w| w != 0.0));
    let meshes = document.meshes().any(|m| set(m.weights()));
    if meshes || document.nodes().any(|n| set(n.weights())) {
        warnings.push("morph targets have weights, which are left out".to_owned());
    }
    if document.animations().len() > 0 {
        warnings.push("animations are left out; nodes are shown as they stand".to_owned());
    }
    warnings
}

/// glTF's y-up world to ours: columns of (x, y, z) ↦ (x, −z, y).
pub(crate) const Z_UP: [[f32; 3]; 4] = [
    [1.0, 0.0, 0.0],
    [0.0, 0.0, 1.0],
    [0.0, -1.0, 0.0],
    [0.0, 0.0, 0.0],
];
