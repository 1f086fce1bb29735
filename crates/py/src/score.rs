//! Metrics and protocols: the code of `lumi eval` and `lumi score`.

use crate::arrays::{Images, exactly, shown};
use crate::errors::{raised, wrong};
use crate::model::Model;
use crate::{json, work};
use lumi_eval::figures::Detail;
use lumi_eval::gallery::Gallery;
use lumi_eval::markdown::markdown;
use lumi_eval::protocols::PROTOCOLS;
use lumi_eval::rules::RULES;
use lumi_eval::score::{Method, Truth};
use lumi_eval::{Collection, Comparison, Judge, Lpips, Net, Options, Picture, Protocol, Rules};
use lumi_model::Device;
use numpy::PyArray3;
use pyo3::prelude::*;
use std::path::PathBuf;

/// What was found of one method or several: the report that `lumi score` and `lumi eval` write.
#[pyclass(frozen, module = "lumitokens")]
pub struct Report {
    found: Found,
    gallery: Gallery,
}

enum Found {
    One(Box<lumi_eval::Report>),
    Several(Comparison),
}

#[pymethods]
impl Report {
    /// The report as plain dicts, lists and numbers: schema `lumi-eval/1`, or `lumi-comparison/1` of several methods.
    fn to_dict<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        match &self.found {
            Found::One(report) => json::to_python(py, report),
            Found::Several(comparison) => json::to_python(py, comparison),
        }
    }

    /// The report's tables.
    fn markdown(&self) -> String {
        match &self.found {
            Found::One(report) => markdown(report),
            Found::Several(comparison) => comparison.markdown(),
        }
    }

    /// The contact sheet of the methods beside the truth: array (H, W, 3) of display values, or None where no pictures were
    /// kept.
    fn grid<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyArray3<f32>>>> {
        let page = lumi_cli::score_grid(&self.gallery).map_err(raised)?;
        page.map(|page| shown(py, &page)).transpose()
    }

    fn __getitem__<'py>(&self, py: Python<'py>, key: &str) -> PyResult<Bound<'py, PyAny>> {
        self.to_dict(py)?.get_item(key)
    }

    fn __str__(&self) -> String {
        self.markdown()
    }

    fn __repr__(&self) -> String {
        let names = match &self.found {
            Found::One(report) => report.model.clone(),
            Found::Several(several) => {
                let names = several.methods.iter().map(|m| m.name.as_str());
                names.collect::<Vec<_>>().join(", ")
            }
        };
        format!("Report({names})")
    }
}

