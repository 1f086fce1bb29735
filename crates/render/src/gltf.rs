//! glTF and GLB models: geometry, node transforms and metallic-roughness materials.
//!
//! Read as Blender's importer does: y-up becomes z-up by (x, y, z) ↦ (x, −z, y). Not read: skins and morphs (the
//! rest pose of the nodes is used), normal maps, emission, transmission and transparency (all is opaque).

use crate::material::{Material, Surface, Textured};
use crate::scene::mesh::{Mesh, Model};
use crate::texture::Image;
use lumi_core::glam::{Mat3, Mat4, Vec3};
use lumi_core::{Error, Result};
use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Textures are averaged down to at most this many pixels a side: an object spans fewer pixels than that.
const MAX_TEXTURE: u32 = 512;

/// Reads a model; its scale is the file's.
///
/// # Errors
/// Names the file and what in it could not be read, or that it has no triangles.
pub fn read(path: &Path) -> Result<Model> {
    let bytes = lumi_core::fs::read_bytes(path)?;
    let parsed =
        gltf::Gltf::from_slice(&bytes).map_err(|e| Error::invalid(path, "glTF", e.to_string()))?;
    let mut reader = Reader::new(path, parsed.document, parsed.blob)?;
    reader.materials()?;
    let scene = reader.document.default_scene();
    let scene = scene.or_else(|| reader.document.scenes().next());
    let roots: Vec<gltf::Node<'_>> = match &scene {
        Some(scene) => scene.nodes().collect(),
        None => reader.document.nodes().collect(),
    };
    let mut mesh = Mesh::default();
    for node in roots {
        reader.node(&node, Mat4::IDENTITY, &mut mesh)?;
    }
    if mesh.triangles.is_empty() {
        let expected = "expected at least one triangle, found none";
        return Err(Error::invalid(path, "meshes", expected));
    }
    for p in mesh.positions.iter_mut().chain(&mut mesh.normals) {
        *p = z_up(*p);
    }
    Ok(Model {
        mesh,
        materials: reader.made,
    })
}

/// The `.glb` and `.gltf` files of a folder, sorted by name.
///
/// # Errors
/// If the folder cannot be read.
pub fn list(folder: &Path) -> Result<Vec<PathBuf>> {
    let mut paths = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(|e| Error::io(folder, e))? {
        let path = entry.map_err(|e| Error::io(folder, e))?.path();
        if path.extension().is_some_and(|e| e == "glb" || e == "gltf") {
            paths.push(path);
        }
    }
    paths.sort();
    Ok(paths)
}

/// glTF's y-up world to ours.
fn z_up(p: Vec3) -> Vec3 {
    Vec3::new(p.x, -p.z, p.y)
}

struct Reader {
    path: PathBuf,
    document: gltf::Document,
    buffers: Vec<Vec<u8>>,
    /// Finished materials: glTF's in order, then the default one.
    made: Vec<Material>,
    images: HashMap<(usize, bool), Arc<Image>>,
}

impl Reader {
    fn new(path: &Path, document: gltf::Document, blob: Option<Vec<u8>>) -> Result<Self> {
        let mut blob = blob;
        let mut buffers = Vec::new();
        for buffer in document.buffers() {
            let field = format!("buffers[{}]", buffer.index());
            let data = match buffer.source() {
                gltf::buffer::Source::Bin => blob.take().ok_or_else(|| {
                    Error::invalid(path, &field, "expected the GLB's binary chunk, found none")
                })?,
                gltf::buffer::Source::Uri(uri) => beside(path, &field, uri)?,
            };
            if data.len() < buffer.length() {
                let expected = format!("expected {} bytes, found {}", buffer.length(), data.len());
                return Err(Error::invalid(path, field, expected));
            }
            buffers.push(data);
        }
        Ok(Self {
            path: path.to_owned(),
            document,
            buffers,
            made: Vec::new(),
            images: HashMap::new(),
        })
    }

