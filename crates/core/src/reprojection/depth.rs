//! How far photographs look where no silhouette bounds what they show: a ground that fills them, or no alpha at all.
//!
//! Each photograph is swept against those beside it (plane sweep, Collins 1996). Of these the few that agree best count at a
//! depth, since the others may be hidden from it (Kang, Szeliski and Chai 2001), and neighbouring pixels come to terms along the
//! picture's lines (semi-global matching, Hirschmüller 2008). A point is then inside where the photographs' distances say so on
//! average (Curless and Levoy 1996).

use super::ray::{Line, Ray};
use super::{OUTSIDE, Reprojection, Source};
use crate::Camera;
use glam::Vec3;
use rayon::prelude::*;

/// Depths that are tried, evenly in their inverses.
const DEPTHS: usize = 64;
/// Depths, and steps of a ray, are from so much nearer than its point nearest to the origin to so much further.
const RANGE: [f32; 2] = [1.1, 2.0];
/// No depth is nearer than this.
const NEAREST: f32 = 0.1;
/// Pixels of a side beyond which photographs are looked at coarser.
const SIDE: usize = 64;
/// Photographs that one is compared with at most, and how many of them count at a depth.
const BESIDE: usize = 8;
const BEST: usize = 4;
/// Difference of colours, mean of three channels, beyond which they are not one place's.
const APART: f32 = 0.3;
/// What neighbouring pixels pay that are one depth apart, and that are further.
const STEP: f32 = 0.01;
const JUMP: f32 = 0.1;
/// How far from what a photograph shows it knows what is there.
const BAND: f32 = 0.18;
/// Steps of a ray.
const STEPS: usize = 64;
/// Share of a photograph's pixels that must look past every silhouette for it to be swept.
const OPEN: f32 = 0.05;

/// The `k`-th of `n` distances between two, evenly in their inverses.
fn distance([near, far]: [f32; 2], k: f32, n: usize) -> f32 {
    let share = k / (n - 1) as f32;
    1.0 / ((1.0 - share) / near + share / far)
}

/// Between which distances a ray is searched.
fn range(to_nearest: f32) -> [f32; 2] {
    let near = (to_nearest - RANGE[0]).max(NEAREST);
    [near, (to_nearest + RANGE[1]).max(2.0 * near)]
}

impl Source {
    /// Pixels that show something whose distance no silhouette bounds.
    fn unbounded(&self) -> impl Iterator<Item = usize> + '_ {
        let shown = self.pixels.iter().zip(&self.hull).enumerate();
        shown.filter_map(|(i, (p, hull))| (p[3] > OUTSIDE && hull.is_infinite()).then_some(i))
    }
}

impl Reprojection {
    /// Finds out how far photographs look where the hull has no border.
    pub(super) fn find_depths(&mut self) {
        let open = |source: &&Source| {
            // One alone has none to be compared with.
            self.sources.len() > 1
                && source.unbounded().count() as f32 > OPEN * source.pixels.len() as f32
        };
        let sources = self.sources.par_iter();
        let swept: Vec<Option<Vec<f32>>> = sources
            .map(|s| Some(s).filter(open).map(|s| self.distances(s)))
            .collect();
        self.swept = swept.iter().any(Option::is_some);
        for (source, distances) in self.sources.iter_mut().zip(swept) {
            let Some(distances) = distances else { continue };
            let unbounded: Vec<usize> = source.unbounded().collect();
            for i in unbounded {
                source.hull[i] = distances[i];
            }
        }
    }

    /// Distance of what a photograph shows, for each of its pixels.
    fn distances(&self, source: &Source) -> Vec<f32> {
        let own = &source.camera;
        let coarser = own.width.max(own.height).div_ceil(SIDE).max(1);
        let [w, h] = [own.width, own.height].map(|n| (n / coarser).max(1));
        let camera = own.resized(w, h);
        let range = range(source.centre.length());
        let costs = blurred(&self.costs(source, &camera, range), w, h);
        let agreed = agreed(&costs, w, h);
        let best = agreed.as_chunks::<DEPTHS>().0.iter();
        let best: Vec<f32> = best.map(|s| distance(range, least(s), DEPTHS)).collect();
        let pixel = |i: usize| {
            let (x, y) = (i % own.width, i / own.width);
            best[y * h / own.height * w + x * w / own.width]
        };
        (0..own.width * own.height).map(pixel).collect()
    }

