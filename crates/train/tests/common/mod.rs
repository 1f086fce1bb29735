//! Objects of random pixels.
#![allow(clippy::unwrap_used)]

use lumi_core::glam::Vec3;
use lumi_core::seed::Rng;
use lumi_core::{
    Camera, EnvMap, Environment, Light, LightBasis, LinearImage, NamedLight, Point, Seed,
};
use lumi_data::store::ObjectRecord;
use rand::RngExt;
use std::path::Path;
use std::sync::Arc;

/// A few objects of random pixels, with random base colours if `albedo`: enough to train on, not to learn from.
pub fn write_objects(folder: &Path, albedo: bool) {
    std::fs::create_dir_all(folder).unwrap();
    for i in 0..4 {
        let rng = &mut Seed(i).stream("object");
        let cameras: Vec<_> = (0..5)
            .map(|k| Camera::orbit(k as f32, 0.5, 2.75, 0.87, 16))
            .collect();
        let point = Light::Point(Point::new(Vec3::new(0.0, 2.0, 3.0), 800.0));
        let map = Arc::new(EnvMap::uniform([0.5, 0.7, 1.0]));
        let environment = Light::Environment(Environment::new(map, 0.3, 1.0));
        let area = Light::Area(lumi_core::Area::facing(
            Vec3::new(3.0, 0.0, 2.0),
            Vec3::ZERO,
            1.0,
            500.0,
        ));
        let named = |name: &str, light| NamedLight {
            name: name.into(),
            light,
        };
        let image = |rng: &mut Rng| {
            let mut image = LinearImage::new(16, 16);
            for p in &mut image.pixels {
                *p = [rng.random(), rng.random(), rng.random(), 1.0];
            }
            image
        };
        let basis = LightBasis {
            lights: vec![
                named("env0", environment),
                named("point0", point),
                named("area0", area),
            ],
            radiance: (0..3)
                .map(|_| (0..5).map(|_| image(rng)).collect())
                .collect(),
        };
        let mut record = ObjectRecord::pack(&format!("object_{i}"), cameras, &basis).unwrap();
        if albedo {
            let images: Vec<_> = (0..5).map(|_| image(rng)).collect();
            record = record.with_albedo(&images).unwrap();
        }
        // Both kinds of record, side by side.
        let name = if i % 2 == 0 { "" } else { ".safetensors" };
        record
            .write(&folder.join(format!("object_{i}{name}")))
            .unwrap();
    }
}
