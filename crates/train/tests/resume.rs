//! A run that was cut off and resumed ends with the very weights of one that was not.
#![allow(clippy::unwrap_used)]

use burn::tensor::Device;
use lumi_core::glam::Vec3;
use lumi_core::seed::Rng;
use lumi_core::{
    Camera, EnvMap, Environment, Event, Light, LightBasis, LinearImage, NamedLight, Point,
    Progress, Seed,
};
use lumi_data::store::ObjectRecord;
use lumi_train::TrainConfig;
use rand::RngExt;
use std::path::Path;
use std::sync::Arc;

/// A few objects of random pixels: enough to train on, not to learn from.
fn write_objects(folder: &Path) {
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
        let record = ObjectRecord::pack(&format!("object_{i}"), cameras, &basis).unwrap();
        // Both kinds of record, side by side.
        let name = if i % 2 == 0 { "" } else { ".safetensors" };
        record
            .write(&folder.join(format!("object_{i}{name}")))
            .unwrap();
    }
}

/// Pulls the plug at a step.
struct Cut(u64);

impl Progress for Cut {
    fn event(&self, event: Event) {
        if let Event::Step { done, note } = event
            && done == self.0
            && note.contains("loss")
        {
            panic!("cut off");
        }
    }
}

fn config(folder: &Path, output: &str, optimizer: &str) -> TrainConfig {
    let text = format!(
        "model = 'nano'\ndata = '{0}/objects'\noutput = '{0}/{output}'\nbatch = 2\nbf16 = false\n\
         validate_every = 3\nholdout = 4\noptimizer = {{ kind = '{optimizer}' }}\n\
         [[stages]]\nkind = 'reconstruction'\nsteps = 5\nlearning_rate = 1e-3\nwarmup = 2\n\
         inputs = [1, 2]\ntargets = 2\n\
         [[stages]]\nkind = 'relight'\nsteps = 5\nlearning_rate = 1e-3\nwarmup = 2\n\
         inputs = [1, 2]\ntargets = 2\n",
        folder.display()
    );
    let path = folder.join("train.toml");
    std::fs::write(&path, text).unwrap();
    TrainConfig::read(&path).unwrap()
}

#[test]
fn resumed_equals_uninterrupted() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::create_dir(folder.path().join("objects")).unwrap();
    write_objects(&folder.path().join("objects"));
    let device = Device::flex();
    for optimizer in ["adamw", "muon"] {
        let whole = config(folder.path(), &format!("{optimizer}-whole"), optimizer);
        let expected =
            std::fs::read(lumi_train::train(&whole, false, &device, &()).unwrap()).unwrap();

        // Cut in the first stage after a save, then in the second, then to the end.
        let cut = config(folder.path(), &format!("{optimizer}-cut"), optimizer);
        for (resume, at) in [(false, 4), (true, 4)] {
            let run = || lumi_train::train(&cut, resume, &device, &Cut(at));
            assert!(std::panic::catch_unwind(std::panic::AssertUnwindSafe(run)).is_err());
        }
        let weights = lumi_train::train(&cut, true, &device, &()).unwrap();
        assert!(
            std::fs::read(weights).unwrap() == expected,
            "{optimizer}: weights differ"
        );

        // A finished folder is not silently overwritten.
        let again = lumi_train::train(&cut, false, &device, &())
            .unwrap_err()
            .to_string();
        assert!(again.contains("--resume"), "{again}");
    }
}
