//! The pictures of a report: sheets of an evaluation's tiles, and charts.

use crate::sheet::{self, Row};
use anyhow::Result;
use lumi_core::DisplayImage;
use lumi_core::image::{read_display, write_png};
use lumi_eval::Outcome;
use lumi_eval::gallery::Tile;
use lumi_eval::plots::{Chart, Series, chain_charts, draw, spread_chart, tone_chart};
use lumi_eval::protocols::runtime::RuntimeReport;
use lumi_eval::report::Report;
use std::path::Path;

/// Side of a picture on a sheet; chains have many pictures in a row.
const TILE: usize = 150;
const SMALL_TILE: usize = 110;
/// Rows after which no further object goes on a page.
const ROWS: usize = 12;
/// Size of charts in pixels.
const ONE: (u32, u32) = (900, 460);
const TWO: (u32, u32) = (1500, 500);

/// Writes every picture of an outcome below `out`.
pub fn write(out: &Path, outcome: &Outcome) -> Result<()> {
    crate::commands::make_folder(out)?;
    let report = &outcome.report;
    let title = |what: &str| {
        let s = &report.settings;
        format!("{what} ({}, {} px)", report.protocol, s.resolution)
    };
    // Every lighting of each object, and one of each, another for every object, for all of them.
    let mut chosen = Vec::new();
    for (i, (object, tiles)) in outcome.tiles.iter().enumerate() {
        let rows = rows(out, object, tiles, "grid")?;
        if rows.is_empty() {
            continue;
        }
        let page = sheet::draw(
            &title(&format!(
                "{} under every target lighting",
                object.replace('_', " ")
            )),
            &rows,
            TILE,
        )?;
        write_png(out.join("objects").join(object).join("grid.png"), &page)?;
        let count = rows.len();
        // Lightings are sorted by name: areas, environments, points. A step of two visits all kinds.
        if let Some(mut row) = rows.into_iter().nth((1 + 2 * i) % count) {
            row.label = format!("{}\n{}", object.replace('_', " "), row.label);
            chosen.push(row);
        }
    }
    if !chosen.is_empty() {
        let page = sheet::draw(
            &title(
                "Relighting beside the trivial answers and the truth, each after one scale per channel",
            ),
            &chosen,
            TILE,
        )?;
        write_png(out.join("grid.png"), &page)?;
    }
    for (name, what, side) in [
        (
            "light-sweep",
            "A point light goes around each object; the tokens are encoded once",
            TILE,
        ),
        (
            "steps-replace",
            "The light is replaced again and again",
            SMALL_TILE,
        ),
        ("steps-add", "Lights are added one after the other", TILE),
    ] {
        let mut all = Vec::new();
        for (object, tiles) in &outcome.tiles {
            // A chain has three rows per object; a page holds some objects, in the order of their names.
            if all.len() < ROWS {
                all.extend(rows(out, object, tiles, name)?);
            }
        }
        if !all.is_empty() {
            let page = sheet::draw(&title(what), &all, side)?;
            write_png(out.join(format!("{name}.png")), &page)?;
        }
    }
    charts(out, report)
}

/// The rows of a sheet that an object contributes.
fn rows(out: &Path, object: &str, tiles: &[Tile], sheet: &str) -> Result<Vec<Row>> {
    let tiles = tiles.iter().filter(|t| t.sheet == sheet).map(|tile| {
        let image = read_display(out.join("objects").join(object).join(&tile.file))?;
        Ok((tile.clone(), image))
    });
    Ok(grouped(tiles.collect::<Result<Vec<_>>>()?))
}

/// Pictures whose neighbours have the same label, in one row each.
pub fn grouped(tiles: impl IntoIterator<Item = (Tile, DisplayImage)>) -> Vec<Row> {
    let mut rows: Vec<(String, Row)> = Vec::new();
    for (tile, image) in tiles {
        let picture = (image, tile.caption);
        match rows.last_mut().filter(|(label, _)| *label == tile.row) {
            Some((_, row)) => row.tiles.push(picture),
            None => {
                let label = tile.row.replace('_', " ").replace('+', " +\n");
                let tiles = vec![picture];
                rows.push((tile.row, Row { label, tiles }));
            }
        }
    }
    rows.into_iter().map(|(_, row)| row).collect()
}

fn charts(out: &Path, report: &Report) -> Result<()> {
    for (chain, methods) in &report.chains {
        let title = match chain.as_str() {
            "add" => "Adding lights, mean over objects",
            _ => "Replacing the light, mean over objects",
        };
        let page = draw(&chain_charts(title, methods), TWO)?;
        write_png(out.join(format!("chain-{chain}.png")), &page)?;
    }
    if report
        .per_object
        .values()
        .any(|o| o.figures.tone.spread.is_some())
    {
        write_png(
            out.join("tone-spread.png"),
            &draw(&[spread_chart(report)], (1300, 460))?,
        )?;
    }
    for (object, record) in &report.per_object {
        // One environment and one local light, where there are such.
        let names: Vec<&String> = record.cases.keys().collect();
        let kind = |start: &str| {
            names
                .iter()
                .find(|n| n.starts_with(start) && !n.contains('+'))
        };
        let mut cases: Vec<&String> = ["env", "point"]
            .into_iter()
            .filter_map(kind)
            .copied()
            .collect();
        if cases.is_empty() {
            cases = names.into_iter().take(1).collect();
        }
        let charts: Vec<Chart> = cases
            .into_iter()
            .filter_map(|c| tone_chart(report, object, c))
            .collect();
        if !charts.is_empty() {
            let size = if charts.len() == 1 { ONE } else { TWO };
            let page = draw(&charts, size)?;
            write_png(
                out.join("objects").join(object).join("tone-scales.png"),
                &page,
            )?;
        }
    }
    Ok(())
}

/// Means of the variants of an ablation.
pub fn write_variants(out: &Path, report: &Report) -> Result<()> {
    crate::commands::make_folder(out)?;
    let names: Vec<String> = report.variants.keys().cloned().collect();
    let charts = ["psnr", "ssim", "lpips"].map(|metric| Chart {
        title: format!("{} after one scale per scene", metric.to_uppercase()),
        x: "weights".into(),
        y: metric.to_uppercase(),
        series: vec![Series {
            name: metric.into(),
            values: report
                .variants
                .values()
                .map(|v| v.figures.whole.slr.get(metric))
                .collect(),
        }],
        groups: names.clone(),
    });
    Ok(write_png(
        out.join("ablation.png"),
        &draw(&charts, (1700, 460))?,
    )?)
}

/// Where the time goes.
pub fn write_runtime(out: &Path, report: &RuntimeReport) -> Result<()> {
    let parts = [
        ("end to end", report.end_to_end),
        ("relight only", report.relight_only),
        ("encode", report.encode),
        ("edit", report.edit),
        ("render", report.render),
    ];
    let chart = Chart {
        title: format!("{} new views, {} px", report.views, report.resolution),
        x: "part".into(),
        y: "seconds".into(),
        series: vec![Series {
            name: "seconds".into(),
            values: parts.iter().map(|(_, s)| Some(*s)).collect(),
        }],
        groups: parts.iter().map(|(name, _)| (*name).to_owned()).collect(),
    };
    Ok(write_png(out.join("runtime.png"), &draw(&[chart], ONE)?)?)
}
