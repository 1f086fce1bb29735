//! Rays that are searched for what photographs cover, as each of the photographs sees them.

use super::{OUTSIDE, POINTS, RADIUS, REACH, Reprojection, Source};
use crate::Camera;
use glam::Vec3;
use rayon::prelude::*;

/// A ray that is searched.
pub(super) struct Ray {
    /// Its point nearest to the origin, and how far that is from where it begins.
    pub nearest: Vec3,
    pub to_nearest: f32,
    pub direction: Vec3,
    /// How far it is searched, each way from there.
    pub reach: f32,
}

impl Ray {
    pub fn new(origin: Vec3, direction: Vec3) -> Self {
        let to_nearest = -origin.dot(direction);
        let nearest = origin + to_nearest * direction;
        let squared = RADIUS * RADIUS - nearest.length_squared();
        Self {
            nearest,
            to_nearest,
            direction,
            reach: squared.max(REACH * REACH).sqrt(),
        }
    }

    /// Where it is searched, from [`Self::nearest`] on.
    pub fn points(&self) -> impl ExactSizeIterator<Item = f32> + use<> {
        let (reach, step) = (self.reach, self.step());
        (0..POINTS).map(move |k| step * (k as f32 + 0.5) - reach)
    }

    /// How far those points are apart.
    pub fn step(&self) -> f32 {
        2.0 * self.reach / POINTS as f32
    }
}

/// A ray as one of the photographs sees it: its point nearest to the origin and its direction, in the camera's axes.
pub(super) struct Line {
    pub source: usize,
    pub nearest: Vec3,
    pub direction: Vec3,
    /// What the photograph shows of the point that was looked at last, if it does.
    pub at: Option<At>,
}

/// A point of a ray in a photograph.
#[derive(Clone, Copy)]
pub(super) struct At {
    /// In the camera's axes, and in the picture.
    pub point: Vec3,
    pub place: [f32; 2],
    /// The pixels around the place and their shares.
    pub around: ([usize; 4], [f32; 4]),
    pub alpha: f32,
    /// How far it is inside the silhouette, in pixels of the view.
    pub margin: f32,
}

impl Line {
    pub fn point(&self, t: f32) -> Vec3 {
        self.nearest + t * self.direction
    }
}

impl Source {
    /// The part of a ray, searched as far as `reach` each way, that shows no further than `beyond` pixels from where the
    /// object is; all of it where the picture's frame cuts the ray.
    fn span(&self, line: &Line, reach: f32, beyond: f32) -> [f32; 2] {
        let whole = [-reach, reach];
        if whole.iter().any(|t| self.place(line.point(*t)).is_none()) {
            return whole;
        }
        let (c, n, d) = (&self.camera, line.nearest, line.direction);
        let [left, right, top, bottom] = self.object;
        let mut span = whole;
        // Depth is positive, so a place is on this side of an edge where f·x − (edge − c)·z is, which is linear along the ray.
        let mut keep = |at: f32, per: f32| {
            if per > 0.0 {
                span[0] = span[0].max(-at / per);
            } else if per < 0.0 {
                span[1] = span[1].min(-at / per);
            } else if at < 0.0 {
                span = NOWHERE;
            }
        };
        let (x, y) = (left - beyond - c.cx, top - beyond - c.cy);
        keep(c.fx * n.x - x * n.z, c.fx * d.x - x * d.z);
        keep(c.fy * n.y - y * n.z, c.fy * d.y - y * d.z);
        let (x, y) = (right + beyond - c.cx, bottom + beyond - c.cy);
        keep(x * n.z - c.fx * n.x, x * d.z - c.fx * d.x);
        keep(y * n.z - c.fy * n.y, y * d.z - c.fy * d.y);
        span
    }
}

/// A part of a ray without points.
const NOWHERE: [f32; 2] = [f32::INFINITY, f32::NEG_INFINITY];

/// Pixels around the object that a rounded number may be off.
const ROUNDING: f32 = 0.05;

/// How far a point may be behind what photographs were found to show and still be taken for free: as uneven as that is.
const UNEVEN: f32 = 0.05;

/// Where pixels count that are not outside: least and greatest column, least and greatest row.
pub(super) fn extent(alpha: &[f32], width: usize) -> [f32; 4] {
    let mut extent = [
        f32::INFINITY,
        f32::NEG_INFINITY,
        f32::INFINITY,
        f32::NEG_INFINITY,
    ];
    for (i, a) in alpha.iter().enumerate() {
        if *a <= 0.0 {
            continue;
        }
        // Centres are half a pixel in, and neighbours reach a pixel from there.
        let (x, y) = ((i % width) as f32 + 0.5, (i / width) as f32 + 0.5);
        let reach = 1.0 + ROUNDING;
        extent[0] = extent[0].min(x - reach);
        extent[1] = extent[1].max(x + reach);
        extent[2] = extent[2].min(y - reach);
        extent[3] = extent[3].max(y + reach);
    }
    match extent[0] <= extent[1] {
        true => extent,
        // Nothing is on both sides of this.
        false => [1.0, -1.0, 1.0, -1.0],
    }
}

