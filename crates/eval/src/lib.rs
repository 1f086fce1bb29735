//! Metrics and evaluation protocols. Below `train` on purpose: what scores a model may also train it.

pub mod align;
pub mod metrics;
pub mod novel_view;
pub mod report;

pub use novel_view::novel_view;
pub use report::Report;

/// Result with the model's error type, which covers files, scenes and weights.
pub type Result<T> = lumi_model::Result<T>;
