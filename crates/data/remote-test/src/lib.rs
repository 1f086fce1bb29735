//! Records on a real S3-compatible server (`s3s`), which the tests start on a free port of this machine.
#![cfg(test)]
#![allow(clippy::unwrap_used)]

mod server;

use lumi_core::glam::Vec3;
use lumi_core::{Camera, EnvMap, Environment, Light, LightBasis, LinearImage, NamedLight, Point};
use lumi_data::store::{self, ObjectRecord, RecordReader};
use lumi_render::generate::{Backend, GenerateConfig, Summary, generate};
use std::path::Path;
use std::sync::{Arc, RwLock, RwLockReadGuard};

/// Held for reading by tests that need the server open, for writing by the one that locks it.
static OPEN: RwLock<()> = RwLock::new(());

fn open() -> RwLockReadGuard<'static, ()> {
    OPEN.read().unwrap_or_else(|e| e.into_inner())
}

/// Three views of this side under two lights.
fn record(name: &str, shade: f32, side: usize) -> ObjectRecord {
    let cameras = (0..3)
        .map(|i| Camera::orbit(i as f32, 0.4, 2.7, 0.87, side))
        .collect();
    let image = |l: usize, v: usize| LinearImage {
        width: side,
        height: side,
        pixels: (0..side * side)
            .map(|i| [shade * l as f32, (i % 256) as f32, v as f32, 1.0])
            .collect(),
    };
    let sky = Environment::new(Arc::new(EnvMap::uniform([0.5, 1.0, 2.0])), 0.3, 1.5);
    let lamp = Point::new(Vec3::new(0.0, 3.0, 2.0), 800.0);
    let lights = [
        ("sky", Light::Environment(sky)),
        ("lamp", Light::Point(lamp)),
    ];
    let lights = lights.map(|(name, light)| NamedLight {
        name: name.to_owned(),
        light,
    });
    let basis = LightBasis {
        radiance: (0..2)
            .map(|l| (0..3).map(|v| image(l, v)).collect())
            .collect(),
        lights: lights.into(),
    };
    ObjectRecord::pack(name, cameras, &basis).unwrap()
}

fn message<T>(result: lumi_core::Result<T>) -> String {
    let message = result.err().expect("an error").to_string();
    assert_eq!(message.lines().count(), 1, "{message}");
    message
}

#[test]
fn records_go_to_a_bucket_and_come_back() {
    let bucket = server::bucket("sets");
    let _open = open();
    let set = Path::new("s3://sets/toys/v1");
    assert!(store::list(set).unwrap().is_empty());
    for (i, name) in ["b", "a"].into_iter().enumerate() {
        assert!(!store::exists(&set.join(name)).unwrap());
        record(name, 1.0 + i as f32, 16)
            .write(&set.join(name))
            .unwrap();
        assert!(store::holds(set, name).unwrap());
    }
    let listed = store::list(set).unwrap();
    assert_eq!(listed, [set.join("a"), set.join("b")]);
    let back = ObjectRecord::read(&listed[0]).unwrap();
    let truth = record("a", 2.0, 16);
    assert_eq!(
        (&back.radiance, &back.alpha),
        (&truth.radiance, &truth.alpha)
    );
    let (Light::Environment(sky), Light::Environment(expected)) =
        (&back.lights[0].light, &truth.lights[0].light)
    else {
        panic!("expected the sky first");
    };
    assert_eq!(
        (&sky.map.pixels, sky.strength),
        (&expected.map.pixels, expected.strength)
    );
    assert_eq!(back.lights[1].light, truth.lights[1].light);

    // The server's files are those of a local store.
    let folder = bucket.join("toys/v1");
    let local = tempfile::tempdir().unwrap();
    truth.write(&local.path().join("a")).unwrap();
    assert_eq!(tree(&folder.join("a")), tree(&local.path().join("a")));
    // A damaged object fails its checksum on the way back.
    let shard = folder.join("b/radiance/c/0/0/0/0/0");
    let mut bytes = std::fs::read(&shard).unwrap();
    bytes[40] ^= 1;
    std::fs::write(&shard, bytes).unwrap();
    let message = message(ObjectRecord::read(&set.join("b")));
    assert!(
        message.starts_with("s3://sets/toys/v1/b: radiance: "),
        "{message}"
    );
    // Without its group's metadata a record does not count, and it can be written again.
    std::fs::remove_file(folder.join("b/zarr.json")).unwrap();
    assert_eq!(store::list(set).unwrap(), [set.join("a")]);
    record("b", 3.0, 8).write(&set.join("b")).unwrap();
    assert_eq!(ObjectRecord::read(&set.join("b")).unwrap().size(), (8, 8));
}

/// Relative paths and bytes of the files below `folder`, but for what the server keeps about objects.
fn tree(folder: &Path) -> Vec<(String, Vec<u8>)> {
    let (mut files, mut folders) = (Vec::new(), vec![folder.to_owned()]);
    while let Some(next) = folders.pop() {
        for entry in std::fs::read_dir(next).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
            } else {
                let name = path.strip_prefix(folder).unwrap().display().to_string();
                files.push((name, std::fs::read(path).unwrap()));
            }
        }
    }
    files.sort();
    files
}

