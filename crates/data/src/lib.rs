//! Scene formats and light-basis data sets.
//!
//! [`open`] turns a folder in any of the [`formats::FORMATS`] into one [`lumi_core::Scene`];
//! [`views`] shows it under a [`Lighting`] at the size a model wants. [`store`] holds what is trained on.

pub mod ball;
pub mod check;
pub mod downscale;
pub mod formats;
mod json;
pub mod lens;
pub mod lighting;
pub mod manifest;
pub mod mask;
pub mod page;
#[doc(hidden)]
pub mod parsers;
pub mod store;
pub mod upright;
pub mod views;

pub use formats::{open, open_with};
pub use json::without_byte_order_mark;
pub use lighting::Lighting;
pub use manifest::Manifest;
pub use views::{
    Orbit, input_light, inputs_under, photographs, spread_inputs, usual_source, views_under,
};
