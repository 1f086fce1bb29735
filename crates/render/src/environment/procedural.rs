//! Skies, studios, rooms and nights made of formulas, with the dynamic range of real ones.

use crate::draw::Draw;
use crate::noise::fractal;
use lumi_core::glam::Vec3;
use lumi_core::{EnvMap, Seed};
use std::f32::consts::TAU;

const ROWS: usize = 128;

/// A random map, 256 × 128. Its mean radiance is 0.15 to 1.5, as that of photographed maps at strength 1.
#[must_use]
pub fn procedural(seed: Seed) -> EnvMap {
    let mut draw = Draw::new(seed, "environment");
    let kind = draw.unit();
    let field: Box<dyn Fn(Vec3) -> Vec3> = if kind < 0.3 {
        sky(&mut draw)
    } else if kind < 0.4 {
        overcast(&mut draw)
    } else if kind < 0.65 {
        studio(&mut draw)
    } else if kind < 0.85 {
        room(&mut draw)
    } else {
        night(&mut draw)
    };
    let mean = draw.log_range(0.15, 1.5);
    let mut pixels = Vec::with_capacity(2 * ROWS * ROWS);
    for y in 0..ROWS {
        for x in 0..2 * ROWS {
            let at = |d: f32, n: usize| (n as f32 + d) / ROWS as f32;
            // Four points per pixel soften the edges of small lamps.
            let sum: Vec3 = [(0.25, 0.25), (0.75, 0.25), (0.25, 0.75), (0.75, 0.75)]
                .into_iter()
                .map(|(dx, dy)| field(EnvMap::direction(0.5 * at(dx, x), at(dy, y))))
                .sum();
            pixels.push(0.25 * sum);
        }
    }
    let map = |pixels: &[Vec3]| EnvMap {
        width: 2 * ROWS,
        height: ROWS,
        pixels: pixels.iter().map(|p| p.to_array()).collect(),
    };
    let energy: f64 = map(&pixels).energy().iter().sum();
    let scale = mean / (energy / (3.0 * 4.0 * std::f64::consts::PI)) as f32;
    for p in &mut pixels {
        *p *= scale;
    }
    map(&pixels)
}

/// A tint: white moved toward a random hue.
fn tint(draw: &mut Draw, strength: f32) -> Vec3 {
    let c = draw.vector(0.0, 1.0);
    Vec3::ONE.lerp(c / c.max_element().max(0.05), strength)
}

/// Blackbody-like colour from warm (0) to cool (1).
fn temperature(t: f32) -> Vec3 {
    let warm = Vec3::new(1.0, 0.55, 0.22);
    let cool = Vec3::new(0.65, 0.8, 1.0);
    if t < 0.6 {
        warm.lerp(Vec3::ONE, t / 0.6)
    } else {
        Vec3::ONE.lerp(cool, (t - 0.6) / 0.4)
    }
}

/// 1 inside the cone of `cosine` about `axis`, falling to 0 within `soft` of it.
fn cone(d: Vec3, axis: Vec3, cosine: f32, soft: f32) -> f32 {
    ((d.dot(axis) - cosine) / soft + 1.0).clamp(0.0, 1.0)
}

fn toward(azimuth: f32, elevation: f32) -> Vec3 {
    let (sa, ca) = azimuth.sin_cos();
    let (se, ce) = elevation.sin_cos();
    Vec3::new(ca * ce, sa * ce, se)
}

