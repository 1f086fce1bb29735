//! Direct light on the visual hull: what the light of edits would make of white and of glossy surfaces there.
//!
//! Deng et al., DiLightNet (2024), give such pictures to a diffusion model as hints; here the shape is the hull, and the light
//! is that of the rays which the network is told anyhow.

use super::Reprojection;
use super::shadow::sorted;
use crate::Camera;
use crate::color::CURVE;
use crate::light::LightRay;
use glam::Vec3;
use rayon::prelude::*;
use std::f32::consts::PI;

/// Channels of [`Surface::lit`], in this order: radiance of a white diffuse surface under the lights, shadows by the hull included
/// (3); without shadows, mean of the channels; radiance of a glossy one (3); share of the light that is known. Radiance is over the
/// scene's illumination scale and display-encoded, as the network's own.
pub const DIRECT: usize = 8;

/// Coverage at which the hull begins.
const INSIDE: f32 = 0.3;
/// Neighbours each way, of whose places a normal is made: of a hull, and of a surface that was found, which is less even.
const NEIGHBOURS: [isize; 2] = [2, 5];
/// Distance of neighbours beyond which they are not of one surface.
const APART: f32 = 0.25;
/// Exponent of the glossy surface's lobe about the mirrored direction: as wide as the cells of the environment grid.
const SHARPNESS: i32 = 16;
/// Pixels that one thread takes at least.
const SPOTS: usize = 64;
/// Radiance beyond which a channel says no more.
const MOST: f32 = 8.0;

/// The hull as a camera sees it.
pub struct Surface<'a> {
    photographs: &'a Reprojection,
    pixels: usize,
    spots: Vec<Spot>,
}

/// A pixel's piece of the hull.
pub(super) struct Spot {
    pixel: usize,
    pub(super) place: Vec3,
    pub(super) normal: Vec3,
    /// From there on, what the camera sees mirrored.
    mirrored: Vec3,
}

impl Reprojection {
    /// The visual hull as a camera sees it, or the surface that was found where it has no border.
    #[must_use]
    pub fn surface(&self, camera: &Camera) -> Surface<'_> {
        let directions = camera.directions();
        let places = self.each_ray(camera, |_, ray, lines| {
            let t = self.first(ray, INSIDE, lines)?;
            Some(ray.nearest + t * ray.direction)
        });
        let neighbours = NEIGHBOURS[usize::from(self.swept)];
        let spot = |(pixel, direction): (usize, &Vec3)| {
            let place = places[pixel]?;
            let normal = normal(&places, pixel, camera.width, neighbours)?;
            // Toward the camera.
            let normal = if normal.dot(*direction) > 0.0 {
                -normal
            } else {
                normal
            };
            Some(Spot {
                pixel,
                place,
                normal,
                mirrored: *direction - 2.0 * direction.dot(normal) * normal,
            })
        };
        Surface {
            photographs: self,
            pixels: places.len(),
            spots: directions.iter().enumerate().filter_map(spot).collect(),
        }
    }
}

