//! The interface as a client meets it: steps, frames and files.
#![allow(clippy::unwrap_used)]

mod common;

use burn::tensor::Device;
use common::{Server, add_point, assets, camera, point};
use lumi_core::{Camera, Seed};
use lumi_model::config::LightConfig;
use lumi_model::{ModelConfig, Relighter};
use lumi_studio::limits::SAVED_SESSIONS;
use serde_json::{Value, json};
use std::collections::BTreeSet;

#[test]
fn a_session_is_a_tree_of_steps() {
    let server = Server::start();
    let session = server.session();
    assert_eq!(session["nodes"].as_array().unwrap().len(), 1);
    assert_eq!(session["inputs"].as_array().unwrap().len(), 4);

    let a = server.add(0, &add_point(2.0));
    let b = server.add(a, &add_point(-2.0));
    let c = server.add(a, &json!({"mode": "set", "lights": [point(0.5, 100.0)]}));
    let parents: Vec<_> = server.session()["nodes"]
        .as_array()
        .unwrap()
        .iter()
        .map(|n| (n["id"].as_u64().unwrap(), n["parent"].as_u64()))
        .collect();
    assert_eq!(
        parents,
        [(0, None), (a, Some(0)), (b, Some(a)), (c, Some(a))]
    );

    // A change counts the version up, and makes what stands on the step anew.
    let changed = json!({"version": 0, "edit": add_point(3.0)});
    let reply = server.json("PUT", &server.path(&format!("nodes/{a}")), &changed);
    assert_eq!(reply.ok()["version"], 1);
    let versions: Vec<_> = server.session()["nodes"]
        .as_array()
        .unwrap()
        .iter()
        .map(|n| n["version"].as_u64().unwrap())
        .collect();
    assert_eq!(versions, [0, 1, 1, 1]);
    let reply = server.json("PUT", &server.path(&format!("nodes/{a}")), &changed);
    reply.refused(409, &["version 0", "found 1"]);

    // Removing takes the branch away, restoring brings all of it back.
    let before = server.session()["nodes"].clone();
    let gone = server.json("DELETE", &server.path(&format!("nodes/{a}")), &json!({}));
    assert_eq!(gone.ok()["removed"], 3);
    assert_eq!(server.session()["nodes"].as_array().unwrap().len(), 1);
    let restore = |node: u64| server.json("POST", &server.path("restore"), &json!({"node": node}));
    assert_eq!(restore(a).ok()["node"], a);
    assert_eq!(server.session()["nodes"], before);
    restore(a).refused(409, &[&format!("node {a}")]);

    // Several removals can be taken back, each by its own step.
    for node in [b, c] {
        server
            .json("DELETE", &server.path(&format!("nodes/{node}")), &json!({}))
            .ok();
    }
    assert_eq!(server.session()["removed"], 2);
    for node in [b, c] {
        restore(node).ok();
    }
    assert_eq!(server.session()["nodes"], before);
    server
        .json("DELETE", &server.path("nodes/0"), &json!({}))
        .refused(409, &["capture"]);
}

#[test]
fn a_step_has_a_name_that_costs_nothing_and_is_saved() {
    let folder = tempfile::tempdir().unwrap();
    let mut server = Server::start_in(folder.path().to_owned());
    let a = server.add(0, &add_point(2.0));
    let b = server.add(a, &add_point(-2.0));
    let path = server.path(&format!("nodes/{a}"));
    let mut edit = add_point(2.0);
    edit["name"] = json!("Key");
    let body = json!({"version": 0, "edit": edit});
    let named = server.json("PUT", &path, &body).ok();
    assert_eq!(named["edit"]["name"], "Key");
    assert_eq!(named["version"], 1);
    let nodes = server.session()["nodes"].clone();
    assert_eq!(nodes[b as usize]["version"], 0, "nothing is made anew");
    server.json("PUT", &path, &body).refused(409, &["version"]);
    for bad in ["", " ", "two\nlines", &"x".repeat(61)] {
        edit["name"] = json!(bad);
        let body = json!({"version": 1, "edit": edit});
        server.json("PUT", &path, &body).refused(422, &["name"]);
    }
    let session = server.session.clone();
    server.stop();
    let again = Server::start_in(folder.path().to_owned());
    let kept = again.get(&format!("/api/sessions/{session}")).ok();
    assert_eq!(kept["nodes"][a as usize]["edit"]["name"], "Key");
    assert!(kept["nodes"][b as usize]["edit"].get("name").is_none());
}

