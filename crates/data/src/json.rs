//! JSON files in, with errors that say where.

use lumi_core::fs;
use lumi_core::{Error, Result};
use serde::de::DeserializeOwned;
use std::path::Path;

/// Reads `path` as `T`.
///
/// # Errors
/// Names the file, and the line where it is malformed or a field is missing or wrong.
pub(crate) fn read<T: DeserializeOwned>(path: &Path) -> Result<T> {
    serde_json::from_slice(&fs::read_bytes(path)?).map_err(|e| at_line(path, &e))
}

/// Writes `value` as indented JSON.
pub(crate) fn write<T: serde::Serialize>(path: &Path, value: &T) -> Result<()> {
    let mut text = serde_json::to_vec_pretty(value).map_err(|e| at_line(path, &e))?;
    text.push(b'\n');
    fs::atomic_write(path, &text)
}

fn at_line(path: &Path, error: &serde_json::Error) -> Error {
    let message = error.to_string();
    // serde_json says "… at line L column C"; the place goes to the front, as everywhere else.
    let text = message.split(" at line ").next().unwrap_or(&message);
    Error::invalid(
        path,
        format!("line {}, column {}", error.line(), error.column()),
        text,
    )
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
