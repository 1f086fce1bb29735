//! How far inside the photographs' silhouettes a ray comes: what tells an object's outline from its visual hull's.
//!
//! The hull is larger than the object, above all where silhouettes of few photographs meet in an edge. How far a point is inside
//! of the least of them, of the second and so on, and how much of the ray is inside of all, says how likely it is that the object is
//! there; coverage, which is 1 from a pixel inside on, does not.

use super::{Line, Ray, Reprojection, Source};

/// Numbers per ray, zero far outside. At its point furthest inside the hull, how far it is inside of the [`LEAST`] silhouettes that
/// it is least inside of, in pixels of the view, counted from [`FAR`] outside and times [`FINE`]; how long the ray is inside the hull,
/// in pixels times [`LENGTH`]'s factor; and, counted as the first ones, the greatest smooth minimum along it of all silhouettes' margins.
pub const MARGINS: usize = LEAST + 2;

/// Silhouettes whose own margins are given.
const LEAST: usize = 4;
/// Pixels beyond which a margin says no more, each way.
const FAR: f32 = 8.0;
/// What margins are multiplied with.
const FINE: f32 = 0.25;
/// What lengths in pixels are multiplied with, and the longest.
const LENGTH: [f32; 2] = [0.1, 40.0];
/// Width in pixels of the smooth minimum −s log Σ exp(−d / s).
const SMOOTH: f32 = 1.5;
/// Alpha at which a pixel is not wholly outside, and at which it is wholly inside.
const PARTLY: [f32; 2] = [0.05, 0.95];

impl Source {
    /// How far a place is inside the silhouette, in pixels.
    fn inside(&self, (pixels, shares): &([usize; 4], [f32; 4])) -> f32 {
        let parts = pixels.iter().zip(shares);
        parts.map(|(i, share)| share * self.inside[*i]).sum()
    }
}

impl Reprojection {
    /// [`MARGINS`] of a ray of a view whose pixels are `pixel` wide at distance 1.
    pub(super) fn margins(&self, ray: &Ray, pixel: f32, lines: &mut [Line]) -> [f32; MARGINS] {
        let (mut best, mut smooth, mut length) = ([-FAR; LEAST], -FAR, 0.0);
        let step = 2.0 * ray.reach / ray.points().len() as f32;
        for t in ray.points() {
            let width = (ray.to_nearest + t) * pixel;
            if width <= 0.0 {
                continue;
            }
            // With no more than that a point changes nothing.
            let enough = smooth.min(0.0);
            let Some((least, all)) = self.point_margins(t, width, enough, lines) else {
                continue;
            };
            if least[0] > best[0] {
                best = least;
            }
            smooth = smooth.max(all);
            if least[0] > 0.0 {
                length += step / width;
            }
        }
        let [per, most] = LENGTH;
        let mut margins = [0.0; MARGINS];
        for (margin, value) in margins.iter_mut().zip(best) {
            *margin = FINE * (value + FAR);
        }
        margins[LEAST] = per * length.min(most);
        margins[LEAST + 1] = FINE * (smooth + FAR);
        margins
    }

    /// The least margins of a point in pixels so wide, and the smooth minimum of all; `None` where less than half of the photographs
    /// look, or one of them says no more than `enough`, which then comes first.
    fn point_margins(
        &self,
        t: f32,
        width: f32,
        enough: f32,
        lines: &mut [Line],
    ) -> Option<([f32; LEAST], f32)> {
        let (mut least, mut sum, mut seeing) = ([FAR; LEAST], 0.0_f32, 0);
        for i in 0..lines.len() {
            let line = &lines[i];
            let source = &self.sources[line.source];
            let point = line.nearest + t * line.direction;
            let Some(place) = source.place(point) else {
                continue;
            };
            let inside = source.inside(&source.around(place));
            let mut margin = (inside * point.z / (source.camera.fx * width)).clamp(-FAR, FAR);
            if margin <= enough {
                lines.swap(0, i);
                return None;
            }
            seeing += 1;
            sum += (-margin / SMOOTH).exp();
            for kept in &mut least {
                if margin < *kept {
                    std::mem::swap(kept, &mut margin);
                }
            }
        }
        let known = seeing > 0 && 2 * seeing >= lines.len();
        known.then(|| (least, (-SMOOTH * sum.ln()).clamp(-FAR, FAR)))
    }
}

/// How far each pixel of an alpha mask is inside of it, in pixels: signed distance to where alpha is a half, by the nearest pixel at
/// the border and its alpha; further than any pixel is where there is no border.
///
/// Nearest pixels are handed on from neighbour to neighbour (Danielsson, Euclidean distance mapping, 1980).
pub(super) fn inside(alpha: &[f32], width: usize) -> Vec<f32> {
    let [partly, wholly] = PARTLY;
    let height = alpha.len().checked_div(width).unwrap_or(0);
    let extremes = |i: usize| {
        let (x, y) = (i % width, i / width);
        let (mut least, mut most) = (1.0_f32, 0.0_f32);
        for y in y.saturating_sub(1)..(y + 2).min(height) {
            for a in &alpha[y * width + x.saturating_sub(1)..y * width + (x + 2).min(width)] {
                (least, most) = (least.min(*a), most.max(*a));
            }
        }
        (least, most)
    };
    let border = |i: usize| {
        let (least, most) = extremes(i);
        least < wholly && most > partly
    };
    let borders: Vec<bool> = (0..alpha.len()).map(border).collect();
    // To pixels that are not wholly inside, and to such as are not wholly outside.
    let outward = distances(width, height, |i| {
        (borders[i] && alpha[i] < wholly).then_some(alpha[i] - 0.5)
    });
    let inward = distances(width, height, |i| {
        (borders[i] && alpha[i] > partly).then_some(0.5 - alpha[i])
    });
    let signed = |(i, a): (usize, &f32)| match a {
        a if *a >= wholly => outward[i],
        a if *a <= partly => -inward[i],
        a => a - 0.5,
    };
    alpha.iter().enumerate().map(signed).collect()
}

