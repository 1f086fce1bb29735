//! `lumi eval`: the paper's tables and figures.

pub mod pictures;

use crate::assets;
use crate::device::OnDevice;
use crate::output::{self, say, say_aside};
use crate::progress::Terminal;
use anyhow::{Context, Result, bail};
use burn::tensor::Device;
use lumi_core::fs::atomic_write;
use lumi_core::{Event, Progress, Seed};
use lumi_eval::cases::Subject;
use lumi_eval::markdown::{markdown, runtime_markdown};
use lumi_eval::protocols::laws::LawsReport;
use lumi_eval::protocols::{laws, runtime};
use lumi_eval::report::{Report, Variant};
use lumi_eval::{Collection, Judge, Lpips, Net, Options, Outcome, Protocol, Rules};
use lumi_model::{ModelConfig, Relighter};
use serde::Serialize;
use std::collections::BTreeMap;
use std::ffi::OsStr;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// Score a model by a protocol of the paper: tables, pictures and JSON
#[derive(clap::Args)]
pub struct Args {
    /// Folder with a manifest.json and one folder per object; a training store; or scenes with one EXR per light
    data: PathBuf,
    /// What to measure
    #[arg(long)]
    protocol: What,
    /// Weights file; the bundled model if absent. `ablation` takes several
    #[arg(long, num_args = 1..)]
    model: Vec<PathBuf>,
    #[command(flatten)]
    on: OnDevice,
    /// `runtime`: a preset with random weights instead of a model
    #[arg(long, conflicts_with = "model")]
    preset: Option<String>,
    /// Objects to evaluate; all if absent
    #[arg(long, num_args = 1..)]
    only: Vec<String>,
    /// Objects to leave out
    #[arg(long, num_args = 1..)]
    skip: Vec<String>,
    /// Steps in which each object's scene tokens are fitted to its inputs; none is the paper's protocol
    #[arg(long, default_value_t = 0, value_name = "STEPS")]
    refine: usize,
    /// novel-view and multi-view: give the model inputs this many times as large as its pictures, each way, and average what it
    /// makes at that size; as far as they go, up to 4, if absent. runtime: inputs and pictures this many times as large, 1 if absent
    #[arg(long, value_name = "TIMES")]
    detail: Option<usize>,
    /// Tell the model the light of the inputs, which the paper's protocols keep from it
    #[arg(long)]
    captured_light: bool,
    /// Score single renders, as the paper does, even if the model's config asks for two with overlapping patches
    #[arg(long)]
    no_overlap: bool,
    /// Input views per object; 4 for multi-view and runtime, else 8
    #[arg(long, value_parser = clap::value_parser!(u8).range(1..=32))]
    inputs: Option<u8>,
    #[command(flatten)]
    judging: Judging,
    /// Write the report as JSON
    #[arg(long)]
    json: Option<PathBuf>,
    /// Folder for report.json, report.md and pictures; objects that are finished there are not evaluated again
    #[arg(long)]
    out: Option<PathBuf>,
    /// Save every prediction in OUT/predictions, as `lumi score` reads them
    #[arg(long, requires = "out")]
    save_images: bool,
    /// Evaluate finished objects again
    #[arg(long)]
    fresh: bool,
    /// Objects at a time; as many as there are processors if absent
    #[arg(long)]
    jobs: Option<usize>,
    /// `runtime`: new views
    #[arg(long, default_value_t = 100, value_parser = clap::value_parser!(u32).range(1..=10_000))]
    views: u32,
    /// `runtime`: measurements after the first, which does not count
    #[arg(long, default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..=1000))]
    repeats: u32,
}

/// How images are compared.
#[derive(clap::Args)]
pub struct Judging {
    /// The benchmark whose alignment and masking apply: paper, stanford-orb or objects-with-lighting
    #[arg(long, default_value = "paper", value_parser = rules)]
    rules: Rules,
    /// Network of LPIPS; the rules' own if absent
    #[arg(long)]
    lpips: Option<NetName>,
    /// LPIPS weights of VGG16; else the file named by LUMI_LPIPS_VGG16, else the one in the cache folder
    #[arg(long)]
    lpips_weights: Option<PathBuf>,
}

#[derive(Clone, Copy, PartialEq, clap::ValueEnum)]
enum NetName {
    Alex,
    Vgg,
}

