//! What other programs write into image files: each kind reads with its right values, or is refused with the reason.
#![allow(clippy::unwrap_used)]

use exr::meta::attribute;
use exr::prelude::*;
use image::{DynamicImage, GrayImage, ImageFormat, Luma, Rgb, RgbImage, Rgba, RgbaImage};
use lumi_core::color::srgb_encode;
use lumi_core::image::{
    read_display, read_linear, read_linear_with_warnings, read_mask_with_warnings,
    read_photograph_with_warnings, write_exr,
};
use lumi_core::{EnvMap, LinearImage};
use proptest::prelude::{ProptestConfig, any, prop, prop_assert, prop_assert_eq, proptest};
use std::io::Cursor;
use std::path::PathBuf;

type Text = String;

/// A file of these bytes in a folder that lives as long as the test.
struct Files(tempfile::TempDir);

impl Files {
    fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    fn write(&self, name: &str, bytes: impl AsRef<[u8]>) -> PathBuf {
        let path = self.0.path().join(name);
        std::fs::write(&path, bytes).unwrap();
        path
    }

    fn save(&self, name: &str, image: impl Into<DynamicImage>) -> PathBuf {
        let path = self.0.path().join(name);
        image.into().save(&path).unwrap();
        path
    }

    /// An EXR of parts, each a name, a corner, a size and channels of one value everywhere, in a display window of
    /// 8 × 4 pixels.
    fn exr(&self, name: &str, parts: &[Part]) -> PathBuf {
        let path = self.0.path().join(name);
        let layers: Vec<_> = parts
            .iter()
            .map(|part| {
                let (w, h) = part.size;
                let channel = |(name, value): &(&str, f32)| {
                    AnyChannel::new(*name, FlatSamples::F32(vec![*value; w * h]))
                };
                let attributes = LayerAttributes {
                    layer_position: Vec2(part.corner.0, part.corner.1),
                    ..LayerAttributes::named(part.name)
                };
                let channels = AnyChannels::sort(part.channels.iter().map(channel).collect());
                Layer::new(part.size, attributes, Encoding::FAST_LOSSLESS, channels)
            })
            .collect();
        let window = ImageAttributes::new(IntegerBounds::new((0, 0), (8, 4)));
        let image = Image::from_layers(window, layers);
        image.write().to_file(&path).unwrap();
        path
    }
}

struct Part<'a> {
    name: &'a str,
    corner: (i32, i32),
    size: (usize, usize),
    channels: &'a [(&'a str, f32)],
}

/// A part that fills the window.
fn part<'a>(name: &'a str, channels: &'a [(&'a str, f32)]) -> Part<'a> {
    Part {
        name,
        corner: (0, 0),
        size: (8, 4),
        channels,
    }
}

fn message<T: std::fmt::Debug>(result: lumi_core::Result<T>) -> Text {
    result.expect_err("must fail").to_string()
}

fn jpeg(width: u32, height: u32) -> Vec<u8> {
    let pixel = |x: u32, y: u32| {
        Rgb([
            (x * 7 % 256) as u8,
            (y * 11 % 256) as u8,
            ((x * y) % 256) as u8,
        ])
    };
    let mut bytes = Cursor::new(Vec::new());
    let image = RgbImage::from_fn(width, height, pixel);
    image.write_to(&mut bytes, ImageFormat::Jpeg).unwrap();
    bytes.into_inner()
}

