//! Scenes that Blender Cycles rendered, built again for our path tracer, and how far apart the two are.

use lumi_core::glam::{Affine3A, Mat3, Mat4, Vec2, Vec3};
use lumi_core::image::read_linear;
use lumi_core::{
    Area, Camera, EnvMap, Environment, Light, LinearImage, NamedLight, Point, Result, Seed,
};
use lumi_render::film::{RenderSettings, render_basis};
use lumi_render::integrator::PathSettings;
use lumi_render::material::{Material, Surface};
use lumi_render::models;
use lumi_render::objects::part::{Assembly, Part};
use lumi_render::objects::primitives::{lathe, rounded_box};
use lumi_render::scene::{Geometry, mesh::Model};
use serde_json::Value;
use std::f32::consts::{FRAC_PI_2, PI};
use std::path::Path;
use std::sync::Arc;

/// A scene with another renderer's images.
pub struct Case {
    /// For the table.
    pub name: String,
    /// Ready to trace.
    pub geometry: Geometry,
    /// The views that are compared.
    pub cameras: Vec<Camera>,
    /// The lights.
    pub lights: Vec<NamedLight>,
    /// `truth[light][view]`.
    pub truth: Vec<Vec<LinearImage>>,
    /// Parts of the picture: name, and per view which pixels belong to it.
    pub masks: Vec<(String, Vec<Vec<bool>>)>,
    /// How paths run there.
    pub paths: PathSettings,
}

/// How one part under one light compares.
pub struct Row {
    /// The light's name.
    pub light: String,
    /// The part's name.
    pub part: String,
    /// Mean radiance of ours by the other's, minus 1.
    pub mean: f64,
    /// Mean of the absolute differences by the other's mean radiance: noise, filters and denoising count.
    pub absolute: f64,
}

/// An object of `data/cycles`: every `step`-th view.
pub fn object(folder: &Path, step: usize) -> Case {
    let scene = lumi_data::open(folder).unwrap();
    let truth = scene.basis.as_ref().unwrap();
    let text = std::fs::read(folder.join("object.json")).unwrap();
    let object: Value = serde_json::from_slice(&text).unwrap();
    let file = folder.join(object["model"].as_str().unwrap());
    let mut model = models::read(&file).unwrap().model;
    // Two objects had another roughness than their files.
    if let Some(roughness) = object["roughness"].as_f64() {
        for material in &mut model.materials {
            if let Material::Textured(t) = material {
                t.factor.roughness = roughness as f32;
            }
        }
    }
    let rows: [[f32; 4]; 4] = serde_json::from_value(object["model_to_world"].clone()).unwrap();
    let to_world = Mat4::from_cols_array_2d(&rows).transpose();
    model.mesh.transform(&Affine3A::from_mat4(to_world));
    let views: Vec<usize> = (0..scene.views.len()).step_by(step).collect();
    let solid = |v: &usize| -> Vec<bool> {
        let image = &truth.radiance[0][*v];
        image.pixels.iter().map(|p| p[3] > 0.999).collect()
    };
    Case {
        name: object["name"].as_str().unwrap().to_owned(),
        geometry: Geometry::new(model),
        cameras: views.iter().map(|&v| scene.views[v].camera).collect(),
        lights: truth.lights.clone(),
        truth: truth
            .radiance
            .iter()
            .map(|images| views.iter().map(|&v| images[v].clone()).collect())
            .collect(),
        masks: vec![("object".to_owned(), views.iter().map(solid).collect())],
        paths: PathSettings {
            max_bounces: 12,
            ..PathSettings::UNBIASED
        },
    }
}

/// The scene of `data/compare`: with all bounces, or with direct light only.
pub fn spheres(folder: &Path, full: bool) -> Result<Case> {
    let text = std::fs::read(folder.join("scene.json")).unwrap();
    let scene: Value = serde_json::from_slice(&text).unwrap();
    let camera = &scene["camera"];
    let eye = vector(&camera["position"]);
    let fov = number(&camera["fov_deg"]).to_radians();
    let camera = Camera::look_at(eye, vector(&camera["look_at"]), fov, 256, 256);
    let lights: Vec<NamedLight> = scene["lights"]
        .as_array()
        .unwrap()
        .iter()
        .map(|l| light(folder, l))
        .collect();
    let suffix = if full { "full" } else { "direct" };
    let image = |l: &NamedLight| read_linear(folder.join(format!("{}_{suffix}.exr", l.name)));
    let truth: Vec<Vec<LinearImage>> = lights
        .iter()
        .map(|l| Ok(vec![image(l)?]))
        .collect::<Result<_>>()?;
    let parts = read_linear(folder.join("masks.exr"))?;
    let names = ["diffuse sphere", "metal sphere", "plastic cube"];
    let mask = |c: usize| parts.pixels.iter().map(|p| p[c] > 0.999).collect();
    let mut paths = PathSettings {
        max_bounces: if full { 12 } else { 0 },
        ..PathSettings::UNBIASED
    };
    paths.scattering = lumi_render::bsdf::Scattering::Single;
    Ok(Case {
        name: format!("spheres, {suffix}"),
        geometry: Geometry::new(room(&scene)),
        cameras: vec![camera],
        masks: (0..3)
            .map(|c| (names[c].to_owned(), vec![mask(c)]))
            .collect(),
        lights,
        truth,
        paths,
    })
}

