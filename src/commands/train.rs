//! `lumi train`.

use crate::device::DeviceName;
use crate::interrupt;
use crate::output::say;
use crate::progress::Terminal;
use anyhow::Result;
use burn::tensor::Device;
use lumi_core::{Event, Progress};
use lumi_train::cost::{self, StageCost};
use lumi_train::reduce::{Reduce, Solo};
use lumi_train::{Finished, TrainConfig};
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::atomic::{AtomicBool, Ordering};

/// Train a model on light-basis data
#[derive(clap::Args)]
pub struct Args {
    /// Training config (see configs/train)
    config: PathBuf,
    /// Continue from the saved state in the config's output folder
    #[arg(long)]
    resume: bool,
    /// Say what the run costs, operations and memory, and do nothing
    #[arg(long)]
    cost: bool,
    /// Devices of this machine, separated by commas; each gets a worker, and they share every batch
    #[arg(long, value_delimiter = ',', default_value = "cpu")]
    devices: Vec<DeviceName>,
    /// One of several processes that mpirun has started, which share every batch
    #[cfg(feature = "mpi")]
    #[arg(long)]
    mpi: bool,
}

pub fn run(args: &Args) -> Result<ExitCode> {
    if args.cost {
        cost(&TrainConfig::read(&args.config)?)?;
        return Ok(ExitCode::SUCCESS);
    }
    // In every process: the others, too, live until the first has ended its step.
    let stop = interrupt::flag("stopping after this step; once more to stop at once")?;
    #[cfg(feature = "mpi")]
    if args.mpi {
        return Ok(lumi_train::reduce::mpi::run(|process| {
            train(args, process, &stop)
        })?);
    }
    Ok(train(args, &Solo, &stop)?)
}

/// The terminal, and whether the run was asked to stop.
struct Watch<'a> {
    terminal: Terminal,
    stop: &'a AtomicBool,
}

impl Progress for Watch<'_> {
    fn event(&self, event: Event) {
        self.terminal.event(event);
    }

    fn stop(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }
}

/// The part of the run that this process has, with the others' in `processes`.
fn train(args: &Args, processes: &dyn Reduce, stop: &AtomicBool) -> lumi_model::Result<ExitCode> {
    let config = TrainConfig::read(&args.config)?;
    let devices: Vec<Device> = args.devices.iter().map(DeviceName::open).collect();
    let first = processes.rank() == 0;
    let terminal = Terminal::new();
    let watch = Watch { terminal, stop };
    let progress: &dyn Progress = if first { &watch } else { &() };
    let finished = lumi_train::train(&config, args.resume, &devices, processes, progress)?;
    if first {
        report(&finished);
    }
    // A job that was asked to stop is not done: who started it shall see that.
    Ok(match finished.stopped {
        Some(_) => ExitCode::from(interrupt::STATUS),
        None => ExitCode::SUCCESS,
    })
}

fn report(finished: &Finished) {
    match finished.stopped {
        Some((stage, step)) => {
            let stage = stage + 1;
            say!("stopped after step {step} of stage {stage}; `--resume` goes on from there");
        }
        None => {
            let (weights, waiting) = (finished.weights.display(), 100.0 * finished.waiting);
            say!("wrote {weights}; {waiting:.1} % of the steps' time went by waiting for samples");
        }
    }
}

/// Prints a table of the stages.
fn cost(config: &TrainConfig) -> Result<()> {
    let model = config.model_config()?;
    let mut all = 0.0;
    say!("stage              steps   TFLOP/step   PFLOP in all   blocks keep, MiB/sample");
    for (i, stage) in config.stages.iter().enumerate() {
        let StageCost { steps, flops, kept } = StageCost::of(config, &model, i)?;
        let (kind, total) = (format!("{:?}", stage.kind), flops * steps as f64);
        all += total;
        say!(
            "{} {kind:14} {steps:8} {:12.3} {:14.3} {:18.0}",
            i + 1,
            flops / 1e12,
            total / 1e15,
            kept / f64::from(1 << 20)
        );
    }
    say!(
        "{:.1} M weights; with gradients and AdamW's moments {:.0} MiB per worker; {:.3} PFLOP in all",
        cost::weights(&model) as f64 / 1e6,
        cost::state_bytes(&model) / f64::from(1 << 20),
        all / 1e15
    );
    Ok(())
}
