//! The authors' encodings of light, turned back into lights.

use glam::{Mat3, Mat4, Vec3};
use lumi_core::image::read_display;
use lumi_core::light::authors::{POWER_RANGE, RayRow};
use lumi_core::{Area, EnvMap, Environment, Error, Light, NamedLight, Point, Result};
use std::path::Path;
use std::sync::Arc;

/// Rows to which a map is averaged; the authors' code stores up to 4096.
const MAP_ROWS: usize = 256;

/// Display values of the low-range picture that pin the scale: not black, not clipped.
const MID: std::ops::Range<f32> = 0.2..0.9;

/// The environment that a frame's two pictures show, for the camera `pose` (OpenCV camera-to-world).
pub(super) fn environment(name: &str, ldr: &Path, hdr: &Path, pose: &Mat4) -> Result<NamedLight> {
    let (low, high) = (read_display(ldr)?, read_display(hdr)?);
    if (low.width, low.height) != (high.width, high.height) {
        let expected = format!(
            "expected {}×{} pixels as its _ldr, found {}×{}",
            low.width, low.height, high.width, high.height
        );
        return Err(Error::invalid(hdr, "size", expected));
    }
    let scale = brightest(low.pixels.as_flattened(), high.pixels.as_flattened());
    let scale = scale.ok_or_else(|| {
        let expected = "expected mid-grey pixels, which tell the map's absolute scale";
        Error::invalid(ldr, "pixels", expected)
    })?;
    let map = EnvMap {
        width: high.width,
        height: high.height,
        pixels: high
            .pixels
            .iter()
            .map(|p| p.map(|h| (h * scale).exp_m1() / 10.0))
            .collect(),
    };
    map.validate().map_err(|e| e.at(hdr))?;
    // A camera-aligned map's +x is the camera's right, its +y the way it looks, its +z the camera's up.
    let axes = Mat3::from_mat4(*pose);
    Ok(NamedLight {
        name: name.to_owned(),
        light: Light::Environment(Environment::oriented(
            Arc::new(map.at_most(MAP_ROWS).into_owned()),
            Mat3::from_cols(axes.x_axis, axes.z_axis, -axes.y_axis),
            [1.0; 3],
        )),
    })
}

/// log1p(10 · the largest radiance): the median over pixels that both pictures resolve.
fn brightest(low: &[f32], high: &[f32]) -> Option<f32> {
    let pairs = low.iter().zip(high);
    let resolved = pairs.filter(|(l, h)| MID.contains(*l) && **h > 0.02);
    // Both encodings truncate, so the true values lie half a step higher on average.
    let half = 0.5 / 255.0;
    let mut scales: Vec<f32> = resolved
        .map(|(l, h)| (10.0 * (l + half).powf(2.2)).ln_1p() / (h + half))
        .collect();
    let middle = scales.len() / 2;
    (!scales.is_empty()).then(|| *scales.select_nth_unstable_by(middle, f32::total_cmp).1)
}

/// The local lights that rows of light rays come from.
///
/// # Errors
/// If a number is not finite, or there are no rows.
pub(super) fn local(rows: &[RayRow]) -> Result<Vec<NamedLight>> {
    if let Some(i) = rows
        .iter()
        .position(|row| !row.iter().all(|v| v.is_finite()))
    {
        return Err(Error::value(format!("row {i}"), "expected finite numbers"));
    }
    let mut lights = Vec::new();
    // Rows of one light follow each other and share intensity and colour; a point's share their origin.
    for same in rows.chunk_by(|a, b| a[..4] == b[..4]) {
        let points: Vec<&[RayRow]> = same.chunk_by(|a, b| a[4..7] == b[4..7]).collect();
        if points.len() > 1 && points.iter().all(|run| run.len() == 1) {
            lights.push(area(same));
        } else {
            lights.extend(points.into_iter().map(|run| point(&run[0])));
        }
    }
    if lights.is_empty() {
        return Err(Error::value("rows", "expected at least one light ray"));
    }
    let named = lights.into_iter().enumerate().map(|(i, light)| NamedLight {
        name: format!("local{i}"),
        light,
    });
    Ok(named.collect())
}

fn origin(row: &RayRow) -> Vec3 {
    Vec3::new(row[4], row[5], row[6])
}

fn color(row: &RayRow) -> [f32; 3] {
    [row[1], row[2], row[3]]
}

/// Watts of an intensity; powers beyond the range were clipped to its ends.
fn power(row: &RayRow) -> f32 {
    let (low, high) = POWER_RANGE;
    low + row[0].exp_m1() / 10.0 * (high - low)
}

fn point(row: &RayRow) -> Light {
    Light::Point(Point {
        color: color(row),
        ..Point::new(origin(row), power(row))
    })
}

/// A square that faces the world's origin: its centre is the mean origin of its rays, and points spread
/// evenly over a square of side s have a summed variance of s²/6.
fn area(rows: &[RayRow]) -> Light {
    let n = rows.len() as f32;
    let centre = rows.iter().map(origin).sum::<Vec3>() / n;
    let spread = rows.iter().map(|r| (origin(r) - centre).length_squared());
    let size = (6.0 * spread.sum::<f32>() / n).sqrt();
    Light::Area(Area {
        color: color(&rows[0]),
        ..Area::facing(centre, Vec3::ZERO, size, power(&rows[0]))
    })
}
