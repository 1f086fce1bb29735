//! The geometry of an OBJ file as it is written: numbers in f64, faces with any number of corners.

use super::lines::{name, number, statements, text, words};
use lumi_core::glam::{DVec3, Vec2, Vec3};
use std::collections::HashMap;

/// No index.
pub const NONE: u32 = u32::MAX;

/// A corner of a face: indices from 0, or [`NONE`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Corner {
    /// Of its position.
    pub position: u32,
    /// Of its texture coordinates.
    pub coord: u32,
    /// Of its normal.
    pub normal: u32,
}

/// A polygon.
#[derive(Clone, Copy, Debug)]
pub struct Face {
    /// Its corners are those from the end of the face before to this.
    pub end: usize,
    /// Index into [`Shape::names`], or [`NONE`].
    pub material: u32,
    /// Where it stands.
    pub line: usize,
}

/// A file.
#[derive(Debug, Default)]
pub struct Shape {
    /// Vertices; not all need be finite.
    pub positions: Vec<DVec3>,
    /// Their colours, sRGB as in the file; fewer than vertices if the last have none, which are white.
    pub colors: Vec<Vec3>,
    /// (u, v), v up.
    pub coords: Vec<Vec2>,
    /// Of any length.
    pub normals: Vec<Vec3>,
    /// Corners of all faces; their positions exist.
    pub corners: Vec<Corner>,
    /// Faces of three corners or more.
    pub faces: Vec<Face>,
    /// Names of the materials that faces use, as they are in the file.
    pub names: Vec<Vec<u8>>,
    /// What `mtllib` statements say.
    pub libraries: Vec<Vec<u8>>,
    /// What is not shown.
    pub warnings: Vec<String>,
}

/// What was wrong, and in which line.
#[derive(Debug)]
pub struct Wrong {
    /// Counted from 1.
    pub line: usize,
    /// What was expected there.
    pub expected: String,
}

/// How many statements are not shown.
#[derive(Default)]
struct Skipped {
    lines: usize,
    points: usize,
    curves: usize,
    /// Faces of fewer than three corners.
    thin: usize,
    /// Corners whose texture coordinates or normal do not exist.
    lost: usize,
}

/// Reads a file's bytes; names and comments may be in any encoding that keeps ASCII.
pub fn parse(bytes: &[u8]) -> Result<Shape, Wrong> {
    let mut shape = Shape::default();
    let mut skipped = Skipped::default();
    let mut known: HashMap<Vec<u8>, u32> = HashMap::new();
    let mut material = NONE;
    if bytes.starts_with(b"\xff\xfe") || bytes.starts_with(b"\xfe\xff") {
        let expected =
            "expected UTF-8 or another encoding that keeps ASCII, found UTF-16".to_owned();
        return Err(Wrong { line: 1, expected });
    }
    for statement in statements(bytes) {
        let rest = &*statement.rest;
        let line = statement.line;
        let wrong = |expected: String| Wrong { line, expected };
        match &*statement.keyword {
            b"v" => shape.vertex(rest).map_err(wrong)?,
            b"vt" => {
                let [u, v, _] = numbers::<1>(rest).map_err(wrong)?;
                shape.coords.push(Vec2::new(u as f32, v as f32));
            }
            b"vn" => {
                let n = numbers::<3>(rest).map_err(wrong)?;
                shape.normals.push(DVec3::from_array(n).as_vec3());
            }
            // `fo` is what old files call a face.
            b"f" | b"fo" => {
                let made = shape.face(rest, material, line).map_err(wrong)?;
                skipped.thin += usize::from(!made);
            }
            b"l" => skipped.lines += 1,
            b"p" => skipped.points += 1,
            b"curv" | b"curv2" | b"surf" => skipped.curves += 1,
            b"mtllib" => shape.libraries.push(rest.to_vec()),
            // Without a name: no material, which is how Blender writes it.
            b"usemtl" if name(rest).is_empty() => material = NONE,
            b"usemtl" => {
                let next = known.len() as u32;
                material = *known.entry(name(rest).to_vec()).or_insert_with(|| {
                    shape.names.push(name(rest).to_vec());
                    next
                });
            }
            _ => {}
        }
    }
    shape.check(&mut skipped)?;
    for (count, what) in [
        (skipped.lines, "lines"),
        (skipped.points, "points"),
        (skipped.curves, "free-form curves and surfaces"),
        (skipped.thin, "faces with fewer than three corners"),
    ] {
        if count > 0 {
            let text = format!("{count} statements are {what}, which are left out");
            shape.warnings.push(text);
        }
    }
    if skipped.lost > 0 {
        shape.warnings.push(format!(
            "{} corners of faces refer to texture coordinates or normals that do not exist; they are left out",
            skipped.lost
        ));
    }
    Ok(shape)
}

