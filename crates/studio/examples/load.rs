//! Many clients at once against a running studio: each orbits without pause and makes, changes and removes steps.
//! At the end every edit that was answered must be there.
//!
//! `cargo run --release -p lumi-studio --example load -- PORT [CLIENTS] [SECONDS] [PID]`
//!
//! PID: the studio's process, to watch its memory (Linux).

use serde_json::{Value, json};
use std::collections::BTreeSet;
use std::io::{Read, Write};
use std::net::TcpStream;
use std::time::{Duration, Instant};
use tungstenite::Message;

type Failure = Box<dyn std::error::Error + Send + Sync>;

/// Steps that a client keeps: older ones are removed, as the sessions' limit demands.
const KEPT: usize = 6;

#[derive(Default)]
struct Tally {
    frames: usize,
    edits: usize,
    removed: usize,
    /// Milliseconds from request to answer.
    frame_ms: Vec<f32>,
    edit_ms: Vec<f32>,
    session: String,
    there: BTreeSet<u64>,
}

fn main() -> Result<(), Failure> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let number = |i: usize, usual: u64| match arguments.get(i) {
        Some(text) => text.parse::<u64>(),
        None => Ok(usual),
    };
    let port = number(0, 7788)? as u16;
    let (clients, seconds) = (number(1, 50)?, number(2, 60)?);
    let pid = arguments.get(3).cloned();
    let end = Instant::now() + Duration::from_secs(seconds);

    // Ten sessions out of the first one's file, five clients on each.
    let studio = request(port, "GET", "/api/studio", b"")?;
    let first = studio["opening"].as_str().ok_or("no session")?.to_owned();
    let file = bytes(port, "GET", &format!("/api/sessions/{first}/file"), b"")?;
    let mut sessions = Vec::new();
    for _ in 0..clients.div_ceil(5) {
        let made = request(port, "POST", "/api/sessions/load", &file)?;
        sessions.push(made["id"].as_str().ok_or("no id")?.to_owned());
    }
    let memory = || pid.as_deref().and_then(resident_mib);
    println!("memory before: {:?} MiB", memory());
    let tallies: Vec<Tally> = std::thread::scope(|scope| {
        let running: Vec<_> = (0..clients as usize)
            .map(|i| {
                let session = sessions[i / 5].clone();
                scope.spawn(move || client(port, session, i, end))
            })
            .collect();
        while Instant::now() < end {
            std::thread::sleep(Duration::from_secs(10).min(end - Instant::now()));
            println!("memory: {:?} MiB", memory());
        }
        let joined = running.into_iter().map(|c| match c.join() {
            Ok(tally) => tally,
            Err(_) => Err("a client panicked".into()),
        });
        joined.collect::<Result<_, Failure>>()
    })?;

    let mut lost = 0;
    for session in &sessions {
        let json = request(port, "GET", &format!("/api/sessions/{session}"), b"")?;
        let nodes = json["nodes"].as_array().ok_or("no nodes")?;
        let there: BTreeSet<u64> = nodes.iter().filter_map(|n| n["id"].as_u64()).collect();
        let mine = tallies.iter().filter(|t| t.session == *session);
        let expected: BTreeSet<u64> = mine.flat_map(|t| t.there.iter().copied()).collect();
        lost += expected.difference(&there).count();
        request(port, "DELETE", &format!("/api/sessions/{session}"), b"")?;
    }
    let sum = |f: fn(&Tally) -> usize| tallies.iter().map(f).sum::<usize>();
    println!(
        "{clients} clients, {seconds} s: {} frames, {} edits, {} removed, {lost} lost",
        sum(|t| t.frames),
        sum(|t| t.edits),
        sum(|t| t.removed)
    );
    for (name, pick) in [
        (
            "frame",
            (|t: &Tally| &t.frame_ms) as fn(&Tally) -> &Vec<f32>,
        ),
        ("edit", |t| &t.edit_ms),
    ] {
        let mut all: Vec<f32> = tallies
            .iter()
            .flat_map(|t| pick(t).iter().copied())
            .collect();
        all.sort_by(f32::total_cmp);
        let at = |q: f32| {
            all.get((q * all.len() as f32) as usize)
                .copied()
                .unwrap_or(0.0)
        };
        println!("{name} ms: median {:.0}, 95 % {:.0}", at(0.5), at(0.95));
    }
    std::thread::sleep(Duration::from_secs(3));
    println!("memory after: {:?} MiB", memory());
    if lost > 0 {
        return Err(format!("{lost} edits were lost").into());
    }
    Ok(())
}

