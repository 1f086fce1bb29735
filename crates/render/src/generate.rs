//! Whole data sets: seeded objects, cameras and lights, one file per object.

use crate::draw::Draw;
use crate::environment;
use crate::film::{RenderSettings, render_basis};
use crate::integrator::PathSettings;
use crate::light::MAP_ROWS;
use crate::models;
use crate::objects;
use crate::scene::{Geometry, mesh::Model};
use lumi_core::glam::Vec3;
use lumi_core::{
    Area, Camera, EnvMap, Environment, Error, Event, Light, NamedLight, Point, Progress, Result,
    Seed,
};
use lumi_data::store::ObjectRecord;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::f32::consts::TAU;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

/// What to generate. Object `k` depends on the seed and `k` only, never on shards or threads.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct GenerateConfig {
    /// Number of objects of the whole set.
    pub objects: usize,
    /// Index of the first object.
    pub first: usize,
    /// This process's part `[i, n]`: objects whose index is `i` modulo `n`.
    pub shard: [usize; 2],
    /// Seed of everything.
    pub seed: u64,
    /// Side of the square images in pixels.
    pub resolution: usize,
    /// Paths per pixel.
    pub samples: u32,
    /// Whether to smooth indirect light.
    pub denoise: bool,
    /// Views per object.
    pub views: usize,
    /// Horizontal field of view in degrees.
    pub fov_deg: f32,
    /// Nearest and farthest camera distance from the origin; objects have radius 1.
    pub distance: [f32; 2],
    /// Lowest and highest camera elevation in degrees; uniform over that band of the sphere.
    pub elevation_deg: [f32; 2],
    /// Fewest and most environment maps per object.
    pub environments: [usize; 2],
    /// Share of environment maps that come from `hdri` rather than from formulas.
    pub hdri_share: f32,
    /// Folder of `.hdr` or `.exr` lat-long maps; none means procedural maps only.
    pub hdri: Option<PathBuf>,
    /// Folder of glTF models to mix in.
    pub models: Option<PathBuf>,
    /// Share of objects that are models of `models`, with colours and roughness varied.
    pub model_share: f32,
    /// Point lights per object.
    pub points: usize,
    /// Area lights per object.
    pub areas: usize,
    /// Nearest and farthest distance of point and area lights, on the upper hemisphere.
    pub light_distance: [f32; 2],
    /// Least and most power of point and area lights in watts.
    pub light_power: [f32; 2],
    /// Least and greatest side of area lights.
    pub area_size: [f32; 2],
}

impl Default for GenerateConfig {
    fn default() -> Self {
        Self {
            objects: 16,
            first: 0,
            shard: [0, 1],
            seed: 0,
            resolution: 64,
            samples: 16,
            denoise: true,
            views: 16,
            fov_deg: 50.0,
            distance: [2.55, 2.95],
            elevation_deg: [5.0, 75.0],
            environments: [2, 3],
            hdri_share: 0.4,
            hdri: None,
            models: None,
            model_share: 0.2,
            points: 4,
            areas: 2,
            light_distance: [3.0, 5.0],
            light_power: [500.0, 1500.0],
            area_size: [0.5, 4.0],
        }
    }
}

/// What a finished run did.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Summary {
    /// Objects rendered now.
    pub rendered: u64,
    /// Objects that were already there.
    pub skipped: u64,
}

impl GenerateConfig {
    /// Checks ranges.
    ///
    /// # Errors
    /// Names the field and what was expected.
    pub fn validate(&self) -> Result<()> {
        let range = |field: &str, [low, high]: [f32; 2], least: f32| {
            if low.is_finite() && high.is_finite() && low >= least && high >= low {
                Ok(())
            } else {
                let expected = format!("expected {least} ≤ low ≤ high, found {low} and {high}");
                Err(Error::value(field, expected))
            }
        };
        // Cameras and lights must stay outside the unit ball that the object fills.
        range("distance", self.distance, 1.05)?;
        range("light_distance", self.light_distance, 1.05)?;
        range("elevation_deg", self.elevation_deg, -90.0)?;
        range("light_power", self.light_power, 1e-3)?;
        range("area_size", self.area_size, 1e-3)?;
        let positive = [
            ("resolution", self.resolution),
            ("samples", self.samples as usize),
            ("views", self.views),
            ("lights", self.environments[0] + self.points + self.areas),
        ];
        for (field, n) in positive {
            if n == 0 {
                return Err(Error::value(field, "expected at least 1, found 0"));
            }
        }
        if self.resolution > 4096 {
            return Err(Error::value("resolution", "expected at most 4096 pixels"));
        }
        if !(self.fov_deg > 1.0 && self.fov_deg < 170.0) {
            return Err(Error::value("fov_deg", "expected 1° to 170°"));
        }
        if self.environments[0] > self.environments[1] {
            return Err(Error::value("environments", "expected fewest ≤ most"));
        }
        for (field, share) in [
            ("hdri_share", self.hdri_share),
            ("model_share", self.model_share),
        ] {
            if !(0.0..=1.0).contains(&share) {
                return Err(Error::value(field, "expected a share from 0 to 1"));
            }
        }
        let [i, n] = self.shard;
        if i >= n {
            let expected = format!("expected [i, n] with i < n, found [{i}, {n}]");
            return Err(Error::value("shard", expected));
        }
        Ok(())
    }

