//! Wavefront OBJ models with their MTL materials.
//!
//! As Blender's importer: y-up becomes z-up by (x, y, z) ↦ (x, −z, y); `Pr`, `Pm`, `Pc` and `Pcr` are roughness,
//! metallicness, clear coat and its roughness; without `Pr` roughness is 1 − √(`Ns`/1000), or 0.5; the mean of `Ks` is
//! the specular level; `Kd` is linear and `map_Kd` takes its place; colours of vertices are sRGB and multiply either;
//! `map_Pr`, `map_Pm`, `norm` and `map_d` are images, with the options `-s`, `-o` and `-bm`; `map_Bump` is one of
//! normals if it is not grey. Opacity is `d`, or 1 − `Tr`. Faces may be concave. Without normals, edges up to 35° are
//! smooth. A library or image is looked for as it is named, then by the last part of its name; a library of the model's
//! own name is read even if no line names it.
//!
//! What is missing or not shown is a warning that names it: lines and points, height maps, `Ke`, refraction, materials,
//! libraries and images that are not there.

mod lines;
mod material;
mod mesh;
mod mtl;
mod parse;
mod polygon;
#[cfg(test)]
mod tests;

use crate::gltf::Z_UP;
use crate::image_file;
use crate::material::Material;
use crate::models::Import;
use crate::scene::mesh::Model;
use lines::{name, text, uncommented};
use lumi_core::glam::Affine3A;
use lumi_core::{Error, Result};
use material::{Maker, grey};
use mtl::Mtl;
use std::collections::HashMap;
use std::path::{Path, PathBuf};

/// Names in a warning, at most.
const MOST_NAMES: usize = 8;

/// Reads a model; its scale is the file's.
///
/// # Errors
/// Names the file and what in it could not be read, or that it has no triangles.
pub fn read(path: &Path) -> Result<Import> {
    let bytes = lumi_core::fs::read_bytes(path)?;
    let mut shape = parse::parse(&bytes)
        .map_err(|e| Error::invalid(path, format!("line {}", e.line), e.expected))?;
    drop(bytes);
    let mut warnings = std::mem::take(&mut shape.warnings);
    let (library, missing) = library(path, &shape.libraries, &mut warnings);

    let mut maker = Maker {
        folder: path.parent().unwrap_or(Path::new("")),
        images: HashMap::new(),
        warnings: Vec::new(),
    };
    // Only those that faces use are made.
    let (mut made, mut places, mut unknown) = (vec![grey()], Vec::new(), Vec::new());
    let by_name = by_name(&library);
    for name in &shape.names {
        // As it is written, or without comments behind either name.
        let found = by_name
            .get(&**name)
            .or_else(|| by_name.get(uncommented(name)));
        if let Some(found) = found {
            let place = u16::try_from(made.len())
                .map_err(|_| Error::invalid(path, "usemtl", "expected under 65536 materials"))?;
            made.push(maker.make(found));
            places.push((place, made[made.len() - 1].normal.is_some()));
        } else {
            unknown.push(text(name));
            places.push((0, false));
        }
    }
    places.push((0, false));
    warnings.extend(lost(&unknown, &missing));
    warnings.append(&mut maker.warnings);

    let built = mesh::build(&shape, &places, &mut warnings);
    let mut mesh = built.map_err(|(field, e)| Error::invalid(path, field, e))?;
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
        warnings,
    })
}

/// The materials of all libraries that a model names, and the libraries that are not there.
fn library(path: &Path, named: &[Vec<u8>], warnings: &mut Vec<String>) -> (Vec<Mtl>, Vec<String>) {
    let folder = path.parent().unwrap_or(Path::new(""));
    let find = |name: &[u8]| image_file::beside(&[folder], name);
    let (mut files, mut missing) = (Vec::<PathBuf>::new(), Vec::new());
    for statement in named {
        for name in libraries(statement, |n| find(n).is_some()) {
            match find(&name) {
                Some(file) if files.contains(&file) => {}
                Some(file) => files.push(file),
                None => missing.push(text(&name)),
            }
        }
    }
    let own = path.with_extension("mtl");
    if own.is_file() && !files.contains(&own) {
        files.push(own);
    }
    let mut all = Vec::new();
    for file in files {
        let name = file.file_name().unwrap_or_default().to_string_lossy();
        match std::fs::read(&file) {
            Ok(bytes) => {
                let (materials, wrong) = mtl::parse(&bytes);
                warnings.extend(wrong.into_iter().map(|w| format!("{name}: {w}")));
                let folder = file.parent().unwrap_or(Path::new(""));
                all.extend(materials.into_iter().map(|m| Mtl {
                    folder: folder.to_owned(),
                    ..m
                }));
            }
            Err(e) => missing.push(format!("{name}: {e}")),
        }
    }
    (all, missing)
}

/// Materials by their names; of several the first, and full names before those without comments.
fn by_name(library: &[Mtl]) -> HashMap<&[u8], &Mtl> {
    let full = library.iter().map(|m| (&*m.name, m));
    let cut = library.iter().map(|m| (uncommented(&m.name), m));
    let mut all = HashMap::new();
    for (name, material) in full.chain(cut) {
        all.entry(name).or_insert(material);
    }
    all
}

/// The libraries of one statement: its whole text if there is such a file, else the names that end with `.mtl`.
fn libraries(statement: &[u8], there: impl Fn(&[u8]) -> bool) -> Vec<Vec<u8>> {
    let whole = name(statement);
    if whole.is_empty() {
        return Vec::new();
    }
    if there(whole) {
        return vec![whole.to_vec()];
    }
    let mut names = vec![Vec::new()];
    for word in uncommented(statement).split(u8::is_ascii_whitespace) {
        let Some(last) = names.last_mut() else { break };
        if !last.is_empty() {
            last.push(b' ');
        }
        last.extend(word);
        if word.to_ascii_lowercase().ends_with(b".mtl") {
            names.push(Vec::new());
        }
    }
    names.retain(|n| !n.is_empty());
    names.iter().map(|n| name(n).to_vec()).collect()
}

/// One warning for the materials and libraries that are not there.
fn lost(materials: &[String], libraries: &[String]) -> Option<String> {
    let list = |names: &[String]| {
        let shown: Vec<String> = names
            .iter()
            .take(MOST_NAMES)
            .map(|n| format!("`{n}`"))
            .collect();
        let more = names.len().saturating_sub(MOST_NAMES);
        let more = if more > 0 {
            format!(" and {more} more")
        } else {
            String::new()
        };
        shown.join(", ") + &more
    };
    match (materials.is_empty(), libraries.is_empty()) {
        (true, true) => None,
        (true, false) => Some(format!("material library {} is not there", list(libraries))),
        (false, true) => Some(format!(
            "material {} is in no material library; shown grey",
            list(materials)
        )),
        (false, false) => Some(format!(
            "material library {} is not there; material {} shown grey",
            list(libraries),
            list(materials)
        )),
    }
}
