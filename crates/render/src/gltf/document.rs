//! The JSON of a glTF file, freed of what the parser would refuse the whole file for, and the bytes it refers to.

use super::KNOWN;
use super::accessor::Buffers;
use super::source;
use gltf::Semantic;
use gltf::json::validation::Checked;
use lumi_core::glam::{DMat4, DQuat, DVec3};
use lumi_core::{Error, Result};
use serde::Deserialize;
use std::path::Path;

/// A file's JSON and its binary chunk.
pub struct Parsed {
    /// The JSON.
    pub root: gltf::json::Root,
    /// The binary chunk of a GLB.
    pub blob: Option<Vec<u8>>,
    /// Of each node, from its parent's space: in f64, since the parser keeps the millions of metres of a globe's
    /// coordinates as f32.
    pub local: Vec<DMat4>,
}

/// What of a node says where it is.
#[derive(Deserialize)]
struct Placed {
    matrix: Option<[f64; 16]>,
    translation: Option<[f64; 3]>,
    rotation: Option<[f64; 4]>,
    scale: Option<[f64; 3]>,
}

#[derive(Deserialize)]
struct Nodes {
    #[serde(default)]
    nodes: Vec<Placed>,
}

impl Placed {
    fn matrix(&self) -> DMat4 {
        if let Some(m) = &self.matrix {
            return DMat4::from_cols_array(m);
        }
        let rotation = DQuat::from_array(self.rotation.unwrap_or([0.0, 0.0, 0.0, 1.0]));
        let length = rotation.length();
        let rotation = if length > 0.0 && length.is_finite() {
            rotation.normalize()
        } else {
            DQuat::IDENTITY
        };
        DMat4::from_scale_rotation_translation(
            self.scale.map_or(DVec3::ONE, DVec3::from_array),
            rotation,
            self.translation.map_or(DVec3::ZERO, DVec3::from_array),
        )
    }
}

/// The JSON and the binary chunk of either kind of file.
pub fn parse(bytes: &[u8]) -> std::result::Result<Parsed, String> {
    if bytes.is_empty() {
        return Err("expected a model, found an empty file".to_owned());
    }
    let (json, blob) = if bytes.starts_with(b"glTF") {
        // The parser takes the header off this without a look.
        let length = bytes.get(8..12).and_then(|b| b.try_into().ok());
        let length = length.map_or(0, u32::from_le_bytes);
        if length < 20 {
            return Err(format!(
                "expected a GLB of 20 bytes or more, found {length}"
            ));
        }
        let glb = gltf::binary::Glb::from_slice(bytes).map_err(|e| e.to_string())?;
        (glb.json, glb.bin.map(|b| b.into_owned()))
    } else {
        (bytes.into(), None)
    };
    let json = json.strip_prefix(b"\xef\xbb\xbf").unwrap_or(&json);
    let root = gltf::json::Root::from_slice(json).map_err(|e| e.to_string())?;
    let nodes: Nodes = serde_json::from_slice(json).map_err(|e| e.to_string())?;
    // The parser's own checks look at these accessors before they have checked the indices.
    let primitives = root.meshes.iter().flat_map(|m| &m.primitives);
    let used = primitives.flat_map(|p| p.attributes.values());
    let n = root.accessors.len();
    if let Some(index) = used.map(|a| a.value()).find(|&a| a >= n) {
        return Err(format!(
            "expected attributes below accessors[{n}], found {index}"
        ));
    }
    Ok(Parsed {
        root,
        blob,
        local: nodes.nodes.iter().map(Placed::matrix).collect(),
    })
}

/// Leaves out what is not shown and would be an error, and says so: attributes with names that glTF has not, primitives
/// without positions, extensions. Boxes of positions, which many files lack and nothing here uses, are made up.
pub fn prune(root: &mut gltf::json::Root) -> Vec<String> {
    let mut warnings = unknown(root);
    let (mut nameless, mut placeless) = (0, 0);
    for mesh in &mut root.meshes {
        for primitive in &mut mesh.primitives {
            let before = primitive.attributes.len();
            let valid = |name: &Checked<Semantic>| matches!(name, Checked::Valid(_));
            primitive.attributes.retain(|name, _| valid(name));
            nameless += before - primitive.attributes.len();
        }
        let before = mesh.primitives.len();
        let positions = Checked::Valid(Semantic::Positions);
        mesh.primitives
            .retain(|p| p.attributes.contains_key(&positions));
        placeless += before - mesh.primitives.len();
        for index in mesh
            .primitives
            .iter()
            .filter_map(|p| p.attributes.get(&positions))
        {
            if let Some(accessor) = root.accessors.get_mut(index.value()) {
                let corner = gltf::json::serialize::to_value([0.0; 3]).ok();
                (accessor.min, accessor.max) = (corner.clone(), corner);
            }
        }
    }
    if nameless > 0 {
        warnings.push(format!(
            "{nameless} attributes have names that are neither glTF's nor begin with `_`; they are left out"
        ));
    }
    if placeless > 0 {
        warnings.push(format!(
            "{placeless} primitives have no POSITION; they are left out"
        ));
    }
    warnings
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

/// The bytes of all buffers.
pub fn buffers(
    path: &Path,
    document: &gltf::Document,
    mut blob: Option<Vec<u8>>,
) -> Result<Buffers> {
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
