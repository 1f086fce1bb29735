//! `lumi eval` and `lumi score` as a person uses them: what is written, and that both find the same figures.
#![allow(clippy::unwrap_used)]

use serde_json::Value;
use std::path::Path;
use std::process::{Command, Output};

fn lumi(args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_lumi"))
        .args(args)
        .output()
        .unwrap()
}

fn demo() -> String {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("assets/demo");
    path.to_str().unwrap().to_owned()
}

fn json(path: &Path) -> Value {
    serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap()
}

fn succeeds(args: &[&str]) {
    let output = lumi(args);
    let text = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success(), "{args:?}: {text}");
}

#[test]
fn saved_predictions_score_like_the_evaluation_that_saved_them() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    let demo = demo();
    let at = out.to_str().unwrap();
    succeeds(&[
        "eval",
        &demo,
        "--protocol",
        "multi-view",
        "--out",
        at,
        "--save-images",
    ]);
    for file in [
        "report.json",
        "report.md",
        "grid.png",
        "light-sweep.png",
        "tone-spread.png",
    ] {
        assert!(out.join(file).is_file(), "{file}");
    }
    assert!(out.join("objects/spot/grid.png").is_file());
    let evaluated = json(&out.join("report.json"));
    assert_eq!(evaluated["schema"], "lumi-eval/1");
    assert_eq!(evaluated["protocol"], "multi-view");

    let (predictions, report) = (out.join("predictions"), folder.path().join("scored.json"));
    let [predictions, to] = [&predictions, &report].map(|p| p.to_str().unwrap());
    succeeds(&[
        "score",
        predictions,
        &demo,
        "--protocol",
        "multi-view",
        "--json",
        to,
    ]);
    let scored = json(&report);
    for place in [
        "/slr/psnr",
        "/ilr/ssim",
        "/object_only/slr/psnr",
        "/per_object/spot/slr/ssim",
    ] {
        let value = |report: &Value| report.pointer(place).unwrap().as_f64().unwrap();
        let (a, b) = (value(&evaluated), value(&scored));
        // Rounding to 8 bits stands between them.
        assert!((a - b).abs() < 0.02, "{place}: {a} against {b}");
    }
    let nearest = "/trivial/nearest/slr";
    assert_eq!(evaluated.pointer(nearest), scored.pointer(nearest));
}

#[test]
fn runtime_says_that_weights_are_random() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("runtime.json");
    let demo = demo();
    let to = path.to_str().unwrap();
    succeeds(&[
        "eval",
        &demo,
        "--protocol",
        "runtime",
        "--preset",
        "nano",
        "--views",
        "3",
        "--repeats",
        "1",
        "--json",
        to,
    ]);
    let report = json(&path);
    assert_eq!(report["random_weights"], true);
    assert!(report["model"].as_str().unwrap().contains("random weights"));
    assert!(report["end_to_end"].as_f64().unwrap() > 0.0);
    assert!(report["peak_gpu_memory"].is_null());
}

#[test]
fn wrong_uses_are_named() {
    let demo = demo();
    let fails = |args: &[&str], status: i32, words: &[&str]| {
        let output = lumi(args);
        let text = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(status), "{args:?}: {text}");
        assert!(!text.contains("panicked"), "{text}");
        for word in words {
            assert!(
                text.contains(word),
                "{args:?}: expected `{word}` in: {text}"
            );
        }
    };
    let eval = |more: &[&str], status: i32, words: &[&str]| {
        fails(&[&["eval", demo.as_str()], more].concat(), status, words);
    };
    eval(&["--protocol", "sideways"], 2, &["multi-view", "runtime"]);
    eval(
        &["--protocol", "ablation"],
        1,
        &["--model", "weights files"],
    );
    eval(
        &["--protocol", "novel-view", "--preset", "nano"],
        1,
        &["--preset", "runtime"],
    );
    eval(
        &["--protocol", "runtime", "--preset", "huge"],
        1,
        &["huge", "nano"],
    );
    eval(
        &["--protocol", "novel-view", "--skip", "teapot"],
        1,
        &["teapot", "spot"],
    );
    eval(
        &["--protocol", "novel-view", "--rules", "mine"],
        2,
        &["stanford-orb"],
    );
    eval(
        &[
            "--protocol",
            "novel-view",
            "--lpips",
            "vgg",
            "--lpips-weights",
            "/nowhere/v",
        ],
        1,
        &["/nowhere/v"],
    );
    let folder = tempfile::tempdir().unwrap();
    let empty = folder.path().to_str().unwrap();
    fails(
        &["eval", empty, "--protocol", "novel-view"],
        1,
        &["manifest.json"],
    );
    fails(&["score", empty, &demo], 1, &["spot"]);
    fails(&["score", empty, empty], 1, &["OBJECT/CASE/VIEW.png"]);
}
