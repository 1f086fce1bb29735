//! Scenes: captures in any format that the program reads, or made from arrays.

use crate::arrays::Images;
use crate::camera::Camera;
use crate::errors::{raised, warn, wrong};
use crate::lights::to_python;
use crate::view::View;
use crate::{json, work};
use lumi_cli::assets;
use lumi_core::glam::Vec3;
use lumi_core::{DisplayImage, Role, Similarity};
use lumi_data::formats::{self, convert};
use lumi_data::views::{photographed, square_camera};
use lumi_data::{Lighting, Orbit, check};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;

/// A capture: posed views, and what is known of its light.
///
/// Made by `open_scene`, `demo_scene` or `Scene.from_arrays`.
#[pyclass(frozen, module = "lumitokens")]
pub struct Scene {
    pub scene: Arc<lumi_core::Scene>,
    /// Where it was read from.
    pub path: Option<PathBuf>,
    /// Name of its format.
    format: &'static str,
}

/// Opens a capture in any format that `lumi` reads (see `formats`).
///
/// What the reader had to assume is warned of as `LumiWarning` and kept in `Scene.warnings`.
///
/// Parameters
/// ----------
/// path : path
///     The capture's folder, or its file where the format has one per scene.
/// full_size : bool
///     Whether photographs keep every pixel; otherwise they are reduced to 1024 along their longer side.
#[pyfunction]
#[pyo3(signature = (path, *, full_size = false))]
pub fn open_scene(py: Python<'_>, path: PathBuf, full_size: bool) -> PyResult<Scene> {
    let from = path.clone();
    let opening = match full_size {
        true => formats::Opening::FULL,
        false => formats::Opening::default(),
    };
    let (scene, format) = work::run(py, move |_| {
        let format = formats::detect(&from)?;
        Ok(((format.read)(&from, &opening)?, format.name))
    })?;
    for text in &scene.warnings {
        warn(py, text)?;
    }
    Ok(Scene {
        scene: Arc::new(scene),
        path: Some(path),
        format,
    })
}

/// The scene that comes with the package: Keenan Crane's *Spot* under one light at a time. It is unpacked into the user's data
/// folder once.
#[pyfunction]
pub fn demo_scene(py: Python<'_>) -> PyResult<Scene> {
    let folder = lumi_cli::studio_folder();
    let folder = folder.ok_or_else(|| wrong("HOME", "expected a folder for the user's data"))?;
    let path = assets::demo_scene(&folder.join("bundled")).map_err(raised)?;
    open_scene(py, path, false)
}

/// Unpacks the evaluation that comes with the package (a manifest, and the scene of `demo_scene`) into `folder`, which must not
/// be there yet, for `score` and `evaluate`; returns `folder`.
#[pyfunction]
pub fn demo_evaluation(folder: PathBuf) -> PyResult<PathBuf> {
    assets::unpack_demo(&folder).map_err(raised)?;
    Ok(folder)
}

