//! Reports as Markdown tables in the paper's shape: ILR and SLR side by side, each with PSNR, SSIM and LPIPS.

use crate::figures::{Aligned, Figures};
use crate::metrics::{METRICS, Metric, Scores, metric};
use crate::protocols::runtime::RuntimeReport;
use crate::report::{Report, Settings, Step, margin};
use crate::rules::PAPER as PAPER_RULES;
use std::fmt::Write;

/// The metrics of the paper's tables.
const PAPER: [&str; 3] = ["psnr", "ssim", "lpips"];

/// A method's figures are those of the `model`; others go by these names.
#[must_use]
pub fn method_name(key: &str) -> &str {
    match key {
        "model" => "ours",
        "token" => "ours, token space",
        "nearest" => "nearest input view",
        "unedited" => "unedited decode",
        "colour_ratio" => "colour ratio",
        "reprojection" => "reprojected, colour ratio",
        "pixel" | "pixel_chain" => "ours, pixel space",
        "direct" => "ours, one edit from the inputs",
        other => other,
    }
}

/// The whole report.
#[must_use]
pub fn markdown(report: &Report) -> String {
    let s = &report.settings;
    let mut out = format!("# {}: {}\n\n", report.protocol, report.model);
    let objects = report.per_object.len();
    let inputs = if s.inputs > 0 {
        format!(", {} input views", s.inputs)
    } else {
        String::new()
    };
    let _ = writeln!(
        out,
        "Data: {}, {objects} objects, {} × {} px{inputs}. Rules `{}`: {}. LPIPS over {}.\n",
        report.data, s.resolution, s.resolution, s.rules, s.rules_about, s.lpips
    );
    for note in &report.notes {
        let _ = writeln!(out, "Note: {note}.\n");
    }
    let mut methods = vec![(method_name("model"), &report.figures)];
    methods.extend(trivial_rows(report));
    summary(&mut out, &report.settings, &methods);
    alignments(&mut out, &report.figures);
    tone(&mut out, &methods);
    if !report.variants.is_empty() {
        variants(&mut out, report);
    }
    objects_table(&mut out, report);
    targets_table(&mut out, report);
    for (chain, methods) in &report.chains {
        let _ = writeln!(
            out,
            "## Chain `{chain}`: PSNR / SSIM / LPIPS after one scale per scene\n"
        );
        let columns: Vec<(&str, &Vec<Step>)> = ["token", "pixel", "direct"]
            .into_iter()
            .filter_map(|m| Some((m, methods.get(m)?)))
            .collect();
        let heads = columns.iter().map(|(m, _)| method_name(m).to_owned());
        head(&mut out, ["step".to_owned()].into_iter().chain(heads));
        let steps = methods.values().map(Vec::len).max().unwrap_or(0);
        for k in 0..steps {
            let cell = |steps: &Vec<Step>| {
                steps
                    .get(k)
                    .map_or("–".into(), |s| triple(&s.figures.whole.slr))
            };
            let cells: Vec<String> = columns.iter().map(|(_, steps)| cell(steps)).collect();
            let _ = writeln!(out, "| {} | {} |", k + 1, cells.join(" | "));
        }
        out.push('\n');
    }
    if !report.failures.is_empty() {
        out.push_str("## Failed objects\n\n");
        for (name, cause) in &report.failures {
            let _ = writeln!(out, "- {name}: {cause}");
        }
    }
    out
}

/// The trivial answers of a report, by the names that tables give them.
pub(crate) fn trivial_rows(report: &Report) -> impl Iterator<Item = (&str, &Figures)> {
    report.trivial.iter().map(|(n, f)| (method_name(n), f))
}

/// Methods, by the names that are shown, in one table each for what the rules' benchmark publishes, whole images and the object.
pub(crate) fn summary(out: &mut String, settings: &Settings, methods: &[(&str, &Figures)]) {
    headline(out, settings, methods);
    section(out, "Whole images", methods, |f| &f.whole);
    section(out, "Object only", methods, |f| &f.object_only);
}

pub(crate) fn head(out: &mut String, columns: impl Iterator<Item = String>) {
    let columns: Vec<String> = columns.collect();
    let _ = writeln!(out, "| {} |", columns.join(" | "));
    let _ = writeln!(out, "|{}", "---|".repeat(columns.len()));
}

fn label(metric: &Metric) -> String {
    let arrow = if metric.higher_is_better {
        "↑"
    } else {
        "↓"
    };
    format!("{} {arrow}", metric.label)
}

