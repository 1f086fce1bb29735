//! How the workers of a run share their gradients.
//!
//! A run has as many workers as it has devices in all its processes. Each computes the gradient of its share of a
//! step's samples; [`Reduce::mean`] turns it into the mean over all of them, in place and the same bits everywhere, and
//! each then takes the same optimiser step. So weights never travel, and what a run learns depends on its samples, not
//! on where they were worked through.
//!
//! [`Solo`] is one worker, [`threads::run`] one thread per device of a process, `mpi::run` (feature `mpi`) one
//! process among several, each with one device or several. Another way to add up gradients, such as NCCL between the
//! GPUs of a node, is another implementation of [`Reduce`] in a file here.

#[cfg(feature = "mpi")]
pub mod mpi;
pub mod threads;

use crate::Result;
use lumi_model::Error;
use lumi_model::checkpoint::fingerprint;

/// One worker's way to the others.
pub trait Reduce {
    /// This worker's number, from 0; 0 logs, validates and saves.
    fn rank(&self) -> usize;

    /// How many workers there are.
    fn workers(&self) -> usize;

    /// Replaces `values` by their mean over all workers. All call it equally often with equally many values; it returns
    /// once all have.
    ///
    /// # Errors
    /// If another worker has failed.
    fn mean(&self, values: &mut [f32]) -> Result<()>;
}

/// The only worker.
#[derive(Clone, Copy, Debug, Default)]
pub struct Solo;

impl Reduce for Solo {
    fn rank(&self) -> usize {
        0
    }

    fn workers(&self) -> usize {
        1
    }

    fn mean(&self, _: &mut [f32]) -> Result<()> {
        Ok(())
    }
}

/// Waits until all workers are here.
///
/// # Errors
/// If another worker has failed.
pub fn meet(worker: &dyn Reduce) -> Result<()> {
    worker.mean(&mut [0.0])
}

/// What the first worker says to a question that only it can answer.
///
/// # Errors
/// If another worker has failed.
pub fn ask_first(worker: &dyn Reduce, answer: bool) -> Result<bool> {
    let mut said = [f32::from(worker.rank() == 0 && answer)];
    worker.mean(&mut said)?;
    Ok(said[0] > 0.0)
}

/// Checks that all workers have the same `text`, which says `what` they work on.
///
/// # Errors
/// If they do not, or another worker has failed.
pub fn agree(worker: &dyn Reduce, what: &str, text: &str) -> Result<()> {
    // Sixteen small whole numbers, whose mean is exact for any number of workers.
    let digits = fingerprint(text.as_bytes());
    let mine: Vec<f32> = digits
        .bytes()
        .map(|digit| f32::from(digit.wrapping_sub(b'0')))
        .collect();
    let mut mean = mine.clone();
    worker.mean(&mut mean)?;
    if mean == mine {
        return Ok(());
    }
    let (rank, workers) = (worker.rank(), worker.workers());
    Err(Error::Failed(format!(
        "worker {rank} of {workers}: expected the same {what} in every process; \
         are its files on a file system that all machines share?"
    )))
}