/// Scores the saved pictures of one method, or of several side by side.
///
/// Parameters
/// ----------
/// predictions : path, or dict of str to path
///     Folder with OBJECT/CASE/VIEW.png (or .jpg, .exr, .hdr); with several methods, their folders by name.
/// truth : path
///     A folder of the same layout, whose alpha says where the object is, or a data set that `lumi eval` takes.
/// protocol : {"novel-view", "multi-view"}
///     Which views and cases of a data set are expected.
/// rules : {"paper", "stanford-orb", "objects-with-lighting"}
///     The benchmark whose alignment and masking apply.
/// lpips : {"alex", "vgg"}, optional
///     Network of LPIPS; the rules' own if left out.
/// lpips_weights : path, optional
///     Weights of VGG16 (docs/evaluation.md).
/// only, skip : sequence of str
///     Objects of a data set to score, or to leave out.
///
/// Returns
/// -------
/// Report
#[pyfunction]
#[pyo3(
    signature = (
        predictions, truth, *, protocol = "novel-view", rules = "paper", lpips = None, lpips_weights = None,
        only = Vec::new(), skip = Vec::new()
    ),
    text_signature = "(predictions, truth, *, protocol='novel-view', rules='paper', lpips=None, lpips_weights=None, \
                      only=(), skip=())"
)]
#[allow(clippy::too_many_arguments)] // Each has a name and a usual value.
pub fn score(
    py: Python<'_>,
    predictions: &Bound<'_, PyAny>,
    truth: PathBuf,
    protocol: &str,
    rules: &str,
    lpips: Option<&str>,
    lpips_weights: Option<PathBuf>,
    only: Vec<String>,
    skip: Vec<String>,
) -> PyResult<Report> {
    let single = predictions.extract::<PathBuf>().ok();
    let methods: Vec<Method> = match &single {
        Some(folder) => vec![Method {
            name: folder
                .file_name()
                .unwrap_or_default()
                .to_string_lossy()
                .into_owned(),
            folder: folder.clone(),
        }],
        None => {
            let items = predictions.call_method0("items")?;
            let pairs = items.try_iter()?.map(|pair| pair?.extract());
            let pairs: Vec<(String, PathBuf)> = pairs.collect::<PyResult<_>>()?;
            let method = |(name, folder)| Method { name, folder };
            pairs.into_iter().map(method).collect()
        }
    };
    let protocol = find_protocol(protocol)?;
    let judging = Judging::new(rules, lpips, lpips_weights)?;
    work::run(py, move |stop| {
        let truth = Truth::open(&truth, protocol, &only, &skip)?;
        let mut scored = lumi_eval::score::score(&methods, &truth, &judging.judge()?, stop)?;
        let found = match single {
            Some(_) => Found::One(Box::new(scored.reports.remove(0))),
            None => {
                let names = methods.into_iter().map(|method| method.name);
                Found::Several(Comparison::new(names.zip(scored.reports))?)
            }
        };
        Ok(Report {
            found,
            gallery: scored.gallery,
        })
    })
}

/// Scores a model by a protocol of the paper, as `lumi eval` does.
///
/// Parameters
/// ----------
/// model : Model
/// data : path
///     What `lumi eval` takes: a folder with a manifest, a training store, or scenes.
/// protocol : {"novel-view", "multi-view", "progressive"}
/// rules, lpips, lpips_weights, only, skip
///     As of `score`.
/// inputs : int, optional
///     Input views per object; the protocol's if left out.
/// captured_light : bool
///     Whether the model is told the light of the inputs, which the paper's protocols keep from it.
/// out : path, optional
///     Folder for objects' figures and pictures; what is finished there is not done again.
///
/// Returns
/// -------
/// Report
#[pyfunction]
#[pyo3(
    signature = (
        model, data, *, protocol = "novel-view", rules = "paper", lpips = None, lpips_weights = None,
        only = Vec::new(), skip = Vec::new(), inputs = None, captured_light = false, out = None
    ),
    text_signature = "(model, data, *, protocol='novel-view', rules='paper', lpips=None, lpips_weights=None, \
                      only=(), skip=(), inputs=None, captured_light=False, out=None)"
)]
#[allow(clippy::too_many_arguments)] // Each has a name and a usual value.
pub fn evaluate(
    py: Python<'_>,
    model: &Model,
    data: PathBuf,
    protocol: &str,
    rules: &str,
    lpips: Option<&str>,
    lpips_weights: Option<PathBuf>,
    only: Vec<String>,
    skip: Vec<String>,
    inputs: Option<usize>,
    captured_light: bool,
    out: Option<PathBuf>,
) -> PyResult<Report> {
    if inputs.is_some_and(|n| !(1..=32).contains(&n)) {
        return Err(wrong("inputs", "expected 1 to 32"));
    }
    let protocol = find_protocol(protocol)?;
    let judging = Judging::new(rules, lpips, lpips_weights)?;
    let model = model.0.clone();
    let options = Options {
        only,
        skip,
        inputs,
        captured_light,
        out,
        ..Options::default()
    };
    work::run(py, move |stop| {
        let data = Collection::open(&data)?;
        let judge = judging.judge()?;
        let outcome = lumi_eval::evaluate(&model, &data, protocol, &judge, &options, stop)?;
        Ok(Report {
            found: Found::One(Box::new(outcome.report)),
            gallery: Gallery::default(),
        })
    })
}

