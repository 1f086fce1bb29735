//! Lights: one class per kind over the core type. A new kind is a class here and an arm of [`to_python`].

use crate::arrays::{Images, image};
use crate::errors::{raised, warn, wrong};
use lumi_core::glam::Mat3;
use lumi_core::light::LightSpec;
use lumi_core::{EnvMap, Light as Core};
use numpy::{PyArray1, PyArray2, PyArray3, PyArrayMethods};
use pyo3::PyClass;
use pyo3::prelude::*;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// A source of light in the scene's world, in Blender's units.
///
/// Made as `Point`, `Area`, `Spot`, `Sun` or `Environment`. Wherever a light is expected, text as on the command line will do, such as
/// `"point:1,-2,3,power=800"`.
#[pyclass(frozen, eq, subclass, module = "lumitokens")]
#[derive(PartialEq)]
pub struct Light(pub Core);

#[pymethods]
impl Light {
    /// `environment`, `point`, `area`, `spot` or `sun`.
    #[getter]
    fn kind(&self) -> &'static str {
        self.0.kind()
    }

    /// The same light `gain` times as strong, one factor or one per channel.
    fn scaled(&self, py: Python<'_>, gain: Channels) -> PyResult<Py<PyAny>> {
        to_python(py, &self.0.scaled(gain.get()))
    }

    fn __repr__(&self) -> String {
        match &self.0 {
            Core::Point(l) => format!(
                "Point({}, power={}, color={:?}, radius={})",
                l.position, l.power, l.color, l.radius
            ),
            Core::Area(l) => format!(
                "Area({}, target={}, size={}, power={}, color={:?})",
                l.position, l.target, l.size, l.power, l.color
            ),
            Core::Spot(l) => format!(
                "Spot({}, target={}, angle={}, blend={}, power={}, color={:?}, radius={})",
                l.position, l.target, l.angle, l.blend, l.power, l.color, l.radius
            ),
            Core::Sun(l) => format!(
                "Sun({}, strength={}, angle={}, color={:?})",
                l.from, l.strength, l.angle, l.color
            ),
            Core::Environment(l) => format!(
                "Environment({}×{}, strength={:?})",
                l.map.width, l.map.height, l.strength
            ),
        }
    }
}

/// One factor for all channels, or one for each.
#[derive(FromPyObject)]
pub enum Channels {
    One(f32),
    Each([f32; 3]),
}

impl Channels {
    pub fn get(self) -> [f32; 3] {
        match self {
            Self::One(factor) => [factor; 3],
            Self::Each(factors) => factors,
        }
    }
}

/// A light of a kind, and what the kind's own class reads.
fn made<S: PyClass<BaseType = Light>>(light: Core, kind: S) -> PyClassInitializer<S> {
    PyClassInitializer::from(Light(light)).add_subclass(kind)
}

/// A small sphere that shines equally in all directions.
///
/// Parameters
/// ----------
/// position : (x, y, z)
///     Centre, in world units; outside the scene's bounding ball.
/// power : float
///     Watts: radiant intensity is power · color / 4π.
/// color : (r, g, b)
///     What the power is multiplied with, linear Rec. 709.
/// radius : float
///     Of the sphere; it softens shadows only.
#[pyclass(frozen, extends = Light, module = "lumitokens")]
pub struct Point(lumi_core::Point);

#[pymethods]
impl Point {
    #[new]
    #[pyo3(
        signature = (position, power = 1000.0, color = [1.0; 3], radius = 0.05),
        text_signature = "(position, power=1000.0, color=(1.0, 1.0, 1.0), radius=0.05)"
    )]
    fn new(
        position: [f32; 3],
        power: f32,
        color: [f32; 3],
        radius: f32,
    ) -> PyClassInitializer<Self> {
        let light = lumi_core::Point {
            color,
            radius,
            ..lumi_core::Point::new(position.into(), power)
        };
        made(Core::Point(light), Self(light))
    }

    /// Centre in the world.
    #[getter]
    fn position(&self) -> [f32; 3] {
        self.0.position.into()
    }

    /// Watts.
    #[getter]
    fn power(&self) -> f32 {
        self.0.power
    }

    /// What the power is multiplied with.
    #[getter]
    fn color(&self) -> [f32; 3] {
        self.0.color
    }

    /// Radius of the sphere.
    #[getter]
    fn radius(&self) -> f32 {
        self.0.radius
    }
}

