//! Scene tokens on disk: tokens, model fingerprint, frame and edit history in one safetensors file.

use crate::checkpoint::{LazyTensor, read_all};
use crate::config::LightConfig;
use crate::exposure::Exposure;
use crate::illumination::Illumination;
use crate::network::Scene;
use crate::relighter::{Photographs, SceneFrame};
use crate::{Error, Relighter, Result, SceneTokens};
use burn::tensor::{Tensor, TensorData};
use lumi_core::Reprojection;
use lumi_core::light::LightRay;
use safetensors::tensor::{Dtype, TensorView};
use serde::{Deserialize, Serialize};
use std::collections::HashMap;
use std::path::Path;
use std::sync::Arc;

/// Version of the layout.
const FORMAT: &str = "lumitokens-scene-2";

/// Key of the header in the file's metadata.
const HEADER_KEY: &str = "lumitokens.scene";

/// What stands in the metadata, as JSON.
#[derive(Serialize, Deserialize)]
struct Header {
    format: String,
    model: String,
    history: Vec<String>,
    illumination: Illumination,
    #[serde(default)]
    lights: Vec<LightRay>,
    frame: SceneFrame,
}

impl Relighter {
    /// The numbers of scene tokens, `[K, d]` row-major, for files that hold several of them.
    #[must_use]
    pub fn token_values(&self, scene: &SceneTokens) -> Vec<f32> {
        crate::params::to_vec(scene.scene.channels.clone())
    }

    /// The tokens of a capture before any edit, from the numbers that [`Self::token_values`] gave, the frame that they live
    /// in, and for models with `reprojection` the photographs ([`Reprojection::values`]).
    ///
    /// # Errors
    /// If their count fits no scene of this model in such a frame, or one is not finite, and if photographs are missing or of
    /// other sizes than the frame's views.
    pub fn captured_from_values(
        &self,
        values: Vec<f32>,
        frame: SceneFrame,
        photographs: Option<&[f32]>,
        history: Vec<String>,
    ) -> Result<SceneTokens> {
        self.check_frame(&frame)?;
        if photographs.is_some() != self.config.reprojection {
            let expected = "expected them exactly for models with `reprojection`";
            return Err(lumi_core::Error::value("photographs", expected).into());
        }
        let photographs = photographs
            .map(|values| Reprojection::from_values(values, &frame.views))
            .transpose()?
            .map(|fine| Photographs::new(fine, &frame.views));
        let scene = Scene {
            channels: self.tokens_of(values)?,
            places: self.places(&frame),
        };
        let k = scene.channels.dims()[1];
        if let Some(places) = &scene.places
            && places.tokens() != k
        {
            let expected = places.tokens();
            let expected = format!("expected the {expected} tokens of their views, found {k}");
            return Err(lumi_core::Error::value("tokens", expected).into());
        }
        Ok(self.captured(scene, frame, photographs, history))
    }

    /// Tokens of `capture` after edits, from their numbers and [`SceneTokens::lights`].
    ///
    /// # Errors
    /// If they are not as many as the capture's, or one is not finite, and if the illumination is not finite or negative, or a ray is
    /// not finite.
    pub fn edited_from_values(
        &self,
        capture: &SceneTokens,
        values: Vec<f32>,
        illumination: Illumination,
        lights: Vec<LightRay>,
        history: Vec<String>,
    ) -> Result<SceneTokens> {
        let channels = self.tokens_of(values)?;
        let [found, expected] = [&channels, &capture.scene.channels].map(|t| t.dims()[1]);
        if found != expected {
            let expected = format!("expected {expected} tokens, as the capture has, found {found}");
            return Err(lumi_core::Error::value("tokens", expected).into());
        }
        if illumination.0.iter().any(|g| !(g.is_finite() && *g >= 0.0)) {
            let expected = "expected three finite numbers that are not negative";
            return Err(lumi_core::Error::value("illumination", expected).into());
        }
        let finite = |ray: &LightRay| {
            let place = ray.origin.is_none_or(|place| place.is_finite());
            place && ray.direction.is_finite() && ray.irradiance.iter().all(|e| e.is_finite())
        };
        if let Some(i) = lights.iter().position(|ray| !finite(ray)) {
            let field = format!("lights[{i}]");
            return Err(lumi_core::Error::value(field, "expected finite numbers").into());
        }
        Ok(SceneTokens {
            scene: Scene {
                channels,
                places: capture.scene.places.clone(),
            },
            illumination,
            lights: lights.into(),
            history,
            prepared: Arc::default(),
            ..capture.clone()
        })
    }

    fn tokens_of(&self, values: Vec<f32>) -> Result<Tensor<3>> {
        let d = self.config.dim;
        let k = values.len() / d;
        if values.len() != k * d || values.iter().any(|v| !v.is_finite()) {
            let found = values.len();
            let expected = format!("expected finite numbers, {d} per token, found {found} numbers");
            return Err(lumi_core::Error::value("tokens", expected).into());
        }
        self.config.check_scene(k)?;
        Ok(Tensor::from_data(
            TensorData::new(values, [1, k, d]),
            &self.device,
        ))
    }

