//! The photographs that a capture is made of: files of a folder, or pictures of a video.

use crate::commands::make_folder;
use anyhow::{Context, Result, bail};
use lumi_core::image::{stated_size, turned, type_of};
use std::collections::BTreeSet;
use std::ffi::OsStr;
use std::io::ErrorKind;
use std::path::Path;
use std::process::Command;

/// Photographs in a folder.
pub struct Photographs {
    /// Their file names, in order.
    pub names: Vec<String>,
    /// Whether all are of one size, and so may be of one camera.
    pub one_size: bool,
}

/// Puts the photographs of `from`, a folder or a video of which `frames` pictures are taken, into the new folder `to`, turned
/// as EXIF says if `turn`; those that stand upright stay the files they are.
///
/// # Errors
/// Names the file that is none that is read, or whose name another one has, too; fails if there are fewer than two.
pub fn gather(from: &Path, to: &Path, turn: bool, frames: usize) -> Result<Photographs> {
    make_folder(to)?;
    if from.is_file() {
        take_frames(from, to, frames)?;
        return in_folder(from, to);
    }
    let place = || from.display().to_string();
    let entries = std::fs::read_dir(from).with_context(place)?;
    let mut paths = Vec::new();
    for entry in entries {
        let path = entry.with_context(place)?.path();
        let hidden = path
            .file_name()
            .is_some_and(|n| n.to_string_lossy().starts_with('.'));
        if path.is_file() && !hidden {
            paths.push(path);
        }
    }
    paths.sort();
    let mut stems = BTreeSet::new();
    for path in paths {
        let bytes = lumi_core::fs::read_bytes(&path)?;
        let kind = type_of(&bytes).unwrap_or_default();
        if !kind.contains("image") {
            continue;
        }
        if !["a PNG image", "a JPEG image"].contains(&kind) {
            bail!(
                "{}: expected a photograph as PNG or JPEG, found {kind}",
                path.display()
            );
        }
        let (Some(name), Some(stem)) = (path.file_name(), path.file_stem().and_then(OsStr::to_str))
        else {
            bail!("{}: expected a name in UTF-8", path.display());
        };
        if !stems.insert(stem.to_lowercase()) {
            bail!(
                "{}: expected names that differ, found two photographs `{stem}`",
                path.display()
            );
        }
        let upright = if turn { turned(&path, &bytes)? } else { None };
        match upright {
            Some(png) => {
                lumi_core::fs::atomic_write(to.join(stem).with_added_extension("png"), &png)?
            }
            None => lumi_core::fs::atomic_write(to.join(name), &bytes)?,
        }
    }
    in_folder(from, to)
}

/// What [`gather`] has put into `to`.
fn in_folder(from: &Path, to: &Path) -> Result<Photographs> {
    let mut names = Vec::new();
    let mut sizes = BTreeSet::new();
    for entry in std::fs::read_dir(to).with_context(|| to.display().to_string())? {
        let path = entry?.path();
        sizes.insert(stated_size(&path, &lumi_core::fs::read_bytes(&path)?));
        names.extend(path.file_name().map(|n| n.to_string_lossy().into_owned()));
    }
    names.sort();
    if names.len() < 2 {
        bail!(
            "{}: expected two photographs or more (PNG, JPEG), found {}",
            from.display(),
            names.len()
        );
    }
    let one_size = sizes.len() == 1;
    Ok(Photographs { names, one_size })
}

/// `count` pictures, evenly spread over the video.
fn take_frames(video: &Path, to: &Path, count: usize) -> Result<()> {
    let seconds = run("ffprobe", |command| {
        command.args([
            "-v",
            "error",
            "-show_entries",
            "format=duration",
            "-of",
            "csv=p=0",
        ]);
        command.arg(video)
    })?;
    let seconds = seconds
        .trim()
        .parse::<f64>()
        .ok()
        .filter(|s| s.is_finite() && *s > 0.0);
    let seconds = seconds.with_context(|| {
        format!(
            "{}: expected a folder of photographs or a video",
            video.display()
        )
    })?;
    run("ffmpeg", |command| {
        command.args(["-v", "error", "-nostdin", "-i"]).arg(video);
        command.args(["-vf", &format!("fps={}", count as f64 / seconds)]);
        command.args(["-frames:v", &count.to_string(), "-q:v", "2"]);
        command.arg(to.join("%04d.jpg"))
    })?;
    Ok(())
}

/// What a program prints.
fn run(program: &str, arguments: impl FnOnce(&mut Command) -> &mut Command) -> Result<String> {
    let output = arguments(&mut Command::new(program)).output();
    let output = output.map_err(|e| match e.kind() {
        ErrorKind::NotFound => anyhow::anyhow!(
            "{program}: expected this program on the PATH to take photographs from a video; install it (Debian, Ubuntu: \
             `apt install ffmpeg`; macOS: `brew install ffmpeg`; https://ffmpeg.org/download.html)"
        ),
        _ => anyhow::Error::new(e).context(program.to_owned()),
    })?;
    if !output.status.success() {
        bail!(
            "{program}: {}",
            String::from_utf8_lossy(&output.stderr).trim()
        );
    }
    Ok(String::from_utf8_lossy(&output.stdout).into_owned())
}
