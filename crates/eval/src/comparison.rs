//! Several methods on the same truth, side by side.

use crate::Result;
use crate::figures::Figures;
use crate::markdown::{head, summary, tone, triple, trivial_rows};
use crate::report::Report;
use lumi_core::Error;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write;

/// Version of the layout; a reader of another one must refuse.
pub const SCHEMA: &str = "lumi-comparison/1";

/// Reports of several methods whose means are over the same objects.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Comparison {
    /// [`SCHEMA`].
    pub schema: String,
    /// The methods, in the order in which they were named.
    pub methods: Vec<Compared>,
    /// What a reader should know.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub notes: Vec<String>,
}

/// A method and its report.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Compared {
    /// What tables call it.
    pub name: String,
    /// Everything that was found of it.
    pub report: Report,
}

impl Comparison {
    /// From a report of each method on the same truth. An object that not every method has would favour some: it is taken from
    /// all and listed among their failures.
    ///
    /// # Errors
    /// If there is no method, or no object that all of them have.
    pub fn new(methods: impl IntoIterator<Item = (String, Report)>) -> Result<Self> {
        let methods = methods.into_iter();
        let mut methods: Vec<_> = methods
            .map(|(name, report)| Compared { name, report })
            .collect();
        let lacks = lacking(&methods);
        for Compared { report, .. } in &mut methods {
            let objects = std::mem::take(&mut report.per_object);
            for (object, record) in objects {
                match lacks.get(&object) {
                    None => drop(report.per_object.insert(object, record)),
                    Some(other) => {
                        let cause = format!("not compared, since `{other}` has no figures for it");
                        report.failures.insert(object, cause);
                    }
                }
            }
            *report = std::mem::take(report).with_means();
        }
        let found = methods.first().map(|m| m.report.per_object.len());
        if found.is_none_or(|objects| objects == 0) {
            let expected = "expected at least one object that every method has";
            return Err(Error::value("methods", expected).into());
        }
        let mut notes = BTreeSet::new();
        for Compared { report, .. } in &methods {
            notes.extend(report.notes.iter().cloned());
        }
        let side = |m: &Compared| m.report.settings.resolution;
        let mut notes: Vec<String> = notes.into_iter().collect();
        if methods.iter().any(|m| side(m) != side(&methods[0])) {
            let list = methods.iter().map(|m| format!("{} {} px", m.name, side(m)));
            notes.push(format!(
                "the methods' pictures are of different sizes, at which figures do not compare: {}",
                list.collect::<Vec<_>>().join(", ")
            ));
        }
        Ok(Self {
            schema: SCHEMA.to_owned(),
            methods,
            notes,
        })
    }

    /// Whether every method has every object.
    #[must_use]
    pub fn is_complete(&self) -> bool {
        self.methods.iter().all(|m| m.report.failures.is_empty())
    }