    fn materials(&mut self) -> Result<()> {
        let document = self.document.clone();
        for material in document.materials() {
            let pbr = material.pbr_metallic_roughness();
            let [r, g, b, _] = pbr.base_color_factor();
            let mut textured = Textured {
                factor: Surface {
                    base: Vec3::new(r, g, b),
                    roughness: pbr.roughness_factor(),
                    metallic: pbr.metallic_factor(),
                },
                base: match pbr.base_color_texture() {
                    Some(info) => Some(self.image(&info.texture(), true)?),
                    None => None,
                },
                metallic_roughness: match pbr.metallic_roughness_texture() {
                    Some(info) => Some(self.image(&info.texture(), false)?),
                    None => None,
                },
            };
            if let Some(old) = material.pbr_specular_glossiness() {
                let [r, g, b, _] = old.diffuse_factor();
                let base = match old.diffuse_texture() {
                    Some(info) => Some(self.image(&info.texture(), true)?),
                    None => None,
                };
                textured = Textured {
                    factor: Surface::dielectric(Vec3::new(r, g, b), 1.0 - old.glossiness_factor()),
                    base,
                    metallic_roughness: None,
                };
            }
            let plain = textured.base.is_none() && textured.metallic_roughness.is_none();
            self.made.push(if plain {
                Material::Plain(textured.factor)
            } else {
                Material::Textured(textured)
            });
        }
        // Triangles without a material: glTF's default is a white rough metal, which Blender shows as a
        // grey dielectric; so do we.
        let grey = Surface::dielectric(Vec3::splat(0.8), 0.5);
        self.made.push(Material::Plain(grey));
        Ok(())
    }

    fn image(&mut self, texture: &gltf::Texture<'_>, color: bool) -> Result<Arc<Image>> {
        let source = texture.source();
        let key = (source.index(), color);
        if let Some(image) = self.images.get(&key) {
            return Ok(image.clone());
        }
        let field = format!("images[{}]", source.index());
        let invalid = |e: &dyn std::fmt::Display| Error::invalid(&self.path, &field, e.to_string());
        let external;
        let bytes = match source.source() {
            gltf::image::Source::View { view, .. } => self
                .buffers
                .get(view.buffer().index())
                .and_then(|b| b.get(view.offset()..view.offset() + view.length()))
                .ok_or_else(|| invalid(&"expected a view within its buffer"))?,
            gltf::image::Source::Uri { uri, .. } => {
                external = beside(&self.path, &field, uri)?;
                &external
            }
        };
        let decoded = image::load_from_memory(bytes).map_err(|e| invalid(&e))?;
        let image = Arc::new(Image::averaged(&decoded.into_rgb8(), color, MAX_TEXTURE));
        self.images.insert(key, image.clone());
        Ok(image)
    }

    fn node(&self, node: &gltf::Node<'_>, parent: Mat4, mesh: &mut Mesh) -> Result<()> {
        let transform = parent * Mat4::from_cols_array_2d(&node.transform().matrix());
        if let Some(source) = node.mesh() {
            for primitive in source.primitives() {
                let field = format!(
                    "meshes[{}].primitives[{}]",
                    source.index(),
                    primitive.index()
                );
                self.primitive(&primitive, transform, mesh)
                    .map_err(|expected| Error::invalid(&self.path, field, expected))?;
            }
        }
        for child in node.children() {
            self.node(&child, transform, mesh)?;
        }
        Ok(())
    }

