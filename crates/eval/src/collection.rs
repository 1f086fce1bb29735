//! A collection of objects to evaluate on, whatever holds them.

use crate::Result;
use crate::draw::{DRAWN, draw_cases};
use lumi_core::{Error, Scene};
use lumi_data::Manifest;
use lumi_data::formats::detect;
use lumi_data::manifest::ObjectCases;
use lumi_data::store::{self, ObjectRecord};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::SystemTime;

/// Where objects come from.
pub enum Collection {
    /// A folder with a `manifest.json` that states the cases.
    Manifest(Manifest),
    /// Objects without stated cases. Those of a light basis are drawn, see [`draw_cases`]; photographs are compared
    /// under the light they were taken in.
    Scenes {
        /// The folder that was named.
        folder: PathBuf,
        /// By name.
        objects: BTreeMap<String, Source>,
        /// Folders that no format recognises, or more than one.
        unknown: Vec<String>,
    },
}

/// What holds an object.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Source {
    /// A record of a training store: a Zarr group or one file.
    Record(PathBuf),
    /// A folder that [`lumi_data::open`] reads.
    Scene(PathBuf),
}

impl Source {
    fn path(&self) -> &Path {
        match self {
            Self::Record(path) | Self::Scene(path) => path,
        }
    }

    /// The file's stem or the folder's name; Objects with Lighting puts each object into `OBJECT/test`.
    fn name(&self) -> Result<String> {
        let full = match self {
            // A group may be in an object store.
            Self::Record(path) => path.clone(),
            Self::Scene(path) => path.canonicalize().map_err(|e| Error::io(path, e))?,
        };
        let is_test = matches!(self, Self::Scene(_)) && full.file_name() == Some(TEST.as_ref());
        let place = full.parent().filter(|_| is_test).unwrap_or(&full);
        let name = if place.extension().is_some_and(|e| e == store::EXTENSION) {
            place.file_stem()
        } else {
            place.file_name()
        };
        let unnamed = || Error::invalid(&full, "name", "expected a folder with a name");
        Ok(name.ok_or_else(unnamed)?.to_string_lossy().into_owned())
    }
}

/// The folder of an object in Objects with Lighting that holds what is evaluated.
const TEST: &str = "test";

impl Collection {
    /// Recognises a folder: a manifest first, then a training store, then one scene, then a folder of scenes
    /// (`FOLDER/SCENE`, or `FOLDER/OBJECT/test` as in Objects with Lighting).
    ///
    /// # Errors
    /// If it is none of these, or two objects have the same name.
    pub fn open(folder: impl AsRef<Path>) -> Result<Self> {
        let folder = folder.as_ref();
        if folder.join("manifest.json").is_file() {
            return Ok(Self::Manifest(Manifest::read(folder)?));
        }
        let records = store::list(folder)?;
        let mut unknown = Vec::new();
        let sources: Vec<Source> = if !records.is_empty() {
            records.into_iter().map(Source::Record).collect()
        } else if let Some(scene) = scene(folder) {
            vec![scene]
        } else if !folder.is_dir() {
            // An object store; folders that are not there have been refused above.
            Vec::new()
        } else {
            let mut scenes = Vec::new();
            for entry in std::fs::read_dir(folder).map_err(|e| Error::io(folder, e))? {
                let path = entry.map_err(|e| Error::io(folder, e))?.path();
                let name = path.file_name().unwrap_or_default().to_string_lossy();
                if !path.is_dir() || name.starts_with('.') {
                    continue;
                }
                match scene(&path) {
                    Some(scene) => scenes.push(scene),
                    None => unknown.push(name.into_owned()),
                }
            }
            unknown.sort();
            scenes
        };
        let mut objects = BTreeMap::new();
        for source in sources {
            let name = source.name()?;
            if let Some(other) = objects.insert(name.clone(), source) {
                let expected = format!("expected names that differ, found {other:?} beside it");
                return Err(Error::invalid(folder, format!("object `{name}`"), expected).into());
            }
        }
        if objects.is_empty() {
            let expected =
                "expected a manifest.json, a training store, a scene, or a folder of scenes";
            return Err(Error::invalid(folder, "data", expected).into());
        }
        Ok(Self::Scenes {
            folder: folder.to_owned(),
            objects,
            unknown,
        })
    }

