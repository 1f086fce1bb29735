//! Stanford-ORB and Objects with Lighting from end to end, on trees in their published layouts that
//! `examples/benchmark_trees` makes of the bundled object.
#![allow(clippy::unwrap_used)]

#[path = "../examples/benchmark_trees/trees.rs"]
mod trees;

use lumi_core::glam::{Mat3, Vec3};
use lumi_core::image::write_png;
use lumi_core::{Light, LinearImage, Role, Scene};
use lumi_eval::cases::Subject;
use lumi_eval::{Collection, Picture};
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::Command;

fn demo() -> Scene {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("assets/demo/spot");
    lumi_data::open(path).unwrap()
}

/// Runs `lumi`, which must end with `status`; what it printed.
fn lumi(args: &[&str], status: i32) -> String {
    let output = Command::new(env!("CARGO_BIN_EXE_lumi"))
        .args(args)
        .output()
        .unwrap();
    let text = String::from_utf8_lossy(&output.stdout).into_owned()
        + &String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(status), "{args:?}: {text}");
    text
}

fn json(path: &Path) -> Value {
    serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap()
}

fn number(report: &Value, place: &str) -> f64 {
    let value = report.pointer(place);
    let value = value.unwrap_or_else(|| panic!("{place} is missing"));
    value.as_f64().unwrap_or_else(|| panic!("{place}: {value}"))
}

/// Side of saved predictions.
const SIDE: usize = 64;

/// Saves the truth of an object as predictions in `folder`: `value` of the linear values as EXR, or of the display
/// values as PNG.
fn predict(
    data: &Path,
    object: &str,
    folder: &Path,
    linear: bool,
    value: impl Fn([f32; 3]) -> [f32; 3] + Sync,
) {
    let collection = Collection::open(data).unwrap();
    let subject = Subject::load(&collection, object, 8, false, SIDE, |_| 1).unwrap();
    for case in &subject.targets {
        let target = subject.target(case).unwrap();
        let place = folder.join(object).join(case);
        std::fs::create_dir_all(&place).unwrap();
        for (view, truth) in target.views.iter().zip(&target.truth) {
            if linear {
                let pixels = (0..SIDE * SIDE).map(|i| {
                    let [r, g, b] = truth.linear_at(i);
                    [r, g, b, 1.0]
                });
                let image = LinearImage {
                    width: SIDE,
                    height: SIDE,
                    pixels: pixels.collect(),
                };
                trees::write_rgb_exr(&place.join(format!("{view}.exr")), &image, &value).unwrap();
            } else {
                let mut shown = truth.shown.clone();
                shown.pixels.iter_mut().for_each(|p| *p = value(*p));
                write_png(place.join(format!("{view}.png")), &shown).unwrap();
            }
        }
    }
}

struct Tree {
    folder: tempfile::TempDir,
    data: PathBuf,
    object: &'static str,
    rules: &'static str,
}

impl Tree {
    fn stanford_orb(part: &str) -> Self {
        let folder = tempfile::tempdir().unwrap();
        trees::stanford_orb(&demo(), folder.path()).unwrap();
        Self {
            data: folder.path().join(part),
            folder,
            object: "spot_scene001",
            rules: "stanford-orb",
        }
    }

    fn objects_with_lighting() -> Self {
        let folder = tempfile::tempdir().unwrap();
        trees::objects_with_lighting(&demo(), folder.path()).unwrap();
        Self {
            data: folder.path().join("dataset"),
            folder,
            object: "spot",
            rules: "objects-with-lighting",
        }
    }

    /// The benchmark's rules, for the one object.
    fn judging(&self) -> [&str; 6] {
        [
            "--rules",
            self.rules,
            "--lpips",
            "alex",
            "--only",
            self.object,
        ]
    }

