//! From photographs to a capture: `lumi scene prepare` with a stand-in for COLMAP that writes a known model, `lumi scene mask`,
//! and `relight` of what they make.
#![allow(clippy::unwrap_used)]
#![cfg(unix)]

use lumi_core::Scene;
use lumi_core::glam::Quat;
use lumi_core::image::write_png;
use lumi_data::{Lighting, views};
use lumi_testkit::demo;
use std::fmt::Write;
use std::os::unix::fs::PermissionsExt;
use std::path::PathBuf;
use std::process::{Command, Output};
use tempfile::TempDir;

/// What stands in for COLMAP: it takes the same arguments, and its mapper puts the model there that stands beside it.
const COLMAP: &str = r#"#!/bin/sh
step=$1; shift
while [ $# -gt 0 ]; do
  case $1 in
    --help) echo "  --SiftExtraction.use_gpu arg (=1)"; exit 0;;
    --output_path) out=$2;;
    --image_path) images=$2;;
  esac
  shift
done
case $step in
  feature_extractor) ls "$images" | while read name; do echo "Processed file [$name]"; done;;
  exhaustive_matcher) echo "Matching block [1/1, 1/1]";;
  mapper)
    echo "Registering image #1 (1)"
    here=$(dirname "$0")
    [ -d "$here/model" ] || { echo "no good initial pair" >&2; exit 1; }
    cp -r "$here/model" "$out/0";;
esac
"#;

/// A folder with photographs of the demo object before a plain ground, a stand-in for COLMAP, and its model of all but the last.
struct Studio {
    folder: TempDir,
    scene: Scene,
}

impl Studio {
    fn new() -> Self {
        let scene = lumi_data::open(demo().join("spot")).unwrap();
        let mut scene = views::photographed(&scene, &Lighting::single("env0")).unwrap();
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        for name in ["photos", "masks", "bin", "bin/model"] {
            std::fs::create_dir(at(name)).unwrap();
        }
        let mut images = String::new();
        for (i, view) in scene.views.iter_mut().enumerate() {
            let mut image = view.image.take().unwrap();
            let alpha = image.alpha.take().unwrap();
            let file = format!("{}.png", view.name);
            let mut mask = image.clone();
            for ((pixel, mask), a) in image.pixels.iter_mut().zip(&mut mask.pixels).zip(alpha) {
                let ground = [0.25, 0.35, 0.45];
                *pixel = [0, 1, 2].map(|c| pixel[c] - (1.0 - a) * (1.0 - ground[c]));
                *mask = [a; 3];
            }
            write_png(at("photos").join(&file), &image).unwrap();
            write_png(at("masks").join(&file), &mask).unwrap();
            let to_camera = view.camera.camera_to_world.inverse();
            let (q, t) = (Quat::from_mat4(&to_camera), to_camera.w_axis);
            writeln!(
                images,
                "{} {} {} {} {} {} {} {} 1 {file}\n",
                i + 1,
                q.w,
                q.x,
                q.y,
                q.z,
                t.x,
                t.y,
                t.z
            )
            .unwrap();
        }
        let images: Vec<&str> = images.lines().collect();
        let known = images[..images.len() - 2].join("\n") + "\n";
        std::fs::write(at("bin/model/images.txt"), known).unwrap();
        let c = scene.views[0].camera;
        let camera = format!(
            "1 PINHOLE {} {} {} {} {} {}\n",
            c.width, c.height, c.fx, c.fy, c.cx, c.cy
        );
        std::fs::write(at("bin/model/cameras.txt"), camera).unwrap();
        std::fs::write(at("bin/colmap"), COLMAP).unwrap();
        std::fs::set_permissions(at("bin/colmap"), PermissionsExt::from_mode(0o755)).unwrap();
        Self { folder, scene }
    }

