//! `lumi score`: the same figures for pictures that any method saved.
//!
//! Predictions lie in `PREDICTIONS/OBJECT/CASE/VIEW.png` (or `.jpg`, `.exr`, `.hdr`; the last two are linear, and
//! rules that look beyond white see what they hold there). The truth is either a folder of the same layout, whose pictures' alpha says where the object is,
//! or a data set that [`Collection::open`] reads: then cases and views are those of a protocol.

use crate::Result;
use crate::assemble::{About, Values};
use crate::baselines::{self, Seen};
use crate::cases::Subject;
use crate::collection::Collection;
use crate::figures::Detail;
use crate::metrics::Judge;
use crate::picture::Picture;
use crate::protocols::Protocol;
use crate::report::{Case, ObjectRecord, Report};
use crate::run::plain;
use lumi_core::image::read_display;
use lumi_core::{Error, Event, Progress};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Endings of picture files, in the order in which they are looked for.
const ENDINGS: [&str; 5] = ["png", "jpg", "jpeg", "exr", "hdr"];

/// Scores saved pictures against a folder of pictures. Every picture of the truth must be predicted.
///
/// # Errors
/// If the truth holds no pictures, or no object could be scored.
pub fn folders(
    predictions: &Path,
    truth: &Path,
    judge: &Judge,
    progress: &dyn Progress,
) -> Result<Report> {
    let objects = subfolders(truth)?;
    if objects.is_empty() {
        let expected = "expected OBJECT/CASE/VIEW.png, or a data set with a manifest.json";
        return Err(Error::invalid(truth, "truth", expected).into());
    }
    let (mut side, mut kinds) = (0, Kinds::default());
    let object = |name: &str| -> Result<ObjectRecord> {
        let mut cases = BTreeMap::new();
        for case in subfolders(&truth.join(name))? {
            let views = pictures(&truth.join(name).join(&case))?;
            let images = views.values().map(Picture::read);
            let images = images.collect::<lumi_core::Result<Vec<_>>>()?;
            let views: Vec<String> = views.into_keys().collect();
            let found = read(predictions, name, &case, &views)?;
            kinds.count(&found);
            let first = images.first().map(|i| &i.shown);
            side = first.map_or(side, |i| i.width.min(i.height));
            let figures = judge.figures(&found, &images, Detail::Full)?;
            let trivial = BTreeMap::new();
            cases.insert(
                case,
                Case {
                    views,
                    figures,
                    trivial,
                },
            );
        }
        if cases.is_empty() {
            let expected = "expected a folder of pictures per case";
            return Err(Error::invalid(truth.join(name), "cases", expected).into());
        }
        Ok(ObjectRecord::from_cases(cases))
    };
    let objects = all(&objects, object, progress);
    let data = truth.display().to_string();
    about(predictions, data, (side, 0), &kinds).report(objects, judge)
}

/// Scores saved pictures against a data set, at the pictures' own size, which must be square.
///
/// # Errors
/// If the data set cannot be read, or no object could be scored.
pub fn data_set(
    predictions: &Path,
    collection: &Collection,
    protocol: Protocol,
    (only, skip): (&[String], &[String]),
    judge: &Judge,
    progress: &dyn Progress,
) -> Result<Report> {
    let protocol = protocol.about();
    let (mut side, mut kinds) = (0, Kinds::default());
    let object = |name: &str| -> Result<ObjectRecord> {
        let place = predictions.join(plain(name)?);
        side = picture_side(&place)?;
        let (inputs, same_views) = (protocol.inputs, protocol.same_views);
        let subject = Subject::load(collection, name, inputs, same_views, side, |_| 1)?;
        let mut cases = BTreeMap::new();
        for case in &subject.targets {
            let target = subject.target(case)?;
            let found = read(predictions, name, case, &target.views)?;
            kinds.count(&found);
            let seen = Seen::by(&subject, &target.cameras);
            let trivial = baselines::figures(&subject, &seen, &target, judge)?;
            let figures = judge.figures(&found, &target.truth, Detail::Full)?;
            let views = target.views;
            cases.insert(
                case.clone(),
                Case {
                    views,
                    figures,
                    trivial,
                },
            );
        }
        Ok(ObjectRecord::from_cases(cases))
    };
    let objects = all(&collection.names(only, skip)?, object, progress);
    let data = format!("{} ({})", collection.folder().display(), protocol.name);
    about(predictions, data, (side, protocol.inputs), &kinds).report(objects, judge)
}