    /// Appends a primitive, or says what is wrong with it.
    fn primitive(
        &self,
        primitive: &gltf::Primitive<'_>,
        transform: Mat4,
        mesh: &mut Mesh,
    ) -> std::result::Result<(), String> {
        use gltf::mesh::Mode;
        let mode = primitive.mode();
        if !matches!(
            mode,
            Mode::Triangles | Mode::TriangleStrip | Mode::TriangleFan
        ) {
            return Ok(());
        }
        let reader = primitive.reader(|b| self.buffers.get(b.index()).map(Vec::as_slice));
        let positions: Vec<Vec3> = reader
            .read_positions()
            .ok_or("expected POSITION, found none")?
            .map(|p| transform.transform_point3(p.into()))
            .collect();
        if positions.iter().any(|p| !p.is_finite()) {
            return Err("expected finite positions".to_owned());
        }
        let n = positions.len() as u32;
        let indices: Vec<u32> = reader
            .read_indices()
            .map_or_else(|| (0..n).collect(), |i| i.into_u32().collect());
        if let Some(i) = indices.iter().find(|&&i| i >= n) {
            return Err(format!("expected indices below {n}, found {i}"));
        }
        let triangles: Vec<[u32; 3]> = match mode {
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
        };
        let base = mesh.positions.len() as u32;
        let to_normal = Mat3::from_mat4(transform).inverse().transpose();
        let normals: Option<Vec<Vec3>> = reader.read_normals().map(|normals| {
            normals
                .map(|v| (to_normal * Vec3::from(v)).normalize_or(Vec3::Y))
                .collect()
        });
        let coords = self.coords(primitive, &reader, positions.len());
        let material = primitive.material().index().unwrap_or(self.made.len() - 1);
        let material = u16::try_from(material).map_err(|_| "expected under 65536 materials")?;
        match normals {
            Some(normals) if normals.len() == positions.len() => {
                mesh.positions.extend(positions);
                mesh.normals.extend(normals);
                mesh.coords.extend(coords);
                let shifted = triangles.iter().map(|t| t.map(|i| i + base));
                mesh.triangles.extend(shifted);
            }
            _ => {
                // Without normals triangles are flat.
                for (i, t) in triangles.iter().enumerate() {
                    let [a, b, c] = t.map(|v| positions[v as usize]);
                    let normal = (b - a).cross(c - a).normalize_or(Vec3::Y);
                    mesh.positions.extend([a, b, c]);
                    mesh.normals.extend([normal; 3]);
                    mesh.coords.extend(t.map(|v| coords[v as usize]));
                    let first = base + 3 * i as u32;
                    mesh.triangles.push([first, first + 1, first + 2]);
                }
            }
        }
        mesh.material.resize(mesh.triangles.len(), material);
        Ok(())
    }