    fn at(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// `lumi` with `arguments`, of which those that begin with `@` are paths in the folder.
    fn lumi(&self, arguments: &str) -> Output {
        let arguments = arguments.split(' ').map(|a| match a.strip_prefix('@') {
            Some(name) => self.at(name).into_os_string(),
            None => a.into(),
        });
        // Without the stand-in no other COLMAP either.
        let mut path = self.at("bin").into_os_string();
        if self.at("bin/colmap").exists() {
            path.push(":/usr/bin:/bin");
        }
        Command::new(env!("CARGO_BIN_EXE_lumi"))
            .args(arguments)
            .env("PATH", path)
            .output()
            .unwrap()
    }

    fn works(&self, arguments: &str) -> String {
        let output = self.lumi(arguments);
        let text = said(&output);
        assert!(output.status.success(), "{arguments}: {text}");
        text
    }

    /// Fails with all `words`, and leaves nothing at `@out` or around it.
    fn fails(&self, arguments: &str, words: &[&str]) {
        let output = self.lumi(arguments);
        let text = said(&output);
        assert_eq!(output.status.code(), Some(1), "{arguments}: {text}");
        for word in words {
            assert!(
                text.contains(word),
                "{arguments}: expected `{word}` in: {text}"
            );
        }
        assert!(!self.at("out").exists(), "{arguments} left output behind");
        let names = std::fs::read_dir(self.folder.path()).unwrap();
        let mut names = names.map(|e| e.unwrap().file_name().into_string().unwrap());
        let left = names.find(|name| name.starts_with(".lumi"));
        assert_eq!(left, None, "{arguments}");
    }
}

fn said(output: &Output) -> String {
    String::from_utf8_lossy(&output.stdout).into_owned() + &String::from_utf8_lossy(&output.stderr)
}

#[test]
fn photographs_become_a_capture_that_is_relit() {
    let studio = Studio::new();
    let text = studio.works("scene prepare @photos --out @out");
    let count = studio.scene.views.len();
    let last = &studio.scene.views[count - 1].name;
    assert!(
        text.contains(&format!(
            "no pose for 1 of {count} photographs, which are left out: {last}.png"
        )),
        "{text}"
    );
    assert!(
        text.contains(&format!("masks     {} of {}", count - 1, count - 1)),
        "{text}"
    );
    assert!(studio.at("out.colmap.log").is_file());
    assert!(studio.at("out/report.json").is_file());

    // Poses are the model's but for a similarity: of each camera's distances from the others nothing is left but the scale.
    let made = lumi_data::open(studio.at("out")).unwrap();
    assert!(
        made.to_model
            .inverse()
            .point(lumi_core::glam::Vec3::ZERO)
            .length()
            < 1e-3
    );
    assert!((made.to_model.scale - 1.0).abs() < 1e-3);
    let apart = |scene: &Scene, i: usize, j: usize| {
        scene.views[i]
            .camera
            .centre()
            .distance(scene.views[j].camera.centre())
    };
    let scale = apart(&made, 0, 5) / apart(&studio.scene, 0, 5);
    for i in 1..made.views.len() {
        assert_eq!(made.views[i].name, studio.scene.views[i].name);
        let expected = scale * apart(&studio.scene, 0, i);
        assert!(
            (apart(&made, 0, i) - expected).abs() < 1e-3 * expected,
            "view {i}"
        );
    }

    // What stands there is only replaced when that is asked for.
    let again = studio.lumi("scene prepare @photos --out @out");
    assert!(!again.status.success() && said(&again).contains("--overwrite"));
    let text = studio.works("scene prepare @photos --masks @masks --overwrite --out @out");
    assert!(text.contains(" IoU 0.9"), "{text}");
    studio.works("relight @out --inputs 4 --set point:2,-2,3 --views orbit:1 --out @relit");
    assert!(studio.at("relit/views/orbit0000.png").is_file());
}

#[test]
fn without_masks_relight_stops_before_it_begins() {
    let studio = Studio::new();
    studio.works("scene prepare @photos --no-mask --out @plain");
    studio.fails(
        "relight @plain --set point:2,-2,9 --out @out",
        &[
            "expected masks",
            "lumi scene mask",
            "--no-mask",
            "warning: masks",
        ],
    );
    studio.works(
        "relight @plain --no-mask --inputs 2 --set point:2,-2,9 --views orbit:1 --out @relit",
    );
    studio.works("scene mask @plain --out @masked");
    let masked = lumi_data::open(studio.at("masked")).unwrap();
    assert!(
        masked
            .views
            .iter()
            .all(|v| v.image.as_ref().unwrap().alpha.is_some())
    );
    studio.fails("scene mask @masked --out @out", &["without masks"]);
    studio.fails("scene mask @plain --out @plain/out", &["outside"]);
}

#[test]
fn known_poses_are_kept() {
    let studio = Studio::new();
    studio.works("scene prepare @photos --poses @bin/model --masks @masks --out @first");
    let first = lumi_data::open(studio.at("first")).unwrap();
    // Its poses again, with the file of their own.
    std::fs::remove_file(studio.at("bin/colmap")).unwrap();
    studio
        .works("scene prepare @photos --poses @first/transforms.json --masks @masks --out @second");
    let second = lumi_data::open(studio.at("second")).unwrap();
    assert_eq!(first.views.len(), second.views.len());
    for (a, b) in first.views.iter().zip(&second.views) {
        let (a, b) = (a.camera.camera_to_world, b.camera.camera_to_world);
        assert!(a.abs_diff_eq(b, 1e-5), "{a} {b}");
    }
    studio.fails(
        "scene prepare @photos --poses @masks --out @out",
        &["--poses", "transforms.json"],
    );
}

#[test]
fn what_cannot_be_prepared_is_named() {
    let studio = Studio::new();
    let view = |i: usize| studio.scene.views[i].name.clone();
    let remove = |path: PathBuf| std::fs::remove_file(path).unwrap();

    // Masks that are missing or of another size.
    let mask = studio.at("masks").join(format!("{}.png", view(2)));
    let small = lumi_core::DisplayImage::filled(8, 8, [1.0; 3]);
    write_png(&mask, &small).unwrap();
    let file = format!("masks/{}.png", view(2));
    studio.fails(
        "scene prepare @photos --masks @masks --out @out",
        &[&file, "8×8"],
    );
    remove(mask);
    studio.fails(
        "scene prepare @photos --masks @masks --out @out",
        &[&file, "found none"],
    );

    // Photographs that are none, or too few.
    studio.fails(
        "scene prepare @nowhere --out @out",
        &["nowhere", "found nothing"],
    );
    studio.fails(
        "scene prepare @bin/model --out @out",
        &["two photographs or more"],
    );
    std::fs::write(studio.at("photos/a.heic"), b"\0\0\0\x18ftypheic").unwrap();
    studio.fails("scene prepare @photos --out @out", &["a.heic", "HEIC"]);
    remove(studio.at("photos/a.heic"));

    // COLMAP that finds nothing, and none at all.
    std::fs::rename(studio.at("bin/model"), studio.at("model")).unwrap();
    studio.fails(
        "scene prepare @photos --out @out",
        &["no poses", "out.colmap.log"],
    );
    let log = std::fs::read_to_string(studio.at("out.colmap.log")).unwrap();
    assert!(
        log.contains("Processed file") && log.contains("no good initial pair"),
        "{log}"
    );
    remove(studio.at("bin/colmap"));
    studio.fails(
        "scene prepare @photos --out @out",
        &["apt install colmap", "--poses"],
    );
}
