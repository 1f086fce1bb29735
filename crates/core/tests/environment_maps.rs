//! Environment maps from files: what is read, what is assumed with a warning, what is refused.
#![allow(clippy::unwrap_used)]

use exr::prelude::write_rgb_file;
use lumi_core::color::srgb_decode;
use lumi_core::image::{read_linear, write_exr, write_png};
use lumi_core::{DisplayImage, EnvMap, LinearImage};

fn message<T: std::fmt::Debug>(result: lumi_core::Result<T>) -> String {
    result.expect_err("must fail").to_string()
}

fn map(width: usize, height: usize, value: f32) -> LinearImage {
    LinearImage {
        width,
        height,
        pixels: vec![[value, value, value, 1.0]; width * height],
    }
}

#[test]
fn maps_that_are_not_lat_long() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.exr");
    write_exr(&path, &map(16, 16, 1.0)).unwrap();
    let text = message(EnvMap::read(&path));
    assert!(
        text.contains("a.exr: size") && text.contains("light probes"),
        "{text}"
    );
    write_exr(&path, &map(16, 6, 1.0)).unwrap();
    let (read, warnings) = EnvMap::read_with_warnings(&path).unwrap();
    assert_eq!((read.width, read.height, warnings.len()), (16, 6, 1));
    assert!(
        warnings[0].contains("16×6") && warnings[0].contains("lat-long"),
        "{warnings:?}"
    );
    write_exr(&path, &map(16, 8, 1.0)).unwrap();
    assert_eq!(
        EnvMap::read_with_warnings(&path).unwrap().1,
        Vec::<String>::new()
    );
}

#[test]
fn suns_are_kept_or_said_to_be_lost() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("sun.exr");
    let mut sunny = map(16, 8, 0.5);
    sunny.pixels[40] = [3e5, 2.5e5, 1e5, 1.0];
    write_exr(&path, &sunny).unwrap();
    let (read, warnings) = EnvMap::read_with_warnings(&path).unwrap();
    assert_eq!((read.pixels[40], warnings.len()), ([3e5, 2.5e5, 1e5], 0));
    write_rgb_file(&path, 16, 8, |x, _| {
        let v = if x == 3 { f32::INFINITY } else { 0.5 };
        (v, 0.5_f32, 0.5_f32)
    })
    .unwrap();
    let (read, warnings) = EnvMap::read_with_warnings(&path).unwrap();
    assert_eq!(read.pixels[3], [65504.0, 0.5, 0.5]);
    assert!(
        warnings[0].contains("8 values are infinite"),
        "{warnings:?}"
    );
    // Only maps may be infinite.
    assert!(message(read_linear(&path)).contains("pixel (3, 0)"));
    sunny.pixels[40] = [1.0; 4];
    sunny.pixels[41][1] = -5e-4;
    write_exr(&path, &sunny).unwrap();
    assert_eq!(EnvMap::read(&path).unwrap().pixels[41], [0.5, 0.0, 0.5]);
    sunny.pixels[41][1] = -5e-3;
    write_exr(&path, &sunny).unwrap();
    assert!(message(EnvMap::read(&path)).contains("pixel (9, 2)"));
}

#[test]
fn environment_maps_read_and_are_checked() {
    let folder = tempfile::tempdir().unwrap();
    let read = EnvMap::read(lumi_testkit::shared(
        "cases/models/24-hdr-rgbe-signature/reference/m.hdr",
    ))
    .unwrap();
    assert_eq!(read.width, 2 * read.height);

    let hdr = folder.path().join("dark.hdr");
    let black = image::Rgb32FImage::from_pixel(8, 4, image::Rgb([0.0; 3]));
    image::DynamicImage::from(black).save(&hdr).unwrap();
    let dark = message(EnvMap::read(&hdr));
    assert!(
        dark.contains("dark.hdr") && dark.contains("zero energy"),
        "{dark}"
    );

    // A panorama is a map too, as far as it goes.
    let panorama = folder.path().join("panorama.png");
    write_png(&panorama, &DisplayImage::filled(8, 4, [1.0, 0.5, 0.0])).unwrap();
    let (shown, warnings) = EnvMap::read_with_warnings(&panorama).unwrap();
    assert!(
        (shown.pixels[3][1] - srgb_decode(128.0 / 255.0)).abs() < 1e-5 && shown.pixels[0][0] == 1.0
    );
    assert!(warnings[0].contains("ends at white"), "{warnings:?}");

    let negative = folder.path().join("negative.exr");
    let mut image = map(9, 7, 1.0);
    image.pixels[10][1] = -0.5;
    write_exr(&negative, &image).unwrap();
    let negative = message(EnvMap::read(&negative));
    assert!(negative.contains("pixel (1, 1)"), "{negative}");
}

#[test]
fn a_map_that_begins_with_another_programs_signature_is_the_same_map() {
    let case = |name: &str| {
        let folder = "cases/models/24-hdr-rgbe-signature";
        lumi_testkit::shared(&format!("{folder}/{name}/m.hdr"))
    };
    let signature = |path| std::fs::read(path).unwrap()[..6].to_vec();
    assert_eq!(signature(case("maps")), b"#?RGBE");
    assert_eq!(signature(case("reference")), b"#?RADI");
    let [found, expected] = ["maps", "reference"].map(|name| {
        let (map, warnings) = EnvMap::read_with_warnings(case(name)).unwrap();
        assert!(warnings.is_empty(), "{warnings:?}");
        map
    });
    assert_eq!(
        (found.width, found.height),
        (expected.width, expected.height)
    );
    assert_eq!(found.pixels, expected.pixels);
    assert!(found.pixels.iter().any(|p| p[0] > 0.1));
}
