//! Image files round trip, and broken ones end in one clear error, never in a panic.
#![allow(clippy::unwrap_used)]

use lumi_core::image::{read_display, read_linear, read_mask, write_exr, write_png};
use lumi_core::{DisplayImage, EnvMap, LinearImage};
use std::path::{Path, PathBuf};

fn sample() -> LinearImage {
    let pixel = |i: usize| {
        let a = (i % 5) as f32 / 4.0;
        [0.5 * a, i as f32 * a / 16.0, 3.0 * a, a]
    };
    LinearImage {
        width: 9,
        height: 7,
        pixels: (0..63).map(pixel).collect(),
    }
}

fn message<T: std::fmt::Debug>(result: lumi_core::Result<T>) -> String {
    result.expect_err("must fail").to_string()
}

/// Saves `image` through the `image` crate, as other programs would.
fn save(folder: &Path, name: &str, image: impl Into<image::DynamicImage>) -> PathBuf {
    let path = folder.join(name);
    image.into().save(&path).unwrap();
    path
}

#[test]
fn exr_round_trip_is_exact_to_half_precision_and_to_more_beyond_it() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.exr");
    let mut image = sample();
    write_exr(&path, &image).unwrap();
    let back = read_linear(&path).unwrap();
    assert_eq!((back.width, back.height), (9, 7));
    for (i, (a, b)) in image.pixels.iter().zip(&back.pixels).enumerate() {
        for c in 0..4 {
            assert!(
                (a[c] - b[c]).abs() <= a[c].abs() / 2048.0,
                "pixel {i}: {a:?} {b:?}"
            );
        }
    }
    let shown = read_display(&path).unwrap();
    assert_eq!(shown, back.to_display());
    image.pixels[3] = [1e9, 0.1, 0.0, 1.0];
    write_exr(&path, &image).unwrap();
    assert_eq!(read_linear(&path).unwrap(), image);
}

#[test]
fn png_round_trip_and_bit_depths() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.png");
    let image = DisplayImage {
        width: 3,
        height: 1,
        pixels: vec![[0.0, 0.5, 1.0], [0.2; 3], [2.0, -1.0, 0.25]],
        alpha: None,
    };
    write_png(&path, &image).unwrap();
    let back = read_display(&path).unwrap();
    assert!(back.alpha.is_none());
    assert_eq!(back.pixels[0], [0.0, 128.0 / 255.0, 1.0]);
    assert_eq!(back.pixels[2][..2], [1.0, 0.0], "clipped");

    let deep = image::ImageBuffer::from_pixel(2, 2, image::Rgba([65535_u16, 1000, 0, 32768]));
    let deep = read_display(save(folder.path(), "deep.png", deep)).unwrap();
    let a = 32768.0 / 65535.0;
    assert!((deep.alpha.unwrap()[0] - a).abs() < 1e-6);
    assert!((deep.pixels[0][1] - (1000.0 / 65535.0 * a + 1.0 - a)).abs() < 1e-6);

    let grey = image::GrayImage::from_pixel(4, 2, image::Luma([51]));
    let grey = save(folder.path(), "grey.png", grey);
    assert!((read_display(&grey).unwrap().pixels[7][2] - 0.2).abs() < 1e-6);
    assert!((read_mask(&grey).unwrap().alpha.unwrap()[0] - 0.2).abs() < 1e-6);
    let grey = image::GrayAlphaImage::from_pixel(1, 1, image::LumaA([0, 51]));
    let grey = read_display(save(folder.path(), "la.png", grey)).unwrap();
    assert!((grey.pixels[0][0] - 0.8).abs() < 1e-6);
}

#[test]
fn jpeg_and_misnamed_files_are_recognised_by_content() {
    let folder = tempfile::tempdir().unwrap();
    let jpeg = save(
        folder.path(),
        "a.jpg",
        image::RgbImage::from_pixel(16, 8, image::Rgb([200, 100, 50])),
    );
    let misnamed = folder.path().join("b.png");
    std::fs::rename(jpeg, &misnamed).unwrap();
    let shown = read_display(&misnamed).unwrap();
    assert_eq!((shown.width, shown.height, shown.alpha), (16, 8, None));
    assert!((shown.pixels[0][0] - 200.0 / 255.0).abs() < 0.02);
    assert!(message(read_linear(&misnamed)).contains("linear radiance"));
}

#[test]
fn values_that_are_not_finite_name_their_pixel() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("nan.exr");
    let mut image = sample();
    image.pixels[20][2] = f32::NAN;
    let refused = message(write_exr(&path, &image));
    assert!(refused.contains("pixel (2, 2)"), "{refused}");
    assert!(!path.exists());
    exr::prelude::write_rgb_file(&path, 4, 3, |x, y| {
        (if (x, y) == (3, 1) { f32::NAN } else { 0.0 }, 0.0, 0.0)
    })
    .unwrap();
    let read = message(read_linear(&path));
    assert!(
        read.contains("nan.exr") && read.contains("pixel (3, 1)"),
        "{read}"
    );
    assert!(message(EnvMap::read(&path)).contains("pixel (3, 1)"));
}

