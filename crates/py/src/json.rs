//! Records as Python's own dicts and lists, by the names that the program's files have.

use crate::errors::raised;
use pyo3::prelude::*;
use serde::Serialize;

/// A record as `json.loads` reads it.
///
/// # Errors
/// None for records that the program writes to files.
pub fn to_python<'py>(py: Python<'py>, value: &impl Serialize) -> PyResult<Bound<'py, PyAny>> {
    let text = serde_json::to_string(value).map_err(raised)?;
    py.import("json")?.call_method1("loads", (text,))
}
