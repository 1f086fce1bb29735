//! The `lumi` program as a library: [`run`] is the whole command line, which `main.rs` and the Python package call. What
//! else is public here is what the package shares with the commands.

#![warn(clippy::print_stdout, clippy::print_stderr)]

pub mod assets;
mod commands;
pub mod device;
pub mod edits;
pub mod groups;
mod interrupt;
mod output;
mod path;
mod progress;
mod results;
mod sheet;
mod viewpoints;

pub use commands::score::grid as score_grid;
pub use commands::studio::data_folder as studio_folder;

use clap::{CommandFactory, Parser, Subcommand};
use output::say_aside;
use std::ffi::OsString;
use std::process::ExitCode;

/// Relight 3D captures in latent token space.
#[derive(Parser)]
#[command(name = "lumi", version, propagate_version = true)]
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

/// Runs the program with its arguments, its own name first, and returns its exit status: 0 done, 1 failed, 2 wrong usage,
/// 130 asked to stop. It says what it has to say on standard output and error.
pub fn run(args: impl IntoIterator<Item = OsString>) -> ExitCode {
    let cli = match Cli::try_parse_from(args) {
        Ok(cli) => cli,
        Err(said) => {
            // Help and versions are among these. A closed pipe is no fault.
            let _lost = said.print();
            return u8::try_from(said.exit_code()).map_or(ExitCode::FAILURE, ExitCode::from);
        }
    };
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
