//! The one error type of the plain-type crates: it names the file, the field and what was expected.

use std::path::{Path, PathBuf};

/// Result with this crate's [`Error`].
pub type Result<T> = std::result::Result<T, Error>;

/// What went wrong while reading, checking or writing.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// A file could not be read or written.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// A file was read, but something in it is not as it must be.
    #[error("{}: {field}: {expected}", path.display())]
    Invalid {
        /// The file or folder.
        path: PathBuf,
        /// The field, frame or tensor in it.
        field: String,
        /// What was expected, and what was found.
        expected: String,
    },
    /// A value that did not come from a file is out of its range.
    #[error("{field}: {expected}")]
    Value {
        /// The argument or field.
        field: String,
        /// What was expected, and what was found.
        expected: String,
    },
}

impl Error {
    /// A failed system call on `path`.
    pub fn io(path: impl AsRef<Path>, source: std::io::Error) -> Self {
        Self::Io {
            path: path.as_ref().to_owned(),
            source,
        }
    }

    /// A wrong `field` of the file `path`.
    pub fn invalid(
        path: impl AsRef<Path>,
        field: impl Into<String>,
        expected: impl Into<String>,
    ) -> Self {
        Self::Invalid {
            path: path.as_ref().to_owned(),
            field: field.into(),
            expected: expected.into(),
        }
    }

    /// A wrong value that stands in no file.
    pub fn value(field: impl Into<String>, expected: impl Into<String>) -> Self {
        Self::Value {
            field: field.into(),
            expected: expected.into(),
        }
    }

    /// The same error, said of a part: `place` goes before the field of a [`Error::Value`].
    #[must_use]
    pub fn within(self, place: impl std::fmt::Display) -> Self {
        match self {
            Self::Value { field, expected } => Self::value(format!("{place}: {field}"), expected),
            other => other,
        }
    }

    /// The same error, said of a field of the file `path` (for values that were read from it).
    #[must_use]
    pub fn at(self, path: impl AsRef<Path>) -> Self {
        match self {
            Self::Value { field, expected } => Self::invalid(path, field, expected),
            other => other,
        }
    }
}
