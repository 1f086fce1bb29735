//! The façade: encode, edit, render. The command line, evaluation and every other user go through it.

use crate::batch;
use crate::checkpoint::{self, Provenance};
pub use crate::config::Mode;
use crate::config::{LightConfig, Output};
use crate::exposure::Exposure;
use crate::illumination::{self, Illumination};
use crate::lights::{self, AuthorsFrame, EditLight, LightShape, LightTokenizer};
use crate::network::{Prepared, Scene};
use crate::places::Places;
use crate::{Error, ModelConfig, Network, Result, radiance};
use burn::tensor::{Device, Tensor};
use lumi_core::light::LightRay;
use lumi_core::{
    Camera, DisplayImage, Light, LinearImage, Reprojection, Similarity, View, reprojection,
};
use lumi_kernels::Precision;
use serde::{Deserialize, Serialize};
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};

/// A model ready to use. Clones share its weights.
#[derive(Clone)]
pub struct Relighter {
    pub(crate) network: Network,
    /// Its architecture.
    pub config: ModelConfig,
    /// Where its weights come from.
    pub provenance: Provenance,
    /// Fingerprint of the weights file; scene tokens carry it, since they mean nothing to other weights.
    pub fingerprint: String,
    /// Steps of [`Self::with_refinement`].
    pub refinement: usize,
    /// As [`Self::with_detail`] says.
    pub(crate) detail: usize,
    pub(crate) device: Device,
}

/// A change of light.
#[derive(Clone, Debug)]
pub struct Edit {
    /// What happens to the light that is there.
    pub mode: Mode,
    /// The lights, in the scene's world space.
    pub lights: Vec<Light>,
    /// Whether `set` goes on from the edited tokens, as the paper's progressive edits do. Otherwise it begins at the captured
    /// ones: it replaces all light, so nothing of an earlier edit can stay.
    pub chained: bool,
}

/// Where a scene's tokens live, from its capture on; the same after every edit.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SceneFrame {
    /// World to model space.
    pub to_model: Similarity,
    /// For models with the authors' lights: where those stand.
    #[serde(default, alias = "release", skip_serializing_if = "Option::is_none")]
    pub authors: Option<AuthorsFrame>,
    /// For models with `anchors`: the input views' cameras in model space.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub views: Vec<Camera>,
    /// As [`Relighter::with_captured_light`] has found it.
    #[serde(default, skip_serializing_if = "Exposure::is_unknown")]
    pub exposure: Exposure,
}

/// What is the same for all tokens of one capture.
#[derive(Debug)]
pub(crate) struct Captured {
    pub(crate) frame: SceneFrame,
    /// The tokens before any edit.
    pub(crate) scene: Scene,
    /// For models with `reprojection`.
    pub(crate) photographs: Option<Photographs>,
}

/// The photographs of a capture, in model space.
#[derive(Clone, Debug)]
pub(crate) struct Photographs {
    /// As they were given.
    pub(crate) fine: Arc<Reprojection>,
    /// At the size that tokens see; the same ones where they were given so.
    pub(crate) coarse: Arc<Reprojection>,
}

impl Photographs {
    /// Photographs that may be finer than `cameras`.
    pub(crate) fn new(fine: Reprojection, cameras: &[Camera]) -> Self {
        let fine = Arc::new(fine);
        let given = fine.images();
        let size = |c: &Camera| (c.width, c.height);
        let as_large = given
            .iter()
            .zip(cameras)
            .all(|(image, c)| (image.width, image.height) == size(c));
        if as_large {
            let coarse = Arc::clone(&fine);
            return Self { fine, coarse };
        }
        let reduced = given.iter().zip(cameras);
        let reduced = reduced.map(|(image, c)| image.resized(c.width, c.height));
        let reduced: Vec<DisplayImage> = reduced.collect();
        Self {
            coarse: Arc::new(Reprojection::new(reduced.iter().zip(cameras))),
            fine,
        }
    }
}

