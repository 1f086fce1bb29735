//! `lumi eval`.

use crate::assets;
use crate::progress::Terminal;
use anyhow::Result;
use std::path::PathBuf;
use std::process::ExitCode;

/// Score a model by a protocol of the paper
#[derive(clap::Args)]
pub struct Args {
    /// Folder with a manifest.json and one folder per object
    data: PathBuf,
    /// What to measure
    #[arg(long)]
    protocol: Protocol,
    /// Weights file; the bundled model if absent
    #[arg(long)]
    model: Option<PathBuf>,
    /// Objects to leave out
    #[arg(long, num_args = 1..)]
    skip: Vec<String>,
    /// Write the report as JSON
    #[arg(long)]
    json: Option<PathBuf>,
    /// Folder for report.json and report.txt
    #[arg(long)]
    out: Option<PathBuf>,
}

#[derive(Clone, Copy, clap::ValueEnum)]
enum Protocol {
    /// Inputs under one light, held-out views under others
    NovelView,
}

pub fn run(args: &Args) -> Result<ExitCode> {
    if let Some(out) = &args.out {
        super::check_output(out)?;
    }
    let model = assets::model(args.model.as_deref())?;
    let report = match args.protocol {
        Protocol::NovelView => {
            lumi_eval::novel_view(&model, &args.data, &args.skip, &Terminal::new())?
        }
    };
    print!("{report}");
    if let Some(path) = &args.json {
        super::write_json(path, &report)?;
    }
    if let Some(out) = &args.out {
        super::make_folder(out)?;
        super::write_json(&out.join("report.json"), &report)?;
        lumi_core::fs::atomic_write(out.join("report.txt"), report.to_string().as_bytes())?;
    }
    Ok(if report.failures.is_empty() {
        ExitCode::SUCCESS
    } else {
        ExitCode::FAILURE
    })
}
