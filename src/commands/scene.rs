//! `lumi scene`: what a capture holds.

use anyhow::Result;
use std::path::PathBuf;
use std::process::ExitCode;

/// Look at captures
#[derive(clap::Args)]
pub struct Args {
    #[command(subcommand)]
    command: Command,
}

#[derive(clap::Subcommand)]
enum Command {
    /// Say what a capture holds, and whether poses, masks and lights agree; exit status 1 if not
    Check {
        /// Folder of the capture
        scene: PathBuf,
        /// Write the findings as JSON
        #[arg(long)]
        json: Option<PathBuf>,
    },
}

pub fn run(args: &Args) -> Result<ExitCode> {
    let Command::Check { scene, json } = &args.command;
    let report = lumi_data::check::check_folder(scene)?;
    print!("{report}");
    if let Some(path) = json {
        super::write_json(path, &report)?;
    }
    Ok(if report.has_errors() {
        ExitCode::FAILURE
    } else {
        ExitCode::SUCCESS
    })
}
