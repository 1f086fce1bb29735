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
pub mod illumination;
pub mod head;
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

pub use config::ModelConfig;
pub use edits_file::{EditEntry, EditsFile};
pub use error::{Error, Result};
pub use lights::ReleaseFrame;
pub use network::Network;
pub use illumination::Illumination;
pub use relighter::{Edit, Mode, Relighter, SceneFrame, SceneTokens};
