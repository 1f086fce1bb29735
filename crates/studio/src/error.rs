//! What went wrong with a request, and the HTTP status that says so.

use axum::Json;
use axum::http::StatusCode;
use axum::response::{IntoResponse, Response};
use serde_json::json;

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
    fn from(e: lumi_core::Error) -> Self {
        Self::Invalid(e.to_string())
    }
}

impl From<lumi_model::Error> for Error {
    fn from(e: lumi_model::Error) -> Self {
        Self::Invalid(e.to_string())
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
        (self.status(), Json(json!({"error": self.to_string()}))).into_response()
    }
}
