//! Where in space all views can see the object: a grid of evidence around the ball of the scene, and what it says to
//! each pixel.

use glam::Vec3;
use lumi_core::Camera;
use rayon::prelude::*;

/// Voxels along each side of the cube around the ball.
const GRID: usize = 80;

/// Of the views that see a voxel, this share may call it background without taking it from the object: photographs have
/// reflections, shadows and poses that are a little off.
const DISSENT: f32 = 0.1;

/// Evidence for the object in every pixel of a view: positive where it speaks for the object.
pub(super) struct Evidence<'a> {
    /// Camera in model space.
    pub camera: Camera,
    pub pixels: &'a [f32],
}

impl Evidence<'_> {
    fn at(&self, point: Vec3) -> Option<f32> {
        let (x, y, z) = self.camera.project(point);
        let (w, h) = (self.camera.width, self.camera.height);
        let inside = z > 0.0 && x >= 0.0 && y >= 0.0 && x < w as f32 && y < h as f32;
        inside.then(|| self.pixels[(y as usize).min(h - 1) * w + (x as usize).min(w - 1)])
    }
}

/// Evidence for the object at points of the cube [−1, 1]³ of model space.
pub(super) struct Hull {
    voxels: Vec<f32>,
}

impl Hull {
    /// What the views agree on: of each voxel's evidence the lowest but for the dissenters'. Voxels outside the unit ball,
    /// and those that less than half of the views see, are background.
    pub fn of(views: &[Evidence], background: f32) -> Self {
        let centre = |i: usize| (i as f32 + 0.5) * 2.0 / GRID as f32 - 1.0;
        let voxel = |i: usize| {
            let point = [i % GRID, i / GRID % GRID, i / GRID / GRID].map(centre);
            let point = Vec3::from_array(point);
            if point.length_squared() > 1.0 {
                return background;
            }
            let mut found: Vec<f32> = views.iter().filter_map(|v| v.at(point)).collect();
            if 2 * found.len() < views.len() {
                return background;
            }
            let dissenters = (DISSENT * found.len() as f32) as usize;
            let (_, lowest, _) = found.select_nth_unstable_by(dissenters, f32::total_cmp);
            *lowest
        };
        let voxels = (0..GRID * GRID * GRID).into_par_iter().map(voxel).collect();
        Self { voxels }
    }

    /// For each pixel of a camera in model space, the highest evidence along its ray.
    pub fn seen(&self, camera: &Camera, background: f32) -> Vec<f32> {
        let origin = camera.centre();
        let rays = camera.directions();
        let highest = |direction: &Vec3| {
            let middle = -origin.dot(*direction);
            let apart = (origin + middle * *direction).length_squared();
            if apart >= 1.0 {
                return background;
            }
            let half = (1.0 - apart).sqrt();
            let step = 1.0 / GRID as f32;
            let first = (middle - half).max(0.0);
            let steps = ((middle + half - first) / step).max(0.0) as usize;
            (0..=steps)
                .map(|k| self.at(origin + (first + k as f32 * step) * *direction))
                .fold(background, f32::max)
        };
        rays.par_iter().map(highest).collect()
    }

    fn at(&self, point: Vec3) -> f32 {
        let cell = |v: f32| (((v + 1.0) * 0.5 * GRID as f32) as usize).min(GRID - 1);
        self.voxels[(cell(point.z) * GRID + cell(point.y)) * GRID + cell(point.x)]
    }
}