#[test]
fn a_large_record_is_several_objects() {
    let bucket = server::bucket("large");
    let _open = open();
    // One light of three such views is 28 million values; a shard holds 32 million.
    let large = record("large", 1.0, 1760);
    let path = Path::new("s3://large/set/large");
    large.write(path).unwrap();
    let shards = ["0", "1"].map(|i| bucket.join(format!("set/large/radiance/c/{i}/0/0/0/0")));
    assert!(shards.iter().all(|s| s.is_file()));
    let back = ObjectRecord::read(path).unwrap();
    assert!(back.radiance == large.radiance && back.alpha == large.alpha);
    std::fs::remove_file(&shards[1]).unwrap();
    let message = message(ObjectRecord::read(path));
    assert!(
        message.ends_with("radiance: expected shard 1, found none"),
        "{message}"
    );
}

#[test]
fn pictures_are_read_alone() {
    let bucket = server::bucket("pictures");
    // Nobody else's bytes are counted.
    let _alone = OPEN.write().unwrap_or_else(|e| e.into_inner());
    let mut whole = record("whole", 1.0, 64);
    let mut state = 1_u32;
    for value in &mut whole.radiance {
        // Noise, so that nothing is small because it compresses well.
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        *value = store::to_half((state >> 8) as f32 / 4096.0);
    }
    let path = Path::new("s3://pictures/set/whole");
    whole.write(path).unwrap();
    let shard = bucket.join("set/whole/radiance/c/0/0/0/0/0");
    let size = std::fs::metadata(shard).unwrap().len();
    let reader = RecordReader::open(path).unwrap();
    for (light, view) in [(0, 0), (1, 2)] {
        let (picture, bytes) = server::fetched(|| reader.radiance(light, view).unwrap());
        assert_eq!(picture, whole.radiance_of(light, view));
        println!("{bytes} of {size} bytes for one of 6 pictures");
        assert!(
            bytes > size / 8 && bytes < size / 2,
            "{bytes} of {size} bytes"
        );
    }
    assert_eq!(reader.alpha(1).unwrap(), whole.alpha_of(1));
    assert!(matches!(
        reader.light(0).unwrap().light,
        Light::Environment(_)
    ));
}

#[test]
fn listing_goes_on_after_the_first_page() {
    let bucket = server::bucket("many");
    let _open = open();
    // Servers list a thousand keys at a time. What makes a record count is its group's metadata.
    let (count, set) = (1003, Path::new("s3://many/set"));
    for i in 0..count {
        let folder = bucket.join(format!("set/object_{i:06}"));
        std::fs::create_dir_all(&folder).unwrap();
        std::fs::write(folder.join("zarr.json"), "{}").unwrap();
    }
    let listed = store::list(set).unwrap();
    assert_eq!(listed.len(), count);
    assert_eq!(listed[count - 1], set.join("object_001002"));
}

#[test]
fn generation_into_a_bucket_resumes() {
    let bucket = server::bucket("generated");
    let _open = open();
    let config = GenerateConfig {
        objects: 2,
        resolution: 16,
        samples: 1,
        views: 2,
        ..GenerateConfig::default()
    };
    let run = |out: &Path| generate(&config, &Backend::Native, out, &()).unwrap();
    let set = Path::new("s3://generated/set");
    let summary = |rendered, skipped| Summary {
        rendered,
        skipped,
        ..Summary::default()
    };
    assert_eq!(run(set), summary(2, 0));
    // What a killed run leaves of its last object.
    std::fs::remove_file(bucket.join("set/object_000001/zarr.json")).unwrap();
    assert_eq!(run(set), summary(1, 1));
    assert_eq!(run(set), summary(0, 2));
    let local = tempfile::tempdir().unwrap();
    run(local.path());
    assert_eq!(tree(&bucket.join("set")), tree(local.path()));
}

#[test]
fn a_server_that_refuses_is_an_error() {
    let bucket = server::bucket("private");
    let set = Path::new("s3://private/set");
    let new = record("new", 1.0, 8);
    let closed = OPEN.write().unwrap_or_else(|e| e.into_inner());
    new.write(&set.join("kept")).unwrap();
    // Nothing is taken for empty, missing or written because the credentials are wrong.
    let messages = server::locked(|| {
        [
            message(store::list(set)),
            message(store::exists(&set.join("kept"))),
            message(store::holds(set, "new")),
            message(ObjectRecord::read(&set.join("kept"))),
            message(new.write(&set.join("new"))),
            message(new.write(&set.join("kept"))),
        ]
    });
    drop(closed);
    for message in &messages {
        println!("{message}");
        assert!(
            message.starts_with("s3://private/set") && message.contains("403"),
            "{message}"
        );
    }
    assert!(
        messages[0].contains("SignatureDoesNotMatch"),
        "{}",
        messages[0]
    );
    let _open = open();
    assert_eq!(store::list(set).unwrap(), [set.join("kept")]);
    assert_eq!(
        ObjectRecord::read(&set.join("kept")).unwrap().radiance,
        new.radiance
    );
    assert!(!bucket.join("set/new").exists());

    let set = Path::new("s3://nothing/here");
    for message in [
        message(store::list(set)),
        message(new.write(&set.join("new"))),
    ] {
        println!("{message}");
        assert!(message.starts_with("s3://nothing/here"), "{message}");
        assert!(message.contains("NoSuchBucket"), "{message}");
    }
}
