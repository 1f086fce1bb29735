//! What is evaluated: a collection of objects, and the views and lightings of each.

use crate::Result;
use lumi_core::{Camera, DisplayImage, Error, Light, LinearImage, Scene, Seed, View};
use lumi_data::manifest::{ObjectCases, Progressive};
use lumi_data::store::{self, ObjectRecord};
use lumi_data::views::square_camera;
use lumi_data::{Lighting, Manifest, views_under};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Where objects come from.
pub enum Collection {
    /// A folder with a `manifest.json` that states the cases.
    Manifest(Manifest),
    /// Scenes that can be shown under one light at a time, without stated cases: a training store, or folders
    /// that [`lumi_data::open`] reads. Cases are drawn, see [`draw_cases`].
    Scenes {
        /// The folder that was named.
        folder: PathBuf,
        /// Each object's file or folder.
        paths: BTreeMap<String, PathBuf>,
    },
}

impl Collection {
    /// Recognises a folder: a manifest first, then a training store, then one scene, then a folder of scenes.
    ///
    /// # Errors
    /// If it is none of these.
    pub fn open(folder: impl AsRef<Path>) -> Result<Self> {
        let folder = folder.as_ref();
        if folder.join("manifest.json").is_file() {
            return Ok(Self::Manifest(Manifest::read(folder)?));
        }
        let name = |path: &Path| path.file_stem().map(|n| n.to_string_lossy().into_owned());
        let stored = store::list(folder)?;
        let paths: BTreeMap<String, PathBuf> = if !stored.is_empty() {
            stored.into_iter().filter_map(|p| Some((name(&p)?, p))).collect()
        } else if lumi_data::formats::detect(folder).is_ok() {
            name(folder).map(|n| (n, folder.to_owned())).into_iter().collect()
        } else {
            let entries = std::fs::read_dir(folder).map_err(|e| Error::io(folder, e))?;
            let folders = entries.filter_map(|e| Some(e.ok()?.path())).filter(|p| p.is_dir());
            let scenes = folders.filter(|p| lumi_data::formats::detect(p).is_ok());
            scenes.filter_map(|p| Some((name(&p)?, p))).collect()
        };
        if paths.is_empty() {
            let expected = "expected a manifest.json, a training store, a scene, or a folder of scenes";
            return Err(Error::invalid(folder, "data", expected).into());
        }
        Ok(Self::Scenes {
            folder: folder.to_owned(),
            paths,
        })
    }

    /// The folder that was opened.
    #[must_use]
    pub fn folder(&self) -> &Path {
        match self {
            Self::Manifest(manifest) => &manifest.folder,
            Self::Scenes { folder, .. } => folder,
        }
    }

    /// Names of the objects, sorted, without those in `skip`.
    ///
    /// # Errors
    /// If `skip` names an object that is not there, or nothing is left.
    pub fn names(&self, skip: &[String]) -> Result<Vec<String>> {
        let all: Vec<&String> = match self {
            Self::Manifest(manifest) => manifest.objects.keys().collect(),
            Self::Scenes { paths, .. } => paths.keys().collect(),
        };
        if let Some(unknown) = skip.iter().find(|s| !all.contains(s)) {
            let list: Vec<&str> = all.iter().map(|n| n.as_str()).collect();
            let expected = format!("expected one of {}", list.join(", "));
            return Err(Error::invalid(self.folder(), format!("object `{unknown}`"), expected).into());
        }
        let left: Vec<String> = all.into_iter().filter(|n| !skip.contains(n)).cloned().collect();
        if left.is_empty() {
            let expected = "expected at least one object that is not left out";
            return Err(Error::invalid(self.folder(), "objects", expected).into());
        }
        Ok(left)
    }

    /// A cheap description of an object's cases; figures that were made from another one do not count.
    #[must_use]
    pub fn describe(&self, name: &str) -> String {
        match self {
            Self::Manifest(manifest) => format!("{:?}", manifest.objects.get(name)),
            Self::Scenes { paths, .. } => {
                let size = paths.get(name).and_then(|p| Some(std::fs::metadata(p).ok()?.len()));
                format!("drawn {DRAWN} {size:?}")
            }
        }
    }

