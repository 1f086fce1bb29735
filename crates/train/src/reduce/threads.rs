//! One worker thread per device of this process.

use super::Reduce;
use crate::Result;
use lumi_model::Error;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};

/// Runs `work` as `count` workers of this process, one thread each; the first is the calling thread. `processes` joins
/// them with the workers of other processes, which have as many each; only the calling thread uses it.
///
/// # Errors
/// That of the worker that failed first; the others stop when they next meet it.
///
/// # Panics
/// If a worker panics.
pub fn run<T: Send>(
    count: usize,
    processes: &dyn Reduce,
    work: impl Fn(usize, &dyn Reduce) -> Result<T> + Sync,
) -> Result<T> {
    let (process, all) = (processes.rank(), processes.workers() * count);
    let group = Group::new(count);
    let (group, work) = (&group, &work);
    let member = |place: usize| Member {
        group,
        place,
        rank: process * count + place,
        workers: all,
    };
    std::thread::scope(|scope| {
        let others: Vec<_> = (1..count)
            .map(|place| {
                let member = member(place);
                scope.spawn(move || member.finish(work(place, &member)))
            })
            .collect();
        let first = Leader {
            member: member(0),
            processes,
        };
        let mut results = vec![first.member.finish(work(0, &first))];
        drop(first);
        for other in others {
            match other.join() {
                Ok(result) => results.push(result),
                Err(panic) => std::panic::resume_unwind(panic),
            }
        }
        let cause = group.state().failed;
        match cause {
            // Every result but the cause's own only says that another has failed.
            Some(place) => results.swap_remove(place),
            None => results.swap_remove(0),
        }
    })
}

/// What the workers of a process share.
struct Group {
    state: Mutex<State>,
    changed: Condvar,
}

struct State {
    /// The values that each worker has brought to this round.
    brought: Vec<Option<Vec<f32>>>,
    /// The mean of the last round.
    mean: Arc<Vec<f32>>,
    /// Rounds that are over.
    rounds: u64,
    /// Who stopped first.
    failed: Option<usize>,
}

impl Group {
    fn new(count: usize) -> Self {
        Self {
            state: Mutex::new(State {
                brought: vec![None; count],
                mean: Arc::new(Vec::new()),
                rounds: 0,
                failed: None,
            }),
            changed: Condvar::new(),
        }
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Waits for `ready`, or for a worker's failure.
    fn wait(&self, ready: impl Fn(&State) -> bool) -> Result<MutexGuard<'_, State>> {
        let state = self
            .changed
            .wait_while(self.state(), |s| s.failed.is_none() && !ready(s))
            .unwrap_or_else(PoisonError::into_inner);
        match state.failed {
            Some(place) => Err(Error::Failed(format!(
                "worker {place} of this process has stopped"
            ))),
            None => Ok(state),
        }
    }

    fn fail(&self, place: usize) {
        self.state().failed.get_or_insert(place);
        self.changed.notify_all();
    }
}

/// One worker of a process.
struct Member<'a> {
    group: &'a Group,
    /// Number in this process.
    place: usize,
    /// Number among all workers.
    rank: usize,
    workers: usize,
}

impl Member<'_> {
    /// Tells the others if the work failed.
    fn finish<T>(&self, result: Result<T>) -> Result<T> {
        if result.is_err() {
            self.group.fail(self.place);
        }
        result
    }

    fn bring(&self, values: &[f32]) -> u64 {
        let mut state = self.group.state();
        state.brought[self.place] = Some(values.to_vec());
        let round = state.rounds;
        drop(state);
        self.group.changed.notify_all();
        round
    }
}

impl Drop for Member<'_> {
    fn drop(&mut self) {
        // Nobody waits for a worker that has panicked.
        if std::thread::panicking() {
            self.group.fail(self.place);
        }
    }
}

impl Reduce for Member<'_> {
    fn rank(&self) -> usize {
        self.rank
    }

    fn workers(&self) -> usize {
        self.workers
    }

    fn mean(&self, values: &mut [f32]) -> Result<()> {
        let round = self.bring(values);
        // The next round cannot end before this worker has come to it, so `mean` stays until it is read.
        let mean = self.group.wait(|s| s.rounds > round)?.mean.clone();
        values.copy_from_slice(&mean);
        Ok(())
    }
}

/// The first worker, which adds up.
struct Leader<'a> {
    member: Member<'a>,
    processes: &'a dyn Reduce,
}

impl Reduce for Leader<'_> {
    fn rank(&self) -> usize {
        self.member.rank
    }

    fn workers(&self) -> usize {
        self.member.workers
    }

    fn mean(&self, values: &mut [f32]) -> Result<()> {
        let group = self.member.group;
        self.member.bring(values);
        let brought: Vec<Vec<f32>> = {
            let mut state = group.wait(|s| s.brought.iter().all(Option::is_some))?;
            state.brought.iter_mut().filter_map(Option::take).collect()
        };
        if brought.iter().any(|part| part.len() != values.len()) {
            return Err(Error::Failed(
                "expected gradients of the same parameters from every worker".into(),
            ));
        }
        // In the order of the workers, whoever came first: a run repeats bit by bit.
        let count = brought.len() as f32;
        for (i, value) in values.iter_mut().enumerate() {
            *value = brought.iter().map(|part| part[i]).sum::<f32>() / count;
        }
        self.processes.mean(values)?;
        let mut state = group.state();
        state.mean = Arc::new(values.to_vec());
        state.rounds += 1;
        drop(state);
        group.changed.notify_all();
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reduce::{Solo, agree, meet};

    #[test]
    fn means_are_the_same_for_all() {
        let means = |rank: usize, worker: &dyn Reduce| {
            assert_eq!((worker.rank(), worker.workers()), (rank, 3));
            for round in 0..50_u8 {
                let mut values = [rank as f32, f32::from(round)];
                worker.mean(&mut values)?;
                assert_eq!(values, [1.0, f32::from(round)]);
            }
            meet(worker)?;
            agree(worker, "text", "the same")?;
            Ok(rank)
        };
        assert_eq!(run(3, &Solo, means).expect("no failure"), 0);
    }

    #[test]
    fn one_failure_stops_all_and_is_told() {
        for culprit in 0..3 {
            let failing = |rank: usize, worker: &dyn Reduce| {
                meet(worker)?;
                if rank == culprit {
                    return Err(Error::Failed("no more paper".into()));
                }
                // Would wait for ever.
                meet(worker)
            };
            let error = run(3, &Solo, failing).expect_err("a failure").to_string();
            assert_eq!(error, "no more paper");
        }
    }

    #[test]
    fn a_panic_stops_all() {
        let panicking = |rank: usize, worker: &dyn Reduce| {
            assert!(rank != 1, "out of order");
            meet(worker)
        };
        let run = || run(3, &Solo, panicking);
        assert!(std::panic::catch_unwind(run).is_err());
    }

    #[test]
    fn disagreement_is_noticed() {
        let text = |rank: usize, worker: &dyn Reduce| agree(worker, "config", ["a", "b"][rank]);
        let error = run(2, &Solo, text).expect_err("differs").to_string();
        assert!(error.contains("the same config"), "{error}");
    }
}
