//! Views of scenes.

use crate::arrays::{image, matrix, shown};
use crate::camera::Camera;
use lumi_core::Role;
use numpy::{PyArray2, PyArray3};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::sync::Arc;

/// A view of a scene: a posed photograph, or only a pose.
#[pyclass(frozen, module = "lumitokens")]
pub struct View {
    pub scene: Arc<lumi_core::Scene>,
    pub index: usize,
}

impl View {
    fn view(&self) -> &lumi_core::View {
        &self.scene.views[self.index]
    }
}

#[pymethods]
impl View {
    /// Name, such as `v03`.
    #[getter]
    fn name(&self) -> &str {
        &self.view().name
    }

    /// `input`, for the encoder, or `target`, held out.
    #[getter]
    fn role(&self) -> &'static str {
        match self.view().role {
            Role::Input => "input",
            Role::Target => "target",
        }
    }

    /// Its camera in the world.
    #[getter]
    fn camera(&self) -> Camera {
        Camera(self.view().camera)
    }

    /// The photograph: array (H, W, 3) of display-encoded values over white, or None for a pose alone.
    #[getter]
    fn image<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyArray3<f32>>>> {
        let image = self.view().image.as_ref();
        image.map(|image| shown(py, image)).transpose()
    }

    /// How much of each pixel the object covers: array (H, W), or None where that is not known.
    #[getter]
    fn alpha<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyArray2<f32>>>> {
        let image = self.view().image.as_ref();
        let known = image.and_then(|image| Some((image, image.alpha.as_ref()?)));
        known
            .map(|(image, alpha)| matrix(py, (image.height, image.width), alpha))
            .transpose()
    }

    /// Linear radiance under each of the scene's lights alone, by name: arrays (H, W, 4), premultiplied. Empty for
    /// photographs.
    #[getter]
    fn radiance<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let all = PyDict::new(py);
        if let Some(basis) = &self.scene.basis {
            for (light, views) in basis.lights.iter().zip(&basis.radiance) {
                let seen = &views[self.index];
                let size = (seen.height, seen.width);
                all.set_item(&light.name, image(py, size, seen.pixels.clone())?)?;
            }
        }
        Ok(all)
    }

    fn __repr__(&self) -> String {
        let camera = self.view().camera;
        let (name, role) = (self.name(), self.role());
        format!("View({name:?}, {role}, {}×{})", camera.width, camera.height)
    }
}
