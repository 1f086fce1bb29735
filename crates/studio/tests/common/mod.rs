//! A running studio, and a client that sends exactly what a test says.
#![allow(clippy::unwrap_used, dead_code)]

use burn::tensor::Device;
use lumi_model::Relighter;
use lumi_studio::{Config, Studio};
use serde_json::{Value, json};
use std::io::{Read, Write};
use std::net::TcpStream;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::thread::JoinHandle;
use tempfile::TempDir;
use tokio::sync::oneshot;
use tungstenite::{Message, WebSocket};

/// A studio on a free port, with the bundled model and scene.
pub struct Server {
    pub port: u16,
    pub session: String,
    pub data: PathBuf,
    stop: Option<oneshot::Sender<()>>,
    thread: Option<JoinHandle<()>>,
    _folder: Option<TempDir>,
}

pub fn assets() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../assets")
}

impl Server {
    pub fn start() -> Self {
        let folder = TempDir::new().unwrap();
        let mut server = Self::start_in(folder.path().to_owned());
        server._folder = Some(folder);
        server
    }

    pub fn start_in(data: PathBuf) -> Self {
        let bundled = || Relighter::load(assets().join("lumi-mini.safetensors"), &Device::flex());
        Self::start_with(data, move || bundled().unwrap())
    }

    pub fn start_with(data: PathBuf, model: impl FnOnce() -> Relighter + Send + 'static) -> Self {
        let (tell, told) = std::sync::mpsc::channel();
        let (stop, stopped) = oneshot::channel();
        let config = Config {
            sessions: data.clone(),
            allow_hosts: vec!["studio.test".into()],
            ..Config::default()
        };
        let thread = std::thread::spawn(move || {
            let studio = Studio::new(model(), config).unwrap();
            let runtime = tokio::runtime::Runtime::new().unwrap();
            runtime.block_on(async {
                let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await.unwrap();
                let folder = assets().join("demo/spot");
                let scene = lumi_data::open(&folder).unwrap();
                let session = studio.open(scene, &folder, 4).await.unwrap();
                tell.send((listener.local_addr().unwrap().port(), session))
                    .unwrap();
                let stop = async {
                    let _ = stopped.await;
                };
                Arc::clone(&studio).serve(listener, stop).await.unwrap();
            });
        });
        let (port, session) = told.recv().unwrap();
        Self {
            port,
            session,
            data,
            stop: Some(stop),
            thread: Some(thread),
            _folder: None,
        }
    }

    /// Ends the server as Ctrl-C does.
    pub fn stop(&mut self) {
        if let Some(stop) = self.stop.take() {
            let _ = stop.send(());
        }
        if let Some(thread) = self.thread.take() {
            thread.join().unwrap();
        }
    }

    /// Sends `head` (request line and headers) and `body` as they are.
    pub fn raw(&self, head: &str, body: &[u8]) -> Reply {
        let mut stream = TcpStream::connect(("127.0.0.1", self.port)).unwrap();
        let head = format!(
            "{head}\r\nConnection: close\r\nContent-Length: {}\r\n\r\n",
            body.len()
        );
        stream.write_all(head.as_bytes()).unwrap();
        // A server that refuses early may close before it has read everything.
        let _ = stream.write_all(body);
        let mut bytes = Vec::new();
        let _ = stream.read_to_end(&mut bytes);
        Reply::parse(&bytes)
    }

    pub fn send(&self, method: &str, path: &str, mime: &str, body: &[u8]) -> Reply {
        let head = format!(
            "{method} {path} HTTP/1.1\r\nHost: 127.0.0.1:{}\r\nContent-Type: {mime}",
            self.port
        );
        self.raw(&head, body)
    }

    pub fn get(&self, path: &str) -> Reply {
        self.send("GET", path, "text/plain", b"")
    }

    pub fn json(&self, method: &str, path: &str, body: &Value) -> Reply {
        let body = body.to_string();
        self.send(method, path, "application/json", body.as_bytes())
    }

    /// `/api/sessions/SESSION/rest` of the first session.
    pub fn path(&self, rest: &str) -> String {
        format!("/api/sessions/{}/{rest}", self.session)
    }

    pub fn session(&self) -> Value {
        self.get(&format!("/api/sessions/{}", self.session)).ok()
    }

    /// Adds a step; returns its number.
    pub fn add(&self, parent: u64, edit: &Value) -> u64 {
        let body = json!({"parent": parent, "edit": edit});
        self.json("POST", &self.path("nodes"), &body).ok()["id"]
            .as_u64()
            .unwrap()
    }