    /// How badly a photograph's pixels agree at each depth with those beside it, `[h, w, DEPTHS]`; seen through `camera`, which is its
    /// own but for the size.
    fn costs(&self, source: &Source, camera: &Camera, range: [f32; 2]) -> Vec<f32> {
        let others = self.beside(source).into_iter();
        let others: Vec<(&Source, Vec3)> = others
            .map(|other| (other, other.rotation * (source.centre - other.centre)))
            .collect();
        let directions = camera.directions();
        let depths: [f32; DEPTHS] = std::array::from_fn(|k| distance(range, k as f32, DEPTHS));
        let [sx, sy] = [
            source.camera.width as f32 / camera.width as f32,
            source.camera.height as f32 / camera.height as f32,
        ];
        let pixel = |(i, direction): (usize, &Vec3)| -> [f32; DEPTHS] {
            let (x, y) = (i % camera.width, i / camera.width);
            let own = [(x as f32 + 0.5) * sx, (y as f32 + 0.5) * sy];
            let own = source.texel(&source.around(own));
            let own = own / own.w.max(OUTSIDE);
            let ways = others.iter().map(|(other, _)| other.rotation * *direction);
            let ways: Vec<Vec3> = ways.collect();
            depths.map(|t| {
                let (mut best, mut seeing) = ([APART; BEST], 0);
                for ((other, begin), way) in others.iter().zip(&ways) {
                    let Some(place) = other.place(*begin + t * *way) else {
                        continue;
                    };
                    let theirs = other.texel(&other.around(place));
                    if theirs.w < OUTSIDE {
                        return APART;
                    }
                    seeing += 1;
                    let apart = (theirs / theirs.w - own).abs();
                    let mut apart = (apart.x + apart.y + apart.z) / 3.0;
                    for kept in &mut best {
                        (*kept, apart) = (kept.min(apart), kept.max(apart));
                    }
                }
                let counted = seeing.clamp(1, BEST);
                best[..counted].iter().sum::<f32>() / counted as f32
            })
        };
        let pixels = directions.par_iter().enumerate().with_min_len(64);
        pixels.flat_map_iter(pixel).collect()
    }

    /// Of the other photographs, those that look from nearest by.
    fn beside(&self, source: &Source) -> Vec<&Source> {
        let others = self.sources.iter().filter(|s| !std::ptr::eq(*s, source));
        let mut others: Vec<&Source> = others.collect();
        let far = |s: &Source| s.centre.distance_squared(source.centre);
        others.sort_by(|a, b| far(a).total_cmp(&far(b)));
        others.truncate(BESIDE);
        others
    }

    /// How far a point of a ray is in front of what photographs show, no further than [`BAND`]; `None` where none knows.
    pub(super) fn ahead(&self, t: f32, lines: &[Line]) -> Option<f32> {
        let (mut sum, mut knowing) = (0.0, 0);
        for line in lines {
            let source = &self.sources[line.source];
            let point = line.point(t);
            let Some([x, y]) = source.place(point) else {
                continue;
            };
            let hull = source.hull[y as usize * source.camera.width + x as usize];
            let ahead = hull - point.length();
            if ahead > -BAND {
                sum += ahead.min(BAND);
                knowing += 1;
            }
        }
        (knowing > 0).then(|| sum / knowing as f32)
    }

    /// Where a ray meets what photographs were found to show, from its point nearest to the origin on; `None` also where silhouettes
    /// bound all of it.
    pub(super) fn meets(&self, ray: &Ray, lines: &[Line]) -> Option<f32> {
        if !self.swept {
            return None;
        }
        let range = range(ray.to_nearest);
        let mut last: Option<(f32, f32)> = None;
        for k in 0..STEPS {
            let t = distance(range, k as f32, STEPS) - ray.to_nearest;
            let Some(ahead) = self.ahead(t, lines) else {
                continue;
            };
            if ahead > 0.0 {
                last = Some((t, ahead));
                continue;
            }
            let Some(mut before) = last else {
                return Some(t);
            };
            let mut behind = (t, ahead);
            // A step may be longer than the band.
            for _ in 0..2 {
                let middle = 0.5 * (before.0 + behind.0);
                match self.ahead(middle, lines) {
                    Some(ahead) if ahead > 0.0 => before = (middle, ahead),
                    Some(ahead) => behind = (middle, ahead),
                    None => break,
                }
            }
            let share = before.1 / (before.1 - behind.1);
            return Some(before.0 + share * (behind.0 - before.0));
        }
        None
    }
}

