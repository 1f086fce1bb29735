//! Wavefront OBJ models with their MTL materials, through the `tobj` crate.
//!
//! As Blender's importer: y-up becomes z-up by (x, y, z) ↦ (x, −z, y); `Pr` and `Pm` are roughness and metallicness;
//! without them roughness is 1 − √(`Ns`/1000) and nothing is metal; `Kd` is linear; `map_Kd`, `map_Pr`, `map_Pm`,
//! `norm` and `map_d` are images, sRGB for colour. Opacity is `d`. Without normals, edges up to 35° are smooth.
//! Not shown, and warned about by name: bump maps (`map_Bump` as height), `Ke`, refraction.

use crate::gltf::Z_UP;
use crate::image_texture::{Image, Texture};
use crate::material::{Material, NormalMap, Opacity, Surface, Textured};
use crate::models::Import;
use crate::objects::primitives::CREASE;
use crate::scene::mesh::{Mesh, Model};
use crate::scene::tangents;
use lumi_core::glam::{Affine3A, Vec2, Vec3};
use lumi_core::{Error, Result};
use std::collections::HashMap;
use std::io::BufReader;
use std::path::Path;
use std::sync::Arc;

/// Vertices with more triangles than this are smooth all around: comparing all pairs would take for ever.
const CROWDED: usize = 64;

/// Reads a model; its scale is the file's.
///
/// # Errors
/// Names the file and what in it could not be read, or that it has no triangles.
pub fn read(path: &Path) -> Result<Import> {
    let bytes = lumi_core::fs::read_bytes(path)?;
    let beside = |p: &Path| {
        let file = path.with_file_name("").join(p);
        let file = std::fs::File::open(file).map_err(|_| tobj::LoadError::OpenFileFailed)?;
        tobj::load_mtl_buf(&mut BufReader::new(file))
    };
    let parsed = tobj::load_obj_buf(&mut &bytes[..], &tobj::GPU_LOAD_OPTIONS, beside);
    let (shapes, materials) = parsed.map_err(|e| Error::invalid(path, "OBJ", e.to_string()))?;
    let mut warnings = Vec::new();
    let materials = materials.unwrap_or_else(|e| {
        warnings.push(format!("material library: {e}; shown grey"));
        Vec::new()
    });
    let mut maker = Maker {
        path,
        images: HashMap::new(),
        warnings,
    };
    let mut made = Vec::new();
    for material in &materials {
        let wrong = |e| Error::invalid(path, format!("material `{}`", material.name), e);
        made.push(maker.make(material).map_err(wrong)?);
    }
    made.push(Textured::new(Surface::dielectric(Vec3::splat(0.8), 0.5)));
    let mut mesh = Mesh::default();
    for shape in &shapes {
        let material = shape.mesh.material_id.unwrap_or(made.len() - 1);
        let material = material.min(made.len() - 1);
        let part = part(&shape.mesh, material, made[material].normal.is_some());
        let wrong = |e: &str| Error::invalid(path, format!("object `{}`", shape.name), e);
        mesh.append(&part.map_err(|e| wrong(&e))?, 0);
    }
    if mesh.triangles.is_empty() {
        let expected = "expected at least one triangle, found none";
        return Err(Error::invalid(path, "faces", expected));
    }
    mesh.transform(&Affine3A::from_cols_array_2d(&Z_UP));
    let boxed = made.into_iter().map(|m| Material::Textured(Box::new(m)));
    Ok(Import {
        model: Model {
            mesh,
            materials: boxed.collect(),
        },
        warnings: maker.warnings,
    })
}

/// A shape as a mesh of one material.
fn part(source: &tobj::Mesh, material: usize, relief: bool) -> std::result::Result<Mesh, String> {
    let material = u16::try_from(material).map_err(|_| "expected under 65536 materials")?;
    let three = |v: &[f32]| -> Vec<Vec3> { v.chunks_exact(3).map(Vec3::from_slice).collect() };
    let positions = three(&source.positions);
    let n = positions.len();
    if positions.iter().any(|p| !p.is_finite()) {
        return Err("expected finite positions".to_owned());
    }
    let triangles: Vec<[u32; 3]> = source
        .indices
        .chunks_exact(3)
        .map(|t| [t[0], t[1], t[2]])
        .collect();
    if triangles.iter().flatten().any(|&v| v as usize >= n) {
        return Err(format!("expected indices below {n}"));
    }
    let coords = source.texcoords.chunks_exact(2).map(|uv| {
        let uv = Vec2::new(uv[0], 1.0 - uv[1]);
        if uv.is_finite() {
            uv.extend(0.0)
        } else {
            Vec3::ZERO
        }
    });
    let mut part = Mesh {
        coords: coords.collect(),
        normals: three(&source.normals),
        material: vec![material; triangles.len()],
        positions,
        triangles,
        ..Mesh::default()
    };
    part.coords.resize(n, Vec3::ZERO);
    if source.vertex_color.len() == 3 * n {
        let colors = three(&source.vertex_color).into_iter();
        let clamped = colors.map(|c| c.clamp(Vec3::ZERO, Vec3::ONE).extend(1.0));
        part.colors = clamped.collect();
    }
    if part.normals.len() == n {
        for v in &mut part.normals {
            *v = v.normalize_or(Vec3::Y);
        }
    } else {
        crease(&mut part);
    }
    if relief {
        part.tangents = tangents::derive(&part, 0..part.triangles.len(), |v| {
            let uv = part.coords[v];
            Vec2::new(uv.x, 1.0 - uv.y)
        });
    }
    Ok(part)
}