fn client(port: u16, session: String, number: usize, end: Instant) -> Result<Tally, Failure> {
    let mut tally = Tally {
        session: session.clone(),
        ..Tally::default()
    };
    let stream = TcpStream::connect(("127.0.0.1", port))?;
    let url = format!("ws://127.0.0.1:{port}/api/sessions/{session}/socket");
    let (mut socket, _) = tungstenite::client(url, stream)?;
    let nodes = format!("/api/sessions/{session}/nodes");
    let mut own: Vec<u64> = Vec::new();
    let mut id = 0_u64;
    while Instant::now() < end {
        for _ in 0..5 {
            id += 1;
            let azimuth = 0.05 * id as f32 + number as f32;
            let camera =
                json!({"azimuth": azimuth, "elevation": 0.4, "distance": 2.75, "fov": 0.87});
            let ask = json!({"id": id, "node": own.last().unwrap_or(&0), "camera": camera, "moving": true});
            let started = Instant::now();
            socket.send(Message::text(ask.to_string()))?;
            while !matches!(socket.read()?, Message::Binary(_)) {}
            tally.frames += 1;
            tally.frame_ms.push(1e3 * started.elapsed().as_secs_f32());
        }
        let position = [2.0 + (0.37 * id as f32).sin(), -2.0, 2.0];
        let light =
            json!({"kind": "point", "position": position, "power": 200.0, "color": [1, 1, 1]});
        let edit = json!({"mode": "add", "lights": [light]});
        // A chain of three, then from the capture again.
        let parent = if own.len().is_multiple_of(3) {
            0
        } else {
            own[own.len() - 1]
        };
        let started = Instant::now();
        let made = request(
            port,
            "POST",
            &nodes,
            json!({"parent": parent, "edit": edit})
                .to_string()
                .as_bytes(),
        )?;
        tally.edit_ms.push(1e3 * started.elapsed().as_secs_f32());
        let made = made["id"].as_u64().ok_or("no id")?;
        tally.edits += 1;
        own.push(made);
        tally.there.insert(made);
        if own.len() > KEPT && own.len().is_multiple_of(3) {
            request(port, "DELETE", &format!("{nodes}/{}", own[0]), b"")?;
            for gone in own.drain(..3) {
                tally.there.remove(&gone);
                tally.removed += 1;
            }
        }
    }
    Ok(tally)
}

fn request(port: u16, method: &str, path: &str, body: &[u8]) -> Result<Value, Failure> {
    Ok(serde_json::from_slice(&bytes(port, method, path, body)?)?)
}

/// The body of a good answer.
fn bytes(port: u16, method: &str, path: &str, body: &[u8]) -> Result<Vec<u8>, Failure> {
    let mut stream = TcpStream::connect(("127.0.0.1", port))?;
    write!(
        stream,
        "{method} {path} HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nContent-Type: application/json\r\n\
         Content-Length: {}\r\nConnection: close\r\n\r\n",
        body.len()
    )?;
    stream.write_all(body)?;
    let mut answer = Vec::new();
    stream.read_to_end(&mut answer)?;
    let end = answer.windows(4).position(|w| w == b"\r\n\r\n");
    let end = end.ok_or("no answer")?;
    let head = String::from_utf8_lossy(&answer[..end]).into_owned();
    let body = answer.split_off(end + 4);
    if head.starts_with("HTTP/1.1 200") {
        return Ok(body);
    }
    let text = String::from_utf8_lossy(&body);
    Err(format!("{method} {path}: {head}\n{text}").into())
}

/// Resident memory of a process.
fn resident_mib(pid: &str) -> Option<u64> {
    let status = std::fs::read_to_string(format!("/proc/{pid}/status")).ok()?;
    let line = status.lines().find(|l| l.starts_with("VmRSS:"))?;
    let kib: u64 = line.split_whitespace().nth(1)?.parse().ok()?;
    Some(kib / 1024)
}
