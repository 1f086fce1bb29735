//! What one record shows: its objects, cameras and lights.

use super::assets::Assets;
use super::config::{GenerateConfig, Split};
use crate::draw::Draw;
use crate::environment;
use crate::objects::{self, Ground, Stage};
use crate::scene::mesh::Model;
use lumi_core::glam::Vec3;
use lumi_core::{Area, Camera, EnvMap, Environment, Light, NamedLight, Point, Result, Seed};
use std::f32::consts::TAU;
use std::sync::Arc;

/// Places that are tried for a light; one straight above is left.
const LIGHT_TRIES: usize = 64;
/// Rotations that are tried for an environment in front of walls, the last of which is kept.
const ENVIRONMENT_TRIES: usize = 16;
/// Share of an environment's light that should come from before the walls.
const LEAST_OPEN: f32 = 0.2;

/// Everything that is needed to render a record, with any renderer.
#[derive(Clone, Debug)]
pub struct Job {
    /// The record's name.
    pub name: String,
    /// In the unit ball, but for a ground that fills the picture.
    pub model: Model,
    /// All of one size.
    pub cameras: Vec<Camera>,
    /// White, environments first.
    pub lights: Vec<NamedLight>,
    /// Of the paths.
    pub pixels: Seed,
}

impl GenerateConfig {
    /// Name of object `index`.
    #[must_use]
    pub fn object_name(index: usize) -> String {
        format!("object_{index:06}")
    }

    /// What record `index` shows.
    ///
    /// # Errors
    /// If it shows a model and none can be read.
    pub fn job(&self, index: usize, assets: &Assets) -> Result<Job> {
        let mut seed = Seed(self.seed).child("generate");
        if self.split == Split::HeldOut {
            seed = seed.child("held out");
        }
        let seed = seed.index(index as u64);
        let (model, stage) = self.model(seed, assets)?;
        Ok(Job {
            name: Self::object_name(index),
            model,
            cameras: self.cameras(seed, &stage),
            lights: self.lights(seed, &stage, &assets.maps),
            pixels: seed.child("pixels"),
        })
    }

    fn model(&self, seed: Seed, assets: &Assets) -> Result<(Model, Stage)> {
        let mut draw = Draw::new(seed, "scene").with_pictures(&assets.pictures);
        if self.scene_share > 0.0 && draw.chance(self.scene_share) {
            let [few, many] = self.scene_objects;
            let count = draw.count(few, many);
            let ground = if draw.chance(self.filled_share) {
                // Half without a wall, a third with one.
                let walls = draw.pick(&[0, 0, 0, 1, 1, 2]);
                Ground::Filling { walls }
            } else {
                Ground::Disc
            };
            let mut failed = None;
            let scene = objects::arrangement(&mut draw, count, ground, |k| {
                let single = self.single(seed.child("objects").index(k as u64), assets);
                single.unwrap_or_else(|e| {
                    failed = Some(e);
                    Model::default()
                })
            });
            return failed.map_or(Ok(scene), Err);
        }
        Ok((self.single(seed, assets)?, Stage::default()))
    }

    /// One object: a model's variation or a procedural one.
    fn single(&self, seed: Seed, assets: &Assets) -> Result<Model> {
        let mut draw = Draw::new(seed, "kind");
        if draw.chance(self.model_share) && !assets.models.is_empty() {
            let i = draw.count(0, assets.models.len() - 1);
            let model = assets.models.model(i)?;
            Ok(objects::varied(&model, seed.child("object")))
        } else {
            Ok(objects::procedural(seed.child("object"), &assets.pictures))
        }
    }

