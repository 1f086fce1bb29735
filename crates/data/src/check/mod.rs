//! What a capture holds, and whether poses, masks and lights make sense together.

mod hull;
mod measure;
mod picture;
mod problems;
mod report;

pub use hull::agreement;
pub use picture::picture;
pub use report::{Exposure, LightReport, Problem, Report, Severity, ViewReport};

use crate::formats;
use lumi_core::{Result, Scene};
use std::path::Path;

/// Opens the scene in `folder` and checks it.
///
/// # Errors
/// If it cannot be opened at all, as [`crate::open`].
pub fn check_folder(folder: impl AsRef<Path>) -> Result<Report> {
    let format = formats::detect(&folder)?;
    Ok(check(&format.open(folder.as_ref())?, format.name))
}

/// Measures `scene` and lists its problems; `format` is only repeated in the report.
#[must_use]
pub fn check(scene: &Scene, format: &str) -> Report {
    let mut report = measure::measure(scene, format);
    problems::list(scene, &mut report);
    report
}
