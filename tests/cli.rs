//! The command line as a person meets it: what works, and one clear error for each kind of bad input.
#![allow(clippy::unwrap_used)]

mod common;

use common::{fails, lumi};
use std::path::{Path, PathBuf};
use std::process::Command;

/// A private copy of the demo scene, to be broken.
fn scene(folder: &Path) -> PathBuf {
    let from = Path::new(env!("CARGO_MANIFEST_DIR")).join("assets/demo/spot");
    let to = folder.join("spot");
    std::fs::create_dir(&to).unwrap();
    for entry in std::fs::read_dir(from).unwrap() {
        let path = entry.unwrap().path();
        std::fs::copy(&path, to.join(path.file_name().unwrap())).unwrap();
    }
    to
}

fn replace(path: &Path, from: &str, to: &str) {
    let text = std::fs::read_to_string(path).unwrap();
    assert!(text.contains(from), "{from} in {}", path.display());
    std::fs::write(path, text.replacen(from, to, 1)).unwrap();
}

/// `relight` of a broken copy of the demo scene.
fn broken(break_it: impl Fn(&Path), words: &[&str]) {
    let folder = tempfile::tempdir().unwrap();
    let scene = scene(folder.path());
    break_it(&scene);
    let out = folder.path().join("out");
    let [scene, out] = [&scene, &out].map(|p| p.to_str().unwrap());
    fails(
        &["relight", scene, "--set", "point:1,-2,3", "--out", out],
        1,
        words,
    );
}

#[test]
fn relight_writes_views_sheet_report_and_tokens() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let scene = Path::new(env!("CARGO_MANIFEST_DIR")).join("assets/demo/spot");
    let scene = scene.to_str().unwrap();
    let (out, tokens) = (path("out"), path("spot.tokens"));
    let output = lumi(&[
        "relight",
        scene,
        "--inputs",
        "4",
        "--set",
        "point:1,-2,3,power=600",
        "--add",
        "area:-3,0,2,size=2",
        "--views",
        "orbit:3",
        "--exr",
        "--video",
        "--save-tokens",
        &tokens,
        "--out",
        &out,
    ]);
    assert!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    for file in [
        "views/orbit0000.png",
        "views/orbit0002.exr",
        "views.gif",
        "contact_sheet.png",
    ] {
        assert!(Path::new(&out).join(file).is_file(), "{file}");
    }
    let report = std::fs::read_to_string(Path::new(&out).join("report.json")).unwrap();
    let report: serde_json::Value = serde_json::from_str(&report).unwrap();
    assert_eq!(report["edits"][1]["edit"], "add area");
    assert_eq!(report["inputs"].as_array().unwrap().len(), 4);

    // The saved tokens go on where they were left; without further edits they give the same pictures.
    let again = path("again");
    let output = lumi(&[
        "relight", scene, "--tokens", &tokens, "--views", "orbit:3", "--out", &again,
    ]);
    assert!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    // A file may lie in the folder of the results, which is still to be made, but in no other that is not there.
    let (fresh, inside) = (path("fresh"), path("fresh/spot.tokens"));
    for (file, good) in [(inside, true), (path("nowhere/spot.tokens"), false)] {
        let output = lumi(&[
            "relight",
            scene,
            "--tokens",
            &tokens,
            "--views",
            "orbit:1",
            "--save-tokens",
            &file,
            "--out",
            &fresh,
        ]);
        let text = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.success(), good, "{text}");
        assert!(
            good == Path::new(&file).is_file() && (good || text.contains("nowhere")),
            "{text}"
        );
    }
    let read = |root: &str| std::fs::read(Path::new(root).join("views/orbit0001.png")).unwrap();
    assert_eq!(read(&out), read(&again));
}