/// A scene as a model sees it: K tokens, how strongly they are lit, and the frame they live in.
#[derive(Clone, Debug)]
pub struct SceneTokens {
    /// `[1, K, d]`
    pub(crate) scene: Scene,
    /// What the decoder's radiance is multiplied with; for models with `output = "radiance"`.
    pub illumination: Illumination,
    /// Rays of the light that edits have brought, in model space: those since the last `set`, which replaces all. For models
    /// with `direct`.
    pub(crate) lights: Arc<[LightRay]>,
    pub(crate) captured: Arc<Captured>,
    /// Fingerprint of the model that made them.
    pub model: String,
    /// What was done, in words, oldest first.
    pub history: Vec<String>,
    /// What the decoder makes of the tokens alone, from the first render on.
    pub(crate) prepared: Arc<Mutex<Option<Arc<Prepared>>>>,
}

impl SceneTokens {
    /// World to model space.
    #[must_use]
    pub fn to_model(&self) -> &Similarity {
        &self.captured.frame.to_model
    }

    /// Where the tokens live.
    #[must_use]
    pub fn frame(&self) -> &SceneFrame {
        &self.captured.frame
    }

    /// What the decoder is given of the photographs, for models with `reprojection`.
    #[must_use]
    pub fn photographs(&self) -> Option<&Reprojection> {
        self.captured.photographs.as_ref().map(|p| &*p.fine)
    }

    /// Rays of the light that edits have brought, in model space, for models with `direct`.
    #[must_use]
    pub fn lights(&self) -> &[LightRay] {
        &self.lights
    }

    /// All light so far `factor` times as strong, per channel: exact, and no network runs.
    #[must_use]
    pub fn scaled(&self, factor: [f64; 3]) -> Self {
        let mut history = self.history.clone();
        history.push(format!("scale {factor:?}"));
        Self {
            illumination: self.illumination.scaled(factor),
            lights: self.lights.iter().map(|ray| ray.scaled(factor)).collect(),
            history,
            ..self.clone()
        }
    }

    /// Memory that the tokens take, apart from what [`Relighter::render`] keeps beside them.
    #[must_use]
    pub fn bytes(&self) -> usize {
        size_of::<f32>() * self.scene.channels.dims().iter().product::<usize>()
    }

    /// Gives back the memory that [`Relighter::render`] has filled beside these tokens and their clones; the next
    /// render fills it again. For those who keep many tokens and look at few.
    pub fn forget_prepared(&self) {
        let mut kept = self.prepared.lock().unwrap_or_else(PoisonError::into_inner);
        *kept = None;
    }
}

/// Largest [`Relighter::detail_of`] a scene.
const DETAIL: usize = 4;

/// Corrections after a removal: each leaves the light's share of what was wrong.
const CORRECTIONS: usize = 4;

/// Views that are rendered at a time, which bounds memory.
pub(crate) const VIEWS_AT_ONCE: usize = 8;

impl Edit {
    /// An edit of a mode.
    pub fn new(mode: Mode, lights: impl Into<Vec<Light>>) -> Self {
        Self {
            mode,
            lights: lights.into(),
            chained: false,
        }
    }

    /// The same, going on from the edited tokens: see [`Self::chained`].
    #[must_use]
    pub fn chained(self) -> Self {
        Self {
            chained: true,
            ..self
        }
    }

    /// Replaces all light.
    pub fn set(lights: impl Into<Vec<Light>>) -> Self {
        Self::new(Mode::Set, lights)
    }

    /// Adds lights.
    pub fn add(lights: impl Into<Vec<Light>>) -> Self {
        Self::new(Mode::Add, lights)
    }

    /// Takes lights away.
    pub fn remove(lights: impl Into<Vec<Light>>) -> Self {
        Self::new(Mode::Remove, lights)
    }

