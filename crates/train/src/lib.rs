//! Training: stages, samples, the loop and its state.
//!
//! Read [`run`] for the loop. A batch depends on the step alone, so a resumed run sees exactly what
//! an uninterrupted one would.

pub mod augment;
pub mod batch;
mod begin;
pub mod config;
pub mod cost;
pub mod handover;
pub mod loader;
mod log;
pub mod object;
pub mod objective;
pub mod optim;
pub mod plan;
pub mod reduce;
pub mod run;
pub mod sample;
pub mod state;
pub mod tensorboard;
pub mod validate;

pub use config::TrainConfig;
pub use run::{Finished, train};

/// Result with the model's error type, which covers files, configs and weights.
pub type Result<T> = lumi_model::Result<T>;
