//! The documents' links lead somewhere, and what they show runs.
#![allow(clippy::unwrap_used)]

use std::path::{Path, PathBuf};

/// Markdown files of the tree, but for what builds leave.
fn documents(folder: &Path, found: &mut Vec<PathBuf>) {
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_name().unwrap().to_str().unwrap();
        if path.is_dir() {
            if !name.starts_with('.') && !["target", "out", "node_modules"].contains(&name) {
                documents(&path, found);
            }
        } else if name.ends_with(".md") {
            found.push(path);
        }
    }
}

/// Targets of `[text](target)` outside code, with their lines.
fn links(text: &str) -> Vec<(usize, String)> {
    let mut found = Vec::new();
    let mut code = false;
    for (i, line) in text.lines().enumerate() {
        if line.trim_start().starts_with("```") {
            code = !code;
        }
        if code {
            continue;
        }
        // What stands between backticks is every second part.
        let prose: Vec<&str> = line.split('`').step_by(2).collect();
        for part in prose.join("``").split("](").skip(1) {
            if let Some((target, _)) = part.split_once(')') {
                found.push((i + 1, target.to_owned()));
            }
        }
    }
    found
}

/// The anchors that headings make, as on common pages: lower case, spaces to dashes, other marks left out.
fn anchors(text: &str) -> Vec<String> {
    let headings = text.lines().filter(|line| line.starts_with('#'));
    let anchor = |line: &str| {
        let title = line.trim_start_matches('#').trim().to_lowercase();
        let kept = title.chars().filter_map(|c| match c {
            ' ' => Some('-'),
            c if c.is_alphanumeric() || c == '-' || c == '_' => Some(c),
            _ => None,
        });
        kept.collect()
    };
    headings.map(anchor).collect()
}

#[test]
fn links_lead_to_files_and_headings_that_exist() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut files = Vec::new();
    documents(root, &mut files);
    assert!(files.len() > 30, "{} documents", files.len());
    let (mut checked, mut broken) = (0, Vec::new());
    for file in &files {
        let text = std::fs::read_to_string(file).unwrap();
        for (line, target) in links(&text) {
            if target.contains("://") || target.starts_with("mailto:") {
                continue;
            }
            checked += 1;
            let (path, anchor) = target.split_once('#').unwrap_or((&target, ""));
            let to = match path {
                "" => file.clone(),
                path => file.parent().unwrap().join(path),
            };
            let there = to.exists();
            let known = anchor.is_empty()
                || (there
                    && anchors(&std::fs::read_to_string(&to).unwrap())
                        .iter()
                        .any(|a| a == anchor));
            if !there || !known {
                broken.push(format!("{}:{line}: {target}", file.display()));
            }
        }
    }
    assert!(checked > 50, "{checked} links");
    assert!(broken.is_empty(), "{}", broken.join("\n"));
}

#[test]
fn the_readmes_library_example_is_one_that_runs() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let readme = std::fs::read_to_string(root.join("README.md")).unwrap();
    let example = std::fs::read_to_string(root.join("examples/relight.rs")).unwrap();
    let between = |text: &str, begin: &str, end: &str| -> Vec<String> {
        let (_, rest) = text.split_once(begin).unwrap();
        let (inside, _) = rest.split_once(end).unwrap();
        inside.lines().map(|line| line.trim().to_owned()).collect()
    };
    let shown = between(&readme, "```rust\n", "```");
    let runs = between(
        &example,
        "// What the README shows.\n",
        "    // That is all.",
    );
    assert_eq!(shown, runs);

    let built = Path::new(env!("CARGO_BIN_EXE_lumi")).with_file_name("examples");
    let out = tempfile::tempdir().unwrap();
    let done = std::process::Command::new(built.join("relight"))
        .arg(out.path())
        .current_dir(root)
        .output()
        .unwrap();
    assert!(done.status.success(), "{done:?}");
    assert_eq!(std::fs::read_dir(out.path()).unwrap().count(), 8);
}

#[test]
fn the_readmes_commands_run_on_the_bundled_scene() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let readme = std::fs::read_to_string(root.join("README.md")).unwrap();
    let here = tempfile::tempdir().unwrap();
    let assets = root.join("assets/").display().to_string();
    let mut ran = 0;
    for line in readme.lines() {
        let (command, _) = line.split_once(" #").unwrap_or((line, ""));
        let of_ours = ["lumi relight assets/", "lumi scene check assets/"];
        if !of_ours.iter().any(|begin| command.starts_with(begin)) {
            continue;
        }
        let words = command.split_whitespace().skip(1);
        let words = words.map(|word| word.replace("assets/", &assets));
        let done = std::process::Command::new(env!("CARGO_BIN_EXE_lumi"))
            .args(words)
            .current_dir(here.path())
            .output()
            .unwrap();
        let said = String::from_utf8_lossy(&done.stderr);
        assert!(done.status.success(), "{command}: {said}");
        ran += 1;
    }
    assert!(ran >= 5, "{ran} commands");
    for file in [
        "steps/step-2-add-point",
        "layers/layers",
        "orbit/spot.tokens",
        "relit/dataset/transforms.json",
    ] {
        assert!(here.path().join("out").join(file).exists(), "{file}");
    }
}

#[test]
fn every_page_is_in_the_book() {
    let docs = Path::new(env!("CARGO_MANIFEST_DIR")).join("docs");
    let summary = std::fs::read_to_string(docs.join("SUMMARY.md")).unwrap();
    let index = std::fs::read_to_string(docs.join("decisions/README.md")).unwrap();
    let mut pages = Vec::new();
    documents(&docs, &mut pages);
    for page in pages {
        let within = page.strip_prefix(&docs).unwrap().to_str().unwrap();
        let listed = summary.contains(&format!("]({within})"));
        assert!(listed || within == "SUMMARY.md", "{within} in SUMMARY.md");
        if let Some(decision) = within.strip_prefix("decisions/") {
            let listed = index.contains(&format!("]({decision})"));
            assert!(listed || decision == "README.md", "{decision} in the index");
        }
    }
}