    /// Name of object `index`.
    #[must_use]
    pub fn object_name(index: usize) -> String {
        format!("object_{index:06}")
    }

    /// The cameras of an object.
    #[must_use]
    pub fn cameras(&self, seed: Seed) -> Vec<Camera> {
        let mut draw = Draw::new(seed, "cameras");
        let [low, high] = self.elevation_deg.map(|e| e.to_radians().sin());
        (0..self.views)
            .map(|_| {
                let azimuth = draw.range(0.0, TAU);
                // Uniform in the sine is uniform over the sphere.
                let elevation = draw.range(low, high).clamp(-1.0, 1.0).asin();
                let radius = draw.range(self.distance[0], self.distance[1]);
                let fov = self.fov_deg.to_radians();
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

    /// Object `index` rendered under all of its lights.
    ///
    /// # Errors
    /// If the result is not a valid record, which would be a bug.
    pub fn object(&self, index: usize, assets: &Assets) -> Result<ObjectRecord> {
        let seed = Seed(self.seed).child("generate").index(index as u64);
        let mut draw = Draw::new(seed, "kind");
        let geometry = Geometry::new(
            if draw.chance(self.model_share) && !assets.models.is_empty() {
                let i = draw.count(0, assets.models.len() - 1);
                objects::varied(&assets.models[i], seed.child("object"))
            } else {
                objects::procedural(seed.child("object"))
            },
        );
        let cameras = self.cameras(seed);
        let settings = RenderSettings {
            samples: self.samples,
            paths: PathSettings::default(),
            denoise: self.denoise,
        };
        let lights = self.lights(seed, &assets.maps);
        let pixels = seed.child("pixels");
        let basis = render_basis(&geometry, lights, &cameras, &settings, pixels);
        ObjectRecord::pack(&Self::object_name(index), cameras, &basis)
    }
}

/// What a set is made of besides formulas.
#[derive(Default)]
pub struct Assets {
    /// Environment maps, averaged down to what rendering uses.
    pub maps: Vec<Arc<EnvMap>>,
    /// Models as they are in their files.
    pub models: Vec<Model>,
}

impl Assets {
    /// Reads the maps and models that `config` names.
    ///
    /// # Errors
    /// If a folder or a file cannot be read, or a folder holds none.
    pub fn load(config: &GenerateConfig) -> Result<Self> {
        let mut assets = Self::default();
        if let Some(folder) = &config.hdri {
            let paths = some(folder, "hdri", environment::list(folder)?)?;
            let maps = paths.par_iter().map(|p| {
                let map = EnvMap::read(p)?;
                let map = if map.height > MAP_ROWS {
                    map.prefiltered(MAP_ROWS, 2 * MAP_ROWS)
                } else {
                    map
                };
                Ok(Arc::new(map))
            });
            assets.maps = maps.collect::<Result<_>>()?;
        }
        if let Some(folder) = &config.models {
            let paths = some(folder, "models", models::list(folder)?)?;
            assets.models = paths
                .par_iter()
                .map(|p| Ok(models::read(p)?.model))
                .collect::<Result<_>>()?;
        }
        Ok(assets)
    }
}

fn some(folder: &Path, field: &str, paths: Vec<PathBuf>) -> Result<Vec<PathBuf>> {
    if paths.is_empty() {
        let expected = "expected files of this kind in the folder, found none";
        return Err(Error::invalid(folder, field, expected));
    }
    Ok(paths)
}

/// Generates the objects of this shard into `folder`; those that are already there are left alone, so an
/// interrupted run continues where it stopped.
///
/// # Errors
/// On a wrong config, an unreadable map, or a file that cannot be written.
pub fn generate(
    config: &GenerateConfig,
    folder: &Path,
    progress: &dyn Progress,
) -> Result<Summary> {
    config.validate()?;
    std::fs::create_dir_all(folder).map_err(|e| Error::io(folder, e))?;
    let assets = Assets::load(config)?;
    let [shard, shards] = config.shard;
    let indices: Vec<usize> = (config.first..config.first + config.objects)
        .filter(|i| i % shards == shard)
        .collect();
    progress.event(Event::Begin {
        stage: "rendering objects".to_owned(),
        total: indices.len() as u64,
    });
    let (done, skipped) = (AtomicU64::new(0), AtomicU64::new(0));
    indices.par_iter().with_max_len(1).try_for_each(|&index| {
        let name = GenerateConfig::object_name(index);
        let path = folder.join(format!("{name}.safetensors"));
        if path.exists() {
            skipped.fetch_add(1, Ordering::Relaxed);
        } else {
            config.object(index, &assets)?.write(&path)?;
        }
        let done = done.fetch_add(1, Ordering::Relaxed) + 1;
        progress.event(Event::Step { done, note: name });
        Ok::<(), Error>(())
    })?;
    progress.event(Event::End);
    let skipped = skipped.into_inner();
    Ok(Summary {
        rendered: done.into_inner() - skipped,
        skipped,
    })
}