impl Surface<'_> {
    /// What lights do to it, `[DIRECT, h, w]`; zero off the surface. `rays` are all known lights' in model space, `scale` the scene's
    /// illumination scale g, and `share` how much of the light they are, in [0, 1].
    #[must_use]
    pub fn lit(&self, rays: &[LightRay], scale: [f64; 3], share: f32) -> Vec<f32> {
        let n = self.pixels;
        let mut channels = vec![0.0; DIRECT * n];
        if rays.is_empty() {
            return channels;
        }
        let inverse = scale.map(|g| if g > 0.0 { (1.0 / g) as f32 } else { 0.0 });
        // A channel without light looks as one with it does, so that colour stays exact in the others.
        let brighter = |a: &usize, b: &usize| scale[*a].total_cmp(&scale[*b]);
        let brightest = (0..3).max_by(brighter).unwrap_or_default();
        let (lamps, distant) = sorted(rays);
        let at = |lines: &mut Vec<super::Line>, spot: &Spot| -> [f32; DIRECT] {
            let (mut shadowed, mut open, mut glossy) = ([0.0_f32; 3], [0.0_f32; 3], [0.0_f32; 3]);
            let mut take = |toward: Vec3, irradiance: [f32; 3], visible: f32| {
                let diffuse = spot.normal.dot(toward).max(0.0) / PI;
                let lobe = spot.mirrored.dot(toward).max(0.0).powi(SHARPNESS);
                let lobe = lobe * (SHARPNESS + 1) as f32 / (2.0 * PI);
                for c in 0..3 {
                    open[c] += diffuse * irradiance[c];
                    shadowed[c] += visible * diffuse * irradiance[c];
                    glossy[c] += visible * lobe * irradiance[c];
                }
            };
            for ray in &distant {
                take(-ray.direction, ray.irradiance, 1.0);
            }
            for lamp in &lamps {
                let (toward, far, factor) = lamp.at(spot.place);
                let visible = match spot.normal.dot(toward) > 0.0 {
                    true => self.photographs.visible(spot, toward, far, lines),
                    false => 0.0,
                };
                take(toward, lamp.irradiance.map(|e| e * factor), visible);
            }
            let encoded = |values: &[f32; 3], c: usize| {
                let c = if inverse[c] > 0.0 { c } else { brightest };
                let radiance = (values[c] * inverse[c]).clamp(0.0, MOST);
                radiance.powf(1.0 / CURVE)
            };
            let mean = (0..3).map(|c| encoded(&open, c)).sum::<f32>() / 3.0;
            let [shadowed, glossy] = [&shadowed, &glossy].map(|v| [0, 1, 2].map(|c| encoded(v, c)));
            let ([r, g, b], [x, y, z]) = (shadowed, glossy);
            [r, g, b, mean, x, y, z, share]
        };
        let spots = self.spots.par_iter().with_min_len(SPOTS);
        let values = spots.map_init(|| self.photographs.lines(), at);
        let values: Vec<[f32; DIRECT]> = values.collect();
        for (spot, values) in self.spots.iter().zip(values) {
            for (c, value) in values.into_iter().enumerate() {
                channels[c * n + spot.pixel] = value;
            }
        }
        channels
    }
}

/// Normal of the surface that so many of a pixel's neighbours each way lie on, toward either side; `None` where there are too few.
fn normal(places: &[Option<Vec3>], pixel: usize, width: usize, n: isize) -> Option<Vec3> {
    let height = places.len() / width;
    let (x, y) = ((pixel % width) as isize, (pixel / width) as isize);
    let at = |dx: isize, dy: isize| -> Option<Vec3> {
        let (x, y) = (x + dx, y + dy);
        let inside = x >= 0 && y >= 0 && (x as usize) < width && (y as usize) < height;
        inside
            .then(|| places[y as usize * width + x as usize])
            .flatten()
    };
    let (mut along, mut down) = (Vec3::ZERO, Vec3::ZERO);
    for dy in -n..=n {
        for dx in -n..=n {
            let Some(here) = at(dx, dy) else { continue };
            let step = |next: Option<Vec3>| {
                let step = next.map(|next| next - here);
                step.filter(|s| s.length_squared() < APART * APART)
            };
            if dx < n {
                along += step(at(dx + 1, dy)).unwrap_or_default();
            }
            if dy < n {
                down += step(at(dx, dy + 1)).unwrap_or_default();
            }
        }
    }
    along.cross(down).try_normalize()
}

#[cfg(test)]
mod tests {
    use super::super::tests::{BALL, around, hit, of};
    use super::*;
    use crate::light::fibonacci_sphere;
    use crate::{DisplayImage, Light, Point, Sun};

    const SIDE: usize = 48;

    fn camera() -> Camera {
        Camera::orbit(0.4, 0.35, 2.6, 0.6, SIDE)
    }

    /// Where the ball shows, for pixels well inside its outline: pixel and normal.
    fn inner() -> Vec<(usize, Vec3)> {
        let camera = camera();
        let seen = |(i, d): (usize, Vec3)| {
            let (t, p) = hit(camera.centre(), d)?;
            let nearest = p - t * d;
            (nearest.length() < 0.7 * BALL).then(|| (i, p / BALL))
        };
        let directions = camera.directions().into_iter();
        directions.enumerate().filter_map(seen).collect()
    }