/// Distance of each pixel to the nearest one of those that have an offset, which is added to it.
fn distances(width: usize, height: usize, offset: impl Fn(usize) -> Option<f32>) -> Vec<f32> {
    let (pixels, far) = (width * height, (width + height) as f32);
    let mut nearest: Vec<Option<(usize, f32)>> = (0..pixels)
        .map(|i| offset(i).map(|offset| (i, offset)))
        .collect();
    let distance = |i: usize, (to, offset): (usize, f32)| {
        let across = (i % width) as f32 - (to % width) as f32;
        let down = (i / width) as f32 - (to / width) as f32;
        across.hypot(down) + offset
    };
    let mut distances: Vec<f32> = (0..pixels)
        .map(|i| nearest[i].map_or(far, |(_, offset)| offset))
        .collect();
    let mut hand_on = |i: usize, from: usize| {
        let Some(candidate) = nearest[from] else {
            return;
        };
        let d = distance(i, candidate);
        if d < distances[i] {
            (distances[i], nearest[i]) = (d, Some(candidate));
        }
    };
    let mut row = |y: usize, before: Option<usize>| {
        for x in 0..width {
            let i = y * width + x;
            if let Some(before) = before {
                for x in x.saturating_sub(1)..(x + 2).min(width) {
                    hand_on(i, before * width + x);
                }
            }
            if x > 0 {
                hand_on(i, i - 1);
            }
        }
        for x in (0..width.saturating_sub(1)).rev() {
            hand_on(y * width + x, y * width + x + 1);
        }
    };
    for y in 0..height {
        row(y, y.checked_sub(1));
    }
    for y in (0..height).rev() {
        row(y, (y + 1 < height).then_some(y + 1));
    }
    distances
}

#[cfg(test)]
mod tests {
    use super::super::tests::{BALL, around, of};
    use super::super::{CHANNELS, SURFACE};
    use super::*;
    use crate::Camera;

    #[test]
    fn distances_to_a_disc_are_those_to_its_circle() {
        let (side, centre, radius) = (48, [23.3_f32, 25.1], 13.4);
        let out = |i: usize| {
            let [x, y] = [i % side, i / side].map(|v| v as f32 + 0.5);
            (x - centre[0]).hypot(y - centre[1]) - radius
        };
        let alpha: Vec<f32> = (0..side * side)
            .map(|i| (0.5 - out(i)).clamp(0.0, 1.0))
            .collect();
        let found = inside(&alpha, side);
        for (i, found) in found.iter().enumerate() {
            assert!((found + out(i)).abs() < 0.4, "{found} for {}", -out(i));
        }
    }

    #[test]
    fn without_a_border_all_is_far_inside_or_outside() {
        assert_eq!(inside(&[1.0; 12], 4), [7.0; 12]);
        assert_eq!(inside(&[0.0; 12], 4), [-7.0; 12]);
        assert!(inside(&[], 0).is_empty());
    }

    #[test]
    fn a_ray_through_a_ball_is_as_far_inside_as_it_passes_from_its_outline() {
        let photographs = of(&around());
        let camera = Camera::orbit(0.4, 0.35, 2.6, 0.6, 48);
        let seen = photographs.seen_by(&camera, 1);
        let n = camera.width * camera.height;
        assert_eq!(seen.len(), CHANNELS * n);
        let (mut near, mut off) = (0, 0.0);
        for (i, d) in camera.directions().into_iter().enumerate() {
            let margin = |k: usize| seen[(SURFACE + k) * n + i];
            let [least, second, length, smooth] = [0, 1, LEAST, LEAST + 1].map(margin);
            assert!(least <= second && smooth <= least + 1e-5);
            let origin = camera.centre();
            let from_centre = (origin - origin.dot(d) * d).length();
            let pixel = -origin.dot(d) / camera.fx;
            let expected = (BALL - from_centre) / pixel;
            if expected < -10.0 {
                assert!(length == 0.0 && least < 1.0, "{least}");
            }
            if expected.abs() < 5.0 {
                // The hull of eight photographs is larger, by two pixels at most.
                let found = least / FINE - FAR;
                assert!(found > expected - 1.0 && found < expected + 3.0);
                (near, off) = (near + 1, off + found - expected);
            }
            if expected > 6.0 {
                let chord = 2.0 * (BALL.powi(2) - from_centre.powi(2)).sqrt() / pixel;
                let length = length * 10.0;
                assert!(
                    length > 0.8 * chord.min(40.0) && length < 1.4 * chord,
                    "{length} {chord}"
                );
            }
        }
        assert!(near > 200 && (off / near as f32).abs() < 1.0);
    }
}