fn rules(name: &str) -> Result<Rules, String> {
    let names: Vec<&str> = lumi_eval::rules::RULES.iter().map(|r| r.name).collect();
    Rules::find(name).ok_or_else(|| format!("expected one of {}", names.join(", ")))
}

impl Judging {
    pub fn judge(&self) -> Result<Judge> {
        let device = Device::flex();
        let net = match self.lpips {
            Some(NetName::Alex) => Net::Alex,
            Some(NetName::Vgg) => Net::Vgg,
            None => self.rules.net,
        };
        let lpips = match net {
            Net::Alex => Lpips::alex(&device)?,
            Net::Vgg => Lpips::vgg(self.lpips_weights.as_deref(), &device)?,
        };
        Ok(Judge::new(self.rules, lpips, &device))
    }
}

#[derive(Clone, Copy, PartialEq, clap::ValueEnum)]
pub enum What {
    /// 4 inputs under one light, the same poses under others
    MultiView,
    /// 8 inputs under one light, held-out poses under others
    NovelView,
    /// Ten edits, one after the other, in token space and in pixel space
    Progressive,
    /// Whether pictures obey light: power, colour, dimming, addition, removal
    Light,
    /// novel-view for several weights files, side by side
    Ablation,
    /// Time and memory of 100 new views under a new light
    Runtime,
}

impl What {
    /// The protocol that scores objects.
    pub fn protocol(self) -> Option<Protocol> {
        match self {
            Self::MultiView => Some(Protocol::MultiView),
            Self::NovelView => Some(Protocol::NovelView),
            Self::Progressive => Some(Protocol::Progressive),
            Self::Ablation | Self::Runtime | Self::Light => None,
        }
    }
}

impl Args {
    /// The model as it is to be measured.
    fn set_up(&self, model: Relighter) -> Relighter {
        let overlap = model.config.overlap && !self.no_overlap;
        model.with_refinement(self.refine).with_overlap(overlap)
    }
}

pub fn run(args: &Args) -> Result<ExitCode> {
    super::check_outputs(args.out.as_deref(), args.json.as_deref())?;
    if args.jobs == Some(0) {
        bail!("--jobs 0: expected at least one object at a time");
    }
    if args.model.len() > 1 && args.protocol != What::Ablation {
        bail!("--model: expected one weights file; only the ablation protocol takes several");
    }
    if args.preset.is_some() && args.protocol != What::Runtime {
        bail!("--preset: random weights only tell time and memory; expected --protocol runtime");
    }
    let views = matches!(
        args.protocol,
        What::NovelView | What::MultiView | What::Ablation
    );
    if args.detail.is_some() && !views && args.protocol != What::Runtime {
        bail!("--detail: only novel-view, multi-view, ablation and runtime take it");
    }
    if args.captured_light && matches!(args.protocol, What::Light | What::Runtime) {
        bail!("--captured-light: neither the laws of light nor times depend on it");
    }
    let collection = Collection::open(&args.data)?;
    match args.protocol {
        What::Runtime => return time(args, &collection),
        What::Ablation => return ablation(args, &collection),
        What::Light => return light(args, &collection),
        What::MultiView | What::NovelView | What::Progressive => {}
    }
    let model = assets::model(args.model.first().map(PathBuf::as_path), &args.on.device)?;
    let model = args.set_up(model);
    let protocol = args.protocol.protocol().unwrap_or(Protocol::NovelView);
    let judge = args.judging.judge()?;
    let options = args.options(args.out.clone());
    let outcome = lumi_eval::evaluate(
        &model,
        &collection,
        protocol,
        &judge,
        &options,
        &Terminal::new(),
    )?;
    if let Some(out) = &args.out {
        pictures::write(out, &outcome)?;
    }
    finish(&outcome.report, args.out.as_deref(), args.json.as_deref())
}

impl Args {
    fn options(&self, out: Option<PathBuf>) -> Options {
        Options {
            only: self.only.clone(),
            skip: self.skip.clone(),
            inputs: self.inputs.map(usize::from),
            detail: self.detail,
            captured_light: self.captured_light,
            jobs: self.jobs,
            out,
            save_images: self.save_images,
            fresh: self.fresh,
        }
    }
}

