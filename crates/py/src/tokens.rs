//! Scene tokens.

use crate::errors::wrong;
use crate::lights::Channels;
use lumi_cli::edits::Step;
use pyo3::prelude::*;

/// A capture before any edit, and the edits since.
pub type MadeBy = (lumi_model::SceneTokens, Vec<Step>);

/// A scene as a model sees it: tokens, how strongly they are lit, and the frame that they live in.
///
/// Made by `Model.encode`, `Model.edit` and `Model.load_tokens`; never changed in place.
#[pyclass(frozen, module = "lumitokens")]
pub struct SceneTokens {
    pub tokens: lumi_model::SceneTokens,
    /// Times that photographs and pictures are as large, each way, as what tokens see of them.
    pub detail: usize,
    /// Of the patches that the model cuts pictures into.
    pub patch: usize,
    pub resolution: usize,
    /// The capture and the edits since; not known of tokens from files.
    pub made_by: Option<MadeBy>,
}

#[pymethods]
impl SceneTokens {
    /// Side of square pictures that the model is made for with this scene, in pixels.
    #[getter]
    fn side(&self) -> usize {
        self.resolution * self.detail
    }

    /// What both sides of a rendered picture are multiples of, in pixels.
    #[getter]
    fn patch(&self) -> usize {
        self.patch
    }

    /// What was done, in words, oldest first.
    #[getter]
    fn history(&self) -> Vec<String> {
        self.tokens.history.clone()
    }

    /// What the decoder's radiance is multiplied with, per channel.
    #[getter]
    fn illumination(&self) -> [f64; 3] {
        self.tokens.illumination.0
    }

    /// Fingerprint of the model that made them.
    #[getter]
    fn model(&self) -> &str {
        &self.tokens.model
    }

    /// All light so far `factor` times as strong, one factor or one per channel: exact, and no network runs.
    fn scaled(&self, factor: Channels) -> PyResult<Self> {
        let factor = factor.get().map(f64::from);
        if factor.iter().any(|f| !(f.is_finite() && *f >= 0.0)) {
            return Err(wrong(
                "factor",
                "expected finite numbers that are not negative",
            ));
        }
        let equal = factor[0] == factor[1] && factor[1] == factor[2];
        let made_by = self.made_by.clone().filter(|_| equal);
        let made_by = made_by.map(|(captured, mut steps)| {
            steps.push(Step::Scale(factor[0]));
            (captured, steps)
        });
        Ok(Self {
            tokens: self.tokens.scaled(factor),
            made_by,
            ..*self
        })
    }

    fn __repr__(&self) -> String {
        let kib = self.tokens.bytes() / 1024;
        format!("SceneTokens({kib} KiB, {})", self.tokens.history.join(", "))
    }
}
