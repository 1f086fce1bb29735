//! The Python package `lumitokens`: the model, scenes, scores, the studio and the `lumi` program as one extension module.
//!
//! Every function here is a thin layer over the crates below; what Python sees of it is described in
//! `python/lumitokens/_lumitokens.pyi` and `docs/python.md`.

mod arrays;
mod camera;
mod errors;
mod images;
mod json;
mod lights;
mod model;
mod scene;
mod score;
mod studio;
mod tokens;
mod view;
mod work;

use pyo3::prelude::*;
use std::ffi::OsString;
use std::process::ExitCode;

/// The extension module behind the package.
#[pymodule]
mod _lumitokens {
    #[pymodule_export]
    use super::camera::Camera;
    #[pymodule_export]
    use super::images::{read_display, read_linear, to_display, write_exr, write_png};
    #[pymodule_export]
    use super::lights::{Area, Environment, Light, Point, Spot, Sun};
    #[pymodule_export]
    use super::model::{Model, load};
    #[pymodule_export]
    use super::run_program;
    #[pymodule_export]
    use super::scene::{Scene, demo_evaluation, demo_scene, open_scene, scene_formats};
    #[pymodule_export]
    use super::score::{Report, compare, evaluate, score};
    #[pymodule_export]
    use super::studio::{Studio, studio};
    #[pymodule_export]
    use super::tokens::SceneTokens;
    #[pymodule_export]
    use super::view::View;

    /// Version of the program and the package.
    #[pymodule_export]
    const VERSION: &str = env!("CARGO_PKG_VERSION");
}

/// Runs the `lumi` program with its arguments, its own name first, and returns its exit status.
#[pyfunction]
fn run_program(py: Python<'_>, args: Vec<OsString>) -> u8 {
    let status = py.detach(|| lumi_cli::run(args));
    // The standard library does not say the number of an exit status.
    let number = (0..=u8::MAX).find(|n| ExitCode::from(*n) == status);
    number.unwrap_or(u8::MAX)
}
