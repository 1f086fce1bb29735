//! The model: encode, edit, render.

use crate::arrays::{float32, images, matrix};
use crate::camera::cameras;
use crate::errors::{raised, warn, wrong};
use crate::lights::from_python;
use crate::scene::Scene;
use crate::tokens::{MadeBy, SceneTokens};
use crate::work;
use anyhow::Context;
use lumi_cli::device::DeviceName;
use lumi_cli::edits::Step;
use lumi_cli::{assets, groups};
use lumi_core::{Light, Progress, Role};
use lumi_data::{Lighting, input_light, spread_inputs};
use lumi_model::config::Output;
use lumi_model::{Edit, Mode, Precision, Relighter};
use numpy::{PyArray2, PyUntypedArrayMethods};
use pyo3::Borrowed;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::collections::BTreeMap;
use std::path::PathBuf;

/// A trained model. It holds no scene; `SceneTokens` do.
///
/// Made by `load`.
#[pyclass(frozen, module = "lumitokens")]
pub struct Model(pub Relighter);

/// Loads a model.
///
/// Parameters
/// ----------
/// path : path, optional
///     A weights file; the bundled model if left out.
/// device : str
///     `cpu`, or a GPU that the package is built for, as `vulkan` or `vulkan:1`.
/// precision : {"bf16", "f32"}
///     Of matrix products' operands on the CPU; sums are in float32 either way.
#[pyfunction]
#[pyo3(signature = (path = None, *, device = "cpu", precision = "bf16"))]
pub fn load(
    py: Python<'_>,
    path: Option<PathBuf>,
    device: &str,
    precision: &str,
) -> PyResult<Model> {
    lumi_kernels::Cpu::from_env().map_err(|e| wrong("LUMI_CPU", e))?;
    let device: DeviceName = device.parse().map_err(|e: String| wrong("device", e))?;
    let precision = match precision {
        "bf16" => Precision::Bf16,
        "f32" => Precision::F32,
        _ => return Err(wrong("precision", "expected bf16 or f32")),
    };
    let model = work::run(py, move |_| assets::model(path.as_deref(), &device))?;
    Ok(Model(model.with_precision(precision)))
}

/// The light that photographs were taken in, as `encode` is told of it.
enum Captured {
    /// What the scene says, if it says so and the model takes it.
    Known,
    Unknown,
    Lights(Vec<Light>),
}

