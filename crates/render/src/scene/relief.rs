//! Normals that relief turns: normal maps, and bumps of solid patterns.

use crate::material::{Material, NormalMap};
use lumi_core::glam::{Vec2, Vec3, Vec4};

/// Least cosine between the triangle's normal and a mirror's reflection.
const LEAST_FACING: f32 = 0.01;
/// How far bumps look to find their slope; objects have radius 1.
const STEP: f32 = 1.5e-3;
/// Steepest slope of bumps.
const STEEPEST: f32 = 1.2;

/// `normal` bent toward the triangle's just enough that a mirror there would not reflect into the triangle. One that
/// faces away from the viewer may stay, as in Cycles: it has no specular reflection then.
pub fn reflecting(normal: Vec3, geometric: Vec3, direction: Vec3) -> Vec3 {
    let view = -direction.dot(geometric);
    let least = (0.9 * view).min(LEAST_FACING);
    let fine = |n: Vec3| {
        let cosine = n.dot(direction);
        (direction - 2.0 * cosine * n).dot(geometric) >= least
    };
    if fine(normal) {
        return normal;
    }
    let (mut bad, mut good) = (0.0, 1.0);
    let mix = |t: f32| normal.lerp(geometric, t).normalize_or(geometric);
    for _ in 0..10 {
        let middle = 0.5 * (bad + good);
        if fine(mix(middle)) {
            good = middle;
        } else {
            bad = middle;
        }
    }
    mix(good)
}

/// The normal of a normal map on the outer side of the surface.
pub fn mapped(map: &NormalMap, uv: &[Vec2; 2], outside: Vec3, tangent: Vec4) -> Vec3 {
    let along = tangent.truncate();
    if along.length_squared() < 1e-8 {
        return outside;
    }
    let across = tangent.w.signum() * outside.cross(along);
    let n = map.lookup(uv);
    (n.x * along + n.y * across + n.z * outside).normalize_or(outside)
}

/// `normal` turned by the slope of the material's height. `along` tells how the pattern's point changes
/// with a step in the triangle's plane.
pub fn bumped(
    material: &Material,
    point: Vec3,
    along: impl Fn(Vec3) -> Vec3,
    normal: Vec3,
) -> Vec3 {
    let (t, b) = crate::sampling::frame(normal);
    let here = material.height(point);
    let slope = |d: Vec3| {
        let step = along(STEP * d);
        let length = step.length();
        if length > 1e-9 {
            (material.height(point + step) - here) / length
        } else {
            0.0
        }
    };
    let gradient = slope(t) * t + slope(b) * b;
    (normal - gradient.clamp_length_max(STEEPEST)).normalize_or(normal)
}