/// `novel-view` for each model; the first one's report holds the others' means.
fn ablation(args: &Args, collection: &Collection) -> Result<ExitCode> {
    if args.model.is_empty() {
        bail!("--model: expected the weights files to compare");
    }
    let judge = args.judging.judge()?;
    let names = variant_names(&args.model)?;
    let mut first: Option<Outcome> = None;
    let (mut variants, mut sides) = (Vec::new(), BTreeMap::new());
    for (path, name) in args.model.iter().zip(&names) {
        let model = assets::model(Some(path), &args.on.device)?;
        let model = args.set_up(model);
        sides.insert(name.clone(), model.config.resolution);
        let out = args.out.as_ref().map(|o| o.join(name));
        let progress = Terminal::new();
        say_aside!("weights `{name}`: {}", path.display());
        let options = args.options(out.clone());
        let outcome = lumi_eval::evaluate(
            &model,
            collection,
            Protocol::NovelView,
            &judge,
            &options,
            &progress,
        )?;
        if let Some(out) = out {
            pictures::write(&out, &outcome)?;
            write(&outcome.report, &markdown(&outcome.report), &out)?;
        }
        let report = &outcome.report;
        let variant = Variant {
            model: report.model.clone(),
            figures: report.figures.clone(),
            margin: report.margin(),
        };
        variants.push((name.clone(), variant));
        match &mut first {
            None => first = Some(outcome),
            Some(first) => {
                let named = report
                    .failures
                    .iter()
                    .map(|(o, cause)| (format!("{name}: {o}"), cause.clone()));
                first.report.failures.extend(named);
            }
        }
    }
    let mut report = first.context("expected a weights file")?.report;
    report.protocol = "ablation".into();
    if sides.values().any(|s| *s != report.settings.resolution) {
        let list: Vec<String> = sides.iter().map(|(n, s)| format!("{n} {s} px")).collect();
        report.notes.push(format!(
            "the weights make images of different sizes, at which figures do not compare: {}",
            list.join(", ")
        ));
    }
    report.variants = variants.into_iter().collect();
    if let Some(out) = &args.out {
        pictures::write_variants(out, &report)?;
    }
    finish(&report, args.out.as_deref(), args.json.as_deref())
}

/// Names for weights files: their stems; where one repeats, as in the folders that runs leave, the folder's name; where
/// that does too, the stem with a number.
fn variant_names(paths: &[PathBuf]) -> Result<Vec<String>> {
    let text = |name: Option<&OsStr>| name.map(|s| s.to_string_lossy().into_owned());
    let stems: Vec<_> = paths.iter().filter_map(|p| text(p.file_stem())).collect();
    if stems.len() != paths.len() {
        bail!("--model: expected paths of weights files");
    }
    let folder = |p: &PathBuf| text(p.parent()?.file_name());
    let folders: Vec<_> = paths.iter().map(folder).collect();
    let once = |i: usize| count(&stems, &stems[i]) == 1;
    let name = |i: usize| match &folders[i] {
        _ if once(i) => stems[i].clone(),
        Some(name) if !stems.contains(name) && count(&folders, &folders[i]) == 1 => name.clone(),
        _ => format!("{}-{}", stems[i], i + 1),
    };
    Ok((0..stems.len()).map(name).collect())
}

fn count<T: PartialEq>(all: &[T], one: &T) -> usize {
    all.iter().filter(|other| *other == one).count()
}

/// `light`: the laws on each object.
fn light(args: &Args, collection: &Collection) -> Result<ExitCode> {
    let model = assets::model(args.model.first().map(PathBuf::as_path), &args.on.device)?;
    let model = args.set_up(model);
    let inputs = args.inputs.map_or(8, usize::from);
    let progress = Terminal::new();
    let names = collection.names(&args.only, &args.skip)?;
    progress.event(Event::Begin {
        stage: "light".into(),
        total: names.len() as u64,
    });
    let mut measured = BTreeMap::new();
    for (i, name) in names.iter().enumerate() {
        let side = model.config.resolution;
        let subject = Subject::load(collection, name, inputs, false, side, |_| 1)?;
        subject.expect_inputs(args.inputs.map(usize::from))?;
        let seed = Seed(0).child("laws").index(i as u64);
        measured.insert(name.clone(), laws::object(&model, &subject, seed)?);
        progress.event(Event::Step {
            done: i as u64 + 1,
            note: name.clone(),
        });
    }
    progress.event(Event::End);
    let report = LawsReport::new(&model, args.data.display().to_string(), measured);
    let text = report.markdown();
    output::text(&text);
    if let Some(out) = &args.out {
        write(&report, &text, out)?;
    }
    if let Some(path) = &args.json {
        super::write_json(path, &report)?;
    }
    Ok(ExitCode::SUCCESS)
}

