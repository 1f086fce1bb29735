//! `lumi eval` and `lumi score` as a person uses them: what is written, and that both find the same figures.
#![allow(clippy::unwrap_used)]

mod common;

use burn::tensor::Device;
use common::{fails, lumi};
use lumi_core::Seed;
use lumi_core::image::{read_display, write_png};
use lumi_eval::Collection;
use lumi_eval::baselines::{Seen, colour_ratio};
use lumi_eval::cases::Subject;
use lumi_model::checkpoint::{self, Provenance, Storage};
use lumi_model::{ModelConfig, Network};
use serde_json::Value;
use std::path::Path;

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
fn several_methods_are_scored_as_the_evaluation_scores_them() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let demo = demo();
    // Two made-up methods: answers that take no model, saved as any method saves its pictures.
    let collection = Collection::open(&demo).unwrap();
    let subject = Subject::load(&collection, "spot", 8, false, 64, |_| 1).unwrap();
    for case in &subject.targets {
        let target = subject.target(case).unwrap();
        let seen = Seen::by(&subject, &target.cameras);
        let ratio = colour_ratio(&subject, &seen.nearest, &target).unwrap();
        for (method, images) in [("one", seen.nearest), ("other", ratio)] {
            let place = folder.path().join(method).join("spot").join(case);
            std::fs::create_dir_all(&place).unwrap();
            for (view, image) in target.views.iter().zip(images) {
                write_png(place.join(format!("{view}.png")), &image).unwrap();
            }
        }
    }
    let report = at("evaluated.json");
    succeeds(&["eval", &demo, "--protocol", "novel-view", "--json", &report]);
    let evaluated = json(Path::new(&report));
    let (one, other) = (
        format!("one={}", at("one")),
        format!("other={}", at("other")),
    );
    let out = at("out");
    succeeds(&["score", &demo, "--method", &one, &other, "--out", &out]);
    let scored = json(&Path::new(&out).join("report.json"));
    assert_eq!(scored["schema"], "lumi-comparison/1");
    let mut compared = 0;
    for (i, answer) in ["nearest", "colour_ratio"].into_iter().enumerate() {
        let method = &scored["methods"][i]["report"];
        assert_eq!(
            method["trivial"]["nearest"],
            evaluated["trivial"]["nearest"]
        );
        for part in ["", "/object_only"] {
            for alignment in ["raw", "ilr", "slr"] {
                for (metric, near) in [("psnr", 0.02), ("ssim", 1e-3), ("lpips", 2e-3)] {
                    let place = format!("{part}/{alignment}/{metric}");
                    let value = |figures: &Value| figures.pointer(&place).unwrap().as_f64();
                    let (a, b) = (value(&evaluated["trivial"][answer]), value(method));
                    // Rounding to 8 bits stands between them.
                    assert!(
                        (a.unwrap() - b.unwrap()).abs() < near,
                        "{answer}{place}: {a:?}, {b:?}"
                    );
                    compared += 1;
                }
            }
        }
    }
    assert_eq!(compared, 2 * 2 * 3 * 3);
    let text = std::fs::read_to_string(Path::new(&out).join("report.md")).unwrap();
    assert!(
        text.contains("| one | ") && text.contains("| other | "),
        "{text}"
    );
    let sheet = read_display(Path::new(&out).join("grid.png")).unwrap();
    // Both methods and the truth in one row.
    assert!(sheet.width > 3 * 150 && sheet.height < 3 * 150);
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
fn a_training_store_is_evaluated_and_scored() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let (zarr, files) = (at("zarr"), at("files"));
    succeeds(&[
        "dataset",
        "generate",
        "--out",
        &zarr,
        "--objects",
        "2",
        "--resolution",
        "32",
    ]);
    succeeds(&["dataset", "pack", &zarr, "--out", &files, "--files"]);
    let evaluated = |store: &str| {
        let out = at(&format!("out-{}", store.len()));
        succeeds(&[
            "eval",
            store,
            "--protocol",
            "novel-view",
            "--out",
            &out,
            "--save-images",
        ]);
        (json(&Path::new(&out).join("report.json")), out)
    };
    let ((from_groups, out), (from_files, _)) = (evaluated(&zarr), evaluated(&files));
    let objects = from_groups["per_object"].as_object().unwrap();
    assert_eq!(objects.len(), 2);
    for (name, object) in objects {
        // Other lights alone, and mixtures of two and three.
        let cases = object["cases"].as_object().unwrap();
        assert!(
            cases.keys().filter(|c| c.contains('+')).count() == 2,
            "{name}"
        );
        assert!(cases.len() > 3, "{name}: {}", cases.len());
    }
    // A group and a file hold the same.
    assert_eq!(from_groups["per_object"], from_files["per_object"]);
    assert!(from_groups["notes"].to_string().contains("drawn"));
    // What was saved is scored against the store itself.
    let (predictions, report) = (format!("{out}/predictions"), at("scored.json"));
    succeeds(&["score", &predictions, &zarr, "--json", &report]);
    let scored = json(Path::new(&report));
    let psnr = |r: &Value| r.pointer("/slr/psnr").unwrap().as_f64().unwrap();
    assert!((psnr(&scored) - psnr(&from_groups)).abs() < 0.05);
}

