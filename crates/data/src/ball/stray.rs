//! Silhouettes that contradict the others': masks of another picture, or of another object.

use super::{MASK_THRESHOLD, Silhouette, closest_point, line, object_pixels, outline_radius};
use glam::Vec3;
use lumi_core::Camera;
use lumi_core::image::area_resize;

/// One view in this many may be stray; more than that, and it is the poses that are wrong.
const ONE_IN: usize = 5;

/// A silhouette is stray if more than this share of what it shows, or of what the others show in it, is contradicted.
const CONTRADICTED: f32 = 0.25;

/// Silhouettes are compared at this many pixels along their longer side, and widened by one: that forgives edges.
const SIDE: usize = 96;

/// Rays per view, and points along each. With many views there are fewer rays.
const RAYS: usize = 96;
const POINTS: usize = 96;

/// A silhouette, small.
struct Coarse {
    camera: Camera,
    /// Pixels (their centres) that are the object's.
    object: Vec<(f32, f32)>,
    /// The object, one pixel wider.
    wide: Vec<bool>,
}

impl Coarse {
    fn new(camera: &Camera, alpha: &[f32]) -> Self {
        let longer = camera.width.max(camera.height);
        let side = |s: usize| (s * SIDE.min(longer)).div_ceil(longer).max(1);
        let (width, height) = (side(camera.width), side(camera.height));
        let small = area_resize(alpha, (camera.width, camera.height, 1), (width, height));
        let camera = camera.resized(width, height);
        let covered = |x: usize, y: usize| small[y * width + x] >= MASK_THRESHOLD;
        let near = |i: usize| {
            let (x, y) = (i % width, i / width);
            let (right, bottom) = ((x + 1).min(width - 1), (y + 1).min(height - 1));
            (y.saturating_sub(1)..=bottom)
                .any(|y| (x.saturating_sub(1)..=right).any(|x| covered(x, y)))
        };
        Self {
            object: object_pixels(&camera, &small),
            wide: (0..width * height).map(near).collect(),
            camera,
        }
    }

    /// Whether the object covers the point; `None` outside the image.
    fn covers(&self, point: Vec3) -> Option<bool> {
        let (x, y, z) = self.camera.project(point);
        let (w, h) = (self.camera.width, self.camera.height);
        let inside = z > 0.0 && x >= 0.0 && y >= 0.0 && x < w as f32 && y < h as f32;
        inside.then(|| self.wide[(y as usize).min(h - 1) * w + (x as usize).min(w - 1)])
    }
}

/// How often a view was contradicted.
#[derive(Clone, Copy, Default)]
struct Tally {
    asked: usize,
    contradicted: usize,
}

impl Tally {
    fn add(&mut self, contradicted: bool) {
        self.asked += 1;
        self.contradicted += usize::from(contradicted);
    }

    fn is_stray(self) -> bool {
        self.contradicted as f32 > CONTRADICTED * self.asked as f32
    }
}

/// Indices of the views whose silhouettes contradict the others', if they are at most one in five of those that have
/// one: the object that they show is nowhere in space for the others, or what all others show is not in theirs.
#[must_use]
pub fn stray(views: &[Silhouette]) -> Vec<usize> {
    let masked: Vec<usize> = (0..views.len())
        .filter(|&i| views[i].alpha.is_some())
        .collect();
    let allowed = masked.len() / ONE_IN;
    let Some((centre, reach)) = place(views).filter(|_| allowed > 0) else {
        return Vec::new();
    };
    let coarse: Vec<Coarse> = masked
        .iter()
        .filter_map(|&i| Some(Coarse::new(views[i].camera, views[i].alpha?)))
        .collect();
    let rays = RAYS.min(32 * RAYS / coarse.len()).max(8);
    let mut shown = vec![Tally::default(); coarse.len()];
    let mut missing = vec![Tally::default(); coarse.len()];
    for (i, view) in coarse.iter().enumerate() {
        let step = view.object.len().div_ceil(rays).max(1);
        for &(x, y) in view.object.iter().step_by(step) {
            let (origin, direction) = (view.camera.centre(), view.camera.direction(x, y));
            let found = agreed(&coarse, i, (origin, direction), (centre, reach), allowed);
            shown[i].add(found.is_none());
            for (j, covered) in found.into_iter().flatten() {
                missing[j].add(!covered);
            }
        }
    }
    let found: Vec<usize> = (0..coarse.len())
        .filter(|&i| shown[i].is_stray() || missing[i].is_stray())
        .collect();
    if found.len() > allowed {
        return Vec::new();
    }
    found.into_iter().map(|i| masked[i]).collect()
}

