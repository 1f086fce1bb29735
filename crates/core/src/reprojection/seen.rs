//! What photographs show of a view, ray by ray and point by point.

use super::margins::Margins;
use super::ray::{At, Line, Ray};
use super::{
    AGREEMENT, CHANNELS, MARGINS, NEAREST, OF_NEAREST, OF_SLICE, OPACITY, OTHERS, OUTSIDE, POINTS,
    Reprojection, SLICES, SURFACE, SWEPT, Source,
};
use crate::Camera;

/// What the photographs make of one point.
#[derive(Clone, Copy)]
struct Seen {
    colour: [f32; 3],
    variance: f32,
    closeness: f32,
}

/// What photographs say of one point.
struct Look {
    /// As [`Reprojection::coverage`] says, 0 also where less than half of the photographs look. Where it is more, or `near`, what lines
    /// keep is whole.
    coverage: f32,
    /// Whether one shows that nothing is there.
    outside: bool,
    /// Whether it counts for margins.
    near: bool,
}

impl Look {
    const OUTSIDE: Self = Self {
        coverage: 0.0,
        outside: true,
        near: false,
    };
}

/// The surface, as far as a ray has been followed.
struct Surface {
    /// How much of what lies behind is still to be seen.
    left: f32,
    /// The greatest so far.
    coverage: f32,
    /// Sum of weights, and sums times weights.
    whole: f32,
    colour: [f32; 3],
    depth: f32,
    depth_squared: f32,
    variance: f32,
    closeness: f32,
}

impl Surface {
    const NONE: Self = Self {
        left: 1.0,
        coverage: 0.0,
        whole: 0.0,
        colour: [0.0; 3],
        depth: 0.0,
        depth_squared: 0.0,
        variance: 0.0,
        closeness: 0.0,
    };

    /// The next point of a ray that came from outside the hull: it hides those behind it, as far as photographs agree on it.
    fn next(&mut self, t: f32, coverage: f32, seen: &Seen) {
        let agree = (-seen.variance / (2.0 * AGREEMENT * AGREEMENT)).exp();
        // Not nothing, so that a ray on which none agree has a colour as well.
        let weight = self.left * coverage * OPACITY * agree.max(1e-3);
        self.left -= weight;
        self.add(t, coverage, seen, weight);
    }

    /// Points of a ray that has always been inside the hull.
    fn swept(points: &[(f32, f32, Seen)]) -> Self {
        let mut surface = Self::NONE;
        let variances = points.iter().map(|(.., seen)| seen.variance);
        let least = variances.fold(f32::INFINITY, f32::min);
        for (t, coverage, seen) in points {
            let weight = coverage * ((least - seen.variance) / SWEPT).exp();
            surface.add(*t, *coverage, seen, weight);
        }
        surface
    }

    fn add(&mut self, t: f32, coverage: f32, seen: &Seen, weight: f32) {
        self.coverage = self.coverage.max(coverage);
        self.whole += weight;
        for (sum, c) in self.colour.iter_mut().zip(seen.colour) {
            *sum += weight * c;
        }
        self.depth += weight * t;
        self.depth_squared += weight * t * t;
        self.variance += weight * seen.variance;
        self.closeness += weight * seen.closeness;
    }
}

impl Reprojection {
    /// A view of them, `[CHANNELS, h, w]`; zero where nothing is. Margins are counted in pixels `finer` times as large as the camera's:
    /// those of the pictures that a network has learnt on, where these are finer.
    #[must_use]
    pub fn seen_by(&self, camera: &Camera, finer: usize) -> Vec<f32> {
        let pixel = finer as f32 / camera.fx;
        let seen = self.each_ray(camera, |_, ray, lines| self.along(ray, pixel, lines));
        let mut channels = vec![0.0; CHANNELS * seen.len()];
        for (i, values) in seen.iter().enumerate() {
            for (c, value) in values.iter().enumerate() {
                channels[c * seen.len() + i] = *value;
            }
        }
        channels
    }