fn sky(draw: &mut Draw) -> Box<dyn Fn(Vec3) -> Vec3> {
    let elevation = draw.range(0.03, 1.3);
    let sun = toward(draw.range(0.0, TAU), elevation);
    // Near the horizon the sun is red and dim, the horizon glows.
    let low = (1.0 - elevation / 0.5).clamp(0.0, 1.0);
    let zenith = Vec3::new(0.18, 0.35, 0.85) * draw.range(0.5, 1.2);
    let horizon = Vec3::new(0.75, 0.85, 1.0).lerp(Vec3::new(1.3, 0.6, 0.25), low);
    let ground = tint(draw, 0.4) * draw.range(0.05, 0.45);
    let sun_color = temperature(0.6 - 0.6 * low);
    let cosine = draw.range(0.006, 0.04).cos();
    // A clear sun brings up to several times the sky's irradiance; haze takes it away.
    let irradiance = draw.log_range(0.3, 8.0) * (1.0 - 0.6 * low);
    let radiance = irradiance / (TAU * (1.0 - cosine));
    let (halo, cover) = (draw.range(0.3, 2.0), draw.range(0.0, 0.7));
    let (seed, scale) = (draw.bits(), draw.range(1.5, 4.0));
    Box::new(move |d| {
        let near = d.dot(sun).max(0.0);
        let glow = sun_color * (halo * near.powi(24) + 0.3 * near.powi(4));
        if d.z < 0.0 {
            return ground * (1.0 + 0.5 * fractal(6.0 * d, 3, seed)).max(0.0);
        }
        let clouds = (fractal(scale * d / (d.z + 0.3), 5, seed) + cover - 0.35).clamp(0.0, 0.8);
        let blue = horizon.lerp(zenith, d.z.powf(0.5));
        let air = blue.lerp(Vec3::splat(1.1).lerp(horizon, low), clouds) + glow;
        air + sun_color * radiance * cone(d, sun, cosine, 1e-4)
    })
}

fn overcast(draw: &mut Draw) -> Box<dyn Fn(Vec3) -> Vec3> {
    let ground = tint(draw, 0.5) * draw.range(0.1, 0.5);
    let sky = temperature(draw.range(0.5, 1.0));
    let bright = draw.direction();
    let (seed, relief, lobe) = (draw.bits(), draw.range(0.1, 0.8), draw.range(0.0, 2.0));
    Box::new(move |d| {
        let texture = (1.0 + relief * fractal(3.0 * d, 4, seed)).max(0.05);
        if d.z < 0.0 {
            return ground * texture;
        }
        sky * (1.0 + 2.0 * d.z) / 3.0 * texture * (1.0 + lobe * d.dot(bright).max(0.0).powi(6))
    })
}

/// A rectangle of light about `axis`, with the extent of its sides as tangents.
#[derive(Clone, Copy)]
struct Panel {
    axis: Vec3,
    right: Vec3,
    up: Vec3,
    width: f32,
    height: f32,
    soft: f32,
    radiance: Vec3,
}

impl Panel {
    fn new(draw: &mut Draw, axis: Vec3, size: (f32, f32), radiance: Vec3) -> Self {
        let right = axis.cross(Vec3::new(0.05, 0.02, 1.0)).normalize();
        Self {
            axis,
            right,
            up: right.cross(axis),
            width: draw.log_range(size.0, size.1),
            height: draw.log_range(size.0, size.1),
            soft: draw.log_range(0.01, 0.2),
            radiance,
        }
    }

    fn radiance(&self, d: Vec3) -> Vec3 {
        let z = d.dot(self.axis);
        if z <= 0.05 {
            return Vec3::ZERO;
        }
        let edge = |t: f32, half: f32| ((half - (t / z).abs()) / self.soft).clamp(0.0, 1.0);
        let inside = edge(d.dot(self.right), self.width) * edge(d.dot(self.up), self.height);
        self.radiance * inside
    }
}

fn studio(draw: &mut Draw) -> Box<dyn Fn(Vec3) -> Vec3> {
    let (floor, wall) = (draw.range(0.0, 0.3), draw.range(0.0, 0.2));
    let ambient = tint(draw, 0.3);
    let colored = draw.chance(0.3);
    let panels: Vec<Panel> = (0..draw.count(1, 5))
        .map(|_| {
            let axis = toward(draw.range(0.0, TAU), draw.range(-0.2, 1.5));
            let strength = if colored { 0.8 } else { 0.1 };
            let radiance = tint(draw, strength) * draw.log_range(2.0, 60.0);
            Panel::new(draw, axis, (0.08, 0.8), radiance)
        })
        .collect();
    Box::new(move |d| {
        let t = 0.5 + 0.5 * d.z;
        let base = ambient * (floor + t * (wall - floor));
        base + panels.iter().map(|p| p.radiance(d)).sum::<Vec3>()
    })
}

