//! `lumi score`: the evaluation's figures for pictures that any method saved, of one method or several side by side.

use super::eval::{Judging, What, finish, pictures, publish};
use crate::progress::Terminal;
use crate::sheet;
use anyhow::{Result, bail};
use lumi_core::DisplayImage;
use lumi_core::image::write_png;
use lumi_eval::Comparison;
use lumi_eval::gallery::Gallery;
use lumi_eval::score::{Method, Scored, Truth, score};
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// Score saved pictures of any method, or of several side by side: OBJECT/CASE/VIEW.png against the truth
#[derive(clap::Args)]
#[command(override_usage = "lumi score [OPTIONS] PREDICTIONS TRUTH\n       \
                            lumi score [OPTIONS] TRUTH --method NAME=PREDICTIONS...")]
pub struct Args {
    /// Folder with OBJECT/CASE/VIEW.png (or .jpg, .exr, .hdr), and TRUTH: a folder of the same layout, whose alpha says
    /// where the object is, or a data set that `lumi eval` takes. With --method, TRUTH alone
    #[arg(required = true, num_args = 1..=2, value_name = "FOLDER")]
    folders: Vec<PathBuf>,
    /// A method by its name and the folder of its pictures; several make one table and one sheet
    #[arg(long, num_args = 1.., value_name = "NAME=PREDICTIONS", value_parser = method)]
    method: Vec<Method>,
    /// Which views and cases of a data set to expect: multi-view or novel-view
    #[arg(long, default_value = "novel-view")]
    protocol: What,
    /// Objects of a data set to score; all if absent
    #[arg(long, num_args = 1..)]
    only: Vec<String>,
    /// Objects of a data set to leave out
    #[arg(long, num_args = 1..)]
    skip: Vec<String>,
    #[command(flatten)]
    judging: Judging,
    /// Write the report as JSON
    #[arg(long)]
    json: Option<PathBuf>,
    /// Folder for report.json, report.md and grid.png
    #[arg(long)]
    out: Option<PathBuf>,
}

fn method(text: &str) -> Result<Method, String> {
    match text.split_once('=') {
        Some((name, folder)) if !name.is_empty() && !folder.is_empty() => Ok(Method {
            name: name.to_owned(),
            folder: folder.into(),
        }),
        _ => Err("expected NAME=FOLDER".into()),
    }
}

/// Side of a picture on the sheet.
const TILE: usize = 150;

pub fn run(args: &Args) -> Result<ExitCode> {
    super::check_outputs(args.out.as_deref(), args.json.as_deref())?;
    let (methods, truth) = args.compared()?;
    let Some(protocol) = args.protocol.protocol() else {
        bail!("--protocol: expected multi-view or novel-view");
    };
    let truth = Truth::open(truth, protocol, &args.only, &args.skip)?;
    let judge = args.judging.judge()?;
    let Scored { reports, gallery } = score(&methods, &truth, &judge, &Terminal::new())?;
    let comparison = if args.method.is_empty() {
        None
    } else {
        let names = methods.into_iter().map(|m| m.name);
        Some(Comparison::new(names.zip(reports.iter().cloned()))?)
    };
    if let Some(out) = &args.out {
        super::make_folder(out)?;
        if let Some(page) = grid(&gallery)? {
            write_png(out.join("grid.png"), &page)?;
        }
    }
    let (out, json) = (args.out.as_deref(), args.json.as_deref());
    match comparison {
        None => finish(&reports[0], out, json),
        Some(several) => publish(
            &several,
            &several.markdown(),
            several.is_complete(),
            out,
            json,
        ),
    }
}

/// The sheet of a gallery's rows; `None` if it has none.
///
/// # Errors
/// If the built-in font cannot be read.
pub fn grid(gallery: &Gallery) -> Result<Option<DisplayImage>> {
    let rows = pictures::grouped(gallery.tiles.iter().cloned());
    if rows.is_empty() {
        return Ok(None);
    }
    let title = "Each method after one scale per channel, beside the truth";
    sheet::draw(title, &rows, TILE).map(Some)
}

impl Args {
    /// The methods, and the folder of the truth.
    fn compared(&self) -> Result<(Vec<Method>, &Path)> {
        match self.folders.as_slice() {
            [truth] if !self.method.is_empty() => {
                let names = self.method.iter().map(|m| &m.name);
                let mut names: Vec<_> = names.collect();
                names.sort();
                if let Some(twice) = names.windows(2).find(|pair| pair[0] == pair[1]) {
                    bail!("--method {}: expected names that differ", twice[0]);
                }
                Ok((self.method.clone(), truth))
            }
            [predictions, truth] if self.method.is_empty() => {
                let name = predictions.file_name().unwrap_or_default();
                let name = name.to_string_lossy().into_owned();
                let folder = predictions.clone();
                Ok((vec![Method { name, folder }], truth))
            }
            [_] => bail!("expected PREDICTIONS and TRUTH, or TRUTH and --method NAME=PREDICTIONS"),
            _ => bail!("--method: expected TRUTH alone beside it"),
        }
    }
}
