//! Errors of the Rust crates as the package's exceptions, which stand in `python/lumitokens/_errors.py`.

use pyo3::prelude::*;
use std::ffi::CString;

mod exceptions {
    #![allow(missing_docs)]
    pyo3::import_exception!(lumitokens._errors, LumiError);
    pyo3::import_exception!(lumitokens._errors, FileError);
    pyo3::import_exception!(lumitokens._errors, FormatError);
    pyo3::import_exception!(lumitokens._errors, InputError);
    pyo3::import_exception!(lumitokens._errors, ModelError);
    pyo3::import_exception!(lumitokens._errors, UnsupportedError);
}

use exceptions::{FileError, FormatError, InputError, LumiError, ModelError, UnsupportedError};

/// The exception of an error, told by the first of ours in its chain.
pub fn raised(error: impl Into<anyhow::Error>) -> PyErr {
    let error = error.into();
    let text = said(&error);
    if let Some(e) = error.downcast_ref::<lumi_core::Error>() {
        return of_core(e, text);
    }
    match error.downcast_ref::<lumi_model::Error>() {
        Some(lumi_model::Error::Core(e)) => of_core(e, text),
        Some(lumi_model::Error::Unsupported(_)) => UnsupportedError::new_err(text),
        Some(lumi_model::Error::Failed(_)) => LumiError::new_err(text),
        Some(_) => ModelError::new_err(text),
        None if error.is::<std::io::Error>() => FileError::new_err(text),
        None => LumiError::new_err(text),
    }
}

/// An error with its causes, those left out that the text before them ends with.
fn said(error: &anyhow::Error) -> String {
    let mut text = error.to_string();
    for cause in error.chain().skip(1).map(ToString::to_string) {
        if !text.ends_with(&cause) {
            text = format!("{text}: {cause}");
        }
    }
    text
}

fn of_core(error: &lumi_core::Error, text: String) -> PyErr {
    match error {
        lumi_core::Error::Io { .. } => FileError::new_err(text),
        lumi_core::Error::Invalid { .. } => FormatError::new_err(text),
        lumi_core::Error::Value { .. } => InputError::new_err(text),
    }
}

/// A wrong argument.
pub fn wrong(field: &str, expected: impl std::fmt::Display) -> PyErr {
    InputError::new_err(format!("{field}: {expected}"))
}

/// Warns as `lumitokens.LumiWarning`.
///
/// # Errors
/// Where the caller has made warnings errors.
pub fn warn(py: Python<'_>, text: &str) -> PyResult<()> {
    let category = py.import("lumitokens._errors")?.getattr("LumiWarning")?;
    // No text of ours has a zero byte, but a file's name may be anything.
    let text = CString::new(text.replace('\0', "\u{fffd}")).unwrap_or_default();
    PyErr::warn(py, &category, &text, 1)
}