    /// Loads an object and its cases.
    ///
    /// # Errors
    /// If it cannot be read, or has nothing to compare with.
    pub fn load(&self, name: &str) -> Result<(Scene, ObjectCases)> {
        match self {
            Self::Manifest(manifest) => {
                let cases = manifest.cases(name)?.clone();
                Ok((manifest.open(name)?, cases))
            }
            Self::Scenes { folder, paths } => {
                let path = paths
                    .get(name)
                    .ok_or_else(|| Error::invalid(folder, format!("object `{name}`"), "not there"))?;
                let scene = if path.is_dir() {
                    lumi_data::open(path)?
                } else {
                    ObjectRecord::read(path)?.to_scene()
                };
                let cases = draw_cases(&scene)?;
                Ok((scene, cases))
            }
        }
    }
}

/// Version of [`draw_cases`].
const DRAWN: u32 = 1;
/// Mean luminance of the object that drawn lightings give it.
const BRIGHTNESS: f32 = 0.2;
/// Input and held-out views that are drawn.
const VIEWS: usize = 8;

/// Cases of a scene that states none, by its name alone: half of the views (at most 8, evenly spread) are inputs,
/// others (at most 8) are held out; the source is the first environment (else the first light); targets are every
/// other light alone and mixtures of two and three; the chain replaces the light ten times out of a pool of five.
/// Every lighting gives the object a mean luminance of 0.2.
///
/// # Errors
/// If the scene has no light basis, or too few lights or views.
pub fn draw_cases(scene: &Scene) -> Result<ObjectCases> {
    use chance::Draw;
    let refuse = |expected: &str| {
        let place = format!("scene `{}`", scene.name);
        Err(Error::value(place, expected).into())
    };
    let Some(basis) = &scene.basis else {
        return refuse("expected one-light-at-a-time images to compare with, found only photographs");
    };
    let gains: Vec<Option<f32>> = basis.radiance.iter().map(|images| gain(images)).collect();
    let lights: Vec<(String, f32)> = basis
        .lights
        .iter()
        .zip(gains)
        .filter_map(|(light, gain)| Some((light.name.clone(), gain?)))
        .collect();
    if lights.len() < 3 || scene.views.len() < 2 {
        return refuse("expected at least three lights that reach the object, and two views");
    }
    let is_environment = |name: &str| {
        let light = basis.find(name).map(|i| basis.lights[i].light.kind());
        light == Some("environment")
    };
    let first = lights.iter().position(|(name, _)| is_environment(name)).unwrap_or(0);
    let alone = |i: usize| Lighting::from([lights[i].clone()]);
    let others: Vec<usize> = (0..lights.len()).filter(|i| *i != first).collect();
    let mut draw = Draw::new(Seed(0).child(&scene.name).child("cases"));
    let mut targets: BTreeMap<String, Lighting> =
        others.iter().map(|&i| (lights[i].0.clone(), alone(i))).collect();
    for count in [2, 3] {
        let chosen = draw.choose(&others, count);
        if chosen.len() < count {
            continue;
        }
        let share = 1.0 / count as f32;
        let mixture = chosen.iter().map(|&i| (lights[i].0.clone(), lights[i].1 * share));
        let name: Vec<&str> = chosen.iter().map(|&i| lights[i].0.as_str()).collect();
        targets.insert(name.join("+"), mixture.collect());
    }
    let names: Vec<String> = targets.keys().cloned().collect();
    let all: Vec<usize> = (0..names.len()).collect();
    let pool: Vec<String> = draw.choose(&all, 5).into_iter().map(|i| names[i].clone()).collect();
    let mut sequence: Vec<String> = Vec::new();
    while sequence.len() < 10 {
        let next = &pool[draw.below(pool.len())];
        if pool.len() == 1 || sequence.last() != Some(next) {
            sequence.push(next.clone());
        }
    }
    let steps = draw.choose(&others, 4);
    let share = 1.0 / steps.len() as f32;
    let additive = steps.iter().map(|&i| Lighting::from([(lights[i].0.clone(), lights[i].1 * share)]));
    let (inputs, views) = split(scene);
    Ok(ObjectCases {
        source: alone(first),
        inputs,
        views,
        targets,
        progressive: Progressive { pool, sequence },
        additive: vec![additive.collect()],
    })
}

