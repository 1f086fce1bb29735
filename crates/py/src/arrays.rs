//! Arrays in and out: float32, row-major, images as height × width × channels.

use crate::errors::wrong;
use lumi_core::{DisplayImage, LinearImage};
use numpy::{
    PyArray1, PyArray2, PyArray3, PyArrayDescrMethods, PyArrayDyn, PyArrayMethods,
    PyReadonlyArrayDyn, PyUntypedArray, PyUntypedArrayMethods,
};
use pyo3::prelude::*;

/// An array as contiguous float32, without a copy where it is that already: NumPy's own, whatever has `__dlpack__` and
/// lies in CPU memory, or nested sequences. Bytes become 0 to 1.
///
/// # Errors
/// If it holds no numbers of these kinds.
pub fn float32<'py>(
    value: &Bound<'py, PyAny>,
    name: &str,
) -> PyResult<PyReadonlyArrayDyn<'py, f32>> {
    let numpy = value.py().import("numpy")?;
    let array = if value.cast::<PyUntypedArray>().is_ok() {
        value.clone()
    } else if value.hasattr("__dlpack__")? {
        numpy.call_method1("from_dlpack", (value,))?
    } else {
        numpy.call_method1("asarray", (value,))?
    };
    let kind = array.cast::<PyUntypedArray>()?.dtype();
    let (letter, size) = (kind.kind(), kind.itemsize());
    let array = numpy.call_method1("ascontiguousarray", (array, "float32"))?;
    let array = match (letter, size) {
        (b'u', 1) => array.call_method1("__truediv__", (255.0_f32,))?,
        (b'f', _) => array,
        // Lists of whole numbers, as in poses; integer images have no known range.
        (b'i', _) if value.cast::<PyUntypedArray>().is_err() => array,
        _ => {
            let expected = format!("expected floating-point numbers or uint8, found dtype {kind}");
            return Err(wrong(name, expected));
        }
    };
    Ok(array.cast_into::<PyArrayDyn<f32>>()?.readonly())
}

/// Numbers of exactly this shape.
///
/// # Errors
/// If it has another.
pub fn exactly(value: &Bound<'_, PyAny>, name: &str, shape: &[usize]) -> PyResult<Vec<f32>> {
    let array = float32(value, name)?;
    if array.shape() != shape {
        let expected = format!("expected shape {shape:?}, found {:?}", array.shape());
        return Err(wrong(name, expected));
    }
    Ok(array.as_slice()?.to_vec())
}

/// One image or a stack of them, `[n,] h, w, 3 or 4`.
pub struct Images<'py> {
    array: PyReadonlyArrayDyn<'py, f32>,
    /// Whether it was a stack.
    pub stacked: bool,
    /// Height, width and channels of each.
    pub size: [usize; 3],
}

impl<'py> Images<'py> {
    /// # Errors
    /// If it is no array of images.
    pub fn new(value: &Bound<'py, PyAny>, name: &str) -> PyResult<Self> {
        let array = float32(value, name)?;
        let (stacked, size) = match *array.shape() {
            [h, w, c] => (false, [h, w, c]),
            [_, h, w, c] => (true, [h, w, c]),
            _ => (false, [0; 3]),
        };
        if size.contains(&0) || !(3..=4).contains(&size[2]) {
            let expected = format!(
                "expected height × width × 3 or 4, or a stack of such images, found shape {:?}",
                array.shape()
            );
            return Err(wrong(name, expected));
        }
        Ok(Self {
            array,
            stacked,
            size,
        })
    }

    /// The pixels of each image, row-major, `channels` numbers each.
    ///
    /// # Errors
    /// None for arrays that [`float32`] made.
    pub fn each(&self) -> PyResult<std::slice::ChunksExact<'_, f32>> {
        let [h, w, c] = self.size;
        Ok(self.array.as_slice()?.chunks_exact(h * w * c))
    }

    /// As radiance, premultiplied; opaque where there are three channels.
    ///
    /// # Errors
    /// As [`Self::each`].
    pub fn linear(&self) -> PyResult<Vec<LinearImage>> {
        let [height, width, channels] = self.size;
        let image = |values: &[f32]| LinearImage {
            width,
            height,
            pixels: values
                .chunks_exact(channels)
                .map(|p| [p[0], p[1], p[2], p.get(3).copied().unwrap_or(1.0)])
                .collect(),
        };
        Ok(self.each()?.map(image).collect())
    }

    /// As display-encoded pictures; a fourth channel is coverage, the colours then straight and blended over white, as in PNG files.
    ///
    /// # Errors
    /// As [`Self::each`].
    pub fn display(&self) -> PyResult<Vec<DisplayImage>> {
        let [height, width, channels] = self.size;
        let image = |values: &[f32]| {
            let pixels = values.chunks_exact(channels);
            let alpha = |p: &[f32]| p.get(3).map_or(1.0, |a| a.clamp(0.0, 1.0));
            DisplayImage {
                width,
                height,
                alpha: (channels == 4).then(|| pixels.clone().map(alpha).collect()),
                pixels: pixels
                    .map(|p| [p[0], p[1], p[2]].map(|v| v * alpha(p) + (1.0 - alpha(p))))
                    .collect(),
            }
        };
        Ok(self.each()?.map(image).collect())
    }
}

/// One image as an array `[h, w, C]`, which takes its pixels over.
///
/// # Errors
/// If there are not `height · width` pixels.
pub fn image<const C: usize>(
    py: Python<'_>,
    (height, width): (usize, usize),
    pixels: Vec<[f32; C]>,
) -> PyResult<Bound<'_, PyArray3<f32>>> {
    PyArray1::from_vec(py, pixels.into_flattened()).reshape([height, width, C])
}

/// Images of one size as an array: `[h, w, C]` of the only one, or `[n, h, w, C]` if `stacked`.
///
/// # Errors
/// If they differ in size.
pub fn images<const C: usize>(
    py: Python<'_>,
    (height, width): (usize, usize),
    mut all: Vec<Vec<[f32; C]>>,
    stacked: bool,
) -> PyResult<Bound<'_, PyAny>> {
    if !stacked && all.len() == 1 {
        return Ok(image(py, (height, width), all.remove(0))?.into_any());
    }
    let n = all.len();
    let values = all.concat().into_flattened();
    let array = PyArray1::from_vec(py, values).reshape([n, height, width, C])?;
    Ok(array.into_any())
}

/// What is shown, as an array `[h, w, 3]`.
///
/// # Errors
/// As [`image`].
pub fn shown<'py>(py: Python<'py>, picture: &DisplayImage) -> PyResult<Bound<'py, PyArray3<f32>>> {
    let size = (picture.height, picture.width);
    image(py, size, picture.pixels.clone())
}

/// Numbers as an array `[h, w]`.
///
/// # Errors
/// If there are not `height · width` of them.
pub fn matrix<'py>(
    py: Python<'py>,
    (height, width): (usize, usize),
    values: &[f32],
) -> PyResult<Bound<'py, PyArray2<f32>>> {
    PyArray1::from_slice(py, values).reshape([height, width])
}
