//! From a scene with a light basis to an interchange folder.

use super::{CamerasFile, ObjectFile, RoleRecord, ViewRecord, image_name, is_plain, lights};
use crate::json;
use crate::lighting::basis;
use glam::Vec3;
use lumi_core::image::write_exr;
use lumi_core::{Error, LightBasis, NamedLight, Result, Role, Scene, View};
use serde_json::{Map, Value};
use std::collections::HashMap;
use std::path::Path;

/// Writes `scene` into `folder`, which is created if need be. Environment maps become
/// `LIGHT.map.exr` beside the images.
///
/// # Errors
/// If the scene has no light basis, holds what the layout cannot express (an environment that is
/// tilted, names that cannot be file names), or a file cannot be written.
pub fn write(folder: &Path, scene: &Scene) -> Result<()> {
    let basis = basis(scene)?;
    let names = scene.views.iter().map(|v| &v.name);
    if let Some(name) = names
        .chain(basis.lights.iter().map(|l| &l.name))
        .find(|n| !is_plain(n))
    {
        let expected = "expected letters, digits, - _ + . only";
        return Err(Error::value(format!("name `{name}`"), expected));
    }
    check_files(scene, basis)?;
    std::fs::create_dir_all(folder).map_err(|e| Error::io(folder, e))?;
    for (light, images) in basis.lights.iter().zip(&basis.radiance) {
        for (view, image) in scene.views.iter().zip(images) {
            write_exr(folder.join(image_name(&view.name, &light.name)), image)?;
        }
    }
    let ball = scene.to_model.inverse();
    let object = ObjectFile {
        name: Some(scene.name.clone()),
        bounding_sphere_center: Some(ball.point(Vec3::ZERO).to_array()),
        bounding_sphere_radius: Some(ball.scale),
    };
    json::write(&folder.join("object.json"), &object)?;
    let lights: Vec<_> = basis
        .lights
        .iter()
        .map(|l| record(folder, l))
        .collect::<Result<_>>()?;
    json::write(&folder.join("lights.json"), &lights)?;
    let cameras = CamerasFile {
        convention: Some(
            "OpenCV (x right, y down, z forward), pixel centres at +0.5, world z up".to_owned(),
        ),
        views: scene.views.iter().map(view).collect(),
    };
    json::write(&folder.join("cameras.json"), &cameras)
}

/// Every picture and map must have a file of its own, also where capitals do not count: view `a_b` under light `c` and
/// view `a` under light `b_c` have not.
fn check_files(scene: &Scene, basis: &LightBasis) -> Result<()> {
    let mut owners: HashMap<String, String> = HashMap::new();
    let pictures = basis.lights.iter().flat_map(|light| {
        let of = |view: &View| {
            let owner = format!("view `{}` under light `{}`", view.name, light.name);
            (image_name(&view.name, &light.name), owner)
        };
        scene.views.iter().map(of).collect::<Vec<_>>()
    });
    let maps = basis.lights.iter();
    let maps = maps.map(|light| {
        (
            map_name(&light.name),
            format!("the map of light `{}`", light.name),
        )
    });
    for (file, owner) in pictures.chain(maps) {
        if let Some(other) = owners.insert(file.to_lowercase(), owner.clone()) {
            let expected = format!(
                "expected names of views and lights that make different files; {other} and {owner} share {file}"
            );
            return Err(Error::value("names", expected));
        }
    }
    Ok(())
}

/// The file of an environment's map.
fn map_name(light: &str) -> String {
    format!("{light}.map.exr")
}

fn view(view: &View) -> ViewRecord {
    let camera = &view.camera;
    ViewRecord {
        name: view.name.clone(),
        role: match view.role {
            Role::Input => RoleRecord::Input,
            Role::Target => RoleRecord::Target,
        },
        width: camera.width,
        height: camera.height,
        fx: camera.fx,
        fy: camera.fy,
        cx: camera.cx,
        cy: camera.cy,
        camera_to_world: json::rows(camera.camera_to_world),
    }
}

fn record(folder: &Path, named: &NamedLight) -> Result<Map<String, Value>> {
    let file = map_name(&named.name);
    let light = named.light.clone().with_map(|_| file.clone());
    let record = lights::write(&named.name, &light)?;
    if let Some(map) = named.light.map() {
        write_exr(folder.join(file), &map.to_image())?;
    }
    Ok(record)
}
