//! Image metrics. A new one is one file here plus one row of [`METRICS`].

mod psnr;

pub use psnr::{psnr, psnr_where};

use lumi_core::DisplayImage;

/// A metric between a prediction and the truth, both display-encoded and of one size.
pub struct Metric {
    /// Name in reports.
    pub name: &'static str,
    /// Unit, for tables.
    pub unit: &'static str,
    /// Whether larger is better.
    pub higher_is_better: bool,
    /// Over the whole image.
    pub compute: fn(&DisplayImage, &DisplayImage) -> f64,
}

/// All metrics.
pub const METRICS: &[Metric] = &[Metric {
    name: "psnr",
    unit: "dB",
    higher_is_better: true,
    compute: psnr,
}];