#[test]
fn bad_edits_are_named() {
    let server = Server::start();
    let inside =
        json!({"kind": "point", "position": [0.1, 0.0, 0.0], "power": 10.0, "color": [1, 1, 1]});
    for (edit, words) in [
        (json!({"mode": "add", "lights": []}), ["lights", "found 0"]),
        (
            json!({"mode": "remove", "lights": [point(2.0, 1e6)]}),
            ["remove", "at most the light that is there"],
        ),
        (
            json!({"mode": "add", "lights": [inside]}),
            ["point.position", "outside"],
        ),
        (
            json!({"mode": "add", "lights": [point(2.0, -1.0)]}),
            ["point.power", "positive"],
        ),
        (
            json!({"mode": "add", "lights": [{"kind": "environment", "map": "x", "rotate": 0, "strength": 1}]}),
            ["map `x`", "no such map"],
        ),
        (
            json!({"mode": "paint", "lights": []}),
            ["paint", "expected"],
        ),
        (
            json!({"mode": "add", "lights": [{"kind": "laser"}]}),
            ["laser", "expected"],
        ),
    ] {
        let body = json!({"parent": 0, "edit": edit});
        let reply = server.json("POST", &server.path("nodes"), &body);
        assert!((400..500).contains(&reply.status), "{}", reply.text());
        reply.refused(reply.status, &words);
    }
    let body = json!({"parent": 77, "edit": add_point(2.0)});
    server
        .json("POST", &server.path("nodes"), &body)
        .refused(404, &["node 77"]);
    assert_eq!(server.session()["nodes"].as_array().unwrap().len(), 1);
}

#[test]
fn frames_come_for_the_newest_request() {
    let server = Server::start();
    let a = server.add(0, &add_point(2.0));
    let mut socket = server.socket();
    socket.ask(&json!({"id": 1, "node": 0, "camera": camera(0.3)}));
    let (header, base) = socket.full(1);
    assert_eq!(header["panes"], 1);
    let side = header["width"].as_u64().unwrap() as usize;
    assert_eq!(base.len(), 4 * side * side);
    assert!(base.iter().any(|v| *v < 200), "something is seen");

    // A draft shows what the step will be, without making it.
    let draft = json!([add_point(2.0)]);
    socket.ask(&json!({"id": 2, "node": 0, "draft": draft, "camera": camera(0.3)}));
    let (header, drafted) = socket.full(2);
    assert!(header["edit_ms"].as_f64().unwrap() > 0.0);
    assert_ne!(drafted, base);
    socket.ask(&json!({"id": 3, "node": 0, "draft": draft, "camera": camera(0.3)}));
    assert_eq!(socket.full(3).0["edit_ms"], 0.0, "the draft is remembered");
    socket.ask(&json!({"id": 4, "node": a, "compare": 0, "camera": camera(0.3)}));
    let (header, both) = socket.full(4);
    assert_eq!(header["panes"], 2);
    assert_eq!(both, [drafted, base].concat());

    // Of a burst, the last is answered; not every one of the others is.
    for id in 10..200 {
        let camera = camera(0.01 * id as f32);
        socket.ask(&json!({"id": id, "node": 0, "camera": camera, "moving": true}));
    }
    let mut answered = 0;
    loop {
        answered += 1;
        if socket.frame().0["id"] == 199 {
            break;
        }
    }
    assert!(answered < 190, "{answered} frames for 190 requests");
}

