//! The authors' own encodings of light, for their checkpoints: camera-aligned, tone-mapped
//! environment images and light-ray rows.
//!
//! They are reproduced as they are, losses included: environments keep neither absolute scale nor
//! `strength`, and local lights carry a clipped, logarithmic power without any fall-off.

use super::{Area, EnvMap, Light, Point, fibonacci_sphere};
use crate::{Error, Result};
use glam::{Mat3, Vec3};
use std::f32::consts::PI;

/// Height and width of the environment images that the released networks take.
pub const ENVIRONMENT_SIZE: (usize, usize) = (256, 512);

/// Light rays per light set in the authors' files; a network is given 1024 of them.
pub const RAYS: usize = 8192;

/// Radius of the sphere, around the world's origin, that light rays aim at.
pub const SPHERE_RADIUS: f32 = 3.0;

/// Power range in watts that the intensity column resolves.
pub const POWER_RANGE: (f32, f32) = (10.0, 1500.0);

/// A light ray as the authors store it: `[intensity, r, g, b, ox, oy, oz, dx, dy, dz]`.
pub type RayRow = [f32; 10];

/// Two 8-bit encodings of one camera-aligned environment; divide by 255 for the network.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct EnvironmentImages {
    /// Width in pixels.
    pub width: usize,
    /// Height in pixels.
    pub height: usize,
    /// `255 · clip(L, 0, 1)^(1/2.2)`, row-major.
    pub ldr: Vec<[u8; 3]>,
    /// `255 · log1p(10 L) / max log1p(10 L)`, the maximum over this one image and its channels.
    pub hdr: Vec<[u8; 3]>,
}

/// Directions in the **camera's** OpenCV axes of an environment image's pixels, row-major: row 0 is
/// the camera's up, columns run left (0), forward (¼), right (½), backward (¾).
#[must_use]
pub fn camera_directions(height: usize, width: usize) -> Vec<Vec3> {
    grid(height, width)
        .map(|d| Vec3::new(d.x, -d.z, d.y))
        .collect()
}

/// World directions of an environment image's pixels for a camera with this rotation (the `env_dir` input).
#[must_use]
pub fn world_directions(camera_rotation: Mat3, height: usize, width: usize) -> Vec<Vec3> {
    let directions = camera_directions(height, width);
    directions
        .into_iter()
        .map(|d| camera_rotation * d)
        .collect()
}

/// `map` turned by `rotation_z` radians and seen from a camera, as linear radiance of the map's own size.
///
/// As in the authors' code the turn is by whole columns (truncated), and sampling takes the first and last
/// pixel centres for the edges of the sphere, so that it is off by up to half a pixel and does not
/// wrap around.
#[must_use]
pub fn align(map: &EnvMap, rotation_z: f32, camera_rotation: Mat3) -> EnvMap {
    let (w, h) = (map.width, map.height);
    let shift = (f64::from(rotation_z).to_degrees() / 360.0 * w as f64).trunc() as isize;
    let at = |x: usize, y: usize| {
        map.pixels[y * w + (x as isize - shift).rem_euclid(w as isize) as usize]
    };
    let sample = |d: Vec3| {
        let row = d.z.clamp(-1.0, 1.0).acos() / PI * (h - 1) as f32;
        let column = (1.0 - d.y.atan2(d.x) / PI) / 2.0 * (w - 1) as f32;
        let (x, y) = (column.floor(), row.floor());
        let (tx, ty) = (column - x, row - y);
        let (x0, y0) = ((x as usize).min(w - 1), (y as usize).min(h - 1));
        let (x1, y1) = ((x0 + 1).min(w - 1), (y0 + 1).min(h - 1));
        let (a, b, c, e) = (at(x0, y0), at(x1, y0), at(x0, y1), at(x1, y1));
        std::array::from_fn(|k| {
            (a[k] * (1.0 - tx) + b[k] * tx) * (1.0 - ty) + (c[k] * (1.0 - tx) + e[k] * tx) * ty
        })
    };
    EnvMap {
        width: w,
        height: h,
        pixels: world_directions(camera_rotation, h, w)
            .into_iter()
            .map(sample)
            .collect(),
    }
}

/// Both 8-bit encodings of a camera-aligned map. A black map stays black.
#[must_use]
pub fn encode(aligned: &EnvMap) -> EnvironmentImages {
    let log = |v: f32| (10.0 * v).ln_1p();
    let brightest = aligned
        .pixels
        .iter()
        .flatten()
        .fold(0.0_f32, |m, &v| m.max(log(v)));
    let byte = |v: f32| (255.0 * v).floor() as u8;
    EnvironmentImages {
        width: aligned.width,
        height: aligned.height,
        ldr: aligned
            .pixels
            .iter()
            .map(|p| p.map(|v| byte(v.clamp(0.0, 1.0).powf(1.0 / 2.2))))
            .collect(),
        hdr: aligned
            .pixels
            .iter()
            .map(|p| p.map(|v| byte(log(v) / brightest.max(f32::MIN_POSITIVE))))
            .collect(),
    }
}

