//! Metrics and evaluation protocols. Below `train` on purpose: what scores a model may also train it.
//!
//! [`evaluate`] runs a [`Protocol`] of the paper over a [`Collection`] of objects and yields a [`Report`];
//! [`score`] does the same for pictures that any method saved. A [`Judge`] compares images by a benchmark's
//! [`Rules`] with the metrics of the table [`metrics::METRICS`].

pub mod align;
mod assemble;
pub mod baselines;
pub mod cases;
pub mod collection;
pub mod comparison;
pub mod draw;
pub mod exposure;
pub mod figures;
pub mod gallery;
pub mod markdown;
pub mod metrics;
pub mod picture;
pub mod plots;
pub mod protocols;
pub mod report;
pub mod rules;
mod run;
pub mod score;

pub use collection::Collection;
pub use comparison::Comparison;
pub use metrics::{Judge, Lpips, Net};
pub use picture::Picture;
pub use protocols::Protocol;
pub use report::Report;
pub use rules::Rules;
pub use run::{Options, Outcome, evaluate};

/// Result with the model's error type, which covers files, scenes and weights.
pub type Result<T> = lumi_model::Result<T>;