#[test]
fn ablation_puts_weights_side_by_side() {
    let folder = tempfile::tempdir().unwrap();
    let nano = |name: &str, seed: u64| {
        let (config, device) = (ModelConfig::preset("nano").unwrap(), Device::flex());
        let network = Network::new(&config, Seed(seed), &device);
        let provenance = Provenance {
            origin: format!("untrained, seed {seed}"),
            ..Provenance::default()
        };
        let path = folder.path().join(name).join("nano.safetensors");
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        checkpoint::save(&path, &network, &config, &provenance, Storage::F32).unwrap();
        path.to_str().unwrap().to_owned()
    };
    let bundled = Path::new(env!("CARGO_MANIFEST_DIR")).join("assets/lumi-mini.safetensors");
    let (one, two) = (nano("a", 1), nano("b", 2));
    let out = folder.path().join("out");
    let (demo, to) = (demo(), out.to_str().unwrap());
    succeeds(&[
        "eval",
        &demo,
        "--protocol",
        "ablation",
        "--out",
        to,
        "--model",
        bundled.to_str().unwrap(),
        &one,
        &two,
    ]);
    let report = json(&out.join("report.json"));
    assert_eq!(report["protocol"], "ablation");
    let variants = report["variants"].as_object().unwrap();
    let names: Vec<&String> = variants.keys().collect();
    // Files of one name are told apart.
    assert_eq!(names, ["a", "b", "lumi-mini"]);
    let psnr = |name: &str| {
        variants[name]
            .pointer("/slr/psnr")
            .unwrap()
            .as_f64()
            .unwrap()
    };
    assert!(
        psnr("lumi-mini") > psnr("a") + 3.0,
        "trained against random"
    );
    assert!(psnr("a") != psnr("b"));
    assert!(
        report["notes"].to_string().contains("16 px"),
        "{}",
        report["notes"]
    );
    let text = std::fs::read_to_string(out.join("report.md")).unwrap();
    assert!(
        text.contains("## Variants") && text.contains("| b |"),
        "{text}"
    );
    for file in ["ablation.png", "lumi-mini/report.json", "a/grid.png"] {
        assert!(out.join(file).is_file(), "{file}");
    }
}

#[test]
fn views_overlap_as_the_model_asks_unless_told_otherwise() {
    let folder = tempfile::tempdir().unwrap();
    let (demo, mut scores) = (demo(), Vec::new());
    for (flags, noted) in [(&[][..], true), (&["--no-overlap"][..], false)] {
        let to = folder.path().join(format!("{noted}.json"));
        let base = ["eval", &demo, "--protocol", "novel-view", "--json"];
        succeeds(&[&base[..], &[to.to_str().unwrap()], flags].concat());
        let report = json(&to);
        let notes = report["notes"].to_string();
        assert_eq!(notes.contains("overlapping patches"), noted, "{notes}");
        scores.push(report["slr"]["psnr"].as_f64().unwrap());
    }
    assert_ne!(scores[0], scores[1]);
}

