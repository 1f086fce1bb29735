//! Basic surfaces: everything turned on a lathe, rounded boxes, superellipsoids and swept tubes.

use super::part::Part;
use lumi_core::glam::{Vec2, Vec3};
use std::f32::consts::{FRAC_PI_2, PI, TAU};

/// Segments around round parts: a 1/40 turn is invisible at 512 px with smooth normals.
const AROUND: usize = 40;
/// Edges up to 35° are shaded smoothly.
pub const CREASE: f32 = 0.61;

/// Surface of revolution about z of a profile of (radius, z) points, closed at both ends where the radius is 0.
#[must_use]
pub fn lathe(profile: &[Vec2], around: usize, crease: f32) -> Part {
    let mut positions = Vec::with_capacity(profile.len() * around);
    for p in profile {
        for i in 0..around {
            let (s, c) = (TAU * i as f32 / around as f32).sin_cos();
            positions.push(Vec3::new(p.x * c, p.x * s, p.y));
        }
    }
    Part::grid(positions, around, (false, true), crease)
}

/// Unit sphere.
#[must_use]
pub fn sphere() -> Part {
    let profile: Vec<Vec2> = (0..=20)
        .map(|i| {
            let (s, c) = (PI * i as f32 / 20.0 - FRAC_PI_2).sin_cos();
            Vec2::new(c.max(0.0), s)
        })
        .collect();
    lathe(&profile, AROUND, 1.2)
}

/// A truncated cone from radius `bottom` at z = −1 to radius `top` at z = 1, edges rounded by `bevel`.
#[must_use]
pub fn cone(bottom: f32, top: f32, bevel: f32, around: usize) -> Part {
    let mut profile = vec![Vec2::new(0.0, -1.0)];
    corner(&mut profile, bottom, -1.0, bevel);
    // The wall in several steps keeps triangles compact for textures and the hierarchy.
    for i in 1..6 {
        let t = i as f32 / 6.0;
        let z = (-1.0 + bevel) + t * (2.0 - 2.0 * bevel);
        profile.push(Vec2::new(bottom + t * (top - bottom), z));
    }
    corner(&mut profile, top, 1.0, bevel);
    profile.push(Vec2::new(0.0, 1.0));
    lathe(&profile, around, CREASE)
}

/// A quarter circle about the edge at (`radius`, `z`), outward from the axis going up.
fn corner(profile: &mut Vec<Vec2>, radius: f32, z: f32, bevel: f32) {
    let bevel = bevel.min(radius).max(0.0);
    if bevel < 1e-3 {
        profile.push(Vec2::new(radius.max(0.0), z));
        return;
    }
    for i in 0..=4 {
        let t = i as f32 / 4.0;
        let (s, c) = (FRAC_PI_2 * if z < 0.0 { t } else { 1.0 - t }).sin_cos();
        profile.push(Vec2::new(
            radius - bevel + bevel * s,
            z - z.signum() * bevel * (1.0 - c),
        ));
    }
}

/// Cylinder of radius 1 from z = −1 to 1.
#[must_use]
pub fn cylinder(bevel: f32) -> Part {
    cone(1.0, 1.0, bevel, AROUND)
}

/// Capsule along z with half-spheres of radius `radius` whose centres are at z = ±1.
#[must_use]
pub fn capsule(bottom: f32, top: f32) -> Part {
    let mut profile = Vec::new();
    for i in 0..=8 {
        let (s, c) = (FRAC_PI_2 * i as f32 / 8.0).sin_cos();
        profile.push(Vec2::new(bottom * s, -1.0 - bottom * c));
    }
    for i in 1..6 {
        let t = i as f32 / 6.0;
        profile.push(Vec2::new(bottom + t * (top - bottom), -1.0 + 2.0 * t));
    }
    for i in 0..=8 {
        let (s, c) = (FRAC_PI_2 * i as f32 / 8.0).sin_cos();
        profile.push(Vec2::new(top * c, 1.0 + top * s));
    }
    lathe(&profile, 28, 1.2)
}

/// Torus about z with ring radius 1 and tube radius `tube`.
#[must_use]
pub fn torus(tube: f32) -> Part {
    let ring: Vec<Vec3> = (0..48)
        .map(|i| {
            let (s, c) = (TAU * i as f32 / 48.0).sin_cos();
            Vec3::new(c, s, 0.0)
        })
        .collect();
    sweep(&ring, |_| tube, |_| 1.0, 20, true)
}

