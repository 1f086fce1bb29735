//! Progress on the terminal: a bar where there is one, plain lines elsewhere.

use crate::output::say_aside;
use indicatif::{ProgressBar, ProgressStyle};
use lumi_core::{DisplayImage, Event, Progress};
use std::io::IsTerminal;
use std::sync::Mutex;

/// Writes events to standard error.
pub struct Terminal {
    bars: bool,
    /// Whether the terminal says that it shows any colour.
    colors: bool,
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
            colors: std::env::var("COLORTERM").is_ok_and(|c| c == "truecolor" || c == "24bit"),
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
            Event::Picture { caption, image } => {
                if let Some(bar) = state.bar.as_ref().filter(|_| self.colors) {
                    bar.println(format!("{caption}\n{}", blocks(&image)));
                }
            }
            Event::Warning(text) => match &state.bar {
                Some(bar) => bar.suspend(|| say_aside!("warning: {text}")),
                None => say_aside!("warning: {text}"),
            },
        }
    }
}

/// Columns of a picture on the terminal, at most.
const COLUMNS: usize = 72;

/// A picture in text: every character shows two pixels, one above the other.
fn blocks(image: &DisplayImage) -> String {
    let width = image.width.min(COLUMNS);
    let height = (image.height * width).div_ceil(image.width.max(1));
    let shown = image.resized(width, height.next_multiple_of(2));
    let bytes = shown.to_bytes();
    let (pixels, _) = bytes.as_chunks::<3>();
    let mut text = String::new();
    for rows in pixels.chunks(2 * width) {
        let (upper, lower) = rows.split_at(width);
        for ([r, g, b], [s, h, c]) in upper.iter().zip(lower) {
            text += &format!("\x1b[38;2;{r};{g};{b};48;2;{s};{h};{c}m\u{2580}");
        }
        text += "\x1b[0m\n";
    }
    text
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
            say_aside!("{stage} ({total})");
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
            say_aside!("{}: {done} of {} {note}", self.stage, self.total);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_picture_becomes_half_as_many_lines() {
        let mut image = DisplayImage::filled(3, 4, [1.0, 0.0, 0.0]);
        image.pixels[3] = [0.0, 0.0, 1.0];
        let text = blocks(&image);
        assert_eq!(text.lines().count(), 2);
        assert!(text.starts_with("\x1b[38;2;255;0;0;48;2;0;0;255m\u{2580}"));
        assert_eq!(text.matches('\u{2580}').count(), 6);
        // As wide as the terminal likes it, whatever the picture's size.
        let text = blocks(&DisplayImage::filled(300, 151, [0.5; 3]));
        assert!(
            text.lines()
                .all(|line| line.matches('\u{2580}').count() == COLUMNS)
        );
    }
}
