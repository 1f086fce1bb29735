//! An object as a protocol sees it: input views, and the views and lightings that are compared.

use crate::Result;
use crate::collection::Collection;
use crate::picture::Picture;
use lumi_core::{Camera, DisplayImage, Error, Light, LinearImage, Role, Scene, Similarity, View};
use lumi_data::manifest::ObjectCases;
use lumi_data::views::{photographed_radiance, radiance_under, spread, square_camera};
use lumi_data::{Lighting, photographs, views_under};
use lumi_model::{Relighter, SceneTokens};
use std::collections::BTreeMap;

/// An object as a protocol sees it: inputs at the model's size, and what they should turn into.
pub struct Subject {
    /// The object's name.
    pub name: String,
    /// World to model space.
    pub to_model: Similarity,
    /// The input views under the light they were taken in, at the side that is compared.
    pub inputs: Vec<View>,
    /// The same as a model is given them, [`Self::detail`] times as large each way.
    pub given: Vec<View>,
    /// As [`Relighter::with_detail`] takes it.
    pub detail: usize,
    /// The light of the inputs in world space, where it is known.
    pub source: Option<Vec<Light>>,
    /// Whether a model is told it ([`Relighter::with_captured_light`]).
    pub told: bool,
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
    pub truth: Vec<Picture>,
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
    /// themselves if `same_views`. What is compared has `side` pixels each way, and what a model is given as many times more
    /// as `detail` says.
    ///
    /// # Errors
    /// As [`Collection::scene`]; if the inputs' own poses are asked for and there are only photographs, which show
    /// a pose in one light; and as [`Subject::photographs`].
    pub fn load(
        collection: &Collection,
        name: &str,
        inputs: usize,
        same_views: bool,
        side: usize,
        detail: impl Fn(&Scene) -> usize,
    ) -> Result<Self> {
        let scene = collection.scene(name)?;
        let detail = detail(&scene);
        if scene.basis.is_none() {
            if same_views {
                let expected = "expected one-light-at-a-time images, found photographs, which show each pose in \
                                one light only; `novel-view` compares held-out photographs";
                return Err(Error::value(format!("scene `{}`", scene.name), expected).into());
            }
            return Self::photographs(&scene, inputs, side, detail);
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
        let given = finer(&inputs, detail, |side| {
            views_under(&scene, &chosen, &cases.source, side)
        })?;
        let square = |&i: &usize| square_camera(&scene, &scene.views[i].camera, side);
        let cameras = held.iter().map(square).collect();
        Ok(Self {
            name: name.to_owned(),
            to_model: scene.to_model,
            inputs,
            given,
            detail,
            source: Some(cases.source.lights(&scene)?),
            told: false,
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

    /// A scene of photographs: inputs as they are, and held-out views whose light is known. Views under lights of
    /// the same names make one target, as one capture of Stanford-ORB does.
    ///
    /// # Errors
    /// If the light of no held-out view is known, or there are no inputs.
    pub fn photographs(scene: &Scene, inputs: usize, side: usize, detail: usize) -> Result<Self> {
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
            let names = shown.iter().map(|v| v.name.clone()).collect();
            let cameras = shown.iter().map(|v| v.camera).collect();
            let images = shown.into_iter().filter_map(|v| v.image);
            let truth = match photographed_radiance(scene, &views, side) {
                Some(radiance) => with_radiance(images, &radiance),
                None => images.map(Picture::from).collect(),
            };
            let target = Target {
                lights: lights.collect(),
                views: names,
                cameras,
                truth,
            };
            targets.insert(name, target);
        }
        let inputs = photographs(scene, &chosen, side)?;
        Ok(Self {
            name: scene.name.clone(),
            to_model: scene.to_model,
            given: finer(&inputs, detail, |side| photographs(scene, &chosen, side))?,
            inputs,
            detail,
            source: None,
            told: false,
            targets: targets.keys().cloned().collect(),
            truth: Truth::Photographs(targets),
        })
    }

    /// Checks that it has as many inputs as somebody has asked for.
    ///
    /// # Errors
    /// If there are fewer, with their number.
    pub fn expect_inputs(&self, asked: Option<usize>) -> Result<()> {
        let there = self.inputs.len();
        match asked.filter(|asked| *asked > there) {
            None => Ok(()),
            Some(asked) => {
                let place = format!("scene `{}`: inputs", self.name);
                let expected = format!("expected at most its {there} input views, found {asked}");
                Err(Error::value(place, expected).into())
            }
        }
    }

    /// Scene tokens of the input views, told their light where the subject says so.
    ///
    /// # Errors
    /// If the model refuses the views or the light, or it is to be told a light that is not known.
    pub fn encode(&self, model: &Relighter) -> Result<SceneTokens> {
        let tokens = model.encode(&self.given, self.to_model)?;
        if !self.told {
            return Ok(tokens);
        }
        let Some(lights) = &self.source else {
            let place = format!("scene `{}`", self.name);
            return Err(Error::value(place, "expected input views whose light is known").into());
        };
        model.with_captured_light(&tokens, lights)
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
        let radiance = radiance_under(&self.scene, &self.held, lighting, self.side)?;
        let shown = radiance.iter().map(LinearImage::to_display);
        Ok(Target {
            views: self.views.clone(),
            cameras: self.cameras.clone(),
            lights: vec![lighting.lights(&self.scene)?],
            truth: with_radiance(shown, &radiance),
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

/// Views `detail` times as large as `views`, which they are where it is 1.
fn finer(
    views: &[View],
    detail: usize,
    load: impl FnOnce(usize) -> lumi_core::Result<Vec<View>>,
) -> Result<Vec<View>> {
    let side = views.first().map_or(0, |v| v.camera.width);
    Ok(match detail {
        1 => views.to_vec(),
        _ => load(side * detail)?,
    })
}

/// What is shown, with the radiance that it was clipped from.
fn with_radiance(
    shown: impl Iterator<Item = DisplayImage>,
    radiance: &[LinearImage],
) -> Vec<Picture> {
    let pairs = shown.zip(radiance);
    pairs
        .map(|(shown, radiance)| Picture::with_radiance(shown, radiance))
        .collect()
}
