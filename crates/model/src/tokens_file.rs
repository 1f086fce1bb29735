//! Scene tokens on disk: tokens, model fingerprint, frame and edit history in one safetensors file.

use crate::checkpoint::{LazyTensor, read_all};
use crate::config::LightConfig;
use crate::lights::ReleaseFrame;
use crate::{Error, Relighter, Result, SceneTokens};
use burn::tensor::{Tensor, TensorData};
use lumi_core::Similarity;
use safetensors::tensor::{Dtype, TensorView};
use serde::{Deserialize, Serialize};
use std::collections::HashMap;
use std::path::Path;

/// Version of the layout.
const FORMAT: &str = "lumitokens-scene-1";

/// Key of the header in the file's metadata.
const HEADER_KEY: &str = "lumitokens.scene";

/// What stands in the metadata, as JSON.
#[derive(Serialize, Deserialize)]
struct Header {
    format: String,
    model: String,
    to_model: Similarity,
    history: Vec<String>,
    /// For models with the release's lights.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    release: Option<ReleaseFrame>,
}

impl Relighter {
    /// The numbers of scene tokens, `[K, w]` row-major with w = [`ModelConfig::token_width`](crate::ModelConfig::token_width), for files that hold several of them.
    #[must_use]
    pub fn token_values(&self, scene: &SceneTokens) -> Vec<f32> {
        crate::params::to_vec(scene.tokens.clone())
    }

    /// Scene tokens of this model from the numbers that [`Self::token_values`] gave and the frame that they live in:
    /// `to_model`, and [`SceneTokens::release`] of models with the release's lights.
    ///
    /// # Errors
    /// If their count fits no scene of this model or one is not finite, or `release` is not there exactly where it is needed.
    pub fn tokens_from_values(
        &self,
        values: Vec<f32>,
        to_model: Similarity,
        release: Option<ReleaseFrame>,
        history: Vec<String>,
    ) -> Result<SceneTokens> {
        self.check_frame(release.as_ref())?;
        let d = self.config.token_width();
        let k = values.len() / d;
        if values.len() != k * d || values.iter().any(|v| !v.is_finite()) {
            let found = values.len();
            let expected = format!("expected finite numbers, {d} per token, found {found} numbers");
            return Err(lumi_core::Error::value("tokens", expected).into());
        }
        self.config.check_scene(k)?;
        Ok(SceneTokens {
            tokens: Tensor::from_data(TensorData::new(values, [1, k, d]), &self.device),
            to_model,
            model: self.fingerprint.clone(),
            history,
            release,
            prepared: Default::default(),
        })
    }

    /// Only models with the release's lights have a frame of their own, of 1 to 32 input views.
    fn check_frame(&self, release: Option<&ReleaseFrame>) -> lumi_core::Result<()> {
        let placed = release.is_some_and(|f| (1..=32).contains(&f.cameras.len()));
        if placed == matches!(self.config.lights, LightConfig::Release { .. }) {
            return Ok(());
        }
        let expected =
            "expected the frame of the input views exactly for models with the release's lights";
        Err(lumi_core::Error::value("release", expected))
    }

    /// Writes scene tokens; atomic.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn save_tokens(&self, scene: &SceneTokens, path: &Path) -> Result<()> {
        let header = Header {
            format: FORMAT.to_owned(),
            model: scene.model.clone(),
            to_model: scene.to_model,
            history: scene.history.clone(),
            release: scene.release.clone(),
        };
        let header = serde_json::to_string(&header)
            .map_err(|e| Error::weights(path, "(metadata)", e.to_string()))?;
        let metadata = HashMap::from([(HEADER_KEY.to_owned(), header)]);
        let shape = scene.tokens.dims().to_vec();
        let values = crate::params::to_vec(scene.tokens.clone());
        let bytes: Vec<u8> = values.iter().flat_map(|v| v.to_le_bytes()).collect();
        let failed =
            |e: safetensors::SafeTensorError| Error::weights(path, "tokens", e.to_string());
        let view = TensorView::new(Dtype::F32, shape, &bytes).map_err(failed)?;
        let file = safetensors::serialize([("tokens", view)], Some(metadata)).map_err(failed)?;
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
            to_model,
            history,
            release,
        } = serde_json::from_str(text).map_err(|e| wrong(HEADER_KEY, &e))?;
        if format != FORMAT {
            let expected = format!("expected format {FORMAT}, found {format}");
            return Err(wrong("(metadata)", &expected));
        }
        self.check_maker(&model)?;
        let tensors = read_all(&bytes, path)?;
        let tensor = tensors
            .get("tokens")
            .ok_or_else(|| wrong("tokens", &"missing"))?;
        let d = self.config.token_width();
        if !matches!(*tensor.shape(), [1, _, width] if width == d) {
            let expected = format!("expected shape [1, K, {d}], found {:?}", tensor.shape());
            return Err(wrong("tokens", &expected));
        }
        self.tokens_from_values(tensor.read()?, to_model, release, history)
            .map_err(|e| wrong("tokens", &e))
    }
}