#[pymethods]
impl Model {
    /// Encodes a scene's input views.
    ///
    /// Parameters
    /// ----------
    /// scene : Scene
    /// inputs : int
    ///     How many views, evenly spread over those there are: 1 to 32. 8, or all of fewer, if left out.
    /// source : dict of str to float, optional
    ///     For scenes rendered one light at a time: the light of the inputs, gains by name. The first environment if left out.
    /// captured_light : "known", None, or lights
    ///     The light that the photographs were taken in, which tells how bright the object is in itself. "known": what the
    ///     scene says, if it does.
    /// detail : int, optional
    ///     How many times as large as the model's own the pictures are, each way; as far as the photographs go, up to 4, if left
    ///     out.
    /// refine : int
    ///     Steps in which the tokens are fitted to the inputs.
    ///
    /// Returns
    /// -------
    /// SceneTokens
    #[pyo3(
        signature = (scene, *, inputs = None, source = None, captured_light = Captured::Known, detail = None, refine = 0),
        text_signature = "($self, scene, *, inputs=None, source=None, captured_light='known', detail=None, refine=0)"
    )]
    #[allow(clippy::too_many_arguments)] // Each has a name and a usual value.
    fn encode(
        &self,
        py: Python<'_>,
        scene: &Scene,
        inputs: Option<usize>,
        source: Option<BTreeMap<String, f32>>,
        captured_light: Captured,
        detail: Option<usize>,
        refine: usize,
    ) -> PyResult<SceneTokens> {
        let scene = scene.scene.clone();
        let detail = detail.unwrap_or_else(|| self.0.detail_of(&scene));
        let model = self.0.clone().with_refinement(refine);
        let model = model.with_detail(detail).map_err(raised)?;
        let there = scene.with_role(Role::Input).len();
        if let Some(wanted) = inputs.filter(|n| *n > there) {
            let expected =
                format!("expected at most {there}, the scene's input views, found {wanted}");
            return Err(wrong("inputs", expected));
        }
        let (tokens, warning) = work::run(py, move |_| {
            let source = source.map(Lighting::from_iter);
            let views = spread_inputs(
                &scene,
                inputs.unwrap_or(INPUTS),
                source.as_ref(),
                model.side(),
            )?;
            let tokens = model.encode(&views, scene.to_model)?;
            let (lights, insisted) = match captured_light {
                Captured::Unknown => (None, false),
                Captured::Lights(lights) => (Some(lights), true),
                Captured::Known if model.takes_captured_light() => {
                    (input_light(&scene, source.as_ref())?, false)
                }
                Captured::Known => (None, false),
            };
            let Some(lights) = lights else {
                return Ok((tokens, None));
            };
            match model.with_captured_light(&tokens, &lights) {
                Ok(told) => Ok((told, None)),
                Err(e) if !insisted => Ok((tokens, Some(e))),
                Err(e) => Err(e).context("captured_light"),
            }
        })?;
        if let Some(e) = warning {
            warn(py, &format!("the captured light is left out: {e}"))?;
        }
        let made_by = Some((tokens.clone(), Vec::new()));
        Ok(self.made(tokens, detail, made_by))
    }

    /// The scene under other light. What is given is done in this order: set, remove, add, scale.
    ///
    /// Parameters
    /// ----------
    /// tokens : SceneTokens
    /// set : light or sequence of lights, optional
    ///     Replaces all light.
    /// remove : light or sequence of lights, optional
    ///     Takes lights away, as they were set or added.
    /// add : light or sequence of lights, optional
    ///     Adds lights.
    /// scale : float, optional
    ///     Makes all light so far that many times as strong; exact.
    /// chained : bool
    ///     Whether `set` goes on from the edited tokens, as the paper's progressive edits do, instead of the captured ones.
    ///
    /// Returns
    /// -------
    /// SceneTokens
    #[pyo3(signature = (tokens, *, set = None, remove = None, add = None, scale = None, chained = false))]
    #[allow(clippy::too_many_arguments)] // Each has a name and a usual value.
    fn edit(
        &self,
        py: Python<'_>,
        tokens: &SceneTokens,
        set: Option<Bound<'_, PyAny>>,
        remove: Option<Bound<'_, PyAny>>,
        add: Option<Bound<'_, PyAny>>,
        scale: Option<f64>,
        chained: bool,
    ) -> PyResult<SceneTokens> {
        let mut steps = Vec::new();
        for (mode, lights) in [(Mode::Set, set), (Mode::Remove, remove), (Mode::Add, add)] {
            if let Some(lights) = lights {
                let edit = Edit::new(mode, from_python(&lights)?);
                steps.push(Step::from(Edit { chained, ..edit }));
            }
        }
        if let Some(factor) = scale {
            if !(factor.is_finite() && factor >= 0.0) {
                let expected = format!("expected a number that is not negative, found {factor}");
                return Err(wrong("scale", expected));
            }
            steps.push(Step::Scale(factor));
        }
        if steps.is_empty() {
            return Err(wrong("edit", "expected set, remove, add or scale"));
        }
        let made_by = tokens.made_by.clone().map(|(captured, mut all)| {
            all.extend(steps.iter().cloned());
            (captured, all)
        });
        let (model, from) = (self.at(tokens.detail)?, tokens.tokens.clone());
        let edited = work::run(py, move |_| {
            steps
                .iter()
                .try_fold(from, |tokens, step| step.apply(&model, &tokens))
        })?;
        Ok(self.made(edited, tokens.detail, made_by))
    }

    /// Renders the scene.
    ///
    /// Parameters
    /// ----------
    /// tokens : SceneTokens
    /// cameras : Camera or sequence of Camera
    ///     In the world, of one size whose sides are multiples of `SceneTokens.patch`; `SceneTokens.side` is what the model
    ///     is made for.
    /// display : bool
    ///     Whether pictures are display-encoded over white instead of linear.
    ///
    /// Returns
    /// -------
    /// array (H, W, 4), float32
    ///     Linear Rec. 709 radiance, premultiplied by alpha (the fourth channel), not clipped. For several cameras
    ///     (N, H, W, 4). With `display`, sRGB values from 0 to 1: (H, W, 3) or (N, H, W, 3).
    #[pyo3(signature = (tokens, cameras, *, display = false))]
    fn render<'py>(
        &self,
        py: Python<'py>,
        tokens: &SceneTokens,
        cameras: &Bound<'py, PyAny>,
        display: bool,
    ) -> PyResult<Bound<'py, PyAny>> {
        let (cameras, several) = self::cameras(cameras)?;
        let size = (cameras[0].height, cameras[0].width);
        let model = self.at(tokens.detail)?;
        let from = tokens.tokens.clone();
        if display {
            let seen = work::run(py, move |stop| {
                in_parts(&cameras, stop, |part| model.render(&from, part))
            })?;
            let pixels = seen.into_iter().map(|image| image.pixels).collect();
            return images(py, size, pixels, several);
        }
        let seen = work::run(py, move |stop| {
            in_parts(&cameras, stop, |part| model.render_radiance(&from, part))
        })?;
        let pixels = seen.into_iter().map(|image| image.pixels).collect();
        images(py, size, pixels, several)
    }

    /// The scene under each light of the result alone; the renders add up to that of all.
    ///
    /// Parameters
    /// ----------
    /// tokens : SceneTokens
    ///     Not from a file, which does not say the lights.
    ///
    /// Returns
    /// -------
    /// dict of str to SceneTokens
    ///     By `captured`, or the light's number and kind, such as `2-point`.
    fn light_groups<'py>(
        &self,
        py: Python<'py>,
        tokens: &SceneTokens,
    ) -> PyResult<Bound<'py, PyDict>> {
        let known = tokens.made_by.clone();
        let expected = "expected tokens that encode made, since a file does not say the lights";
        let (captured, steps) = known.ok_or_else(|| wrong("tokens", expected))?;
        let model = self.at(tokens.detail)?;
        let found = work::run(py, move |_| groups::of(&model, &captured, &steps))?;
        let table = PyDict::new(py);
        for group in found {
            let alone = self.made(group.tokens().clone(), tokens.detail, None);
            table.set_item(group.name, alone)?;
        }
        Ok(table)
    }

    /// Writes scene tokens to a file, which this model alone reads back.
    fn save_tokens(&self, py: Python<'_>, tokens: &SceneTokens, path: PathBuf) -> PyResult<()> {
        let (model, tokens) = (self.0.clone(), tokens.tokens.clone());
        work::run(py, move |_| Ok(model.save_tokens(&tokens, &path)?))
    }

    /// Reads scene tokens that this model made.
    fn load_tokens(&self, py: Python<'_>, path: PathBuf) -> PyResult<SceneTokens> {
        let model = self.0.clone();
        let tokens = work::run(py, move |_| Ok(model.load_tokens(&path)?))?;
        let fine = tokens
            .photographs()
            .and_then(|p| Some(p.images().first()?.width));
        let coarse = tokens.frame().views.first().map(|camera| camera.width);
        let detail = fine.zip(coarse).map_or(1, |(fine, coarse)| fine / coarse);
        Ok(self.made(tokens, detail, None))
    }

    /// The numbers of scene tokens: array (K, d), float32.
    fn token_values<'py>(
        &self,
        py: Python<'py>,
        tokens: &SceneTokens,
    ) -> PyResult<Bound<'py, PyArray2<f32>>> {
        let (values, d) = (self.0.token_values(&tokens.tokens), self.0.config.dim);
        matrix(py, (values.len() / d, d), &values)
    }

    /// The same scene with other numbers for its tokens, for experiments: array (K, d).
    fn with_token_values(
        &self,
        tokens: &SceneTokens,
        values: &Bound<'_, PyAny>,
    ) -> PyResult<SceneTokens> {
        let array = float32(values, "values")?;
        let d = self.0.config.dim;
        if !matches!(*array.shape(), [_, width] if width == d) {
            let expected = format!("expected shape (K, {d}), found {:?}", array.shape());
            return Err(wrong("values", expected));
        }
        let (old, values) = (&tokens.tokens, array.as_slice()?.to_vec());
        let mut history = old.history.clone();
        history.push("values".to_owned());
        let (illumination, lights) = (old.illumination, old.lights().to_vec());
        let new = self
            .0
            .edited_from_values(old, values, illumination, lights, history);
        Ok(self.made(new.map_err(raised)?, tokens.detail, None))
    }

    /// Side of the pictures that tokens see, in pixels.
    #[getter]
    fn resolution(&self) -> usize {
        self.0.config.resolution
    }

    /// Fingerprint of the weights, which scene tokens carry.
    #[getter]
    fn fingerprint(&self) -> &str {
        &self.0.fingerprint
    }

    /// Where the weights come from.
    #[getter]
    fn origin(&self) -> &str {
        &self.0.provenance.origin
    }

    /// Kinds of edits that it was trained for: `set`, `add`, `remove`.
    #[getter]
    fn modes(&self) -> Vec<String> {
        let modes = self.0.config.lights.modes().iter();
        modes
            .map(|mode| format!("{mode:?}").to_lowercase())
            .collect()
    }

    /// Whether it makes linear radiance; otherwise `render` needs `display=True`.
    #[getter]
    fn makes_radiance(&self) -> bool {
        self.0.config.output == Output::Radiance
    }

    fn __repr__(&self) -> String {
        let (c, print) = (&self.0.config, &self.0.fingerprint);
        format!("Model({print}, {} px, {:?})", c.resolution, self.modes())
    }
}