    fn decoded(channels: &[f32], c: usize, pixel: usize) -> f32 {
        channels[c * SIDE * SIDE + pixel].powf(CURVE)
    }

    fn one(value: f32) -> [f32; 3] {
        [value, 0.5 * value, 0.0]
    }

    #[test]
    fn a_distant_lamp_lights_a_ball_by_the_cosine_and_leaves_its_far_side_dark() {
        let photographs = of(&around());
        let surface = photographs.surface(&camera());
        let toward = Vec3::new(0.3, -0.9, 0.6).normalize();
        let distance = 50.0;
        let lamp = LightRay {
            origin: Some(distance * toward),
            direction: -toward,
            irradiance: one(PI),
        };
        let lit = surface.lit(&[lamp], [1.0; 3], 0.75);
        let (mut off, mut dark, mut bright) = (0.0_f32, 0, 0);
        let inner = inner();
        for (pixel, normal) in &inner {
            let expected = normal.dot(toward).max(0.0);
            off += (decoded(&lit, 0, *pixel) - expected).abs();
            if normal.dot(toward) < -0.3 {
                assert!(decoded(&lit, 0, *pixel) < 0.05);
                dark += 1;
            } else if expected > 0.3 {
                // A channel with half the light shows half of it.
                let [red, green, blue] = [0, 1, 2].map(|c| decoded(&lit, c, *pixel));
                assert!((green / red - 0.5).abs() < 0.01 && blue == 0.0);
                bright += 1;
            }
            assert!((lit[7 * SIDE * SIDE + pixel] - 0.75).abs() < 1e-6);
        }
        assert!(dark > 20 && bright > 100, "{dark} {bright}");
        let off = off / inner.len() as f32;
        assert!(off < 0.12, "off by {off} on average");
    }

    #[test]
    fn a_lamp_is_as_strong_as_its_distance_says_and_the_scale_divides_it() {
        let photographs = of(&around());
        let surface = photographs.surface(&camera());
        let toward = camera().centre().normalize();
        let lit = |power: f32, scale: f64| {
            let lamp = Light::Point(Point::new(6.0 * toward, power));
            let pattern = crate::light::RayPattern {
                local_rays: 8,
                ..Default::default()
            };
            surface.lit(&lamp.rays(&pattern), [scale; 3], 1.0)
        };
        let (one, four) = (lit(50.0, 0.5), lit(200.0, 2.0));
        let facing = |(_, a): &(usize, Vec3), (_, b): &(usize, Vec3)| {
            a.dot(toward).total_cmp(&b.dot(toward))
        };
        let (pixel, _) = inner().into_iter().max_by(facing).expect("pixel");
        assert!(decoded(&one, 0, pixel) > 0.0);
        assert!((decoded(&one, 0, pixel) / decoded(&four, 0, pixel) - 1.0).abs() < 1e-3);
        // Irradiance of a point light: I / d² at the surface, which faces it.
        let intensity = 50.0 / (4.0 * PI);
        let expected = intensity / (6.0 - BALL).powi(2) / PI / 0.5;
        let found = decoded(&one, 0, pixel);
        assert!(
            (found / expected - 1.0).abs() < 0.1,
            "{found} for {expected}"
        );
    }

    #[test]
    fn light_from_everywhere_makes_white_of_white_and_what_is_taken_away_is_gone() {
        let photographs = of(&around());
        let surface = photographs.surface(&camera());
        // Radiance 1 from all directions.
        let n = 400;
        let ray = |d: Vec3| LightRay {
            origin: None,
            direction: d,
            irradiance: [4.0 * PI / n as f32; 3],
        };
        let mut rays: Vec<LightRay> = fibonacci_sphere(n).into_iter().map(ray).collect();
        let lit = surface.lit(&rays, [1.0; 3], 1.0);
        for (pixel, _) in inner() {
            for c in [0, 3, 4] {
                let found = decoded(&lit, c, pixel);
                assert!((found - 1.0).abs() < 0.12, "channel {c}: {found}");
            }
        }
        let taken: Vec<LightRay> = rays
            .iter()
            .map(|ray| LightRay {
                irradiance: ray.irradiance.map(|e| -e),
                ..*ray
            })
            .collect();
        rays.extend(taken);
        let dark = surface.lit(&rays, [1.0; 3], 0.0);
        assert!(dark.iter().all(|v| *v < 1e-2));
    }

