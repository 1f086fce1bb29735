//! JSON files in, with errors that say where.

use lumi_core::fs;
use lumi_core::{Error, Result};
use serde::de::DeserializeOwned;
use std::path::{Path, PathBuf};

/// Reads `path` as `T`.
///
/// # Errors
/// Names the file, and the line and field that is malformed, missing or wrong.
pub(crate) fn read<T: DeserializeOwned>(path: &Path) -> Result<T> {
    Document::read(path)?.parse()
}

/// Writes `value` as indented JSON.
pub(crate) fn write<T: serde::Serialize>(path: &Path, value: &T) -> Result<()> {
    let wrong = |e: serde_json::Error| Error::invalid(path, "JSON", e.to_string());
    let mut text = serde_json::to_vec_pretty(value).map_err(wrong)?;
    text.push(b'\n');
    fs::atomic_write(path, &text)
}

/// The text of a JSON file.
///
/// Types that flatten others lose the place of an error, so such files are parsed once for each of their parts.
pub(crate) struct Document {
    path: PathBuf,
    text: Vec<u8>,
}

impl Document {
    /// Reads a file; a byte order mark is skipped, and UTF-16 that has one is taken as well.
    ///
    /// # Errors
    /// Names the file.
    pub fn read(path: &Path) -> Result<Self> {
        Ok(Self {
            path: path.to_owned(),
            text: without_byte_order_mark(fs::read_bytes(path)?),
        })
    }

    /// The file as `T`.
    ///
    /// # Errors
    /// Names the file, and the line and field that is malformed, missing or wrong.
    pub fn parse<T: DeserializeOwned>(&self) -> Result<T> {
        serde_json::from_slice(&self.text).map_err(|e| self.wrong(&e))
    }

    fn wrong(&self, error: &serde_json::Error) -> Error {
        let message = error.to_string();
        // serde_json says "… at line L column C"; the place goes to the front, as everywhere else.
        let mut text = message.split(" at line ").next().unwrap_or(&message);
        let (line, column) = (error.line(), error.column());
        let offset = self.offset(line, column);
        let field = field_at(&self.text, offset);
        let named = if field.is_empty() {
            String::new()
        } else {
            format!(": {field}")
        };
        let expected;
        if let Some(found) = not_a_number(&self.text, offset) {
            expected = format!("expected a finite number, found {found}");
            text = &expected;
        }
        let place = format!("line {line}, column {column}{named}");
        Error::invalid(&self.path, place, text)
    }

    /// Index of the byte that a line and a column, both from 1, mean.
    fn offset(&self, line: usize, column: usize) -> usize {
        let ends = self.text.iter().enumerate().filter(|(_, b)| **b == b'\n');
        let before = line
            .checked_sub(2)
            .and_then(|n| ends.map(|(i, _)| i + 1).nth(n));
        before.unwrap_or(0) + column.saturating_sub(1)
    }
}

/// The text as UTF-8 without a byte order mark; UTF-16 is known by its own.
#[must_use]
pub fn without_byte_order_mark(bytes: Vec<u8>) -> Vec<u8> {
    let wide = |unit: fn([u8; 2]) -> u16| {
        let units = bytes[2..].as_chunks::<2>().0.iter().map(|b| unit(*b));
        String::from_utf16_lossy(&units.collect::<Vec<_>>()).into_bytes()
    };
    match bytes.as_slice() {
        [0xef, 0xbb, 0xbf, rest @ ..] => rest.to_vec(),
        [0xff, 0xfe, ..] => wide(u16::from_le_bytes),
        [0xfe, 0xff, ..] => wide(u16::from_be_bytes),
        _ => bytes,
    }
}

/// What stands at `offset` in place of a number, as Python and JavaScript write them.
fn not_a_number(text: &[u8], offset: usize) -> Option<&'static str> {
    const FOUND: [&str; 5] = ["NaN", "-Infinity", "Infinity", "nan", "inf"];
    // The parser stops within the word.
    let rest = |back: usize| text.get(offset.checked_sub(back)?..);
    FOUND
        .into_iter()
        .find(|word| (0..3).any(|back| rest(back).is_some_and(|r| r.starts_with(word.as_bytes()))))
}

/// An object or array that the walk is in.
enum Level {
    Object { key: String, expects_key: bool },
    Array { index: usize },
}

/// What stands at `offset`, such as `frames[2].fl_x`; empty for the whole file. Takes any bytes.
fn field_at(text: &[u8], offset: usize) -> String {
    let mut levels: Vec<Level> = Vec::new();
    let (mut found, mut at) = (String::new(), 0);
    while at <= offset {
        let Some(&byte) = text.get(at) else { break };
        let start = at;
        at += 1;
        match byte {
            b'{' | b'[' => {
                found = written(&levels);
                levels.push(if byte == b'{' {
                    Level::Object {
                        key: String::new(),
                        expects_key: true,
                    }
                } else {
                    Level::Array { index: 0 }
                });
            }
            b'}' | b']' => {
                levels.pop();
                found = written(&levels);
            }
            b',' => match levels.last_mut() {
                Some(Level::Array { index }) => *index += 1,
                Some(Level::Object { expects_key, .. }) => *expects_key = true,
                None => {}
            },
            b'"' => {
                at = string_end(text, at);
                match levels.last_mut() {
                    Some(Level::Object { key, expects_key }) if *expects_key => {
                        let name = text.get(start + 1..at - 1).unwrap_or_default();
                        *key = String::from_utf8_lossy(name).into_owned();
                        *expects_key = false;
                    }
                    _ => found = written(&levels),
                }
            }
            b':' | b' ' | b'\t' | b'\r' | b'\n' => {}
            _ => {
                found = written(&levels);
                let rest = &text[at..];
                let end = rest.iter().position(|b| b",]}: \t\r\n\"".contains(b));
                at += end.unwrap_or(rest.len());
            }
        }
    }
    found
}

