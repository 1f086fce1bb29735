//! Photographs carried into another view by geometry alone: what classical image-based rendering knows of it.
//!
//! Along each pixel's ray, points that every photograph covers make the visual hull (Laurentini 1994). Of these, the first ones
//! that the photographs agree on are the surface, as in space carving (Kutulakos and Seitz 2000), and its colour is theirs,
//! weighted by angle (unstructured lumigraph, Buehler et al. 2001); those from whose side the hull hides the point hardly
//! count. Without alpha the hull is what all photographs see.

mod direct;
mod margins;

pub use direct::{DIRECT, Surface};
pub use margins::MARGINS;

use crate::{Camera, DisplayImage, Error, Result};
use glam::{Mat3, Vec3};
use rayon::prelude::*;

/// Channels of [`Reprojection::seen_by`]: those of the surface, then the [`MARGINS`] of the silhouettes, then for each of the
/// [`NEAREST`] photographs that count most at the surface its [`OF_NEAREST`], then for each of the [`SLICES`] of the ray
/// [`OF_SLICE`].
pub const CHANNELS: usize = SURFACE + MARGINS + NEAREST * OF_NEAREST + SLICES * OF_SLICE;

/// Of the surface, in this order: display-encoded colour times coverage (3), coverage in [0, 1], distance of the surface along the
/// ray from its point nearest to the origin, times coverage; standard deviation of that distance; standard deviation of the
/// photographs' colours there; cosine of the angle to the nearest photograph, times coverage.
pub const SURFACE: usize = 8;

/// Photographs whose own colours are given.
pub const NEAREST: usize = 3;

/// Of each of them: by how much its colour differs from the surface's, times coverage (3); how much it counts, and its alpha.
pub const OF_NEAREST: usize = 5;

/// Equal parts of a ray, from the near end to the far one.
pub const SLICES: usize = 8;

/// Of each of them: means over its points of coverage, and of coverage times the standard deviation of the photographs' colours
/// as far as they see it.
pub const OF_SLICE: usize = 2;

/// Channels of the nearest photographs and of the slices.
const OTHERS: usize = NEAREST * OF_NEAREST + SLICES * OF_SLICE;

/// How many times finer than the cameras that are given photographs may be at most, each way.
pub const FINEST: usize = 16;

/// Points along a ray.
const POINTS: usize = 24;
/// Radius of the ball whose rays are searched from one side to the other.
const RADIUS: f32 = 1.1;
/// Rays are searched this far at least, each way from their point nearest to the origin: grounds and walls go on beyond.
const REACH: f32 = 0.5;
/// 1 − cos of the angle at which a photograph has a quarter of the weight that it has from its own place.
const ANGLE: f32 = 0.05;
/// How far behind the hull's surface, as a photograph sees it, a point may be and still count as seen by it.
const SLACK: f32 = 0.15;
/// Factor of a photograph's weight where the point is further behind.
const HIDDEN: f32 = 0.1;
/// Standard deviation of colours at which photographs no longer agree.
const AGREEMENT: f32 = 0.2;
/// Opacity of a point on which they agree wholly.
const OPACITY: f32 = 0.6;
/// Coverage under which a point is outside.
const OUTSIDE: f32 = 0.02;

/// Posed photographs, ready to be looked up.
#[derive(Clone, Debug)]
pub struct Reprojection {
    sources: Vec<Source>,
}

#[derive(Clone, Debug)]
struct Source {
    camera: Camera,
    /// World to camera.
    rotation: Mat3,
    centre: Vec3,
    /// Display-encoded, premultiplied.
    pixels: Vec<[f32; 4]>,
    /// Distance of the hull along each pixel's ray; infinite where it meets none.
    hull: Vec<f32>,
    /// How far each pixel is inside the silhouette, in pixels; negative outside.
    inside: Vec<f32>,
}