    /// The report of `lumi score` for predictions made from the truth.
    fn scored(&self, linear: bool, value: impl Fn([f32; 3]) -> [f32; 3] + Sync) -> Value {
        let folder = tempfile::tempdir_in(self.folder.path()).unwrap();
        predict(&self.data, self.object, folder.path(), linear, value);
        let report = folder.path().join("report.json");
        let [predictions, data, to] =
            [folder.path(), &self.data, &report].map(|p| p.to_str().unwrap());
        let args = ["score", predictions, data, "--json", to];
        lumi(&[&args[..], &self.judging()].concat(), 0);
        json(&report)
    }

    /// The report of `lumi eval` with the bundled model, and the folder that it wrote.
    fn evaluated(&self) -> (Value, PathBuf) {
        let out = self.folder.path().join("out");
        let [data, to] = [&self.data, &out].map(|p| p.to_str().unwrap());
        let args = ["eval", data, "--protocol", "novel-view", "--out", to];
        lumi(&[&args[..], &self.judging()].concat(), 0);
        (json(&out.join("report.json")), out)
    }
}

#[test]
fn stanford_orb_end_to_end() {
    let tree = Tree::stanford_orb("blender_HDR");
    let (report, out) = tree.evaluated();
    assert_eq!(report["settings"]["rules"], "stanford-orb");
    assert_eq!(report["settings"]["headline"], "ilr");
    let cases = &report["per_object"]["spot_scene001"]["cases"];
    let names: Vec<&String> = cases.as_object().unwrap().keys().collect();
    assert_eq!(names, ["spot_scene001", "spot_scene002", "spot_scene003"]);
    for name in names {
        assert_eq!(cases[name]["views"].as_array().unwrap().len(), 3, "{name}");
    }
    for place in [
        "/ilr/psnr",
        "/ilr/psnr_hdr",
        "/ilr/ssim",
        "/trivial/nearest/ilr/psnr_hdr",
    ] {
        assert!(number(&report, place).is_finite());
    }
    assert!(number(&report, "/tone/spread") > 0.0);
    // Honest about what a model of display-encoded images can know.
    assert!(report["notes"].to_string().contains("limits PSNR-H"));
    let text = std::fs::read_to_string(out.join("report.md")).unwrap();
    assert!(
        text.contains("## As `stanford-orb` reports it (`ilr`)"),
        "{text}"
    );
    assert!(
        text.contains("| method | PSNR-L ↑ | SSIM ↑ | LPIPS ↓ | PSNR-H ↑ |"),
        "{text}"
    );
    assert!(out.join("grid.png").is_file());

    // Photographs of 8 bits have no PSNR-H, which is said and not made up.
    let (report, _) = Tree::stanford_orb("blender_LDR").evaluated();
    assert!(report.pointer("/ilr/psnr_hdr").unwrap().is_null());
    assert!(
        report["notes"]
            .to_string()
            .contains("PSNR-H is not reported")
    );
}

#[test]
fn stanford_orb_forgives_a_scale_per_channel() {
    let tree = Tree::stanford_orb("blender_HDR");
    let perfect = tree.scored(true, |p| p);
    for place in ["/raw/psnr", "/raw/psnr_hdr", "/ilr/psnr", "/ilr/psnr_hdr"] {
        assert!(number(&perfect, place) > 60.0, "{place}: {perfect}");
    }
    assert!(number(&perfect, "/ilr/ssim") > 0.9999 && number(&perfect, "/ilr/lpips") < 1e-3);
    assert_eq!(perfect["notes"].as_array().map_or(0, Vec::len), 0);
    // Beyond white after scaling, so only a scale on unclipped values can take it back.
    let scaled = tree.scored(true, |[r, g, b]| [20.0 * r, 6.0 * g, 0.3 * b]);
    let (raw, whole) = ("/object_only/raw/psnr", number(&scaled, "/raw/psnr"));
    assert!(number(&scaled, raw) < 15.0 && whole < 30.0, "{whole}");
    for place in ["/ilr/psnr", "/ilr/psnr_hdr", "/slr/psnr", "/slr/psnr_hdr"] {
        assert!(number(&scaled, place) > 55.0, "{place}: {scaled}");
    }
    // The same pictures as PNG: only highlights are lost, and the report says so.
    let clipped = tree.scored(false, |p| p);
    assert!(clipped["notes"].to_string().contains("limits PSNR-H"));
    assert!(number(&clipped, "/raw/psnr") > 45.0);
    assert!(number(&clipped, "/raw/psnr_hdr") < number(&perfect, "/raw/psnr_hdr") - 10.0);
}

