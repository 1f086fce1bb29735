//! What an evaluation found, as JSON and as a table.

use serde::Serialize;
use std::collections::BTreeMap;
use std::fmt;

/// Mean PSNR in dB of one method.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Scores {
    /// As it is.
    pub raw: f64,
    /// After one scale per image and channel.
    pub ilr: f64,
    /// After one scale per scene (all views of a case) and channel.
    pub slr: f64,
    /// As `slr`, over the object's pixels alone.
    pub slr_object: f64,
}

/// One object's, or the mean over objects'.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Row {
    /// The model.
    pub model: Scores,
    /// Trivial answer: the nearest input view, unchanged.
    pub nearest: Scores,
    /// Trivial answer: the model's own decode without the edit.
    pub unedited: Scores,
}

/// A whole evaluation.
#[derive(Clone, Debug, Serialize)]
pub struct Report {
    /// Protocol.
    pub protocol: String,
    /// Weights and where they come from.
    pub model: String,
    /// Data set.
    pub data: String,
    /// Side of the images in pixels.
    pub resolution: usize,
    /// Mean over objects.
    pub mean: Row,
    /// By object.
    pub per_object: BTreeMap<String, Row>,
    /// Model, nearest and unedited SLR PSNR by target lighting, means over objects.
    pub per_target: BTreeMap<String, [f64; 3]>,
    /// Objects that could not be evaluated, with the cause.
    pub failures: BTreeMap<String, String>,
}

impl Scores {
    pub(crate) fn mean(all: &[Self]) -> Self {
        let n = all.len().max(1) as f64;
        let mean = |f: fn(&Self) -> f64| all.iter().map(f).sum::<f64>() / n;
        Self {
            raw: mean(|s| s.raw),
            ilr: mean(|s| s.ilr),
            slr: mean(|s| s.slr),
            slr_object: mean(|s| s.slr_object),
        }
    }
}

impl Row {
    pub(crate) fn mean(all: &[Self]) -> Self {
        let pick = |f: fn(&Self) -> Scores| Scores::mean(&all.iter().map(f).collect::<Vec<_>>());
        Self {
            model: pick(|r| r.model),
            nearest: pick(|r| r.nearest),
            unedited: pick(|r| r.unedited),
        }
    }

    /// How far the model is above the better trivial answer, in dB after per-scene alignment.
    #[must_use]
    pub fn margin(&self) -> f64 {
        self.model.slr - self.nearest.slr.max(self.unedited.slr)
    }
}

impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(
            f,
            "{} on {}, {} px, {}: PSNR in dB after one scale per scene and channel",
            self.protocol, self.data, self.resolution, self.model
        )?;
        writeln!(
            f,
            "{:16} {:>8} {:>9} {:>9} {:>8}",
            "object", "model", "nearest", "unedited", "margin"
        )?;
        let mut line = |name: &str, row: &Row| {
            let (m, n, u) = (row.model.slr, row.nearest.slr, row.unedited.slr);
            writeln!(f, "{name:16} {m:8.2} {n:9.2} {u:9.2} {:+8.2}", row.margin())
        };
        for (name, row) in &self.per_object {
            line(name, row)?;
        }
        line("mean", &self.mean)?;
        let m = &self.mean.model;
        writeln!(
            f,
            "model: raw {:.2}, per-image scale {:.2}, object pixels only {:.2}",
            m.raw, m.ilr, m.slr_object
        )?;
        for (name, cause) in &self.failures {
            writeln!(f, "failed: {name}: {cause}")?;
        }
        Ok(())
    }
}
