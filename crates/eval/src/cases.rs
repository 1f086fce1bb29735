//! What is evaluated: a collection of objects, and the views and lightings of each.

use crate::Result;
use lumi_core::{
    Camera, DisplayImage, Error, Light, LinearImage, Role, Scene, Seed, Similarity, View,
};
use lumi_data::manifest::{ObjectCases, Progressive};
use lumi_data::store::{self, ObjectRecord};
use lumi_data::views::square_camera;
use lumi_data::{Lighting, Manifest, photographs, views_under};
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
            stored
                .into_iter()
                .filter_map(|p| Some((name(&p)?, p)))
                .collect()
        } else if lumi_data::formats::detect(folder).is_ok() {
            name(folder)
                .map(|n| (n, folder.to_owned()))
                .into_iter()
                .collect()
        } else {
            let entries = std::fs::read_dir(folder).map_err(|e| Error::io(folder, e))?;
            let folders = entries
                .filter_map(|e| Some(e.ok()?.path()))
                .filter(|p| p.is_dir());
            let scenes = folders.filter(|p| lumi_data::formats::detect(p).is_ok());
            scenes.filter_map(|p| Some((name(&p)?, p))).collect()
        };
        if paths.is_empty() {
            let expected =
                "expected a manifest.json, a training store, a scene, or a folder of scenes";
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
            return Err(
                Error::invalid(self.folder(), format!("object `{unknown}`"), expected).into(),
            );
        }
        let left: Vec<String> = all
            .into_iter()
            .filter(|n| !skip.contains(n))
            .cloned()
            .collect();
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
                let size = paths
                    .get(name)
                    .and_then(|p| Some(std::fs::metadata(p).ok()?.len()));
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
            Self::Scenes { folder, paths } => {
                let path = paths.get(name).ok_or_else(|| {
                    Error::invalid(folder, format!("object `{name}`"), "not there")
                })?;
                if path.is_dir() {
                    return Ok(lumi_data::open(path)?);
                }
                Ok(ObjectRecord::read(path)?.to_scene())
            }
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
        return refuse(
            "expected one-light-at-a-time images to compare with, found only photographs",
        );
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
    let first = lights
        .iter()
        .position(|(name, _)| is_environment(name))
        .unwrap_or(0);
    let alone = |i: usize| Lighting::from([lights[i].clone()]);
    let others: Vec<usize> = (0..lights.len()).filter(|i| *i != first).collect();
    let mut draw = Draw::new(Seed(0).child(&scene.name).child("cases"));
    let mut targets: BTreeMap<String, Lighting> = others
        .iter()
        .map(|&i| (lights[i].0.clone(), alone(i)))
        .collect();
    for count in [2, 3] {
        let chosen = draw.choose(&others, count);
        if chosen.len() < count {
            continue;
        }
        let share = 1.0 / count as f32;
        let mixture = chosen
            .iter()
            .map(|&i| (lights[i].0.clone(), lights[i].1 * share));
        let name: Vec<&str> = chosen.iter().map(|&i| lights[i].0.as_str()).collect();
        targets.insert(name.join("+"), mixture.collect());
    }
    let names: Vec<String> = targets.keys().cloned().collect();
    let all: Vec<usize> = (0..names.len()).collect();
    let pool: Vec<String> = draw
        .choose(&all, 5)
        .into_iter()
        .map(|i| names[i].clone())
        .collect();
    let mut sequence: Vec<String> = Vec::new();
    while sequence.len() < 10 {
        let next = &pool[draw.below(pool.len())];
        if pool.len() == 1 || sequence.last() != Some(next) {
            sequence.push(next.clone());
        }
    }
    let steps = draw.choose(&others, 4);
    let share = 1.0 / steps.len() as f32;
    let additive = steps
        .iter()
        .map(|&i| Lighting::from([(lights[i].0.clone(), lights[i].1 * share)]));
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

/// An object as a protocol sees it: inputs at the model's size, and what they should turn into.
pub struct Subject {
    /// The object's name.
    pub name: String,
    /// World to model space.
    pub to_model: Similarity,
    /// The input views under the light they were taken in.
    pub inputs: Vec<View>,
    /// The light of the inputs in world space, where it is known.
    pub source: Option<Vec<Light>>,
    /// Names of the target lightings.
    pub targets: Vec<String>,
    truth: Truth,
}

/// Where the truth comes from.
enum Truth {
    /// Sums of one-light-at-a-time images.
    Basis(Box<Basis>),
    /// Photographs, by target.
    Photographs(BTreeMap<String, Target>),
}

/// The truth under any lighting of a scene's lights.
pub struct Basis {
    scene: Scene,
    /// The stated or drawn cases.
    pub cases: ObjectCases,
    /// Names of the views that are compared.
    pub views: Vec<String>,
    /// Their square cameras.
    pub cameras: Vec<Camera>,
    held: Vec<usize>,
    side: usize,
}

/// A target lighting: views, what they are lit by, and what they should look like.
#[derive(Clone, Debug)]
pub struct Target {
    /// Names of the views.
    pub views: Vec<String>,
    /// Their square cameras in world space.
    pub cameras: Vec<Camera>,
    /// The lights in world space: one list for all views, or one list for each.
    pub lights: Vec<Vec<Light>>,
    /// What the views look like.
    pub truth: Vec<DisplayImage>,
}

impl Target {
    /// The lights of the view at position `i`.
    #[must_use]
    pub fn lights_of(&self, i: usize) -> &[Light] {
        let list = self.lights.get(i).or(self.lights.first());
        list.map_or(&[], Vec::as_slice)
    }
}

