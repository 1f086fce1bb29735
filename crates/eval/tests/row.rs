//! One object's row, recomputed by `tools/eval_golden.py` with numpy and scikit-image, for predictions that were
//! saved once by the bundled model of that day.
#![allow(clippy::unwrap_used)]

use burn::tensor::Device;
use lumi_eval::figures::Aligned;
use lumi_eval::report::Report;
use lumi_eval::rules::{PAPER, RULES};
use lumi_eval::score::{Method, Truth, score};
use lumi_eval::{Judge, Lpips, Picture, Protocol};
use serde_json::Value;
use std::path::{Path, PathBuf};

fn here(path: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(path)
}

fn judge() -> Judge {
    let device = Device::flex();
    Judge::new(PAPER, Lpips::alex(&device).unwrap(), &device)
}

/// The report of the pictures in a folder.
fn scored(folder: PathBuf, truth: &Truth) -> lumi_eval::Result<Report> {
    let name = "ours".to_owned();
    let mut found = score(&[Method { name, folder }], truth, &judge(), &())?;
    Ok(found.reports.remove(0))
}

fn row() -> Report {
    let truth = Truth::open(&here("../../assets/demo"), Protocol::MultiView, &[], &[]);
    scored(here("tests/golden/predictions"), &truth.unwrap()).unwrap()
}

#[test]
fn the_row_equals_an_independent_computation() {
    let golden: Value = serde_json::from_str(include_str!("golden/row.json")).unwrap();
    let report = row();
    let record = &report.per_object[golden["object"].as_str().unwrap()];
    let mut compared = 0;
    let mut compare = |aligned: &Aligned, golden: &Value, place: &str| {
        for (alignment, scores) in aligned.variants() {
            for (metric, expected) in golden[alignment].as_object().unwrap() {
                let found = scores.get(metric).unwrap();
                let expected = expected.as_f64().unwrap();
                let tolerance = match metric.as_str() {
                    "lpips" => 1e-3,
                    "ssim" => 1e-4,
                    _ => 1e-3, // dB
                };
                assert!(
                    (found - expected).abs() < tolerance,
                    "{place}{alignment} {metric}: {found}, expected {expected}"
                );
                compared += 1;
            }
        }
    };
    compare(&record.figures.whole, &golden, "");
    compare(
        &record.figures.object_only,
        &golden["object_only"],
        "object only, ",
    );
    assert_eq!(compared, 2 * 5 * 4);
    let spread = record.figures.tone.spread.unwrap();
    assert!((spread - golden["spread"].as_f64().unwrap()).abs() < 1e-4);
    // One object: its row is the mean.
    assert_eq!(record.figures.whole, report.figures.whole);
}

#[test]
fn a_report_survives_being_written() {
    let report = row();
    let text = serde_json::to_string(&report).unwrap();
    let value: Value = serde_json::from_str(&text).unwrap();
    for path in [
        "ilr",
        "slr",
        "object_only/ilr",
        "trivial/nearest/slr",
        "per_object/spot/slr",
    ] {
        let place = value.pointer(&format!("/{path}")).unwrap();
        for metric in ["psnr", "ssim", "lpips"] {
            assert!(place[metric].is_f64(), "{path}/{metric}");
        }
    }
    let back: Report = serde_json::from_str(&text).unwrap();
    assert_eq!(back, report);
}

/// The truth itself as a folder of pictures with alpha, scored against itself and against what is missing.
#[test]
fn folders_of_pictures_are_scored() {
    let folder = tempfile::tempdir().unwrap();
    let place = |root: &str| folder.path().join(root).join("thing/light");
    let image = |shift: f32| {
        let mut image = lumi_core::DisplayImage::filled(40, 36, [0.0; 3]);
        for (i, p) in image.pixels.iter_mut().enumerate() {
            let v = (i % 40) as f32 / 40.0;
            *p = [v, 1.0 - v, 0.5 + shift];
        }
        image
    };
    for (root, shift) in [("truth", 0.0), ("ours", 0.1)] {
        std::fs::create_dir_all(place(root)).unwrap();
        for view in ["a", "b"] {
            let path = place(root).join(format!("{view}.png"));
            lumi_core::image::write_png(path, &image(shift)).unwrap();
        }
    }
    let truth = folder.path().join("truth");
    let truth = Truth::open(&truth, Protocol::NovelView, &[], &[]).unwrap();
    let score = |name: &str| scored(folder.path().join(name), &truth);
    let same = score("truth").unwrap();
    assert_eq!(same.figures.whole.raw.get("psnr"), Some(100.0));
    assert_eq!(same.figures.whole.raw.get("lpips"), Some(0.0));
    assert!(same.figures.tone.spread.unwrap() < 1e-6);
    let ours = score("ours").unwrap();
    // A blue of 0.5 against 0.6, rounded to bytes: −10·log₁₀((25/255)²/3).
    let expected = -10.0 * ((25.0_f64 / 255.0).powi(2) / 3.0).log10();
    let found = ours.figures.whole.raw.get("psnr").unwrap();
    assert!((found - expected).abs() < 0.2, "{found} against {expected}");
    std::fs::remove_file(place("ours").join("b.png")).unwrap();
    let message = score("ours").unwrap_err().to_string();
    assert!(message.contains("b.png"), "{message}");
    let message = score("nowhere").unwrap_err().to_string();
    assert!(message.contains("nowhere"), "{message}");
}

#[test]
fn every_rule_scores_a_perfect_prediction_perfectly() {
    let device = Device::flex();
    let mut truth = lumi_core::DisplayImage::filled(33, 33, [1.0; 3]);
    let mut alpha = vec![0.0; 33 * 33];
    for (i, (p, a)) in truth.pixels.iter_mut().zip(&mut alpha).enumerate() {
        if (8..25).contains(&(i % 33)) && (8..25).contains(&(i / 33)) {
            *p = [0.2, (i % 7) as f32 / 7.0, 0.6];
            *a = 1.0;
        }
    }
    truth.alpha = Some(alpha);
    for rules in RULES {
        let judge = Judge::new(*rules, Lpips::alex(&device).unwrap(), &device);
        let truth = [Picture::from(truth.clone())];
        let figures = judge
            .figures(&truth, &truth, lumi_eval::figures::Detail::Full)
            .unwrap();
        for part in [&figures.whole, &figures.object_only] {
            for (name, scores) in part.variants() {
                assert!(scores.get("psnr").unwrap() > 90.0, "{} {name}", rules.name);
                assert!(
                    scores.get("ssim").unwrap() > 0.9999,
                    "{} {name}",
                    rules.name
                );
                assert!(scores.get("lpips").unwrap() < 1e-4, "{} {name}", rules.name);
            }
        }
    }
}