    /// The edit in a few words, such as `add point`.
    #[must_use]
    pub fn describe(&self) -> String {
        let mode = format!("{:?}", self.mode).to_lowercase();
        let kinds: Vec<_> = self.lights.iter().map(Light::kind).collect();
        format!("{mode} {}", kinds.join(" + "))
    }
}

impl Relighter {
    /// Loads a weights file.
    ///
    /// # Errors
    /// If it cannot be read or its tensors do not fit its config.
    pub fn load(path: impl AsRef<Path>, device: &Device) -> Result<Self> {
        let path = path.as_ref();
        let bytes = lumi_core::fs::read_bytes(path)?;
        Self::from_bytes(&bytes, path, device)
    }

    /// Loads a weights file from memory; `path` names it in errors.
    ///
    /// # Errors
    /// As [`Self::load`].
    pub fn from_bytes(bytes: &[u8], path: &Path, device: &Device) -> Result<Self> {
        let (network, config, provenance) = checkpoint::load_bytes(bytes, path, device)?;
        let fingerprint = checkpoint::fingerprint(bytes);
        Ok(Self {
            network,
            config,
            provenance,
            fingerprint,
            refinement: 0,
            detail: 1,
            device: device.clone(),
        }
        .with_precision(Precision::Bf16))
    }

    /// The model with this precision of matrix operands where our CPU kernels run (bf16 after loading).
    #[must_use]
    pub fn with_precision(mut self, precision: Precision) -> Self {
        self.network = self.network.with_precision(precision).packed();
        self
    }

    /// The model with photographs and pictures `times` as large, each way, as what tokens see of them: detail comes from the
    /// photographs by geometry, light from the tokens. For models with `reprojection`.
    ///
    /// # Errors
    /// For other models, unless `times` is 1; and beyond 16.
    pub fn with_detail(mut self, times: usize) -> Result<Self> {
        if !(1..=reprojection::FINEST).contains(&times) {
            let expected = format!("expected 1 to {}, found {times}", reprojection::FINEST);
            return Err(lumi_core::Error::value("detail", expected).into());
        }
        if times > 1 && !self.config.reprojection {
            let text =
                "detail: expected 1, since this model's decoder is not given the photographs";
            return Err(Error::Unsupported(text.into()));
        }
        self.detail = times;
        Ok(self)
    }

    /// What [`Self::with_detail`] may be asked for with a scene's views: as far as the smallest one goes, up to 4; 1 for models that
    /// take none.
    #[must_use]
    pub fn detail_of(&self, scene: &lumi_core::Scene) -> usize {
        if !self.config.reprojection {
            return 1;
        }
        let sides = scene.views.iter();
        let sides = sides.map(|v| v.camera.width.min(v.camera.height));
        let smallest = sides.min().unwrap_or_default();
        (smallest / self.config.resolution).clamp(1, DETAIL)
    }

    /// As [`Self::with_detail`] says; else 1.
    #[must_use]
    pub fn detail(&self) -> usize {
        self.detail
    }

    /// Side of the pictures that it is made for, in pixels.
    #[must_use]
    pub fn side(&self) -> usize {
        self.config.resolution * self.detail
    }