/// What the other views say of the middle of the points on a ray of view `i` that all but `allowed` of them cover;
/// `None` if there is no such point.
fn agreed(
    views: &[Coarse],
    i: usize,
    (origin, direction): (Vec3, Vec3),
    (centre, reach): (Vec3, f32),
    allowed: usize,
) -> Option<Vec<(usize, bool)>> {
    let middle = (centre - origin).dot(direction);
    let point = |k: usize| {
        let t = middle + reach * (2.0 * (k as f32 + 0.5) / POINTS as f32 - 1.0);
        origin + t.max(0.0) * direction
    };
    let said = |k: usize| -> Vec<(usize, bool)> {
        let others = views.iter().enumerate().filter(|(j, _)| *j != i);
        let covers = |(j, view): (usize, &Coarse)| Some((j, view.covers(point(k))?));
        others.filter_map(covers).collect()
    };
    let good: Vec<usize> = (0..POINTS)
        .filter(|&k| {
            let said = said(k);
            let against = said.iter().filter(|(_, covered)| !covered).count();
            against <= allowed && against < said.len()
        })
        .collect();
    good.get(good.len() / 2).map(|&k| said(k))
}

/// About where the object is and how far from there silhouettes reach, whatever a few of them say.
fn place(views: &[Silhouette]) -> Option<(Vec3, f32)> {
    let lines: Vec<(Vec3, Vec3)> = views.iter().map(line).collect();
    let mut centre = closest_point(&lines).ok()?;
    // The point with the smallest sum of distances, not squared ones: nearer lines are counted more often.
    for _ in 0..8 {
        let distance = |(o, d): &(Vec3, Vec3)| (centre - *o).cross(*d).length();
        let nearest: Vec<f32> = lines.iter().map(distance).collect();
        let largest = nearest.iter().fold(1e-6_f32, |m, v| m.max(*v));
        let times = |d: f32| (largest / d.max(0.05 * largest)).round() as usize;
        let weighted: Vec<(Vec3, Vec3)> = lines
            .iter()
            .zip(&nearest)
            .flat_map(|(line, d)| std::iter::repeat_n(*line, times(*d)))
            .collect();
        centre = closest_point(&weighted).ok()?;
    }
    let reach = views.iter().filter_map(|v| outline_radius(v, centre));
    let reach = reach.fold(0.0, f32::max);
    (reach > 0.0 && reach.is_finite()).then_some((centre, reach))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ball::estimate;

    /// Silhouettes of a stick, whose outlines differ much between views, with `change` to the masks.
    fn stick(
        count: usize,
        change: impl Fn(usize, &Camera, &mut Vec<f32>),
    ) -> Vec<(Camera, Vec<f32>)> {
        let view = |i: usize| {
            let camera = Camera::orbit(1.1 * i as f32, 0.1 + 0.1 * i as f32, 4.0, 0.8, 48);
            let eye = camera.centre();
            // Beads of radius 0.2 along x from −0.8 to 0.8.
            let hits = |d: Vec3| {
                let bead = |k: i32| Vec3::new(0.1 * k as f32, 0.0, 0.0) - eye;
                (-8..=8).any(|k| d.cross(bead(k)).length() < 0.2)
            };
            let directions = camera.directions().into_iter();
            let mut alpha = directions.map(|d| f32::from(u8::from(hits(d)))).collect();
            change(i, &camera, &mut alpha);
            (camera, alpha)
        };
        (0..count).map(view).collect()
    }

    fn silhouettes(views: &[(Camera, Vec<f32>)]) -> Vec<Silhouette<'_>> {
        let silhouette = |(camera, alpha)| Silhouette {
            camera,
            alpha: Some(alpha),
        };
        views
            .iter()
            .map(|(c, a)| silhouette((c, a.as_slice())))
            .collect()
    }

    #[test]
    fn sound_views_are_not_stray_whatever_the_object() {
        for count in [2, 5, 6, 12, 30] {
            let views = stick(count, |_, _, _| {});
            assert_eq!(stray(&silhouettes(&views)), Vec::<usize>::new(), "{count}");
        }
    }

    #[test]
    fn one_in_five_does_not_move_the_ball() {
        let truth = estimate(&silhouettes(&stick(6, |_, _, _| {}))).expect("a ball");
        let shift = |alpha: &mut Vec<f32>| alpha.rotate_right(15 * 48);
        let wipe = |alpha: &mut Vec<f32>| {
            // Only a corner of the object is left.
            let first = alpha.iter().position(|a| *a > 0.0).unwrap_or(0);
            alpha.iter_mut().skip(first + 2 * 48).for_each(|a| *a = 0.0);
        };
        let fill = |alpha: &mut Vec<f32>| alpha[..30 * 48].fill(1.0);
        type Change<'a> = &'a dyn Fn(&mut Vec<f32>);
        let changes: [Change; 3] = [&shift, &wipe, &fill];
        for (k, change) in changes.iter().enumerate() {
            for bad in 0..6 {
                let views = stick(6, |i, _, alpha| {
                    if i == bad {
                        change(alpha);
                    }
                });
                let ball = estimate(&silhouettes(&views)).expect("a ball");
                assert_eq!(ball.stray, [bad], "change {k} of view {bad}");
                assert!(ball.centre.distance(truth.centre) < 0.05, "{ball:?}");
                assert!(
                    (ball.radius - truth.radius).abs() < 0.1,
                    "{ball:?} {truth:?}"
                );
            }
        }
    }

    #[test]
    fn where_many_disagree_none_is_left_out() {
        let views = stick(6, |i, _, alpha| {
            if i < 3 {
                alpha.rotate_right((10 + 5 * i) * 48);
            }
        });
        assert_eq!(stray(&silhouettes(&views)), Vec::<usize>::new());
    }
}
