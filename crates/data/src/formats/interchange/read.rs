//! From an interchange folder to a scene.

use super::{CamerasFile, ObjectFile, RoleRecord, image_name, is_plain, lights};
use crate::ball::{Silhouette, estimate};
use crate::formats::photo::{found, stray_mask};
use crate::formats::{Opening, folder_name};
use crate::json::{self, Document};
use lumi_core::image::{LEFT_OVER, read_linear_with_warnings};
use lumi_core::{
    Camera, EnvMap, Error, LightBasis, LinearImage, NamedLight, Result, Role, Scene, Similarity,
    View,
};
use serde_json::{Map, Value};
use std::collections::{HashMap, HashSet};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Reads and checks the whole folder.
///
/// # Errors
/// Names the file and the view, light or field that is missing or wrong.
pub fn open(folder: &Path, _: &Opening) -> Result<Scene> {
    let views = read_views(&folder.join("cameras.json"))?;
    let lights_file = folder.join("lights.json");
    let mut warnings = Vec::new();
    let lights = read_lights(&lights_file, folder, &mut warnings)?;
    let radiance = lights
        .iter()
        .map(|light| {
            views
                .iter()
                .map(|view| read_radiance(folder, view, light, &mut warnings))
                .collect()
        })
        .collect::<Result<Vec<Vec<LinearImage>>>>()?;
    let object = read_object(&folder.join("object.json"))?;
    let to_model = match object.bounding_sphere_radius {
        Some(radius) => Similarity::to_unit_ball(
            object.bounding_sphere_center.unwrap_or_default().into(),
            radius,
        ),
        None => estimated(&views, &radiance[0], &mut warnings).map_err(|e| e.at(folder))?,
    };
    for (i, named) in lights.iter().enumerate() {
        let check = named.light.transformed(&to_model).validate();
        check.map_err(|e| {
            e.within(format!("lights[{i}] `{}`", named.name))
                .at(&lights_file)
        })?;
    }
    Ok(Scene {
        name: object.name.unwrap_or_else(|| folder_name(folder)),
        views,
        to_model,
        basis: Some(LightBasis { lights, radiance }),
        lit_by: Vec::new(),
        radiance: Vec::new(),
        warnings,
    })
}

fn read_views(path: &Path) -> Result<Vec<View>> {
    let file: CamerasFile = json::read(path)?;
    if let Some(convention) = file.convention.filter(|c| !c.starts_with("OpenCV")) {
        let expected = format!("expected OpenCV cameras, found `{convention}`");
        return Err(Error::invalid(path, "convention", expected));
    }
    if file.views.is_empty() {
        return Err(Error::invalid(path, "views", "expected at least one view"));
    }
    let mut names = HashSet::new();
    let views = file.views.into_iter().enumerate().map(|(i, v)| {
        check_name(path, &format!("views[{i}].name"), &v.name, &mut names)?;
        let camera = Camera {
            width: v.width,
            height: v.height,
            fx: v.fx,
            fy: v.fy,
            cx: v.cx,
            cy: v.cy,
            camera_to_world: json::matrix(&v.camera_to_world),
        };
        let check = camera.validate();
        check.map_err(|e| e.within(format!("view `{}`", v.name)).at(path))?;
        let role = match v.role {
            RoleRecord::Input => Role::Input,
            RoleRecord::Target => Role::Target,
        };
        Ok(View {
            name: v.name,
            role,
            camera,
            image: None,
        })
    });
    views.collect()
}

fn read_object(path: &Path) -> Result<ObjectFile> {
    if !path.exists() {
        return Ok(ObjectFile::default());
    }
    let object: ObjectFile = json::read(path)?;
    if object
        .bounding_sphere_radius
        .is_some_and(|r| !(r.is_finite() && r > 0.0))
    {
        let expected = "expected a positive length";
        return Err(Error::invalid(path, "bounding_sphere_radius", expected));
    }
    Ok(object)
}