    /// Scene tokens of posed photographs: 1 to 32 views of one size, a multiple of the patch (and of [`Self::with_detail`]).
    /// `to_model` maps the world so that the scene lies in the unit ball. Models with the authors' lights go on from
    /// there to a frame of their own, which the input cameras decide.
    ///
    /// # Errors
    /// On no or too many views, a view without image, differing or unfit sizes, and bad cameras, by view.
    pub fn encode(&self, views: &[View], to_model: Similarity) -> Result<SceneTokens> {
        if views.is_empty() || views.len() > 32 {
            let expected = format!("expected 1 to 32 input views, found {}", views.len());
            return Err(lumi_core::Error::value("inputs", expected).into());
        }
        let mut posed: Vec<(DisplayImage, Camera)> = Vec::new();
        for view in views {
            let named = |e: lumi_core::Error| e.within(format!("view `{}`", view.name));
            view.camera.validate().map_err(named)?;
            self.check_size(&view.camera).map_err(named)?;
            let Some(image) = &view.image else {
                return Err(
                    named(lumi_core::Error::value("image", "expected a photograph")).into(),
                );
            };
            let size = (image.width, image.height);
            if size != (view.camera.width, view.camera.height)
                || posed
                    .first()
                    .is_some_and(|(first, _)| size != (first.width, first.height))
            {
                let expected = "expected all input images and their cameras to have one size";
                return Err(named(lumi_core::Error::value("image", expected)).into());
            }
            posed.push((image.clone(), view.camera));
        }
        let (to_model, authors) = match self.config.lights {
            LightConfig::Rays { .. } => (to_model, None),
            LightConfig::Authors { .. } => {
                let cameras: Vec<_> = posed.iter().map(|(_, camera)| *camera).collect();
                let frame = AuthorsFrame::new(&cameras, &to_model)?;
                (frame.to_model(), Some(frame))
            }
        };
        for (_, camera) in &mut posed {
            *camera = camera.transformed(&to_model);
        }
        let fine = self
            .config
            .reprojection
            .then(|| Reprojection::new(posed.iter().map(|(image, camera)| (image, camera))));
        for (image, camera) in &mut posed {
            let (w, h) = (camera.width / self.detail, camera.height / self.detail);
            (*image, *camera) = (image.resized(w, h), camera.resized(w, h));
        }
        let views: Vec<Camera> = posed.iter().map(|(_, camera)| *camera).collect();
        let photographs = fine.map(|fine| Photographs::new(fine, &views));
        let coarse = photographs.as_ref().map(|p| &*p.coarse);
        let input = batch::posed_views(&posed, coarse, &self.config, &self.device);
        let mut scene = self.network.encode(input, &views, &self.config);
        let mut history = vec![format!("encode {} views", views.len())];
        if self.refinement > 0 {
            scene = self.refined(scene, &posed);
            history.push(format!("refine {} steps", self.refinement));
        }
        let frame = SceneFrame {
            to_model,
            authors,
            views: if self.config.anchors {
                views
            } else {
                Vec::new()
            },
            exposure: Exposure::default(),
        };
        Ok(self.captured(scene, frame, photographs, history))
    }

    /// A capture's tokens before any edit.
    pub(crate) fn captured(
        &self,
        scene: Scene,
        frame: SceneFrame,
        photographs: Option<Photographs>,
        history: Vec<String>,
    ) -> SceneTokens {
        SceneTokens {
            scene: scene.clone(),
            illumination: Illumination::CAPTURED,
            lights: Arc::default(),
            captured: Arc::new(Captured {
                frame,
                scene,
                photographs,
            }),
            model: self.fingerprint.clone(),
            history,
            prepared: Arc::default(),
        }
    }

    /// Where the tokens of a frame's views are, for models with `anchors`.
    pub(crate) fn places(&self, frame: &SceneFrame) -> Option<Arc<Places>> {
        let kept: &[Camera] = if self.config.view_tokens {
            &frame.views
        } else {
            &[]
        };
        let places = || Places::new(1, self.config.scene_tokens, kept, self.config.patch);
        self.config.anchors.then(|| Arc::new(places()))
    }

