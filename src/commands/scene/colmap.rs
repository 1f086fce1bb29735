//! Poses by COLMAP, which runs as a program of its own: <https://colmap.github.io>.

use super::photographs::Photographs;
use crate::commands::make_folder;
use anyhow::{Context, Result, bail};
use lumi_core::{Event, Progress};
use std::fs::File;
use std::io::{BufRead, BufReader, ErrorKind, Write};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

/// COLMAP with a log of all it says.
pub struct Colmap {
    log: PathBuf,
    /// How this version calls its options `use_gpu`.
    extraction: &'static str,
    matching: &'static str,
}

/// A step of COLMAP: its name there and for people, and how a line begins that says of one part that it is done.
struct Step {
    command: &'static str,
    stage: &'static str,
    part: &'static str,
}

const EXTRACT: Step = Step {
    command: "feature_extractor",
    stage: "finding features",
    part: "Processed file [",
};
const MATCH: Step = Step {
    command: "exhaustive_matcher",
    stage: "matching photographs",
    part: "Matching block [",
};
const MAP: Step = Step {
    command: "mapper",
    stage: "finding poses",
    part: "Registering image #",
};

const MISSING: &str = "colmap: expected this program on the PATH; install it (Debian, Ubuntu: `apt install colmap`; macOS: `brew \
    install colmap`; https://colmap.github.io/install.html), or give --poses";

/// Photographs a side of the blocks that are matched at a time; COLMAP's own choice.
const BLOCK: usize = 50;

impl Colmap {
    /// The program, which shall write its log to `log`.
    ///
    /// # Errors
    /// Says how to install it where it is missing.
    pub fn find(log: &Path) -> Result<Self> {
        let option = |step: &Step, new: &'static str, old: &'static str| -> Result<&'static str> {
            let output = colmap(step).arg("--help").output();
            let output = output.map_err(|e| match e.kind() {
                ErrorKind::NotFound => anyhow::anyhow!("{MISSING}"),
                _ => anyhow::Error::new(e).context("colmap"),
            })?;
            let help = [output.stdout, output.stderr].concat();
            let known = String::from_utf8_lossy(&help).contains(new);
            Ok(if known { new } else { old })
        };
        let extraction = ["--FeatureExtraction.use_gpu", "--SiftExtraction.use_gpu"];
        let matching = ["--FeatureMatching.use_gpu", "--SiftMatching.use_gpu"];
        Ok(Self {
            log: log.to_owned(),
            extraction: option(&EXTRACT, extraction[0], extraction[1])?,
            matching: option(&MATCH, matching[0], matching[1])?,
        })
    }

    /// Models `work/sparse/0`, `1`, … of the photographs that were gathered in `work/images`; those of one size are taken to be of
    /// one camera. With `masks`, which hold `NAME.EXTENSION.png` for each of them, only what is white there is looked at.
    ///
    /// # Errors
    /// If COLMAP fails, or finds no poses; names its log.
    pub fn reconstruct(
        &self,
        work: &Path,
        photographs: &Photographs,
        masks: Option<&Path>,
        progress: &dyn Progress,
    ) -> Result<()> {
        let count = photographs.names.len();
        let place = |name: &str| work.join(name).into_os_string();
        let (database, images) = (place("database.db"), place("images"));
        let sparse = work.join("sparse");
        std::fs::create_dir(&sparse).with_context(|| sparse.display().to_string())?;
        if let Some(folder) = self.log.parent() {
            make_folder(folder)?;
        }
        File::create(&self.log).with_context(|| self.log.display().to_string())?;
        let mut command = colmap(&EXTRACT);
        command.arg("--database_path").arg(&database);
        command.arg("--image_path").arg(&images);
        let one_camera = if photographs.one_size { "1" } else { "0" };
        command.args(["--ImageReader.single_camera", one_camera]);
        // Without a GPU COLMAP would open a window for the one it looks for.
        command.args([self.extraction, "0"]);
        // Weaker features than usual (0.0067) count, too: smooth objects have few others.
        command.args(["--SiftExtraction.peak_threshold", "0.003"]);
        if let Some(masks) = masks {
            command.arg("--ImageReader.mask_path").arg(masks);
        }
        self.run(command, &EXTRACT, count, progress)?;

        let mut command = colmap(&MATCH);
        command.arg("--database_path").arg(&database);
        command.args([self.matching, "0"]);
        let blocks = count.div_ceil(BLOCK);
        self.run(command, &MATCH, blocks * blocks, progress)?;

        let mut command = colmap(&MAP);
        command.arg("--database_path").arg(&database);
        command.arg("--image_path").arg(&images);
        command.arg("--output_path").arg(&sparse);
        // Photographs for a capture are few and far apart: fewer matches must do (COLMAP's own: 100, 30 and 15, 16°).
        command.args(["--Mapper.init_min_num_inliers", "40"]);
        command.args(["--Mapper.abs_pose_min_num_inliers", "15"]);
        command.args(["--Mapper.min_num_matches", "12"]);
        command.args(["--Mapper.init_min_tri_angle", "6"]);
        let mapped = self.run(command, &MAP, count, progress);
        let found = std::fs::read_dir(&sparse).is_ok_and(|mut models| models.next().is_some());
        if !found {
            bail!(
                "COLMAP found no poses: the {count} photographs overlap too little, or show too little that can be recognised \
                 (how to shoot: docs/capture.md); its log is {}",
                self.log.display()
            );
        }
        mapped
    }

    /// Runs a step to its end, its output going into the log.
    fn run(
        &self,
        mut command: Command,
        step: &Step,
        total: usize,
        progress: &dyn Progress,
    ) -> Result<()> {
        let place = || format!("colmap {}", step.command);
        progress.event(Event::Begin {
            stage: step.stage.to_owned(),
            total: total as u64,
        });
        let mut log = File::options().append(true).open(&self.log);
        let log = log
            .as_mut()
            .map_err(|e| anyhow::anyhow!("{}: {e}", self.log.display()))?;
        let (reader, writer) = std::io::pipe().with_context(place)?;
        command
            .stdin(Stdio::null())
            .stderr(writer.try_clone().with_context(place)?);
        let mut child = command.stdout(writer).spawn().with_context(place)?;
        // It holds ends of the pipe, which would never be closed.
        drop(command);
        let mut done = 0;
        for line in BufReader::new(reader).split(b'\n') {
            let line = line.with_context(place)?;
            log.write_all(&[&line[..], b"\n"].concat())
                .with_context(|| self.log.display().to_string())?;
            if String::from_utf8_lossy(&line).contains(step.part) {
                done = total.min(done + 1);
                progress.event(Event::Step {
                    done: done as u64,
                    note: String::new(),
                });
            }
        }
        let status = child.wait().with_context(place)?;
        progress.event(Event::End);
        if !status.success() {
            bail!(
                "{}: ended with {status}; its log is {}",
                place(),
                self.log.display()
            );
        }
        Ok(())
    }
}

fn colmap(step: &Step) -> Command {
    let mut command = Command::new("colmap");
    command.arg(step.command);
    // Its parts that draw want a screen otherwise.
    if std::env::var_os("QT_QPA_PLATFORM").is_none() {
        command.env("QT_QPA_PLATFORM", "offscreen");
    }
    command
}