/// The first three numbers of a statement, of which the first `N` must be there; the others are 0 without.
fn numbers<const N: usize>(rest: &[u8]) -> Result<[f64; 3], String> {
    let mut all = [0.0; 3];
    let mut found = words(rest);
    for (i, value) in all.iter_mut().enumerate() {
        let Some(word) = found.next() else {
            if i < N {
                return Err(format!("expected {N} numbers, found `{}`", text(rest)));
            }
            break;
        };
        *value =
            number(word).ok_or_else(|| format!("expected a number, found `{}`", text(word)))?;
    }
    Ok(all)
}

impl Shape {
    /// `v x y z`, and then nothing, a weight that polygons do not use, or a colour.
    fn vertex(&mut self, rest: &[u8]) -> Result<(), String> {
        let position = numbers::<3>(rest)?;
        let mut more = words(rest).skip(3).map(|w| number(w).unwrap_or(f64::NAN));
        if let (Some(r), Some(g), Some(b)) = (more.next(), more.next(), more.next()) {
            let color = DVec3::new(r, g, b).as_vec3();
            self.colors.resize(self.positions.len(), Vec3::ONE);
            self.colors
                .push(if color.is_finite() { color } else { Vec3::ONE });
        }
        self.positions.push(DVec3::from_array(position));
        Ok(())
    }

    /// Whether it has three corners, else it is left out.
    fn face(&mut self, rest: &[u8], material: u32, line: usize) -> Result<bool, String> {
        let first = self.corners.len();
        let counts = [self.positions.len(), self.coords.len(), self.normals.len()];
        for word in words(rest) {
            let mut indices = [NONE; 3];
            let mut parts = word.split(|&b| b == b'/');
            for (slot, n) in indices.iter_mut().zip(counts) {
                let Some(part) = parts.next() else { break };
                if !part.is_empty() {
                    *slot = index(part, n).ok_or_else(|| unreadable(word))?;
                }
            }
            let [position, coord, normal] = indices;
            if parts.next().is_some() || position == NONE {
                return Err(unreadable(word));
            }
            self.corners.push(Corner {
                position,
                coord,
                normal,
            });
        }
        if self.corners.len() < first + 3 {
            self.corners.truncate(first);
            return Ok(false);
        }
        self.faces.push(Face {
            end: self.corners.len(),
            material,
            line,
        });
        Ok(true)
    }

    /// Every position must exist; texture coordinates and normals that do not are taken away.
    fn check(&mut self, skipped: &mut Skipped) -> Result<(), Wrong> {
        let n = self.positions.len();
        let mut first = 0;
        for face in &self.faces {
            for corner in &mut self.corners[first..face.end] {
                if corner.position as usize >= n {
                    let found = u64::from(corner.position) + 1;
                    let expected = format!("expected vertices 1 to {n}, found {found}");
                    return Err(Wrong {
                        line: face.line,
                        expected,
                    });
                }
                let mut check = |index: &mut u32, n: usize| {
                    if *index != NONE && *index as usize >= n {
                        *index = NONE;
                        skipped.lost += 1;
                    }
                };
                check(&mut corner.coord, self.coords.len());
                check(&mut corner.normal, self.normals.len());
            }
            first = face.end;
        }
        Ok(())
    }

    /// The corners of each face.
    pub fn polygons(&self) -> impl Iterator<Item = (&Face, &[Corner])> {
        let mut first = 0;
        self.faces.iter().map(move |face| {
            let corners = &self.corners[first..face.end];
            first = face.end;
            (face, corners)
        })
    }
}

fn unreadable(word: &[u8]) -> String {
    format!(
        "expected corners as v, v/vt, v//vn or v/vt/vn, found `{}`",
        text(word)
    )
}

/// An index counted from 1, or from −1 backwards from the last of `n`. 0, which some files have for texture coordinates
/// that they lack, is [`NONE`]; so that what does not exist is told from it, that becomes the greatest other.
fn index(part: &[u8], n: usize) -> Option<u32> {
    let i: i64 = std::str::from_utf8(part).ok()?.parse().ok()?;
    let from_zero = match i {
        0 => return Some(NONE),
        1.. => i - 1,
        _ => (n as i64).checked_add(i)?,
    };
    Some(u32::try_from(from_zero).map_or(NONE - 1, |i| i.min(NONE - 1)))
}