#[test]
fn a_damaged_object_fails_alone_and_is_made_up_for() {
    let folder = tempfile::tempdir().unwrap();
    let store = folder.path().join("store");
    let (from, out) = (demo(), folder.path().join("out"));
    for name in ["good", "bad"] {
        std::fs::create_dir_all(store.join(name)).unwrap();
        for entry in std::fs::read_dir(Path::new(&from).join("spot")).unwrap() {
            let path = entry.unwrap().path();
            std::fs::copy(&path, store.join(name).join(path.file_name().unwrap())).unwrap();
        }
    }
    let damaged = store.join("bad/v05_point1.exr");
    let whole = std::fs::read(&damaged).unwrap();
    std::fs::write(&damaged, &whole[..whole.len() / 2]).unwrap();
    let args = [
        "eval",
        store.to_str().unwrap(),
        "--protocol",
        "multi-view",
        "--out",
        out.to_str().unwrap(),
    ];
    let output = lumi(&args);
    assert_eq!(output.status.code(), Some(1));
    let report = json(&out.join("report.json"));
    assert!(report["per_object"]["good"].is_object() && report["per_object"]["bad"].is_null());
    let cause = report["failures"]["bad"].as_str().unwrap();
    assert!(cause.contains("v05_point1.exr"), "{cause}");
    assert!(String::from_utf8_lossy(&output.stderr).contains("v05_point1.exr"));
    // Mended, only the damaged object is evaluated; the other one's record stays as it is.
    let record = out.join("objects/good/record.json");
    let before = std::fs::metadata(&record).unwrap().modified().unwrap();
    std::fs::write(&damaged, whole).unwrap();
    succeeds(&args);
    let report = json(&out.join("report.json"));
    assert_eq!(report["per_object"].as_object().unwrap().len(), 2);
    assert_eq!(
        std::fs::metadata(&record).unwrap().modified().unwrap(),
        before
    );
}

/// What photographs cannot tell, the captured light does: without any alignment, pictures are as good as with it.
#[test]
fn told_the_captured_light_raw_figures_are_near_aligned_ones() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("report.json");
    let (demo, to) = (demo(), path.to_str().unwrap());
    let args = ["eval", &demo, "--protocol", "novel-view", "--json", to];
    let figures = |more: &[&str]| {
        succeeds(&[&args[..], more].concat());
        let report = json(&path);
        let value = |place: &str| report.pointer(place).unwrap().as_f64().unwrap();
        let notes = report["notes"].to_string();
        (value("/raw/psnr"), value("/slr/psnr"), notes)
    };
    let (raw, aligned, notes) = figures(&["--captured-light"]);
    assert!(
        aligned - raw < 0.7,
        "{raw} without alignment, {aligned} with it"
    );
    assert!(
        notes.contains("told") && notes.contains("averaged"),
        "{notes}"
    );
    let (unknown, _, notes) = figures(&["--detail", "1"]);
    assert!(raw > unknown, "{raw} told, {unknown} not");
    assert!(
        !notes.contains("told") && !notes.contains("averaged"),
        "{notes}"
    );
}

#[test]
fn wrong_uses_are_named() {
    let demo = demo();
    let eval = |more: &[&str], status: i32, words: &[&str]| {
        fails(&[&["eval", demo.as_str()], more].concat(), status, words);
    };
    eval(
        &["--protocol", "novel-view", "--inputs", "16"],
        1,
        &["spot", "8 input views"],
    );
    eval(
        &["--protocol", "light", "--captured-light"],
        1,
        &["--captured-light"],
    );
    eval(
        &["--protocol", "progressive", "--detail", "2"],
        1,
        &["--detail", "novel-view", "runtime"],
    );
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
    fails(&["score", &demo], 1, &["--method NAME=PREDICTIONS"]);
    let twice = format!("a={empty}");
    fails(
        &["score", &demo, "--method", &twice, &twice],
        1,
        &["names that differ"],
    );
    fails(
        &["score", empty, &demo, "--method", &twice],
        1,
        &["TRUTH alone"],
    );
    fails(&["score", &demo, "--method", empty], 2, &["NAME=FOLDER"]);
}