impl Source {
    fn new(pixels: Vec<[f32; 4]>, camera: &Camera) -> Self {
        let alpha: Vec<f32> = pixels.iter().map(|p| p[3]).collect();
        Self {
            camera: *camera,
            rotation: Mat3::from_mat4(camera.camera_to_world).transpose(),
            centre: camera.centre(),
            inside: margins::inside(&alpha, camera.width),
            pixels,
            hull: Vec::new(),
        }
    }

    /// Where a point given in the camera's axes shows, if it does.
    fn place(&self, p: Vec3) -> Option<[f32; 2]> {
        let c = &self.camera;
        if p.z < 1e-3 {
            return None;
        }
        let inverse = 1.0 / p.z;
        let (x, y) = (c.fx * p.x * inverse + c.cx, c.fy * p.y * inverse + c.cy);
        let inside = x >= 0.0 && y >= 0.0 && x < c.width as f32 && y < c.height as f32;
        inside.then_some([x, y])
    }

    /// The pixels around a place and their bilinear shares; the outermost pixels reach to the border.
    fn around(&self, [x, y]: [f32; 2]) -> ([usize; 4], [f32; 4]) {
        let c = &self.camera;
        let split = |v: f32, n: usize| {
            let v = (v - 0.5).clamp(0.0, (n - 1) as f32);
            let i = (v as usize).min(n.saturating_sub(2));
            (i, (i + 1).min(n - 1), v - i as f32)
        };
        let (x0, x1, fx) = split(x, c.width);
        let (y0, y1, fy) = split(y, c.height);
        let (top, bottom) = (y0 * c.width, y1 * c.width);
        let (gx, gy) = (1.0 - fx, 1.0 - fy);
        (
            [top + x0, top + x1, bottom + x0, bottom + x1],
            [gy * gx, gy * fx, fy * gx, fy * fx],
        )
    }

    /// How much a photograph's colour of a point counts, given in its camera's axes and seen by it at `place`, for a ray in the
    /// same axes; and the cosine between that ray and the photograph's own.
    fn weight(&self, point: Vec3, direction: Vec3, [x, y]: [f32; 2]) -> (f32, f32) {
        let cosine = point.normalize_or_zero().dot(direction);
        let weight = (ANGLE / (ANGLE + 1.0 - cosine)).powi(2);
        let hidden =
            point.length() > self.hull[y as usize * self.camera.width + x as usize] + SLACK;
        (if hidden { weight * HIDDEN } else { weight }, cosine)
    }

    fn alpha(&self, (pixels, shares): &([usize; 4], [f32; 4])) -> f32 {
        let parts = pixels.iter().zip(shares);
        parts.map(|(i, share)| share * self.pixels[*i][3]).sum()
    }

    fn colour(&self, (pixels, shares): &([usize; 4], [f32; 4])) -> [f32; 3] {
        let mut sum = [0.0; 3];
        for (i, share) in pixels.iter().zip(shares) {
            for (sum, value) in sum.iter_mut().zip(self.pixels[*i]) {
                *sum += share * value;
            }
        }
        sum
    }
}

/// Display-encoded, premultiplied pixels of a view, over white.
fn over_white(pixels: &[[f32; 4]], camera: &Camera) -> DisplayImage {
    let shown = |p: &[f32; 4]| [0, 1, 2].map(|c| p[c] + 1.0 - p[3]);
    DisplayImage {
        width: camera.width,
        height: camera.height,
        pixels: pixels.iter().map(shown).collect(),
        alpha: Some(pixels.iter().map(|p| p[3]).collect()),
    }
}

/// A ray that is searched.
struct Ray {
    /// Its point nearest to the origin, and how far that is from where it begins.
    nearest: Vec3,
    to_nearest: f32,
    direction: Vec3,
    /// How far it is searched, each way from there.
    reach: f32,
}

