//! What saved pictures are compared with: pictures, or the cases of a data set.

use super::files::{picture_side, pictures, subfolders};
use crate::Result;
use crate::baselines::{self, Seen};
use crate::cases::Subject;
use crate::collection::Collection;
use crate::figures::Figures;
use crate::metrics::Judge;
use crate::picture::Picture;
use crate::protocols::Protocol;
use crate::run::plain;
use lumi_core::Error;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// What saved pictures are compared with.
pub enum Truth {
    /// A folder of pictures, every one of which must be predicted.
    Pictures(PathBuf),
    /// Objects of a data set, at the pictures' own size, which must be square.
    DataSet {
        /// The data set.
        collection: Collection,
        /// Which views and cases are expected.
        protocol: Protocol,
        /// Names of the objects.
        objects: Vec<String>,
    },
}

impl Truth {
    /// Recognises a data set, of which `only` some objects count and others are left out (`skip`), or else a folder of pictures.
    ///
    /// # Errors
    /// If a manifest or another part of a data set cannot be read, an object is not there, the protocol is none of single
    /// views, or objects are chosen from a folder of pictures.
    pub fn open(
        folder: &Path,
        protocol: Protocol,
        only: &[String],
        skip: &[String],
    ) -> Result<Self> {
        let collection = match Collection::open(folder) {
            Ok(collection) => collection,
            // A folder of plain pictures is no data set, and a broken manifest no folder of pictures.
            Err(error) if folder.join("manifest.json").is_file() => return Err(error),
            Err(_) if only.is_empty() && skip.is_empty() => {
                return Ok(Self::Pictures(folder.to_owned()));
            }
            Err(_) => {
                let expected =
                    "expected a data set; in a folder of pictures, leave objects' folders out";
                return Err(Error::invalid(folder, "only, skip", expected).into());
            }
        };
        if protocol == Protocol::Progressive {
            let expected = "expected multi-view or novel-view";
            return Err(Error::value("protocol", expected).into());
        }
        Ok(Self::DataSet {
            objects: collection.names(only, skip)?,
            collection,
            protocol,
        })
    }

    /// The objects' names.
    pub(super) fn objects(&self) -> Result<Vec<String>> {
        let folder = match self {
            Self::DataSet { objects, .. } => return Ok(objects.clone()),
            Self::Pictures(folder) => folder,
        };
        let objects = subfolders(folder)?;
        if objects.is_empty() {
            let expected = "expected OBJECT/CASE/VIEW.png, or a data set with a manifest.json";
            return Err(Error::invalid(folder, "truth", expected).into());
        }
        Ok(objects)
    }

    /// Side at which an object's truth is wanted for the pictures in `predictions`; 0 where it has a size of its own.
    pub(super) fn side(&self, predictions: &Path, object: &str) -> Result<usize> {
        match self {
            Self::Pictures(_) => Ok(0),
            Self::DataSet { .. } => picture_side(&predictions.join(plain(object)?)),
        }
    }

    pub(super) fn object(&self, name: &str, side: usize) -> Result<Object> {
        match self {
            Self::Pictures(folder) => Ok(Object::Pictures(folder.join(name))),
            Self::DataSet {
                collection,
                protocol,
                ..
            } => {
                let about = protocol.about();
                let (inputs, same_views) = (about.inputs, about.same_views);
                let subject = Subject::load(collection, name, inputs, same_views, side, |_| 1)?;
                let trivial = BTreeMap::new();
                Ok(Object::Subject(Box::new(subject), trivial))
            }
        }
    }

    /// What it is, in words, and the number of inputs behind its cases; 0 where that is not known.
    pub(super) fn about(&self) -> (String, usize) {
        match self {
            Self::Pictures(folder) => (folder.display().to_string(), 0),
            Self::DataSet {
                collection,
                protocol,
                ..
            } => {
                let about = protocol.about();
                let folder = collection.folder().display();
                (format!("{folder} ({})", about.name), about.inputs)
            }
        }
    }
}

/// Figures of answers that take no model, by name.
pub(super) type Trivial = BTreeMap<String, Figures>;

/// The truth of one object at one size.
pub(super) enum Object {
    Pictures(PathBuf),
    /// With the trivial answers to the cases so far, which are the same for every method.
    Subject(Box<Subject>, BTreeMap<String, Trivial>),
}

/// What the views of a case should look like.
pub(super) struct Expected {
    pub views: Vec<String>,
    pub truth: Vec<Picture>,
    pub trivial: Trivial,
}

impl Object {
    pub(super) fn cases(&self) -> Result<Vec<String>> {
        let folder = match self {
            Self::Subject(subject, _) => return Ok(subject.targets.clone()),
            Self::Pictures(folder) => folder,
        };
        let cases = subfolders(folder)?;
        if cases.is_empty() {
            let expected = "expected a folder of pictures per case";
            return Err(Error::invalid(folder, "cases", expected).into());
        }
        Ok(cases)
    }

    pub(super) fn case(&mut self, name: &str, judge: &Judge) -> Result<Expected> {
        match self {
            Self::Pictures(folder) => {
                let views = pictures(&folder.join(name))?;
                let truth = views.values().map(Picture::read);
                Ok(Expected {
                    truth: truth.collect::<lumi_core::Result<_>>()?,
                    views: views.into_keys().collect(),
                    trivial: Trivial::new(),
                })
            }
            Self::Subject(subject, known) => {
                let target = subject.target(name)?;
                if !known.contains_key(name) {
                    let seen = Seen::by(subject, &target.cameras);
                    let trivial = baselines::figures(subject, &seen, &target, judge)?;
                    known.insert(name.to_owned(), trivial);
                }
                Ok(Expected {
                    views: target.views,
                    truth: target.truth,
                    trivial: known[name].clone(),
                })
            }
        }
    }
}