#[test]
fn an_exr_without_alpha_has_none() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("rgb.exr");
    exr::prelude::write_rgb_file(&path, 2, 2, |_, _| (0.25_f32, 0.5_f32, 1.0_f32)).unwrap();
    assert_eq!(read_linear(&path).unwrap().pixels[0], [0.25, 0.5, 1.0, 1.0]);
    assert!(read_display(&path).unwrap().alpha.is_none());
}

#[test]
fn missing_empty_and_foreign_files_are_named() {
    let folder = tempfile::tempdir().unwrap();
    assert!(message(read_display(folder.path().join("no.png"))).contains("no.png"));
    for (name, bytes) in [
        ("empty.png", &b""[..]),
        ("text.png", b"hello"),
        ("magic.exr", b"\x76\x2f\x31\x01"),
    ] {
        let path = folder.path().join(name);
        std::fs::write(&path, bytes).unwrap();
        let text = message(read_display(&path));
        assert!(text.contains(name) && text.contains("expected"), "{text}");
    }
    assert!(message(read_display(folder.path())).contains(&folder.path().display().to_string()));
}

#[test]
fn unwritable_outputs_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("file");
    std::fs::write(&file, "x").unwrap();
    assert!(message(write_exr(file.join("a.exr"), &sample())).contains("a.exr"));
    assert!(message(write_png(file.join("a.png"), &sample().to_display())).contains("a.png"));
    assert!(
        message(write_exr(
            folder.path().join("b.exr"),
            &LinearImage::new(0, 4)
        ))
        .contains("size")
    );
}

/// Every truncation and many single-byte changes of each format: an error or an image, no panic,
/// and no allocation that a changed header asks for.
#[test]
fn damaged_files_never_panic() {
    let folder = tempfile::tempdir().unwrap();
    let rgba = image::RgbaImage::from_fn(9, 7, |x, y| {
        image::Rgba([x as u8 * 20, y as u8 * 30, 7, 200])
    });
    let rgb = image::DynamicImage::from(rgba.clone()).to_rgb8();
    let exr = folder.path().join("a.exr");
    write_exr(&exr, &sample()).unwrap();
    let files = [
        save(folder.path(), "a.png", rgba),
        save(folder.path(), "a.jpg", rgb.clone()),
        save(
            folder.path(),
            "a.hdr",
            image::DynamicImage::from(rgb).to_rgb32f(),
        ),
        exr,
    ];
    for file in files {
        let whole = std::fs::read(&file).unwrap();
        assert!(read_display(&file).is_ok(), "{}", file.display());
        // A fresh file each time: file systems flush one that is overwritten, which takes far longer.
        let save = |path: &Path, bytes: &[u8]| {
            let _ = std::fs::remove_file(path);
            std::fs::write(path, bytes).unwrap();
        };
        let damaged = file.with_extension(format!("bad.{}", file.extension().unwrap().display()));
        for cut in 0..whole.len() * 2 / 3 {
            save(&damaged, &whole[..cut]);
            assert!(
                read_display(&damaged).is_err(),
                "{} cut at {cut}",
                file.display()
            );
        }
        for at in 0..whole.len() {
            for value in [0x00, 0x7f, 0xff, whole[at] ^ 1] {
                let mut bytes = whole.clone();
                bytes[at] = value;
                save(&damaged, &bytes);
                let _ = read_display(&damaged);
            }
        }
    }
}

#[test]
fn headers_that_promise_more_than_their_file_are_refused_at_once() {
    let folder = tempfile::tempdir().expect("folder");
    // A PNG whose header says 16384 × 8192 and whose data are those of four pixels.
    let path = save(folder.path(), "a.png", image::RgbImage::new(2, 2));
    let mut bytes = std::fs::read(&path).expect("bytes");
    bytes[16..20].copy_from_slice(&16_384_u32.to_be_bytes());
    bytes[20..24].copy_from_slice(&8_192_u32.to_be_bytes());
    let checksum = crc32(&bytes[12..29]);
    bytes[29..33].copy_from_slice(&checksum.to_be_bytes());
    std::fs::write(&path, &bytes).expect("written");
    let text = message(read_display(&path));
    assert!(text.contains("expected data for 16384×8192"), "{text}");
    // The same of a Radiance file.
    let hdr = folder.path().join("a.hdr");
    std::fs::write(
        &hdr,
        b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 8192 +X 16384\nx",
    )
    .expect("written");
    let text = message(read_linear(&hdr));
    assert!(text.contains("expected data for 16384×8192"), "{text}");
}

/// The checksum of PNG chunks (CRC-32, ISO 3309).
fn crc32(bytes: &[u8]) -> u32 {
    let step = |mut crc: u32, byte: &u8| {
        crc ^= u32::from(*byte);
        for _ in 0..8 {
            crc = if crc & 1 == 1 {
                crc >> 1 ^ 0xedb8_8320
            } else {
                crc >> 1
            };
        }
        crc
    };
    !bytes.iter().fold(u32::MAX, step)
}