/// Scores pictures in memory against the truth: every metric after every alignment, over whole images and the object alone.
///
/// Parameters
/// ----------
/// predictions, truth : array (H, W, 3) or (N, H, W, 3)
///     Display-encoded values from 0 to 1, or uint8: the views of one scene in one light.
/// alpha : array of the truth's shape without channels, optional
///     Where the object is, from 0 to 1; everywhere if left out.
/// rules, lpips, lpips_weights
///     As of `score`.
///
/// Returns
/// -------
/// dict
///     `raw`, `ilr`, `slr`, … → metric → value; the same under `object_only`; `tone` (docs/evaluation.md).
#[pyfunction]
#[pyo3(signature = (predictions, truth, alpha = None, *, rules = "paper", lpips = None, lpips_weights = None))]
pub fn compare<'py>(
    py: Python<'py>,
    predictions: &Bound<'py, PyAny>,
    truth: &Bound<'py, PyAny>,
    alpha: Option<&Bound<'py, PyAny>>,
    rules: &str,
    lpips: Option<&str>,
    lpips_weights: Option<PathBuf>,
) -> PyResult<Bound<'py, PyAny>> {
    let read = |value, name| {
        let images = Images::new(value, name)?;
        if images.size[2] != 3 {
            return Err(wrong(
                name,
                "expected three channels; coverage is given as alpha",
            ));
        }
        Ok((images.display()?, images.stacked, images.size))
    };
    let (predictions, ..) = read(predictions, "predictions")?;
    let (mut truth, stacked, [h, w, _]) = read(truth, "truth")?;
    if let Some(alpha) = alpha {
        let (n, of_one, of_many) = (truth.len(), [h, w], [truth.len(), h, w]);
        let shape: &[usize] = if stacked { &of_many } else { &of_one };
        let values = exactly(alpha, "alpha", shape)?;
        for (image, alpha) in truth.iter_mut().zip(values.chunks_exact(values.len() / n)) {
            image.alpha = Some(alpha.to_vec());
        }
    }
    let judging = Judging::new(rules, lpips, lpips_weights)?;
    let figures = work::run(py, move |_| {
        let (predictions, truth) = (Picture::all(&predictions), Picture::all(&truth));
        let judge = judging.judge()?;
        Ok(judge.figures(&predictions, &truth, Detail::Full)?)
    })?;
    json::to_python(py, &figures)
}

/// By which rules, and with which LPIPS.
struct Judging {
    rules: Rules,
    net: Net,
    weights: Option<PathBuf>,
}

impl Judging {
    fn new(rules: &str, lpips: Option<&str>, weights: Option<PathBuf>) -> PyResult<Self> {
        let names = RULES.iter().map(|r| r.name).collect::<Vec<_>>().join(", ");
        let expected = || wrong("rules", format!("expected one of {names}"));
        let rules = Rules::find(rules).ok_or_else(expected)?;
        let net = match lpips {
            None => rules.net,
            Some("alex") => Net::Alex,
            Some("vgg") => Net::Vgg,
            Some(_) => return Err(wrong("lpips", "expected alex or vgg")),
        };
        Ok(Self {
            rules,
            net,
            weights,
        })
    }

    fn judge(&self) -> anyhow::Result<Judge> {
        let device = Device::flex();
        let lpips = match self.net {
            Net::Alex => Lpips::alex(&device)?,
            Net::Vgg => Lpips::vgg(self.weights.as_deref(), &device)?,
        };
        Ok(Judge::new(self.rules, lpips, &device))
    }
}

fn find_protocol(name: &str) -> PyResult<Protocol> {
    let names = PROTOCOLS
        .iter()
        .map(|p| p.name)
        .collect::<Vec<_>>()
        .join(", ");
    let found = PROTOCOLS.iter().find(|p| p.name == name);
    let expected = || wrong("protocol", format!("expected one of {names}"));
    Ok(found.ok_or_else(expected)?.protocol)
}