/// The intensity column: `log1p(10 t)` with the power's place `t` in [`POWER_RANGE`], clipped.
#[must_use]
pub fn intensity(power: f32) -> f32 {
    let (low, high) = POWER_RANGE;
    (10.0 * (power.clamp(low, high) - low) / (high - low)).ln_1p()
}

/// `count` rays of a point light, all from its centre.
#[must_use]
pub fn point_rays(light: &Point, count: usize) -> Vec<RayRow> {
    let targets = fibonacci_sphere(count);
    let ray = |s: &Vec3| row(light.power, light.color, light.position, *s);
    targets.iter().map(ray).collect()
}

/// Rays of an area light, one per sample; samples are in [−½, ½]² of the square (the authors draw
/// them at random). The square faces the origin, whichever way the light is turned.
#[must_use]
pub fn area_rays(light: &Area, samples: &[[f32; 2]]) -> Vec<RayRow> {
    let square = Area::facing(light.position, Vec3::ZERO, light.size, light.power);
    let targets = fibonacci_sphere(samples.len());
    let [side, other] = square.sides();
    let ray = |(&[u, v], s): (&[f32; 2], &Vec3)| {
        let offset = u * side + v * other;
        row(
            light.power,
            light.color,
            light.position + light.size * offset,
            *s,
        )
    };
    samples.iter().zip(&targets).map(ray).collect()
}

/// `count` rays of several local lights, points before areas, shared out by power. `samples` gives the
/// place on the square of an area light's i-th ray out of n.
///
/// # Errors
/// If there is no local light, or another kind among them: environments go through [`align`], and spots and suns the authors'
/// networks do not know.
pub fn rays(
    lights: &[Light],
    count: usize,
    mut samples: impl FnMut(usize, usize) -> [f32; 2],
) -> Result<Vec<RayRow>> {
    let power = |light: &Light| match light {
        Light::Point(l) => Ok(l.power),
        Light::Area(l) => Ok(l.power),
        Light::Environment(_) | Light::Spot(_) | Light::Sun(_) => {
            let expected = format!(
                "expected point and area lights only, found {}",
                light.kind()
            );
            Err(Error::value("lights", expected))
        }
    };
    let mut sorted: Vec<&Light> = lights.iter().collect();
    sorted.sort_by_key(|l| matches!(l, Light::Area(_)));
    let powers = sorted
        .iter()
        .map(|l| power(l))
        .collect::<Result<Vec<f32>>>()?;
    let rows = sorted
        .iter()
        .zip(shares(&powers, count)?)
        .flat_map(|(light, n)| match light {
            Light::Point(l) => point_rays(l, n),
            Light::Area(l) => area_rays(l, &(0..n).map(|i| samples(i, n)).collect::<Vec<_>>()),
            Light::Environment(_) | Light::Spot(_) | Light::Sun(_) => Vec::new(),
        });
    Ok(rows.collect())
}

/// How many of `count` rays each light gets: at least one, in proportion to its (unclipped) power; the
/// first takes what rounding leaves.
fn shares(powers: &[f32], count: usize) -> Result<Vec<usize>> {
    let total: f64 = powers.iter().map(|p| f64::from(*p)).sum();
    let share = |p: &f32| {
        (count as f64 * f64::from(*p) / total)
            .round_ties_even()
            .max(1.0) as usize
    };
    let mut counts: Vec<usize> = powers.iter().map(share).collect();
    let others: usize = counts.iter().skip(1).sum();
    match counts.first_mut() {
        Some(first) if others < count => {
            *first = count - others;
            Ok(counts)
        }
        _ => {
            let expected = format!(
                "expected 1 to {count} lights for {count} rays, found {}",
                powers.len()
            );
            Err(Error::value("lights", expected))
        }
    }
}

/// A ray from `origin` toward the point `target` of the unit sphere, scaled to [`SPHERE_RADIUS`].
fn row(power: f32, color: [f32; 3], origin: Vec3, target: Vec3) -> RayRow {
    let d = (SPHERE_RADIUS * target - origin).normalize();
    let [r, g, b] = color;
    [
        intensity(power),
        r,
        g,
        b,
        origin.x,
        origin.y,
        origin.z,
        d.x,
        d.y,
        d.z,
    ]
}

/// Directions of a lat-long grid's pixel centres, z up: row 0 is up, azimuth falls from π.
fn grid(height: usize, width: usize) -> impl Iterator<Item = Vec3> {
    (0..height * width).map(move |i| {
        let u = ((i % width) as f32 + 0.5) / width as f32;
        let v = ((i / width) as f32 + 0.5) / height as f32;
        EnvMap::direction(u, v)
    })
}