/// Scores each object.
fn all(
    names: &[String],
    mut object: impl FnMut(&str) -> Result<ObjectRecord>,
    progress: &dyn Progress,
) -> BTreeMap<String, Result<ObjectRecord>> {
    progress.event(Event::Begin {
        stage: "scoring".into(),
        total: names.len() as u64,
    });
    let mut objects = BTreeMap::new();
    for (i, name) in names.iter().enumerate() {
        objects.insert(name.clone(), object(name));
        progress.event(Event::Step {
            done: i as u64 + 1,
            note: name.clone(),
        });
    }
    progress.event(Event::End);
    objects
}

/// What the report of `predictions` is about, with the side of their pictures and the number of inputs behind them.
fn about<'a>(
    predictions: &'a Path,
    data: String,
    (resolution, inputs): (usize, usize),
    kinds: &Kinds,
) -> About<'a> {
    About {
        protocol: "score",
        model: predictions.display().to_string(),
        data,
        place: predictions,
        resolution,
        inputs,
        values: kinds.values(),
    }
}

/// How many pictures hold what.
#[derive(Default)]
struct Kinds {
    display: usize,
    linear: usize,
}

impl Kinds {
    fn count(&mut self, pictures: &[Picture]) {
        let linear = pictures.iter().filter(|p| p.linear.is_some()).count();
        self.linear += linear;
        self.display += pictures.len() - linear;
    }

    fn values(&self) -> Values {
        match (self.display, self.linear) {
            (_, 0) => Values::Display,
            (0, _) => Values::Linear,
            _ => Values::Mixed,
        }
    }
}

/// The predictions of a case's views.
fn read(root: &Path, object: &str, case: &str, views: &[String]) -> Result<Vec<Picture>> {
    let folder = root.join(plain(object)?).join(plain(case)?);
    // A folder that is not there lacks its pictures, which is said of the first.
    let there = entries(&folder).unwrap_or_default();
    let one = |view: &String| -> Result<Picture> {
        let name = plain(view)?;
        let named = |p: &&PathBuf| p.file_stem().is_some_and(|stem| stem == name);
        let found = there.iter().filter(named).filter(|p| p.is_file());
        let path = found.filter_map(|p| Some((rank(p)?, p))).min();
        let (_, path) = path.ok_or_else(|| {
            let expected = "expected this picture (.png, .jpg, .exr or .hdr)".to_owned();
            Error::invalid(folder.join(format!("{name}.png")), "prediction", expected)
        })?;
        Ok(Picture::read(path)?)
    };
    views.iter().map(one).collect()
}

/// The place of a picture's ending among [`ENDINGS`], whatever its case; `None` if it is no picture.
fn rank(path: &Path) -> Option<usize> {
    let ending = path.extension()?.to_str()?.to_lowercase();
    ENDINGS.iter().position(|e| *e == ending)
}

/// Names of the folders in a folder, sorted.
fn subfolders(folder: &Path) -> Result<Vec<String>> {
    let paths = entries(folder)?.into_iter().filter(|p| p.is_dir());
    let names = paths.filter_map(|p| Some(p.file_name()?.to_str()?.to_owned()));
    Ok(names.filter(|n| !n.starts_with('.')).collect())
}

/// Pictures in a folder by name without ending, sorted.
fn pictures(folder: &Path) -> Result<BTreeMap<String, PathBuf>> {
    let files = entries(folder)?.into_iter();
    let files = files.filter(|path| rank(path).is_some());
    let named: BTreeMap<String, PathBuf> = files
        .filter_map(|p| Some((p.file_stem()?.to_str()?.to_owned(), p)))
        .collect();
    if named.is_empty() {
        return Err(Error::invalid(folder, "pictures", "expected at least one").into());
    }
    Ok(named)
}

fn entries(folder: &Path) -> Result<Vec<PathBuf>> {
    let list = std::fs::read_dir(folder).map_err(|e| Error::io(folder, e))?;
    let paths: std::io::Result<Vec<PathBuf>> = list.map(|e| Ok(e?.path())).collect();
    let mut paths = paths.map_err(|e| Error::io(folder, e))?;
    paths.sort();
    Ok(paths)
}

/// Side of the first picture of an object's predictions.
fn picture_side(object: &Path) -> Result<usize> {
    let cases = subfolders(object)?;
    let none = || {
        Error::invalid(
            object,
            "predictions",
            "expected a folder of pictures per case",
        )
    };
    let first = pictures(&object.join(cases.first().ok_or_else(none)?))?;
    let path = first.values().next().ok_or_else(none)?;
    let image = read_display(path)?;
    if image.width != image.height {
        let expected = format!(
            "expected a square picture, found {}×{}",
            image.width, image.height
        );
        return Err(Error::invalid(path, "size", expected).into());
    }
    Ok(image.width)
}
