//! Which frames are inputs and which are held out: the lists of names in a file's head.
//!
//! Names are compared as paths: `./images/000.png`, `images\\000.png` and `images/000.png` are one, and an extension may
//! be left out on one side. Where there is a list of training frames, a frame in no list is unused, as in nerfstudio.

use super::TransformsFile;
use crate::formats::photo::usual_role;
use lumi_core::{Error, Result, Role};
use std::collections::{HashMap, HashSet};
use std::path::Path;

/// Most names that a message lists.
const LISTED: usize = 3;

/// The role of each frame; `None` for frames that no list names.
///
/// # Errors
/// Names the entry of a list that is no frame's.
pub(super) fn roles(
    file: &TransformsFile,
    warnings: &mut Vec<String>,
) -> Result<Vec<Option<Role>>> {
    let count = file.frames.len();
    let names = Names::of(file);
    let train = names.find("train_filenames", file.train_filenames.as_deref())?;
    let test = names.find("test_filenames", file.test_filenames.as_deref())?;
    let val = names.find("val_filenames", file.val_filenames.as_deref())?;
    if train.is_none() && test.is_none() && val.is_none() {
        return Ok((0..count).map(|i| Some(usual_role(i, count))).collect());
    }
    let held: HashSet<usize> = test.into_iter().chain(val).flatten().collect();
    let role = |i: usize| match &train {
        _ if held.contains(&i) => Some(Role::Target),
        Some(train) if !train.contains(&i) => None,
        _ => Some(Role::Input),
    };
    let roles: Vec<Option<Role>> = (0..count).map(role).collect();
    let both = |i: &usize| held.contains(i) && train.as_ref().is_some_and(|t| t.contains(i));
    names.tell(
        both,
        "are listed for training and held out; taken as held out",
        warnings,
    );
    names.tell(
        |i| roles[*i].is_none(),
        "are in no list and unused",
        warnings,
    );
    if train.is_none() {
        let rest = |i: &usize| roles[*i] == Some(Role::Input);
        let text = "are in no list; taken as inputs, for there is no train_filenames";
        names.tell(rest, text, warnings);
    }
    Ok(roles)
}

/// Frames by their paths, plain.
struct Names {
    plain: Vec<String>,
    by_path: HashMap<String, Vec<usize>>,
    by_stem: HashMap<String, Vec<usize>>,
}

impl Names {
    fn of(file: &TransformsFile) -> Self {
        let plain: Vec<String> = file.frames.iter().map(|f| plain(&f.file_path)).collect();
        let mut names = Self {
            plain: plain.clone(),
            by_path: HashMap::new(),
            by_stem: HashMap::new(),
        };
        for (i, path) in plain.into_iter().enumerate() {
            names.by_stem.entry(stem(&path)).or_default().push(i);
            names.by_path.entry(path).or_default().push(i);
        }
        names
    }

    /// The frames that a list names.
    fn find(&self, field: &str, list: Option<&[String]>) -> Result<Option<HashSet<usize>>> {
        let Some(list) = list else { return Ok(None) };
        let mut found = HashSet::new();
        for (i, name) in list.iter().enumerate() {
            let path = plain(name);
            let frames = self
                .by_path
                .get(&path)
                .or_else(|| self.by_path.get(&stem(&path)))
                .or_else(|| self.by_stem.get(&path));
            let frames = frames.ok_or_else(|| {
                let expected = format!("expected the file_path of a frame, found `{name}`");
                Error::value(format!("{field}[{i}]"), expected)
            })?;
            found.extend(frames);
        }
        Ok(Some(found))
    }

    /// Says something of those frames of which it is true.
    fn tell(&self, of: impl Fn(&usize) -> bool, text: &str, warnings: &mut Vec<String>) {
        let these: Vec<usize> = (0..self.plain.len()).filter(of).collect();
        if these.is_empty() {
            return;
        }
        let listed: Vec<&str> = these
            .iter()
            .take(LISTED)
            .map(|i| self.plain[*i].as_str())
            .collect();
        let more = if these.len() > LISTED { ", …" } else { "" };
        let (count, all) = (these.len(), self.plain.len());
        warnings.push(format!(
            "frames: {count} of {all} {text}: {}{more}",
            listed.join(", ")
        ));
    }
}

/// A path with `/`, without `.` and empty parts, and with `..` taken back where that is possible.
fn plain(name: &str) -> String {
    let slashed = name.replace('\\', "/");
    let mut parts: Vec<&str> = Vec::new();
    for part in slashed.split('/') {
        match part {
            "" | "." => {}
            ".." if parts.last().is_some_and(|p| *p != "..") => {
                parts.pop();
            }
            part => parts.push(part),
        }
    }
    let root = if slashed.starts_with('/') { "/" } else { "" };
    format!("{root}{}", parts.join("/"))
}

/// The path without its extension.
fn stem(path: &str) -> String {
    Path::new(path)
        .with_extension("")
        .to_string_lossy()
        .into_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn paths_are_compared_as_paths() {
        for name in [
            "./images/0.png",
            "images//0.png",
            "images\\0.png",
            "a/../images/0.png",
            ".\\images/./0.png",
        ] {
            assert_eq!(plain(name), "images/0.png", "{name}");
        }
        assert_eq!(plain("../a/0.png"), "../a/0.png");
        assert_eq!(plain("/a/./b"), "/a/b");
    }
}
