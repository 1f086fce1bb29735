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
    /// How far a place in depth `z` is inside the silhouette, in pixels `width` wide there, no further than [`FAR`].
    pub(super) fn margin(
        &self,
        (pixels, shares): &([usize; 4], [f32; 4]),
        z: f32,
        width: f32,
    ) -> f32 {
        let parts = pixels.iter().zip(shares);
        let inside: f32 = parts.map(|(i, share)| share * self.inside[*i]).sum();
        (inside * z / (self.camera.fx * width)).clamp(-FAR, FAR)
    }
}

/// The margins of a ray, as far as it has been followed.
pub(super) struct Margins {
    /// The least ones of the point furthest inside.
    best: [f32; LEAST],
    smooth: f32,
    length: f32,
}

impl Margins {
    pub fn outside() -> Self {
        Self {
            best: [-FAR; LEAST],
            smooth: -FAR,
            length: 0.0,
        }
    }

    /// With no more than that in any photograph a point changes nothing.
    pub fn enough(&self) -> f32 {
        self.smooth.min(0.0)
    }

    /// Takes in the point that was looked at last, for so many pixels of the ray.
    pub fn add(&mut self, lines: &[Line], pixels: f32) {
        let margins = || lines.iter().filter_map(|line| line.at.map(|at| at.margin));
        let mut least = [FAR; LEAST];
        for mut margin in margins() {
            for kept in &mut least {
                if margin < *kept {
                    std::mem::swap(kept, &mut margin);
                }
            }
        }
        if least[0] > self.best[0] {
            self.best = least;
        }
        // It is no greater than the least.
        if least[0] > self.smooth {
            let sum: f32 = margins().map(|margin| (-margin / SMOOTH).exp()).sum();
            self.smooth = self.smooth.max((-SMOOTH * sum.ln()).clamp(-FAR, FAR));
        }
        if least[0] > 0.0 {
            self.length += pixels;
        }
    }

    /// [`MARGINS`].
    pub fn channels(&self) -> [f32; MARGINS] {
        let [per, most] = LENGTH;
        let mut channels = [0.0; MARGINS];
        for (margin, value) in channels.iter_mut().zip(self.best) {
            *margin = FINE * (value + FAR);
        }
        channels[LEAST] = per * self.length.min(most);
        channels[LEAST + 1] = FINE * (self.smooth + FAR);
        channels
    }
}

impl Reprojection {
    /// The part of a ray of a view, whose pixels are `pixel` wide at distance 1, outside of which some photograph has no margin to speak
    /// of, and so nothing is covered either.
    pub(super) fn near(&self, ray: &Ray, pixel: f32, lines: &[Line]) -> [f32; 2] {
        let widest = (ray.to_nearest + ray.reach).max(0.0) * pixel;
        // Distances are from centre to centre of pixels, and mean of four.
        self.within(ray, lines, |camera, depth| {
            FAR * camera.fx * widest / depth + 1.0
        })
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