    /// The channels of a ray of a view whose pixels are `pixel` wide at distance 1.
    fn along(&self, ray: &Ray, pixel: f32, lines: &mut [Line]) -> [f32; CHANNELS] {
        let mut channels = [0.0; CHANNELS];
        let (surface_channels, rest) = channels.split_at_mut(SURFACE);
        let (margin_channels, others) = rest.split_at_mut(MARGINS);
        debug_assert_eq!(others.len(), OTHERS);
        let (nearest, slices) = others.split_at_mut(NEAREST * OF_NEAREST);
        let (mut surface, mut margins) = (Surface::NONE, Margins::outside());
        let [from, to] = self.near(ray, pixel, lines);
        // Whether it has been outside the hull, and its points inside if it has not.
        let (mut bounded, mut swept) = (false, Vec::new());
        for (k, t) in ray.points().enumerate() {
            if t < from || t > to {
                bounded |= swept.is_empty();
                continue;
            }
            let width = (ray.to_nearest + t) * pixel;
            let Look {
                coverage: within,
                outside,
                near,
            } = self.look(t, width, margins.enough(), lines);
            bounded |= outside && swept.is_empty();
            if near {
                margins.add(lines, ray.step() / width);
            }
            let slice = &mut slices[k / (POINTS / SLICES) * OF_SLICE..][..OF_SLICE];
            let share = within * SLICES as f32 / POINTS as f32;
            slice[0] += share;
            // What lies behind the surface no photograph shows.
            let visible = surface.left >= 0.02 && within > 0.0;
            if let Some(seen) = visible.then(|| self.point(lines)).flatten() {
                slice[1] += share * seen.variance.sqrt();
                match bounded {
                    true => surface.next(t, within, &seen),
                    false => swept.push((t, within, seen)),
                }
            }
        }
        if !bounded {
            let met = self.meets(ray, lines);
            let met = met.and_then(|t| self.point_at(t, lines));
            surface = Surface::swept(if met.is_some() {
                met.as_slice()
            } else {
                &swept
            });
        }
        margin_channels.copy_from_slice(&margins.channels());
        let Surface {
            coverage, whole, ..
        } = surface;
        if whole <= 0.0 {
            nearest.fill(0.0);
            slices.fill(0.0);
            return channels;
        }
        let colour = surface.colour.map(|c| c / whole);
        let mean = surface.depth / whole;
        let spread = (surface.depth_squared / whole - mean * mean).max(0.0);
        surface_channels[..3].copy_from_slice(&colour.map(|c| coverage * c));
        surface_channels[3..].copy_from_slice(&[
            coverage,
            coverage * mean,
            spread.sqrt(),
            (surface.variance / whole).sqrt(),
            coverage * surface.closeness / whole,
        ]);
        self.nearest(mean, lines, nearest, |c, own| coverage * (own - colour[c]));
        channels
    }

    /// Looks at a point of a ray in every photograph, whose lines keep what they show. Margins are in pixels so wide; points whose
    /// margin is no more than `enough` in one of them do not count for these.
    fn look(&self, t: f32, width: f32, enough: f32, lines: &mut [Line]) -> Look {
        let (mut seeing, mut coverage, mut near) = (0, 1.0_f32, width > 0.0);
        for i in 0..lines.len() {
            let line = &mut lines[i];
            let source = &self.sources[line.source];
            let point = line.point(t);
            line.at = source.place(point).map(|place| {
                let around = source.around(place);
                At {
                    point,
                    place,
                    alpha: source.alpha(&around),
                    margin: source.margin(&around, point.z, width),
                    around,
                }
            });
            let Some(at) = &line.at else {
                continue;
            };
            seeing += 1;
            near &= at.margin > enough;
            coverage = coverage.min(at.alpha);
            if coverage < OUTSIDE {
                coverage = 0.0;
                if !near {
                    // It will often say the same of the next point.
                    lines.swap(0, i);
                    return Look::OUTSIDE;
                }
            }
        }
        // Where few photographs look, few can say that nothing is there.
        if 2 * seeing < lines.len() {
            return Look {
                outside: coverage == 0.0,
                ..Look::OUTSIDE
            };
        }
        Look {
            coverage,
            outside: coverage == 0.0,
            near: near && seeing > 0,
        }
    }

