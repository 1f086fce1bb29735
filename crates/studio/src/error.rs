//! What went wrong with a request, and the HTTP status that says so.

use crate::reply::Failed;
use axum::Json;
use axum::http::StatusCode;
use axum::response::{IntoResponse, Response};

/// Result with this crate's [`Error`].
pub type Result<T> = std::result::Result<T, Error>;

/// Why a request was not carried out. The text is for people and is sent as `{"error": text}`.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The request or a file in it is not as it must be.
    #[error("{0}")]
    Invalid(String),
    /// Somebody asked who may not.
    #[error("{0}")]
    Forbidden(String),
    /// There is no such thing.
    #[error("{0}")]
    NotFound(String),
    /// It does not fit what is there now.
    #[error("{0}")]
    Conflict(String),
    /// More than a limit allows.
    #[error("{0}")]
    TooLarge(String),
    /// No room at the moment.
    #[error("{0}")]
    Busy(String),
    /// A fault of the server.
    #[error("internal error: {0}")]
    Internal(String),
}

impl Error {
    /// The HTTP status.
    #[must_use]
    pub fn status(&self) -> StatusCode {
        match self {
            Self::Invalid(_) => StatusCode::UNPROCESSABLE_ENTITY,
            Self::Forbidden(_) => StatusCode::FORBIDDEN,
            Self::NotFound(_) => StatusCode::NOT_FOUND,
            Self::Conflict(_) => StatusCode::CONFLICT,
            Self::TooLarge(_) => StatusCode::PAYLOAD_TOO_LARGE,
            Self::Busy(_) => StatusCode::SERVICE_UNAVAILABLE,
            Self::Internal(_) => StatusCode::INTERNAL_SERVER_ERROR,
        }
    }
}

impl From<lumi_core::Error> for Error {
    /// What is wrong with a file that somebody sent is theirs; a disk that is full or does not answer is the server's.
    fn from(e: lumi_core::Error) -> Self {
        use std::io::ErrorKind as Kind;
        let text = e.to_string();
        match e {
            lumi_core::Error::Io { source, .. } => match source.kind() {
                Kind::NotFound
                | Kind::InvalidData
                | Kind::InvalidInput
                | Kind::UnexpectedEof
                | Kind::IsADirectory
                | Kind::NotADirectory
                | Kind::InvalidFilename => Self::Invalid(text),
                _ => Self::Internal(text),
            },
            lumi_core::Error::Invalid { .. } | lumi_core::Error::Value { .. } => {
                Self::Invalid(text)
            }
        }
    }
}

impl From<lumi_model::Error> for Error {
    fn from(e: lumi_model::Error) -> Self {
        match e {
            lumi_model::Error::Core(e) => e.into(),
            lumi_model::Error::Unsupported(text) => Self::Invalid(text),
            // The model was loaded before anybody asked for anything.
            lumi_model::Error::Config { .. }
            | lumi_model::Error::Weights { .. }
            | lumi_model::Error::Failed(_) => Self::Internal(e.to_string()),
        }
    }
}

impl From<tokio::task::JoinError> for Error {
    fn from(e: tokio::task::JoinError) -> Self {
        Self::Internal(format!("the work on this request ended early: {e}"))
    }
}

impl From<axum::extract::multipart::MultipartError> for Error {
    fn from(e: axum::extract::multipart::MultipartError) -> Self {
        Self::Invalid(format!("upload: {}", e.body_text()))
    }
}

impl IntoResponse for Error {
    fn into_response(self) -> Response {
        let error = self.to_string();
        (self.status(), Json(Failed { error })).into_response()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::ErrorKind;

    #[test]
    fn a_full_disk_is_no_fault_of_the_client() {
        let status = |kind: ErrorKind| {
            let io = lumi_core::Error::io("/data/session", kind.into());
            Error::from(lumi_model::Error::from(io)).status().as_u16()
        };
        assert_eq!(status(ErrorKind::StorageFull), 500);
        assert_eq!(status(ErrorKind::PermissionDenied), 500);
        assert_eq!(status(ErrorKind::NotFound), 422);
        let value = lumi_core::Error::value("point.power", "expected a positive number");
        assert_eq!(Error::from(value).status().as_u16(), 422);
        let asked = lumi_model::Error::Unsupported("this model takes no suns".into());
        assert_eq!(Error::from(asked).status().as_u16(), 422);
        let failed = lumi_model::Error::Failed("the device has failed".into());
        assert_eq!(Error::from(failed).status().as_u16(), 500);
        let weights = lumi_model::Error::weights("w", "t", "expected another shape");
        assert_eq!(Error::from(weights).status().as_u16(), 500);
    }
}
