//! Progress on the terminal: a bar where there is one, plain lines elsewhere.

use indicatif::{ProgressBar, ProgressStyle};
use lumi_core::{Event, Progress};
use std::io::IsTerminal;
use std::sync::Mutex;

/// Writes events to standard error.
pub struct Terminal {
    bars: bool,
    state: Mutex<State>,
}

#[derive(Default)]
struct State {
    bar: Option<ProgressBar>,
    stage: String,
    total: u64,
    /// Tenths of the stage that were already reported (without a terminal).
    tenths: u64,
}

impl Terminal {
    /// Chooses between bar and lines.
    pub fn new() -> Self {
        Self {
            bars: std::io::stderr().is_terminal(),
            state: Mutex::default(),
        }
    }
}

impl Progress for Terminal {
    fn event(&self, event: Event) {
        let Ok(mut state) = self.state.lock() else {
            return;
        };
        match event {
            Event::Begin { stage, total } => state.begin(stage, total, self.bars),
            Event::Step { done, note } => state.step(done, note),
            Event::End => {
                if let Some(bar) = state.bar.take() {
                    bar.finish();
                }
            }
            Event::Warning(text) => match &state.bar {
                Some(bar) => bar.suspend(|| eprintln!("warning: {text}")),
                None => eprintln!("warning: {text}"),
            },
        }
    }
}

impl State {
    fn begin(&mut self, stage: String, total: u64, bars: bool) {
        if bars {
            let bar = ProgressBar::new(total);
            let template = "{msg:24} {bar:30} {pos}/{len} {prefix} {eta}";
            if let Ok(style) = ProgressStyle::with_template(template) {
                bar.set_style(style);
            }
            bar.set_message(stage.clone());
            self.bar = Some(bar);
        } else {
            eprintln!("{stage} ({total})");
        }
        (self.stage, self.total, self.tenths) = (stage, total, 0);
    }

    fn step(&mut self, done: u64, note: String) {
        if let Some(bar) = &self.bar {
            bar.set_position(done);
            bar.set_prefix(note);
            return;
        }
        let tenths = (10 * done).checked_div(self.total).unwrap_or(10);
        if tenths > self.tenths {
            self.tenths = tenths;
            eprintln!("{}: {done} of {} {note}", self.stage, self.total);
        }
    }
}
