//! Folders of results: written whole or not at all, and never with another run's files among them.

use crate::commands;
use anyhow::{Context, Result, bail};
use std::fs;
use std::path::{Path, PathBuf};
use tempfile::TempDir;

/// The file by which a folder of results is known.
const REPORT: &str = "report.json";

/// Results on their way to a folder.
pub struct Results {
    /// Beside the folder, so that it only needs another name at the end.
    beside: TempDir,
    out: PathBuf,
}

impl Results {
    /// Begins results that [`Self::finish`] puts at `out`. A folder that is there must be empty or, with `overwrite`, hold
    /// earlier results.
    ///
    /// # Errors
    /// If it holds anything else, or its place cannot be written to.
    pub fn begin(out: &Path, overwrite: bool) -> Result<Self> {
        let place = || out.display();
        let holds = match fs::read_dir(out) {
            Ok(mut entries) => entries.next().is_some(),
            Err(_) if !out.exists() => false,
            Err(error) => return Err(error).with_context(|| format!("{}: output folder", place())),
        };
        if holds && !out.join(REPORT).is_file() {
            bail!(
                "{}: expected a new or empty folder, or one of earlier results ({REPORT})",
                place()
            );
        }
        if holds && !overwrite {
            bail!(
                "{}: expected a new or empty folder; --overwrite replaces the results in it",
                place()
            );
        }
        let above = out.parent().map_or(Path::new("."), commands::standing);
        let beside = tempfile::Builder::new().prefix(".lumi-").tempdir_in(above);
        let beside = beside
            .with_context(|| format!("{}: expected a folder that can be written to", place()))?;
        // Unlike the one around it, this has the rights that folders usually have.
        fs::create_dir(beside.path().join("new")).with_context(|| place().to_string())?;
        Ok(Self {
            beside,
            out: out.to_owned(),
        })
    }

    /// The folder to write to meanwhile.
    #[must_use]
    pub fn folder(&self) -> PathBuf {
        self.beside.path().join("new")
    }

    /// Where a file that is to lie at `path` in the end is written: elsewhere than there only if it lies in the folder.
    #[must_use]
    pub fn file(&self, path: &Path) -> PathBuf {
        match path.strip_prefix(&self.out) {
            Ok(inside) => self.folder().join(inside),
            Err(_) => path.to_owned(),
        }
    }

    /// Puts the results in place of what was there.
    ///
    /// # Errors
    /// If they cannot be moved there; what was there is then there still.
    pub fn finish(self) -> Result<()> {
        let moved = || -> std::io::Result<()> {
            if let Some(parent) = self.out.parent() {
                fs::create_dir_all(parent)?;
            }
            let old = self.beside.path().join("old");
            let replaces = self.out.exists();
            if replaces {
                fs::rename(&self.out, &old)?;
            }
            let put = fs::rename(self.folder(), &self.out);
            if put.is_err() && replaces {
                fs::rename(&old, &self.out)?;
            }
            put
        };
        moved().with_context(|| format!("{}: output folder", self.out.display()))
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    fn write(results: &Results, file: &str) {
        fs::write(results.folder().join(file), "x").unwrap();
    }

    fn files(folder: &Path) -> Vec<String> {
        let names = fs::read_dir(folder).unwrap();
        let mut names: Vec<String> = names
            .map(|e| e.unwrap().file_name().into_string().unwrap())
            .collect();
        names.sort();
        names
    }

    #[test]
    fn results_come_whole_and_replace_only_results() {
        let around = tempfile::tempdir().unwrap();
        let out = around.path().join("deep/out");
        let first = Results::begin(&out, false).unwrap();
        write(&first, REPORT);
        write(&first, "a.png");
        assert!(!out.exists(), "nothing before the end");
        first.finish().unwrap();
        assert_eq!(files(&out), ["a.png", REPORT]);

        let refused = Results::begin(&out, false).err().unwrap().to_string();
        assert!(refused.contains("--overwrite"), "{refused}");
        let second = Results::begin(&out, true).unwrap();
        write(&second, REPORT);
        assert_eq!(second.file(&out.join("t/b")), second.folder().join("t/b"));
        assert_eq!(second.file(Path::new("b")), Path::new("b"));
        second.finish().unwrap();
        assert_eq!(files(&out), [REPORT], "nothing of the first is left");

        let foreign = around.path().join("foreign");
        fs::create_dir(&foreign).unwrap();
        Results::begin(&foreign, false).unwrap().finish().unwrap();
        fs::write(foreign.join("thesis.tex"), "x").unwrap();
        for overwrite in [false, true] {
            let refused = Results::begin(&foreign, overwrite).err().unwrap();
            assert!(refused.to_string().contains("earlier results"));
        }
        // What was begun and not finished leaves nothing.
        drop(Results::begin(&out, true).unwrap());
        assert_eq!(files(&around.path().join("deep")), ["out"]);
    }
}
