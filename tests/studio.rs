//! `lumi studio` as a person starts it; what its server answers is tested in its own crate, the page in a browser.
#![allow(clippy::unwrap_used)]

use std::io::{BufRead, BufReader, Read};
use std::process::{Command, Stdio};

#[test]
fn a_studio_says_who_reaches_it_and_that_another_has_its_folder() {
    let folder = tempfile::tempdir().unwrap();
    let data = folder.path();
    let sessions = data.join("sessions");
    std::fs::create_dir(&sessions).unwrap();
    let other = lumi_core::fs::alone(&sessions).unwrap();
    assert!(other.is_some());
    let mut studio = Command::new(env!("CARGO_BIN_EXE_lumi"))
        .args(["studio", "--port", "0", "--address", "0.0.0.0", "--data"])
        .arg(data)
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let lines = BufReader::new(studio.stdout.take().unwrap()).lines();
    let address = lines
        .map_while(Result::ok)
        .find(|l| l.starts_with("studio: http://"));
    studio.kill().unwrap();
    let mut said = String::new();
    studio
        .stderr
        .take()
        .unwrap()
        .read_to_string(&mut said)
        .unwrap();
    studio.wait().unwrap();
    assert!(said.contains("another studio keeps its sessions"), "{said}");
    assert!(said.contains("knows no passwords"), "{said}");
    assert!(address.is_some(), "{said}");
}
