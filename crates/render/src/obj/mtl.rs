//! MTL files as they are written.

use super::lines::{name, number, statements, text, words};
use lumi_core::glam::{Vec2, Vec3};
use std::path::PathBuf;

/// What an image is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// `map_Kd`.
    Color,
    /// `map_d`.
    Opacity,
    /// `map_Pr`.
    Roughness,
    /// `map_Pm`.
    Metallic,
    /// `norm`, in which components of normals are colours.
    Normal,
    /// `map_Bump` and `bump`: heights by the specification, normals in what Blender writes.
    Bump,
}

/// Statements of images that are shown.
const MAPS: [(&str, Kind); 7] = [
    ("map_kd", Kind::Color),
    ("map_d", Kind::Opacity),
    ("map_pr", Kind::Roughness),
    ("map_pm", Kind::Metallic),
    ("norm", Kind::Normal),
    ("map_bump", Kind::Bump),
    ("bump", Kind::Bump),
];

/// An image with its options.
#[derive(Clone, Debug, PartialEq)]
pub struct Map {
    /// What for.
    pub kind: Kind,
    /// As it is written.
    pub file: Vec<u8>,
    /// `-o`, added to texture coordinates after the scale.
    pub offset: Vec2,
    /// `-s`.
    pub scale: Vec2,
    /// `-bm`.
    pub strength: f32,
}

/// A material; what it does not say is `None`.
#[derive(Clone, Debug, Default)]
pub struct Mtl {
    /// As it is written.
    pub name: Vec<u8>,
    /// The folder of its file.
    pub folder: PathBuf,
    /// `Kd`.
    pub diffuse: Option<Vec3>,
    /// `Ks`.
    pub specular: Option<Vec3>,
    /// `Ns`.
    pub shine: Option<f32>,
    /// `d`, or 1 − `Tr`.
    pub opacity: Option<f32>,
    /// `Ke` and `map_Ke`: whether it glows.
    pub glows: bool,
    /// `Pr`.
    pub roughness: Option<f32>,
    /// `Pm`.
    pub metallic: Option<f32>,
    /// `Pc`.
    pub coat: Option<f32>,
    /// `Pcr`.
    pub coat_roughness: Option<f32>,
    /// Images, the last of each kind.
    pub maps: Vec<Map>,
}

/// The materials of a file, and warnings that name lines.
pub fn parse(bytes: &[u8]) -> (Vec<Mtl>, Vec<String>) {
    let (mut all, mut warnings) = (Vec::<Mtl>::new(), Vec::new());
    // Whether `d` was given, which says what `Tr`, of which two opposite readings are about, only guesses.
    let mut sure = false;
    for statement in statements(bytes) {
        let rest = &*statement.rest;
        let keyword = text(&statement.keyword).to_ascii_lowercase();
        if keyword == "newmtl" {
            sure = false;
            all.push(Mtl {
                name: name(rest).to_vec(),
                ..Mtl::default()
            });
            continue;
        }
        let Some(m) = all.last_mut() else { continue };
        let mut warn = |what: &str| {
            let (line, keyword) = (statement.line, text(&statement.keyword));
            warnings.push(format!("line {line}: {keyword}: {what}"));
        };
        let mut number = || {
            let found = single(rest);
            if found.is_none() {
                warn(&format!(
                    "expected a number, found `{}`; left out",
                    text(rest)
                ));
            }
            found
        };
        match keyword.as_str() {
            "ns" => m.shine = number().or(m.shine),
            "pr" => m.roughness = number().or(m.roughness),
            "pm" => m.metallic = number().or(m.metallic),
            "pc" => m.coat = number().or(m.coat),
            "pcr" => m.coat_roughness = number().or(m.coat_roughness),
            "d" => {
                // `d -halo 0.5` is opacity at the outline only.
                let given = number();
                sure |= given.is_some();
                m.opacity = given.or(m.opacity);
            }
            "tr" => {
                let given = number();
                if !sure {
                    m.opacity = given.map(|v| 1.0 - v).or(m.opacity);
                }
            }
            "kd" | "ks" | "ke" => match color(rest) {
                None => {
                    let found = text(rest);
                    warn(&format!(
                        "expected one to three numbers, found `{found}`; left out"
                    ));
                }
                Some(c) if keyword == "kd" => m.diffuse = Some(c),
                Some(c) if keyword == "ks" => m.specular = Some(c),
                Some(c) => m.glows |= c != Vec3::ZERO,
            },
            "map_ke" => m.glows = true,
            _ => {
                if let Some(&(_, kind)) = MAPS.iter().find(|(k, _)| *k == keyword) {
                    let (map, unused) = map(kind, rest);
                    if !unused.is_empty() {
                        warn(&format!("options {} are left out", unused.join(", ")));
                    }
                    if map.file.is_empty() {
                        warn("expected the name of an image, found none; left out");
                    } else {
                        m.maps.retain(|other| other.kind != kind);
                        m.maps.push(map);
                    }
                }
            }
        }
    }
    (all, warnings)
}

/// One finite number.
fn single(rest: &[u8]) -> Option<f32> {
    let value = number(words(rest).next()?)? as f32;
    value.is_finite().then_some(value)
}

/// One number is a grey, and a missing third one the second: the specification allows both to be left out.
fn color(rest: &[u8]) -> Option<Vec3> {
    let mut values = words(rest).take(3).map(|w| number(w).map(|v| v as f32));
    let r = values.next()??;
    let g = values.next().unwrap_or(Some(r))?;
    let b = values.next().unwrap_or(Some(g))?;
    let color = Vec3::new(r, g, b);
    color.is_finite().then_some(color)
}