    /// One row per method, then the answers that take no model.
    fn rows<'a>(&'a self, trivial: impl Iterator<Item = (&'a str, &'a Figures)>) -> Rows<'a> {
        let methods = self.methods.iter();
        let methods = methods.map(|m| (m.name.as_str(), &m.report.figures));
        methods.chain(trivial).collect()
    }

    /// All methods in one table of each kind, with the answers that take no model.
    #[must_use]
    pub fn markdown(&self) -> String {
        let first = &self.methods[0].report;
        let (s, objects) = (&first.settings, first.per_object.len());
        let mut out = format!("# {}: {} methods\n\n", first.protocol, self.methods.len());
        let _ = writeln!(
            out,
            "Data: {}, {objects} objects, {} × {} px. Rules `{}`: {}. LPIPS over {}.\n",
            first.data, s.resolution, s.resolution, s.rules, s.rules_about, s.lpips
        );
        for note in &self.notes {
            let _ = writeln!(out, "Note: {note}.\n");
        }
        let rows = self.rows(trivial_rows(first));
        summary(&mut out, s, &rows);
        tone(&mut out, &rows);
        self.objects_table(&mut out, &rows);
        self.targets_table(&mut out);
        if !self.is_complete() {
            out.push_str("## Failed objects\n\n");
            for Compared { name, report } in &self.methods {
                for (object, cause) in &report.failures {
                    let _ = writeln!(out, "- {name}: {object}: {cause}");
                }
            }
        }
        out
    }

    fn objects_table(&self, out: &mut String, means: &Rows) {
        out.push_str("## By object: PSNR in dB, whole images, one scale per scene and channel\n\n");
        let names = means.iter().map(|(name, _)| (*name).to_owned());
        head(out, ["object".to_owned()].into_iter().chain(names));
        let mut line = |object: &str, figures: &[Option<&Figures>]| {
            let psnr = |f: &Option<&Figures>| f.and_then(|f| f.whole.slr.get("psnr"));
            let cells = figures.iter().map(psnr);
            let cells = cells.map(|v| v.map_or("–".into(), |v| format!("{v:.2}")));
            let cells: Vec<String> = cells.collect();
            let _ = writeln!(out, "| {object} | {} |", cells.join(" | "));
        };
        let first = &self.methods[0].report;
        for (object, record) in &first.per_object {
            let methods = self.methods.iter().map(|m| &m.report.per_object);
            let methods = methods.map(|objects| objects.get(object).map(|o| &o.figures));
            let trivial = first.trivial.keys().map(|name| record.trivial.get(name));
            line(object, &methods.chain(trivial).collect::<Vec<_>>());
        }
        let means: Vec<_> = means.iter().map(|(_, figures)| Some(*figures)).collect();
        line("**mean**", &means);
        out.push('\n');
    }

    fn targets_table(&self, out: &mut String) {
        out.push_str("## By target lighting: PSNR / SSIM / LPIPS after one scale per scene\n\n");
        let names = self.methods.iter().map(|m| m.name.clone());
        head(out, ["lighting".to_owned()].into_iter().chain(names));
        for target in self.methods[0].report.per_target.keys() {
            let cell = |m: &Compared| {
                let found = m.report.per_target.get(target)?.get("model")?;
                Some(triple(&found.slr))
            };
            let cells = self.methods.iter().map(cell);
            let cells: Vec<String> = cells.map(|c| c.unwrap_or("–".into())).collect();
            let _ = writeln!(out, "| {target} | {} |", cells.join(" | "));
        }
        out.push('\n');
    }
}

/// Names and figures of a table's rows.
type Rows<'a> = Vec<(&'a str, &'a Figures)>;

/// The objects that some method has no figures for, each with the first such method.
fn lacking(methods: &[Compared]) -> BTreeMap<String, String> {
    let all = methods.iter().flat_map(|m| m.report.per_object.keys());
    let all: BTreeSet<&String> = all.collect();
    let first = |object: &String| {
        let lacks = |m: &&Compared| !m.report.per_object.contains_key(object);
        let other = methods.iter().find(lacks)?;
        Some((object.clone(), other.name.clone()))
    };
    all.into_iter().filter_map(first).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::figures::Aligned;
    use crate::metrics::Scores;
    use crate::report::ObjectRecord;

    fn report(objects: &[(&str, f64)]) -> Report {
        let record = |psnr: f64| {
            let scores = Scores([("psnr".to_owned(), Some(psnr))].into());
            let whole = Aligned {
                slr: scores,
                ..Aligned::default()
            };
            ObjectRecord {
                figures: Figures {
                    whole,
                    ..Figures::default()
                },
                ..ObjectRecord::default()
            }
        };
        let objects = objects.iter();
        Report {
            per_object: objects
                .map(|(n, v)| ((*n).to_owned(), record(*v)))
                .collect(),
            ..Report::default()
        }
        .with_means()
    }

    #[test]
    fn means_are_over_what_every_method_has() {
        let (a, b) = (
            report(&[("cow", 20.0), ("cup", 30.0)]),
            report(&[("cow", 22.0)]),
        );
        let both = [("a".to_owned(), a), ("b".to_owned(), b.clone())];
        let both = Comparison::new(both).expect("a common object");
        let means = both
            .methods
            .iter()
            .map(|m| m.report.figures.whole.slr.get("psnr"));
        assert_eq!(means.collect::<Vec<_>>(), [Some(20.0), Some(22.0)]);
        assert!(!both.is_complete());
        let text = both.markdown();
        assert!(text.contains("| cow | 20.00 | 22.00 |"), "{text}");
        assert!(text.contains("- a: cup: not compared, since `b`"), "{text}");

        let apart = [
            ("a".to_owned(), report(&[("cup", 1.0)])),
            ("b".to_owned(), b),
        ];
        let message = Comparison::new(apart)
            .expect_err("nothing common")
            .to_string();
        assert!(message.contains("every method has"), "{message}");
        assert!(Comparison::new([]).is_err());
    }
}