/// Gives each triangle its own vertices, with normals that are smooth over flat edges and not over sharp ones.
fn crease(part: &mut Mesh) {
    let faces: Vec<Vec3> = part
        .triangles
        .iter()
        .map(|t| {
            let [a, b, c] = t.map(|v| part.positions[v as usize]);
            (b - a).cross(c - a)
        })
        .collect();
    let key = |p: Vec3| p.to_array().map(|v| (v + 0.0).to_bits());
    let mut around: HashMap<[u32; 3], Vec<usize>> = HashMap::new();
    for (i, t) in part.triangles.iter().enumerate() {
        for &v in t {
            let list = around.entry(key(part.positions[v as usize])).or_default();
            list.push(i);
        }
    }
    let sums: HashMap<[u32; 3], Vec3> = around
        .iter()
        .filter(|(_, list)| list.len() > CROWDED)
        .map(|(&k, list)| (k, list.iter().map(|&f| faces[f]).sum()))
        .collect();
    let limit = CREASE.cos();
    let mut flat = Mesh {
        material: std::mem::take(&mut part.material),
        ..Mesh::default()
    };
    for (i, t) in part.triangles.iter().enumerate() {
        let own = faces[i].normalize_or_zero();
        let first = 3 * i as u32;
        for &v in t {
            let v = v as usize;
            let k = key(part.positions[v]);
            let normal = sums.get(&k).copied().unwrap_or_else(|| {
                let near = around[&k].iter().map(|&f| faces[f]);
                near.filter(|n| n.dot(own) >= limit * n.length()).sum()
            });
            flat.positions.push(part.positions[v]);
            flat.coords.push(part.coords[v]);
            flat.normals
                .push(normal.normalize_or(own.normalize_or(Vec3::Y)));
            if let Some(&color) = part.colors.get(v) {
                flat.colors.push(color);
            }
        }
        flat.triangles.push([first, first + 1, first + 2]);
    }
    *part = flat;
}

struct Maker<'a> {
    path: &'a Path,
    images: HashMap<(String, bool), Arc<Image>>,
    warnings: Vec<String>,
}

