//! Poses by COLMAP, which runs as a program of its own: <https://colmap.github.io>.

use anyhow::{Context, Result, bail};
use lumi_core::{Event, Progress};
use std::fs::File;
use std::io::{BufRead, BufReader, ErrorKind, Write};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

/// COLMAP with a log of all it says.
pub struct Colmap {
    log: PathBuf,
    /// What precedes `use_gpu` in the names of options; newer versions have other names.
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

/// Photographs a side of the blocks that are matched at a time; COLMAP's own choice.
const BLOCK: usize = 50;

impl Colmap {
    /// The program, which shall write its log to `log`.
    ///
    /// # Errors
    /// Says how to install it where it is missing.
    pub fn find(log: &Path) -> Result<Self> {
        let help = |command: &str| -> Result<String> {
            let output = colmap().args([command, "--help"]).output();
            let output = output.map_err(|e| match e.kind() {
                ErrorKind::NotFound => anyhow::anyhow!(
                    "colmap: expected this program on the PATH; install it (Debian, Ubuntu: `apt install colmap`; macOS: \
                     `brew install colmap`; https://colmap.github.io/install.html), or give --poses"
                ),
                _ => anyhow::Error::new(e).context("colmap"),
            })?;
            Ok(String::from_utf8_lossy(&output.stdout).into_owned()
                + &String::from_utf8_lossy(&output.stderr))
        };
        let named = |command, new: &'static str, old: &'static str| -> Result<&'static str> {
            Ok(if help(command)?.contains(new) {
                new
            } else {
                old
            })
        };
        Ok(Self {
            log: log.to_owned(),
            extraction: named(
                EXTRACT.command,
                "--FeatureExtraction.use_gpu",
                "--SiftExtraction.use_gpu",
            )?,
            matching: named(
                MATCH.command,
                "--FeatureMatching.use_gpu",
                "--SiftMatching.use_gpu",
            )?,
        })
    }

    /// Models `work/sparse/0`, `1`, … of the `count` photographs in `work/images`; where `one_camera`, all are taken by one.
    /// With `masks`, which hold `NAME.EXTENSION.png` for each of them, only what is white there is looked at.
    ///
    /// # Errors
    /// If COLMAP fails, or finds no poses; names its log.
    pub fn reconstruct(
        &self,
        work: &Path,
        count: usize,
        one_camera: bool,
        masks: Option<&Path>,
        progress: &dyn Progress,
    ) -> Result<()> {
        let place = |name: &str| work.join(name).into_os_string();
        let (database, images) = (place("database.db"), place("images"));
        let sparse = work.join("sparse");
        std::fs::create_dir(&sparse).with_context(|| sparse.display().to_string())?;
        File::create(&self.log).with_context(|| self.log.display().to_string())?;
        let common = [("--database_path", database), ("--image_path", images)];
        let mut command = colmap();
        command.arg(EXTRACT.command);
        common.iter().for_each(|(name, value)| {
            command.arg(name).arg(value);
        });
        command.args([
            "--ImageReader.single_camera",
            if one_camera { "1" } else { "0" },
        ]);
        // Without a GPU COLMAP would open a window for the one it looks for. Weaker features than usual (0.0067) count, too:
        // smooth objects have few others.
        command.args([
            self.extraction,
            "0",
            "--SiftExtraction.peak_threshold",
            "0.003",
        ]);
        if let Some(masks) = masks {
            command.arg("--ImageReader.mask_path").arg(masks);
        }
        self.run(command, &EXTRACT, count, progress)?;

        let mut command = colmap();
        command.args([MATCH.command, self.matching, "0"]);
        command.arg(common[0].0).arg(&common[0].1);
        let blocks = count.div_ceil(BLOCK);
        self.run(command, &MATCH, blocks * blocks, progress)?;

        let mut command = colmap();
        command.arg(MAP.command).arg("--output_path").arg(&sparse);
        common.iter().for_each(|(name, value)| {
            command.arg(name).arg(value);
        });
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

fn colmap() -> Command {
    let mut command = Command::new("colmap");
    // Its parts that draw want a screen otherwise.
    if std::env::var_os("QT_QPA_PLATFORM").is_none() {
        command.env("QT_QPA_PLATFORM", "offscreen");
    }
    command
}
