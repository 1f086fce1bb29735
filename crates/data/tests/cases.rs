//! Inputs that people bring, as public bug reports of neighbouring tools describe them: each reads with its right
//! values, or is refused with the reason. They lie in `data/cases`, a folder each.
#![allow(clippy::unwrap_used)]

use lumi_core::{EnvMap, Light, Role, Scene};
use lumi_data::check::check_folder;
use lumi_data::formats::{self, convert};
use lumi_data::open;
use std::path::{Path, PathBuf};

/// Share of a 32 × 32 picture that the ball of these captures covers.
const COVERED: f32 = 0.359;

fn case(name: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/cases");
    let folder = folder.join(name);
    let scene = folder.join("scene");
    if scene.is_dir() { scene } else { folder }
}

fn read(name: &str) -> Scene {
    open(case(name)).unwrap()
}

fn refused(name: &str) -> String {
    open(case(name)).expect_err(name).to_string()
}

fn names(scene: &Scene, role: Role) -> Vec<&str> {
    let views = scene.with_role(role).into_iter();
    views.map(|i| scene.views[i].name.as_str()).collect()
}

/// Mean coverage of each view.
fn coverage(scene: &Scene) -> Vec<f32> {
    let mean = |a: &Vec<f32>| a.iter().sum::<f32>() / a.len() as f32;
    let alpha = scene
        .views
        .iter()
        .map(|v| v.image.as_ref().unwrap().alpha.as_ref());
    alpha.map(|a| mean(a.expect("a mask"))).collect()
}

fn is_covered(scene: &Scene) {
    for c in coverage(scene) {
        assert!((c - COVERED).abs() < 2e-3, "{c}");
    }
    has_ball(scene);
}

/// The ball of all these captures: at the origin, of radius 0.7.
fn has_ball(scene: &Scene) {
    let ball = scene.to_model.inverse();
    assert!(
        ball.translation.length() < 0.02 && (ball.scale - 0.7).abs() < 0.02,
        "{ball:?}"
    );
}

fn map(scene: &Scene) -> &EnvMap {
    match &scene.basis.as_ref().unwrap().lights[0].light {
        Light::Environment(light) => &light.map,
        other => panic!("an environment, not {}", other.kind()),
    }
}

fn has_pixel(map: &EnvMap, expected: [f32; 3], tolerance: f32) {
    let found = map.pixels[3 * map.width + 5];
    for (a, b) in found.iter().zip(expected) {
        assert!((a - b).abs() <= tolerance * b, "{found:?} {expected:?}");
    }
}

#[test]
fn case_01_any_radiance_signature() {
    let scene = read("01-hdr-rgbe-signature");
    assert_eq!(scene.warnings, Vec::<String>::new());
    has_pixel(map(&scene), [0.725, 0.575, 0.8], 0.01);
}

#[test]
fn case_02_a_cut_jpeg() {
    let message = refused("02-jpeg-truncated");
    assert!(
        message.contains("001.jpg") && message.contains("complete"),
        "{message}"
    );
}

#[test]
fn case_03_lists_spell_paths_otherwise() {
    let scene = read("03-split-names-spelled-otherwise");
    assert_eq!(names(&scene, Role::Target), ["004", "005"]);
    assert_eq!(names(&scene, Role::Input), ["000", "001", "002", "003"]);
}

#[test]
fn case_04_a_frame_in_no_list() {
    let scene = read("04-split-frames-in-no-list");
    assert_eq!(names(&scene, Role::Input), ["000", "001", "002"]);
    assert_eq!(names(&scene, Role::Target), ["003", "004"]);
    assert_eq!(
        scene.warnings,
        ["frames: 1 of 6 are in no list and unused: images/005.png"]
    );
}

#[test]
fn case_06_masks_as_opaque_rgba() {
    is_covered(&read("06-mask-rgba-opaque"));
}

#[test]
fn case_08_masks_with_a_palette() {
    let scene = read("08-mask-colour-palette");
    is_covered(&scene);
    let alpha = scene.views[0]
        .image
        .as_ref()
        .unwrap()
        .alpha
        .as_ref()
        .unwrap();
    assert!(alpha.iter().all(|a| *a == 0.0 || *a == 1.0));
}

#[test]
fn case_10_frames_cropped_to_a_data_window() {
    let scene = read("10-exr-data-window-frames");
    for view in &scene.views {
        let camera = &view.camera;
        assert_eq!((camera.width, camera.height), (32, 32));
        assert!((camera.fx - 44.8).abs() < 1e-3, "{}", camera.fx);
    }
    is_covered(&scene);
}

