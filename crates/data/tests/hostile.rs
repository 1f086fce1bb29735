//! Whatever bytes a file holds, reading it ends in a scene or in one clear error: no panic, no endless loop,
//! no memory beyond what the file itself justifies.
#![allow(clippy::unwrap_used)]

mod trees;

use lumi_core::EnvMap;
use lumi_core::glam::Vec3;
use lumi_core::image::{decode_display, decode_linear, decode_mask};
use lumi_data::store::ObjectRecord;
use lumi_data::{formats, parsers};
use proptest::prelude::*;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

/// A change to the bytes of a file.
#[derive(Clone, Debug)]
enum Damage {
    Cut(f64),
    Flip(f64, u8),
    /// Eight bytes of all ones or zeros: counts and lengths beyond any file.
    Fill(f64, u8),
    Insert(f64, Vec<u8>),
    Replace(Vec<u8>),
}

fn damage() -> impl Strategy<Value = Damage> {
    let at = || 0.0..1.0_f64;
    prop_oneof![
        at().prop_map(Damage::Cut),
        (at(), 1..=255_u8).prop_map(|(at, bits)| Damage::Flip(at, bits)),
        (at(), prop_oneof![Just(0_u8), Just(255), Just(b'9')])
            .prop_map(|(at, v)| Damage::Fill(at, v)),
        (at(), prop::collection::vec(any::<u8>(), 1..40)).prop_map(|(at, v)| Damage::Insert(at, v)),
        prop::collection::vec(any::<u8>(), 0..200).prop_map(Damage::Replace),
    ]
}

fn damaged(bytes: &[u8], damage: &Damage) -> Vec<u8> {
    let index = |at: f64| (at * bytes.len() as f64) as usize;
    let mut out = bytes.to_vec();
    match damage {
        Damage::Cut(at) => out.truncate(index(*at)),
        Damage::Flip(at, bits) => {
            if let Some(byte) = out.get_mut(index(*at)) {
                *byte ^= bits;
            }
        }
        Damage::Fill(at, value) => out
            .iter_mut()
            .skip(index(*at))
            .take(8)
            .for_each(|b| *b = *value),
        Damage::Insert(at, more) => drop(out.splice(index(*at)..index(*at), more.iter().copied())),
        Damage::Replace(other) => out.clone_from(other),
    }
    out
}

/// A capture: the place to open, and every file of it.
type Capture = (PathBuf, Vec<PathBuf>);

/// A capture in every format, written once.
fn captures() -> &'static [Capture] {
    static TREES: OnceLock<(tempfile::TempDir, Vec<Capture>)> = OnceLock::new();
    let make = || {
        let root = tempfile::tempdir().unwrap();
        let at = |name: &str| root.path().join(name);
        trees::colmap(
            &at("text"),
            false,
            (1, "PINHOLE"),
            &[56.0, 56.0, 24.0, 24.0],
        );
        trees::colmap(
            &at("binary"),
            true,
            (2, "SIMPLE_RADIAL"),
            &[56.0, 24.0, 24.0, 0.01],
        );
        trees::stanford_orb(&at("orb"), Vec3::Z);
        trees::objects_with_lighting(&at("owl"), Vec3::Z);
        formats::transforms::write(&at("transforms"), &trees::ball(4)).unwrap();
        formats::authors::write(&at("authors"), &trees::ball(4)).unwrap();
        let open = [
            "text",
            "binary",
            "orb/blender_LDR/ball_scene001",
            "owl/ball/test",
            "transforms",
            "authors",
        ];
        let trees = open.map(|open| {
            let mut files = Vec::new();
            walk(&at(open), &mut files);
            assert!(formats::open(at(open)).is_ok(), "{open}");
            (at(open), files)
        });
        (root, trees.into())
    };
    &TREES.get_or_init(make).1
}

fn walk(folder: &Path, files: &mut Vec<PathBuf>) {
    let mut entries: Vec<_> = std::fs::read_dir(folder)
        .unwrap()
        .map(|e| e.unwrap().path())
        .collect();
    entries.sort();
    for path in entries {
        if path.is_dir() {
            walk(&path, files);
        } else {
            files.push(path);
        }
    }
}

/// An error is one line that names a file.
fn is_clear(error: &lumi_core::Error) {
    let text = error.to_string();
    assert!(!text.is_empty() && text.len() < 2000, "{text}");
    assert!(text.contains('/') || text.contains('.'), "{text}");
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 96, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn captures_with_a_damaged_file(which in 0..6_usize, file in 0.0..1.0_f64, damage in damage()) {
        // One test at a time changes the shared trees; this is the only one that does.
        let (open, files) = &captures()[which];
        let path = &files[(file * files.len() as f64) as usize];
        let whole = std::fs::read(path).unwrap();
        std::fs::write(path, damaged(&whole, &damage)).unwrap();
        let result = formats::open(open).map(|scene| scene.views.len());
        std::fs::write(path, whole).unwrap();
        if let Err(error) = result {
            is_clear(&error);
        }
    }

    #[test]
    fn parsers_of_any_bytes(bytes in prop::collection::vec(any::<u8>(), 0..400)) {
        let _ = parsers::colmap_cameras(&bytes);
        let _ = parsers::colmap_images(&bytes);
        let _ = parsers::light_rays(&bytes);
        let _ = parsers::colmap_text(&String::from_utf8_lossy(&bytes));
        let path = Path::new("any.bytes");
        for magic in [
            &b""[..], b"\x89PNG\r\n\x1a\n", b"\xff\xd8\xff", b"#?RADIANCE\n", b"#?RGBE\n\n-Y 9 +X 9\n",
            b"\x76\x2f\x31\x01\x02\0\0\0",
        ] {
            let file = [magic, &bytes].concat();
            let _ = decode_display(path, &file);
            let _ = decode_linear(path, &file);
            let _ = decode_mask(path, &file);
            let _ = EnvMap::decode(path, &file);
        }
    }

    #[test]
    fn counts_are_not_believed(count in any::<u64>(), rest in prop::collection::vec(any::<u8>(), 0..120)) {
        let bytes = [&count.to_le_bytes()[..], &rest].concat();
        if count > 2 {
            prop_assert!(parsers::colmap_images(&bytes).is_err());
            prop_assert!(parsers::colmap_cameras(&bytes).is_err() || count <= 120 / 24);
        }
    }

    #[test]
    fn records_with_a_damaged_file(file in 0.0..1.0_f64, damage in damage()) {
        let folder = tempfile::tempdir().unwrap();
        let record = trees::record();
        let (single, group) = (folder.path().join("a.safetensors"), folder.path().join("b"));
        record.write(&single).unwrap();
        record.write(&group).unwrap();
        let bytes = std::fs::read(&single).unwrap();
        let _ = ObjectRecord::parse(&single, &damaged(&bytes, &damage));
        let mut files = Vec::new();
        walk(&group, &mut files);
        let path = &files[(file * files.len() as f64) as usize];
        let whole = std::fs::read(path).unwrap();
        let changed = damaged(&whole, &damage);
        std::fs::write(path, &changed).unwrap();
        match ObjectRecord::read(&group) {
            Err(error) => is_clear(&error),
            // Damage that goes unnoticed must be no damage to the data: all of those carry checksums.
            Ok(back) => prop_assert!(changed == whole || path.ends_with("zarr.json") || back.radiance == record.radiance),
        }
    }
}