#[test]
fn sockets_answer_mistakes_and_tell_of_changes() {
    let server = Server::start();
    let mut socket = server.socket();
    for (request, word) in [
        (json!({"id": 1}), "missing field"),
        (json!({"id": 1, "node": 9, "camera": camera(0.0)}), "node 9"),
        (
            json!({"id": 1, "node": 0, "camera": {"azimuth": 0, "elevation": 0, "distance": 1e9, "fov": 1}}),
            "camera.distance",
        ),
        (
            json!({"id": 1, "node": 0, "camera": camera(0.0), "colour": 1}),
            "colour",
        ),
    ] {
        socket.ask(&request);
        let error = socket.next().unwrap_err();
        assert_eq!(error["type"], "error");
        assert!(error["error"].as_str().unwrap().contains(word), "{error}");
    }
    server.add(0, &add_point(2.0));
    let changed = socket.next().unwrap_err();
    assert_eq!(changed, json!({"type": "changed", "revision": 1}));
}

#[test]
fn sessions_survive_a_restart() {
    let folder = tempfile::tempdir().unwrap();
    let mut server = Server::start_in(folder.path().to_owned());
    let maps = server.get("/api/maps").ok();
    let map = maps["maps"][0]["id"].as_str().unwrap().to_owned();
    let environment = json!({"kind": "environment", "map": map, "rotate": 40.0, "strength": 0.7});
    let a = server.add(0, &json!({"mode": "set", "lights": [environment]}));
    let b = server.add(a, &add_point(2.0));
    let camera = "azimuth=0.4&elevation=0.4&distance=2.75&fov=0.87";
    let picture = |server: &Server, id: &str| {
        let path = format!("/api/sessions/{id}/nodes/{b}/picture/png?{camera}");
        server.get(&path).body
    };
    let (id, before) = (server.session.clone(), server.session());
    let shown = picture(&server, &id);
    server.stop();

    let again = Server::start_in(folder.path().to_owned());
    let listed = again.get("/api/sessions").ok();
    let row = listed["sessions"].as_array().unwrap().iter();
    let row = row.into_iter().find(|r| r["id"] == *id).unwrap().clone();
    assert_eq!((&row["steps"], &row["usable"]), (&json!(3), &json!(true)));
    let after = again.get(&format!("/api/sessions/{id}")).ok();
    for field in ["name", "source", "to_model", "camera", "inputs", "nodes"] {
        assert_eq!(after[field], before[field], "{field}");
    }
    assert_eq!(picture(&again, &id), shown, "the same tokens");
    // Versions count from 0 again, so pictures are told apart by this.
    assert_ne!(after["opened"], before["opened"]);
    let same = again.get(&format!("/api/sessions/{id}")).ok();
    assert_eq!(same["opened"], after["opened"]);

    // The file opens as a session of its own, also elsewhere.
    let file = again.get(&format!("/api/sessions/{id}/file"));
    assert_eq!(file.status, 200);
    let elsewhere = Server::start();
    let loaded = elsewhere.send(
        "POST",
        "/api/sessions/load",
        "application/octet-stream",
        &file.body,
    );
    let copy = loaded.ok()["id"].as_str().unwrap().to_owned();
    assert_eq!(picture(&elsewhere, &copy), shown);

    // A session that is deleted is gone from the disk too.
    let path = format!("/api/sessions/{id}");
    again.json("DELETE", &path, &json!({})).ok();
    again.get(&path).refused(404, &["no such session"]);
}

#[test]
fn sessions_that_are_only_opened_survive_a_restart() {
    let folder = tempfile::tempdir().unwrap();
    let mut server = Server::start_in(folder.path().to_owned());
    let file = server.get(&server.path("file")).body;
    let mime = "application/octet-stream";
    let loaded = server.send("POST", "/api/sessions/load", mime, &file).ok();
    server.stop();
    let again = Server::start_in(folder.path().to_owned());
    let id = loaded["id"].as_str().unwrap();
    let after = again.get(&format!("/api/sessions/{id}")).ok();
    assert_eq!(after["nodes"], loaded["nodes"]);
    // What the program opens by itself is made again at every start, and leaves no file.
    let first = format!("/api/sessions/{}", server.session);
    again.get(&first).refused(404, &["no such session"]);
}