    /// A point of a ray, of which as few photographs as may be see something.
    fn point_at(&self, t: f32, lines: &mut [Line]) -> Option<(f32, f32, Seen)> {
        self.look(t, 1.0, f32::NEG_INFINITY, lines);
        let alphas = lines.iter().filter_map(|line| line.at.map(|at| at.alpha));
        let coverage = alphas.fold(1.0, f32::min);
        let seen = (coverage >= OUTSIDE).then(|| self.point(lines)).flatten()?;
        Some((t, coverage, seen))
    }

    /// Colours at the point inside the hull that was looked at last; `None` if no photograph's counts.
    fn point(&self, lines: &[Line]) -> Option<Seen> {
        let (mut whole, mut sum, mut squares, mut closest) = (0.0, [0.0; 3], 0.0, -1.0_f32);
        for line in lines {
            let source = &self.sources[line.source];
            let Some(at) = &line.at else {
                continue;
            };
            let (weight, cosine) = source.weight(at.point, line.direction, at.place);
            closest = closest.max(cosine);
            whole += weight;
            for (sum, c) in sum.iter_mut().zip(source.colour(&at.around)) {
                let c = c / at.alpha;
                *sum += weight * c;
                squares += weight * c * c;
            }
        }
        if whole <= 0.0 {
            return None;
        }
        let colour = sum.map(|c: f32| c / whole);
        let square: f32 = colour.iter().map(|c| c * c).sum();
        Some(Seen {
            colour,
            variance: ((squares / whole - square) / 3.0).max(0.0),
            closeness: closest,
        })
    }

