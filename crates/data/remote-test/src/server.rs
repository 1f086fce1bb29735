//! An S3-compatible server on a free port of this machine, and the environment that leads clients to it.

use hyper::body::Incoming;
use hyper::header::CONTENT_LENGTH;
use hyper::service::{Service, service_fn};
use hyper::{Method, Request};
use hyper_util::rt::{TokioExecutor, TokioIo};
use hyper_util::server::conn::auto::Builder;
use s3s::HttpError;
use s3s::auth::SimpleAuth;
use s3s::service::{S3Service, S3ServiceBuilder};
use std::path::{Path, PathBuf};
use std::sync::OnceLock;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use tempfile::TempDir;
use tokio::net::TcpListener;
use tokio::runtime::Runtime;

const KEY: &str = "key";
const SECRET: &str = "secret";

/// Whether the server knows another secret than the clients.
static LOCKED: AtomicBool = AtomicBool::new(false);

/// Bytes of objects that the server has sent.
static SENT: AtomicU64 = AtomicU64::new(0);

/// The folder whose folders are the server's buckets; the first call starts the server.
///
/// Only here is the environment changed, and every test calls this before anything else.
fn root() -> &'static Path {
    static SERVER: OnceLock<(TempDir, Runtime)> = OnceLock::new();
    let start = || {
        let socket = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
        let endpoint = format!("http://{}", socket.local_addr().unwrap());
        for (variable, value) in [
            ("AWS_ENDPOINT", endpoint.as_str()),
            ("AWS_ALLOW_HTTP", "true"),
            ("AWS_REGION", "us-east-1"),
            ("AWS_ACCESS_KEY_ID", KEY),
            ("AWS_SECRET_ACCESS_KEY", SECRET),
        ] {
            // SAFETY: other threads wait for this one or do not read the environment.
            unsafe { std::env::set_var(variable, value) };
        }
        let root = tempfile::tempdir().unwrap();
        let runtime = Runtime::new().unwrap();
        serve(&runtime, socket, root.path());
        (root, runtime)
    };
    SERVER.get_or_init(start).0.path()
}

/// A new bucket of this name; returns its folder.
pub fn bucket(name: &str) -> PathBuf {
    let folder = root().join(name);
    std::fs::create_dir(&folder).unwrap();
    folder
}

/// What `during` returns while the server refuses the clients' credentials.
pub fn locked<T>(during: impl FnOnce() -> T) -> T {
    LOCKED.store(true, Ordering::SeqCst);
    let result = during();
    LOCKED.store(false, Ordering::SeqCst);
    result
}

/// What `during` returns, and how many bytes of objects were fetched meanwhile.
pub fn fetched<T>(during: impl FnOnce() -> T) -> (T, u64) {
    let before = SENT.load(Ordering::SeqCst);
    let result = during();
    (result, SENT.load(Ordering::SeqCst) - before)
}

fn service(root: &Path, secret: &str) -> S3Service {
    let mut service = S3ServiceBuilder::new(s3s_fs::FileSystem::new(root).unwrap());
    service.set_auth(SimpleAuth::from_single(KEY, secret));
    service.build()
}

fn serve(runtime: &Runtime, socket: std::net::TcpListener, root: &Path) {
    let [open, locked] = [SECRET, "another"].map(|secret| service(root, secret));
    socket.set_nonblocking(true).unwrap();
    runtime.spawn(async move {
        let listener = TcpListener::from_std(socket).unwrap();
        while let Ok((socket, _)) = listener.accept().await {
            let services = [open.clone(), locked.clone()];
            let answer = move |request: Request<Incoming>| {
                let is_get = request.method() == Method::GET;
                // Asked for each request, because clients keep their connections.
                let service = &services[usize::from(LOCKED.load(Ordering::SeqCst))];
                let response = Service::call(service, request);
                async move {
                    let response = response.await?;
                    let length = response.headers().get(CONTENT_LENGTH);
                    let length = length.and_then(|l| l.to_str().ok()?.parse().ok());
                    SENT.fetch_add(length.filter(|_| is_get).unwrap_or(0), Ordering::SeqCst);
                    Ok::<_, HttpError>(response)
                }
            };
            tokio::spawn(async move {
                let server = Builder::new(TokioExecutor::new());
                let _ = server
                    .serve_connection(TokioIo::new(socket), service_fn(answer))
                    .await;
            });
        }
    });
}