/// A one-sided square that shines as a Lambertian emitter.
///
/// Parameters
/// ----------
/// position : (x, y, z)
///     Its middle, in world units; outside the scene's bounding ball.
/// target : (x, y, z)
///     The point that it faces.
/// size : float
///     Length of a side.
/// power : float
///     Watts: radiance is power · color / (π · size²).
/// color : (r, g, b)
///     What the power is multiplied with, linear Rec. 709.
#[pyclass(frozen, extends = Light, module = "lumitokens")]
pub struct Area(lumi_core::Area);

#[pymethods]
impl Area {
    #[new]
    #[pyo3(
        signature = (position, target = [0.0; 3], size = 1.0, power = 1000.0, color = [1.0; 3]),
        text_signature = "(position, target=(0.0, 0.0, 0.0), size=1.0, power=1000.0, color=(1.0, 1.0, 1.0))"
    )]
    fn new(
        position: [f32; 3],
        target: [f32; 3],
        size: f32,
        power: f32,
        color: [f32; 3],
    ) -> PyResult<PyClassInitializer<Self>> {
        elsewhere(position, target)?;
        let light = lumi_core::Area {
            color,
            ..lumi_core::Area::facing(position.into(), target.into(), size, power)
        };
        Ok(made(Core::Area(light), Self(light)))
    }

    /// Its middle, in the world.
    #[getter]
    fn position(&self) -> [f32; 3] {
        self.0.position.into()
    }

    /// Unit vector: the way it shines.
    #[getter]
    fn direction(&self) -> [f32; 3] {
        self.0.direction().into()
    }

    /// Length of a side.
    #[getter]
    fn size(&self) -> f32 {
        self.0.size
    }

    /// Watts.
    #[getter]
    fn power(&self) -> f32 {
        self.0.power
    }

    /// What the power is multiplied with.
    #[getter]
    fn color(&self) -> [f32; 3] {
        self.0.color
    }
}

/// A small sphere that shines within a cone, as Blender's spot.
///
/// Parameters
/// ----------
/// position : (x, y, z)
///     Centre, in world units; outside the scene's bounding ball.
/// target : (x, y, z)
///     The point that its axis goes to.
/// angle : float
///     Degrees from one side of the cone to the other, 1 to 180.
/// blend : float
///     How much of the cone its soft edge takes, 0 to 1.
/// power : float
///     Watts that it would have without the cone: radiant intensity on the axis is power · color / 4π.
/// color : (r, g, b)
///     What the power is multiplied with, linear Rec. 709.
/// radius : float
///     Of the sphere; it softens shadows only.
#[pyclass(frozen, extends = Light, module = "lumitokens")]
pub struct Spot(lumi_core::Spot);

