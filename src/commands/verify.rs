//! `lumi verify`: largest error per tensor against golden values.

use crate::device::OnDevice;
use crate::output::say;
use anyhow::Result;
use lumi_model::{checkpoint, import, verify};
use std::path::PathBuf;
use std::process::ExitCode;

/// Compare a network with golden tensors, tensor by tensor; exit status 1 if one is beyond its tolerance
#[derive(clap::Args)]
pub struct Args {
    /// Weights: the authors' checkpoint.pt or safetensors, or a file of `lumi import`
    #[arg(long)]
    weights: PathBuf,
    /// Model config: TOML, or the authors' JSON
    #[arg(long)]
    config: PathBuf,
    /// Golden case: a safetensors file, or a folder that holds case.safetensors
    #[arg(long)]
    case: PathBuf,
    #[command(flatten)]
    on: OnDevice,
    /// Write the rows as JSON
    #[arg(long)]
    json: Option<PathBuf>,
}

pub fn run(args: &Args) -> Result<ExitCode> {
    let device = args.on.device.open();
    let config = import::read_config(&args.config)?;
    let network = if checkpoint::is_ours(&args.weights)? {
        let (network, found, _) = checkpoint::load(&args.weights, &device)?;
        anyhow::ensure!(
            found == config,
            "{}: expected weights for this config; they were saved with another",
            args.weights.display()
        );
        network
    } else {
        import::load_authors(&args.weights, &config, &device)?
    };
    let case = if args.case.is_dir() {
        args.case.join("case.safetensors")
    } else {
        args.case.clone()
    };
    let rows = verify::verify(&network, &config, &case, &device)?;
    say!("{:32} {:>11} {:>10}", "tensor", "max error", "tolerance");
    for row in &rows {
        let mark = if row.ok() { "" } else { "  too large" };
        say!(
            "{:32} {:11.2e} {:10.0e}{mark}",
            row.tensor,
            row.max_error,
            row.tolerance
        );
    }
    if let Some(path) = &args.json {
        super::write_json(path, &rows)?;
    }
    anyhow::ensure!(
        !rows.is_empty(),
        "{}: expected golden tensors, found none",
        case.display()
    );
    let bad = rows.iter().filter(|r| !r.ok()).count();
    say!("{} tensors compared, {bad} beyond tolerance", rows.len());
    Ok(if bad == 0 {
        ExitCode::SUCCESS
    } else {
        ExitCode::FAILURE
    })
}