    /// Scene tokens under other light.
    ///
    /// # Errors
    /// If the model was not trained for the mode, a light is invalid, or there is none.
    pub fn edit(&self, scene: &SceneTokens, edit: &Edit) -> Result<SceneTokens> {
        self.check_tokens(scene)?;
        let modes = self.config.lights.modes();
        if !modes.contains(&edit.mode) {
            let expected = format!(
                "this model was trained for {modes:?} edits, not {:?}",
                edit.mode
            );
            return Err(Error::Unsupported(expected));
        }
        if edit.lights.is_empty() {
            return Err(lumi_core::Error::value("edit", "expected at least one light").into());
        }
        let (light, illumination, rays) = self.light(scene, edit)?;
        let from = match edit.mode {
            Mode::Set if !edit.chained => &scene.captured.scene,
            _ => &scene.scene,
        };
        let mut edited = self.network.edit(from, light, &self.config);
        let adds = modes.contains(&Mode::Add) && self.config.output == Output::Radiance;
        if edit.mode == Mode::Remove && adds {
            edited = self.removed(edited, from, &rays, illumination)?;
        }
        let known = match self.config.direct {
            true => illumination::known_rays(&scene.lights, edit.mode, &rays),
            false => Vec::new(),
        };
        let mut history = scene.history.clone();
        history.push(edit.describe());
        Ok(SceneTokens {
            scene: edited,
            illumination,
            lights: known.into(),
            history,
            prepared: Arc::default(),
            ..scene.clone()
        })
    }

    /// What a light's removal from `before` leaves, corrected until adding the light again leads back there: an edit that adds a
    /// share w of the light changes tokens by w·Δ at most, so it is undone by fixed-point iteration, as a residual layer is
    /// (Behrmann et al., Invertible residual networks, 2019). What the editor makes of the removal by itself is where it begins.
    fn removed(
        &self,
        removed: Scene,
        before: &Scene,
        rays: &[LightRay],
        left: Illumination,
    ) -> Result<Scene> {
        let (shape, _) = LightShape::new(rays, Mode::Add, left)?;
        let light = self.network.shaped_light(&[shape], Mode::Add)?;
        let (mut best, mut next, mut least) = (removed.clone(), removed, f32::INFINITY);
        for _ in 0..=CORRECTIONS {
            let again = self.network.edit(&next, light.clone(), &self.config);
            let off = before.channels.clone() - again.channels;
            // Where hardly anything is left it may lead away.
            let apart = off.clone().square().mean().into_scalar::<f32>();
            if apart.is_nan() || apart >= least {
                break;
            }
            (best, least) = (next.clone(), apart);
            next.channels = next.channels + off;
        }
        Ok(best)
    }

    /// What the editor is told of an edit's light, the illumination after it, and, for models with `output = "radiance"`, its
    /// rays.
    fn light(
        &self,
        scene: &SceneTokens,
        edit: &Edit,
    ) -> Result<(EditLight, Illumination, Vec<LightRay>)> {
        let frame = scene.frame();
        if let (LightTokenizer::Authors(tokenizer), Some(authors)) =
            (&self.network.lights, &frame.authors)
        {
            // Only the place of a light in the unit ball's space says whether it is a sensible one.
            let to_unit_ball = authors.unit_ball();
            for light in &edit.lights {
                light.transformed(&to_unit_ball).validate()?;
            }
            let lights = &self.config.lights;
            let tokens = tokenizer.tokens(&edit.lights, authors, lights, &self.device)?;
            return Ok((tokens.into(), scene.illumination, Vec::new()));
        }
        let moved = edit.lights.iter().map(|l| l.transformed(&frame.to_model));
        let moved: Vec<Light> = moved.collect();
        for light in &moved {
            light.validate()?;
        }
        let pattern = self.config.lights.pattern();
        match self.config.output {
            Output::Display => {
                let features = lights::ray_batch(&[moved], &pattern, &self.device);
                let light = self.network.light_tokens(features, edit.mode)?;
                Ok((light, scene.illumination, Vec::new()))
            }
            Output::Radiance => {
                let rays = moved.iter().flat_map(|l| l.rays(&pattern));
                let rays: Vec<_> = rays.map(|ray| ray.scaled(frame.exposure.0)).collect();
                let (shape, change) = LightShape::new(&rays, edit.mode, scene.illumination)?;
                let light = self.network.shaped_light(&[shape], edit.mode)?;
                Ok((light, change.after, rays))
            }
        }
    }