/// `runtime` on the first object.
fn time(args: &Args, collection: &Collection) -> Result<ExitCode> {
    let model = match &args.preset {
        Some(preset) => {
            let config = ModelConfig::preset(preset)?;
            Relighter::random(&config, Seed(0), &args.on.device.open())
        }
        None => assets::model(args.model.first().map(PathBuf::as_path), &args.on.device)?,
    };
    let detail = args.detail.unwrap_or(1);
    let model = args.set_up(model).with_detail(detail)?;
    let names = collection.names(&args.only, &args.skip)?;
    let object = names.first().context("expected an object")?;
    let inputs = args.inputs.map_or(4, usize::from);
    let side = model.config.resolution;
    let subject = Subject::load(collection, object, inputs, false, side, |_| detail)?;
    subject.expect_inputs(args.inputs.map(usize::from))?;
    let (views, repeats) = (args.views as usize, args.repeats as usize);
    let mut report = runtime::run(&model, &subject, views, repeats, &Terminal::new())?;
    report.random_weights = args.preset.is_some();
    report.model = match &args.preset {
        Some(preset) => format!("preset {preset}, random weights"),
        None => format!("{} ({})", model.fingerprint, model.provenance.origin),
    };
    report.data = format!("{}, object {object}", args.data.display());
    let threads = std::thread::available_parallelism().map_or(1, usize::from);
    let cpu = lumi_kernels::Cpu::from_env().map_err(anyhow::Error::msg)?;
    report.device = if args.on.device.is_cpu() {
        format!("CPU, {cpu:?}, {threads} threads")
    } else {
        args.on.device.to_string()
    };
    report
        .notes
        .push("the peak of CPU memory includes the loaded scene".into());
    let text = runtime_markdown(&report);
    output::text(&text);
    if let Some(out) = &args.out {
        write(&report, &text, out)?;
        pictures::write_runtime(out, &report)?;
    }
    if let Some(path) = &args.json {
        super::write_json(path, &report)?;
    }
    Ok(ExitCode::SUCCESS)
}

/// Prints a report and writes it where it was asked for.
pub fn finish(report: &Report, out: Option<&Path>, json: Option<&Path>) -> Result<ExitCode> {
    let complete = report.failures.is_empty();
    publish(report, &markdown(report), complete, out, json)
}

/// Prints what was found, as `text`, and writes it where it was asked for; exit status 1 if it is not complete.
pub fn publish(
    found: &impl Serialize,
    text: &str,
    complete: bool,
    out: Option<&Path>,
    json: Option<&Path>,
) -> Result<ExitCode> {
    output::text(text);
    if let Some(out) = out {
        write(found, text, out)?;
        say!("wrote report.json and report.md to {}", out.display());
    }
    // Last, since it may lie in the folder that has just been made.
    if let Some(path) = json {
        super::write_json(path, found)?;
    }
    Ok(if complete {
        ExitCode::SUCCESS
    } else {
        ExitCode::FAILURE
    })
}

fn write(found: &impl Serialize, text: &str, out: &Path) -> Result<()> {
    super::make_folder(out)?;
    super::write_json(&out.join("report.json"), found)?;
    Ok(atomic_write(out.join("report.md"), text.as_bytes())?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn weights_files_get_names_that_tell_them_apart() {
        let named = |paths: &[&str]| {
            let paths: Vec<_> = paths.iter().map(PathBuf::from).collect();
            variant_names(&paths).map_err(|e| e.to_string())
        };
        let names = |names: &[&str]| Ok(names.iter().map(ToString::to_string).collect());
        assert_eq!(
            named(&["x/a.safetensors", "x/b.safetensors"]),
            names(&["a", "b"])
        );
        assert_eq!(named(&["a", "x/w.st", "y/w.st"]), names(&["a", "x", "y"]));
        assert_eq!(named(&["x/w.st", "x/w.st"]), names(&["w-1", "w-2"]));
        // A folder is called as another file is.
        assert_eq!(named(&["x", "x/w.st", "w.st"]), names(&["x", "w-2", "w-3"]));
        assert!(named(&["x", ".."]).is_err());
    }
}