    #[test]
    fn one_thing_shadows_another() {
        // A small ball above the large one.
        let balls = [(Vec3::ZERO, BALL), (Vec3::new(0.0, 0.0, 0.8), 0.15)];
        let photograph = |camera: &Camera| {
            let meets = |d: Vec3| {
                balls.iter().any(|(centre, radius)| {
                    let o = camera.centre() - *centre;
                    (o - o.dot(d) * d).length() < *radius
                })
            };
            let mut image = DisplayImage::filled(camera.width, camera.height, [1.0; 3]);
            let alpha = camera.directions().into_iter();
            image.alpha = Some(alpha.map(|d| f32::from(u8::from(meets(d)))).collect());
            image
        };
        let cameras = around();
        let images: Vec<DisplayImage> = cameras.iter().map(photograph).collect();
        let photographs = Reprojection::new(images.iter().zip(&cameras));
        let camera = Camera::orbit(0.4, 0.9, 2.6, 0.7, SIDE);
        let surface = photographs.surface(&camera);
        let share = |light: &Light, place: Vec3| {
            let rays = light.rays(&crate::light::RayPattern::default());
            let lit = surface.lit(&rays, [1.0; 3], 1.0);
            let (x, y, _) = camera.project(place);
            let pixel = y as usize * SIDE + x as usize;
            decoded(&lit, 0, pixel) / decoded(&lit, 3, pixel)
        };
        // Toward the camera from the small ball, so that it does not hide them.
        let at = |angle: f32| {
            let side = Vec3::new(camera.centre().x, camera.centre().y, 0.0).normalize();
            BALL * (angle.sin() * side + angle.cos() * Vec3::Z)
        };
        for light in [
            Light::Point(Point::new(Vec3::new(0.0, 0.0, 3.0), 100.0)),
            Light::Sun(Sun::new(Vec3::Z, 1.0)),
        ] {
            let (under, aside) = (share(&light, at(0.15)), share(&light, at(0.9)));
            assert!(under < 0.3, "{under} of {light:?}");
            assert!(aside > 0.9, "{aside} of {light:?}");
        }
    }

    #[test]
    fn a_spot_lights_what_is_in_its_cone_as_a_point_does_and_nothing_else() {
        let photographs = of(&around());
        let surface = photographs.surface(&camera());
        let toward = camera().centre().normalize();
        // Its cone meets three tenths of the ball, each way.
        let place = 3.0 * toward;
        let half = (0.3 * BALL / (3.0 - BALL)).atan();
        let mut spot = crate::Spot::facing(place, Vec3::ZERO, 100.0);
        spot.angle = 2.0 * half.to_degrees();
        let point = Light::Point(spot.bulb());
        for pattern in [8, 64].map(|local_rays| crate::light::RayPattern {
            local_rays,
            ..Default::default()
        }) {
            let lit = |light: &Light| surface.lit(&light.rays(&pattern), [1.0; 3], 1.0);
            let (of_spot, of_point) = (lit(&Light::Spot(spot)), lit(&point));
            let (mut inside, mut outside) = (0, 0);
            for (pixel, normal) in inner() {
                let off = (BALL * normal - place).angle_between(-toward) / half;
                let share = decoded(&of_spot, 0, pixel) / decoded(&of_point, 0, pixel);
                if off < 0.7 {
                    assert!((share - 1.0).abs() < 0.25, "{share} at {off} of the cone");
                    inside += 1;
                } else if off > 1.3 {
                    assert!(share < 0.02, "{share} at {off} of the cone");
                    outside += 1;
                }
            }
            assert!(inside > 10 && outside > 10, "{inside} {outside}");
        }
    }
}
