//! Scene formats and light-basis data sets.

pub mod store;