impl Reprojection {
    pub(super) fn lines(&self) -> Vec<Line> {
        let line = |source| Line {
            source,
            nearest: Vec3::ZERO,
            direction: Vec3::ZERO,
            at: None,
        };
        (0..self.sources.len()).map(line).collect()
    }

    pub(super) fn aim(&self, lines: &mut [Line], ray: &Ray) {
        for line in lines {
            let source = &self.sources[line.source];
            line.nearest = source.rotation * (ray.nearest - source.centre);
            line.direction = source.rotation * ray.direction;
        }
    }

    /// The part of a ray outside of which nothing is covered: some photograph shows it, and no object there.
    pub(super) fn covered(&self, ray: &Ray, lines: &[Line]) -> [f32; 2] {
        self.within(ray, lines, |_, _| 0.0)
    }

    /// The part of a ray that no photograph shows further from the object than `beyond` says, in its pixels: of its camera, and the
    /// least depth of the ray there.
    pub(super) fn within(
        &self,
        ray: &Ray,
        lines: &[Line],
        beyond: impl Fn(&Camera, f32) -> f32,
    ) -> [f32; 2] {
        let mut span = [-ray.reach, ray.reach];
        for line in lines {
            let source = &self.sources[line.source];
            let depth = line.nearest.z - ray.reach * line.direction.z.abs();
            let beyond = beyond(&source.camera, depth.max(1e-3));
            let own = source.span(line, ray.reach, beyond);
            span = [span[0].max(own[0]), span[1].min(own[1])];
            if span[0] > span[1] {
                return NOWHERE;
            }
        }
        span
    }

    /// What `look` makes of the rays of a view's pixels, which it is told by their numbers; rows side by side.
    pub(super) fn each_ray<T: Send>(
        &self,
        camera: &Camera,
        look: impl Fn(usize, &Ray, &mut [Line]) -> T + Sync,
    ) -> Vec<T> {
        let (origin, width) = (camera.centre(), camera.width.max(1));
        let row = |(y, row): (usize, &[Vec3])| -> Vec<T> {
            let mut lines = self.lines();
            let one = |(x, direction): (usize, &Vec3)| {
                let ray = Ray::new(origin, *direction);
                self.aim(&mut lines, &ray);
                look(y * width + x, &ray, &mut lines)
            };
            row.iter().enumerate().map(one).collect()
        };
        let directions = camera.directions();
        let rows = directions.par_chunks(width).enumerate();
        rows.flat_map_iter(row).collect()
    }

    /// Where a ray first meets something, from its point nearest to the origin on: that much coverage, or where no photograph shows
    /// before that nothing is there, what photographs have been found to show.
    pub(super) fn first(&self, ray: &Ray, wanted: f32, lines: &mut [Line]) -> Option<f32> {
        let entered = self.enters(ray, wanted, lines);
        entered.or_else(|| self.meets(ray, lines))
    }

    /// Where a ray first meets that much coverage, from its point nearest to the origin on; `None` also where no photograph shows
    /// before that nothing is there, so that the hull has no border.
    pub(super) fn enters(&self, ray: &Ray, wanted: f32, lines: &mut [Line]) -> Option<f32> {
        let [from, to] = self.covered(ray, lines);
        let mut last = None;
        for t in ray.points() {
            if t > to {
                break;
            }
            let coverage = match t < from {
                true => Some(0.0),
                false => self.coverage(t, lines),
            };
            match coverage {
                Some(coverage) if coverage > wanted => {
                    // Back to where coverage passes it.
                    let back = |(at, least)| (t - at) * (coverage - wanted) / (coverage - least);
                    return last.map(|last| t - back(last));
                }
                Some(coverage) => last = Some((t, coverage)),
                None => {}
            }
        }
        None
    }

    /// [`Self::coverage`] of what is well behind what photographs have been found to show.
    pub(super) fn solid(&self, t: f32, lines: &mut [Line]) -> f32 {
        match self.coverage(t, lines) {
            Some(coverage) if coverage > 0.0 && self.swept => {
                let free = self.ahead(t, lines).is_some_and(|ahead| ahead > -UNEVEN);
                if free { 0.0 } else { coverage }
            }
            coverage => coverage.unwrap_or(0.0),
        }
    }

    /// Least coverage of a point of a ray by the photographs that look there, 0 outside the hull; `None` where less than half of them
    /// look, which can hardly say that nothing is there. The photograph that says so comes first from then on: it will often
    /// say the same of the next point.
    pub(super) fn coverage(&self, t: f32, lines: &mut [Line]) -> Option<f32> {
        let (mut seeing, mut coverage) = (0, 1.0_f32);
        for i in 0..lines.len() {
            let line = &lines[i];
            let source = &self.sources[line.source];
            let Some(place) = source.place(line.point(t)) else {
                continue;
            };
            coverage = coverage.min(source.alpha(&source.around(place)));
            if coverage < OUTSIDE {
                lines.swap(0, i);
                return Some(0.0);
            }
            seeing += 1;
        }
        (2 * seeing >= lines.len()).then_some(coverage)
    }
}
