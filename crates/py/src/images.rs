//! Image files, and what a display shows of radiance.

use crate::arrays::{Images, image, images, shown};
use crate::errors::{raised, wrong};
use crate::work;
use numpy::PyArray3;
use pyo3::prelude::*;
use std::path::PathBuf;

/// What a display shows of radiance: clip(rgb / alpha), sRGB-encoded, blended over white.
///
/// Parameters
/// ----------
/// image : array (..., H, W, 4) or (..., H, W, 3), float
///     Linear Rec. 709, premultiplied; three channels are opaque. One image or a stack of them.
///
/// Returns
/// -------
/// array (..., H, W, 3), float32
///     From 0 to 1.
#[pyfunction]
pub fn to_display<'py>(image: &Bound<'py, PyAny>) -> PyResult<Bound<'py, PyAny>> {
    let given = Images::new(image, "image")?;
    let [height, width, _] = given.size;
    let shown = given.linear()?.into_iter().map(|i| i.to_display().pixels);
    images(image.py(), (height, width), shown.collect(), given.stacked)
}

/// Reads linear radiance from an OpenEXR or Radiance HDR file.
///
/// Returns
/// -------
/// array (H, W, 4), float32
///     Premultiplied by alpha, which is 1 where the file has none.
#[pyfunction]
pub fn read_linear(py: Python<'_>, path: PathBuf) -> PyResult<Bound<'_, PyArray3<f32>>> {
    let read = work::run(py, move |_| Ok(lumi_core::image::read_linear(path)?))?;
    image(py, (read.height, read.width), read.pixels)
}

/// Reads what a display shows of a picture (PNG, JPEG, OpenEXR, Radiance HDR) over white.
///
/// Returns
/// -------
/// array (H, W, 3), float32
///     sRGB values from 0 to 1.
#[pyfunction]
pub fn read_display(py: Python<'_>, path: PathBuf) -> PyResult<Bound<'_, PyArray3<f32>>> {
    let read = work::run(py, move |_| Ok(lumi_core::image::read_display(path)?))?;
    shown(py, &read)
}

/// Writes display-encoded values from 0 to 1 as an 8-bit PNG, whole or not at all.
///
/// Parameters
/// ----------
/// path : path
/// image : array (H, W, 3)
///     As `to_display` makes it.
#[pyfunction]
pub fn write_png(path: PathBuf, image: &Bound<'_, PyAny>) -> PyResult<()> {
    let given = Images::new(image, "image")?;
    if given.stacked || given.size[2] != 3 {
        let expected =
            "expected one image of height × width × 3; to_display makes such from radiance";
        return Err(wrong("image", expected));
    }
    for picture in given.display()? {
        lumi_core::image::write_png(&path, &picture).map_err(raised)?;
    }
    Ok(())
}

/// Writes linear radiance as an OpenEXR file, whole or not at all: in half floats, or in whole ones where a value lies beyond
/// their range.
///
/// Parameters
/// ----------
/// path : path
/// image : array (H, W, 4) or (H, W, 3)
///     Linear Rec. 709, premultiplied; three channels are opaque.
#[pyfunction]
pub fn write_exr(path: PathBuf, image: &Bound<'_, PyAny>) -> PyResult<()> {
    let given = Images::new(image, "image")?;
    if given.stacked {
        return Err(wrong("image", "expected one image, not a stack"));
    }
    for picture in given.linear()? {
        lumi_core::image::write_exr(&path, &picture).map_err(raised)?;
    }
    Ok(())
}