    /// Fills in what the photographs that count most at a point of a ray show of it, most first; zero where there are no more.
    fn nearest(
        &self,
        t: f32,
        lines: &[Line],
        channels: &mut [f32],
        difference: impl Fn(usize, f32) -> f32,
    ) {
        let mut best: [Option<(f32, &Source, [f32; 2])>; NEAREST] = [None; NEAREST];
        for line in lines {
            let source = &self.sources[line.source];
            let point = line.point(t);
            let Some(place) = source.place(point) else {
                continue;
            };
            let (weight, _) = source.weight(point, line.direction, place);
            let mut candidate = Some((weight, source, place));
            for kept in &mut best {
                let more = |(w, ..): &(f32, _, _)| kept.is_none_or(|(own, ..)| *w > own);
                if candidate.as_ref().is_some_and(more) {
                    std::mem::swap(kept, &mut candidate);
                }
            }
        }
        let channels = channels.chunks_exact_mut(OF_NEAREST);
        for (channels, (weight, source, place)) in channels.zip(best.into_iter().flatten()) {
            let around = source.around(place);
            let alpha = source.alpha(&around);
            if alpha > OUTSIDE {
                for (c, own) in source.colour(&around).into_iter().enumerate() {
                    channels[c] = difference(c, own / alpha);
                }
            }
            channels[3..].copy_from_slice(&[weight, alpha]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::{around, filled, of};
    use super::*;
    use glam::Vec3;

    /// Coverage of the slices and margins of a ray, point by point in every photograph, whatever is known of others.
    fn slowly(all: &Reprojection, ray: &Ray, pixel: f32) -> ([f32; SLICES], [f32; MARGINS]) {
        let mut lines = all.lines();
        all.aim(&mut lines, ray);
        let (mut slices, mut margins) = ([0.0; SLICES], Margins::outside());
        for (k, t) in ray.points().enumerate() {
            let width = (ray.to_nearest + t) * pixel;
            let (mut coverage, mut least, mut seeing) = (1.0_f32, f32::INFINITY, 0);
            for line in &mut lines {
                let source = &all.sources[line.source];
                let point = line.point(t);
                line.at = source.place(point).map(|place| {
                    let around = source.around(place);
                    let (alpha, margin) = (
                        source.alpha(&around),
                        source.margin(&around, point.z, width),
                    );
                    seeing += 1;
                    (coverage, least) = (coverage.min(alpha), least.min(margin));
                    At {
                        point,
                        place,
                        around,
                        alpha,
                        margin,
                    }
                });
            }
            if 2 * seeing < lines.len() {
                continue;
            }
            if coverage >= OUTSIDE {
                slices[k / (POINTS / SLICES)] += coverage * SLICES as f32 / POINTS as f32;
            }
            if least > margins.enough() {
                margins.add(&lines, ray.step() / width);
            }
        }
        (slices, margins.channels())
    }

    #[test]
    fn what_is_passed_over_changes_nothing() {
        let mut cameras = around();
        // One that cuts the object off, and one that looks past it.
        cameras[1].cx += 20.0;
        cameras[4].cx += 200.0;
        let photographs = of(&cameras);
        for finer in [1, 2] {
            let camera = Camera::orbit(0.4, 0.35, 2.6, 0.6, 40);
            let pixel = finer as f32 / camera.fx;
            let seen = photographs.seen_by(&camera, finer);
            let n = camera.width * camera.height;
            let mut inside = 0;
            for (i, d) in camera.directions().into_iter().enumerate() {
                let (slices, margins) = slowly(&photographs, &Ray::new(camera.centre(), d), pixel);
                let found = |c: usize| seen[c * n + i];
                for (k, expected) in margins.iter().enumerate() {
                    let found = found(SURFACE + k);
                    assert!(
                        (found - expected).abs() < 1e-4,
                        "{k}: {found} for {expected}"
                    );
                }
                if found(3) == 0.0 {
                    continue;
                }
                inside += 1;
                for (k, expected) in slices.iter().enumerate() {
                    let found = found(SURFACE + MARGINS + NEAREST * OF_NEAREST + k * OF_SLICE);
                    assert!(
                        (found - expected).abs() < 1e-5,
                        "{k}: {found} for {expected}"
                    );
                }
            }
            assert!(inside > 100, "{inside}");
        }
    }

    #[test]
    fn without_silhouettes_the_surface_is_where_photographs_agree() {
        // A patterned ground that fills every picture.
        let meets = |origin: Vec3, d: Vec3| origin - origin.z / d.z * d;
        let colour = |p: Vec3| {
            let wave = |x: f32| 0.5 + 0.4 * x.sin();
            [
                wave(9.0 * p.x),
                wave(7.0 * p.y + 2.0 * p.x),
                wave(4.0 * (p.x - p.y)),
            ]
        };
        let orbit = |azimuth: f32| Camera::orbit(azimuth, 0.9, 2.6, 0.5, 48);
        let cameras: Vec<Camera> = (0..8).map(|i| orbit(0.3 * i as f32)).collect();
        let photographs = filled(&cameras, colour, meets);
        let camera = orbit(1.0);
        let seen = photographs.seen_by(&camera, 1);
        let n = camera.width * camera.height;
        let (mut off, mut deep, mut pixels) = (0.0, 0.0, 0);
        for (i, d) in camera.directions().into_iter().enumerate() {
            let p = meets(camera.centre(), d);
            if p.length() > 0.6 {
                continue;
            }
            pixels += 1;
            for (c, expected) in colour(p).into_iter().enumerate() {
                off += (seen[c * n + i] - expected).abs() / 3.0;
            }
            // Coverage is one, so this is the depth from the ray's point nearest to the origin.
            assert!((seen[3 * n + i] - 1.0).abs() < 1e-5);
            let nearest = camera.centre() - camera.centre().dot(d) * d;
            deep += (seen[4 * n + i] - (p - nearest).dot(d)).abs();
        }
        let (off, deep) = (off / pixels as f32, deep / pixels as f32);
        assert!(
            pixels > 200 && off < 0.04 && deep < 0.1,
            "{off} {deep} on {pixels}"
        );
        // As far as the photographs themselves look.
        let (mut deep, mut pixels) = (0.0, 0);
        let depths = photographs.depths(0);
        for (depth, d) in depths.iter().zip(cameras[0].directions()) {
            let p = meets(cameras[0].centre(), d);
            if p.length() < 0.6 {
                deep += (depth - p.dot(d)).abs();
                pixels += 1;
            }
        }
        let deep = deep / pixels as f32;
        assert!(pixels > 200 && deep < 0.1, "{deep} on {pixels}");
    }
}