/// Factor that brings the object's mean luminance to [`BRIGHTNESS`]; `None` for a light that does not reach it.
fn gain(images: &[LinearImage]) -> Option<f32> {
    let (mut light, mut area) = (0.0_f64, 0.0_f64);
    for [r, g, b, a] in images.iter().flat_map(|i| &i.pixels) {
        light += f64::from(0.2126 * r + 0.7152 * g + 0.0722 * b);
        area += f64::from(*a);
    }
    let mean = light / area;
    (mean.is_finite() && mean > 1e-6).then(|| (f64::from(BRIGHTNESS) / mean) as f32)
}

/// Names of inputs (even positions) and held-out views (odd ones).
fn split(scene: &Scene) -> (Vec<String>, Vec<String>) {
    let of = |parity: usize| {
        let names = scene.views.iter().skip(parity).step_by(2);
        let names: Vec<String> = names.map(|v| v.name.clone()).collect();
        spread(&names, VIEWS)
    };
    (of(0), of(1))
}

/// At most `n` of the items, evenly spread.
#[must_use]
pub fn spread<T: Clone>(items: &[T], n: usize) -> Vec<T> {
    let n = n.min(items.len());
    (0..n).map(|i| items[i * items.len() / n].clone()).collect()
}

/// An object as a protocol sees it: inputs at the model's size, and the truth under any lighting.
pub struct Subject {
    /// The object's name.
    pub name: String,
    /// The scene.
    pub scene: Scene,
    /// Its cases.
    pub cases: ObjectCases,
    /// The input views under the source lighting.
    pub inputs: Vec<View>,
    /// Names of the views that are compared.
    pub views: Vec<String>,
    /// Their square cameras.
    pub cameras: Vec<Camera>,
    held: Vec<usize>,
    side: usize,
}

impl Subject {
    /// Loads an object with `inputs` of its input views. The compared views are the held-out ones, or the inputs
    /// themselves if `same_views`.
    ///
    /// # Errors
    /// As [`Collection::load`].
    pub fn load(
        collection: &Collection,
        name: &str,
        inputs: usize,
        same_views: bool,
        side: usize,
    ) -> Result<Self> {
        let (scene, cases) = collection.load(name)?;
        let chosen = spread(&cases.inputs, inputs);
        let views = if same_views { chosen.clone() } else { cases.views.clone() };
        let chosen = ObjectCases::indices(&scene, &chosen)?;
        let held = ObjectCases::indices(&scene, &views)?;
        let inputs = views_under(&scene, &chosen, &cases.source, side)?;
        let square = |&i: &usize| square_camera(&scene, &scene.views[i].camera, side);
        let cameras = held.iter().map(square).collect();
        Ok(Self {
            name: name.to_owned(),
            scene,
            cases,
            inputs,
            views,
            cameras,
            held,
            side,
        })
    }

    /// What the compared views look like under `lighting`.
    ///
    /// # Errors
    /// If the lighting names an unknown light.
    pub fn truth(&self, lighting: &Lighting) -> Result<Vec<DisplayImage>> {
        let views = views_under(&self.scene, &self.held, lighting, self.side)?;
        Ok(views.into_iter().filter_map(|v| v.image).collect())
    }

    /// The lights of `lighting` in world space.
    ///
    /// # Errors
    /// If the lighting names an unknown light.
    pub fn lights(&self, lighting: &Lighting) -> Result<Vec<Light>> {
        Ok(lighting.lights(&self.scene)?)
    }

    /// A target lighting by name.
    ///
    /// # Errors
    /// If there is none of that name.
    pub fn target(&self, name: &str) -> Result<&Lighting> {
        self.cases.targets.get(name).ok_or_else(|| {
            Error::value(format!("target `{name}`"), "expected the name of a target").into()
        })
    }
}

/// Draws from a seed; child seeds are already well mixed, so no generator is needed.
mod chance {
    use lumi_core::Seed;

    pub struct Draw(Seed, u64);

    impl Draw {
        pub fn new(seed: Seed) -> Self {
            Self(seed, 0)
        }

        /// A number below `n`.
        pub fn below(&mut self, n: usize) -> usize {
            self.1 += 1;
            (self.0.index(self.1).0 % n as u64) as usize
        }

        /// At most `n` different items, in the order in which they were drawn.
        pub fn choose(&mut self, items: &[usize], n: usize) -> Vec<usize> {
            let mut left = items.to_vec();
            let n = n.min(left.len());
            (0..n).map(|_| left.remove(self.below(left.len()))).collect()
        }
    }
}