    /// The scene seen from world-space cameras of one size, a multiple of the patch: display-encoded images over white.
    ///
    /// With a `one-way` decoder the first call keeps the scene's keys and values beside the tokens (and in their
    /// clones), which later calls reuse: about `4·K·d` bytes per decoder block in bf16, freed with the tokens or by
    /// [`SceneTokens::forget_prepared`].
    ///
    /// # Errors
    /// On bad cameras and unfit sizes.
    pub fn render(&self, scene: &SceneTokens, cameras: &[Camera]) -> Result<Vec<DisplayImage>> {
        let show = |views: Tensor<5>| match self.config.output {
            Output::Display => batch::to_images(views),
            Output::Radiance => radiance::to_linear(views, scene.illumination)
                .iter()
                .map(LinearImage::to_display)
                .collect(),
        };
        self.seen(scene, cameras, show)
    }

    /// The scene's radiance seen from world-space cameras as in [`Self::render`], with alpha, and beyond white.
    ///
    /// # Errors
    /// As [`Self::render`], and for models that make display-encoded pictures only.
    pub fn render_radiance(
        &self,
        scene: &SceneTokens,
        cameras: &[Camera],
    ) -> Result<Vec<LinearImage>> {
        if self.config.output != Output::Radiance {
            let text = "this model makes display-encoded pictures, no radiance";
            return Err(Error::Unsupported(text.into()));
        }
        self.seen(scene, cameras, |views| {
            radiance::to_linear(views, scene.illumination)
        })
    }

    fn seen<T>(
        &self,
        scene: &SceneTokens,
        cameras: &[Camera],
        show: impl Fn(Tensor<5>) -> Vec<T>,
    ) -> Result<Vec<T>> {
        self.check_tokens(scene)?;
        for (i, camera) in cameras.iter().enumerate() {
            let named = |e: lumi_core::Error| e.within(format!("camera {i}"));
            camera.validate().map_err(named)?;
            self.check_size(camera).map_err(named)?;
            if (camera.width, camera.height) != (cameras[0].width, cameras[0].height) {
                let expected = "expected cameras of one size in one call";
                return Err(named(lumi_core::Error::value("size", expected)).into());
            }
        }
        let moved = cameras.iter().map(|c| c.transformed(scene.to_model()));
        let moved: Vec<Camera> = moved.collect();
        let prepared = {
            let mut kept = scene
                .prepared
                .lock()
                .unwrap_or_else(PoisonError::into_inner);
            let make = || Arc::new(self.network.prepare(&scene.scene, &self.config));
            Arc::clone(kept.get_or_insert_with(make))
        };
        let mut images = Vec::with_capacity(cameras.len());
        for chunk in moved.chunks(VIEWS_AT_ONCE) {
            images.extend(show(self.views(&prepared, scene, chunk)));
        }
        Ok(images)
    }

    /// Returns when all that was begun is done: some devices only queue it. For those who take times.
    ///
    /// # Errors
    /// If the device has failed.
    pub fn wait(&self) -> Result<()> {
        let failed = |e| Error::Failed(format!("the device has failed: {e}"));
        self.device.sync().map_err(failed)
    }

    fn check_size(&self, camera: &Camera) -> lumi_core::Result<()> {
        let p = self.config.patch * self.detail;
        if camera.width.is_multiple_of(p) && camera.height.is_multiple_of(p) {
            return Ok(());
        }
        let (w, h) = (camera.width, camera.height);
        let expected = format!("expected sides that are multiples of {p} pixels, found {w}×{h}");
        Err(lumi_core::Error::value("size", expected))
    }

    pub(crate) fn check_tokens(&self, scene: &SceneTokens) -> Result<()> {
        self.check_maker(&scene.model)
    }

    /// Tokens mean something to the weights that made them alone.
    pub(crate) fn check_maker(&self, made: &str) -> Result<()> {
        let here = &self.fingerprint;
        if made == here {
            return Ok(());
        }
        Err(Error::Unsupported(format!(
            "these scene tokens were made by model {made}; this is model {here}, to which they mean nothing"
        )))
    }
}
