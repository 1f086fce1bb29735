//! What must not work: foreign names and pages, hostile files, too much of anything. The server serves on.
#![allow(clippy::unwrap_used)]

mod common;

use common::{Server, add_point, assets, camera};
use serde_json::{Value, json};
use std::io::{Cursor, Write};
use zip::ZipWriter;
use zip::write::SimpleFileOptions;

/// Something ordinary still works.
fn serves_on(server: &Server) {
    let before = server.session()["nodes"].as_array().unwrap().len();
    server.add(0, &add_point(2.0));
    let after = server.session()["nodes"].as_array().unwrap().len();
    assert_eq!(after, before + 1);
    let mut socket = server.socket();
    socket.ask(&json!({"id": 1, "node": 0, "camera": camera(0.1)}));
    socket.frame();
}

fn zip(entries: &[(&str, &[u8])]) -> Vec<u8> {
    let mut zip = ZipWriter::new(Cursor::new(Vec::new()));
    for (name, bytes) in entries {
        zip.start_file(*name, SimpleFileOptions::default()).unwrap();
        zip.write_all(bytes).unwrap();
    }
    zip.finish().unwrap().into_inner()
}

#[test]
fn foreign_names_and_pages_are_kept_out() {
    let server = Server::start();
    let port = server.port;
    let get = |headers: &str| server.raw(&format!("GET /api/studio HTTP/1.1\r\n{headers}"), b"");
    for good in [
        format!("Host: 127.0.0.1:{port}"),
        format!("Host: localhost:{port}"),
        format!("Host: [::1]:{port}"),
        "Host: studio.test\r\nOrigin: https://studio.test".to_owned(),
        format!("Host: LOCALHOST:{port}\r\nOrigin: http://localhost:{port}"),
        format!("Host: 127.0.0.1:{port}\r\nSec-Fetch-Site: same-origin"),
    ] {
        assert_eq!(get(&good).status, 200, "{good}");
    }
    for bad in [
        "Host: evil.example".to_owned(),
        format!("Host: evil.example:{port}"),
        "Host: localhost.evil.example".to_owned(),
        "Host: 192.168.1.9".to_owned(),
        "Host: 127.0.0.1.evil.example".to_owned(),
        "Host: ".to_owned(),
        format!("Host: 127.0.0.1:{port}\r\nOrigin: http://evil.example"),
        format!("Host: 127.0.0.1:{port}\r\nOrigin: null"),
        format!(
            "Host: 127.0.0.1:{port}\r\nOrigin: http://127.0.0.1:{}",
            port ^ 1
        ),
        format!("Host: localhost:{port}\r\nOrigin: http://127.0.0.1:{port}"),
        format!("Host: 127.0.0.1:{port}\r\nSec-Fetch-Site: cross-site"),
    ] {
        get(&bad).refused(403, &["expected"]);
    }
    // A page elsewhere that opens our WebSocket: browsers send its origin, and do not stop it themselves.
    let upgrade = |origin: &str| {
        let head = format!(
            "GET {} HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n\
             Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\nOrigin: {origin}",
            server.path("socket")
        );
        server.raw(&head, b"")
    };
    upgrade("http://evil.example").refused(403, &["Origin"]);
    serves_on(&server);
}