    /// Uploads files by their paths.
    pub fn upload(&self, files: &[(&str, &[u8])]) -> Reply {
        let named = files.iter().map(|(path, bytes)| {
            let file = path.rsplit('/').next().unwrap_or_default();
            (*path, file, *bytes)
        });
        self.upload_parts(&named.collect::<Vec<_>>())
    }

    /// Uploads parts: the form's field, the file's name, what is in it.
    pub fn upload_parts(&self, parts: &[(&str, &str, &[u8])]) -> Reply {
        let mut body = Vec::new();
        for (field, file, bytes) in parts {
            let head = format!(
                "--xyz\r\nContent-Disposition: form-data; name=\"{field}\"; filename=\"{file}\"\r\n\r\n"
            );
            body.extend(head.as_bytes());
            body.extend(*bytes);
            body.extend(b"\r\n");
        }
        body.extend(b"--xyz--\r\n");
        self.send(
            "POST",
            "/api/uploads",
            "multipart/form-data; boundary=xyz",
            &body,
        )
    }

    pub fn socket(&self) -> Socket {
        let stream = TcpStream::connect(("127.0.0.1", self.port)).unwrap();
        let url = format!("ws://127.0.0.1:{}{}", self.port, self.path("socket"));
        let (socket, _) = tungstenite::client(url, stream).unwrap();
        Socket(socket)
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        if !std::thread::panicking() {
            self.stop();
        }
    }
}

pub struct Reply {
    pub status: u16,
    pub head: String,
    pub body: Vec<u8>,
}

impl Reply {
    fn parse(bytes: &[u8]) -> Self {
        let end = bytes.windows(4).position(|w| w == b"\r\n\r\n");
        let end = end.unwrap_or_else(|| panic!("{:?}", String::from_utf8_lossy(bytes)));
        let head = String::from_utf8(bytes[..end].to_vec()).unwrap();
        let status = head.split(' ').nth(1).unwrap().parse().unwrap();
        Self {
            status,
            head: head.to_ascii_lowercase(),
            body: bytes[end + 4..].to_vec(),
        }
    }

    pub fn text(&self) -> String {
        String::from_utf8_lossy(&self.body).into_owned()
    }

    /// The JSON of a reply that must be good.
    #[track_caller]
    pub fn ok(&self) -> Value {
        assert_eq!(self.status, 200, "{}", self.text());
        serde_json::from_slice(&self.body).unwrap()
    }

    /// A refusal with this status whose text has these words.
    #[track_caller]
    pub fn refused(&self, status: u16, words: &[&str]) {
        assert_eq!(self.status, status, "{}", self.text());
        let json: Value = serde_json::from_slice(&self.body).unwrap();
        let text = json["error"].as_str().unwrap();
        for word in words {
            assert!(text.contains(word), "expected `{word}` in: {text}");
        }
    }
}

pub struct Socket(pub WebSocket<TcpStream>);

impl Socket {
    pub fn ask(&mut self, request: &Value) {
        self.0.send(Message::text(request.to_string())).unwrap();
    }

    /// The next frame: header and pixels. Other messages are errors.
    pub fn frame(&mut self) -> (Value, Vec<u8>) {
        match self.next() {
            Ok(frame) => frame,
            Err(text) => panic!("{text}"),
        }
    }

    /// The full frame of request `id`; slow machines send a quick one before it.
    pub fn full(&mut self, id: u64) -> (Value, Vec<u8>) {
        loop {
            let (header, pixels) = self.frame();
            if header["id"] == id && header["quality"] == "full" {
                return (header, pixels);
            }
        }
    }

    /// The next frame, or the next text.
    pub fn next(&mut self) -> Result<(Value, Vec<u8>), Value> {
        loop {
            match self.0.read().unwrap() {
                Message::Binary(bytes) => {
                    let n = u32::from_le_bytes(bytes[..4].try_into().unwrap()) as usize;
                    let header = serde_json::from_slice(&bytes[4..4 + n]).unwrap();
                    return Ok((header, bytes[4 + n..].to_vec()));
                }
                Message::Text(text) => return Err(serde_json::from_str(&text).unwrap()),
                _ => {}
            }
        }
    }
}

pub fn camera(azimuth: f32) -> Value {
    json!({"azimuth": azimuth, "elevation": 0.4, "distance": 2.75, "fov": 0.87})
}

pub fn point(x: f32, power: f32) -> Value {
    json!({"kind": "point", "position": [x, -2.0, 2.5], "power": power, "color": [1.0, 0.9, 0.8]})
}

pub fn add_point(x: f32) -> Value {
    json!({"mode": "add", "lights": [point(x, 400.0)]})
}