fn value(scores: &Scores, metric: &Metric) -> String {
    scores
        .get(metric.name)
        .map_or("–".into(), |v| format!("{v:.*}", metric.decimals))
}

fn paper_values(scores: &Scores) -> Vec<String> {
    PAPER
        .iter()
        .filter_map(|m| Some(value(scores, metric(m)?)))
        .collect()
}

pub(crate) fn triple(scores: &Scores) -> String {
    paper_values(scores).join(" / ")
}

/// A table in the paper's shape.
fn section(
    out: &mut String,
    title: &str,
    methods: &[(&str, &Figures)],
    part: fn(&Figures) -> &Aligned,
) {
    let _ = writeln!(out, "## {title}\n");
    let columns = ["ILR", "SLR"].into_iter().flat_map(|a| {
        let labels = PAPER.iter().filter_map(|m| Some(label(metric(m)?)));
        labels.map(move |l| format!("{a} {l}"))
    });
    head(out, ["method".to_owned()].into_iter().chain(columns));
    for (name, figures) in methods {
        let aligned = part(figures);
        let cells = [&aligned.ilr, &aligned.slr]
            .into_iter()
            .flat_map(paper_values);
        let cells: Vec<String> = cells.collect();
        let _ = writeln!(out, "| {name} | {} |", cells.join(" | "));
    }
    out.push('\n');
}

/// What the rules' own benchmark publishes, where it is not the paper's tables.
fn headline(out: &mut String, settings: &Settings, methods: &[(&str, &Figures)]) {
    if settings.rules == PAPER_RULES.name {
        return;
    }
    let (object_only, alignment) = match settings.headline.split_once('.') {
        Some((_, alignment)) => (true, alignment),
        None => (false, settings.headline.as_str()),
    };
    let scores = |figures: &Figures| -> Scores {
        let part = if object_only {
            &figures.object_only
        } else {
            &figures.whole
        };
        let found = part.variants().into_iter().find(|(n, _)| *n == alignment);
        found.map_or_else(Scores::default, |(_, s)| s.clone())
    };
    let high = methods
        .first()
        .is_some_and(|(_, first)| scores(first).0.contains_key("psnr_hdr"));
    let shown: Vec<&Metric> = METRICS
        .iter()
        .filter(|m| PAPER.contains(&m.name) || m.name == "psnr_hdr" && high)
        .collect();
    let _ = writeln!(
        out,
        "## As `{}` reports it (`{}`)\n",
        settings.rules, settings.headline
    );
    let name = |m: &&Metric| match m.name {
        "psnr" if high => "PSNR-L ↑".to_owned(),
        _ => label(m),
    };
    let columns = shown.iter().map(name);
    head(out, ["method".to_owned()].into_iter().chain(columns));
    for (method, figures) in methods {
        let scores = scores(figures);
        let cells: Vec<String> = shown.iter().map(|m| value(&scores, m)).collect();
        let _ = writeln!(out, "| {method} | {} |", cells.join(" | "));
    }
    out.push('\n');
}

fn alignments(out: &mut String, figures: &Figures) {
    out.push_str("## The method under every alignment\n\n");
    let measured = |part: &Aligned| -> Vec<&Metric> {
        let known = |m: &&Metric| part.variants().iter().any(|(_, s)| s.get(m.name).is_some());
        METRICS.iter().filter(known).collect()
    };
    let (whole, object) = (measured(&figures.whole), measured(&figures.object_only));
    let columns = whole.iter().map(|m| label(m));
    let columns = columns.chain(object.iter().map(|m| format!("object {}", label(m))));
    head(out, ["alignment".to_owned()].into_iter().chain(columns));
    let parts = figures
        .whole
        .variants()
        .into_iter()
        .zip(figures.object_only.variants());
    for ((name, of_whole), (_, of_object)) in parts {
        let cells = whole.iter().map(|m| value(of_whole, m));
        let cells = cells.chain(object.iter().map(|m| value(of_object, m)));
        let cells: Vec<String> = cells.collect();
        let _ = writeln!(out, "| {name} | {} |", cells.join(" | "));
    }
    out.push('\n');
}

pub(crate) fn tone(out: &mut String, methods: &[(&str, &Figures)]) {
    out.push_str(
        "## Spread of per-view scales (standard deviation of ln, lower is more consistent)\n\n",
    );
    head(out, ["method", "spread"].into_iter().map(str::to_owned));
    for (name, figures) in methods {
        let spread = figures
            .tone
            .spread
            .map_or("–".into(), |s| format!("{s:.3}"));
        let _ = writeln!(out, "| {name} | {spread} |");
    }
    out.push('\n');
}

