//! Where a captured object is and how large, from cameras and silhouettes.

use glam::{DMat3, DVec3, Vec3};
use lumi_core::{Camera, Error, Result};

mod stray;

pub use stray::stray;

/// Share of the mean view's inner half-angle that an object without masks is taken to fill.
const FILL_WITHOUT_MASKS: f32 = 0.9;

/// Alpha from here on belongs to the object.
pub const MASK_THRESHOLD: f32 = 0.5;

/// A camera and, where known, the object's coverage of its pixels (row-major, `width · height`).
#[derive(Clone, Copy)]
pub struct Silhouette<'a> {
    /// The camera.
    pub camera: &'a Camera,
    /// Coverage in [0, 1].
    pub alpha: Option<&'a [f32]>,
}

/// A ball around the object, in world units.
#[derive(Clone, Debug)]
pub struct Ball {
    /// Centre.
    pub centre: Vec3,
    /// Radius.
    pub radius: f32,
    /// Views whose silhouettes contradict the others' and were left out, by index; see [`stray`].
    pub stray: Vec<usize>,
}

/// The ball around the object that cameras and silhouettes show.
///
/// * Views whose silhouettes are [`stray`] do not count.
/// * Centre: the least-squares point closest to one line per view: through the middle of the
///   silhouette's bounding box where there is a mask, else the optical axis.
/// * Radius: per view with a mask, the ball around the centre whose outline reaches the silhouette's
///   99.5th-percentile pixel (stray mask pixels do not count); of these the 90th percentile. Without any mask: the
///   ball that fills 90 % of the mean view's narrower half-angle.
/// * A silhouette that covers nothing or everything is none.
///
/// # Errors
/// If the lines are parallel (a single view, say) or the centre lies behind most cameras.
pub fn estimate(views: &[Silhouette]) -> Result<Ball> {
    let views: Vec<Silhouette> = views.iter().map(telling).collect();
    let stray = stray(&views);
    let kept = (0..views.len()).filter(|i| !stray.contains(i));
    let kept: Vec<Silhouette> = kept.map(|i| views[i]).collect();
    let (centre, radius) = enclosing(&kept)?;
    Ok(Ball {
        centre,
        radius,
        stray,
    })
}

/// The view without a silhouette that covers nothing or everything.
fn telling<'a>(view: &Silhouette<'a>) -> Silhouette<'a> {
    let covered = |a: &&f32| **a >= MASK_THRESHOLD;
    let tells = |a: &&[f32]| {
        let count = a.iter().filter(covered).count();
        count > 0 && count < a.len()
    };
    Silhouette {
        camera: view.camera,
        alpha: view.alpha.filter(tells),
    }
}

/// Centre and radius, every view counted.
fn enclosing(views: &[Silhouette]) -> Result<(Vec3, f32)> {
    let lines: Vec<(Vec3, Vec3)> = views.iter().map(line).collect();
    let centre = closest_point(&lines)?;
    let distance = |v: &Silhouette| v.camera.centre().distance(centre);
    let mut radii: Vec<f32> = views
        .iter()
        .filter_map(|v| outline_radius(v, centre))
        .collect();
    let radius = if radii.is_empty() {
        let framed = |v: &Silhouette| distance(v) * FILL_WITHOUT_MASKS * half_angle(v.camera).sin();
        views.iter().map(framed).sum::<f32>() / views.len() as f32
    } else {
        percentile(&mut radii, 0.9)
    };
    if radius > 0.0 && radius.is_finite() {
        Ok((centre, radius))
    } else {
        let expected = "expected masks or cameras that enclose an object; give bounding_sphere_center and bounding_sphere_radius";
        Err(Error::value("bounding sphere", expected))
    }
}

/// The point with the smallest sum of squared distances to the lines (origin, unit direction).
fn closest_point(lines: &[(Vec3, Vec3)]) -> Result<Vec3> {
    let (mut a, mut b) = (DMat3::ZERO, DVec3::ZERO);
    for (origin, direction) in lines {
        let d = direction.as_dvec3();
        let across = DMat3::IDENTITY - DMat3::from_cols(d * d.x, d * d.y, d * d.z);
        a += across;
        b += across * origin.as_dvec3();
    }
    // For n lines the determinant is at most (2n/3)³; parallel lines give zero.
    let n = lines.len() as f64;
    if a.determinant() < 1e-6 * n * n * n {
        let expected = "expected at least two views from different sides; give bounding_sphere_center and bounding_sphere_radius";
        return Err(Error::value("bounding sphere", expected));
    }
    let point = (a.inverse() * b).as_vec3();
    let behind = lines
        .iter()
        .filter(|(o, d)| (point - *o).dot(*d) <= 0.0)
        .count();
    if 2 * behind > lines.len() {
        let expected = format!(
            "expected cameras that look at a common point, found it behind {behind} of {}",
            lines.len()
        );
        return Err(Error::value("bounding sphere", expected));
    }
    Ok(point)
}