/// Input views if nobody says how many.
const INPUTS: usize = 8;

/// Views between two looks at whether the caller still waits.
const PART: usize = 8;

/// `look` at some cameras at a time, until the caller gives up.
fn in_parts<T>(
    cameras: &[lumi_core::Camera],
    stop: &work::Stop,
    look: impl Fn(&[lumi_core::Camera]) -> lumi_model::Result<Vec<T>>,
) -> anyhow::Result<Vec<T>> {
    // What differs in size is told of all cameras together.
    let size = |c: &lumi_core::Camera| (c.width, c.height);
    if let Some(i) = cameras.iter().position(|c| size(c) != size(&cameras[0])) {
        let expected = "expected cameras of one size in one call";
        return Err(lumi_core::Error::value(format!("cameras[{i}]"), expected).into());
    }
    let mut seen = Vec::with_capacity(cameras.len());
    for part in cameras.chunks(PART) {
        if stop.stop() {
            anyhow::bail!("stopped before all views were rendered");
        }
        seen.extend(look(part)?);
    }
    Ok(seen)
}

impl<'py> FromPyObject<'_, 'py> for Captured {
    type Error = PyErr;

    fn extract(value: Borrowed<'_, 'py, PyAny>) -> PyResult<Self> {
        if value.is_none() {
            return Ok(Self::Unknown);
        }
        match value.extract::<String>().as_deref() {
            Ok("known") => Ok(Self::Known),
            _ => from_python(&value).map(Self::Lights),
        }
    }
}

impl Model {
    /// The model as scene tokens of this detail want it.
    fn at(&self, detail: usize) -> PyResult<Relighter> {
        self.0.clone().with_detail(detail).map_err(raised)
    }

    fn made(
        &self,
        tokens: lumi_model::SceneTokens,
        detail: usize,
        made_by: Option<MadeBy>,
    ) -> SceneTokens {
        let config = &self.0.config;
        SceneTokens {
            tokens,
            detail,
            patch: config.patch * detail,
            resolution: config.resolution,
            made_by,
        }
    }
}