fn variants(out: &mut String, report: &Report) {
    out.push_str("## Variants: whole images\n\n");
    let labels = ["ILR", "SLR"].into_iter().flat_map(|a| {
        let labels = PAPER.iter().filter_map(|m| Some(label(metric(m)?)));
        labels.map(move |l| format!("{a} {l}"))
    });
    let heads = ["weights".to_owned()].into_iter().chain(labels);
    head(out, heads.chain(["margin dB".to_owned()]));
    for (name, variant) in &report.variants {
        let whole = &variant.figures.whole;
        let cells: Vec<String> = [&whole.ilr, &whole.slr]
            .into_iter()
            .flat_map(paper_values)
            .collect();
        let margin = variant.margin.map_or("–".into(), |m| format!("{m:+.2}"));
        let _ = writeln!(out, "| {name} | {} | {margin} |", cells.join(" | "));
    }
    out.push('\n');
}

fn objects_table(out: &mut String, report: &Report) {
    out.push_str("## By object: PSNR in dB, whole images, one scale per scene and channel\n\n");
    let trivial: Vec<&String> = report.trivial.keys().collect();
    let heads = trivial.iter().map(|n| method_name(n).to_owned());
    let ours = ["object", "ours"].into_iter().map(str::to_owned);
    head(
        out,
        ours.chain(heads)
            .chain(["margin".to_owned(), "object only".to_owned()]),
    );
    let mut line =
        |name: &str, figures: &Figures, others: &std::collections::BTreeMap<String, Figures>| {
            let psnr = |a: &Aligned| a.slr.get("psnr").map_or("–".into(), |v| format!("{v:.2}"));
            let cells = trivial
                .iter()
                .map(|n| others.get(*n).map_or("–".into(), |f| psnr(&f.whole)));
            let cells: String = cells.map(|c| format!(" {c} |")).collect();
            let margin = margin(figures, others).map_or("–".into(), |m| format!("{m:+.2}"));
            let _ = writeln!(
                out,
                "| {name} | {} |{cells} {margin} | {} |",
                psnr(&figures.whole),
                psnr(&figures.object_only)
            );
        };
    for (name, object) in &report.per_object {
        line(name, &object.figures, &object.trivial);
    }
    line("**mean**", &report.figures, &report.trivial);
    out.push('\n');
}

fn targets_table(out: &mut String, report: &Report) {
    if report.per_target.is_empty() {
        return;
    }
    out.push_str("## By target lighting: PSNR / SSIM / LPIPS after one scale per scene\n\n");
    let mut methods: Vec<&String> = report.per_target.values().flat_map(|m| m.keys()).collect();
    methods.sort_by_key(|m| (*m != "model", *m));
    methods.dedup();
    let heads = methods.iter().map(|m| method_name(m).to_owned());
    head(out, ["lighting".to_owned()].into_iter().chain(heads));
    for (target, by_method) in &report.per_target {
        let cell = |m: &&String| by_method.get(*m).map_or("–".into(), |a| triple(&a.slr));
        let cells: Vec<String> = methods.iter().map(cell).collect();
        let _ = writeln!(out, "| {target} | {} |", cells.join(" | "));
    }
    out.push('\n');
}

/// The table of a runtime report.
#[must_use]
pub fn runtime_markdown(report: &RuntimeReport) -> String {
    let mut out = format!("# runtime: {}\n\n", report.model);
    let _ = writeln!(
        out,
        "{}, {} × {} px, {} input views, {} new views, {}. Medians of {} repeats after a warm-up.\n",
        report.data,
        report.resolution,
        report.resolution,
        report.inputs,
        report.views,
        report.device,
        report.repeats
    );
    for note in &report.notes {
        let _ = writeln!(out, "Note: {note}.\n");
    }
    head(&mut out, ["part", "value"].into_iter().map(str::to_owned));
    let seconds = [
        ("end to end (encode, edit, render)", report.end_to_end),
        ("relight only (edit, render)", report.relight_only),
        ("encode", report.encode),
        ("edit", report.edit),
        ("render", report.render),
        ("render, per view", report.render_per_view),
    ];
    for (part, seconds) in seconds {
        let _ = writeln!(out, "| {part} | {seconds:.4} s |");
    }
    for (part, bytes) in [
        ("peak CPU memory", report.peak_cpu_memory),
        ("peak GPU memory", report.peak_gpu_memory),
    ] {
        let value = bytes.map_or("–".into(), |b| {
            format!("{:.0} MiB", b as f64 / 1_048_576.0)
        });
        let _ = writeln!(out, "| {part} | {value} |");
    }
    out
}