impl Ray {
    fn new(origin: Vec3, direction: Vec3) -> Self {
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
    fn points(&self) -> impl ExactSizeIterator<Item = f32> + use<> {
        let (reach, step) = (self.reach, 2.0 * self.reach / POINTS as f32);
        (0..POINTS).map(move |k| step * (k as f32 + 0.5) - reach)
    }
}

/// A ray as one of the photographs sees it: its point nearest to the origin and its direction, in the camera's axes.
struct Line {
    source: usize,
    nearest: Vec3,
    direction: Vec3,
}

/// What the photographs make of one point.
struct Seen {
    colour: [f32; 3],
    variance: f32,
    coverage: f32,
    closeness: f32,
}

impl Reprojection {
    /// Of photographs and their cameras in a space in which the scene lies in the unit ball.
    ///
    /// # Panics
    /// If a photograph is not of its camera's size.
    #[must_use]
    pub fn new<'a>(views: impl IntoIterator<Item = (&'a DisplayImage, &'a Camera)>) -> Self {
        let source = |(image, camera): (&DisplayImage, &Camera)| {
            assert_eq!(
                (image.width, image.height),
                (camera.width, camera.height),
                "a photograph and its camera must have one size"
            );
            let pixel = |(i, rgb): (usize, &[f32; 3])| {
                let alpha = image.alpha.as_ref().map_or(1.0, |a| a[i].clamp(0.0, 1.0));
                let [r, g, b] = rgb.map(|v| (v - (1.0 - alpha)).clamp(0.0, alpha));
                [r, g, b, alpha]
            };
            let pixels = image.pixels.iter().enumerate().map(pixel);
            Source::new(pixels.collect(), camera)
        };
        Self::of(views.into_iter().map(source).collect())
    }

    fn of(sources: Vec<Source>) -> Self {
        let mut all = Self { sources };
        let hulls: Vec<Vec<f32>> = all.sources.iter().map(|s| all.hull(s)).collect();
        for (source, hull) in all.sources.iter_mut().zip(hulls) {
            source.hull = hull;
        }
        all
    }

    /// The photographs' pixels, `[v, h, w, 4]`: display-encoded colour times alpha, alpha.
    #[must_use]
    pub fn values(&self) -> Vec<f32> {
        let pixels = self.sources.iter().flat_map(|source| &source.pixels);
        pixels.flatten().copied().collect()
    }

    /// Where a photograph sees the visual hull, for each of its pixels: distance along the ray from its point nearest to the
    /// origin; 0 where there is none.
    #[must_use]
    pub fn depths(&self, photograph: usize) -> Vec<f32> {
        let source = &self.sources[photograph];
        let directions = source.camera.directions().into_iter();
        let depth = |(direction, hull): (Vec3, &f32)| match hull.is_finite() {
            true => hull + source.centre.dot(direction),
            false => 0.0,
        };
        directions.zip(&source.hull).map(depth).collect()
    }

    /// The photographs, over white.
    #[must_use]
    pub fn images(&self) -> Vec<DisplayImage> {
        let sources = self.sources.iter();
        sources.map(|s| over_white(&s.pixels, &s.camera)).collect()
    }

    /// The picture in what [`Self::seen_by`] sees, over white.
    #[must_use]
    pub fn picture(&self, camera: &Camera) -> DisplayImage {
        let (seen, n) = (self.seen_by(camera, 1), camera.width * camera.height);
        let pixel = |i: usize| std::array::from_fn(|c| seen[c * n + i]);
        over_white(&(0..n).map(pixel).collect::<Vec<_>>(), camera)
    }

    /// From what [`Self::values`] gave and the cameras, whose sides may be a whole fraction of the photographs'.
    ///
    /// # Errors
    /// If they are not as many as the cameras' pixels ask for, or one is not in [0, 1].
    pub fn from_values(values: &[f32], cameras: &[Camera]) -> Result<Self> {
        let (pixels, rest) = values.as_chunks::<4>();
        let size = |camera: &Camera| camera.width * camera.height;
        let given: usize = cameras.iter().map(size).sum();
        let finer = (1..=FINEST).find(|k| given > 0 && pixels.len() == k * k * given);
        let cameras: Vec<Camera> = cameras
            .iter()
            .map(|c| c.resized(c.width * finer.unwrap_or(1), c.height * finer.unwrap_or(1)))
            .collect();
        let expected: usize = cameras.iter().map(size).sum();
        let fits = finer.is_some() && rest.is_empty();
        if !fits || values.iter().any(|v| !(0.0..=1.0).contains(v)) {
            let found = values.len();
            let expected = format!(
                "expected {} numbers in [0, 1], four for each pixel of {} views, found {found} numbers",
                4 * expected,
                cameras.len()
            );
            return Err(Error::value("photographs", expected));
        }
        let mut pixels = pixels;
        let source = |camera: &Camera| {
            let (own, rest) = pixels.split_at(size(camera));
            pixels = rest;
            Source::new(own.to_vec(), camera)
        };
        Ok(Self::of(cameras.iter().map(source).collect()))
    }