#[test]
fn relight_is_told_the_captured_light() {
    let folder = tempfile::tempdir().unwrap();
    let scene = Path::new(env!("CARGO_MANIFEST_DIR")).join("assets/demo/spot");
    let map = scene.join("env0.map.exr");
    let (scene, map) = (scene.to_str().unwrap(), format!("env:{}", map.display()));
    let exposure = |name: &str, told: &[&str]| -> Vec<f64> {
        let out = folder.path().join(name);
        let base = [
            "relight",
            scene,
            "--set",
            "point:1,-2,3",
            "--views",
            "orbit:1",
        ];
        let output = lumi(&[&base[..], told, &["--out", out.to_str().unwrap()]].concat());
        let text = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success(), "{text}");
        let report = std::fs::read_to_string(out.join("report.json")).unwrap();
        let report: serde_json::Value = serde_json::from_str(&report).unwrap();
        serde_json::from_value(report["exposure"].clone()).unwrap()
    };
    let unasked = exposure("a", &[]);
    assert_eq!(exposure("b", &["--captured-light", "unknown"]), [1.0; 3]);
    assert_ne!(unasked, [1.0; 3]);
    assert_eq!(exposure("c", &["--captured-light", "known"]), unasked);
    let twice = format!("{map},strength=2");
    let once = exposure("d", &["--captured-light", &map]);
    for (once, twice) in once
        .iter()
        .zip(exposure("e", &["--captured-light", &twice]))
    {
        assert!((once / twice - 2.0).abs() < 1e-3, "{once} and {twice}");
    }
    fails(
        &[
            "relight",
            scene,
            "--captured-light",
            "lamp:1,2,3",
            "--out",
            "nowhere",
        ],
        1,
        &["--captured-light", "env:, point:, area:"],
    );
}

#[test]
fn relight_follows_a_path_of_camera_and_lights() {
    let folder = tempfile::tempdir().unwrap();
    let scene = Path::new(env!("CARGO_MANIFEST_DIR")).join("assets/demo/spot");
    let scene = scene.to_str().unwrap();
    let (path, out) = (folder.path().join("path.toml"), folder.path().join("out"));
    let (file, at) = (path.to_str().unwrap(), out.to_str().unwrap());
    let keys = |first: &str, second: &str| {
        let key = |lights: &str| {
            format!("[[key]]\ncamera = {{ azimuth = 30, elevation = 25 }}\nlights = [{lights}]\n")
        };
        let text = format!("frames = 3\n{}{}", key(first), key(second));
        std::fs::write(&path, text).unwrap();
    };
    let (left, right) = ("\"point:3,-2,2,power=900\"", "\"point:-3,2,2,power=900\"");
    keys(left, right);
    let relight = [
        "relight", scene, "--detail", "1", "--views", file, "--out", at,
    ];
    let output = lumi(&[&relight[..], &["--video"]].concat());
    let text = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{text}");
    assert!(out.join("views.gif").is_file());
    let read = |i: usize| std::fs::read(out.join(format!("views/frame000{i}.png"))).unwrap();
    assert!(read(0) != read(1) && read(1) != read(2), "the lamp moves");
    // The first frame is what its light makes of the scene when it is set.
    let camera = format!(
        "frames = 2\n{0}{0}",
        "[[key]]\ncamera = { azimuth = 30, elevation = 25 }\n"
    );
    std::fs::write(&path, camera).unwrap();
    let set = ["--set", "point:3,-2,2,power=900", "--overwrite"];
    let first = read(0);
    let output = lumi(&[&relight[..], &set].concat());
    assert!(output.status.success());
    assert_eq!(read(0), first);

    let wrong = |first: &str, second: &str, words: &[&str]| {
        keys(first, second);
        let elsewhere = ["relight", scene, "--views", file, "--out", "nowhere"];
        fails(&elsewhere, 1, words);
    };
    wrong(left, "", &["key[1]", "as many"]);
    wrong(left, "\"area:-3,2,2\"", &["key[1]", "lights[0]", "point"]);
    wrong(
        left,
        "\"lamp:1,2,3\"",
        &["path.toml", "key[1]", "env:, point:, area:"],
    );
    std::fs::write(&path, "frames = 3\n[[key]]\n").unwrap();
    let elsewhere = ["relight", scene, "--views", file, "--out", "nowhere"];
    fails(&elsewhere, 1, &["path.toml", "2 keys"]);
}

