//! From objects' records to a report that says what it is about.

use crate::Result;
use crate::metrics::Judge;
use crate::report::{ObjectRecord, Report, SCHEMA, Settings};
use lumi_core::Error;
use std::collections::BTreeMap;
use std::path::Path;

/// What predictions hold.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Values {
    /// Display-encoded values, as models make them and PNG and JPEG files hold them.
    Display,
    /// Linear ones, from EXR or HDR files.
    Linear,
    /// Some pictures this, some that.
    Mixed,
}

/// What a report is about.
pub(crate) struct About<'a> {
    /// [`Report::protocol`].
    pub protocol: &'a str,
    /// [`Report::model`].
    pub model: String,
    /// [`Report::data`].
    pub data: String,
    /// Where the objects or their predictions lie, for errors.
    pub place: &'a Path,
    /// [`Settings::resolution`].
    pub resolution: usize,
    /// [`Settings::inputs`].
    pub inputs: usize,
    /// What the predictions hold.
    pub values: Values,
}

impl About<'_> {
    /// The report of objects by name; those that failed, with the cause in words, are listed.
    ///
    /// # Errors
    /// If all failed.
    pub(crate) fn report(
        self,
        objects: BTreeMap<String, std::result::Result<ObjectRecord, String>>,
        judge: &Judge,
    ) -> Result<Report> {
        let mut report = Report {
            schema: SCHEMA.to_owned(),
            protocol: self.protocol.to_owned(),
            settings: self.settings(judge),
            model: self.model,
            data: self.data,
            ..Report::default()
        };
        for (name, object) in objects {
            match object {
                Ok(record) => drop(report.per_object.insert(name, record)),
                Err(cause) => drop(report.failures.insert(name, cause)),
            }
        }
        if report.per_object.is_empty() {
            let causes: Vec<_> = report.failures.into_values().collect();
            let expected = format!(
                "expected at least one object that can be scored: {}",
                causes.join("; ")
            );
            return Err(Error::invalid(self.place, "objects", expected).into());
        }
        let mut report = report.with_means();
        report.notes = notes(judge, &report, self.values);
        Ok(report)
    }

    fn settings(&self, judge: &Judge) -> Settings {
        let headline = match judge.rules.exposure_search {
            Some(_) if self.values == Values::Linear => "object_only.exposure",
            _ => judge.rules.headline,
        };
        Settings {
            resolution: self.resolution,
            inputs: self.inputs,
            rules: judge.rules.name.to_owned(),
            rules_about: judge.rules.about.to_owned(),
            headline: headline.to_owned(),
            lpips: format!("{:?}", judge.net()).to_lowercase(),
            version: env!("CARGO_PKG_VERSION").to_owned(),
        }
    }
}

/// What a reader of a report should know.
fn notes(judge: &Judge, report: &Report, values: Values) -> Vec<String> {
    let mut notes = judge.limits(report.settings.resolution);
    if judge.rules.high_range {
        let measured = report.figures.whole.ilr.get("psnr_hdr").is_some();
        if !measured {
            notes.push(
                "PSNR-H is not reported: the truth is clipped to what a display shows".to_owned(),
            );
        } else if values != Values::Linear {
            notes.push(
                "predictions were clipped to what a display shows before anything was measured, which limits PSNR-H"
                    .to_owned(),
            );
        }
    }
    if judge.rules.exposure_search.is_some() && values == Values::Mixed {
        notes.push(
            "some predictions are tone-mapped, some linear: the benchmark takes `raw` of the former and `exposure` \
             of the latter, so neither mean is its own"
                .to_owned(),
        );
    }
    notes
}
