//! Data sets made by several processes, and by processes that are killed, are those that one process makes.
#![allow(clippy::unwrap_used)]

use std::collections::BTreeMap;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::Duration;

/// Starts `lumi dataset generate RECIPE --out OUT OPTIONS..`.
fn generate(recipe: &Path, out: &Path, options: &[&str]) -> Child {
    Command::new(env!("CARGO_BIN_EXE_lumi"))
        .args(["dataset", "generate"])
        .arg(recipe)
        .arg("--out")
        .arg(out)
        .args(options)
        .stdout(Stdio::null())
        .spawn()
        .unwrap()
}

fn recipe(folder: &Path, text: &str) -> std::path::PathBuf {
    let path = folder.join("recipe.toml");
    std::fs::write(&path, text).unwrap();
    path
}

/// Every file below a folder with its bytes. What a killed process leaves under a hidden name does not count.
fn files(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    let mut all = BTreeMap::new();
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_name().unwrap().to_str().unwrap().to_owned();
        if path.is_dir() {
            let below = files(&path).into_iter();
            all.extend(below.map(|(n, bytes)| (format!("{name}/{n}"), bytes)));
        } else if !name.starts_with('.') {
            all.insert(name, std::fs::read(&path).unwrap());
        }
    }
    all
}

fn same(a: &Path, b: &Path) {
    let (a, b) = (files(a), files(b));
    assert!(a.keys().eq(b.keys()), "other files");
    for (name, bytes) in &a {
        assert!(bytes == &b[name], "{name} differs");
    }
}

#[test]
fn three_processes_at_once_make_what_one_makes() {
    let folder = tempfile::tempdir().unwrap();
    let recipe = recipe(
        folder.path(),
        "objects = 5\nfirst = 2\nseed = 3\nresolution = 16\nsamples = 2\nviews = 2\nscene_share = 0.3\n",
    );
    let [whole, parts] = ["whole", "parts"].map(|n| folder.path().join(n));
    assert!(generate(&recipe, &whole, &[]).wait().unwrap().success());
    let running = ["0/3", "1/3", "2/3"].map(|s| generate(&recipe, &parts, &["--shard", s]));
    for mut child in running {
        assert!(child.wait().unwrap().success());
    }
    same(&whole, &parts);
    let records = files(&whole).into_keys();
    let complete = records.filter(|n| n.ends_with("/radiance/zarr.json"));
    assert_eq!(complete.count(), 5);
}

#[test]
fn a_killed_run_goes_on_where_it_stopped() {
    let folder = tempfile::tempdir().unwrap();
    let recipe = recipe(
        folder.path(),
        "objects = 24\nseed = 8\nresolution = 32\nsamples = 4\nviews = 4\n",
    );
    let [whole, cut] = ["whole", "cut"].map(|n| folder.path().join(n));
    assert!(generate(&recipe, &whole, &[]).wait().unwrap().success());
    let finished = || (0..24).filter(|i| cut.join(format!("object_{i:06}/zarr.json")).exists());
    for run in 0..4_u64 {
        let before = finished().count();
        let mut child = generate(&recipe, &cut, &[]);
        // Killed somewhere within a record that comes after a finished one.
        while finished().count() == before {
            assert!(child.try_wait().unwrap().is_none(), "run {run} ended early");
            std::thread::sleep(Duration::from_millis(1));
        }
        std::thread::sleep(Duration::from_millis(3 * run));
        child.kill().unwrap();
        child.wait().unwrap();
    }
    let kept: Vec<_> = finished().collect();
    assert!(kept.len() < 24, "no run was killed");
    let age = |i: &usize| {
        let path = cut.join(format!("object_{i:06}/zarr.json"));
        path.metadata().unwrap().modified().unwrap()
    };
    let ages: Vec<_> = kept.iter().map(age).collect();
    assert!(generate(&recipe, &cut, &[]).wait().unwrap().success());
    same(&whole, &cut);
    // What was finished was not made again.
    assert!(kept.iter().map(age).eq(ages));
}
