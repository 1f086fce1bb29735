//! `lumi score`: the same figures for pictures that any method saved.
//!
//! Predictions lie in `PREDICTIONS/OBJECT/CASE/VIEW.png` (or `.jpg`, `.exr`, `.hdr`; the last two are linear, and
//! rules that look beyond white see what they hold there). The truth is either a folder of the same layout, whose pictures' alpha says where the object is,
//! or a data set that [`Collection::open`](crate::Collection::open) reads: then cases and views are those of a protocol.

mod files;
mod truth;

pub use truth::Truth;

use crate::Result;
use crate::assemble::{About, Values};
use crate::figures::Detail;
use crate::gallery::Gallery;
use crate::metrics::{Judge, psnr};
use crate::picture::Picture;
use crate::report::{Case, ObjectRecord, Report};
use lumi_core::{DisplayImage, Event, Progress};
use std::collections::BTreeMap;
use std::collections::btree_map::Entry;
use std::path::PathBuf;
use truth::{Expected, Object};

/// A method's saved pictures.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Method {
    /// What tables call it.
    pub name: String,
    /// Folder with `OBJECT/CASE/VIEW.png`.
    pub folder: PathBuf,
}

/// What [`score`] finds.
pub struct Scored {
    /// A report per method, in their order.
    pub reports: Vec<Report>,
    /// Sheet `grid`: for some objects one view of one case, from every method and as it should be.
    pub gallery: Gallery,
}

/// Objects in the gallery.
const SHOWN: usize = 12;

/// Scores the saved pictures of methods. Asked to stop, it begins no further object, and lists those as failed.
///
/// # Errors
/// If the truth holds nothing, or no object of some method could be scored.
pub fn score(
    methods: &[Method],
    truth: &Truth,
    judge: &Judge,
    progress: &dyn Progress,
) -> Result<Scored> {
    let names = truth.objects()?;
    let mut columns: Vec<Column> = methods.iter().map(Column::new).collect();
    let mut gallery = Gallery::default();
    progress.event(Event::Begin {
        stage: "scoring".into(),
        total: names.len() as u64,
    });
    for (i, name) in names.iter().enumerate() {
        if progress.stop() {
            for column in &mut columns {
                let stopped = Err("stopped before it was scored".to_owned());
                column.objects.insert(name.clone(), stopped);
            }
            continue;
        }
        let mut row = Row::new(i);
        let mut open = BTreeMap::new();
        for column in &mut columns {
            let record = column.record(name, truth, &mut open, judge, &mut row);
            let record = record.map_err(|e| e.to_string());
            column.objects.insert(name.clone(), record);
        }
        row.show(name, &mut gallery);
        progress.event(Event::Step {
            done: i as u64 + 1,
            note: name.clone(),
        });
    }
    progress.event(Event::End);
    let (data, inputs) = truth.about();
    let report = |column: Column| {
        let folder = &column.method.folder;
        let about = About {
            protocol: "score",
            model: folder.display().to_string(),
            data: data.clone(),
            place: folder,
            resolution: column.side,
            inputs,
            values: column.kinds.values(),
        };
        about.report(column.objects, judge)
    };
    Ok(Scored {
        reports: columns.into_iter().map(report).collect::<Result<_>>()?,
        gallery,
    })
}

/// A method while it is scored.
struct Column<'a> {
    method: &'a Method,
    objects: BTreeMap<String, std::result::Result<ObjectRecord, String>>,
    /// Shorter side of its pictures.
    side: usize,
    kinds: Kinds,
}

impl<'a> Column<'a> {
    fn new(method: &'a Method) -> Self {
        Self {
            method,
            objects: BTreeMap::new(),
            side: 0,
            kinds: Kinds::default(),
        }
    }

    /// Scores an object; `open` holds its truth by size, for the methods after this one.
    fn record(
        &mut self,
        name: &str,
        truth: &Truth,
        open: &mut BTreeMap<usize, Object>,
        judge: &Judge,
        row: &mut Row,
    ) -> Result<ObjectRecord> {
        let side = truth.side(&self.method.folder, name)?;
        let object = match open.entry(side) {
            Entry::Occupied(entry) => entry.into_mut(),
            Entry::Vacant(entry) => entry.insert(truth.object(name, side)?),
        };
        let names = object.cases()?;
        let mut cases = BTreeMap::new();
        for (i, case) in names.iter().enumerate() {
            let expected = object.case(case, judge)?;
            let found = files::read(&self.method.folder, name, case, &expected.views)?;
            self.kinds.count(&found);
            let first = expected.truth.first().map(|p| &p.shown);
            self.side = first.map_or(side, |shown| shown.width.min(shown.height));
            let figures = judge.figures(&found, &expected.truth, Detail::Full)?;
            if row.shows(i, names.len()) {
                row.add(&self.method.name, case, &found, &expected, judge)?;
            }
            let Expected { views, trivial, .. } = expected;
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
    }
}

/// An object's row of the grid: one view of one case, others for every object.
struct Row {
    /// The object's place among all.
    object: usize,
    /// Case and view that are shown.
    label: String,
    tiles: Vec<(String, DisplayImage)>,
    truth: Option<DisplayImage>,
}

impl Row {
    fn new(object: usize) -> Self {
        Self {
            object,
            label: String::new(),
            tiles: Vec::new(),
            truth: None,
        }
    }

    /// Whether it shows the `case`th of an object's cases. Lightings are sorted by name (areas, environments, points): a step of
    /// two visits all kinds.
    fn shows(&self, case: usize, cases: usize) -> bool {
        self.object < SHOWN && case == (1 + 2 * self.object) % cases
    }

    /// Adds a method's picture after one scale per channel for all views of the case.
    fn add(
        &mut self,
        method: &str,
        case: &str,
        found: &[Picture],
        expected: &Expected,
        judge: &Judge,
    ) -> Result<()> {
        let view = self.object % expected.views.len();
        let image = judge.aligned(found, &expected.truth)?.swap_remove(view);
        let truth = &expected.truth[view].shown;
        let caption = format!("{method} {:.1} dB", psnr(&image, truth));
        self.tiles.push((caption, image));
        self.label = format!("{case}\n{}", expected.views[view]);
        self.truth = Some(truth.clone());
        Ok(())
    }

    fn show(self, object: &str, gallery: &mut Gallery) {
        let row = format!("{object}\n{}", self.label);
        let truth = self.truth.map(|image| ("truth".to_owned(), image));
        for (caption, image) in self.tiles.into_iter().chain(truth) {
            gallery.add("grid", &row, caption, image);
        }
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
