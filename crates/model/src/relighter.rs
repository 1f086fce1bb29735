//! The façade: encode, edit, render. The command line, evaluation and every other user go through it.

use crate::batch;
use crate::checkpoint::{self, Provenance};
use crate::config::LightConfig;
pub use crate::config::Mode;
use crate::lights::{self, LightTokenizer, ReleaseFrame};
use crate::network::Prepared;
use crate::{Error, ModelConfig, Network, Result};
use burn::tensor::{Device, Tensor};
use lumi_core::{Camera, DisplayImage, Light, Similarity, View};
use lumi_kernels::Precision;
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};

/// A model ready to use.
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
    pub(crate) device: Device,
}

/// A change of light.
#[derive(Clone, Debug)]
pub struct Edit {
    /// What happens to the light that is there.
    pub mode: Mode,
    /// The lights, in the scene's world space.
    pub lights: Vec<Light>,
}

/// A scene as a model sees it: K tokens and the frame they live in.
#[derive(Clone, Debug)]
pub struct SceneTokens {
    /// `[1, K, w]`, w = [`ModelConfig::token_width`]
    pub(crate) tokens: Tensor<3>,
    /// World to model space.
    pub to_model: Similarity,
    /// Fingerprint of the model that made them.
    pub model: String,
    /// What was done, in words, oldest first.
    pub history: Vec<String>,
    /// For models with the release's lights: where those stand.
    pub release: Option<ReleaseFrame>,
    /// What the decoder makes of the tokens alone, from the first render on.
    pub(crate) prepared: Arc<Mutex<Option<Arc<Prepared>>>>,
}

impl SceneTokens {
    /// Memory that the tokens take, apart from what [`Relighter::render`] keeps beside them.
    #[must_use]
    pub fn bytes(&self) -> usize {
        size_of::<f32>() * self.tokens.dims().iter().product::<usize>()
    }

    /// Gives back the memory that [`Relighter::render`] has filled beside these tokens and their clones; the next
    /// render fills it again. For those who keep many tokens and look at few.
    pub fn forget_prepared(&self) {
        let mut kept = self.prepared.lock().unwrap_or_else(PoisonError::into_inner);
        *kept = None;
    }
}

/// Views that are rendered at a time, which bounds memory.
pub(crate) const VIEWS_AT_ONCE: usize = 8;

impl Edit {
    /// Replaces all light.
    pub fn set(lights: impl Into<Vec<Light>>) -> Self {
        Self {
            mode: Mode::Set,
            lights: lights.into(),
        }
    }

    /// Adds lights.
    pub fn add(lights: impl Into<Vec<Light>>) -> Self {
        Self {
            mode: Mode::Add,
            lights: lights.into(),
        }
    }

    /// Takes lights away.
    pub fn remove(lights: impl Into<Vec<Light>>) -> Self {
        Self {
            mode: Mode::Remove,
            lights: lights.into(),
        }
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

    /// Scene tokens of posed photographs: 1 to 32 views of one size, a multiple of the patch.
    /// `to_model` maps the world so that the scene lies in the unit ball. Models with the release's lights go on from
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
        let (to_model, release) = match self.config.lights {
            LightConfig::Rays { .. } => (to_model, None),
            LightConfig::Release { .. } => {
                let cameras: Vec<_> = posed.iter().map(|(_, camera)| *camera).collect();
                let frame = ReleaseFrame::new(&cameras, &to_model)?;
                (frame.to_model(), Some(frame))
            }
        };
        for (_, camera) in &mut posed {
            *camera = camera.transformed(&to_model);
        }
        let input = batch::posed_views(&posed, self.config.rays, &self.device);
        let mut tokens = self.network.encode(input, &self.config);
        let mut history = vec![format!("encode {} views", views.len())];
        if self.refinement > 0 {
            tokens = self.refined(tokens, &posed);
            history.push(format!("refine {} steps", self.refinement));
        }
        Ok(SceneTokens {
            tokens,
            to_model,
            model: self.fingerprint.clone(),
            history,
            release,
            prepared: Arc::default(),
        })
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
        let light = match (&self.network.lights, &scene.release) {
            (LightTokenizer::Release(tokenizer), Some(frame)) => {
                // Only the place of a light in the unit ball's space says whether it is a sensible one.
                let to_unit_ball = frame.unit_ball();
                for light in &edit.lights {
                    light.transformed(&to_unit_ball).validate()?;
                }
                tokenizer
                    .tokens(&edit.lights, frame, &self.config.lights, &self.device)?
                    .into()
            }
            _ => {
                let moved = edit.lights.iter().map(|l| l.transformed(&scene.to_model));
                let moved: Vec<Light> = moved.collect();
                for light in &moved {
                    light.validate()?;
                }
                let pattern = self.config.lights.pattern();
                let features = lights::ray_batch(&[moved], &pattern, &self.device);
                self.network.light_tokens(features, edit.mode)?
            }
        };
        let tokens = self.network.edit(scene.tokens.clone(), light);
        let mut history = scene.history.clone();
        history.push(edit.describe());
        Ok(SceneTokens {
            tokens,
            history,
            prepared: Arc::default(),
            ..scene.clone()
        })
    }

    /// The scene seen from world-space cameras of one size, a multiple of the patch: display-encoded images over white.
    ///
    /// With a `cached` decoder the first call keeps the scene's keys and values beside the tokens (and in their
    /// clones), which later calls reuse: about `4·K·d` bytes per decoder block in bf16, freed with the tokens or by
    /// [`SceneTokens::forget_prepared`].
    ///
    /// # Errors
    /// On bad cameras and unfit sizes.
    pub fn render(&self, scene: &SceneTokens, cameras: &[Camera]) -> Result<Vec<DisplayImage>> {
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
        let moved: Vec<Camera> = cameras
            .iter()
            .map(|c| c.transformed(&scene.to_model))
            .collect();
        let prepared = {
            let mut kept = scene
                .prepared
                .lock()
                .unwrap_or_else(PoisonError::into_inner);
            let make = || Arc::new(self.network.prepare(scene.tokens.clone(), &self.config));
            Arc::clone(kept.get_or_insert_with(make))
        };
        let mut images = Vec::with_capacity(cameras.len());
        for chunk in moved.chunks(VIEWS_AT_ONCE) {
            images.extend(batch::to_images(self.views(&prepared, chunk)));
        }
        Ok(images)
    }

    /// Returns when all that was begun is done: some devices only queue it. For those who take times.
    ///
    /// # Errors
    /// If the device has failed.
    pub fn wait(&self) -> Result<()> {
        let failed = |e| Error::Unsupported(format!("the device has failed: {e}"));
        self.device.sync().map_err(failed)
    }

    fn check_size(&self, camera: &Camera) -> lumi_core::Result<()> {
        let p = self.config.patch;
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
