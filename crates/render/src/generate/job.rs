//! What one record shows: its objects, cameras and lights.

use super::assets::Assets;
use super::config::{GenerateConfig, Split};
use crate::draw::Draw;
use crate::environment;
use crate::objects;
use crate::scene::mesh::Model;
use lumi_core::glam::Vec3;
use lumi_core::{Area, Camera, EnvMap, Environment, Light, NamedLight, Point, Result, Seed};
use std::f32::consts::TAU;
use std::sync::Arc;

/// Everything that is needed to render a record, with any renderer.
#[derive(Clone, Debug)]
pub struct Job {
    /// The record's name.
    pub name: String,
    /// In the unit ball.
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
        Ok(Job {
            name: Self::object_name(index),
            model: self.model(seed, assets)?,
            cameras: self.cameras(seed),
            lights: self.lights(seed, &assets.maps),
            pixels: seed.child("pixels"),
        })
    }

    fn model(&self, seed: Seed, assets: &Assets) -> Result<Model> {
        let mut draw = Draw::new(seed, "scene");
        if self.scene_share > 0.0 && draw.chance(self.scene_share) {
            let [few, many] = self.scene_objects;
            let count = draw.count(few, many);
            let mut failed = None;
            let scene = objects::arrangement(&mut draw, count, |k| {
                let single = self.single(seed.child("objects").index(k as u64), assets);
                single.unwrap_or_else(|e| {
                    failed = Some(e);
                    Model::default()
                })
            });
            return failed.map_or(Ok(scene), Err);
        }
        self.single(seed, assets)
    }

    /// One object: a model's variation or a procedural one.
    fn single(&self, seed: Seed, assets: &Assets) -> Result<Model> {
        let mut draw = Draw::new(seed, "kind");
        if draw.chance(self.model_share) && !assets.models.is_empty() {
            let i = draw.count(0, assets.models.len() - 1);
            let model = assets.models.model(i)?;
            Ok(objects::varied(&model, seed.child("object")))
        } else {
            Ok(objects::procedural(seed.child("object")))
        }
    }

    /// The cameras of an object: those on the arc first.
    #[must_use]
    pub fn cameras(&self, seed: Seed) -> Vec<Camera> {
        let [narrow, wide] = self.fov_deg;
        let fov = Draw::new(seed, "fov").range(narrow, wide).to_radians();
        let [near, far] = self.framing.map_or(self.distance, |framing| {
            framing.map(|f| (f / (0.5 * fov).sin()).max(1.05))
        });
        let mut arc = Draw::new(seed, "arc");
        let mut draw = Draw::new(seed, "cameras");
        let [low, high] = self.elevation_deg.map(|e| e.to_radians().sin());
        // Uniform in the sine is uniform over the sphere.
        let elevation = |draw: &mut Draw| draw.range(low, high).clamp(-1.0, 1.0).asin();
        let (start, sweep) = (arc.range(0.0, TAU), arc.range(0.5, 2.0) * TAU / 2.0);
        let (from, to) = (elevation(&mut arc), elevation(&mut arc));
        let along = |i: usize, arc: &mut Draw| {
            let t = (i as f32 + arc.unit()) / self.arc_views as f32;
            let sway = 0.03 * (arc.unit() - 0.5);
            (start + t * sweep, from + t * (to - from) + sway)
        };
        (0..self.views)
            .map(|i| {
                let (azimuth, elevation) = if i < self.arc_views {
                    along(i, &mut arc)
                } else {
                    (draw.range(0.0, TAU), elevation(&mut draw))
                };
                let radius = draw.range(near, far);
                Camera::orbit(azimuth, elevation, radius, fov, self.resolution)
            })
            .collect()
    }

    /// The lights of an object: white, environments first.
    fn lights(&self, seed: Seed, maps: &[Arc<EnvMap>]) -> Vec<NamedLight> {
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
            let rotation = draw.range(0.0, TAU);
            add(
                "env",
                i,
                Light::Environment(Environment::new(map, rotation, 1.0)),
            );
        }
        let place = |draw: &mut Draw| {
            let mut direction = draw.direction();
            direction.z = direction.z.abs();
            let [near, far] = self.light_distance;
            let position = draw.range(near, far) * direction;
            (
                position,
                draw.range(self.light_power[0], self.light_power[1]),
            )
        };
        for i in 0..self.points {
            let (position, power) = place(&mut draw);
            add("point", i, Light::Point(Point::new(position, power)));
        }
        for i in 0..self.areas {
            let (position, power) = place(&mut draw);
            let size = draw.range(self.area_size[0], self.area_size[1]);
            add(
                "area",
                i,
                Light::Area(Area::facing(position, Vec3::ZERO, size, power)),
            );
        }
        lights
    }
}