#[test]
fn a_cut_jpeg_is_an_error_and_one_without_its_end_a_warning() {
    let files = Files::new();
    let whole = jpeg(96, 64);
    let path = files.write("a.jpg", &whole);
    let read = read_photograph_with_warnings(&path).unwrap();
    assert_eq!(read.warnings, Vec::<Text>::new());
    // Everything but the last two bytes.
    let path = files.write("b.jpg", &whole[..whole.len() - 2]);
    let short = read_photograph_with_warnings(&path).unwrap();
    assert_eq!(short.shown, read.shown);
    assert!(
        short.warnings[0].contains("end marker is missing"),
        "{:?}",
        short.warnings
    );
    for cut in (3..whole.len() - 4).step_by(17) {
        let text = message(read_display(files.write("c.jpg", &whole[..cut])));
        assert!(
            text.contains("c.jpg") && text.contains("complete"),
            "{cut}: {text}"
        );
    }
    // A download that was not finished, in a file of its full length.
    let mut filled = whole[..whole.len() / 2].to_vec();
    filled.resize(whole.len(), 0);
    assert!(message(read_display(files.write("e.jpg", filled))).contains("within its picture"));
    // Phones append their own data after the end.
    let path = files.write("d.jpg", [&whole[..], b"\xff\xd8more"].concat());
    assert_eq!(
        read_photograph_with_warnings(&path).unwrap().shown,
        read.shown
    );
}