#[test]
fn relit_views_are_a_capture_and_results_are_not_mixed() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    let scene = Path::new(env!("CARGO_MANIFEST_DIR")).join("assets/demo/spot");
    let [scene, at] = [&scene, &out].map(|p| p.to_str().unwrap());
    let views = ["--views", "orbit:8", "--detail", "1", "--out", at];
    let relight = ["relight", scene, "--set", "point:1,-2,3"];
    let first = [&relight[..], &views, &["--to-dataset"]].concat();
    let output = lumi(&first);
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{said}");
    let dataset = out.join("dataset");
    let relit = lumi_data::open(&dataset).unwrap();
    assert_eq!(relit.views.len(), 8);
    for view in &relit.views {
        let alpha = view.image.as_ref().unwrap().alpha.as_ref().unwrap();
        assert!(alpha.iter().any(|a| *a > 0.9) && alpha.iter().any(|a| *a < 0.1));
    }
    let output = lumi(&["scene", "check", dataset.to_str().unwrap()]);
    assert!(output.status.success(), "poses and masks agree");

    // Refused, then replaced as a whole.
    let refused = lumi(&first);
    let said = String::from_utf8_lossy(&refused.stderr);
    assert!(
        !refused.status.success() && said.contains("--overwrite"),
        "{said}"
    );
    assert!(dataset.is_dir(), "what was there stays");
    let second = [&relight[..], &views, &["--overwrite"]].concat();
    assert!(lumi(&second).status.success());
    assert!(out.join("views").is_dir() && !dataset.exists());

    let more = [&relight[..], &["--inputs", "9", "--out", "elsewhere"]].concat();
    fails(&more, 1, &["--inputs 9", "at most 8"]);
}

#[test]
fn completions_and_manual_pages_name_every_command() {
    for shell in ["bash", "zsh", "fish", "powershell", "elvish"] {
        let output = lumi(&["completions", shell]);
        let text = String::from_utf8(output.stdout).unwrap();
        assert!(output.status.success());
        assert!(
            text.contains("relight") && text.contains("to-dataset"),
            "{shell}"
        );
    }
    let folder = tempfile::tempdir().unwrap();
    let output = lumi(&["man", "--out", folder.path().to_str().unwrap()]);
    assert!(output.status.success());
    for page in ["lumi.1", "lumi-relight.1", "lumi-scene-convert.1"] {
        let text = std::fs::read_to_string(folder.path().join(page)).unwrap();
        assert!(text.contains(".SH NAME"), "{page}");
    }
}

#[test]
fn every_step_gets_a_folder_and_an_edits_file_is_read() {
    let folder = tempfile::tempdir().unwrap();
    let scene = Path::new(env!("CARGO_MANIFEST_DIR")).join("assets/demo/spot");
    let edits = folder.path().join("edits.toml");
    let text = "[[edit]]\nmode = 'set'\nlights = ['sun:3,0,2,strength=2']\n\
        [[edit]]\nmode = 'add'\nlights = [{kind = 'spot', position = [0, 3, 2], angle = 30}]\n";
    std::fs::write(&edits, text).unwrap();
    let out = folder.path().join("out");
    let [scene, edits, at] = [&scene, &edits, &out].map(|p| p.to_str().unwrap());
    let output = lumi(&[
        "relight",
        scene,
        "--edits",
        edits,
        "--every-step",
        "--out",
        at,
    ]);
    assert!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    for step in ["step-0-no-edit", "step-1-set-sun", "step-2-add-spot"] {
        assert!(out.join(step).join("v08.png").is_file(), "{step}");
    }
    // The report has lights as they are written everywhere.
    let report = std::fs::read_to_string(out.join("report.json")).unwrap();
    let report: serde_json::Value = serde_json::from_str(&report).unwrap();
    let spot = &report["edits"][1]["lights"][0];
    assert_eq!(
        (&spot["kind"], &spot["angle"]),
        (&"spot".into(), &30.0.into())
    );
    assert_eq!(report["edits"][0]["lights"][0]["strength"], 2.0);
    std::fs::write(
        folder.path().join("edits.toml"),
        "[[edit]]\nmode = 'set'\nlight = []\n",
    )
    .unwrap();
    let bad = folder.path().join("bad");
    fails(
        &[
            "relight",
            scene,
            "--edits",
            edits,
            "--out",
            bad.to_str().unwrap(),
        ],
        1,
        &["edits.toml", "light"],
    );
}