#[test]
fn a_full_folder_of_sessions_is_named_and_keeps_nobody_from_starting() {
    let folder = tempfile::tempdir().unwrap();
    for i in 0..SAVED_SESSIONS {
        let path = folder.path().join(format!("{i:016x}.lumi-session"));
        std::fs::write(path, b"").unwrap();
    }
    let server = Server::start_in(folder.path().to_owned());
    let file = server.get(&server.path("file")).body;
    let mime = "application/octet-stream";
    let place = folder.path().display().to_string();
    let load = || server.send("POST", "/api/sessions/load", mime, &file);
    load().refused(413, &[&place, &SAVED_SESSIONS.to_string()]);
    let one = format!("/api/sessions/{:016x}", 7);
    server.json("DELETE", &one, &json!({})).ok();
    load().ok();
}

/// A small model with the authors' lights: its tokens live in a frame of their own.
fn authors_model() -> Relighter {
    let config = ModelConfig {
        lights: LightConfig::Authors {
            environment_patch: Some(16),
            point_rays: true,
            single_environment: true,
        },
        ..ModelConfig::preset("nano").unwrap()
    };
    Relighter::random(&config, Seed(5), &Device::flex())
}

#[test]
fn captured_views_of_models_with_the_authors_lights_are_seen_from_where_they_were_captured() {
    let folder = tempfile::tempdir().unwrap();
    let server = Server::start_with(folder.path().to_owned(), authors_model);
    let model = authors_model();
    let side = model.config.resolution;
    let scene = lumi_data::open(assets().join("demo/spot")).unwrap();
    let views = lumi_data::spread_inputs(&scene, 4, None, side).unwrap();
    let tokens = model.encode(&views, scene.to_model).unwrap();
    let apart = |a: &[u8], b: &[u8]| {
        let sum: u64 = a
            .iter()
            .zip(b)
            .map(|(a, b)| u64::from(a.abs_diff(*b)))
            .sum();
        sum as f64 / a.len() as f64
    };
    let session = server.session();
    for (view, input) in views.iter().zip(session["inputs"].as_array().unwrap()) {
        let render = |camera: Camera| model.render(&tokens, &[camera]).unwrap()[0].to_bytes();
        let truth = render(view.camera);
        let camera = &input["camera"];
        let query =
            ["azimuth", "elevation", "distance", "fov"].map(|f| format!("{f}={}", camera[f]));
        let path = format!("nodes/0/picture/png?{}", query.join("&"));
        let reply = server.get(&server.path(&path));
        assert_eq!(reply.status, 200, "{}", reply.text());
        let shown = image::load_from_memory(&reply.body).unwrap().to_rgb8();
        // The same angles in the frame of the tokens are another place.
        let [azimuth, elevation, distance, fov] =
            ["azimuth", "elevation", "distance", "fov"].map(|f| camera[f].as_f64().unwrap() as f32);
        let elsewhere = Camera::orbit(azimuth, elevation, distance, fov, side);
        let elsewhere = render(elsewhere.transformed(&tokens.to_model().inverse()));
        let (here, there) = (apart(&shown, &truth), apart(&elsewhere, &truth));
        assert!(here < 0.1 * there, "{}: {here} against {there}", view.name);
    }
}

#[test]
fn sessions_of_models_with_the_authors_lights_open_again() {
    let folder = tempfile::tempdir().unwrap();
    let server = Server::start_with(folder.path().to_owned(), authors_model);
    let lit = server.add(
        0,
        &json!({"mode": "set", "lights": add_point(2.0)["lights"]}),
    );
    let further = |session: &str, node: u64| {
        let edit = json!({"mode": "set", "lights": add_point(-3.0)["lights"]});
        let path = format!("/api/sessions/{session}/nodes");
        let made = server.json("POST", &path, &json!({"parent": node, "edit": edit}));
        let node = made.ok()["id"].as_u64().unwrap();
        let camera = "azimuth=0.4&elevation=0.4&distance=2.75&fov=0.87";
        let path = format!("/api/sessions/{session}/nodes/{node}/picture/png?{camera}");
        server.get(&path).body
    };
    let file = server.get(&server.path("file"));
    assert_eq!(file.status, 200, "{}", file.text());
    let mime = "application/octet-stream";
    let loaded = server.send("POST", "/api/sessions/load", mime, &file.body);
    let copy = loaded.ok()["id"].as_str().unwrap().to_owned();
    assert_eq!(further(&copy, lit), further(&server.session, lit));
}