    /// What a reader of the figures should know about where they come from.
    #[must_use]
    pub fn notes(&self) -> Vec<String> {
        let Self::Scenes { unknown, .. } = self else {
            return Vec::new();
        };
        let mut notes = vec![
            "the data states no cases: those of a light basis are drawn, photographs are compared under the light \
             that they were taken in (docs/evaluation.md)"
                .to_owned(),
        ];
        if !unknown.is_empty() {
            let list = unknown.join(", ");
            notes.push(format!(
                "left out, since they hold no scene of exactly one known format: {list}"
            ));
        }
        notes
    }

    /// The folder that was opened.
    #[must_use]
    pub fn folder(&self) -> &Path {
        match self {
            Self::Manifest(manifest) => &manifest.folder,
            Self::Scenes { folder, .. } => folder,
        }
    }

    /// Names of the objects, sorted: those in `only`, or all if it is empty, without those in `skip`.
    ///
    /// # Errors
    /// If a list names an object that is not there, or nothing is left.
    pub fn names(&self, only: &[String], skip: &[String]) -> Result<Vec<String>> {
        let all: Vec<&String> = match self {
            Self::Manifest(manifest) => manifest.objects.keys().collect(),
            Self::Scenes { objects, .. } => objects.keys().collect(),
        };
        if let Some(unknown) = only.iter().chain(skip).find(|s| !all.contains(s)) {
            let list: Vec<&str> = all.iter().map(|n| n.as_str()).collect();
            let expected = format!("expected one of {}", list.join(", "));
            return Err(
                Error::invalid(self.folder(), format!("object `{unknown}`"), expected).into(),
            );
        }
        let left: Vec<String> = all
            .into_iter()
            .filter(|n| (only.is_empty() || only.contains(n)) && !skip.contains(n))
            .cloned()
            .collect();
        if left.is_empty() {
            let expected = "expected at least one object that is not left out";
            return Err(Error::invalid(self.folder(), "objects", expected).into());
        }
        Ok(left)
    }

    /// A cheap description of an object's cases and files; figures that were made from another one do not count. Objects
    /// in an object store are told by their addresses alone.
    #[must_use]
    pub fn describe(&self, name: &str) -> String {
        match self {
            Self::Manifest(manifest) => {
                let size = Size::of(&manifest.folder.join(name));
                format!("{:?} {size:?}", manifest.objects.get(name))
            }
            Self::Scenes { objects, .. } => {
                let size = objects.get(name).map(|s| Size::of(s.path()));
                format!("drawn {DRAWN} {size:?}")
            }
        }
    }

    /// Loads an object.
    ///
    /// # Errors
    /// If it is not there or cannot be read.
    pub fn scene(&self, name: &str) -> Result<Scene> {
        match self {
            Self::Manifest(manifest) => Ok(manifest.open(name)?),
            Self::Scenes {
                folder, objects, ..
            } => match objects.get(name) {
                Some(Source::Record(path)) => Ok(ObjectRecord::read(path)?.to_scene()),
                Some(Source::Scene(path)) => Ok(lumi_data::open(path)?),
                None => {
                    let place = format!("object `{name}`");
                    Err(Error::invalid(folder, place, "not there").into())
                }
            },
        }
    }

    /// The stated cases of an object, or drawn ones.
    ///
    /// # Errors
    /// As [`draw_cases`].
    pub fn cases(&self, name: &str, scene: &Scene) -> Result<ObjectCases> {
        match self {
            Self::Manifest(manifest) => Ok(manifest.cases(name)?.clone()),
            Self::Scenes { .. } => draw_cases(scene),
        }
    }
}

/// The scene in `folder`, or in its folder `test`.
fn scene(folder: &Path) -> Option<Source> {
    let places = [folder.to_owned(), folder.join(TEST)];
    let mut scenes = places.into_iter().filter(|p| detect(p).is_ok());
    scenes.next().map(Source::Scene)
}

/// How many files a path holds, their bytes together, and when the newest was written. Links are not followed.
#[derive(Debug, Default)]
struct Size {
    files: u64,
    bytes: u64,
    newest: Option<SystemTime>,
}

impl Size {
    fn of(path: &Path) -> Self {
        match std::fs::symlink_metadata(path) {
            Ok(found) if found.is_dir() => {
                let entries = std::fs::read_dir(path).into_iter().flatten();
                let sizes = entries.filter_map(|e| Some(Self::of(&e.ok()?.path())));
                sizes.fold(Self::default(), |sum, one| Self {
                    files: sum.files + one.files,
                    bytes: sum.bytes + one.bytes,
                    newest: sum.newest.max(one.newest),
                })
            }
            Ok(found) => Self {
                files: 1,
                bytes: found.len(),
                newest: found.modified().ok(),
            },
            Err(_) => Self::default(),
        }
    }
}
