//! Which crate may use which: the arrows of `docs/architecture.md`, held by `cargo metadata`.
#![allow(clippy::unwrap_used)]

use serde_json::Value;
use std::collections::BTreeMap;
use std::process::Command;

/// Each crate of the workspace with the crates of the workspace that it may depend on.
/// A new crate fails the tests until its arrows are stated here.
const ALLOWED: &[(&str, &[&str])] = &[
    ("lumi-core", &[]),
    ("lumi-kernels", &[]),
    ("lumi-testkit", &[]),
    ("lumi-data", &["lumi-core"]),
    ("lumi-render", &["lumi-core", "lumi-data"]),
    ("lumi-model", &["lumi-core", "lumi-kernels"]),
    ("lumi-eval", &["lumi-core", "lumi-data", "lumi-model"]),
    (
        "lumi-train",
        &[
            "lumi-core",
            "lumi-data",
            "lumi-eval",
            "lumi-kernels",
            "lumi-model",
        ],
    ),
    ("lumi-studio", &["lumi-core", "lumi-data", "lumi-model"]),
    // The Python package has the command line in it.
    (
        "lumi-py",
        &[
            "lumi",
            "lumi-core",
            "lumi-data",
            "lumi-eval",
            "lumi-kernels",
            "lumi-model",
            "lumi-studio",
        ],
    ),
    // The command line may use every crate that is not for tests alone.
    (
        "lumi",
        &[
            "lumi-core",
            "lumi-data",
            "lumi-eval",
            "lumi-kernels",
            "lumi-model",
            "lumi-render",
            "lumi-studio",
            "lumi-train",
        ],
    ),
];

/// Helps tests, so it may be a development dependency of any crate and nothing else.
const TESTS_ONLY: &str = "lumi-testkit";

/// Crates that must compile without the tensor library, which takes minutes.
const WITHOUT_BURN: &[&str] = &[
    "lumi-core",
    "lumi-data",
    "lumi-kernels",
    "lumi-render",
    "lumi-testkit",
];

/// A dependency as a manifest states it: its package, and `None`, `dev` or `build`.
struct Dependency {
    name: String,
    kind: Option<String>,
}

/// The workspace's crates with their direct dependencies.
fn workspace() -> BTreeMap<String, Vec<Dependency>> {
    let output = Command::new(env!("CARGO"))
        .args(["metadata", "--no-deps", "--format-version", "1"])
        .args(["--offline", "--manifest-path"])
        .arg(concat!(env!("CARGO_MANIFEST_DIR"), "/Cargo.toml"))
        .output()
        .expect("cargo runs");
    let errors = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "cargo metadata: {errors}");
    let metadata: Value = serde_json::from_slice(&output.stdout).expect("JSON");
    let text = |value: &Value| value.as_str().map(str::to_owned);
    let packages = metadata["packages"].as_array().unwrap();
    packages
        .iter()
        .map(|package| {
            let dependencies = package["dependencies"].as_array().unwrap();
            let dependencies = dependencies.iter().map(|d| Dependency {
                name: text(&d["name"]).unwrap(),
                kind: text(&d["kind"]),
            });
            (text(&package["name"]).unwrap(), dependencies.collect())
        })
        .collect()
}

#[test]
fn every_crate_states_its_arrows() {
    let found = workspace();
    let mut found: Vec<_> = found.keys().map(String::as_str).collect();
    let mut stated: Vec<_> = ALLOWED.iter().map(|(name, _)| *name).collect();
    found.sort_unstable();
    stated.sort_unstable();
    assert_eq!(
        found, stated,
        "crates of the workspace (left) against the rows of ALLOWED (right)"
    );
}

#[test]
fn arrows_point_one_way() {
    let workspace = workspace();
    let mut wrong = Vec::new();
    for (name, allowed) in ALLOWED {
        for dependency in workspace.get(*name).into_iter().flatten() {
            let ours = workspace.contains_key(&dependency.name);
            let normal = dependency.kind.is_none();
            if ours && normal && !allowed.contains(&dependency.name.as_str()) {
                wrong.push(format!("{name} -> {}", dependency.name));
            }
        }
    }
    assert!(wrong.is_empty(), "not allowed: {}", wrong.join(", "));
}

#[test]
fn the_testkit_serves_tests_only() {
    for (name, dependencies) in workspace() {
        for dependency in dependencies.iter().filter(|d| d.name == TESTS_ONLY) {
            assert_eq!(
                dependency.kind.as_deref(),
                Some("dev"),
                "{name} -> {TESTS_ONLY}: expected a development dependency"
            );
        }
    }
}

#[test]
fn plain_crates_do_not_need_burn() {
    let workspace = workspace();
    for name in WITHOUT_BURN {
        for dependency in workspace.get(*name).into_iter().flatten() {
            let burn = dependency.name == "burn" || dependency.name.starts_with("burn-");
            assert!(!burn, "{name} -> {}", dependency.name);
        }
    }
}
