//! The `lumi` command line: relight 3D captures in latent token space.

use std::process::ExitCode;

fn main() -> ExitCode {
    lumi_cli::run(std::env::args_os())
}