#[test]
fn hostile_uploads_get_a_clear_message() {
    let server = Server::start();
    let spot = assets().join("demo/spot");
    let file = |name: &str| std::fs::read(spot.join(name)).unwrap();

    server.upload(&[]).refused(422, &["no files"]);
    for name in ["../a.json", "/etc/a.json", "a/../../b", "C:x"] {
        server
            .upload(&[(name, b"x")])
            .refused(422, &["expected a path"]);
    }
    server
        .upload(&[("a/x.txt", b"x")])
        .refused(422, &["expected a scene"]);
    server
        .upload(&[("s/transforms.json", b"{\"frames\": [")])
        .refused(422, &["transforms.json", "JSON"]);
    server
        .upload(&[("s/transforms.json", &b"[".repeat(100_000))])
        .refused(422, &["transforms.json", "JSON"]);
    for path in ["../../../etc/passwd", "/etc/hostname", "a/../../b.png"] {
        let json =
            json!({"camera_angle_x": 1.0, "frames": [{"file_path": path, "transform_matrix": []}]});
        server
            .upload(&[("s/transforms.json", json.to_string().as_bytes())])
            .refused(422, &["frames[0].file_path", "inside the folder"]);
    }
    // The same file twice, and a file where a folder should be.
    server
        .upload(&[("a/x", b"1"), ("a/x", b"2")])
        .refused(422, &["a/x"]);
    server
        .upload(&[("a", b"1"), ("a/x", b"2")])
        .refused(422, &["a/x"]);

    // A PNG whose header claims 60000 × 60000 pixels, and an EXR that does.
    let mut png = b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR".to_vec();
    png.extend([0, 0, 0xea, 0x60, 0, 0, 0xea, 0x60, 8, 2, 0, 0, 0]);
    png.extend([0; 64]);
    let frame = json!({"camera_angle_x": 1.0, "frames": [{"file_path": "a.png", "transform_matrix":
        [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 3], [0, 0, 0, 1]]}]});
    let frame = frame.to_string();
    let reply = server.upload(&[("s/transforms.json", frame.as_bytes()), ("s/a.png", &png)]);
    assert!([413, 422].contains(&reply.status), "{}", reply.text());
    let mut exr = file("v00_env0.exr");
    let at = exr.windows(11).position(|w| w == b"dataWindow\0").unwrap() + 11 + 6 + 4;
    exr[at + 8..at + 16].copy_from_slice(&[0xff, 0x3f, 0, 0, 0xff, 0x3f, 0, 0]);
    let reply = server.upload(&[("s/transforms.json", frame.as_bytes()), ("s/a.png", &exr)]);
    reply.refused(413, &["a.png", "pixels"]);

    // NaN in a radiance file.
    let mut files: Vec<(String, Vec<u8>)> = Vec::new();
    for entry in std::fs::read_dir(&spot).unwrap() {
        let name = entry.unwrap().file_name().into_string().unwrap();
        files.push((name.clone(), file(&name)));
    }
    let image = lumi_core::image::read_linear(spot.join("v00_env0.exr")).unwrap();
    let nan = nan_exr(image.width, image.height);
    for (name, bytes) in &mut files {
        if name == "v00_env0.exr" {
            bytes.clone_from(&nan);
        }
    }
    let sent: Vec<_> = files
        .iter()
        .map(|(n, b)| (n.as_str(), b.as_slice()))
        .collect();
    server
        .upload(&sent)
        .refused(422, &["v00_env0.exr", "pixel", "finite"]);
    serves_on(&server);
}

/// An EXR of half floats that are not numbers; our own writer refuses to make one.
fn nan_exr(width: usize, height: usize) -> Vec<u8> {
    use exr::prelude::*;
    let channels = SpecificChannels::rgba(|_: Vec2<usize>| (f32::NAN, 0.0_f32, 0.0_f32, 1.0_f32));
    let image = Image::from_channels((width, height), channels);
    let mut bytes = Cursor::new(Vec::new());
    image.write().to_buffered(&mut bytes).unwrap();
    bytes.into_inner()
}

#[test]
fn hostile_zips_get_a_clear_message() {
    let server = Server::start();
    let send = |bytes: &[u8]| server.upload(&[("scene.zip", bytes)]);
    send(b"PK\x03\x04 not really").refused(422, &["zip"]);
    for name in ["../../evil.txt", "/abs.txt", "a\\..\\b"] {
        send(&zip(&[(name, b"x")])).refused(422, &["expected a path"]);
    }
    // 1100 MiB of zeros in about a megabyte.
    let mut bomb = ZipWriter::new(Cursor::new(Vec::new()));
    let zeros = vec![0; 1 << 20];
    for i in 0..11 {
        bomb.start_file(format!("f{i}"), SimpleFileOptions::default())
            .unwrap();
        for _ in 0..100 {
            bomb.write_all(&zeros).unwrap();
        }
    }
    let bomb = bomb.finish().unwrap().into_inner();
    assert!(bomb.len() < 4 << 20);
    send(&bomb).refused(413, &["zip", "1024 MiB"]);
    // More entries than the limit.
    let names: Vec<String> = (0..4200).map(|i| format!("{i}.txt")).collect();
    let many: Vec<(&str, &[u8])> = names.iter().map(|n| (n.as_str(), &b""[..])).collect();
    send(&zip(&many)).refused(413, &["4096 files"]);
    // A link out of the folder.
    let mut link = ZipWriter::new(Cursor::new(Vec::new()));
    link.add_symlink("images", "/etc", SimpleFileOptions::default())
        .unwrap();
    let link = link.finish().unwrap().into_inner();
    send(&link).refused(422, &["no links"]);
    // A good one, in a folder of its own, works.
    let spot = assets().join("demo/spot");
    let files: Vec<(String, Vec<u8>)> = std::fs::read_dir(&spot)
        .unwrap()
        .map(|e| {
            let path = e.unwrap().path();
            let name = path.file_name().unwrap().to_str().unwrap().to_owned();
            (format!("outer/spot/{name}"), std::fs::read(path).unwrap())
        })
        .collect();
    let files: Vec<_> = files
        .iter()
        .map(|(n, b)| (n.as_str(), b.as_slice()))
        .collect();
    let good = zip(&files);
    let reply = send(&good).ok();
    assert_eq!(reply["check"]["usable"], true);
    // As `curl -F file=@spot.zip` and pages of others send it: known by what it is.
    for (field, file) in [("file", "spot.zip"), ("file", "blob"), ("capture", "")] {
        let reply = server.upload_parts(&[(field, file, &good)]).ok();
        assert_eq!(reply["check"]["usable"], true, "{field} {file}");
    }
    serves_on(&server);
}