#[test]
fn missing_and_corrupt_images_are_named() {
    broken(
        |s| std::fs::remove_file(s.join("v03_env0.exr")).unwrap(),
        &["v03_env0.exr"],
    );
    broken(
        |s| std::fs::write(s.join("v03_env0.exr"), b"not an image").unwrap(),
        &["v03_env0.exr"],
    );
    broken(
        |s| {
            let bytes = std::fs::read(s.join("v03_env0.exr")).unwrap();
            std::fs::write(s.join("v03_env0.exr"), &bytes[..bytes.len() / 2]).unwrap();
        },
        &["v03_env0.exr"],
    );
}

#[test]
fn nan_in_an_image_is_named() {
    broken(
        |s| {
            let path = s.join("v02_point1.exr");
            exr_with_nan(&path);
        },
        &["v02_point1.exr", "finite"],
    );
}

/// A 128×128 image with one pixel that is no number. (Our own writer refuses to write one.)
fn exr_with_nan(path: &Path) {
    let pixel = |x: usize, y: usize| {
        let red = if (x, y) == (5, 7) { f32::NAN } else { 0.5 };
        (red, 0.5_f32, 0.5_f32, 1.0_f32)
    };
    exr::prelude::write_rgba_file(path, 128, 128, pixel).unwrap();
}

#[test]
fn bad_cameras_and_sizes_are_named() {
    // The first entry of the first pose's rotation.
    let pose = |s: &Path| {
        let path = s.join("cameras.json");
        let text = std::fs::read_to_string(&path).unwrap();
        let mut value: serde_json::Value = serde_json::from_str(&text).unwrap();
        value["views"][0]["camera_to_world"][0][0] = 7.0.into();
        std::fs::write(path, value.to_string()).unwrap();
    };
    broken(pose, &["cameras.json", "v00", "rotation"]);
    let size = |s: &Path| replace(&s.join("cameras.json"), "\"width\": 128", "\"width\": 64");
    broken(size, &["64", "128"]);
    let syntax = |s: &Path| std::fs::write(s.join("lights.json"), "[{").unwrap();
    broken(syntax, &["lights.json", "line 1"]);
}