#[pymethods]
impl Spot {
    #[new]
    #[pyo3(
        signature = (position, target = [0.0; 3], angle = 45.0, blend = 0.15, power = 1000.0, color = [1.0; 3], radius = 0.05),
        text_signature = "(position, target=(0.0, 0.0, 0.0), angle=45.0, blend=0.15, power=1000.0, color=(1.0, 1.0, 1.0), radius=0.05)"
    )]
    fn new(
        position: [f32; 3],
        target: [f32; 3],
        angle: f32,
        blend: f32,
        power: f32,
        color: [f32; 3],
        radius: f32,
    ) -> PyResult<PyClassInitializer<Self>> {
        elsewhere(position, target)?;
        let light = lumi_core::Spot {
            angle,
            blend,
            color,
            radius,
            ..lumi_core::Spot::facing(position.into(), target.into(), power)
        };
        Ok(made(Core::Spot(light), Self(light)))
    }

    /// Centre in the world.
    #[getter]
    fn position(&self) -> [f32; 3] {
        self.0.position.into()
    }

    /// Unit vector along its axis: the way it shines.
    #[getter]
    fn direction(&self) -> [f32; 3] {
        self.0.direction().into()
    }

    /// Degrees from one side of the cone to the other.
    #[getter]
    fn angle(&self) -> f32 {
        self.0.angle
    }

    /// How much of the cone its soft edge takes.
    #[getter]
    fn blend(&self) -> f32 {
        self.0.blend
    }

    /// Watts, without the cone.
    #[getter]
    fn power(&self) -> f32 {
        self.0.power
    }

    /// What the power is multiplied with.
    #[getter]
    fn color(&self) -> [f32; 3] {
        self.0.color
    }

    /// Radius of the sphere.
    #[getter]
    fn radius(&self) -> f32 {
        self.0.radius
    }
}

/// A distant disc of even radiance, as Blender's sun.
///
/// Parameters
/// ----------
/// toward : (x, y, z)
///     The way to it, of any length but none.
/// strength : float
///     Irradiance of a surface that faces it, W/m².
/// angle : float
///     Degrees from one side of the disc to the other, 0 to 180.
/// color : (r, g, b)
///     What the strength is multiplied with, linear Rec. 709.
#[pyclass(frozen, extends = Light, module = "lumitokens")]
pub struct Sun(lumi_core::Sun);

#[pymethods]
impl Sun {
    #[new]
    #[pyo3(
        signature = (toward, strength = 1.0, angle = 0.526, color = [1.0; 3]),
        text_signature = "(toward, strength=1.0, angle=0.526, color=(1.0, 1.0, 1.0))"
    )]
    fn new(
        toward: [f32; 3],
        strength: f32,
        angle: f32,
        color: [f32; 3],
    ) -> PyResult<PyClassInitializer<Self>> {
        if toward == [0.0; 3] {
            return Err(wrong("toward", "expected a direction, found none"));
        }
        let light = lumi_core::Sun {
            angle,
            color,
            ..lumi_core::Sun::new(toward.into(), strength)
        };
        Ok(made(Core::Sun(light), Self(light)))
    }

    /// Unit vector to its centre.
    #[getter]
    fn toward(&self) -> [f32; 3] {
        self.0.toward().into()
    }

    /// Irradiance of a surface that faces it, W/m².
    #[getter]
    fn strength(&self) -> f32 {
        self.0.strength
    }

    /// Degrees from one side of the disc to the other.
    #[getter]
    fn angle(&self) -> f32 {
        self.0.angle
    }

    /// What the strength is multiplied with.
    #[getter]
    fn color(&self) -> [f32; 3] {
        self.0.color
    }
}

/// # Errors
/// If a light's target is its own place.
fn elsewhere(position: [f32; 3], target: [f32; 3]) -> PyResult<()> {
    match position == target {
        true => Err(wrong(
            "target",
            "expected another place than the light's own",
        )),
        false => Ok(()),
    }
}

/// Distant light from all sides: a lat-long map of linear radiance. Row 0 is +z; the centre column looks along +x, the first
/// quarter's along +y.
///
/// Parameters
/// ----------
/// map : path or array (H, 2·H, 3)
///     An `.hdr` or `.exr` file (or a panorama, `.jpg` or `.png`, which ends at white), or linear radiance, which is copied.
/// rotate : float
///     Degrees about +z, counter-clockwise from above.
/// strength : float or (r, g, b)
///     Factor on the map's radiance.
#[pyclass(frozen, extends = Light, module = "lumitokens")]
pub struct Environment(lumi_core::Environment);

