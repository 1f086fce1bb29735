//! Do masks and poses agree? Carve a coarse visual hull and look at it again from every view.

use crate::ball::MASK_THRESHOLD;
use glam::Vec3;
use lumi_core::Camera;
use lumi_core::image::area_resize;

/// Voxels along each side of the model-space cube [−1, 1]³.
const GRID: usize = 48;

/// Masks are compared at this many pixels along their longer side; finer than a voxel's image.
const MASK_SIDE: usize = 96;

/// A voxel goes when more than this share of the views that see it call it background. One view in
/// ten may be wrong without taking the hull along, so that it stands out itself.
const DISSENT: f32 = 0.1;

/// A view of the object in model space.
struct Coarse {
    camera: Camera,
    mask: Vec<bool>,
}

/// For each view (camera in model space, coverage), the intersection over union of its mask and the
/// reprojected hull; 0 where both are empty. A voxel is about 1/24 of the ball's radius, which costs
/// fine shapes a few hundredths. The views whose indices are in `stray` are compared, but do not carve.
#[must_use]
pub fn agreement(views: &[(Camera, &[f32])], stray: &[usize]) -> Vec<f32> {
    let views: Vec<Coarse> = views
        .iter()
        .map(|(camera, alpha)| coarse(camera, alpha))
        .collect();
    let sound = (0..views.len()).filter(|i| !stray.contains(i));
    let hull = carve(&sound.map(|i| &views[i]).collect::<Vec<_>>());
    views.iter().map(|view| overlap(view, &hull)).collect()
}

fn coarse(camera: &Camera, alpha: &[f32]) -> Coarse {
    let longer = camera.width.max(camera.height);
    let side = |s: usize| (s * MASK_SIDE.min(longer)).div_ceil(longer).max(1);
    let (width, height) = (side(camera.width), side(camera.height));
    let small = area_resize(alpha, (camera.width, camera.height, 1), (width, height));
    Coarse {
        camera: camera.resized(width, height),
        mask: small.iter().map(|a| *a >= MASK_THRESHOLD).collect(),
    }
}

impl Coarse {
    /// Whether the object covers the point's pixel; `None` outside the image.
    fn covers(&self, point: Vec3) -> Option<bool> {
        let (x, y, z) = self.camera.project(point);
        let inside = z > 0.0 && x >= 0.0 && y >= 0.0;
        let (x, y) = (x as usize, y as usize);
        let inside = inside && x < self.camera.width && y < self.camera.height;
        inside.then(|| self.mask[y * self.camera.width + x])
    }
}

/// Voxels that enough views call object and at least one view sees.
fn carve(views: &[&Coarse]) -> Vec<bool> {
    let centre = |i: usize| (i as f32 + 0.5) * 2.0 / GRID as f32 - 1.0;
    let allowed = (DISSENT * views.len() as f32) as usize;
    (0..GRID * GRID * GRID)
        .map(|i| {
            let point = Vec3::new(
                centre(i % GRID),
                centre(i / GRID % GRID),
                centre(i / GRID / GRID),
            );
            let (mut object, mut background) = (0, 0);
            for view in views {
                match view.covers(point) {
                    Some(true) => object += 1,
                    Some(false) => background += 1,
                    None => {}
                }
                if background > allowed {
                    return false;
                }
            }
            object > 0
        })
        .collect()
}

fn overlap(view: &Coarse, hull: &[bool]) -> f32 {
    let (mut both, mut either) = (0_u32, 0_u32);
    let origin = view.camera.centre();
    for (direction, &mask) in view.camera.directions().into_iter().zip(&view.mask) {
        let seen = hits(hull, origin, direction);
        both += u32::from(seen && mask);
        either += u32::from(seen || mask);
    }
    both as f32 / either.max(1) as f32
}

/// Whether a ray meets a voxel, by half-voxel steps through the part of it inside the ball of the cube.
fn hits(hull: &[bool], origin: Vec3, direction: Vec3) -> bool {
    let middle = -origin.dot(direction);
    let apart = (origin + middle * direction).length_squared();
    if apart > 3.0 {
        return false;
    }
    let half = (3.0 - apart).sqrt();
    let step = 1.0 / GRID as f32;
    let cell = |v: f32| {
        let i = ((v + 1.0) * 0.5 * GRID as f32).floor();
        (i >= 0.0 && i < GRID as f32).then_some(i as usize)
    };
    let steps = (2.0 * half / step) as usize;
    (0..=steps).any(|k| {
        let p = origin + (middle - half + k as f32 * step).max(0.0) * direction;
        let at = cell(p.x).zip(cell(p.y)).zip(cell(p.z));
        at.is_some_and(|((x, y), z)| hull[(z * GRID + y) * GRID + x])
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ball_views() -> (Vec<Camera>, Vec<Vec<f32>>) {
        let cameras: Vec<_> = (0..12)
            .map(|i| Camera::orbit(0.6 * i as f32, 0.1 + 0.1 * i as f32, 3.0, 0.8, 96))
            .collect();
        let inside = |c: &Camera, d: Vec3| f32::from(u8::from(d.cross(c.centre()).length() < 0.7));
        let masks = cameras
            .iter()
            .map(|c| c.directions().into_iter().map(|d| inside(c, d)).collect())
            .collect();
        (cameras, masks)
    }

    #[test]
    fn consistent_views_agree_and_a_wrong_one_stands_out() {
        let (mut cameras, masks) = ball_views();
        // Turn one camera a quarter of its field of view aside.
        cameras[4].cx += 30.0;
        let views: Vec<_> = cameras
            .iter()
            .copied()
            .zip(masks.iter().map(Vec::as_slice))
            .collect();
        let ious = agreement(&views, &[]);
        for (i, iou) in ious.iter().enumerate() {
            assert_eq!(*iou > 0.9, i != 4, "view {i}: {iou}");
        }
        assert!(ious[4] < 0.6);
    }
}
