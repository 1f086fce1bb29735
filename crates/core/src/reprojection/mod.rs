//! Photographs carried into another view by geometry alone: what classical image-based rendering knows of it.
//!
//! Along each pixel's ray, points that every photograph covers make the visual hull (Laurentini 1994). Of these, the first ones
//! that the photographs agree on are the surface, as in space carving (Kutulakos and Seitz 2000), and its colour is theirs,
//! weighted by angle (unstructured lumigraph, Buehler et al. 2001); those from whose side the hull hides the point hardly
//! count. Where no silhouette bounds the hull, since photographs have no alpha or show a ground to their edges, the surface is where
//! the distances say that each photograph is found to look, by comparing it with others.

mod depth;
mod direct;
mod margins;
mod ray;
mod seen;
mod shadow;

pub use direct::{DIRECT, Surface};
pub use margins::MARGINS;

use crate::{Camera, DisplayImage, Error, Result};
use glam::{Mat3, Vec3, Vec4};
use ray::{Line, Ray};

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
const OPACITY: f32 = 0.9;
/// Variance of colours beyond the least on a ray at which points count little, where the hull has no border.
const SWEPT: f32 = 0.002;
/// Coverage under which a point is outside.
const OUTSIDE: f32 = 0.02;

/// Posed photographs, ready to be looked up.
#[derive(Clone, Debug)]
pub struct Reprojection {
    sources: Vec<Source>,
    /// Whether some of them look past every silhouette, so far that it was found out how far.
    swept: bool,
}

#[derive(Clone, Debug)]
struct Source {
    camera: Camera,
    /// World to camera.
    rotation: Mat3,
    centre: Vec3,
    /// Display-encoded, premultiplied.
    pixels: Vec<[f32; 4]>,
    /// Distance of what is seen along each pixel's ray: the hull, or where it has no border, what [`depth`] finds; infinite where
    /// there is nothing, or nothing is known.
    hull: Vec<f32>,
    /// How far each pixel is inside the silhouette, in pixels; negative outside.
    inside: Vec<f32>,
    /// Least and greatest column, least and greatest row of places at which alpha may be more than nothing.
    object: [f32; 4],
}

impl Source {
    fn new(pixels: Vec<[f32; 4]>, camera: &Camera) -> Self {
        let alpha: Vec<f32> = pixels.iter().map(|p| p[3]).collect();
        Self {
            camera: *camera,
            rotation: Mat3::from_mat4(camera.camera_to_world).transpose(),
            centre: camera.centre(),
            inside: margins::inside(&alpha, camera.width),
            object: ray::extent(&alpha, camera.width),
            hull: vec![f32::INFINITY; pixels.len()],
            pixels,
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

    fn colour(&self, around: &([usize; 4], [f32; 4])) -> [f32; 3] {
        self.texel(around).truncate().to_array()
    }

    /// Colour times alpha, and alpha.
    fn texel(&self, (pixels, shares): &([usize; 4], [f32; 4])) -> Vec4 {
        let parts = pixels.iter().zip(shares);
        parts.fold(Vec4::ZERO, |sum, (i, share)| {
            sum + *share * Vec4::from_array(self.pixels[*i])
        })
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
        let mut all = Self {
            sources,
            swept: false,
        };
        let hulls: Vec<Vec<f32>> = all.sources.iter().map(|s| all.hull(s)).collect();
        for (source, hull) in all.sources.iter_mut().zip(hulls) {
            source.hull = hull;
        }
        all.find_depths();
        all
    }

    /// The photographs' pixels, `[v, h, w, 4]`: display-encoded colour times alpha, alpha.
    #[must_use]
    pub fn values(&self) -> Vec<f32> {
        let pixels = self.sources.iter().flat_map(|source| &source.pixels);
        pixels.flatten().copied().collect()
    }

    /// Where a photograph sees the visual hull, or what it was found to show where no silhouette bounds that, for each of its pixels:
    /// distance along the ray from its point nearest to the origin; 0 where there is none.
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

    /// Distance of the visual hull along the rays of a photograph's pixels; infinite where they meet none, or one without a border.
    fn hull(&self, source: &Source) -> Vec<f32> {
        self.each_ray(&source.camera, |pixel, ray, lines| {
            if source.pixels[pixel][3] < OUTSIDE {
                return f32::INFINITY;
            }
            let first = self.enters(ray, 0.5, lines);
            first.map_or(f32::INFINITY, |t| ray.to_nearest + t)
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

    /// Photographs without silhouettes, by the place that each ray meets.
    pub(super) fn filled(
        cameras: &[Camera],
        colour: impl Fn(Vec3) -> [f32; 3],
        meets: impl Fn(Vec3, Vec3) -> Vec3,
    ) -> Reprojection {
        let photograph = |camera: &Camera| {
            let meets = |d| meets(camera.centre(), d);
            let mut image = DisplayImage::filled(camera.width, camera.height, [0.0; 3]);
            for (pixel, d) in image.pixels.iter_mut().zip(camera.directions()) {
                *pixel = colour(meets(d));
            }
            image
        };
        let images: Vec<DisplayImage> = cameras.iter().map(photograph).collect();
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