/// Box with half sides `half`, edges and corners rounded by `bevel`.
#[must_use]
pub fn rounded_box(half: Vec3, bevel: f32) -> Part {
    let bevel = bevel.min(half.min_element());
    let core = half - bevel;
    cube_sphere(
        8,
        |q| {
            // Grid lines gather at the rounded edges.
            let stretched = q * half;
            let inner = stretched.clamp(-core, core);
            let out = (stretched - inner).normalize_or_zero();
            inner + bevel * out
        },
        half,
        bevel,
    )
}

/// Box with half sides `half` of twelve triangles, for small or sharp parts.
#[must_use]
pub fn cuboid(half: Vec3) -> Part {
    let corner = |i: u32| {
        let sign = |bit: u32| if i >> bit & 1 == 1 { 1.0 } else { -1.0 };
        half * Vec3::new(sign(0), sign(1), sign(2))
    };
    let faces = [
        [0, 2, 3, 1],
        [4, 5, 7, 6],
        [0, 1, 5, 4],
        [2, 6, 7, 3],
        [0, 4, 6, 2],
        [1, 3, 7, 5],
    ];
    let halves = faces
        .iter()
        .flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]]);
    Part::new((0..8).map(corner).collect(), halves.collect(), CREASE)
}

/// Superellipsoid |x|^(2/e) … = 1 with exponents for the horizontal and vertical outlines; 1 is a sphere,
/// below 1 boxy, above pointed.
#[must_use]
pub fn superellipsoid(vertical: f32, horizontal: f32) -> Part {
    let power = |v: f32, e: f32| v.abs().powf(e).copysign(v);
    let (rows, columns) = (25, 48);
    let mut positions = Vec::with_capacity(rows * columns);
    for r in 0..rows {
        let (s, c) = (PI * r as f32 / (rows - 1) as f32 - FRAC_PI_2).sin_cos();
        let radius = power(c.max(0.0), vertical);
        for k in 0..columns {
            let (sa, ca) = (TAU * k as f32 / columns as f32).sin_cos();
            positions.push(Vec3::new(
                radius * power(ca, horizontal),
                radius * power(sa, horizontal),
                power(s, vertical),
            ));
        }
    }
    Part::grid(positions, columns, (false, true), 0.8)
}

/// The six faces of a cube of `2·n` cells per side pushed through `place`; vertices at seams coincide but are
/// welded, so that normals are smooth across them.
fn cube_sphere(n: usize, place: impl Fn(Vec3) -> Vec3, half: Vec3, bevel: f32) -> Part {
    // Parameters along one half side: dense within the bevel.
    let line = |side: f32| -> Vec<f32> {
        let inner = ((side - bevel) / side).max(0.0);
        let mut t: Vec<f32> = (0..=n / 2)
            .map(|i| inner * i as f32 / (n / 2) as f32)
            .collect();
        for i in 1..=n / 2 {
            // Equal angles on the rounded edge.
            let a = (0.5 * FRAC_PI_2 * i as f32 / (n / 2) as f32).tan();
            t.push((inner + (1.0 - inner) * a).min(1.0));
        }
        let negative = t[1..].iter().rev().map(|v| -v).collect::<Vec<_>>();
        negative.into_iter().chain(t).collect()
    };
    let mut part = Part::new(Vec::new(), Vec::new(), CREASE);
    let mut index = std::collections::HashMap::new();
    for axis in 0..3 {
        for sign in [-1.0, 1.0] {
            let (a, b) = ((axis + 1) % 3, (axis + 2) % 3);
            let (us, vs) = (line(half[a]), line(half[b]));
            let mut vertex = |u: f32, v: f32| {
                let mut q = Vec3::ZERO;
                (q[axis], q[a], q[b]) = (sign, u, v);
                let p = place(q);
                let key = (p * 65536.0).round().as_ivec3();
                *index.entry(key).or_insert_with(|| {
                    part.positions.push(p);
                    (part.positions.len() - 1) as u32
                })
            };
            for j in 0..vs.len() - 1 {
                for i in 0..us.len() - 1 {
                    let c = [
                        vertex(us[i], vs[j]),
                        vertex(us[i + 1], vs[j]),
                        vertex(us[i + 1], vs[j + 1]),
                        vertex(us[i], vs[j + 1]),
                    ];
                    let (x, y) = if sign > 0.0 { (1, 2) } else { (2, 1) };
                    part.triangles.push([c[0], c[x], c[y]]);
                    let (x, y) = if sign > 0.0 { (2, 3) } else { (3, 2) };
                    part.triangles.push([c[0], c[x], c[y]]);
                }
            }
        }
    }
    part.coords = part.positions.clone();
    part
}