/// Options that are followed by numbers, and by how many at most.
const NUMBERS: [(&str, usize); 7] = [
    ("-o", 3),
    ("-s", 3),
    ("-t", 3),
    ("-mm", 2),
    ("-bm", 1),
    ("-boost", 1),
    ("-texres", 1),
];
/// Options that are followed by a word.
const WORDS: [&str; 6] = ["-blendu", "-blendv", "-cc", "-clamp", "-imfchan", "-type"];

/// An image's statement, and the options that are not shown. Options come first; those with numbers end where a word is
/// none, and the rest is the name.
fn map(kind: Kind, rest: &[u8]) -> (Map, Vec<String>) {
    let mut map = Map {
        kind,
        file: Vec::new(),
        offset: Vec2::ZERO,
        scale: Vec2::ONE,
        strength: 1.0,
    };
    let (mut left, mut unused) = (rest, Vec::new());
    loop {
        let (word, after) = first(left);
        let option = text(word).to_ascii_lowercase();
        if WORDS.contains(&option.as_str()) {
            let (value, after) = first(after);
            let value = text(value).to_ascii_lowercase();
            // What images without the option do.
            let usual = match option.as_str() {
                "-blendu" | "-blendv" => value == "on",
                _ => value == "off",
            };
            if !usual {
                unused.push(format!("{option} {value}"));
            }
            left = after;
            continue;
        }
        let Some(&(_, most)) = NUMBERS.iter().find(|(o, _)| *o == option) else {
            break;
        };
        let mut values = Vec::new();
        left = after;
        while values.len() < most {
            let (word, after) = first(left);
            let Some(v) = number(word).filter(|v| v.is_finite() && !after.is_empty()) else {
                break;
            };
            values.push(v as f32);
            left = after;
        }
        let value = |i: usize, default: f32| values.get(i).copied().unwrap_or(default);
        match option.as_str() {
            "-o" => map.offset = Vec2::new(value(0, 0.0), value(1, 0.0)),
            "-s" => map.scale = Vec2::new(value(0, 1.0), value(1, 1.0)),
            "-bm" => map.strength = value(0, 1.0),
            _ => unused.push(option),
        }
    }
    map.file = name(left).to_vec();
    (map, unused)
}

/// The first word, and what follows it.
fn first(rest: &[u8]) -> (&[u8], &[u8]) {
    let rest = rest.trim_ascii_start();
    let end = rest.iter().take_while(|b| !b.is_ascii_whitespace()).count();
    (&rest[..end], rest[end..].trim_ascii())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn colours_of_one_two_and_three_numbers() {
        let file = b"newmtl a\nKd 0.5\nKs 0.1 0.2\nNs 10 # shiny\nTr 0.25\nnewmtl b c\nKd 1 0 nan\nKd spectral a.rfl\nd 1\nTr 1\nPr x";
        let (all, warnings) = parse(file);
        assert_eq!(all[0].diffuse, Some(Vec3::splat(0.5)));
        assert_eq!(all[0].specular, Some(Vec3::new(0.1, 0.2, 0.2)));
        assert_eq!((all[0].shine, all[0].opacity), (Some(10.0), Some(0.75)));
        assert_eq!(
            (all[1].name.as_slice(), all[1].opacity),
            (&b"b c"[..], Some(1.0))
        );
        assert_eq!((all[1].diffuse, all[1].roughness), (None, None));
        let lines: Vec<&str> = warnings.iter().map(|w| &w[..12]).collect();
        assert_eq!(lines, ["line 7: Kd: ", "line 8: Kd: ", "line 11: Pr:"]);
    }

    #[test]
    fn options_end_where_a_word_is_no_number() {
        for (rest, file, scale, offset, strength, unused) in [
            (
                "-s 2 2 1 my tex.png",
                "my tex.png",
                [2.0, 2.0],
                [0.0, 0.0],
                1.0,
                0,
            ),
            (
                "-s 2 -o 0.5 -0.25 t.png",
                "t.png",
                [2.0, 1.0],
                [0.5, -0.25],
                1.0,
                0,
            ),
            (
                "-bm 0.3 -clamp on a b.png",
                "a b.png",
                [1.0, 1.0],
                [0.0, 0.0],
                0.3,
                1,
            ),
            (
                "-blendu on -imfchan r -mm 0 1 t.png",
                "t.png",
                [1.0, 1.0],
                [0.0, 0.0],
                1.0,
                2,
            ),
            (
                "-o 1 1 1 7 dwarfs.png",
                "7 dwarfs.png",
                [1.0, 1.0],
                [1.0, 1.0],
                1.0,
                0,
            ),
            ("-s 1 1 1 7", "7", [1.0, 1.0], [0.0, 0.0], 1.0, 0),
            (
                "\"my tex.png\"",
                "my tex.png",
                [1.0, 1.0],
                [0.0, 0.0],
                1.0,
                0,
            ),
            ("-tex.png", "-tex.png", [1.0, 1.0], [0.0, 0.0], 1.0, 0),
        ] {
            let (map, left) = map(Kind::Color, rest.as_bytes());
            assert_eq!(text(&map.file), file, "{rest}");
            assert_eq!(map.scale.to_array(), scale, "{rest}");
            assert_eq!(map.offset.to_array(), offset, "{rest}");
            assert_eq!((map.strength, left.len()), (strength, unused), "{rest}");
        }
    }
}
