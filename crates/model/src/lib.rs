//! The LumiTokens network: tokenizers, encoder, Scene Token Editor, decoder, heads, checkpoints.
//!
//! Read [`network`] for the whole forward pass and [`relighter`] for how everything else uses it.
//! Tensors begin here; the crates below deal in plain types.

pub mod batch;
pub mod block;
mod bridge;
pub mod checkpoint;
pub mod config;
pub mod cost;
mod edits_file;
pub mod error;
mod exposure;
pub mod head;
pub mod illumination;
pub mod import;
pub mod layers;
pub mod lights;
pub mod network;
mod overlap;
pub mod params;
pub mod places;
pub mod radiance;
mod random;
mod refine;
pub mod relighter;
pub mod resize;
mod tokens_file;
mod turns;
pub mod verify;

pub use burn::tensor::Device;
pub use config::ModelConfig;
pub use edits_file::{EditEntry, EditsFile};
pub use error::{Error, Result};
pub use exposure::Exposure;
pub use illumination::Illumination;
pub use lights::AuthorsFrame;
pub use lumi_kernels::Precision;
pub use network::Network;
pub use relighter::{Edit, Mode, Relighter, SceneFrame, SceneTokens};
