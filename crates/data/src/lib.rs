//! Scene formats and light-basis data sets.

mod downscale;
pub mod store;