    /// The cameras of an object on `stage`: those on the arc first.
    #[must_use]
    pub fn cameras(&self, seed: Seed, stage: &Stage) -> Vec<Camera> {
        let [narrow, wide] = self.fov_deg;
        let fov = Draw::new(seed, "fov").range(narrow, wide).to_radians();
        let [near, far] = self.framing.map_or(self.distance, |framing| {
            framing.map(|f| (f / (0.5 * fov).sin()).max(1.05))
        });
        let mut arc = Draw::new(seed, "arc");
        let mut draw = Draw::new(seed, "cameras");
        let elevations = self.elevation_deg.map(f32::to_radians);
        let [low, high] = stage.elevations(elevations, fov).map(f32::sin);
        // Uniform in the sine is uniform over the sphere.
        let elevation = |draw: &mut Draw| draw.range(low, high).clamp(-1.0, 1.0).asin();
        let (start, sweep) = (arc.range(0.0, TAU), arc.range(0.5, 2.0) * TAU / 2.0);
        let (from, to) = (elevation(&mut arc), elevation(&mut arc));
        let along = |i: usize, arc: &mut Draw| {
            let t = (i as f32 + arc.unit()) / self.arc_views as f32;
            let sway = 0.03 * (arc.unit() - 0.5);
            // Swaying must not lift the horizon into the picture.
            let swayed = from + t * (to - from) + sway;
            let elevation = if stage.planes.is_empty() {
                swayed
            } else {
                swayed.max(low.asin())
            };
            (start + t * sweep, elevation)
        };
        (0..self.views)
            .map(|i| {
                let (azimuth, elevation) = if i < self.arc_views {
                    along(i, &mut arc)
                } else {
                    (draw.range(0.0, TAU), elevation(&mut draw))
                };
                let radius = draw.range(near, far);
                let azimuth = stage.azimuth(azimuth);
                Camera::orbit(azimuth, elevation, radius, fov, self.resolution)
            })
            .collect()
    }

    /// The lights of an object: white, environments first.
    fn lights(&self, seed: Seed, stage: &Stage, maps: &[Arc<EnvMap>]) -> Vec<NamedLight> {
        let mut draw = Draw::new(seed, "lights");
        let mut lights = Vec::new();
        let mut add = |kind: &str, i: usize, light: Light| {
            lights.push(NamedLight {
                name: format!("{kind}{i}"),
                light,
            });
        };
        for i in 0..draw.count(self.environments[0], self.environments[1]) {
            let from_file = draw.chance(self.hdri_share) && !maps.is_empty();
            let map = if from_file {
                maps[draw.count(0, maps.len() - 1)].clone()
            } else {
                Arc::new(environment::procedural(seed.child("map").index(i as u64)))
            };
            let mut environment = Environment::new(map, draw.range(0.0, TAU), 1.0);
            if stage.azimuths.is_some() {
                turn_to(&mut environment, stage, &mut draw);
            }
            add("env", i, Light::Environment(environment));
        }
        // Lights are whole on the open side of the ground and of walls: a square of side s is within 0.71 s.
        let place = |draw: &mut Draw, radius: f32| {
            let [near, far] = self.light_distance;
            let mut position = far * Vec3::Z;
            for _ in 0..LIGHT_TRIES {
                let mut direction = draw.direction();
                direction.z = direction.z.abs();
                let tried = draw.range(near, far) * direction;
                if stage.admits(tried, radius) {
                    position = tried;
                    break;
                }
            }
            (
                position,
                draw.range(self.light_power[0], self.light_power[1]),
            )
        };
        for i in 0..self.points {
            let (position, power) = place(&mut draw, 0.2);
            add("point", i, Light::Point(Point::new(position, power)));
        }
        for i in 0..draw.count(self.areas[0], self.areas[1]) {
            let size = draw.range(self.area_size[0], self.area_size[1]);
            let (position, power) = place(&mut draw, 0.71 * size);
            add(
                "area",
                i,
                Light::Area(Area::facing(position, Vec3::ZERO, size, power)),
            );
        }
        lights
    }
}

/// Turns an environment whose light comes from behind the walls of `stage`, until enough comes from before them.
fn turn_to(environment: &mut Environment, stage: &Stage, draw: &mut Draw) {
    let coarse = environment.map.at_most(16).into_owned();
    let (rows, columns) = (coarse.height, coarse.width);
    let light: Vec<(Vec3, f32)> = (0..rows * columns)
        .map(|i| {
            let (x, y) = (i % columns, i / columns);
            let (u, v) = (
                (x as f32 + 0.5) / columns as f32,
                (y as f32 + 0.5) / rows as f32,
            );
            let solid = EnvMap::solid_angle(y, rows, columns);
            let power = coarse.pixels[i].iter().sum::<f32>() * solid;
            (EnvMap::direction(u, v), power)
        })
        .collect();
    let total: f32 = light.iter().map(|l| l.1).sum();
    for _ in 0..ENVIRONMENT_TRIES {
        let reaches = |d: Vec3| stage.open_toward(environment.orientation() * d);
        let open = light.iter().filter(|l| reaches(l.0)).map(|l| l.1);
        if open.sum::<f32>() >= LEAST_OPEN * total {
            return;
        }
        *environment = Environment::new(environment.map.clone(), draw.range(0.0, TAU), 1.0);
    }
}
