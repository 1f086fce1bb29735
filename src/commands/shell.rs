//! `lumi completions` and `lumi man`: the command line as shells and manuals want it.

use crate::output;
use anyhow::Result;
use clap::Command;
use clap_complete::Shell;
use std::path::PathBuf;
use std::process::ExitCode;

/// Print completions for a shell, such as `lumi completions bash > ~/.local/share/bash-completion/completions/lumi`
#[derive(clap::Args)]
pub struct Completions {
    /// Shell to print them for
    shell: Shell,
}

/// Write a manual page for each command
#[derive(clap::Args)]
pub struct Man {
    /// Folder for the pages, such as ~/.local/share/man/man1
    #[arg(long)]
    out: PathBuf,
}

pub fn completions(args: &Completions, mut command: Command) -> Result<ExitCode> {
    let mut text = Vec::new();
    clap_complete::generate(args.shell, &mut command, "lumi", &mut text);
    output::text(&String::from_utf8(text)?);
    Ok(ExitCode::SUCCESS)
}

pub fn man(args: &Man, command: Command) -> Result<ExitCode> {
    super::make_folder(&args.out)?;
    clap_mangen::generate_to(command, &args.out)?;
    Ok(ExitCode::SUCCESS)
}