/// The line of sight to the middle of the silhouette, or the optical axis.
fn line(view: &Silhouette) -> (Vec3, Vec3) {
    let camera = view.camera;
    let inside = view
        .alpha
        .map(|a| object_pixels(camera, a))
        .filter(|p| !p.is_empty());
    let direction = inside.map_or(camera.forward(), |pixels| {
        let bounds = pixels
            .iter()
            .fold((f32::MAX, f32::MIN, f32::MAX, f32::MIN), |b, &(x, y)| {
                (b.0.min(x), b.1.max(x), b.2.min(y), b.3.max(y))
            });
        camera.direction(0.5 * (bounds.0 + bounds.1), 0.5 * (bounds.2 + bounds.3))
    });
    (camera.centre(), direction)
}

/// Radius of the ball around `centre` whose outline reaches the silhouette's far pixels.
fn outline_radius(view: &Silhouette, centre: Vec3) -> Option<f32> {
    let to_centre = centre - view.camera.centre();
    let mut reach: Vec<f32> = object_pixels(view.camera, view.alpha?)
        .into_iter()
        .map(|(x, y)| view.camera.direction(x, y).cross(to_centre).length())
        .collect();
    (!reach.is_empty()).then(|| percentile(&mut reach, 0.995))
}

/// Centres of the pixels that belong to the object.
pub(crate) fn object_pixels(camera: &Camera, alpha: &[f32]) -> Vec<(f32, f32)> {
    let covered = alpha
        .iter()
        .enumerate()
        .filter(|(_, a)| **a >= MASK_THRESHOLD);
    covered
        .map(|(i, _)| {
            (
                (i % camera.width) as f32 + 0.5,
                (i / camera.width) as f32 + 0.5,
            )
        })
        .collect()
}

/// Half of the narrower field of view, in radians.
fn half_angle(camera: &Camera) -> f32 {
    let tangent = (camera.width as f32 / camera.fx).min(camera.height as f32 / camera.fy);
    (0.5 * tangent).atan()
}

/// The value below which `share` of the values lie; sorts them.
pub(crate) fn percentile(values: &mut [f32], share: f32) -> f32 {
    values.sort_by(f32::total_cmp);
    let last = values.len().saturating_sub(1);
    values[(share * last as f32).round() as usize]
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A ball of radius 0.5 at (0.3, −0.2, 0.1), seen by cameras that look past it.
    fn silhouette(camera: &Camera) -> Vec<f32> {
        let to = Vec3::new(0.3, -0.2, 0.1) - camera.centre();
        let hit = |d: Vec3| f32::from(u8::from(d.cross(to).length() < 0.5));
        camera.directions().into_iter().map(hit).collect()
    }

    #[test]
    fn finds_a_ball_that_is_off_centre() {
        let cameras: Vec<_> = (0..8)
            .map(|i| Camera::orbit(i as f32, 0.2 + 0.1 * i as f32, 4.0, 0.8, 64))
            .collect();
        let masks: Vec<_> = cameras.iter().map(silhouette).collect();
        let views: Vec<_> = cameras
            .iter()
            .zip(&masks)
            .map(|(camera, alpha)| Silhouette {
                camera,
                alpha: Some(alpha),
            })
            .collect();
        let Ball { centre, radius, .. } = estimate(&views).expect("enclosed");
        assert!(
            centre.distance(Vec3::new(0.3, -0.2, 0.1)) < 0.02,
            "{centre}"
        );
        assert!((radius - 0.5).abs() < 0.04, "{radius}");
    }

    #[test]
    fn without_masks_takes_the_look_at_point() {
        let cameras: Vec<_> = (0..5)
            .map(|i| Camera::orbit(i as f32, 0.4, 4.0, 0.8, 64))
            .collect();
        let views: Vec<_> = cameras
            .iter()
            .map(|camera| Silhouette {
                camera,
                alpha: None,
            })
            .collect();
        let Ball { centre, radius, .. } = estimate(&views).expect("enclosed");
        assert!(centre.length() < 1e-4);
        assert!((radius - 0.9 * 4.0 * 0.4_f32.sin()).abs() < 1e-3);
        let error = estimate(&views[..1]).expect_err("one view").to_string();
        assert!(error.contains("two views"), "{error}");
    }
}