/// Means of each depth's costs over 3 × 3 pixels.
fn blurred(costs: &[f32], w: usize, h: usize) -> Vec<f32> {
    let (costs, _) = costs.as_chunks::<DEPTHS>();
    let pixel = |i: usize| -> [f32; DEPTHS] {
        let (x, y) = (i % w, i / w);
        let (mut sum, mut n) = ([0.0; DEPTHS], 0.0);
        for y in y.saturating_sub(1)..(y + 2).min(h) {
            for costs in &costs[y * w..][x.saturating_sub(1)..(x + 2).min(w)] {
                n += 1.0;
                sum.iter_mut().zip(costs).for_each(|(s, c)| *s += c);
            }
        }
        sum.map(|s| s / n)
    };
    (0..w * h).flat_map(pixel).collect()
}

/// Costs with what neighbours pay, summed over the eight ways in which a pixel is reached.
fn agreed(costs: &[f32], w: usize, h: usize) -> Vec<f32> {
    const WAYS: [[isize; 2]; 4] = [[-1, 0], [0, -1], [-1, -1], [1, -1]];
    let (costs, _) = costs.as_chunks::<DEPTHS>();
    let mut sums = vec![[0.0; DEPTHS]; w * h];
    let mut paths = vec![[0.0; DEPTHS]; w * h];
    for [dx, dy] in WAYS {
        // There, and back from the last pixel to the first.
        for sign in [1, -1] {
            for i in 0..w * h {
                let i = if sign > 0 { i } else { w * h - 1 - i };
                let x = (i % w) as isize + sign * dx;
                let y = (i / w) as isize + sign * dy;
                let inside = (0..w as isize).contains(&x) && (0..h as isize).contains(&y);
                paths[i] = match inside {
                    true => carried(&paths[y as usize * w + x as usize], &costs[i]),
                    false => costs[i],
                };
                sums[i].iter_mut().zip(&paths[i]).for_each(|(s, p)| *s += p);
            }
        }
    }
    sums.into_flattened()
}

/// A pixel's costs and what it takes to come from the one before.
fn carried(before: &[f32; DEPTHS], costs: &[f32; DEPTHS]) -> [f32; DEPTHS] {
    let mut padded = [f32::INFINITY; DEPTHS + 2];
    padded[1..=DEPTHS].copy_from_slice(before);
    let lowest = before.iter().copied().fold(f32::INFINITY, f32::min);
    std::array::from_fn(|k| {
        let stepped = padded[k].min(padded[k + 2]) + STEP;
        costs[k] + padded[k + 1].min(stepped).min(lowest + JUMP) - lowest
    })
}

