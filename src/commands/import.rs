//! `lumi import`: the authors' checkpoints into our weights files.

use crate::output::say;
use anyhow::Result;
use burn::tensor::Device;
use lumi_model::checkpoint::{self, Provenance, Storage};
use lumi_model::import;
use std::path::PathBuf;
use std::process::ExitCode;

/// Convert an authors' checkpoint to safetensors; nothing in the file is executed
#[derive(clap::Args)]
pub struct Args {
    /// checkpoint.pt, or safetensors in the authors' names
    checkpoint: PathBuf,
    /// Model config: TOML or the authors' JSON, or a preset's name
    #[arg(long)]
    config: String,
    /// Weights file to write
    #[arg(short, long)]
    output: PathBuf,
}

pub fn run(args: &Args) -> Result<ExitCode> {
    super::check_outputs(None, Some(&args.output))?;
    let config = import::config_or_preset(&args.config)?;
    let network = import::load_authors(&args.checkpoint, &config, &Device::flex())?;
    let name = args
        .checkpoint
        .file_name()
        .unwrap_or_default()
        .to_string_lossy();
    let provenance = Provenance {
        origin: format!("imported from {name}"),
        licence: "as the checkpoint's; the authors' release is CC BY-NC-SA 4.0".into(),
        ..Provenance::default()
    };
    checkpoint::save(&args.output, &network, &config, &provenance, Storage::F32)?;
    say!("wrote {}", args.output.display());
    Ok(ExitCode::SUCCESS)
}
