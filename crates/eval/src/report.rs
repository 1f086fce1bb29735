//! What an evaluation found. Written as JSON; the schema is described in `docs/evaluation.md`.

use crate::figures::{Aligned, Figures};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Version of the layout of reports; a reader of another one must refuse.
pub const SCHEMA: &str = "lumi-eval/1";

/// A whole evaluation.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Report {
    /// [`SCHEMA`].
    pub schema: String,
    /// Protocol.
    pub protocol: String,
    /// What was scored: a model's fingerprint and origin, or a folder of pictures.
    pub model: String,
    /// Data set.
    pub data: String,
    /// What else the figures depend on.
    pub settings: Settings,
    /// Means over the objects.
    #[serde(flatten)]
    pub figures: Figures,
    /// Means over the objects of the answers that take no relighting model.
    pub trivial: BTreeMap<String, Figures>,
    /// By object.
    pub per_object: BTreeMap<String, ObjectRecord>,
    /// Whole-image scores by target lighting and method, means over the objects.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub per_target: BTreeMap<String, BTreeMap<String, Aligned>>,
    /// Scores after each edit, by chain and method, means over the objects that have that step.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub chains: Chains,
    /// Other weights on the same cases (protocol `ablation`), by name; the figures above are the first one's.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub variants: BTreeMap<String, Variant>,
    /// What a reader should know.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub notes: Vec<String>,
    /// Objects that could not be evaluated, with the cause.
    pub failures: BTreeMap<String, String>,
}

/// What figures depend on besides model and data.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Settings {
    /// Side of the images in pixels.
    pub resolution: usize,
    /// Input views per object; 0 where the method's own are not known.
    pub inputs: usize,
    /// Name of the rules by which images are compared.
    pub rules: String,
    /// The same in words.
    pub rules_about: String,
    /// Which of the figures the rules' benchmark publishes.
    pub headline: String,
    /// Network of LPIPS.
    pub lpips: String,
    /// Version of the program.
    pub version: String,
}

/// Chains of edits: chain, method, steps.
pub type Chains = BTreeMap<String, BTreeMap<String, Vec<Step>>>;

/// One object's part of a report.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ObjectRecord {
    /// Means over the object's cases.
    #[serde(flatten)]
    pub figures: Figures,
    /// The answers that take no relighting model.
    pub trivial: BTreeMap<String, Figures>,
    /// By target lighting.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub cases: BTreeMap<String, Case>,
    /// Scores after each edit.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub chains: Chains,
}

/// One target lighting of one object.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Case {
    /// Names of the views, in the order of per-view values.
    pub views: Vec<String>,
    /// The method's.
    #[serde(flatten)]
    pub figures: Figures,
    /// The answers that take no relighting model.
    pub trivial: BTreeMap<String, Figures>,
}

/// The state after one edit of a chain.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Step {
    /// What was done, such as `set point1`; empty in means over objects whose chains differ.
    pub edit: String,
    /// Scores of the held-out views.
    #[serde(flatten)]
    pub figures: Figures,
}

/// Another method's means.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Variant {
    /// Fingerprint and origin.
    pub model: String,
    /// Means over the objects.
    #[serde(flatten)]
    pub figures: Figures,
    /// How far it is above the best trivial answer, in dB after one scale per scene.
    pub margin: Option<f64>,
}

impl ObjectRecord {
    /// From an object's cases: means.
    #[must_use]
    pub fn from_cases(cases: BTreeMap<String, Case>) -> Self {
        Self {
            figures: Figures::mean(cases.values().map(|c| &c.figures)),
            trivial: means(cases.values().map(|c| &c.trivial)),
            cases,
            chains: Chains::new(),
        }
    }
}

/// Mean of each method over those who have it.
fn means<'a>(
    all: impl IntoIterator<Item = &'a BTreeMap<String, Figures>>,
) -> BTreeMap<String, Figures> {
    let mut lists: BTreeMap<String, Vec<&Figures>> = BTreeMap::new();
    for methods in all {
        for (name, figures) in methods {
            lists.entry(name.clone()).or_default().push(figures);
        }
    }
    let mean = |(name, list): (String, Vec<&Figures>)| (name, Figures::mean(list));
    lists.into_iter().map(mean).collect()
}

impl Report {
    /// Fills the means from `per_object`.
    #[must_use]
    pub fn with_means(mut self) -> Self {
        let objects = &self.per_object;
        self.figures = Figures::mean(objects.values().map(|o| &o.figures));
        self.trivial = means(objects.values().map(|o| &o.trivial));
        let mut targets: BTreeMap<String, Vec<BTreeMap<String, Figures>>> = BTreeMap::new();
        for (name, case) in objects.values().flat_map(|o| &o.cases) {
            let mut methods = case.trivial.clone();
            methods.insert("model".to_owned(), case.figures.clone());
            targets.entry(name.clone()).or_default().push(methods);
        }
        self.per_target = targets
            .into_iter()
            .map(|(name, list)| {
                let whole = means(&list).into_iter().map(|(m, f)| (m, f.whole));
                (name, whole.collect())
            })
            .collect();
        self.chains = mean_chains(objects.values().map(|o| &o.chains));
        self
    }

    /// How far the method is above the best trivial answer: PSNR in dB after one scale per scene.
    #[must_use]
    pub fn margin(&self) -> Option<f64> {
        margin(&self.figures, &self.trivial)
    }
}

/// How far `figures` are above the best of `trivial`: PSNR in dB after one scale per scene.
#[must_use]
pub fn margin(figures: &Figures, trivial: &BTreeMap<String, Figures>) -> Option<f64> {
    let slr = |f: &Figures| f.whole.slr.get("psnr");
    let best = trivial.values().filter_map(slr).reduce(f64::max)?;
    Some(slr(figures)? - best)
}

fn mean_chains<'a>(all: impl IntoIterator<Item = &'a Chains>) -> Chains {
    let mut lists: BTreeMap<(String, String), Vec<&Vec<Step>>> = BTreeMap::new();
    for chains in all {
        for (chain, methods) in chains {
            for (method, steps) in methods {
                let key = (chain.clone(), method.clone());
                lists.entry(key).or_default().push(steps);
            }
        }
    }
    let mut out = Chains::new();
    for ((chain, method), lists) in lists {
        let longest = lists.iter().map(|l| l.len()).max().unwrap_or(0);
        let steps = (0..longest).map(|k| {
            let at: Vec<&Step> = lists.iter().filter_map(|l| l.get(k)).collect();
            let same = at.windows(2).all(|w| w[0].edit == w[1].edit);
            Step {
                edit: at
                    .first()
                    .filter(|_| same)
                    .map_or(String::new(), |s| s.edit.clone()),
                figures: Figures::mean(at.iter().map(|s| &s.figures)),
            }
        });
        out.entry(chain)
            .or_default()
            .insert(method, steps.collect());
    }
    out
}
