//! Runs a protocol over a collection: objects in parallel, finished ones kept, failures listed.

use crate::Result;
use crate::assemble::{About, Values};
use crate::cases::Subject;
use crate::collection::Collection;
use crate::gallery::{Gallery, Tile};
use crate::metrics::Judge;
use crate::protocols::Protocol;
use crate::report::{ObjectRecord, Report, SCHEMA};
use lumi_core::fs::{atomic_write, read_bytes};
use lumi_core::image::write_png;
use lumi_core::{Error, Event, Progress, Scene};
use lumi_model::Relighter;
use lumi_model::checkpoint::fingerprint;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

/// How to run.
#[derive(Clone, Debug, Default)]
pub struct Options {
    /// Objects to evaluate; all if empty.
    pub only: Vec<String>,
    /// Objects to leave out.
    pub skip: Vec<String>,
    /// Input views per object; the protocol's if absent.
    pub inputs: Option<usize>,
    /// How many times as large as its own pictures, each way, the inputs that the model is given are; as far as they go if
    /// absent. Chains are run without.
    pub detail: Option<usize>,
    /// Whether the model is told the light of the inputs, which the paper's protocols keep from it.
    pub captured_light: bool,
    /// Objects at a time; as many as there are processors if absent.
    pub jobs: Option<usize>,
    /// Folder for objects' figures and pictures. A later run takes over what is finished there.
    pub out: Option<PathBuf>,
    /// Whether every prediction is saved, as `lumi score` reads them (needs `out`).
    pub save_images: bool,
    /// Whether finished objects are evaluated again.
    pub fresh: bool,
}

/// A report and the pictures that belong to it.
#[derive(Clone, Debug, Default)]
pub struct Outcome {
    /// The figures.
    pub report: Report,
    /// Pictures by object, in `out/objects/OBJECT/`; empty without a folder.
    pub tiles: BTreeMap<String, Vec<Tile>>,
}

/// What is left in an object's folder once it is finished.
#[derive(Serialize, Deserialize)]
struct Finished {
    /// Fingerprint of everything the figures depend on.
    key: String,
    record: ObjectRecord,
    tiles: Vec<Tile>,
}

/// Evaluates every object of a collection. Objects that fail are listed with the cause; the others count. The
/// figures do not depend on the number of objects at a time, nor on whether the run was interrupted. Asked to stop, it
/// begins no further object, and lists those as failed.
///
/// # Errors
/// If no object could be evaluated, or `out` cannot be written.
pub fn evaluate(
    model: &Relighter,
    collection: &Collection,
    protocol: Protocol,
    judge: &Judge,
    options: &Options,
    progress: &dyn Progress,
) -> Result<Outcome> {
    let names = collection.names(&options.only, &options.skip)?;
    let about = protocol.about();
    let inputs = options.inputs.unwrap_or(about.inputs);
    let run = Run {
        model,
        collection,
        protocol,
        judge,
        options,
        inputs,
    };
    progress.event(Event::Begin {
        stage: about.name.to_owned(),
        total: names.len() as u64,
    });
    let results = run.all(&names, progress);
    progress.event(Event::End);

    let (mut objects, mut tiles) = (BTreeMap::new(), BTreeMap::new());
    for (name, result) in names.into_iter().zip(results) {
        let record = result.map(|finished| {
            tiles.insert(name.clone(), finished.tiles);
            finished.record
        });
        objects.insert(name, record.map_err(|e| e.to_string()));
    }
    let about = About {
        protocol: about.name,
        model: format!("{} ({})", model.fingerprint, model.provenance.origin),
        data: collection.folder().display().to_string(),
        place: collection.folder(),
        resolution: model.config.resolution,
        inputs,
        values: Values::Display,
    };
    let mut report = about.report(objects, judge)?;
    report.notes.extend(collection.notes());
    if model.refinement > 0 {
        report.notes.push(format!(
            "scene tokens were fitted to the inputs in {} steps, which is not part of the paper's protocols",
            model.refinement
        ));
    }
    if options.captured_light {
        let told =
            "the model was told the light of the inputs, which the paper's protocols keep from it";
        report.notes.push(told.to_owned());
    }
    if protocol != Protocol::Progressive && model.config.reprojection && options.detail != Some(1) {
        let times = match options.detail {
            Some(times) => format!("{times} times"),
            None => "as far as they go, up to 4 times".to_owned(),
        };
        report.notes.push(format!(
            "the model was given inputs {times} as large each way as its pictures are, and what it made at that size was averaged"
        ));
    }
    if model.config.overlap {
        report
            .notes
            .push("views were rendered twice, with overlapping patches".to_owned());
    }
    Ok(Outcome { report, tiles })
}

struct Run<'a> {
    model: &'a Relighter,
    collection: &'a Collection,
    protocol: Protocol,
    judge: &'a Judge,
    options: &'a Options,
    inputs: usize,
}