#[test]
fn exports() {
    let server = Server::start();
    let maps = server.get("/api/maps").ok();
    let map = maps["maps"][1]["id"].as_str().unwrap().to_owned();
    let a = server.add(0, &add_point(2.0));
    let area = json!({"kind": "area", "position": [0.0, -3.0, 2.0], "target": [0.0, 0.0, 0.2],
                      "size": 1.5, "power": 300.0, "color": [1.0, 1.0, 1.0]});
    let b = server.add(a, &json!({"mode": "add", "lights": [area]}));
    let environment = json!({"kind": "environment", "map": map, "rotate": 10.0, "strength": 2.0});
    let c = server.add(b, &json!({"mode": "set", "lights": [environment]}));
    let camera = "azimuth=0.4&elevation=0.4&distance=2.75&fov=0.87";
    for (rest, magic) in [
        (
            format!("nodes/{a}/picture/png?{camera}&size=200"),
            &b"\x89PNG"[..],
        ),
        (
            format!("nodes/{a}/picture/exr?{camera}"),
            b"\x76\x2f\x31\x01",
        ),
        (
            format!("nodes/{a}/turntable?{camera}&frames=4&size=64"),
            b"GIF89a",
        ),
        (format!("nodes/{a}/thumbnail"), b"\x89PNG"),
        (format!("nodes/{c}/edits"), b"PK"),
        ("inputs/0".to_owned(), b"\x89PNG"),
    ] {
        let reply = server.get(&server.path(&rest));
        assert_eq!(reply.status, 200, "{rest}: {}", reply.text());
        assert!(reply.body.starts_with(magic), "{rest}");
    }
    // The edits read back as `lumi relight` reads them, and make the same tokens.
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("edits.toml");
    std::fs::write(
        &path,
        server.get(&server.path(&format!("nodes/{b}/edits"))).body,
    )
    .unwrap();
    let edits = lumi_model::EditsFile::read(&path).unwrap();
    assert_eq!(edits.len(), 2);
    let lumi_core::Light::Area(area) = &edits[1].lights[0] else {
        panic!("an area light")
    };
    assert_eq!((area.size, area.power), (1.5, 300.0));
    let command = server.get(&server.path(&format!("nodes/{c}/command"))).ok();
    let command = command["command"].as_str().unwrap();
    for word in [
        "lumi relight",
        "demo/spot",
        "--inputs 4",
        "--add point:2,-2,2.5",
        "--views orbit:24",
    ] {
        assert!(command.contains(word), "{word} in {command}");
    }
    // Maps that have no file get one that the command names, and a camera stands before it.
    let file = command.split("--set env:").nth(1).unwrap();
    let file = file.split(',').next().unwrap().trim_matches('\'');
    lumi_core::EnvMap::read(file).unwrap();
    let seen = server
        .get(&server.path(&format!("nodes/{c}/command?{camera}")))
        .ok();
    let seen = seen["command"].as_str().unwrap();
    let listed = seen.lines().nth(1).unwrap();
    let listed: Value = serde_json::from_str(listed).unwrap();
    assert!(listed[0]["camera"]["fx"].as_f64().unwrap() > 0.0);
    let name = seen.lines().next().unwrap().split(' ').nth(2).unwrap();
    assert!(seen.contains(&format!("--views {name}")), "{seen}");
    server
        .get(&server.path(&format!("nodes/{c}/command?azimuth=1")))
        .refused(422, &["camera", "none of them"]);
    for (rest, status, word) in [
        (format!("nodes/{a}/picture/bmp?{camera}"), 404, "png or exr"),
        (
            format!("nodes/{a}/picture/png?{camera}&size=99999"),
            422,
            "size",
        ),
        (
            format!("nodes/{a}/picture/png?azimuth=NaN&elevation=0&distance=3&fov=1"),
            422,
            "azimuth",
        ),
        (format!("nodes/{a}/picture/png"), 422, "missing field"),
        (
            format!("nodes/{a}/turntable?{camera}&frames=100000"),
            422,
            "frames",
        ),
        ("nodes/99/thumbnail".to_owned(), 404, "node 99"),
        ("inputs/99".to_owned(), 404, "input 99"),
    ] {
        server.get(&server.path(&rest)).refused(status, &[word]);
    }
}

