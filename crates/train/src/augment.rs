//! Changes that light transport does not notice, so that what is rendered once is seen in many ways.

use lumi_core::glam::{Mat3, Vec3};
use lumi_core::light::LightRay;
use lumi_core::seed::Rng;
use lumi_core::{Camera, Light, LinearImage, Similarity};
use rand::RngExt;
use rand::seq::SliceRandom;
use std::f32::consts::TAU;

/// A change of the whole world, the same for all views and lights of a sample: turned about z, mirrored or not, colour
/// channels exchanged.
pub struct World {
    /// Where things go; with a reflection where it is mirrored.
    motion: Similarity,
    mirrored: bool,
    channels: [usize; 3],
}

impl World {
    /// The world as it is.
    #[must_use]
    pub fn as_rendered() -> Self {
        Self {
            motion: Similarity::IDENTITY,
            mirrored: false,
            channels: [0, 1, 2],
        }
    }

    /// Any of them.
    pub fn draw(rng: &mut Rng) -> Self {
        let turn = Mat3::from_rotation_z(rng.random::<f32>() * TAU);
        let mirrored = rng.random::<bool>();
        let mirror = if mirrored { -1.0 } else { 1.0 };
        let mut channels = [0, 1, 2];
        channels.shuffle(rng);
        Self {
            motion: Similarity {
                rotation: turn * Mat3::from_diagonal(Vec3::new(1.0, mirror, 1.0)),
                ..Similarity::IDENTITY
            },
            mirrored,
            channels,
        }
    }

    /// A camera in it. Mirrored, it would be left-handed, so its pictures are turned over instead ([`Self::picture`]).
    #[must_use]
    pub fn camera(&self, camera: &Camera) -> Camera {
        let mut moved = camera.transformed(&self.motion);
        if self.mirrored {
            moved.camera_to_world.x_axis *= -1.0;
            moved.cx = moved.width as f32 - moved.cx;
        }
        moved
    }

    /// What [`Self::camera`] sees of it, by what the camera saw.
    #[must_use]
    pub fn picture(&self, mut image: LinearImage) -> LinearImage {
        if self.mirrored {
            let rows = image.pixels.chunks_exact_mut(image.width.max(1));
            rows.for_each(<[_]>::reverse);
        }
        for pixel in &mut image.pixels {
            let [r, g, b] = self.channels.map(|c| pixel[c]);
            *pixel = [r, g, b, pixel[3]];
        }
        image
    }

    /// A light in it; its colours are exchanged in its rays ([`Self::ray`]).
    #[must_use]
    pub fn light(&self, light: &Light) -> Light {
        light.transformed(&self.motion)
    }

    /// A ray of [`Self::light`] with its colours exchanged.
    #[must_use]
    pub fn ray(&self, ray: LightRay) -> LightRay {
        LightRay {
            irradiance: self.channels.map(|c| ray.irradiance[c]),
            ..ray
        }
    }
}

/// A view, moved by whole pixels to the right and down, together with its principal point.
pub struct Shot {
    /// The view's number.
    pub view: usize,
    by: [i32; 2],
}

impl Shot {
    /// `view`, moved by at most `most` pixels each way.
    pub fn draw(view: usize, most: usize, rng: &mut Rng) -> Self {
        let most = most as i32;
        let by = [(); 2].map(|()| rng.random_range(-most..=most));
        Self { view, by }
    }

    /// Its camera, by the view's.
    #[must_use]
    pub fn camera(&self, camera: &Camera) -> Camera {
        Camera {
            cx: camera.cx + self.by[0] as f32,
            cy: camera.cy + self.by[1] as f32,
            ..*camera
        }
    }

    /// Its picture, by the view's. What comes in from outside is empty, as behind the object.
    #[must_use]
    pub fn picture(&self, image: &LinearImage) -> LinearImage {
        let (w, h) = (image.width as i32, image.height as i32);
        let [right, down] = self.by;
        let pixel = |y: i32, x: i32| {
            let (y, x) = (y - down, x - right);
            let inside = (0..h).contains(&y) && (0..w).contains(&x);
            inside.then(|| image.pixels[(y * w + x) as usize])
        };
        let rows = (0..h).flat_map(|y| (0..w).map(move |x| (y, x)));
        LinearImage {
            pixels: rows.map(|(y, x)| pixel(y, x).unwrap_or([0.0; 4])).collect(),
            ..*image
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use lumi_core::Seed;

    #[test]
    fn a_moved_picture_shows_the_same_along_its_rays() {
        let mut image = LinearImage::new(5, 4);
        image.pixels[5 + 2] = [0.1, 0.2, 0.3, 0.8];
        let by = [2, -1];
        let shot = Shot { view: 0, by };
        let mut expected = LinearImage::new(5, 4);
        expected.pixels[4] = [0.1, 0.2, 0.3, 0.8];
        assert_eq!(shot.picture(&image), expected);
        let camera = Camera::orbit(0.3, 0.4, 2.75, 0.87, 5);
        let ray = shot.camera(&camera).direction(4.5, 0.5);
        assert!((ray - camera.direction(2.5, 1.5)).length() < 1e-6);
    }

    #[test]
    fn a_changed_world_looks_as_its_rays_say() {
        // Far away, the world has the colour of each direction.
        let colour = |d: Vec3| (0.5 + 0.5 * d).extend(1.0).to_array();
        let mut camera = Camera::orbit(0.7, 0.4, 2.75, 0.87, 6);
        (camera.cx, camera.cy) = (2.0, 3.5);
        let mut image = LinearImage::new(6, 6);
        image.pixels = camera.directions().into_iter().map(colour).collect();
        let mut mirrored = 0;
        for i in 0..8 {
            let world = World::draw(&mut Seed(i).stream("world"));
            mirrored += usize::from(world.mirrored);
            let moved = world.camera(&camera);
            moved.validate().expect("a camera like any other");
            let shown = world.picture(image.clone());
            for (d, seen) in moved.directions().into_iter().zip(&shown.pixels) {
                let before = colour(world.motion.rotation.transpose() * d);
                for (k, &c) in world.channels.iter().enumerate() {
                    assert!((seen[k] - before[c]).abs() < 1e-5);
                }
            }
            // The point that the camera stands at goes with the lights.
            let there = world.motion.point(camera.centre());
            assert!((moved.centre() - there).length() < 1e-5);
        }
        assert!((1..8).contains(&mirrored));
    }
}