impl Run<'_> {
    /// One result per name, in their order.
    fn all(&self, names: &[String], progress: &dyn Progress) -> Vec<Result<Finished>> {
        let available = std::thread::available_parallelism().map_or(1, usize::from);
        let jobs = self.options.jobs.unwrap_or(available).clamp(1, names.len());
        let (next, done) = (AtomicUsize::new(0), AtomicUsize::new(0));
        let results: Vec<Mutex<Option<Result<Finished>>>> =
            names.iter().map(|_| Mutex::new(None)).collect();
        let work = || {
            while !progress.stop() {
                let i = next.fetch_add(1, Ordering::Relaxed);
                let Some(name) = names.get(i) else { return };
                let result = self.one(name);
                let failed = result.as_ref().err().map(|e| format!("{name}: {e}"));
                if let Some(text) = failed {
                    progress.event(Event::Warning(text));
                }
                if let Ok(mut slot) = results[i].lock() {
                    *slot = Some(result);
                }
                progress.event(Event::Step {
                    done: done.fetch_add(1, Ordering::Relaxed) as u64 + 1,
                    note: name.clone(),
                });
            }
        };
        std::thread::scope(|scope| {
            for _ in 0..jobs {
                scope.spawn(work);
            }
        });
        let missing = || Err(Error::value("object", "stopped before it was evaluated").into());
        let taken = results
            .into_iter()
            .map(|slot| slot.into_inner().ok().flatten());
        taken.map(|result| result.unwrap_or_else(missing)).collect()
    }

    /// An object, taken over where it is finished.
    fn one(&self, name: &str) -> Result<Finished> {
        let folder = match &self.options.out {
            Some(out) => Some(out.join("objects").join(plain(name)?)),
            None => None,
        };
        let key = self.key(name);
        let earlier = folder.as_ref().filter(|_| !self.options.fresh);
        if let Some(finished) = earlier.and_then(|folder| finished(folder, &key)) {
            return Ok(finished);
        }
        let about = self.protocol.about();
        let side = self.model.config.resolution;
        let (inputs, same_views) = (self.inputs, about.same_views);
        let detail = |scene: &Scene| match (self.protocol, self.options.detail) {
            // Its chains in pixel space begin again with the pictures that it has made.
            (Protocol::Progressive, _) => 1,
            (_, Some(detail)) => detail,
            (_, None) => self.model.detail_of(scene),
        };
        let mut subject = Subject::load(self.collection, name, inputs, same_views, side, detail)?;
        subject.expect_inputs(self.options.inputs)?;
        subject.told = self.options.captured_light;
        let model = self.model.clone().with_detail(subject.detail)?;
        let mut gallery = Gallery::default();
        let record = self
            .protocol
            .object(&model, &subject, self.judge, &mut gallery)?;
        let tiles = gallery.tiles.iter().map(|(tile, _)| tile.clone()).collect();
        let finished = Finished { key, record, tiles };
        if let Some(folder) = folder {
            self.keep(&folder, name, &finished, &gallery)?;
        }
        Ok(finished)
    }

    /// Everything an object's figures depend on.
    fn key(&self, name: &str) -> String {
        let depends = format!(
            "{SCHEMA} {} {} refined {} overlap {} detail {:?} told {} {:?} {} {:?} {} {}",
            env!("CARGO_PKG_VERSION"),
            self.model.fingerprint,
            self.model.refinement,
            self.model.config.overlap,
            self.options.detail,
            self.options.captured_light,
            self.protocol,
            self.inputs,
            self.judge.rules,
            self.judge.lpips(),
            self.collection.describe(name),
        );
        let saved = self.options.save_images;
        format!(
            "{}{}",
            fingerprint(depends.as_bytes()),
            if saved { "+images" } else { "" }
        )
    }

    /// Writes pictures, then the record: once that is there, the object is finished.
    fn keep(
        &self,
        folder: &Path,
        name: &str,
        finished: &Finished,
        gallery: &Gallery,
    ) -> Result<()> {
        make(folder)?;
        for (tile, image) in &gallery.tiles {
            write_png(folder.join(&tile.file), image)?;
        }
        if let (true, Some(out)) = (self.options.save_images, &self.options.out) {
            for (case, view, image) in &gallery.predictions {
                let place = out
                    .join("predictions")
                    .join(plain(name)?)
                    .join(plain(case)?);
                make(&place)?;
                write_png(place.join(plain(view)?).with_added_extension("png"), image)?;
            }
        }
        let path = folder.join("record.json");
        let text = serde_json::to_vec_pretty(finished)
            .map_err(|e| Error::invalid(&path, "record", e.to_string()))?;
        Ok(atomic_write(&path, &text)?)
    }
}

/// What an earlier run left, if it was made from the same things.
fn finished(folder: &Path, key: &str) -> Option<Finished> {
    let bytes = read_bytes(folder.join("record.json")).ok()?;
    let finished: Finished = serde_json::from_slice(&bytes).ok()?;
    let there = |tile: &Tile| folder.join(&tile.file).is_file();
    (finished.key == key && finished.tiles.iter().all(there)).then_some(finished)
}

fn make(folder: &Path) -> Result<()> {
    std::fs::create_dir_all(folder).map_err(|e| Error::io(folder, e).into())
}

/// A name that may become part of a path: names come from files.
pub(crate) fn plain(name: &str) -> Result<&str> {
    if !name.is_empty() && Path::new(name).file_name().is_some_and(|n| n == name) {
        return Ok(name);
    }
    let expected = "expected a name without path separators";
    Err(Error::value(format!("name `{name}`"), expected).into())
}
