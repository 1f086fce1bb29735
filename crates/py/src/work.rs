//! Long work: off the interpreter's thread, so that others run meanwhile and Ctrl-C is answered.

use crate::errors::raised;
use lumi_core::{Event, Progress};
use pyo3::exceptions::PyRuntimeError;
use pyo3::prelude::*;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{RecvTimeoutError, channel};
use std::time::Duration;

/// How often the interpreter is asked whether somebody pressed Ctrl-C.
const POLL: Duration = Duration::from_millis(50);

/// Whether the caller has given up; work of several steps asks between them.
#[derive(Clone, Default)]
pub struct Stop(Arc<AtomicBool>);

impl Progress for Stop {
    fn event(&self, _: Event) {}

    fn stop(&self) -> bool {
        self.0.load(Ordering::Relaxed)
    }
}

/// Does `work` on a thread of its own without holding the interpreter. On Ctrl-C the call ends at once with
/// `KeyboardInterrupt`; what cannot stop between steps is finished for nobody.
///
/// # Errors
/// Those of the work, as exceptions.
pub fn run<T: Send + 'static>(
    py: Python<'_>,
    work: impl FnOnce(&Stop) -> anyhow::Result<T> + Send + 'static,
) -> PyResult<T> {
    let stop = Stop::default();
    let asked = stop.clone();
    let (send, mut receive) = channel();
    let thread = std::thread::Builder::new().name("lumitokens".into());
    // Nobody listens any more after an interruption.
    let spawned = thread.spawn(move || drop(send.send(work(&asked))));
    spawned.map_err(raised)?;
    loop {
        let (receiver, got) = py.detach(move || {
            let got = receive.recv_timeout(POLL);
            (receive, got)
        });
        receive = receiver;
        match got {
            Ok(done) => return done.map_err(raised),
            Err(RecvTimeoutError::Timeout) => {
                if let Err(interrupted) = py.check_signals() {
                    stop.0.store(true, Ordering::Relaxed);
                    return Err(interrupted);
                }
            }
            Err(RecvTimeoutError::Disconnected) => {
                let text = "internal error, see standard error; please report it";
                return Err(PyRuntimeError::new_err(text));
            }
        }
    }
}