#[test]
fn objects_with_lighting_end_to_end() {
    let tree = Tree::objects_with_lighting();
    let (report, out) = tree.evaluated();
    let cases = report["per_object"]["spot"]["cases"].as_object().unwrap();
    // Two environments, three photographs in each, every one with a map of its own.
    assert_eq!(cases.len(), 2 * trees::HELD_OUT);
    assert!(cases.contains_key("gt_env_0000"));
    assert_eq!(report["settings"]["headline"], "object_only.raw");
    for place in [
        "/object_only/raw/psnr",
        "/object_only/exposure/psnr",
        "/object_only/raw/lpips",
    ] {
        assert!(number(&report, place).is_finite());
    }
    let text = std::fs::read_to_string(out.join("report.md")).unwrap();
    assert!(text.contains("## As `objects-with-lighting` reports it (`object_only.raw`)"));
    // One object named on its own is found too, by its own name.
    let object = tree.data.join("spot/test");
    let collection = Collection::open(object).unwrap();
    assert_eq!(collection.names(&[], &[]).unwrap(), ["spot"]);
}

#[test]
fn objects_with_lighting_forgives_the_exposure_of_linear_predictions() {
    let tree = Tree::objects_with_lighting();
    let psnr =
        |report: &Value, alignment: &str| number(report, &format!("/object_only/{alignment}/psnr"));
    // Photographs have 8 bits.
    let perfect = tree.scored(false, |p| p);
    assert!(psnr(&perfect, "raw") > 45.0, "{perfect}");
    assert_eq!(perfect["settings"]["headline"], "object_only.raw");
    let scaled = tree.scored(true, |[r, g, b]| [3.0 * r, 4.0 * g, 5.5 * b]);
    assert_eq!(scaled["settings"]["headline"], "object_only.exposure");
    assert!(psnr(&scaled, "raw") < 15.0, "{scaled}");
    assert!(psnr(&scaled, "exposure") > 40.0, "{scaled}");
    // A balance beyond a half or two is not forgiven.
    let tinted = tree.scored(true, |[r, g, b]| [r, g, 9.0 * b]);
    assert!(psnr(&tinted, "exposure") < 30.0, "{tinted}");
    // Nor is anything in tone-mapped predictions.
    let dark = tree.scored(false, |p| p.map(|v| 0.7 * v));
    assert_eq!(dark["settings"]["headline"], "object_only.raw");
    assert!(psnr(&dark, "raw") < 25.0, "{dark}");
}

/// Correlation of two lights over directions, both seen in the axes of a camera.
fn correlation(a: impl Fn(Vec3) -> [f32; 3], b: impl Fn(Vec3) -> [f32; 3]) -> f64 {
    let n = 2000;
    let pairs = (0..n).map(|i| {
        let z = 1.0 - 2.0 * (i as f32 + 0.5) / n as f32;
        let (s, c) = (2.399_963 * i as f32).sin_cos();
        let r = (1.0 - z * z).sqrt();
        let d = Vec3::new(r * c, r * s, z);
        let brightness = |v: [f32; 3]| f64::from(0.01 + v.iter().sum::<f32>()).ln();
        (brightness(a(d)), brightness(b(d)))
    });
    let pairs: Vec<(f64, f64)> = pairs.collect();
    let mean = |f: &dyn Fn(&(f64, f64)) -> f64| pairs.iter().map(f).sum::<f64>() / f64::from(n);
    let (x, y) = (mean(&|p| p.0), mean(&|p| p.1));
    let covariance = mean(&|p| (p.0 - x) * (p.1 - y));
    covariance / (mean(&|p| (p.0 - x).powi(2)) * mean(&|p| (p.1 - y).powi(2))).sqrt()
}

