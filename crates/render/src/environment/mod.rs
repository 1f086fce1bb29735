//! Environment maps: procedural ones, so that training never depends on a few photographs, and files.

mod file;
mod procedural;

pub use file::list;
pub use procedural::procedural;
