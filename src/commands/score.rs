//! `lumi score`: the evaluation's figures for pictures that any method saved.

use super::eval::{Judging, What, finish};
use crate::progress::Terminal;
use anyhow::{Result, bail};
use lumi_eval::{Collection, score};
use std::path::PathBuf;
use std::process::ExitCode;

/// Score saved pictures of any method: PREDICTIONS/OBJECT/CASE/VIEW.png against the truth
#[derive(clap::Args)]
pub struct Args {
    /// Folder with OBJECT/CASE/VIEW.png (or .jpg, .exr, .hdr)
    predictions: PathBuf,
    /// Folder of the same layout, whose alpha says where the object is; or a data set that `lumi eval` takes
    truth: PathBuf,
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
    /// Folder for report.json and report.md
    #[arg(long)]
    out: Option<PathBuf>,
}

pub fn run(args: &Args) -> Result<ExitCode> {
    super::check_outputs(args.out.as_deref(), args.json.as_deref())?;
    let judge = args.judging.judge()?;
    let progress = Terminal::new();
    let (predictions, truth) = (&args.predictions, &args.truth);
    // A folder of plain pictures is no data set, and a broken manifest no folder of pictures.
    let data_set = match Collection::open(truth) {
        Ok(collection) => Some(collection),
        Err(error) if truth.join("manifest.json").is_file() => return Err(error.into()),
        Err(_) => None,
    };
    let report = if let Some(collection) = data_set {
        let protocol = match args.protocol {
            What::MultiView | What::NovelView => args.protocol.protocol(),
            _ => None,
        };
        let Some(protocol) = protocol else {
            bail!("--protocol: expected multi-view or novel-view");
        };
        score::data_set(
            predictions,
            &collection,
            protocol,
            (&args.only, &args.skip),
            &judge,
            &progress,
        )?
    } else {
        if !(args.only.is_empty() && args.skip.is_empty()) {
            bail!(
                "--only, --skip: for a data set; in a folder of pictures, leave objects' folders out"
            );
        }
        score::folders(predictions, truth, &judge, &progress)?
    };
    finish(&report, args.out.as_deref(), args.json.as_deref())
}