#[test]
fn case_11_normals_before_the_picture() {
    let scene = read("11-exr-multipart-normals-first");
    has_pixel(map(&scene), [0.725, 0.575, 0.8], 2e-3);
}

#[test]
fn case_12_alpha_in_a_part_of_its_own() {
    is_covered(&read("12-exr-multipart-alpha-elsewhere"));
}

#[test]
fn case_14_two_models() {
    let scene = read("14-colmap-two-models");
    assert_eq!(names(&scene, Role::Input).len(), 4);
    assert_eq!(
        scene.warnings,
        ["model: took sparse/1 (4 images); there is also sparse/0 (2 images)"]
    );
    has_ball(&scene);
}

#[test]
fn case_16_a_model_below_colmap() {
    let folder = case("16-colmap-in-colmap-folder");
    for open_as in ["", "colmap", "colmap/sparse", "colmap/sparse/0"] {
        let scene = open(folder.join(open_as)).unwrap();
        assert_eq!(scene.views.len(), 6, "{open_as}");
        has_ball(&scene);
    }
}

#[test]
fn case_17_two_photographs_never_share_a_file() {
    let scene = read("17-convert-loses-a-photograph");
    let out = tempfile::tempdir().unwrap();
    formats::transforms::write(out.path(), &scene).unwrap();
    let files = std::fs::read_dir(out.path().join("images"))
        .unwrap()
        .count();
    assert_eq!((scene.views.len(), files), (6, 6));
    let back = open(out.path()).unwrap();
    for (a, b) in scene.views.iter().zip(&back.views) {
        let (a, b) = (a.image.as_ref().unwrap(), b.image.as_ref().unwrap());
        let pairs = a.pixels.as_flattened().iter().zip(b.pixels.as_flattened());
        assert!(pairs.map(|(a, b)| (a - b).abs()).fold(0.0, f32::max) < 1.5 / 255.0);
    }
}

#[test]
fn case_18_a_sun_survives() {
    let scene = read("18-convert-clips-the-sun");
    let energy = |scene: &Scene| map(scene).energy().iter().sum::<f64>() / 3.0;
    assert!((energy(&scene) - 7328.08).abs() < 0.1, "{}", energy(&scene));
    let out = tempfile::tempdir().unwrap();
    formats::interchange::write(out.path(), &scene).unwrap();
    assert_eq!(map(&open(out.path()).unwrap()).pixels, map(&scene).pixels);
    // In the training store, too, whose maps are half floats.
    let basis = scene.basis.as_ref().unwrap();
    let cameras = scene.views.iter().map(|v| v.camera).collect();
    let record = lumi_data::store::ObjectRecord::pack("sun", cameras, basis).unwrap();
    let path = out.path().join("sun.safetensors");
    record.write(&path).unwrap();
    let back = lumi_data::store::ObjectRecord::read(&path)
        .unwrap()
        .to_scene();
    let Light::Environment(light) = &back.basis.unwrap().lights[0].light.clone() else {
        panic!("an environment");
    };
    let stored: f64 = (0..3)
        .map(|c| light.map.energy()[c] * f64::from(light.strength[c]) / 3.0)
        .sum();
    assert!((stored / energy(&scene) - 1.0).abs() < 1e-3, "{stored}");
}

#[test]
fn case_19_a_byte_order_mark() {
    let scene = read("19-json-bom");
    assert_eq!(scene.views.len(), 6);
    has_ball(&scene);
}

#[test]
fn case_21_the_wrong_field_is_named() {
    let message = refused("21-json-wrong-place");
    assert!(
        message.contains("transforms.json: line 6, column"),
        "{message}"
    );
    assert!(
        message.contains(": w: invalid type: string \"32\""),
        "{message}"
    );
}

#[test]
fn case_23_square_maps() {
    let message = refused("23-env-map-not-lat-long");
    assert!(
        message.contains("map.") && message.contains("16×16: square maps are light probes"),
        "{message}"
    );
}

#[test]
fn case_24_chromaticities() {
    let scene = read("24-exr-chromaticities");
    has_pixel(map(&scene), [0.725, 0.575, 0.8], 4e-3);
}