fn number(v: &Value) -> f32 {
    v.as_f64().unwrap() as f32
}

fn vector(v: &Value) -> Vec3 {
    Vec3::from_array([0, 1, 2].map(|i| number(&v[i])))
}

fn light(folder: &Path, l: &Value) -> NamedLight {
    let name = l["name"].as_str().unwrap().to_owned();
    let light = match l["type"].as_str().unwrap() {
        "env" => {
            let map = EnvMap::read(folder.join(l["file"].as_str().unwrap())).unwrap();
            let (turn, strength) = (number(&l["rotation_z"]), number(&l["strength"]));
            Light::Environment(Environment::new(Arc::new(map), turn, strength))
        }
        "point" => {
            let mut point = Point::new(vector(&l["position"]), number(&l["power_watts"]));
            point.radius = number(&l["radius"]);
            Light::Point(point)
        }
        _ => {
            let mut area = Area::facing(
                vector(&l["position"]),
                vector(&l["look_at"]),
                number(&l["size"]),
                number(&l["power_watts"]),
            );
            area.side = Some(vector(&l["side_u"]));
            Light::Area(area)
        }
    };
    NamedLight { name, light }
}

fn room(scene: &Value) -> Model {
    let mut assembly = Assembly::default();
    for object in scene["objects"].as_array().unwrap() {
        let m = &object["material"];
        let surface = Surface {
            metallic: number(&m["metallic"]),
            specular: 2.0 * number(&m["specular"]),
            ..Surface::dielectric(vector(&m["base_color"]), number(&m["roughness"]))
        };
        let material = assembly.material(Material::Plain(surface));
        let part = match object["shape"].as_str().unwrap() {
            "plane" => {
                let h = 0.5 * number(&object["side"]);
                let corner = |x: f32, y: f32| Vec3::new(h * x, h * y, 0.0);
                let corners = vec![
                    corner(-1.0, -1.0),
                    corner(1.0, -1.0),
                    corner(-1.0, 1.0),
                    corner(1.0, 1.0),
                ];
                Part::grid(corners, 2, (false, false), 0.5)
            }
            "sphere" => {
                let profile: Vec<Vec2> = (0..=128)
                    .map(|i| {
                        let (s, c) = (PI * i as f32 / 128.0 - FRAC_PI_2).sin_cos();
                        Vec2::new(c.max(0.0), s)
                    })
                    .collect();
                lathe(&profile, 256, 1.2).scaled(Vec3::splat(number(&object["radius"])))
            }
            _ => {
                let half = Vec3::splat(0.5 * number(&object["side"]));
                let turn = number(&object["rotation_z_deg"]).to_radians();
                rounded_box(half, 0.0).turned(Mat3::from_rotation_z(turn))
            }
        };
        assembly.add(&part.at(vector(&object["centre"])), material);
    }
    assembly.finish()
}

/// Renders the case and compares every part under every light.
pub fn compare(case: &Case, samples: u32) -> (Vec<Row>, Vec<Vec<LinearImage>>) {
    let settings = RenderSettings {
        samples,
        paths: case.paths,
        denoise: false,
    };
    let basis = render_basis(
        &case.geometry,
        case.lights.clone(),
        &case.cameras,
        &settings,
        Seed(1),
    );
    let mut rows = Vec::new();
    for (part, masks) in &case.masks {
        for (l, light) in case.lights.iter().enumerate() {
            let (mut ours, mut theirs, mut apart) = (0.0, 0.0, 0.0);
            for (v, mask) in masks.iter().enumerate() {
                let pair = case.truth[l][v]
                    .pixels
                    .iter()
                    .zip(&basis.radiance[l][v].pixels);
                for ((a, b), _) in pair.zip(mask).filter(|(_, inside)| **inside) {
                    for c in 0..3 {
                        theirs += f64::from(a[c]);
                        ours += f64::from(b[c]);
                        apart += f64::from((a[c] - b[c]).abs());
                    }
                }
            }
            rows.push(Row {
                light: light.name.clone(),
                part: part.clone(),
                mean: ours / theirs - 1.0,
                absolute: apart / theirs,
            });
        }
    }
    (rows, basis.radiance)
}