/// However a benchmark's worlds, cameras and maps are turned: seen from the camera, the light of each photograph must
/// be where it was when the photograph was rendered.
#[test]
fn light_comes_from_where_it_came() {
    let scene = demo();
    let shoots = trees::shoots(&scene).unwrap();
    let orb = Tree::stanford_orb("blender_LDR");
    let owl = Tree::objects_with_lighting();
    let mut compared = 0;
    for folder in [orb.data.join("spot_scene002"), owl.data.join("spot/test")] {
        let read = lumi_data::open(&folder).unwrap();
        for (i, view) in read.views.iter().enumerate() {
            if view.role == Role::Input {
                continue;
            }
            let [named] = read.lights_of(i) else {
                panic!("{}: expected one light", view.name);
            };
            let Light::Environment(light) = &named.light else {
                panic!("expected an environment");
            };
            // Which photograph it is: the one of the same view in the same environment.
            let (k, original) = match view.name.split_once("gt_") {
                Some((_, number)) => {
                    let at: usize = number.parse().unwrap();
                    let k = 1 + at / trees::HELD_OUT;
                    (k, shoots[k].held_out[at % trees::HELD_OUT])
                }
                None => {
                    let k: usize = named.name.rsplit("scene").next().unwrap().parse().unwrap();
                    (
                        k - 1,
                        view.name.rsplit('_').next().unwrap().parse().unwrap(),
                    )
                }
            };
            let axes = |camera: &lumi_core::Camera| Mat3::from_mat4(camera.camera_to_world);
            let (there, here) = (axes(&scene.views[original].camera), axes(&view.camera));
            let truth = |d: Vec3| shoots[k].environment.radiance(there * d);
            let found = correlation(|d| light.radiance(here * d), truth);
            assert!(found > 0.95, "{}: {found}", view.name);
            // Mirrored, turned or upside down it does not fit.
            let wrong: [fn(Vec3) -> Vec3; 3] = [
                |d| Vec3::new(-d.x, d.y, d.z),
                |d| Vec3::new(d.z, d.y, -d.x),
                |d| Vec3::new(d.x, -d.y, d.z),
            ];
            for turn in wrong {
                let off = correlation(|d| light.radiance(here * turn(d)), truth);
                assert!(off < found - 0.05, "{}: {off} beside {found}", view.name);
            }
            // And it is as bright as it was: what it brings from all sides, times the photograph's exposure.
            let sum = |light: &dyn Fn(Vec3) -> [f32; 3]| -> f32 {
                let n = 4000;
                let directions = (0..n).map(|i| {
                    let z = 1.0 - 2.0 * (i as f32 + 0.5) / n as f32;
                    let (s, c) = (2.399_963 * i as f32).sin_cos();
                    let r = (1.0 - z * z).sqrt();
                    Vec3::new(r * c, r * s, z)
                });
                directions.map(|d| light(d)[1]).sum()
            };
            let ratio = sum(&|d| light.radiance(d)) / (shoots[k].gain * sum(&truth));
            assert!((ratio - 1.0).abs() < 0.1, "{}: {ratio}", view.name);
            compared += 1;
        }
    }
    // Nine photographs of three captures, six of two environments.
    assert_eq!(compared, 9 + 6);
    // The photographs themselves are those of the object.
    let subject = |data: &Path, object: &str| {
        let collection = Collection::open(data).unwrap();
        Subject::load(&collection, object, 8, false, SIDE, |_| 1).unwrap()
    };
    let target = subject(&owl.data, "spot").target("gt_env_0000").unwrap();
    let Picture { shown, linear } = &target.truth[0];
    assert!(linear.is_none() && shown.alpha.is_some());
}