impl Subject {
    /// Loads an object with `inputs` of its input views. The compared views are the held-out ones, or the inputs
    /// themselves if `same_views`.
    ///
    /// # Errors
    /// As [`Collection::load`]; and if a scene of photographs does not tell the light of its held-out views.
    pub fn load(
        collection: &Collection,
        name: &str,
        inputs: usize,
        same_views: bool,
        side: usize,
    ) -> Result<Self> {
        let scene = collection.scene(name)?;
        if scene.basis.is_none() {
            return Self::photographs(&scene, inputs, side);
        }
        let cases = collection.cases(name, &scene)?;
        let chosen = spread(&cases.inputs, inputs);
        let views = if same_views {
            chosen.clone()
        } else {
            cases.views.clone()
        };
        let chosen = ObjectCases::indices(&scene, &chosen)?;
        let held = ObjectCases::indices(&scene, &views)?;
        let inputs = views_under(&scene, &chosen, &cases.source, side)?;
        let square = |&i: &usize| square_camera(&scene, &scene.views[i].camera, side);
        let cameras = held.iter().map(square).collect();
        Ok(Self {
            name: name.to_owned(),
            to_model: scene.to_model,
            inputs,
            source: Some(cases.source.lights(&scene)?),
            targets: cases.targets.keys().cloned().collect(),
            truth: Truth::Basis(Box::new(Basis {
                scene,
                cases,
                views,
                cameras,
                held,
                side,
            })),
        })
    }

    /// A scene of photographs: inputs as they are, and held-out views whose light is known. Views under lights of the same names make one target, as
    /// one scene of Stanford-ORB or one environment of Objects with Lighting does.
    ///
    /// # Errors
    /// If the light of no held-out view is known, or there are no inputs.
    pub fn photographs(scene: &Scene, inputs: usize, side: usize) -> Result<Self> {
        let mut groups: BTreeMap<String, Vec<usize>> = BTreeMap::new();
        for i in scene.with_role(Role::Target) {
            let lights = scene.lights_of(i);
            if !lights.is_empty() {
                let names: Vec<String> = lights
                    .iter()
                    .map(|l| l.name.replace(['/', '\\'], "-"))
                    .collect();
                groups.entry(names.join("+")).or_default().push(i);
            }
        }
        let refuse = |expected: &str| {
            let place = format!("scene `{}`", scene.name);
            Err(Error::value(place, expected).into())
        };
        if groups.is_empty() {
            return refuse(
                "expected one-light-at-a-time images, or held-out photographs whose light is known",
            );
        }
        let chosen = spread(&scene.with_role(Role::Input), inputs);
        if chosen.is_empty() {
            return refuse("expected input views");
        }
        let mut targets = BTreeMap::new();
        for (name, views) in groups {
            let shown = photographs(scene, &views, side)?;
            let lights = views
                .iter()
                .map(|&i| scene.lights_of(i).iter().map(|l| l.light.clone()).collect());
            let target = Target {
                lights: lights.collect(),
                views: shown.iter().map(|v| v.name.clone()).collect(),
                cameras: shown.iter().map(|v| v.camera).collect(),
                truth: shown.into_iter().filter_map(|v| v.image).collect(),
            };
            targets.insert(name, target);
        }
        Ok(Self {
            name: scene.name.clone(),
            to_model: scene.to_model,
            inputs: photographs(scene, &chosen, side)?,
            source: None,
            targets: targets.keys().cloned().collect(),
            truth: Truth::Photographs(targets),
        })
    }

    /// A target by name.
    ///
    /// # Errors
    /// If there is none of that name.
    pub fn target(&self, name: &str) -> Result<Target> {
        let target = match &self.truth {
            Truth::Photographs(targets) => targets.get(name).cloned(),
            Truth::Basis(basis) => {
                let lighting = basis.cases.targets.get(name);
                lighting.map(|l| basis.target(l)).transpose()?
            }
        };
        target.ok_or_else(|| {
            Error::value(format!("target `{name}`"), "expected the name of a target").into()
        })
    }

    /// The light basis, for chains of edits.
    ///
    /// # Errors
    /// If the scene holds photographs.
    pub fn basis(&self) -> Result<&Basis> {
        match &self.truth {
            Truth::Basis(basis) => Ok(basis),
            Truth::Photographs(_) => {
                let place = format!("scene `{}`", self.name);
                let expected =
                    "expected one-light-at-a-time images, found photographs, which do not add up";
                Err(Error::value(place, expected).into())
            }
        }
    }
}

impl Basis {
    /// What the compared views look like under `lighting`, and its lights.
    ///
    /// # Errors
    /// If the lighting names an unknown light.
    pub fn target(&self, lighting: &Lighting) -> Result<Target> {
        let views = views_under(&self.scene, &self.held, lighting, self.side)?;
        Ok(Target {
            views: self.views.clone(),
            cameras: self.cameras.clone(),
            lights: vec![lighting.lights(&self.scene)?],
            truth: views.into_iter().filter_map(|v| v.image).collect(),
        })
    }

    /// The lights of `lighting` in world space.
    ///
    /// # Errors
    /// If the lighting names an unknown light.
    pub fn lights(&self, lighting: &Lighting) -> Result<Vec<Light>> {
        Ok(lighting.lights(&self.scene)?)
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
            (0..n)
                .map(|_| left.remove(self.below(left.len())))
                .collect()
        }
    }
}
