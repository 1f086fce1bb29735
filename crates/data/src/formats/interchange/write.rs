//! From a scene with a light basis to an interchange folder.

use super::{AreaRecord, CamerasFile, EnvRecord, ObjectFile, PointRecord, RoleRecord, Strength};
use super::{ViewRecord, image_name, is_plain};
use crate::json;
use crate::lighting::basis;
use glam::{Mat3, Vec3};
use lumi_core::image::write_exr;
use lumi_core::{Error, Light, LightBasis, NamedLight, Result, Role, Scene, View};
use serde::Serialize;
use serde_json::{Value, json};
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
    let lights: Vec<Value> = basis
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

fn record(folder: &Path, named: &NamedLight) -> Result<Value> {
    let name = named.name.clone();
    match &named.light {
        Light::Environment(light) => {
            let rotation_z = light.rotation.x_axis.y.atan2(light.rotation.x_axis.x);
            if !light
                .rotation
                .abs_diff_eq(Mat3::from_rotation_z(rotation_z), 1e-5)
            {
                let expected = "expected a map turned about z only; the layout knows no tilt";
                return Err(Error::value(format!("light `{name}`"), expected));
            }
            let file = map_name(&name);
            write_exr(folder.join(&file), &light.map.to_image())?;
            typed(
                "env",
                &EnvRecord {
                    name,
                    file,
                    rotation_z,
                    strength: Strength::Each(light.strength),
                    _lookup: Default::default(),
                },
            )
        }
        Light::Point(light) => typed(
            "point",
            &PointRecord {
                name,
                position: light.position.to_array(),
                power_watts: light.power,
                color: light.color,
                radius: light.radius,
                _distance: Default::default(),
                _radiant_intensity: Default::default(),
                _sphere_radiance: Default::default(),
            },
        ),
        Light::Area(light) => typed(
            "area",
            &AreaRecord {
                name,
                position: light.position.to_array(),
                size: light.size,
                power_watts: light.power,
                color: light.color,
                direction: Some(light.direction.to_array()),
                side_u: Some(light.side.to_array()),
                _side_v: Default::default(),
                _distance: Default::default(),
                _radiance: Default::default(),
                _light_to_world: Default::default(),
            },
        ),
    }
}

fn typed(kind: &str, record: &impl Serialize) -> Result<Value> {
    let wrong = |e: serde_json::Error| Error::value("lights", e.to_string());
    let mut value = serde_json::to_value(record).map_err(wrong)?;
    value["type"] = json!(kind);
    Ok(value)
}