/// The index after the quote that ends the string which begins at `at`.
fn string_end(text: &[u8], mut at: usize) -> usize {
    while let Some(byte) = text.get(at) {
        at += match byte {
            b'"' => return at + 1,
            b'\\' => 2,
            _ => 1,
        };
    }
    text.len().max(1)
}

fn written(levels: &[Level]) -> String {
    let mut field = String::new();
    for level in levels {
        match level {
            Level::Object { key, .. } => {
                if !field.is_empty() {
                    field.push('.');
                }
                field.push_str(key);
            }
            Level::Array { index } => field.push_str(&format!("[{index}]")),
        }
    }
    field
}

/// Rows of a 4×4 matrix, as files store it.
pub(crate) type Rows = [[f64; 4]; 4];

/// Rows of a file as a matrix.
pub(crate) fn matrix(rows: &Rows) -> glam::Mat4 {
    glam::DMat4::from_cols_array_2d(rows).transpose().as_mat4()
}

/// A matrix as rows.
pub(crate) fn rows(matrix: glam::Mat4) -> Rows {
    matrix.as_dmat4().transpose().to_cols_array_2d()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[derive(Debug, serde::Deserialize)]
    struct File {
        #[serde(default)]
        frames: Vec<Frame>,
    }

    #[derive(Debug, serde::Deserialize)]
    struct Frame {
        #[serde(default)]
        m: Vec<[f64; 2]>,
        #[serde(default)]
        name: String,
    }

    fn message(text: &[u8]) -> String {
        let document = Document {
            path: "a.json".into(),
            text: without_byte_order_mark(text.to_vec()),
        };
        document.parse::<File>().expect_err("wrong").to_string()
    }

    #[test]
    fn line_and_field_of_what_is_wrong() {
        for (text, expected) in [
            (
                "{\n\"frames\": [{}, {\n\"m\": [[1, \"2\"]]}]}",
                "line 3, column 13: frames[1].m[0][1]: invalid type: string \"2\"",
            ),
            (
                "{\"frames\": [\n{\"m\": [[1, NaN]]}]}",
                "line 2, column 12: frames[0].m[0][1]: expected a finite number, found NaN",
            ),
            (
                "{\"frames\": [{\"m\": [[-Infinity, 1]]}]}",
                "frames[0].m[0][0]: expected a finite number, found -Infinity",
            ),
            (
                "{\"frames\": [{\"m\": [[1]]}]}",
                "frames[0].m[0]: invalid length 1",
            ),
            (
                "{\"frames\": [{\"m\": [[1, null]]}]}",
                "frames[0].m[0][1]: invalid type: null",
            ),
            (
                "{\"frames\": [{\"name\": 3}]}",
                "frames[0].name: invalid type: integer `3`",
            ),
            ("{\"frames\": 3}", "frames: invalid type: integer `3`"),
            (
                "{\"frames\": [{\"m\": [[1, 1e999]]}]}",
                "frames[0].m[0][1]: number out of range",
            ),
            ("", "line 1, column 0: EOF"),
        ] {
            let message = message(text.as_bytes());
            assert!(message.contains(expected), "{message}\n{expected}");
        }
    }

    #[test]
    fn byte_order_marks() {
        let text = "{\"frames\": [{\"name\": \"ä\"}]}";
        let le: Vec<u8> = text.encode_utf16().flat_map(u16::to_le_bytes).collect();
        let be: Vec<u8> = text.encode_utf16().flat_map(u16::to_be_bytes).collect();
        for bytes in [
            text.as_bytes().to_vec(),
            [b"\xef\xbb\xbf", text.as_bytes()].concat(),
            [b"\xff\xfe", &le[..]].concat(),
            [b"\xfe\xff", &be[..]].concat(),
        ] {
            let file: File =
                serde_json::from_slice(&without_byte_order_mark(bytes)).expect("reads");
            assert_eq!(
                (file.frames[0].name.as_str(), file.frames[0].m.len()),
                ("ä", 0)
            );
        }
    }

    proptest! {
        #[test]
        fn any_bytes_have_a_field(text in prop::collection::vec(prop::sample::select(&b"{}[]\",:\\ N1a\n"[..]), 0..60)) {
            for offset in 0..text.len() + 2 {
                let _ = field_at(&text, offset);
            }
            let _ = message_of_any(&text);
        }
    }

    fn message_of_any(text: &[u8]) -> Option<String> {
        let document = Document {
            path: "a.json".into(),
            text: text.to_vec(),
        };
        document.parse::<File>().err().map(|e| e.to_string())
    }
}