#[test]
fn hostile_maps_and_sessions_get_a_clear_message() {
    let server = Server::start();
    let map = |bytes: &[u8]| {
        server.send(
            "POST",
            "/api/maps?name=mine",
            "application/octet-stream",
            bytes,
        )
    };
    map(b"").refused(422, &["mine", "empty"]);
    map(b"hello").refused(422, &["mine", "format"]);
    map(&nan_exr(8, 4)).refused(422, &["mine", "finite"]);
    map(b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 99999999 +X 99999999\n")
        .refused(413, &["mine", "pixels"]);
    map(&vec![0; 65 << 20]).refused(413, &[]);

    let load = |bytes: &[u8]| {
        server.send(
            "POST",
            "/api/sessions/load",
            "application/octet-stream",
            bytes,
        )
    };
    load(b"").refused(422, &["session"]);
    load(&[0xff; 64]).refused(422, &["session"]);
    server.add(0, &add_point(2.0));
    let good = server.get(&server.path("file")).body;
    load(&good[..good.len() / 2]).refused(422, &["session file"]);
    let length = u64::from_le_bytes(good[..8].try_into().unwrap()) as usize;
    let header: Value = serde_json::from_slice(&good[8..8 + length]).unwrap();
    let broken = |change: &dyn Fn(&mut Value)| {
        let mut inner: Value = serde_json::from_str(
            header["__metadata__"]["lumitokens.session"]
                .as_str()
                .unwrap(),
        )
        .unwrap();
        change(&mut inner);
        let mut header = header.clone();
        header["__metadata__"]["lumitokens.session"] = inner.to_string().into();
        let text = header.to_string();
        let mut bytes = (text.len() as u64).to_le_bytes().to_vec();
        bytes.extend(text.as_bytes());
        bytes.extend(&good[8 + length..]);
        bytes
    };
    load(&broken(&|_| {})).ok();
    for (change, status, word) in [
        (
            &(|h: &mut Value| h["model"] = "0123".into()) as &dyn Fn(&mut Value),
            409,
            "model",
        ),
        (&|h| h["format"] = "x".into(), 422, "format"),
        (&|h| h["nodes"][1]["parent"] = 9.into(), 422, "tree"),
        (&|h| h["nodes"][1]["parent"] = 1.into(), 422, "tree"),
        (&|h| h["nodes"][1]["id"] = 7.into(), 422, "tokens.7"),
        (&|h| h["camera"]["fov"] = 900.into(), 422, "fov"),
        (&|h| h["to_model"]["scale"] = 0.into(), 422, "to_model"),
        (&|h| h["inputs"][0]["camera"]["fx"] = (-1).into(), 422, "fx"),
        (&|h| h["extra"] = 1.into(), 422, "extra"),
    ] {
        load(&broken(change)).refused(status, &[word]);
    }
    serves_on(&server);
}

#[test]
fn large_bodies_and_strange_ids_are_refused() {
    let server = Server::start();
    let long = format!("{{\"parent\": 0, \"edit\": \"{}\"}}", "x".repeat(100_000));
    let reply = server.send(
        "POST",
        &server.path("nodes"),
        "application/json",
        long.as_bytes(),
    );
    assert!([413, 422].contains(&reply.status), "{}", reply.status);
    for id in [
        "..",
        "%2e%2e%2fx",
        "a",
        "0123456789abcdeg",
        "0123456789abcdef",
    ] {
        server
            .get(&format!("/api/sessions/{id}"))
            .refused(404, &["session"]);
    }
    server
        .json("POST", &server.path("nodes"), &json!({"parent": -1}))
        .refused(422, &["parent"]);
    serves_on(&server);
}
