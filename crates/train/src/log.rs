//! What a run writes down: `log.jsonl`, one line per ten steps and per validation, and the same as TensorBoard events.

use crate::Result;
use crate::tensorboard::EventFile;
use crate::validate::Scores;
use lumi_core::image::encode_png;
use lumi_core::{DisplayImage, Error};
use serde_json::json;
use std::fs::File;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Steps between two lines.
const EVERY: u64 = 10;

/// A step as the log takes it in.
pub struct Step {
    /// Its stage.
    pub stage: usize,
    /// Its number in the stage, from 1.
    pub step: u64,
    /// Steps of the stages before this one: TensorBoard has one axis.
    pub before: u64,
    /// Loss before it.
    pub loss: f32,
    /// Global norm of the gradient.
    pub norm: f64,
    /// Learning rate.
    pub rate: f64,
    /// Samples that it has seen.
    pub samples: u64,
    /// Share of the time of all steps so far that went by waiting for samples.
    pub waiting: f64,
}

/// The log of one run.
pub struct Log {
    file: File,
    path: PathBuf,
    events: EventFile,
    started: Instant,
    samples: u64,
    mean: f32,
    before: u64,
    scores: Option<Scores>,
}

impl Log {
    /// Goes on with the log in a run's folder.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn open(output: &Path) -> Result<Self> {
        let path = output.join("log.jsonl");
        let file = File::options().create(true).append(true).open(&path);
        Ok(Self {
            file: file.map_err(|e| Error::io(&path, e))?,
            path,
            events: EventFile::create(output)?,
            started: Instant::now(),
            samples: 0,
            mean: 0.0,
            before: 0,
            scores: None,
        })
    }

    /// Samples per second since the run began or resumed.
    #[must_use]
    pub fn throughput(&self) -> f64 {
        self.samples as f64 / self.started.elapsed().as_secs_f64().max(1e-9)
    }

    /// The run in a few words: loss, the last validation, throughput.
    #[must_use]
    pub fn note(&self) -> String {
        let scores = self.scores.map(|scores| format!(", {scores}"));
        let scores = scores.unwrap_or_default();
        let (loss, throughput) = (self.mean, self.throughput());
        format!("loss {loss:.5}{scores}, {throughput:.1} samples/s")
    }

    /// Takes in a step of a stage.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn step(&mut self, step: &Step) -> Result<()> {
        self.samples += step.samples;
        self.before = step.before;
        self.mean = if self.mean == 0.0 {
            step.loss
        } else {
            0.98 * self.mean + 0.02 * step.loss
        };
        if !step.step.is_multiple_of(EVERY) {
            return Ok(());
        }
        let throughput = self.throughput();
        let at = step.before + step.step;
        for (tag, value) in [
            ("train/loss", f64::from(self.mean)),
            ("train/gradient_norm", step.norm),
            ("train/learning_rate", step.rate),
            ("train/samples_per_second", throughput),
            ("train/waiting_for_samples", step.waiting),
        ] {
            self.events.scalar(tag, at, value as f32)?;
        }
        self.write(&json!({
            "stage": step.stage, "step": step.step, "loss": self.mean, "grad_norm": step.norm,
            "learning_rate": step.rate, "samples_per_second": throughput,
            "waiting_for_samples": step.waiting,
        }))
    }

    /// Takes in a validation and its picture.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn scores(
        &mut self,
        stage: usize,
        step: u64,
        scores: &Scores,
        sheet: &DisplayImage,
    ) -> Result<()> {
        self.scores = Some(*scores);
        let at = self.before + step;
        for (tag, value) in [
            ("validation/reconstruction_psnr", scores.reconstruction),
            ("validation/edited_psnr", scores.edited),
            ("validation/last_edit_psnr", scores.last),
            ("validation/aligned_psnr", scores.aligned),
            ("validation/unedited_psnr", scores.unedited),
        ] {
            self.events.scalar(tag, at, value as f32)?;
        }
        let size = [sheet.width, sheet.height];
        self.events
            .picture("validation/samples", at, size, &encode_png(sheet)?)?;
        self.write(&json!({"stage": stage, "step": step, "validation": scores}))
    }

    fn write(&mut self, line: &serde_json::Value) -> Result<()> {
        writeln!(self.file, "{line}").map_err(|e| Error::io(&self.path, e).into())
    }
}