/// A PNG with chunks before its pixels.
fn png(image: impl Into<DynamicImage>, chunks: &[(&[u8; 4], &[u8])]) -> Vec<u8> {
    let mut bytes = Cursor::new(Vec::new());
    image.into().write_to(&mut bytes, ImageFormat::Png).unwrap();
    let mut bytes = bytes.into_inner();
    let mut more = Vec::new();
    for (name, data) in chunks {
        let body = [&name[..], data].concat();
        more.extend((data.len() as u32).to_be_bytes());
        more.extend(&body);
        more.extend(crc32(&body).to_be_bytes());
    }
    // After the signature and the header.
    bytes.splice(33..33, more);
    bytes
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

fn be(numbers: &[u32]) -> Vec<u8> {
    numbers.iter().flat_map(|n| n.to_be_bytes()).collect()
}

#[test]
fn png_gamma_and_primaries_are_applied() {
    let files = Files::new();
    let stored = RgbImage::from_pixel(2, 1, Rgb([128, 64, 200]));
    let plain = [128.0, 64.0, 200.0].map(|v: f32| v / 255.0);
    let shown = |chunks: &[(&[u8; 4], &[u8])]| {
        let path = files.write("a.png", png(stored.clone(), chunks));
        let read = read_photograph_with_warnings(path).unwrap();
        (read.shown.pixels[0], read.warnings)
    };
    let close = |a: [f32; 3], b: [f32; 3]| a.iter().zip(b).all(|(a, b)| (a - b).abs() < 2e-3);
    assert!(close(shown(&[(b"gAMA", &be(&[45_455]))]).0, plain));
    assert!(close(
        shown(&[(b"gAMA", &be(&[100_000]))]).0,
        plain.map(srgb_encode)
    ));
    let darker = plain.map(|v| srgb_encode(v.powf(1.8)));
    assert!(close(shown(&[(b"gAMA", &be(&[55_556]))]).0, darker));
    // sRGB says more than gAMA.
    let both: [(&[u8; 4], &[u8]); 2] = [(b"sRGB", &[0]), (b"gAMA", &be(&[100_000]))];
    assert!(close(shown(&both).0, plain));
    let xyz = be(&[33_333, 33_333, 100_000, 0, 0, 100_000, 0, 0]);
    let linear: [(&[u8; 4], &[u8]); 2] = [(b"gAMA", &be(&[100_000])), (b"cHRM", &xyz)];
    let [x, y, z] = plain;
    let red = 3.2406 * x - 1.5372 * y - 0.4986 * z;
    assert!((shown(&linear).0[0] - srgb_encode(red)).abs() < 2e-3);
    let (pixel, warnings) = shown(&[(b"gAMA", &be(&[0]))]);
    assert!(
        close(pixel, plain) && warnings[0].starts_with("gAMA"),
        "{warnings:?}"
    );
}

#[test]
fn exr_pixels_lie_where_the_display_window_has_them() {
    let files = Files::new();
    let inside = Part {
        name: "rgba",
        corner: (2, 1),
        size: (3, 2),
        channels: &[("R", 0.5), ("G", 0.25), ("B", 2.0), ("A", 1.0)],
    };
    let image = read_linear(files.exr("a.exr", &[inside])).unwrap();
    assert_eq!((image.width, image.height), (8, 4));
    for (i, pixel) in image.pixels.iter().enumerate() {
        let known = (2..5).contains(&(i % 8)) && (1..3).contains(&(i / 8));
        assert_eq!(
            *pixel,
            if known {
                [0.5, 0.25, 2.0, 1.0]
            } else {
                [0.0; 4]
            },
            "{i}"
        );
    }
    // Overscan is cut off; without alpha, what is outside is black and opaque.
    let over = Part {
        name: "",
        corner: (-1, -2),
        size: (4, 20),
        channels: &[("R", 1.0), ("G", 1.0), ("B", 1.0)],
    };
    let image = read_linear(files.exr("b.exr", &[over])).unwrap();
    assert_eq!(
        (image.pixels.len(), image.pixels[26], image.pixels[27]),
        (32, [1.0; 4], [0.0, 0.0, 0.0, 1.0])
    );
    let outside = Part {
        name: "",
        corner: (8, 0),
        size: (2, 2),
        channels: &[("R", 1.0), ("G", 1.0), ("B", 1.0)],
    };
    let text = message(read_linear(files.exr("c.exr", &[outside])));
    assert!(
        text.contains("c.exr") && text.contains("data window"),
        "{text}"
    );
}

#[test]
fn the_picture_is_chosen_by_name_and_type() {
    let files = Files::new();
    const NORMAL: [(&str, f32); 3] = [("R", 0.1), ("G", 0.1), ("B", 0.1)];
    const COLOR: [(&str, f32); 3] = [("R", 3.0), ("G", 2.0), ("B", 1.0)];
    const OWN: [(&str, f32); 4] = [("R", 3.0), ("G", 2.0), ("B", 1.0), ("A", 0.5)];
    let pixel = |parts: &[Part]| {
        let (image, warnings) = read_linear_with_warnings(files.exr("a.exr", parts)).unwrap();
        (image.pixels[9], warnings)
    };
    for (first, second) in [
        ("N", "C"),
        ("normals", "beauty"),
        ("WorldNormal", "rgba"),
        ("albedo", "ViewLayer.Combined"),
    ] {
        for parts in [
            [part(first, &NORMAL), part(second, &COLOR)],
            [part(second, &COLOR), part(first, &NORMAL)],
        ] {
            assert_eq!(
                pixel(&parts),
                ([3.0, 2.0, 1.0, 1.0], Vec::new()),
                "{first} {second}"
            );
        }
    }
    // Layers within a part, and depth as the only other channel.
    let layers = [
        ("ViewLayer.Combined.R", 3.0),
        ("ViewLayer.Combined.G", 2.0),
        ("ViewLayer.Combined.B", 1.0),
        ("ViewLayer.Combined.A", 0.25),
        ("ViewLayer.DiffCol.R", 9.0),
        ("ViewLayer.DiffCol.G", 9.0),
        ("ViewLayer.DiffCol.B", 9.0),
        ("ViewLayer.Depth.Z", 7.0),
    ];
    assert_eq!(pixel(&[part("", &layers)]).0, [3.0, 2.0, 1.0, 0.25]);
    // Alpha of its own part; of several, none.
    let alone = [part("rgb", &COLOR), part("alpha", &[("A", 0.5)])];
    assert_eq!(pixel(&alone), ([3.0, 2.0, 1.0, 0.5], Vec::new()));
    let luminance = [part("alpha", &[("Y", 0.5)]), part("beauty", &COLOR)];
    assert_eq!(pixel(&luminance).0, [3.0, 2.0, 1.0, 0.5]);
    let several = [
        part("rgb", &COLOR),
        part("fg", &[("A", 0.5)]),
        part("bg", &[("A", 0.1)]),
    ];
    let (found, warnings) = pixel(&several);
    assert_eq!(found[3], 1.0);
    assert!(warnings[0].contains("`fg`, `bg`"), "{warnings:?}");
    // Alpha of normals is not the picture's.
    let own = [part("normal", &OWN), part("beauty", &COLOR)];
    assert_eq!(pixel(&own).0, [3.0, 2.0, 1.0, 1.0]);
    // Names that say nothing: the first, with a warning.
    let (found, warnings) = pixel(&[part("take1", &COLOR), part("take2", &NORMAL)]);
    assert_eq!(found[0], 3.0);
    assert!(
        warnings[0].contains("`take1`") && warnings[0].contains("`take2`"),
        "{warnings:?}"
    );
    // Grey pictures.
    assert_eq!(pixel(&[part("", &[("Y", 0.5)])]).0, [0.5, 0.5, 0.5, 1.0]);
}

#[test]
fn channels_are_listed_when_none_fits() {
    let files = Files::new();
    let depth = [
        part("depth", &[("Z", 1.0)]),
        part("uv", &[("U", 1.0), ("V", 0.0)]),
    ];
    let text = message(read_linear(files.exr("a.exr", &depth)));
    assert!(
        text.contains("a.exr: EXR channels") && text.contains("depth/Z, uv/U, uv/V"),
        "{text}"
    );
    const COLOR: [(&str, f32); 3] = [("R", 3.0), ("G", 2.0), ("B", 1.0)];
    let passes = [part("normal", &COLOR), part("position", &COLOR)];
    assert!(message(read_linear(files.exr("b.exr", &passes))).contains("normal/B"));
    // Luminance with chroma at half the resolution is no grey picture, and not a broken file.
    let chroma = [part("", &[("BY", 0.1), ("RY", 0.2), ("Y", 0.5)])];
    let path = files.exr("c.exr", &chroma);
    let mut bytes = std::fs::read(&path).unwrap();
    for name in [&b"BY\0"[..], b"RY\0"] {
        let at = bytes.windows(3).position(|w| w == name).unwrap() + 3;
        // Type, linearity, then samples across and down.
        for sampling in [at + 8, at + 12] {
            assert_eq!(bytes[sampling..sampling + 4], [1, 0, 0, 0]);
            bytes[sampling] = 2;
        }
    }
    std::fs::write(&path, bytes).unwrap();
    let text = message(read_linear(path));
    assert!(text.contains("is not read: channel subsampling"), "{text}");
}

#[test]
fn exr_chromaticities_become_rec_709() {
    let files = Files::new();
    let path = files.0.path().join("xyz.exr");
    let channels = SpecificChannels::rgb(|_| (0.9505_f32, 1.0_f32, 1.089_f32));
    let layer = Layer::new(
        (2, 1),
        LayerAttributes::default(),
        Encoding::UNCOMPRESSED,
        channels,
    );
    let mut image = Image::from_layer(layer);
    let corner = |x, y| Vec2(x, y);
    image.attributes.chromaticities = Some(attribute::Chromaticities {
        red: corner(1.0, 0.0),
        green: corner(0.0, 1.0),
        blue: corner(0.0, 0.0),
        white: corner(1.0 / 3.0, 1.0 / 3.0),
    });
    image.write().to_file(&path).unwrap();
    let pixel = read_linear(&path).unwrap().pixels[0];
    assert!(pixel.iter().all(|v| (v - 1.0).abs() < 2e-3), "{pixel:?}");
}

/// Coverage of the pixels of a mask, rounded, and what was said of it.
fn mask(path: PathBuf) -> (Vec<f32>, Vec<Text>) {
    let (mask, warnings) = read_mask_with_warnings(path).unwrap();
    let rounded = |a: &f32| (a * 1e5).round() / 1e5;
    (mask.alpha.unwrap().iter().map(rounded).collect(), warnings)
}

#[test]
fn masks_of_every_kind() {
    let files = Files::new();
    let rgba = |pixels: [[u8; 4]; 3]| RgbaImage::from_fn(3, 1, |x, _| Rgba(pixels[x as usize]));
    // Opaque everywhere: the colours say it. Else alpha does.
    let opaque = rgba([[255; 4], [0, 0, 0, 255], [51, 51, 51, 255]]);
    assert_eq!(mask(files.save("a.png", opaque)).0, [1.0, 0.0, 0.2]);
    let clear = rgba([[255, 255, 255, 0], [0, 0, 0, 0], [255, 255, 255, 0]]);
    assert_eq!(mask(files.save("b.png", clear)).0, [1.0, 0.0, 1.0]);
    let alpha = rgba([[0, 0, 0, 255], [255; 4], [255, 255, 255, 0]]);
    assert_eq!(mask(files.save("c.png", alpha)).0, [1.0, 1.0, 0.0]);
    // Labels in colour: all but black.
    let labels = rgba([[128, 0, 0, 255], [0, 0, 0, 255], [0, 0, 1, 255]]);
    assert_eq!(mask(files.save("d.png", labels)).0, [1.0, 0.0, 1.0]);
    // Labels in grey, shades of grey, sixteen bits.
    let grey = |levels: [u8; 3]| GrayImage::from_fn(3, 1, |x, _| Luma([levels[x as usize]]));
    assert_eq!(
        mask(files.save("e.png", grey([0, 1, 0]))),
        (vec![0.0, 1.0, 0.0], vec![])
    );
    let (found, warnings) = mask(files.save("f.png", grey([0, 1, 4])));
    assert_eq!(found, [0.0, 1.0, 1.0]);
    assert!(warnings[0].contains("labels"), "{warnings:?}");
    assert_eq!(
        mask(files.save("g.png", grey([0, 51, 255]))).0,
        [0.0, 0.2, 1.0]
    );
    assert_eq!(
        mask(files.save("h.png", grey([0, 0, 0]))),
        (vec![0.0; 3], vec![])
    );
    let deep = |levels: [u16; 3]| {
        DynamicImage::from(image::ImageBuffer::from_fn(3, 1, |x, _| {
            Luma([levels[x as usize]])
        }))
    };
    assert_eq!(
        mask(files.save("i.png", deep([0, 1, 1]))).0,
        [0.0, 1.0, 1.0]
    );
    assert_eq!(
        mask(files.save("j.png", deep([0, 255, 51]))).0,
        [0.0, 1.0, 0.2]
    );
    assert_eq!(
        mask(files.save("k.png", deep([0, 65535, 13107]))).0,
        [0.0, 1.0, 0.2]
    );
    // Linear files hold coverage as it is, not light to be encoded.
    let half = LinearImage {
        width: 2,
        height: 1,
        pixels: vec![[0.5, 0.5, 0.5, 1.0], [1.0; 4]],
    };
    let path = files.0.path().join("l.exr");
    write_exr(&path, &half).unwrap();
    assert_eq!(mask(path).0, [0.5, 1.0]);
    let black = RgbImage::from_fn(16, 16, |x, _| Rgb([if x < 8 { 200 } else { 0 }, 0, 0]));
    let (found, _) = mask(files.save("m.jpg", black));
    assert_eq!((found[0], found[15]), (1.0, 0.0));
}

#[test]
fn what_a_file_really_is_is_named() {
    let files = Files::new();
    for (bytes, name) in [
        (&b"RIFF\0\0\0\0WEBPVP8 "[..], "a WebP image"),
        (b"II*\0\x08\0\0\0", "a TIFF image"),
        (b"\0\0\0\x18ftypheic", "a HEIC image"),
        (b"\n<!DOCTYPE html>", "a web page"),
        (b"version https://git-lfs.github.com/spec/v1", "Git LFS"),
    ] {
        let text = message(read_display(files.write("a.png", bytes)));
        assert!(text.contains(name), "{text}");
    }
    let mut png = Cursor::new(Vec::new());
    RgbImage::new(4, 2)
        .write_to(&mut png, ImageFormat::Png)
        .unwrap();
    let path = files.write("map.exr", png.into_inner());
    let text = message(read_linear(&path));
    assert!(text.contains("display-encoded PNG"), "{text}");
    // A picture is a map too, whatever its file is called, if it has light.
    let text = message(EnvMap::read(&path));
    assert!(
        text.contains("map.exr") && text.contains("some light"),
        "{text}"
    );
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 64, failure_persistence: None, ..ProptestConfig::default() })]

    /// Whatever the data window: a pixel is known where it lies in it, and nowhere else.
    #[test]
    fn any_data_window(x in -6..10_i32, y in -6..8_i32, width in 1..12_usize, height in 1..9_usize) {
        let files = Files::new();
        let crop = Part {
            name: "",
            corner: (x, y),
            size: (width, height),
            channels: &[("R", 1.0), ("G", 2.0), ("B", 3.0), ("A", 1.0)],
        };
        let read = read_linear(files.exr("a.exr", &[crop]));
        let inside = |i: usize| {
            let (px, py) = ((i % 8) as i32, (i / 8) as i32);
            (x..x + width as i32).contains(&px) && (y..y + height as i32).contains(&py)
        };
        match read {
            Ok(image) => for (i, pixel) in image.pixels.iter().enumerate() {
                prop_assert_eq!(*pixel, if inside(i) { [1.0, 2.0, 3.0, 1.0] } else { [0.0; 4] });
            },
            Err(error) => {
                prop_assert!(!(0..32).any(inside), "{}", error);
                prop_assert!(error.to_string().contains("data window"));
            }
        }
    }

    /// What the `image` crate writes as run lengths reads back as it reads it.
    #[test]
    fn radiance_run_lengths(width in 1..40_u32, height in 1..6_u32, levels in prop::collection::vec(0..3_u8, 1..9)) {
        let files = Files::new();
        let picture = image::Rgb32FImage::from_fn(width, height, |x, y| {
            let level = levels[(x / 3 + y) as usize % levels.len()];
            Rgb([f32::from(level), 0.5, f32::from(level) * 40.0])
        });
        let path = files.save("a.hdr", picture);
        let expected = image::open(&path).unwrap().to_rgb32f();
        let read = read_linear(&path).unwrap();
        for (a, b) in read.pixels.iter().zip(expected.pixels()) {
            prop_assert_eq!(&a[..3], &b.0[..]);
        }
    }

    /// A JPEG that is cut anywhere in its picture is an error. A stray zero behind the cut is data that codes up to two
    /// blocks of colour, so that with one the last blocks must not be all that is missing.
    #[test]
    fn any_cut_of_a_jpeg(width in 9..70_u32, height in 9..70_u32, at in 0.05..0.9_f64, stray in any::<bool>()) {
        let files = Files::new();
        let whole = jpeg(width, height);
        let start = whole.windows(2).position(|w| w == [0xff, 0xda]).unwrap() + 14;
        let (more, part): (&[u8], f64) = if stray { (&[0], 0.5) } else { (&[], 1.0) };
        let cut = start + ((whole.len() - 2 - start) as f64 * at * part) as usize;
        let bytes = [&whole[..cut], more].concat();
        prop_assert!(read_display(files.write("a.jpg", bytes)).is_err());
    }
}