impl Maker<'_> {
    fn make(&mut self, m: &tobj::Material) -> std::result::Result<Textured, String> {
        let unknown = |name: &str| m.unknown_param.get(name);
        let number = |name: &str| {
            unknown(name)?
                .split_whitespace()
                .next()?
                .parse::<f32>()
                .ok()
        };
        let finite = |v: f32, default: f32| if v.is_finite() { v } else { default };
        let shine = m
            .shininess
            .map(|ns| (finite(ns, 0.0) / 1000.0).clamp(0.0, 1.0));
        let roughness = number("Pr").unwrap_or_else(|| shine.map_or(0.5, |s| 1.0 - s.sqrt()));
        let base = Vec3::from(m.diffuse.unwrap_or([0.8; 3]));
        let mut made = Textured::new(Surface {
            metallic: finite(number("Pm").unwrap_or(0.0), 0.0).clamp(0.0, 1.0),
            ..Surface::dielectric(base, finite(roughness, 0.5).clamp(0.0, 1.0))
        });
        if !base.is_finite() {
            return Err("expected a finite Kd".to_owned());
        }
        let mut opaque = finite(m.dissolve.unwrap_or(1.0), 1.0).clamp(0.0, 1.0);
        let mut base = m.diffuse_texture.clone();
        if let Some(mask) = &m.dissolve_texture {
            if base.is_none() || base.as_ref() == Some(mask) {
                // Opacity in the alpha of the colour image.
                base = Some(mask.clone());
                opaque = opaque.min(0.999_999);
            } else {
                self.warnings
                    .push(format!("material `{}`: map_d is left out", m.name));
            }
        }
        made.base = self.texture(base.as_deref(), true)?;
        if made.base.is_some() && m.diffuse.is_none() {
            made.factor.base = Vec3::ONE;
        }
        if opaque < 1.0 {
            made.opacity = Opacity::Blend { factor: opaque };
        }
        // Roughness is read from green and metallicness from blue; grey images have both alike.
        let (rough, metal) = (unknown("map_Pr").cloned(), unknown("map_Pm").cloned());
        if rough.is_some() && metal.is_some() && rough != metal {
            let text = format!("material `{}`: map_Pm beside map_Pr is left out", m.name);
            self.warnings.push(text);
        } else if let Some(name) = rough.as_ref().or(metal.as_ref()) {
            made.metallic_roughness = self.texture(Some(name), false)?;
            if rough.is_some() {
                made.factor.roughness = 1.0;
            }
            if metal.is_some() {
                made.factor.metallic = 1.0;
            }
        }
        if let Some(texture) = self.texture(unknown("norm").map(String::as_str), false)? {
            made.normal = Some(NormalMap {
                texture,
                scale: 1.0,
            });
        }
        if m.normal_texture.is_some() {
            self.warnings
                .push(format!("material `{}`: map_Bump is left out", m.name));
        }
        let glow = m.emissive.unwrap_or_default();
        if glow != [0.0; 3] {
            self.warnings
                .push(format!("material `{}`: its own light is left out", m.name));
        }
        Ok(made)
    }

    /// The image that a map statement ends with; options before the file's name are not applied.
    fn texture(
        &mut self,
        statement: Option<&str>,
        srgb: bool,
    ) -> std::result::Result<Option<Texture>, String> {
        let Some(statement) = statement else {
            return Ok(None);
        };
        let name = if statement.trim_start().starts_with('-') {
            self.warnings
                .push(format!("options of `{statement}` are left out"));
            statement.split_whitespace().last().unwrap_or_default()
        } else {
            statement.trim()
        };
        let key = (name.to_owned(), srgb);
        if let Some(image) = self.images.get(&key) {
            return Ok(Some(Texture::new(image.clone())));
        }
        let file = self.path.with_file_name("").join(name.replace('\\', "/"));
        let bytes = std::fs::read(&file).map_err(|e| format!("{}: {e}", file.display()))?;
        let decoded = crate::gltf::decode_image(&bytes).map_err(|e| format!("{name}: {e}"))?;
        let image = Arc::new(Image::new(&decoded, srgb));
        self.images.insert(key, image.clone());
        Ok(Some(Texture::new(image)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::material::Coords;

    const CUBE_SIDE: &str = "mtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\n\
        usemtl red\nf 1/1 2/2 3/3 4/4\n";

    #[test]
    fn reads_faces_materials_and_images() {
        let folder = tempfile::tempdir().expect("folder");
        let path = folder.path().join("a.obj");
        std::fs::write(&path, CUBE_SIDE).expect("written");
        let mtl = "newmtl red\nKd 1 0.5 0.5\nNs 250\nPm 0.25\nmap_Kd red dot.png\n";
        std::fs::write(folder.path().join("a.mtl"), mtl).expect("written");
        let dot = image::RgbaImage::from_pixel(1, 1, image::Rgba([255, 0, 0, 255]));
        dot.save(folder.path().join("red dot.png"))
            .expect("written");
        let import = read(&path).expect("read");
        assert_eq!(import.warnings, Vec::<String>::new());
        let mesh = &import.model.mesh;
        assert_eq!(mesh.triangles.len(), 2);
        assert_eq!(mesh.bounds(), (Vec3::ZERO, Vec3::new(1.0, 0.0, 1.0)));
        assert!(mesh.normals.iter().all(|n| n.distance(Vec3::NEG_Y) < 1e-6));
        let s = import.model.materials[0].surface(&Coords::solid(Vec3::splat(0.5)));
        assert_eq!((s.base, s.metallic, s.roughness), (Vec3::X, 0.25, 0.5));
    }

    #[test]
    fn sharp_edges_stay_sharp_and_flat_ones_are_smooth() {
        // A roof of 90° and a nearly flat pair share their middle edges.
        for (height, smooth) in [(1.0, false), (0.1, true)] {
            let text = format!(
                "v -1 0 0\nv -1 1 0\nv 0 0 {height}\nv 0 1 {height}\nv 1 0 0\nv 1 1 0\nf 1 3 4 2\nf 3 5 6 4\n"
            );
            let folder = tempfile::tempdir().expect("folder");
            let path = folder.path().join("roof.obj");
            std::fs::write(&path, text).expect("written");
            let mesh = read(&path).expect("read").model.mesh;
            let top: Vec<Vec3> = mesh
                .positions
                .iter()
                .zip(&mesh.normals)
                .filter(|(p, _)| p.x == 0.0)
                .map(|(_, n)| *n)
                .collect();
            let spread = top.iter().any(|n| n.dot(top[0]) < 0.9);
            assert_eq!(spread, !smooth, "{height}: {top:?}");
        }
    }

    #[test]
    fn broken_files_are_errors_that_name_the_file() {
        let folder = tempfile::tempdir().expect("folder");
        let path = folder.path().join("broken.obj");
        for text in [
            "",
            "# nothing\n",
            "v 0 0 0\nf 1 2 3\n",
            "v a b c\n",
            "v 0 0 0\nv 1 0 0\nv nan 1 0\nf 1 2 3\n",
            "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 99999999999999\n",
        ] {
            std::fs::write(&path, text).expect("written");
            let message = read(&path).expect_err(text).to_string();
            assert!(message.contains("broken.obj"), "{message}");
        }
        // A lost library is a warning: the shape is still good.
        std::fs::write(&path, CUBE_SIDE).expect("written");
        assert_eq!(read(&path).expect("read").warnings.len(), 1);
    }
}