fn room(draw: &mut Draw) -> Box<dyn Fn(Vec3) -> Vec3> {
    let half = Vec3::new(draw.range(1.0, 3.0), draw.range(1.0, 3.0), 1.0);
    let walls: [Vec3; 6] = std::array::from_fn(|_| tint(draw, 0.5) * draw.range(0.1, 0.6));
    let seed = draw.bits();
    let day = draw.chance(0.6);
    let mut panels = Vec::new();
    for _ in 0..draw.count(1, 3) {
        if day {
            // Windows: at eye level, daylight.
            let axis = toward(draw.range(0.0, TAU), draw.range(-0.1, 0.35));
            let radiance = temperature(draw.range(0.5, 1.0)) * draw.log_range(4.0, 30.0);
            panels.push(Panel::new(draw, axis, (0.15, 0.7), radiance));
        }
        if !day || draw.chance(0.4) {
            // Lamps: overhead, small, warm.
            let axis = toward(draw.range(0.0, TAU), draw.range(0.6, 1.5));
            let radiance = temperature(draw.range(0.1, 0.8)) * draw.log_range(20.0, 300.0);
            panels.push(Panel::new(draw, axis, (0.03, 0.15), radiance));
        }
    }
    Box::new(move |d| {
        let t = half / d.abs().max(Vec3::splat(1e-4));
        let axis = if t.x < t.y && t.x < t.z {
            0
        } else if t.y < t.z {
            1
        } else {
            2
        };
        let p = d * t[axis];
        let side = 2 * axis + usize::from(d[axis] < 0.0);
        // Corners are darker, and furniture is noise on the walls.
        let corner = (1.0 - (p / half).abs().powf(6.0).element_sum() / 4.0).max(0.3);
        let clutter = (1.0 + 1.2 * fractal(2.5 * p, 4, seed)).clamp(0.1, 2.0);
        walls[side] * corner * clutter + panels.iter().map(|q| q.radiance(d)).sum::<Vec3>()
    })
}

fn night(draw: &mut Draw) -> Box<dyn Fn(Vec3) -> Vec3> {
    let sky = tint(draw, 0.7) * draw.range(0.005, 0.05);
    let ground = tint(draw, 0.4) * draw.range(0.005, 0.08);
    let seed = draw.bits();
    let lamps: Vec<(Vec3, f32, Vec3)> = (0..draw.count(3, 14))
        .map(|_| {
            let axis = toward(draw.range(0.0, TAU), draw.range(-0.15, 0.7));
            let color = if draw.chance(0.4) {
                tint(draw, 0.9)
            } else {
                temperature(draw.range(0.0, 0.9))
            };
            (
                axis,
                draw.log_range(0.02, 0.15).cos(),
                color * draw.log_range(3.0, 100.0),
            )
        })
        .collect();
    Box::new(move |d| {
        let base = if d.z < 0.0 { ground } else { sky };
        let texture = (1.0 + 1.5 * fractal(4.0 * d, 4, seed)).max(0.0);
        let lights = lamps
            .iter()
            .map(|(axis, cosine, radiance)| *radiance * cone(d, *axis, *cosine, 3e-4));
        base * texture + lights.sum::<Vec3>()
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn maps_are_valid_varied_and_of_sensible_strength() {
        let mut peaks = Vec::new();
        for i in 0..40 {
            let map = procedural(Seed(5).index(i));
            map.validate().expect("valid");
            let mean: f64 = map.energy().iter().sum::<f64>() / (12.0 * std::f64::consts::PI);
            assert!((0.14..1.6).contains(&mean), "{mean}");
            let peak = map.pixels.iter().flatten().fold(0.0_f32, |m, &v| m.max(v));
            peaks.push(f64::from(peak) / mean);
        }
        // Some maps must be nearly flat and some must hold a sun or small lamps.
        assert!(
            peaks.iter().any(|p| *p < 6.0) && peaks.iter().any(|p| *p > 100.0),
            "{peaks:?}"
        );
    }
}