/// Entropy-coded bits of a JPEG.
#[derive(Default)]
struct Bits {
    bytes: Vec<u8>,
    buffer: u32,
    count: u32,
}

impl Bits {
    fn put(&mut self, value: u32, count: u32) {
        for i in (0..count).rev() {
            self.buffer = self.buffer << 1 | (value >> i & 1);
            self.count += 1;
            if self.count == 8 {
                self.bytes.push(self.buffer as u8);
                if self.buffer == 0xff {
                    self.bytes.push(0);
                }
                (self.buffer, self.count) = (0, 0);
            }
        }
    }

    /// A signed value behind the code of its size, which `code` makes of the size.
    fn value(&mut self, value: i32, code: impl Fn(u32) -> (u32, u32)) {
        let size = 32 - value.unsigned_abs().leading_zeros();
        let (word, length) = code(size);
        self.put(word, length);
        let low = if value < 0 { value - 1 } else { value };
        self.put(low as u32 & ((1 << size) - 1), size);
    }

    fn finish(mut self) -> Vec<u8> {
        self.put(0x7f, (8 - self.count) % 8);
        self.bytes
    }
}

/// A progressive grey JPEG of 8 × 8 blocks in three scans: means, coefficient 1 and coefficient 10.
fn progressive(side: u16) -> Vec<u8> {
    let mut file = vec![0xff, 0xd8];
    let mut segment = |marker: u8, data: &[u8], after: &[u8]| {
        file.extend([0xff, marker]);
        file.extend((data.len() as u16 + 2).to_be_bytes());
        file.extend(data);
        file.extend(after);
    };
    segment(0xdb, &[&[0][..], &[8; 64]].concat(), &[]);
    let [h, l] = side.to_be_bytes();
    segment(0xc2, &[8, h, l, h, l, 1, 1, 0x11, 0], &[]);
    // Codes of four bits for sizes 0 to 11 of means; of five for the end of a block and sizes of coefficients.
    let lengths = |length: usize, count: u8| {
        let mut lengths = [0; 16];
        lengths[length - 1] = count;
        lengths
    };
    segment(
        0xc4,
        &[&[0x00][..], &lengths(4, 12), &(0..12).collect::<Vec<_>>()].concat(),
        &[],
    );
    let symbols: Vec<u8> = [0x00]
        .into_iter()
        .chain(1..9)
        .chain((1..9).map(|s| 0x40 | s))
        .collect();
    segment(
        0xc4,
        &[&[0x10][..], &lengths(5, 17), &symbols].concat(),
        &[],
    );
    let blocks = usize::from(side / 8).pow(2) as i32;
    let value = |i: i32, k: i32| (i * 37 + k * 11) % 50 - 25;
    for (first, last, k) in [(0, 0, 0), (1, 5, 1), (6, 63, 10)] {
        let mut bits = Bits::default();
        let mut before = 0;
        for i in 0..blocks {
            match k {
                0 => {
                    bits.value(value(i, k) - before, |size| (size, 4));
                    before = value(i, k);
                }
                _ => {
                    // Symbols 1 to 8 have no zeros before them, the next eight have four.
                    let of = if k == 1 { 0 } else { 8 };
                    if value(i, k) != 0 {
                        bits.value(value(i, k), |size| (size + of, 5));
                    }
                    bits.put(0, 5);
                }
            }
        }
        segment(0xda, &[1, 1, 0x00, first, last, 0], &bits.finish());
    }
    file.extend([0xff, 0xd9]);
    file
}