    /// Distance of the visual hull along the rays of a photograph's pixels; infinite where they meet none.
    fn hull(&self, source: &Source) -> Vec<f32> {
        self.each_ray(&source.camera, |pixel, ray, lines| {
            if source.pixels[pixel][3] < OUTSIDE {
                return f32::INFINITY;
            }
            let first = self.first(ray, 0.5, lines);
            first.map_or(f32::INFINITY, |t| ray.to_nearest + t)
        })
    }

    /// Where a ray first meets that much coverage, from its point nearest to the origin on.
    fn first(&self, ray: &Ray, wanted: f32, lines: &mut [Line]) -> Option<f32> {
        let mut last = None;
        for t in ray.points() {
            let coverage = self.coverage(t, lines);
            if coverage > wanted {
                // Back to where coverage passes it.
                let back = |(at, least)| (t - at) * (coverage - wanted) / (coverage - least);
                return Some(t - last.map_or(0.0, back));
            }
            last = Some((t, coverage));
        }
        None
    }

    fn lines(&self) -> Vec<Line> {
        let line = |source| Line {
            source,
            nearest: Vec3::ZERO,
            direction: Vec3::ZERO,
        };
        (0..self.sources.len()).map(line).collect()
    }

    fn aim(&self, lines: &mut [Line], ray: &Ray) {
        for line in lines {
            let source = &self.sources[line.source];
            line.nearest = source.rotation * (ray.nearest - source.centre);
            line.direction = source.rotation * ray.direction;
        }
    }

    /// A view of them, `[CHANNELS, h, w]`; zero where nothing is. Margins are counted in pixels `finer` times as large as the camera's:
    /// those of the pictures that a network has learnt on, where these are finer.
    #[must_use]
    pub fn seen_by(&self, camera: &Camera, finer: usize) -> Vec<f32> {
        let pixel = finer as f32 / camera.fx;
        let seen = self.each_ray(camera, |_, ray, lines| {
            let mut values = [0.0; CHANNELS];
            let margins = self.margins(ray, pixel, lines);
            values[SURFACE..SURFACE + MARGINS].copy_from_slice(&margins);
            if let Some((surface, others)) = self.along(ray, lines) {
                values[..SURFACE].copy_from_slice(&surface);
                values[SURFACE + MARGINS..].copy_from_slice(&others);
            }
            values
        });
        let mut channels = vec![0.0; CHANNELS * seen.len()];
        for (i, values) in seen.iter().enumerate() {
            for (c, value) in values.iter().enumerate() {
                channels[c * seen.len() + i] = *value;
            }
        }
        channels
    }