/// A tube along `path` whose radius and flatness (height over width of the cross-section) are functions of the
/// position along it in [0, 1]. Open tubes are closed by round-ish caps.
#[must_use]
pub fn sweep(
    path: &[Vec3],
    radius: impl Fn(f32) -> f32,
    flatness: impl Fn(f32) -> f32,
    around: usize,
    closed: bool,
) -> Part {
    let n = path.len();
    let tangent = |i: usize| {
        let (a, b) = if closed {
            (path[(i + n - 1) % n], path[(i + 1) % n])
        } else {
            (path[i.saturating_sub(1)], path[(i + 1).min(n - 1)])
        };
        (b - a).normalize_or(Vec3::Z)
    };
    let mut normal = crate::sampling::frame(tangent(0)).0;
    let mut frames = Vec::with_capacity(n);
    for i in 0..n {
        // Parallel transport: drop what the turned tangent no longer is perpendicular to.
        let t = tangent(i);
        normal = (normal - normal.dot(t) * t).normalize_or(crate::sampling::frame(t).0);
        frames.push((t, normal));
    }
    if closed {
        // Spread the twist that transport leaves at the seam over the whole ring.
        let (t, first) = frames[0];
        let last = (normal - normal.dot(t) * t).normalize_or(first);
        let twist = last.cross(first).dot(t).atan2(last.dot(first));
        for (i, (t, m)) in frames.iter_mut().enumerate() {
            let (s, c) = (twist * i as f32 / n as f32).sin_cos();
            *m = c * *m + s * t.cross(*m);
        }
    }
    let mut positions = Vec::new();
    let mut ring = |centre: Vec3, (t, m): (Vec3, Vec3), r: f32, flat: f32| {
        let b = t.cross(m);
        for k in 0..around {
            let (s, c) = (TAU * k as f32 / around as f32).sin_cos();
            positions.push(centre + r * (c * m + flat * s * b));
        }
    };
    let cap = |i: usize| -> (Vec3, f32) { (path[i], radius(if i == 0 { 0.0 } else { 1.0 })) };
    if !closed {
        let (p, r) = cap(0);
        for (back, share) in [(1.0, 0.0), (0.92, 0.39), (0.71, 0.71), (0.39, 0.92)] {
            ring(
                p - back * r * frames[0].0,
                frames[0],
                share * r,
                flatness(0.0),
            );
        }
    }
    for i in 0..n {
        let t = i as f32 / if closed { n } else { n - 1 } as f32;
        ring(path[i], frames[i], radius(t), flatness(t));
    }
    if !closed {
        let (p, r) = cap(n - 1);
        for (ahead, share) in [(0.39, 0.92), (0.71, 0.71), (0.92, 0.39), (1.0, 0.0)] {
            ring(
                p + ahead * r * frames[n - 1].0,
                frames[n - 1],
                share * r,
                flatness(1.0),
            );
        }
    }
    Part::grid(positions, around, (closed, true), 0.9)
}

/// `n` points on a smooth curve through `knots` (Catmull-Rom).
#[must_use]
pub fn spline(knots: &[Vec3], n: usize, closed: bool) -> Vec<Vec3> {
    let k = knots.len();
    let segments = if closed { k } else { k - 1 };
    let at = |i: isize| {
        if closed {
            knots[i.rem_euclid(k as isize) as usize]
        } else {
            knots[i.clamp(0, k as isize - 1) as usize]
        }
    };
    (0..n)
        .map(|i| {
            let x = i as f32 * segments as f32 / if closed { n } else { n - 1 } as f32;
            let j = (x as usize).min(segments - 1);
            let t = x - j as f32;
            let j = j as isize;
            let (a, b, c, d) = (at(j - 1), at(j), at(j + 1), at(j + 2));
            0.5 * (2.0 * b
                + t * (c - a)
                + t * t * (2.0 * a - 5.0 * b + 4.0 * c - d)
                + t * t * t * (3.0 * b - a - 3.0 * c + d))
        })
        .collect()
}
