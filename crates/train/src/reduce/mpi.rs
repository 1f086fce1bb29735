//! Several processes, on one machine or many, started by `mpirun`.

use super::Reduce;
use crate::Result;
use lumi_model::Error;
use mpi::Threading;
use mpi::collective::SystemOperation;
use mpi::topology::SimpleCommunicator;
use mpi::traits::{Communicator, CommunicatorCollectives};

/// Values per exchange: what is added up needs that much memory twice, whatever the model's size.
const CHUNK: usize = 1 << 22;

/// Runs `work` as one of the processes that `mpirun` has started. If it fails or panics, so that the others would wait
/// for it for ever, all of them are ended, with exit status 1.
///
/// # Errors
/// If MPI cannot be started.
pub fn run<T>(work: impl FnOnce(&dyn Reduce) -> Result<T>) -> Result<T> {
    // Only the main thread speaks to other processes, see `threads`.
    let Some((universe, _)) = mpi::initialize_with_threading(Threading::Funneled) else {
        return Err(Error::Failed("MPI has been started before".into()));
    };
    let mut process = Process {
        world: universe.world(),
        finished: false,
    };
    let result = work(&process);
    match &result {
        Ok(_) => process.finished = true,
        Err(error) => {
            let (rank, all) = (process.rank(), process.workers());
            eprintln!("error: process {rank} of {all}: {error}");
        }
    }
    result
}

/// One process.
struct Process {
    world: SimpleCommunicator,
    finished: bool,
}

impl Drop for Process {
    fn drop(&mut self) {
        if !self.finished {
            // The others wait for this one, and nobody else can end them.
            self.world.abort(1);
        }
    }
}

impl Reduce for Process {
    fn rank(&self) -> usize {
        usize::try_from(self.world.rank()).unwrap_or_default()
    }

    fn workers(&self) -> usize {
        usize::try_from(self.world.size()).unwrap_or(1)
    }

    fn mean(&self, values: &mut [f32]) -> Result<()> {
        let workers = self.world.size() as f32;
        let mut sum = vec![0.0; values.len().min(CHUNK)];
        for part in values.chunks_mut(CHUNK) {
            let sum = &mut sum[..part.len()];
            self.world
                .all_reduce_into(&*part, sum, SystemOperation::sum());
            for (value, sum) in part.iter_mut().zip(sum) {
                *value = *sum / workers;
            }
        }
        Ok(())
    }
}