/// Where the least is, between depths by a parabola.
fn least(costs: &[f32; DEPTHS]) -> f32 {
    let lower = |a: &usize, b: &usize| costs[*a].total_cmp(&costs[*b]);
    let k = (0..DEPTHS).min_by(lower).unwrap_or_default();
    if k == 0 || k + 1 == DEPTHS {
        return k as f32;
    }
    let [a, b, c] = [costs[k - 1], costs[k], costs[k + 1]];
    let bend = a - 2.0 * b + c;
    k as f32
        + if bend > 0.0 {
            0.5 * (a - c) / bend
        } else {
            0.0
        }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::super::tests::filled;
    use super::*;
    use crate::light::LightRay;
    use crate::{Light, Point};
    use rand::RngExt;

    /// The cheapest way to a depth along a line of pixels, all ways tried: what is paid on the way, less the least of each step.
    fn cheapest(costs: &[[f32; DEPTHS]]) -> [f32; DEPTHS] {
        let Some((last, before)) = costs.split_last() else {
            return [0.0; DEPTHS];
        };
        if before.is_empty() {
            return *last;
        }
        let before = cheapest(before);
        let least = before.iter().copied().fold(f32::INFINITY, f32::min);
        std::array::from_fn(|k| {
            let from = |j: usize| {
                before[j]
                    + match k.abs_diff(j) {
                        0 => 0.0,
                        1 => STEP,
                        _ => JUMP,
                    }
            };
            let way = (0..DEPTHS).map(from).fold(f32::INFINITY, f32::min);
            last[k] + way - least
        })
    }

    #[test]
    fn neighbours_agree_as_all_ways_tried_say() {
        let (w, h) = (5, 4);
        let mut rng = crate::Seed(5).stream("costs");
        let costs: Vec<f32> = (0..w * h * DEPTHS)
            .map(|_| 0.3 * rng.random::<f32>())
            .collect();
        let found = agreed(&costs, w, h);
        let (costs, _) = costs.as_chunks::<DEPTHS>();
        for (i, found) in found.as_chunks::<DEPTHS>().0.iter().enumerate() {
            let mut expected = [0.0; DEPTHS];
            for way in [
                [1, 0],
                [0, 1],
                [1, 1],
                [1, -1],
                [-1, 0],
                [0, -1],
                [-1, -1],
                [-1, 1],
            ] {
                // From the border to the pixel.
                let (mut x, mut y) = ((i % w) as isize, (i / w) as isize);
                let mut line = Vec::new();
                while (0..w as isize).contains(&x) && (0..h as isize).contains(&y) {
                    line.insert(0, costs[y as usize * w + x as usize]);
                    (x, y) = (x - way[0], y - way[1]);
                }
                let sum = cheapest(&line);
                expected.iter_mut().zip(sum).for_each(|(e, s)| *e += s);
            }
            for (found, expected) in found.iter().zip(expected) {
                assert!((found - expected).abs() < 1e-4, "{found} for {expected}");
            }
        }
    }

    #[test]
    fn the_least_is_found_between_depths() {
        let costs = std::array::from_fn(|k| (k as f32 - 20.3).powi(2));
        assert!((least(&costs) - 20.3).abs() < 1e-3);
        assert_eq!(least(&[1.0; DEPTHS]), 0.0);
    }

    const GROUND: f32 = -0.3;
    const BALL: (Vec3, f32) = (Vec3::new(0.0, 0.0, 0.0), 0.3);

    /// A patterned ball on a patterned ground that goes on for ever: where a ray meets one of them.
    fn meets(origin: Vec3, d: Vec3) -> Vec3 {
        let (centre, radius) = BALL;
        let way = centre - origin;
        let along = way.dot(d);
        let squared = radius * radius - (way - along * d).length_squared();
        if squared > 0.0 {
            return origin + (along - squared.sqrt()) * d;
        }
        origin + (GROUND - origin.z) / d.z * d
    }

    fn scene() -> (Reprojection, Camera) {
        let wave = |x: f32| 0.5 + 0.4 * x.sin();
        let colour = |p: Vec3| {
            [
                wave(13.0 * p.x + 4.0 * p.z),
                wave(11.0 * p.y + 2.0 * p.x),
                wave(7.0 * (p.x - p.y - p.z)),
            ]
        };
        let orbit = |azimuth: f32| Camera::orbit(azimuth, 0.9, 2.6, 0.5, 48);
        let cameras: Vec<Camera> = (0..8).map(|i| orbit(0.785 * i as f32)).collect();
        (filled(&cameras, colour, meets), orbit(0.4))
    }

    #[test]
    fn what_stands_on_a_ground_is_found_and_shadows_it() {
        let (photographs, camera) = scene();
        assert!(photographs.swept);
        let lamp = Point::new(Vec3::new(0.3, -2.0, 2.2), 500.0);
        let rays: Vec<LightRay> = Light::Point(lamp).rays(&Default::default());
        let lit = photographs.surface(&camera).lit(&rays, [1.0; 3], 1.0);
        let n = camera.width * camera.height;
        let found = photographs.each_ray(&camera, |_, ray, lines| {
            photographs
                .meets(ray, lines)
                .map(|t| ray.nearest + t * ray.direction)
        });
        let (mut off, mut pixels) = (0.0, 0);
        let (mut dark, mut shadowed, mut light, mut open) = (0, 0, 0, 0);
        for (i, d) in camera.directions().into_iter().enumerate() {
            let p = meets(camera.centre(), d);
            if p.length() > 0.9 {
                continue;
            }
            off += found[i].map_or(1.0, |found| found.distance(p));
            pixels += 1;
            if p.z > GROUND + 1e-4 {
                continue;
            }
            let toward = (lamp.position - p).normalize();
            let (centre, radius) = BALL;
            let miss = (centre - p) - (centre - p).dot(toward) * toward;
            // Away from the outline of the shadow.
            if (miss.length() - radius).abs() < 0.1 {
                continue;
            }
            let blocked = lit[i] < 0.5 * lit[3 * n + i];
            match miss.length() < radius {
                true => (shadowed, dark) = (shadowed + 1, dark + usize::from(blocked)),
                false => (open, light) = (open + 1, light + usize::from(!blocked)),
            }
        }
        let off = off / pixels as f32;
        assert!(pixels > 500 && off < 0.08, "{off} on {pixels}");
        assert!(
            shadowed > 20 && 10 * dark > 7 * shadowed,
            "{dark} of {shadowed}"
        );
        assert!(open > 200 && 10 * light > 9 * open, "{light} of {open}");
    }
}