#[test]
fn lights_that_cannot_be_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let scene = Path::new(env!("CARGO_MANIFEST_DIR")).join("assets/demo/spot");
    let scene = scene.to_str().unwrap();
    let out = folder.path().join("out");
    let out = out.to_str().unwrap();
    let relight = |light: &str, status: i32, words: &[&str]| {
        fails(
            &["relight", scene, "--out", out, "--set", light],
            status,
            words,
        );
    };
    relight("point:0.1,0,0.1", 1, &["point.position", "outside"]);
    relight("point:1,2,3,colour=1,1,1", 2, &["unknown field `colour`"]);
    relight("lamp:1,2,3", 2, &["env:, point:, area:, spot:, sun:"]);
    relight("point:1,2,3,power=0", 2, &["point.power", "positive"]);
    relight("point:1,2,3,power=1e20", 2, &["point.power", "up to"]);
    relight("spot:1,2,3,angle=200", 2, &["spot.angle", "1 to 180"]);
    relight("sun:0,0,0", 2, &["sun.from", "direction"]);
    relight("point:1,2,3,color=255,0,0", 2, &["from 0 to 1"]);
    relight("area:1,2,3,target=1,2,3", 2, &["another place"]);
    relight("env:/nowhere/map.hdr", 1, &["/nowhere/map.hdr"]);

    // Before a model is looked for.
    for (light, words) in [
        ("point:0.1,0,0.1", ["point:0.1,0,0.1", "outside"]),
        ("spot:0,0,4,target=9,0,4,angle=20", ["spot.target", "cone"]),
    ] {
        let args = [
            "relight", scene, "--model", "/nowhere", "--out", out, "--add", light,
        ];
        fails(&args, 1, &words);
    }

    let dark = folder.path().join("dark.hdr");
    let black = image::Rgb32FImage::new(8, 4);
    image::DynamicImage::ImageRgb32F(black).save(&dark).unwrap();
    relight(
        &format!("env:{}", dark.display()),
        1,
        &["dark.hdr", "zero energy"],
    );
    fails(
        &[
            "relight",
            scene,
            "--out",
            out,
            "--set",
            "point:1,2,3,power=100",
            "--remove",
            "point:1,2,3,power=200",
        ],
        1,
        &["remove", "at most the light that is there"],
    );
    fails(
        &["relight", scene, "--out", out, "--source", "lamp9"],
        1,
        &["lamp9", "env0"],
    );
}

#[test]
fn empty_folders_and_unwritable_outputs_are_errors() {
    let folder = tempfile::tempdir().unwrap();
    let empty = folder.path().to_str().unwrap();
    fails(&["scene", "check", empty], 1, &["expected"]);
    let file = folder.path().join("file");
    std::fs::write(&file, "x").unwrap();
    let below = file.join("out");
    let below = below.to_str().unwrap();
    fails(&["demo", "--out", below], 1, &["expected a folder"]);
    let scene = Path::new(env!("CARGO_MANIFEST_DIR")).join("assets/demo/spot");
    fails(
        &["relight", scene.to_str().unwrap(), "--out", below],
        1,
        &["expected a folder"],
    );
    fails(&["frobnicate"], 2, &["frobnicate"]);
}

#[test]
fn scene_check_accepts_the_demo_scene() {
    let scene = Path::new(env!("CARGO_MANIFEST_DIR")).join("assets/demo/spot");
    let output = lumi(&["scene", "check", scene.to_str().unwrap()]);
    let text = String::from_utf8_lossy(&output.stdout);
    assert!(output.status.success(), "{text}");
    assert!(text.contains("env0") && text.contains("point3"), "{text}");
}

#[test]
fn an_unknown_instruction_set_is_an_error() {
    let mut command = Command::new(env!("CARGO_BIN_EXE_lumi"));
    let output = command
        .args(["scene", "check", "x"])
        .env("LUMI_CPU", "abacus")
        .output()
        .unwrap();
    assert_eq!(output.status.code(), Some(2));
    let text = String::from_utf8_lossy(&output.stderr);
    assert!(
        text.contains("abacus") && !text.contains("panicked"),
        "{text}"
    );
}

#[test]
fn a_pipe_that_nobody_reads_is_no_fault() {
    use std::process::Stdio;
    let spot = Path::new(env!("CARGO_MANIFEST_DIR")).join("assets/demo/spot");
    let spot = spot.to_str().unwrap();
    for args in [&["scene", "check", spot][..], &["eval", "--help"]] {
        let mut child = Command::new(env!("CARGO_BIN_EXE_lumi"))
            .args(args)
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        drop(child.stdout.take());
        let output = child.wait_with_output().unwrap();
        let text = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success(), "{args:?}: {}", output.status);
        assert!(!text.contains("panicked"), "{args:?}: {text}");
    }
}
