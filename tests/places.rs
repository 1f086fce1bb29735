//! CONTRIBUTING.md says which files a new kind of light is written into: those that know of suns, the newest kind, and no others.
#![allow(clippy::unwrap_used)]

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// How files of the program and of the page tell that a light is a sun.
const SUN: [&str; 8] = [
    "::Sun", " Sun(", "Sun};", "\"sun\"", "'sun'", "sun:", "\"SUN\"", "Sun,",
];

/// Files below `folder` that are programs; tests and examples tell of any kinds they like.
fn sources(folder: &Path, found: &mut Vec<PathBuf>) {
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_name().unwrap().to_string_lossy().into_owned();
        if path.is_dir() {
            if !["tests", "examples", "target"].contains(&name.as_str()) {
                sources(&path, found);
            }
        } else if [".rs", ".js", ".py"].iter().any(|end| name.ends_with(end)) {
            found.push(path);
        }
    }
}

#[test]
fn contributing_lists_where_a_light_is_written() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut all = Vec::new();
    for folder in ["src", "crates"] {
        sources(&root.join(folder), &mut all);
    }
    let knows = |path: &PathBuf| {
        let text = std::fs::read_to_string(path).unwrap();
        // What stands behind the program is its tests.
        let program = text.split("#[cfg(test)]").next().unwrap_or_default();
        SUN.iter().any(|word| program.contains(word))
    };
    let name = |path: PathBuf| {
        let path = path
            .strip_prefix(root)
            .unwrap()
            .to_string_lossy()
            .into_owned();
        path.replace('\\', "/")
    };
    let there: BTreeSet<String> = all.into_iter().filter(knows).map(name).collect();

    let text = std::fs::read_to_string(root.join("CONTRIBUTING.md")).unwrap();
    let section = text.split("**A light**").nth(1).unwrap();
    let section = section.split("**A head**").next().unwrap();
    // Further code in a sentence names what to look for in the file before it.
    let listed = section.split('`').skip(1).step_by(2);
    let listed: BTreeSet<String> = listed
        .filter(|word| word.contains('/') && !word.contains("tests/"))
        .filter(|word| [".rs", ".js", ".py"].iter().any(|end| word.ends_with(end)))
        .map(|word| word.replace("NAME", "sun"))
        .collect();
    for file in &listed {
        assert!(root.join(file).is_file(), "there is no {file}");
    }
    // Whether it is trained on is a choice of its own.
    let training = [
        "crates/render/src/generate/job.rs",
        "crates/train/src/sample.rs",
    ];
    let missing: Vec<_> = there.difference(&listed).collect();
    let beyond: Vec<_> = listed.difference(&there).collect();
    assert_eq!(missing, Vec::<&String>::new(), "files that the list lacks");
    assert_eq!(
        beyond,
        training.iter().collect::<Vec<_>>(),
        "files that know no sun"
    );
}
