//! Progress as typed events; a terminal, a log or a web page consumes them.

use crate::DisplayImage;
use std::sync::Arc;

/// Something that happened during long work.
#[derive(Clone, Debug, PartialEq)]
pub enum Event {
    /// A stage of `total` steps begins.
    Begin {
        /// What is being done, for people.
        stage: String,
        /// How many steps it has.
        total: u64,
    },
    /// `done` steps of the current stage are finished.
    Step {
        /// Steps finished so far.
        done: u64,
        /// A short note, such as the loss or the file's name; may be empty.
        note: String,
    },
    /// The current stage is over.
    End,
    /// A picture of how the work goes, such as samples of a model in training.
    Picture {
        /// What it shows, for people.
        caption: String,
        /// The picture.
        image: Arc<DisplayImage>,
    },
    /// Something the user should know that does not stop the work.
    Warning(String),
}

/// Receives [`Event`]s. `()` ignores them.
pub trait Progress: Sync {
    /// Takes one event.
    fn event(&self, event: Event);

    /// Whether the work shall end early. Training, evaluation and scoring ask between their steps, and what can be taken up
    /// again keeps what it has done; other work does not ask.
    fn stop(&self) -> bool {
        false
    }
}

impl Progress for () {
    fn event(&self, _: Event) {}
}
