//! Errors of loading, checking and running models.

use std::path::{Path, PathBuf};

/// Result with this crate's [`Error`].
pub type Result<T> = std::result::Result<T, Error>;

/// What went wrong with a model, its weights or what it was asked.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// A file, image, camera or light is not as it must be.
    #[error(transparent)]
    Core(#[from] lumi_core::Error),
    /// A model config is wrong.
    #[error("{source_name}: {field}: {expected}")]
    Config {
        /// File or preset that holds the config.
        source_name: String,
        /// The field.
        field: String,
        /// What was expected, and what was found.
        expected: String,
    },
    /// Weights do not fit the config.
    #[error("{}: tensor `{tensor}`: {expected}", path.display())]
    Weights {
        /// The weights file.
        path: PathBuf,
        /// The tensor's name there.
        tensor: String,
        /// What was expected, and what was found.
        expected: String,
    },
    /// The model was asked for what it was not made or trained for.
    #[error("{0}")]
    Unsupported(String),
    /// What was asked for is right, and failed: a device, another worker, a training that diverged.
    #[error("{0}")]
    Failed(String),
}

impl Error {
    /// A wrong `field` of a config.
    pub fn config(
        source_name: impl Into<String>,
        field: impl Into<String>,
        expected: impl Into<String>,
    ) -> Self {
        Self::Config {
            source_name: source_name.into(),
            field: field.into(),
            expected: expected.into(),
        }
    }

    /// A tensor that is missing, unexpected or misshapen.
    pub fn weights(
        path: impl AsRef<Path>,
        tensor: impl Into<String>,
        expected: impl Into<String>,
    ) -> Self {
        Self::Weights {
            path: path.as_ref().to_owned(),
            tensor: tensor.into(),
            expected: expected.into(),
        }
    }
}
