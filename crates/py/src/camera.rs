//! Cameras.

use crate::arrays::exactly;
use crate::errors::{raised, wrong};
use lumi_core::camera::opengl_to_opencv;
use lumi_core::glam::{Mat4, Vec3};
use numpy::{PyArray1, PyArray2, PyArrayMethods};
use pyo3::prelude::*;

/// A pinhole camera in the scene's world, which is right-handed with z up.
///
/// Parameters
/// ----------
/// pose : array (4, 4)
///     Camera to world, a rotation and a translation.
/// fx, fy : float
///     Focal lengths in pixels.
/// cx, cy : float
///     Principal point in pixels from the left and upper edges; the centre of the first pixel is (0.5, 0.5).
/// width, height : int
///     Size in pixels. What a model renders has sides that are multiples of `SceneTokens.patch`.
/// convention : {"opencv", "opengl"}
///     The pose's axes: x right, y down, z forward; or x right, y up, z backward, as Blender and nerfstudio have them.
#[pyclass(frozen, eq, module = "lumitokens")]
#[derive(PartialEq)]
pub struct Camera(pub lumi_core::Camera);

#[pymethods]
impl Camera {
    #[new]
    #[pyo3(signature = (pose, *, fx, fy, cx, cy, width, height, convention = "opencv"))]
    #[allow(clippy::too_many_arguments)] // By name, as intrinsics are given everywhere.
    fn new(
        pose: &Bound<'_, PyAny>,
        fx: f32,
        fy: f32,
        cx: f32,
        cy: f32,
        width: usize,
        height: usize,
        convention: &str,
    ) -> PyResult<Self> {
        let rows: Vec<f32> = exactly(pose, "pose", &[4, 4])?;
        let pose = Mat4::from_cols_slice(&rows).transpose();
        let camera_to_world = match convention {
            "opencv" => pose,
            "opengl" => opengl_to_opencv(pose),
            _ => return Err(wrong("convention", "expected opencv or opengl")),
        };
        let camera = lumi_core::Camera {
            width,
            height,
            fx,
            fy,
            cx,
            cy,
            camera_to_world,
        };
        camera.validate().map_err(raised)?;
        Ok(Self(camera))
    }

    /// A camera at `eye` that looks at `target`, with square pixels and the principal point in the middle.
    ///
    /// Parameters
    /// ----------
    /// eye, target : (x, y, z)
    ///     Points of the world.
    /// fov : float
    ///     Horizontal field of view in degrees.
    /// width, height : int
    ///     Size in pixels; square if `height` is left out.
    #[staticmethod]
    #[pyo3(
        signature = (eye, target = [0.0; 3], *, fov = 50.0, width = 256, height = None),
        text_signature = "(eye, target=(0.0, 0.0, 0.0), *, fov=50.0, width=256, height=None)"
    )]
    fn look_at(
        eye: [f32; 3],
        target: [f32; 3],
        fov: f32,
        width: usize,
        height: Option<usize>,
    ) -> PyResult<Self> {
        if !(fov > 0.0 && fov < 180.0) {
            return Err(wrong(
                "fov",
                format!("expected 0 to 180 degrees, found {fov}"),
            ));
        }
        if eye == target {
            return Err(wrong("target", "expected another point than the eye"));
        }
        let (eye, target) = (Vec3::from(eye), Vec3::from(target));
        let height = height.unwrap_or(width);
        let camera = lumi_core::Camera::look_at(eye, target, fov.to_radians(), width, height);
        camera.validate().map_err(raised)?;
        Ok(Self(camera))
    }

    /// The same view at another resolution.
    fn resized(&self, width: usize, height: usize) -> PyResult<Self> {
        let camera = self.0.resized(width, height);
        camera.validate().map_err(raised)?;
        Ok(Self(camera))
    }

    /// Camera to world, OpenCV axes: array (4, 4).
    #[getter]
    fn pose<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f32>>> {
        let rows = self.0.camera_to_world.transpose().to_cols_array();
        PyArray1::from_slice(py, &rows).reshape([4, 4])
    }

    /// Intrinsics in pixels: array (3, 3).
    #[getter]
    fn intrinsics<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f32>>> {
        let c = &self.0;
        let rows = [c.fx, 0.0, c.cx, 0.0, c.fy, c.cy, 0.0, 0.0, 1.0];
        PyArray1::from_slice(py, &rows).reshape([3, 3])
    }

    /// Centre of projection in the world.
    #[getter]
    fn centre(&self) -> [f32; 3] {
        self.0.centre().into()
    }

    /// Width in pixels.
    #[getter]
    fn width(&self) -> usize {
        self.0.width
    }

    /// Height in pixels.
    #[getter]
    fn height(&self) -> usize {
        self.0.height
    }

    fn __repr__(&self) -> String {
        let (c, [x, y, z]) = (&self.0, self.centre());
        format!(
            "Camera({}×{}, at ({x:.3}, {y:.3}, {z:.3}), fx={:.1}, fy={:.1})",
            c.width, c.height, c.fx, c.fy
        )
    }
}

/// One camera or several, and whether it was several.
///
/// # Errors
/// If it is anything else, or none.
pub fn cameras(value: &Bound<'_, PyAny>) -> PyResult<(Vec<lumi_core::Camera>, bool)> {
    if let Ok(one) = value.cast::<Camera>() {
        return Ok((vec![one.get().0], false));
    }
    let mut all = Vec::new();
    for item in value.try_iter()? {
        all.push(item?.cast::<Camera>()?.get().0);
    }
    if all.is_empty() {
        return Err(wrong("cameras", "expected at least one"));
    }
    Ok((all, true))
}