    /// Only models with the authors' lights have a frame of their own, of 1 to 32 input views, and only models with anchors
    /// know their views.
    fn check_frame(&self, frame: &SceneFrame) -> lumi_core::Result<()> {
        let authors = frame.authors.as_ref();
        let placed = authors.is_some_and(|f| (1..=32).contains(&f.cameras.len()));
        if placed != matches!(self.config.lights, LightConfig::Authors { .. }) {
            let expected =
                "expected the frame of the input views exactly for models with the authors' lights";
            return Err(lumi_core::Error::value("authors", expected));
        }
        if (1..=32).contains(&frame.views.len()) != self.config.anchors {
            let expected = "expected 1 to 32 cameras exactly for models with `anchors`";
            return Err(lumi_core::Error::value("views", expected));
        }
        let Exposure(exposure) = frame.exposure;
        if exposure.iter().any(|e| !(e.is_finite() && *e >= 0.0)) {
            let expected = "expected three finite numbers that are not negative";
            return Err(lumi_core::Error::value("exposure", expected));
        }
        let p = self.config.patch;
        for (i, camera) in frame.views.iter().enumerate() {
            let named = |e: lumi_core::Error| e.within(format!("views[{i}]"));
            camera.validate().map_err(named)?;
            let size = (camera.width, camera.height);
            let first = (frame.views[0].width, frame.views[0].height);
            if size != first || !size.0.is_multiple_of(p) || !size.1.is_multiple_of(p) {
                let expected = format!("expected one size for all, a multiple of {p}");
                return Err(named(lumi_core::Error::value("size", expected)));
            }
        }
        Ok(())
    }

    /// Writes scene tokens; atomic.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn save_tokens(&self, scene: &SceneTokens, path: &Path) -> Result<()> {
        let header = Header {
            format: FORMAT.to_owned(),
            model: scene.model.clone(),
            history: scene.history.clone(),
            illumination: scene.illumination,
            lights: scene.lights.to_vec(),
            frame: scene.frame().clone(),
        };
        let header = serde_json::to_string(&header)
            .map_err(|e| Error::weights(path, "(metadata)", e.to_string()))?;
        let metadata = HashMap::from([(HEADER_KEY.to_owned(), header)]);
        let failed =
            |e: safetensors::SafeTensorError| Error::weights(path, "tokens", e.to_string());
        let parts = [
            ("tokens", &scene.scene),
            ("captured", &scene.captured.scene),
        ];
        let bytes =
            |values: Vec<f32>| -> Vec<u8> { values.iter().flat_map(|v| v.to_le_bytes()).collect() };
        let parts = parts.map(|(name, scene)| {
            let values = crate::params::to_vec(scene.channels.clone());
            (name, scene.channels.dims().to_vec(), bytes(values))
        });
        let photographs = scene.photographs().map(|photographs| {
            let values = photographs.values();
            ("photographs", vec![values.len() / 4, 4], bytes(values))
        });
        let parts: Vec<_> = parts.into_iter().chain(photographs).collect();
        let views = parts.iter().map(|(name, shape, bytes)| {
            Ok((*name, TensorView::new(Dtype::F32, shape.clone(), bytes)?))
        });
        let views = views
            .collect::<std::result::Result<Vec<_>, _>>()
            .map_err(failed)?;
        let file = safetensors::serialize(views, Some(metadata)).map_err(failed)?;
        lumi_core::fs::atomic_write(path, &file)?;
        Ok(())
    }

    /// Reads scene tokens that this model made.
    ///
    /// # Errors
    /// If the file is malformed, or another model made it.
    pub fn load_tokens(&self, path: &Path) -> Result<SceneTokens> {
        let bytes = lumi_core::fs::read_bytes(path)?;
        let wrong =
            |what: &str, e: &dyn std::fmt::Display| Error::weights(path, what, e.to_string());
        let (_, header) = safetensors::SafeTensors::read_metadata(&bytes)
            .map_err(|e| wrong("(header)", &format!("expected a scene tokens file: {e}")))?;
        let text = header
            .metadata()
            .as_ref()
            .and_then(|entries| entries.get(HEADER_KEY))
            .ok_or_else(|| wrong("(metadata)", &format!("expected `{HEADER_KEY}`")))?;
        let Header {
            format,
            model,
            history,
            illumination,
            lights,
            frame,
        } = serde_json::from_str(text).map_err(|e| wrong(HEADER_KEY, &e))?;
        if format != FORMAT {
            let expected = format!("expected format {FORMAT}, found {format}");
            return Err(wrong("(metadata)", &expected));
        }
        self.check_maker(&model)?;
        let tensors = read_all(&bytes, path)?;
        let d = self.config.dim;
        let values = |name: &str| -> Result<Vec<f32>> {
            let tensor = tensors.get(name).ok_or_else(|| wrong(name, &"missing"))?;
            if !matches!(*tensor.shape(), [1, _, width] if width == d) {
                let expected = format!("expected shape [1, K, {d}], found {:?}", tensor.shape());
                return Err(wrong(name, &expected));
            }
            tensor.read()
        };
        let captured = values("captured")?;
        let photographs = match tensors.get("photographs") {
            Some(tensor) => Some(tensor.read()?),
            None => None,
        };
        let capture = self
            .captured_from_values(captured, frame, photographs.as_deref(), Vec::new())
            .map_err(|e| wrong("captured", &e))?;
        self.edited_from_values(&capture, values("tokens")?, illumination, lights, history)
            .map_err(|e| wrong("tokens", &e))
    }
}
