//! Records on a real S3-compatible server (`s3s`), which the test starts on a free port of this machine.
#![cfg(test)]
#![allow(clippy::unwrap_used)]

use hyper_util::rt::{TokioExecutor, TokioIo};
use hyper_util::server::conn::auto::Builder;
use lumi_core::glam::Vec3;
use lumi_core::{Camera, EnvMap, Environment, Light, LightBasis, LinearImage, NamedLight, Point};
use lumi_data::store::{self, ObjectRecord};
use s3s::auth::SimpleAuth;
use s3s::service::S3ServiceBuilder;
use std::path::Path;
use std::sync::Arc;
use tokio::net::TcpListener;
use tokio::runtime::Runtime;

const KEY: &str = "key";
const SECRET: &str = "secret";

/// Serves `root`, whose folders are the buckets, until the runtime is dropped; returns the endpoint.
fn serve(runtime: &Runtime, root: &Path) -> String {
    let files = s3s_fs::FileSystem::new(root).unwrap();
    let mut service = S3ServiceBuilder::new(files);
    service.set_auth(SimpleAuth::from_single(KEY, SECRET));
    let service = service.build();
    let listener = runtime.block_on(TcpListener::bind("127.0.0.1:0")).unwrap();
    let endpoint = format!("http://{}", listener.local_addr().unwrap());
    runtime.spawn(async move {
        while let Ok((socket, _)) = listener.accept().await {
            let service = service.clone();
            tokio::spawn(async move {
                let server = Builder::new(TokioExecutor::new());
                let _ = server.serve_connection(TokioIo::new(socket), service).await;
            });
        }
    });
    endpoint
}

fn record(name: &str, shade: f32) -> ObjectRecord {
    let cameras = (0..3).map(|i| Camera::orbit(i as f32, 0.4, 2.7, 0.87, 16)).collect();
    let image = |l: usize| LinearImage {
        width: 16,
        height: 16,
        pixels: (0..256).map(|i| [shade * l as f32, i as f32, 0.5, 1.0]).collect(),
    };
    let sky = Environment::new(Arc::new(EnvMap::uniform([0.5, 1.0, 2.0])), 0.3, 1.5);
    let lamp = Point::new(Vec3::new(0.0, 3.0, 2.0), 800.0);
    let lights = [("sky", Light::Environment(sky)), ("lamp", Light::Point(lamp))];
    let lights = lights.map(|(name, light)| NamedLight {
        name: name.to_owned(),
        light,
    });
    let basis = LightBasis {
        radiance: (0..2).map(|l| vec![image(l); 3]).collect(),
        lights: lights.into(),
    };
    ObjectRecord::pack(name, cameras, &basis).unwrap()
}

#[test]
fn records_go_to_a_bucket_and_come_back() {
    let root = tempfile::tempdir().unwrap();
    std::fs::create_dir(root.path().join("sets")).unwrap();
    let runtime = Runtime::new().unwrap();
    let endpoint = serve(&runtime, root.path());
    for (variable, value) in [
        ("AWS_ENDPOINT", endpoint.as_str()),
        ("AWS_ALLOW_HTTP", "true"),
        ("AWS_REGION", "us-east-1"),
        ("AWS_ACCESS_KEY_ID", KEY),
        ("AWS_SECRET_ACCESS_KEY", SECRET),
    ] {
        // SAFETY: this package has one test, and nothing else reads the environment yet.
        unsafe { std::env::set_var(variable, value) };
    }
    let set = Path::new("s3://sets/toys/v1");
    assert!(store::list(set).unwrap().is_empty());
    let names = ["b", "a"];
    for (i, name) in names.into_iter().enumerate() {
        assert!(!store::exists(&set.join(name)).unwrap());
        record(name, 1.0 + i as f32).write(&set.join(name)).unwrap();
    }
    let listed = store::list(set).unwrap();
    assert_eq!(listed, [set.join("a"), set.join("b")]);
    let back = ObjectRecord::read(&listed[0]).unwrap();
    let truth = record("a", 2.0);
    assert_eq!((back.radiance, back.alpha), (truth.radiance, truth.alpha));
    assert_eq!(back.lights[1].light, truth.lights[1].light);

    // The server's files are those of a local store.
    let folder = root.path().join("sets/toys/v1");
    assert_eq!(ObjectRecord::read(&folder.join("a")).unwrap().name, "a");
    // A damaged object fails its checksum on the way back.
    let shard = folder.join("b/radiance/c/0/0/0/0/0");
    let mut bytes = std::fs::read(&shard).unwrap();
    bytes[40] ^= 1;
    std::fs::write(&shard, bytes).unwrap();
    let message = ObjectRecord::read(&set.join("b")).unwrap_err().to_string();
    assert!(message.contains("radiance") && message.contains("b"), "{message}");
    // Without its group's metadata a record does not count.
    std::fs::remove_file(folder.join("b/zarr.json")).unwrap();
    assert_eq!(store::list(set).unwrap(), [set.join("a")]);
    // A server that refuses is an error, not an empty store.
    let message = store::list(Path::new("s3://nothing/here")).unwrap_err().to_string();
    assert!(message.contains("nothing"), "{message}");
}
