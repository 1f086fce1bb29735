//! `lumi train`.

use crate::progress::Terminal;
use anyhow::Result;
use burn::tensor::Device;
use lumi_train::TrainConfig;
use std::path::PathBuf;
use std::process::ExitCode;

/// Train a model on light-basis data
#[derive(clap::Args)]
pub struct Args {
    /// Training config (see configs/train)
    config: PathBuf,
    /// Continue from the saved state in the config's output folder
    #[arg(long)]
    resume: bool,
}

pub fn run(args: &Args) -> Result<ExitCode> {
    let config = TrainConfig::read(&args.config)?;
    let weights = lumi_train::train(&config, args.resume, &Device::flex(), &Terminal::new())?;
    println!("wrote {}", weights.display());
    Ok(ExitCode::SUCCESS)
}
