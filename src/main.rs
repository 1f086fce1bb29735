//! The `lumi` command line: relight 3D captures in latent token space.

#![warn(clippy::print_stdout, clippy::print_stderr)]

mod assets;
mod commands;
mod device;
mod edits;
mod groups;
mod interrupt;
mod output;
mod path;
mod progress;
mod results;
mod sheet;
mod viewpoints;

use clap::{CommandFactory, Parser, Subcommand};
use output::say_aside;
use std::process::ExitCode;

/// Relight 3D captures in latent token space.
#[derive(Parser)]
#[command(version, propagate_version = true)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    Demo(commands::demo::Args),
    Relight(commands::relight::Args),
    Studio(commands::studio::Args),
    Scene(commands::scene::Args),
    Dataset(commands::dataset::Args),
    Train(commands::train::Args),
    Eval(commands::eval::Args),
    Bench(commands::bench::Args),
    Score(commands::score::Args),
    Verify(commands::verify::Args),
    Import(commands::import::Args),
    Completions(commands::shell::Completions),
    Man(commands::shell::Man),
}

fn main() -> ExitCode {
    // Wrong usage exits with status 2 inside clap.
    let cli = Cli::parse();
    if let Err(error) = lumi_kernels::Cpu::from_env() {
        say_aside!("error: {error}");
        return ExitCode::from(2);
    }
    let done = match cli.command {
        Command::Demo(args) => commands::demo::run(&args),
        Command::Relight(args) => commands::relight::run(&args),
        Command::Studio(args) => commands::studio::run(&args),
        Command::Scene(args) => commands::scene::run(&args),
        Command::Dataset(args) => commands::dataset::run(&args),
        Command::Train(args) => commands::train::run(&args),
        Command::Eval(args) => commands::eval::run(&args),
        Command::Bench(args) => commands::bench::run(&args),
        Command::Score(args) => commands::score::run(&args),
        Command::Verify(args) => commands::verify::run(&args),
        Command::Import(args) => commands::import::run(&args),
        Command::Completions(args) => commands::shell::completions(&args, Cli::command()),
        Command::Man(args) => commands::shell::man(&args, Cli::command()),
    };
    match done {
        Ok(code) => code,
        Err(error) => {
            say_aside!("error: {error:#}");
            ExitCode::FAILURE
        }
    }
}