#[test]
fn a_progressive_jpeg_needs_all_its_scans() {
    let files = Files::new();
    let whole = progressive(48);
    let read = read_display(files.write("a.jpg", &whole)).unwrap();
    let grey: Vec<f32> = read.pixels.iter().map(|p| p[0]).collect();
    let (low, high) = grey
        .iter()
        .fold((1.0_f32, 0.0_f32), |(l, h), v| (l.min(*v), h.max(*v)));
    assert!(low < 0.3 && high > 0.7, "{low} {high}");
    let path = files.write("b.jpg", &whole[..whole.len() - 2]);
    let short = read_photograph_with_warnings(path).unwrap();
    assert_eq!(short.shown, read);
    assert!(short.warnings[0].contains("end marker is missing"));
    let scans: Vec<usize> = whole
        .windows(2)
        .enumerate()
        .filter(|(_, w)| *w == [0xff, 0xda])
        .map(|(i, _)| i)
        .collect();
    assert_eq!(scans.len(), 3);
    // Between scans, and within each.
    for cut in [
        scans[1],
        scans[2],
        scans[0] + 20,
        scans[1] + 30,
        scans[2] + 30,
        whole.len() - 12,
    ] {
        let message = message(read_display(files.write("c.jpg", &whole[..cut])));
        assert!(message.contains("complete Jpeg"), "{cut}: {message}");
    }
}