/// The formats of scenes, by name, with what a folder of each holds.
#[pyfunction(name = "formats")]
pub fn scene_formats(py: Python<'_>) -> PyResult<Bound<'_, PyDict>> {
    let table = PyDict::new(py);
    for format in formats::FORMATS {
        table.set_item(format.name, format.holds)?;
    }
    Ok(table)
}

#[pymethods]
impl Scene {
    /// A scene of photographs in memory.
    ///
    /// Parameters
    /// ----------
    /// images : sequence of arrays (H, W, 3 or 4), or one array (N, H, W, 3 or 4)
    ///     Display-encoded (sRGB) values from 0 to 1, or uint8. A fourth channel says where the object is; colours are then
    ///     straight, as in PNG files, and shown over white. Without it results are poor unless the background is white.
    /// cameras : sequence of Camera
    ///     One per image, of its size.
    /// center : (x, y, z)
    ///     Centre of the object's bounding ball in the world.
    /// radius : float
    ///     Its radius.
    /// name : str
    ///     For people.
    #[staticmethod]
    #[pyo3(
        signature = (images, cameras, *, center = [0.0; 3], radius = 1.0, name = "arrays".to_owned()),
        text_signature = "(images, cameras, *, center=(0.0, 0.0, 0.0), radius=1.0, name='arrays')"
    )]
    fn from_arrays(
        images: &Bound<'_, PyAny>,
        cameras: &Bound<'_, PyAny>,
        center: [f32; 3],
        radius: f32,
        name: String,
    ) -> PyResult<Self> {
        let (cameras, _) = crate::camera::cameras(cameras)?;
        if !(radius.is_finite() && radius > 0.0 && center.iter().all(|v| v.is_finite())) {
            return Err(wrong(
                "radius",
                "expected a finite ball with a positive radius",
            ));
        }
        let mut pictures: Vec<DisplayImage> = Vec::new();
        for (i, item) in images.try_iter()?.enumerate() {
            pictures.extend(Images::new(&item?, &format!("images[{i}]"))?.display()?);
        }
        if pictures.len() != cameras.len() {
            let (n, found) = (cameras.len(), pictures.len());
            return Err(wrong(
                "images",
                format!("expected {n}, one per camera, found {found}"),
            ));
        }
        let views = cameras.into_iter().zip(pictures).enumerate();
        let views = views.map(|(i, (camera, picture))| {
            let sizes = [
                (picture.width, picture.height),
                (camera.width, camera.height),
            ];
            if sizes[0] != sizes[1] {
                let [(w, h), (cw, ch)] = sizes;
                let expected = format!("expected its camera's {cw}×{ch} pixels, found {w}×{h}");
                return Err(wrong(&format!("images[{i}]"), expected));
            }
            if picture.pixels.iter().flatten().any(|v| !v.is_finite()) {
                return Err(wrong(&format!("images[{i}]"), "expected finite numbers"));
            }
            Ok(lumi_core::View {
                name: format!("v{i:02}"),
                role: Role::Input,
                camera,
                image: Some(picture),
            })
        });
        let scene = lumi_core::Scene {
            name,
            views: views.collect::<PyResult<_>>()?,
            to_model: Similarity::to_unit_ball(Vec3::from(center), radius),
            basis: None,
            lit_by: Vec::new(),
            radiance: Vec::new(),
            warnings: Vec::new(),
        };
        Ok(Self {
            scene: Arc::new(scene),
            path: None,
            format: "arrays",
        })
    }

    /// The scene as if photographed under some of its own lights; for scenes rendered one light at a time.
    ///
    /// Parameters
    /// ----------
    /// lighting : dict of str to float
    ///     Gain by the light's name (see `lights`).
    fn under(&self, py: Python<'_>, lighting: BTreeMap<String, f32>) -> PyResult<Self> {
        let (scene, lighting) = (Arc::clone(&self.scene), Lighting::from_iter(lighting));
        let scene = work::run(py, move |_| Ok(photographed(&scene, &lighting)?))?;
        Ok(Self {
            scene: Arc::new(scene),
            path: None,
            format: self.format,
        })
    }

    /// Square cameras of the scene's own views.
    ///
    /// Parameters
    /// ----------
    /// which : {"targets", "inputs", "all"}
    ///     Held-out views, views for the encoder, or both.
    /// side : int
    ///     Side in pixels, such as `SceneTokens.side`.
    #[pyo3(signature = (which, *, side))]
    fn cameras(&self, which: &str, side: usize) -> PyResult<Vec<Camera>> {
        let wanted = |role: Role| match which {
            "targets" => role == Role::Target,
            "inputs" => role == Role::Input,
            _ => true,
        };
        if !["targets", "inputs", "all"].contains(&which) {
            return Err(wrong("which", "expected targets, inputs or all"));
        }
        check_side(side)?;
        let views = self.scene.views.iter().filter(|view| wanted(view.role));
        let square = |v: &lumi_core::View| Camera(square_camera(&self.scene, &v.camera, side));
        Ok(views.map(square).collect())
    }

    /// Square cameras once around the scene, at the mean distance and elevation of its own.
    ///
    /// Parameters
    /// ----------
    /// count : int
    ///     How many.
    /// side : int
    ///     Side in pixels, such as `SceneTokens.side`.
    #[pyo3(signature = (count = 24, *, side))]
    fn orbit(&self, count: usize, side: usize) -> PyResult<Vec<Camera>> {
        if !(1..=10_000).contains(&count) {
            return Err(wrong(
                "count",
                format!("expected 1 to 10000, found {count}"),
            ));
        }
        check_side(side)?;
        let cameras = Orbit::of(&self.scene).cameras(count, side, &self.scene.to_model);
        Ok(cameras.into_iter().map(Camera).collect())
    }

    /// Writes the scene in another format.
    ///
    /// Parameters
    /// ----------
    /// folder : path
    ///     Empty or not there yet, unless `overwrite`.
    /// format : {"transforms", "interchange", "authors"}
    ///     See `formats`.
    #[pyo3(signature = (folder, format = "transforms", *, overwrite = false))]
    fn write(
        &self,
        py: Python<'_>,
        folder: PathBuf,
        format: &str,
        overwrite: bool,
    ) -> PyResult<()> {
        let format = formats::named(format).map_err(raised)?;
        let write = format.write;
        let write = write.ok_or_else(|| wrong("format", "expected one that can be written"))?;
        let (scene, path) = (Arc::clone(&self.scene), self.path.clone());
        work::run(py, move |_| {
            let filled = || {
                folder
                    .read_dir()
                    .is_ok_and(|mut files| files.next().is_some())
            };
            match path {
                Some(source) => convert::check_target(&source, &folder, overwrite)?,
                None if !overwrite && filled() => {
                    let expected = "expected an empty folder, or overwrite=True";
                    return Err(lumi_core::Error::invalid(folder, "output", expected).into());
                }
                None => {}
            }
            Ok(write(&folder, &scene)?)
        })
    }

    /// Whether poses, masks and lights agree, as `lumi scene check` finds it.
    fn check<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let (scene, format) = (Arc::clone(&self.scene), self.format);
        let report = work::run(py, move |_| Ok(check::check(&scene, format)))?;
        json::to_python(py, &report)
    }

    /// Name, usually the folder's.
    #[getter]
    fn name(&self) -> &str {
        &self.scene.name
    }

    /// Where it was read from, or None.
    #[getter]
    fn path(&self) -> Option<PathBuf> {
        self.path.clone()
    }

    /// Its views.
    #[getter]
    fn views(&self) -> Vec<View> {
        let view = |index| View {
            scene: Arc::clone(&self.scene),
            index,
        };
        (0..self.scene.views.len()).map(view).collect()
    }

    /// Lights that it was rendered under one at a time, by name, in the world; empty for photographs.
    #[getter]
    fn lights<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let lights = PyDict::new(py);
        for light in self.scene.basis.iter().flat_map(|b| &b.lights) {
            lights.set_item(&light.name, to_python(py, &light.light)?)?;
        }
        Ok(lights)
    }

    /// Centre of its bounding ball in the world.
    #[getter]
    fn center(&self) -> [f32; 3] {
        self.scene.to_model.inverse().translation.into()
    }

    /// Radius of its bounding ball.
    #[getter]
    fn radius(&self) -> f32 {
        1.0 / self.scene.to_model.scale
    }

    /// What the reader assumed, left out or could not apply.
    #[getter]
    fn warnings(&self) -> Vec<String> {
        self.scene.warnings.clone()
    }

    fn __repr__(&self) -> String {
        let (name, views) = (&self.scene.name, self.scene.views.len());
        format!("Scene({name:?}, {} format, {views} views)", self.format)
    }
}

fn check_side(side: usize) -> PyResult<()> {
    let most = lumi_core::camera::MAX_SIDE;
    if (1..=most).contains(&side) {
        return Ok(());
    }
    Err(wrong(
        "side",
        format!("expected 1 to {most} pixels, found {side}"),
    ))
}