#[test]
fn an_uploaded_capture_is_checked_and_encoded() {
    let server = Server::start();
    let folder = assets().join("demo/spot");
    let files: Vec<(String, Vec<u8>)> = std::fs::read_dir(folder)
        .unwrap()
        .map(|entry| {
            let path = entry.unwrap().path();
            let name = path.file_name().unwrap().to_str().unwrap().to_owned();
            (format!("spot/{name}"), std::fs::read(path).unwrap())
        })
        .collect();
    let files: Vec<_> = files
        .iter()
        .map(|(n, b)| (n.as_str(), b.as_slice()))
        .collect();
    let reply = server.upload(&files).ok();
    let (id, check) = (reply["id"].as_str().unwrap(), &reply["check"]);
    assert_eq!(check["usable"], true);
    assert!(check["text"].as_str().unwrap().contains("visual hull"));
    let views = check["views"].as_array().unwrap().len();
    assert_eq!(views as u64, check["report"]["inputs"].as_u64().unwrap());
    let picture = server.get(&format!("/api/uploads/{id}/views/0"));
    assert!(picture.body.starts_with(b"\x89PNG"));
    let page = server.get(&format!("/api/uploads/{id}/picture"));
    assert!(page.status == 200 && page.body.starts_with(b"\x89PNG"));
    let body = json!({"upload": id, "inputs": 3, "source": "env1"});
    let session = server.json("POST", "/api/sessions", &body).ok();
    assert_eq!(session["inputs"].as_array().unwrap().len(), 3);
    assert_eq!(session["source"]["light"], "env1");
    let body = json!({"upload": id, "inputs": 3, "source": "env9"});
    server
        .json("POST", "/api/sessions", &body)
        .refused(422, &["env9", "env0"]);
}

#[test]
fn lights_that_bring_nothing_are_refused() {
    let server = Server::start();
    let miss = json!({"kind": "spot", "position": [0, 0, 4], "target": [9, 0, 4], "angle": 20.0});
    let body = json!({"parent": 0, "edit": {"mode": "add", "lights": [miss]}});
    let reply = server.json("POST", &server.path("nodes"), &body);
    reply.refused(422, &["spot.target", "cone"]);
    let night = json!({"kind": "sun", "from": [0, 0, 0]});
    let body = json!({"parent": 0, "edit": {"mode": "add", "lights": [night]}});
    let reply = server.json("POST", &server.path("nodes"), &body);
    reply.refused(422, &["sun.from", "direction"]);
}

#[test]
fn the_page_is_whole_and_asks_for_nothing_else() {
    let server = Server::start();
    let page = server.get("/");
    assert!(
        page.head
            .contains("content-security-policy: default-src 'self'")
    );
    let mut left: Vec<String> = vec![page.text()];
    let mut seen = BTreeSet::new();
    while let Some(text) = left.pop() {
        assert!(!text.contains("https://"), "no other host is named");
        let own = text.split(['"', '\'']).filter_map(|part| {
            let part = part.strip_prefix("/assets/").or(part.strip_prefix("./"))?;
            part.contains('.').then(|| part.to_owned())
        });
        for name in own.collect::<Vec<_>>() {
            if seen.insert(name.clone()) {
                let reply = server.get(&format!("/assets/{name}"));
                assert_eq!(reply.status, 200, "{name}");
                left.push(reply.text());
            }
        }
    }
    assert!(seen.len() > 8, "{seen:?}");
    server.get("/assets/../Cargo.toml").refused(404, &[]);
    server.get("/nothing").refused(404, &["nothing here"]);
}
