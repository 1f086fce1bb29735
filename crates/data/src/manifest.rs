//! The evaluation manifest beside a set of interchange folders: which views and lightings make the cases.

use crate::{Lighting, json};
use lumi_core::{Error, Result, Scene};
use serde::Deserialize;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// `manifest.json`.
#[derive(Clone, Debug, Deserialize)]
pub struct Manifest {
    /// Layout version; 1.
    pub version: u32,
    /// Side of the stored images in pixels.
    pub resolution: usize,
    /// Cases of each object, by folder name.
    pub objects: BTreeMap<String, ObjectCases>,
    /// Where the manifest and the objects' folders are.
    #[serde(skip)]
    pub folder: PathBuf,
}

/// What is asked of one object.
#[derive(Clone, Debug, Deserialize)]
pub struct ObjectCases {
    /// Lighting of the input images.
    pub source: Lighting,
    /// Names of the input views.
    pub inputs: Vec<String>,
    /// Names of the held-out views.
    pub views: Vec<String>,
    /// Target lightings by name.
    pub targets: BTreeMap<String, Lighting>,
    /// Replacing the light again and again.
    pub progressive: Progressive,
    /// Sequences of lights to add one after the other; the truth at step k is the sum of the first k.
    pub additive: Vec<Vec<Lighting>>,
}

/// Random replacements out of a small pool; all names are keys of [`ObjectCases::targets`].
#[derive(Clone, Debug, Deserialize)]
pub struct Progressive {
    /// The lightings to draw from.
    pub pool: Vec<String>,
    /// The lighting of each step.
    pub sequence: Vec<String>,
}

impl Manifest {
    /// Reads `folder/manifest.json` and checks what can be checked without images: every target that
    /// is referred to exists, and every light and view stands in its object's files.
    ///
    /// # Errors
    /// Names the file, the object, and the target, light or view.
    pub fn read(folder: impl AsRef<Path>) -> Result<Self> {
        let folder = folder.as_ref();
        let path = folder.join("manifest.json");
        let mut manifest: Self = json::read(&path)?;
        folder.clone_into(&mut manifest.folder);
        if manifest.version != 1 {
            let expected = format!("expected 1, found {}", manifest.version);
            return Err(Error::invalid(path, "version", expected));
        }
        for (name, cases) in &manifest.objects {
            let names = Names::read(&folder.join(name))?;
            let checked = cases.check(&names.lights, &names.views);
            checked.map_err(|e| e.within(format!("object `{name}`")).at(&path))?;
        }
        Ok(manifest)
    }

    /// The cases of `object`.
    ///
    /// # Errors
    /// Lists the objects if there is no such one.
    pub fn cases(&self, object: &str) -> Result<&ObjectCases> {
        self.objects.get(object).ok_or_else(|| {
            let names: Vec<_> = self.objects.keys().map(String::as_str).collect();
            let expected = format!("expected one of {}", names.join(", "));
            Error::invalid(
                self.folder.join("manifest.json"),
                format!("object `{object}`"),
                expected,
            )
        })
    }

    /// Opens the scene of `object`.
    ///
    /// # Errors
    /// As [`Manifest::cases`] and [`crate::open`].
    pub fn open(&self, object: &str) -> Result<Scene> {
        self.cases(object)?;
        crate::open(self.folder.join(object))
    }
}

impl ObjectCases {
    /// Indices in `scene` of the named views.
    ///
    /// # Errors
    /// Names a view that the scene does not have.
    pub fn indices(scene: &Scene, names: &[String]) -> Result<Vec<usize>> {
        let index = |name: &String| {
            let found = scene.views.iter().position(|v| v.name == *name);
            let unknown = || {
                Error::value(
                    format!("view `{name}`"),
                    format!("expected a view of scene `{}`", scene.name),
                )
            };
            found.ok_or_else(unknown)
        };
        names.iter().map(index).collect()
    }

    /// The true lighting after each step of an additive sequence: sums of the first k lightings.
    #[must_use]
    pub fn sums(sequence: &[Lighting]) -> Vec<Lighting> {
        let mut sum = Lighting::default();
        let mut add = |step: &Lighting| {
            sum = sum.plus(step);
            sum.clone()
        };
        sequence.iter().map(&mut add).collect()
    }

    fn check(&self, lights: &[String], views: &[String]) -> Result<()> {
        let check = |place: String, lighting: &Lighting| {
            let knows = |name: &str| lights.iter().any(|l| l == name);
            lighting
                .check(knows, || lights.join(", "))
                .map_err(|e| e.within(place))
        };
        let counts = [
            ("inputs", self.inputs.len()),
            ("views", self.views.len()),
            ("targets", self.targets.len()),
        ];
        if let Some((field, _)) = counts.iter().find(|(_, n)| *n == 0) {
            return Err(Error::value(*field, "expected at least one"));
        }
        check("source".to_owned(), &self.source)?;
        for (name, lighting) in &self.targets {
            check(format!("target `{name}`"), lighting)?;
        }
        for (i, sequence) in self.additive.iter().enumerate() {
            for (k, step) in sequence.iter().enumerate() {
                check(format!("additive[{i}][{k}]"), step)?;
            }
        }
        let progressive = &self.progressive;
        for name in progressive.pool.iter().chain(&progressive.sequence) {
            if !self.targets.contains_key(name) {
                let expected = "expected the name of a target".to_owned();
                return Err(Error::value(format!("progressive `{name}`"), expected));
            }
        }
        for name in self.inputs.iter().chain(&self.views) {
            if !views.contains(name) {
                let expected = format!("expected one of {}", views.join(", "));
                return Err(Error::value(format!("view `{name}`"), expected));
            }
        }
        Ok(())
    }
}

/// Names of an object's lights and views, without reading any image.
struct Names {
    lights: Vec<String>,
    views: Vec<String>,
}

impl Names {
    fn read(folder: &Path) -> Result<Self> {
        #[derive(Deserialize)]
        struct Named {
            name: String,
        }
        #[derive(Deserialize)]
        struct Cameras {
            views: Vec<Named>,
        }
        let names = |list: Vec<Named>| list.into_iter().map(|n| n.name).collect();
        Ok(Self {
            lights: names(json::read(&folder.join("lights.json"))?),
            views: names(json::read::<Cameras>(&folder.join("cameras.json"))?.views),
        })
    }
}