#[test]
fn case_26_linear_png() {
    // The same photographs as of another case, which are sRGB in 8 bits.
    let (linear, encoded) = (
        read("26-png-gama-linear"),
        read("03-split-names-spelled-otherwise"),
    );
    for (a, b) in linear.views.iter().zip(&encoded.views) {
        let (a, b) = (a.image.as_ref().unwrap(), b.image.as_ref().unwrap());
        let pairs = a.pixels.as_flattened().iter().zip(b.pixels.as_flattened());
        let worst = pairs.map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        assert!(worst < 1.5 / 255.0, "{worst}");
    }
}

#[test]
fn case_27_exposure() {
    let scene = read("27-hdr-exposure-colorcorr");
    has_pixel(map(&scene), [7.2266, 5.7422, 7.9688], 1e-3);
}

#[test]
fn case_28_one_mask_of_another_picture() {
    let folder = case("28-one-bad-mask-of-six").join("owl/test");
    let scene = open(&folder).unwrap();
    has_ball(&scene);
    let named: Vec<_> = scene
        .warnings
        .iter()
        .filter(|w| w.contains("contradicts"))
        .collect();
    assert_eq!(named.len(), 1, "{:?}", scene.warnings);
    assert!(named[0].starts_with("view `input_0005`"), "{named:?}");
    // The others agree with each other, and the check says who does not.
    let report = check_folder(&folder).unwrap();
    assert!(report.hull_median.unwrap() > 0.85, "{report}");
    let about: Vec<_> = report
        .problems
        .iter()
        .filter(|p| p.field.contains("input_0005"))
        .collect();
    assert!(
        about.iter().any(|p| p.text.contains("disagrees")),
        "{report}"
    );
}

#[test]
fn conversions_do_not_write_over_anything() {
    let root = tempfile::tempdir().unwrap();
    let at = |name: &str| root.path().join(name);
    for name in ["capture/images", "full", "empty"] {
        std::fs::create_dir_all(at(name)).unwrap();
    }
    std::fs::write(at("full/notes.txt"), "mine").unwrap();
    std::fs::write(at("file"), "mine").unwrap();
    let target = |out: &str, overwrite| convert::check_target(&at("capture"), &at(out), overwrite);
    for (out, overwrite) in [
        ("empty", false),
        ("new", false),
        ("new/deeper", false),
        ("full", true),
    ] {
        target(out, overwrite).unwrap();
    }
    for (out, overwrite, part) in [
        ("full", false, "--overwrite"),
        ("capture", true, "capture's own"),
        ("capture/../capture", true, "capture's own"),
        ("capture/images", true, "outside"),
        ("capture/new", false, "outside"),
        (".", true, "does not hold the capture"),
        ("file", true, "found a file"),
    ] {
        let message = target(out, overwrite).expect_err(out).to_string();
        assert!(message.contains(part), "{out}: {message}");
    }
}

#[test]
fn conversions_keep_every_pixel_unless_told() {
    let root = tempfile::tempdir().unwrap();
    let mut scene = read("03-split-names-spelled-otherwise");
    for view in &mut scene.views {
        view.image = Some(view.image.take().unwrap().resized(1200, 1200));
        view.camera = view.camera.resized(1200, 1200);
    }
    formats::transforms::write(root.path(), &scene).unwrap();
    let sides = |longest| -> Vec<usize> {
        let scene = lumi_data::open_with(root.path(), &convert::opening(longest)).unwrap();
        scene.views.iter().map(|v| v.camera.width).collect()
    };
    assert_eq!(sides(None), [1200; 6]);
    assert_eq!(sides(Some(100)), [100; 6]);
    let small = convert::reduced(scene, 60);
    assert_eq!(
        (small.views[0].camera.width, small.views[0].camera.cx),
        (60, 30.0)
    );
    assert_eq!(small.views[0].image.as_ref().unwrap().pixels.len(), 3600);
}

#[test]
fn what_a_format_cannot_hold_is_said() {
    let mut owl = open(case("28-one-bad-mask-of-six").join("owl/test")).unwrap();
    owl.lit_by[7].clear();
    let said = |to: &str| convert::losses(&owl, to).join("; ");
    assert!(
        said("transforms").contains("the lights of 7 photographs"),
        "{}",
        said("transforms")
    );
    let authors = said("authors");
    assert!(
        authors.contains("2 views are held out") && authors.contains("theirs differ"),
        "{authors}"
    );
    assert_eq!(
        convert::losses(&read("19-json-bom"), "transforms"),
        Vec::<String>::new()
    );
}