    /// What `look` makes of the rays of a view's pixels, which it is told by their numbers; rows side by side.
    fn each_ray<T: Send>(
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

    /// The channels of the surface, and those of the nearest photographs and of the slices.
    fn along(&self, ray: &Ray, lines: &mut [Line]) -> Option<([f32; SURFACE], [f32; OTHERS])> {
        let (mut surface, mut others) = ([0.0; SURFACE], [0.0; OTHERS]);
        let (nearest, slices) = others.split_at_mut(NEAREST * OF_NEAREST);
        let (mut left, mut coverage, mut whole) = (1.0_f32, 0.0_f32, 0.0_f32);
        let mut sum = [0.0_f32; 3];
        let (mut depth, mut depth_squared, mut variance, mut closeness) = (0.0, 0.0, 0.0, 0.0);
        for (k, t) in ray.points().enumerate() {
            let slice = &mut slices[k / (POINTS / SLICES) * OF_SLICE..][..OF_SLICE];
            let within = self.coverage(t, lines);
            let share = within * SLICES as f32 / POINTS as f32;
            slice[0] += share;
            // What lies behind the surface no photograph shows.
            let visible = left >= 0.02 && within > 0.0;
            let Some(seen) = visible.then(|| self.point(t, within, lines)).flatten() else {
                continue;
            };
            slice[1] += share * seen.variance.sqrt();
            coverage = coverage.max(seen.coverage);
            let agree = (-seen.variance / (2.0 * AGREEMENT * AGREEMENT)).exp();
            // Not nothing, so that a ray on which none agree has a colour as well.
            let weight = left * seen.coverage * OPACITY * agree.max(1e-3);
            left -= weight;
            whole += weight;
            for (sum, c) in sum.iter_mut().zip(seen.colour) {
                *sum += weight * c;
            }
            depth += weight * t;
            depth_squared += weight * t * t;
            variance += weight * seen.variance;
            closeness += weight * seen.closeness;
        }
        if whole <= 0.0 {
            return None;
        }
        let colour = sum.map(|c| c / whole);
        let mean = depth / whole;
        surface[..3].copy_from_slice(&colour.map(|c| coverage * c));
        surface[3..].copy_from_slice(&[
            coverage,
            coverage * mean,
            (depth_squared / whole - mean * mean).max(0.0).sqrt(),
            (variance / whole).sqrt(),
            coverage * closeness / whole,
        ]);
        self.nearest(mean, lines, nearest, |c, own| coverage * (own - colour[c]));
        Some((surface, others))
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
            let point = line.nearest + t * line.direction;
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

    /// Least coverage of a point of a ray by the photographs that look there; 0 outside the hull, and where less than half of them
    /// look. The photograph that says so comes first from then on: it will often say the same of the next point.
    fn coverage(&self, t: f32, lines: &mut [Line]) -> f32 {
        let (mut seeing, mut coverage) = (0, 1.0_f32);
        for i in 0..lines.len() {
            let line = &lines[i];
            let source = &self.sources[line.source];
            let Some(place) = source.place(line.nearest + t * line.direction) else {
                continue;
            };
            coverage = coverage.min(source.alpha(&source.around(place)));
            if coverage < OUTSIDE {
                lines.swap(0, i);
                return 0.0;
            }
            seeing += 1;
        }
        // Where few photographs look, few can say that nothing is there.
        if 2 * seeing < lines.len() {
            return 0.0;
        }
        coverage
    }

    /// Colours at a point of a ray inside the hull; `None` if no photograph's counts.
    fn point(&self, t: f32, coverage: f32, lines: &[Line]) -> Option<Seen> {
        let (mut whole, mut sum, mut squares, mut closest) = (0.0, [0.0; 3], 0.0, -1.0_f32);
        for line in lines.iter() {
            let source = &self.sources[line.source];
            let point = line.nearest + t * line.direction;
            let Some(place) = source.place(point) else {
                continue;
            };
            let (weight, cosine) = source.weight(point, line.direction, place);
            closest = closest.max(cosine);
            let around = source.around(place);
            let alpha = source.alpha(&around);
            whole += weight;
            for (sum, c) in sum.iter_mut().zip(source.colour(&around)) {
                let c = c / alpha;
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
            coverage,
            closeness: closest,
        })
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    pub(super) const BALL: f32 = 0.5;

    /// Where a ray meets the ball, from its point nearest to the origin on.
    pub(super) fn hit(origin: Vec3, d: Vec3) -> Option<(f32, Vec3)> {
        let nearest = origin - origin.dot(d) * d;
        let inside = BALL * BALL - nearest.length_squared();
        let t = -inside.max(0.0).sqrt();
        (inside > 0.0).then_some((t, nearest + t * d))
    }

    /// A ball, coloured by place and smoothly.
    fn colour(p: Vec3) -> Vec3 {
        0.5 + 0.3 * p / BALL
    }

    fn photograph(camera: &Camera) -> DisplayImage {
        let mut image = DisplayImage::filled(camera.width, camera.height, [1.0; 3]);
        let mut alpha = vec![0.0; image.pixels.len()];
        let pixels = image.pixels.iter_mut().zip(&mut alpha);
        for ((pixel, alpha), d) in pixels.zip(camera.directions()) {
            if let Some((_, p)) = hit(camera.centre(), d) {
                (*pixel, *alpha) = (colour(p).to_array(), 1.0);
            }
        }
        image.alpha = Some(alpha);
        image
    }

    pub(super) fn around() -> Vec<Camera> {
        let camera = |i: usize| {
            let elevation = [0.2, 0.7, -0.3][i % 3];
            Camera::orbit(i as f32 * 0.785, elevation, 2.75, 0.6, 48)
        };
        (0..8).map(camera).collect()
    }

    pub(super) fn of(cameras: &[Camera]) -> Reprojection {
        let images: Vec<_> = cameras.iter().map(photograph).collect();
        Reprojection::new(images.iter().zip(cameras))
    }

    #[test]
    fn a_ball_is_seen_where_it_is_and_in_its_colours() {
        let photographs = of(&around());
        let camera = Camera::orbit(0.4, 0.35, 2.6, 0.6, 48);
        let seen = photographs.seen_by(&camera, 1);
        let n = 48 * 48;
        let (mut inside, mut outside) = (0, 0);
        for (i, d) in camera.directions().into_iter().enumerate() {
            let [r, g, b, coverage, depth, _, disagreement, closeness] =
                std::array::from_fn(|c| seen[c * n + i]);
            let nearest = (camera.centre() - camera.centre().dot(d) * d).length();
            if nearest > 1.3 * BALL {
                assert!(coverage < 0.05, "{coverage} at {nearest}");
                outside += 1;
            }
            if nearest > 0.7 * BALL {
                continue;
            }
            let (t, p) = hit(camera.centre(), d).unwrap();
            assert!(coverage > 0.99);
            // Points are 0.09 apart, and the second one counts as well.
            assert!((depth - t).abs() < 0.18, "{depth} for {t}");
            let off = (Vec3::new(r, g, b) - colour(p)).abs().max_element();
            assert!(off < 0.06, "off by {off}");
            assert!(disagreement < 0.1 && closeness > 0.8);
            inside += 1;
        }
        assert!(inside > 100 && outside > 100);
    }

    #[test]
    fn a_photograph_is_seen_from_its_own_camera() {
        let cameras = around();
        let photographs = of(&cameras);
        let (image, seen) = (photograph(&cameras[2]), photographs.seen_by(&cameras[2], 1));
        let n = 48 * 48;
        let off: f32 = (0..n)
            .filter(|i| image.alpha.as_ref().unwrap()[*i] > 0.0 && seen[3 * n + i] > 0.99)
            .map(|i| (seen[i] - image.pixels[i][0]).abs())
            .fold(0.0, f32::max);
        assert!(off < 0.06, "off by {off}");
    }

    #[test]
    fn values_give_the_same_photographs_back() {
        let cameras = around();
        let photographs = of(&cameras);
        let values = photographs.values();
        let again = Reprojection::from_values(&values, &cameras).unwrap();
        let camera = Camera::orbit(1.1, 0.1, 2.6, 0.6, 16);
        assert_eq!(again.seen_by(&camera, 1), photographs.seen_by(&camera, 1));
        let short = Reprojection::from_values(&values[4..], &cameras);
        let error = short.unwrap_err().to_string();
        assert!(
            error.contains("photographs") && error.contains("8 views"),
            "{error}"
        );
        let mut wild = values;
        wild[7] = f32::NAN;
        assert!(Reprojection::from_values(&wild, &cameras).is_err());
    }
}