fn read_lights(path: &Path, folder: &Path, warnings: &mut Vec<String>) -> Result<Vec<NamedLight>> {
    let document = Document::read(path)?;
    let records: Vec<Map<String, Value>> = document.parse()?;
    if records.is_empty() {
        return Err(Error::invalid(
            path,
            "lights",
            "expected at least one light",
        ));
    }
    let mut names = HashSet::new();
    let mut maps = HashMap::new();
    let lights = records.into_iter().enumerate().map(|(i, mut record)| {
        let text = |key: &str| record.get(key).and_then(Value::as_str).map(str::to_owned);
        let name = text("name").unwrap_or_default();
        check_name(path, &format!("lights[{i}].name"), &name, &mut names)?;
        record.remove("name");
        let light = lights::read(record).and_then(|light| {
            light.try_with_map(|file| environment(&file, folder, &mut maps, warnings))
        });
        let light = light
            .map_err(|e| e.within(format!("lights[{i}] `{name}`")))
            .map_err(|e| e.at(path))?;
        Ok(NamedLight { name, light })
    });
    lights.collect()
}

/// An environment's map; one that several lights share is read once.
fn environment(
    name: &str,
    folder: &Path,
    maps: &mut HashMap<PathBuf, Arc<EnvMap>>,
    warnings: &mut Vec<String>,
) -> Result<Arc<EnvMap>> {
    let file = found(folder, name).unwrap_or_else(|| folder.join(name));
    let map = match maps.get(&file) {
        Some(map) => Arc::clone(map),
        None => {
            let (map, said) = EnvMap::read_with_warnings(&file)?;
            warnings.extend(said.iter().map(|text| format!("{name}: {text}")));
            Arc::new(map)
        }
    };
    maps.insert(file, Arc::clone(&map));
    Ok(map)
}

fn read_radiance(
    folder: &Path,
    view: &View,
    light: &NamedLight,
    warnings: &mut Vec<String>,
) -> Result<LinearImage> {
    let name = image_name(&view.name, &light.name);
    let path = folder.join(&name);
    let (image, said) = read_linear_with_warnings(&path)?;
    warnings.extend(said.iter().map(|text| format!("{name}: {text}")));
    let (found, camera) = ((image.width, image.height), &view.camera);
    if found == (camera.width, camera.height) {
        return not_negative(image).map_err(|e| e.at(path));
    }
    let expected = format!(
        "expected {}×{} pixels as view `{}` in cameras.json says, found {}×{}",
        camera.width, camera.height, view.name, found.0, found.1
    );
    Err(Error::invalid(path, "size", expected))
}

/// Light is not negative ([`LinearImage::clear_left_overs`]), nor is coverage beyond 0 to 1 by more than that.
fn not_negative(mut image: LinearImage) -> Result<LinearImage> {
    image.clear_left_overs()?;
    let width = image.width;
    for (i, p) in image.pixels.iter_mut().enumerate() {
        if !(-LEFT_OVER..=1.0 + LEFT_OVER).contains(&p[3]) {
            let (x, y) = (i % width, i / width);
            let expected = format!("expected alpha of 0 to 1, found {p:?}");
            return Err(Error::value(format!("pixel ({x}, {y})"), expected));
        }
        p[3] = p[3].clamp(0.0, 1.0);
    }
    Ok(image)
}

/// The ball that the silhouettes suggest, for folders that state none.
fn estimated(
    views: &[View],
    images: &[LinearImage],
    warnings: &mut Vec<String>,
) -> Result<Similarity> {
    let alphas: Vec<Vec<f32>> = images
        .iter()
        .map(|i| i.pixels.iter().map(|p| p[3]).collect())
        .collect();
    let silhouettes = views.iter().zip(&alphas).map(|(view, alpha)| Silhouette {
        camera: &view.camera,
        alpha: Some(alpha),
    });
    let ball = estimate(&silhouettes.collect::<Vec<_>>())?;
    warnings.extend(ball.stray.iter().map(|i| stray_mask(&views[*i].name)));
    Ok(Similarity::to_unit_ball(ball.centre, ball.radius))
}

/// Names become file names and keys: plain and unique.
fn check_name(path: &Path, field: &str, name: &str, known: &mut HashSet<String>) -> Result<()> {
    if !is_plain(name) {
        let expected = format!("expected a name of letters, digits, - _ + . only, found `{name}`");
        return Err(Error::invalid(path, field, expected));
    }
    if !known.insert(name.to_owned()) {
        let expected = format!("expected names that differ, found `{name}` twice");
        return Err(Error::invalid(path, field, expected));
    }
    Ok(())
}