#[pymethods]
impl Environment {
    #[new]
    #[pyo3(
        signature = (map, rotate = 0.0, strength = Channels::One(1.0)),
        text_signature = "(map, rotate=0.0, strength=1.0)"
    )]
    fn new(
        map: &Bound<'_, PyAny>,
        rotate: f32,
        strength: Channels,
    ) -> PyResult<PyClassInitializer<Self>> {
        let (read, warnings) = match map.extract::<PathBuf>() {
            Ok(path) => EnvMap::read_with_warnings(path).map_err(raised)?,
            Err(_) => (radiance(map)?, Vec::new()),
        };
        for text in warnings {
            warn(map.py(), &text)?;
        }
        let light = lumi_core::Environment {
            map: Arc::new(read),
            rotate,
            rotation: Mat3::IDENTITY,
            strength: strength.get(),
        };
        let core = Core::Environment(light.clone());
        Ok(made(core, Self(light)))
    }

    /// Radiance, before `strength`: array (H, W, 3).
    #[getter]
    fn map<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray3<f32>>> {
        let map = &self.0.map;
        image(py, (map.height, map.width), map.pixels.clone())
    }

    /// From directions of the map to those of the world: array (3, 3).
    #[getter]
    fn rotation<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f32>>> {
        let rows = self.0.orientation().transpose().to_cols_array();
        PyArray1::from_slice(py, &rows).reshape([3, 3])
    }

    /// Factor on the map's radiance, per channel.
    #[getter]
    fn strength(&self) -> [f32; 3] {
        self.0.strength
    }
}

/// A map from an array `[h, w, 3]`.
fn radiance(values: &Bound<'_, PyAny>) -> PyResult<EnvMap> {
    let images = Images::new(values, "map")?;
    let [height, width, channels] = images.size;
    if images.stacked || channels != 3 {
        return Err(wrong("map", "expected height × width × 3"));
    }
    let pixels = images.each()?.flat_map(|map| map.as_chunks::<3>().0);
    let map = EnvMap {
        width,
        height,
        pixels: pixels.copied().collect(),
    };
    map.validate().map_err(|e| raised(e.within("map")))?;
    Ok(map)
}

/// The object of a light's own class.
///
/// # Errors
/// If the interpreter has no memory left.
pub fn to_python(py: Python<'_>, light: &Core) -> PyResult<Py<PyAny>> {
    let core = light.clone();
    Ok(match light {
        Core::Point(l) => Py::new(py, made(core, Point(*l)))?.into_any(),
        Core::Area(l) => Py::new(py, made(core, Area(*l)))?.into_any(),
        Core::Spot(l) => Py::new(py, made(core, Spot(*l)))?.into_any(),
        Core::Sun(l) => Py::new(py, made(core, Sun(*l)))?.into_any(),
        Core::Environment(l) => Py::new(py, made(core, Environment(l.clone())))?.into_any(),
    })
}

/// One light or several, as objects or text.
///
/// # Errors
/// If something is no light, by its place.
pub fn from_python(value: &Bound<'_, PyAny>) -> PyResult<Vec<Core>> {
    if let Some(light) = one(value)? {
        return Ok(vec![light]);
    }
    let mut lights = Vec::new();
    for (i, item) in value.try_iter()?.enumerate() {
        let item = item?;
        let expected = || format!("expected a light, found {}", item.get_type());
        lights.push(one(&item)?.ok_or_else(|| wrong(&format!("lights[{i}]"), expected()))?);
    }
    Ok(lights)
}

/// A light, or nothing if `value` is none.
fn one(value: &Bound<'_, PyAny>) -> PyResult<Option<Core>> {
    if let Ok(light) = value.cast::<Light>() {
        return Ok(Some(light.get().0.clone()));
    }
    let Ok(text) = value.extract::<String>() else {
        return Ok(None);
    };
    let spec: LightSpec = text.parse().map_err(|e: String| wrong("light", e))?;
    let (light, warnings) = spec.open_with_warnings(Path::new("")).map_err(raised)?;
    for text in warnings {
        warn(value.py(), &text)?;
    }
    Ok(Some(light))
}