    /// (u, v, 0) per vertex as the base colour's texture takes them.
    fn coords<'a, 's, F>(
        &self,
        primitive: &gltf::Primitive<'a>,
        reader: &gltf::mesh::Reader<'a, 's, F>,
        n: usize,
    ) -> Vec<Vec3>
    where
        F: Clone + Fn(gltf::Buffer<'a>) -> Option<&'s [u8]>,
    {
        let material = primitive.material();
        let pbr = material.pbr_metallic_roughness();
        let info = pbr
            .base_color_texture()
            .or_else(|| material.pbr_specular_glossiness()?.diffuse_texture())
            .or_else(|| pbr.metallic_roughness_texture());
        let transform = info
            .as_ref()
            .and_then(gltf::texture::Info::texture_transform);
        let set = transform.as_ref().and_then(|t| t.tex_coord());
        let set = set.unwrap_or_else(|| info.as_ref().map_or(0, gltf::texture::Info::tex_coord));
        let Some(uvs) = reader.read_tex_coords(set) else {
            return vec![Vec3::ZERO; n];
        };
        let place = |[u, v]: [f32; 2]| match &transform {
            Some(t) => {
                let ([su, sv], [ou, ov]) = (t.scale(), t.offset());
                let (s, c) = t.rotation().sin_cos();
                let (u, v) = (su * u, sv * v);
                Vec3::new(c * u + s * v + ou, c * v - s * u + ov, 0.0)
            }
            None => Vec3::new(u, v, 0.0),
        };
        let mut coords: Vec<Vec3> = uvs.into_f32().map(place).collect();
        coords.resize(n, Vec3::ZERO);
        coords
    }
}

/// A file that lies beside the model.
fn beside(path: &Path, field: &str, uri: &str) -> Result<Vec<u8>> {
    if uri.starts_with("data:") {
        let expected = "expected a file beside the model or a GLB, found a data URI";
        return Err(Error::invalid(path, field, expected));
    }
    let file = path.with_file_name(uri.replace("%20", " "));
    std::fs::read(&file).map_err(|e| Error::io(&file, e))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A quad in glTF's xy plane, moved up by 2, with a red texture of one pixel.
    fn quad() -> Vec<u8> {
        let mut png = std::io::Cursor::new(Vec::new());
        let red = image::RgbImage::from_pixel(1, 1, image::Rgb([255, 0, 0]));
        red.write_to(&mut png, image::ImageFormat::Png)
            .expect("png");
        let mut bin = Vec::new();
        for p in [
            [0.0_f32, 0.0, 0.0],
            [1.0, 0.0, 0.0],
            [1.0, 1.0, 0.0],
            [0.0, 1.0, 0.0],
        ] {
            bin.extend(p.iter().flat_map(|v| v.to_le_bytes()));
        }
        for uv in [[0.0_f32, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]] {
            bin.extend(uv.iter().flat_map(|v| v.to_le_bytes()));
        }
        bin.extend([0_u16, 1, 2, 0, 2, 3].iter().flat_map(|v| v.to_le_bytes()));
        let image = bin.len();
        bin.extend(png.get_ref());
        let length = png.get_ref().len();
        bin.resize(bin.len().next_multiple_of(4), 0);
        let json = format!(
            r#"{{"asset":{{"version":"2.0"}},"scene":0,"scenes":[{{"nodes":[0]}}],
            "nodes":[{{"children":[1],"translation":[0,2,0]}},{{"mesh":0}}],
            "meshes":[{{"primitives":[{{"attributes":{{"POSITION":0,"TEXCOORD_0":1}},"indices":2,"material":0}}]}}],
            "materials":[{{"pbrMetallicRoughness":{{"baseColorTexture":{{"index":0}},"metallicFactor":0,"roughnessFactor":0.4}}}}],
            "textures":[{{"source":0}}],"images":[{{"bufferView":3,"mimeType":"image/png"}}],
            "accessors":[{{"bufferView":0,"componentType":5126,"count":4,"type":"VEC3","min":[0,0,0],"max":[1,1,0]}},
            {{"bufferView":1,"componentType":5126,"count":4,"type":"VEC2"}},
            {{"bufferView":2,"componentType":5123,"count":6,"type":"SCALAR"}}],
            "bufferViews":[{{"buffer":0,"byteOffset":0,"byteLength":48}},{{"buffer":0,"byteOffset":48,"byteLength":32}},
            {{"buffer":0,"byteOffset":80,"byteLength":12}},{{"buffer":0,"byteOffset":{image},"byteLength":{length}}}],
            "buffers":[{{"byteLength":{}}}]}}"#,
            bin.len()
        );
        let mut json = json.into_bytes();
        json.resize(json.len().next_multiple_of(4), b' ');
        let mut glb = Vec::new();
        glb.extend(b"glTF");
        glb.extend(2_u32.to_le_bytes());
        glb.extend((12 + 8 + json.len() as u32 + 8 + bin.len() as u32).to_le_bytes());
        for (kind, chunk) in [(b"JSON", &json), (b"BIN\0", &bin)] {
            glb.extend((chunk.len() as u32).to_le_bytes());
            glb.extend(kind);
            glb.extend(chunk);
        }
        glb
    }

    #[test]
    fn reads_a_textured_quad_and_turns_it_z_up() {
        let folder = tempfile::tempdir().expect("folder");
        let path = folder.path().join("quad.glb");
        std::fs::write(&path, quad()).expect("written");
        let listed = list(folder.path()).expect("listed");
        assert_eq!(listed, std::slice::from_ref(&path));
        let model = read(&path).expect("read");
        assert_eq!(model.mesh.triangles.len(), 2);
        let (lo, hi) = model.mesh.bounds();
        assert!(lo.distance(Vec3::new(0.0, 0.0, 2.0)) < 1e-6, "{lo}");
        assert!(hi.distance(Vec3::new(1.0, 0.0, 3.0)) < 1e-6, "{hi}");
        // It faced glTF's +z, which is our −y.
        assert!(model.mesh.normals[0].distance(Vec3::NEG_Y) < 1e-6);
        let surface = model.materials[0].surface(Vec3::new(0.5, 0.5, 0.0));
        assert_eq!((surface.base, surface.metallic), (Vec3::X, 0.0));
        assert!((surface.roughness - 0.4).abs() < 1e-6);
    }

    #[test]
    fn broken_files_are_errors() {
        let folder = tempfile::tempdir().expect("folder");
        let path = folder.path().join("broken.glb");
        let good = quad();
        for n in (0..good.len()).step_by(37) {
            std::fs::write(&path, &good[..n]).expect("written");
            let message = read(&path).expect_err("cut").to_string();
            assert!(message.contains("broken.glb"), "{message}");
        }
    }
}
