//! Views of a scene as a model takes them: square, at one size, under a chosen light.

use crate::lighting::{Lighting, basis};
use glam::Vec3;
use lumi_core::{Camera, Error, Result, Role, Scene, View};

/// The input views under `lighting`, `side × side` pixels each; see [`views_under`].
///
/// # Errors
/// As [`views_under`].
pub fn inputs_under(scene: &Scene, lighting: &Lighting, side: usize) -> Result<Vec<View>> {
    views_under(scene, &scene.with_role(Role::Input), lighting, side)
}

/// The given views under `lighting`: lights are summed in linear radiance, cropped to a square (see
/// [`square_camera`]), averaged down to `side × side` (premultiplied) and then encoded over white. Cameras
/// follow the crop and the size.
///
/// # Errors
/// If the scene has no light basis, or the lighting names an unknown light.
pub fn views_under(
    scene: &Scene,
    views: &[usize],
    lighting: &Lighting,
    side: usize,
) -> Result<Vec<View>> {
    let basis = basis(scene)?;
    let lights = lighting.resolve(basis)?;
    let shown = views.iter().map(|&i| {
        let camera = &scene.views[i].camera;
        let (corner, size) = square(scene, camera);
        let linear = basis.compose(i, &lights).cropped(corner, size);
        View {
            camera: square_camera(scene, camera, side),
            image: Some(linear.resized(side, side).to_display()),
            ..scene.views[i].clone()
        }
    });
    Ok(shown.collect())
}

/// The given views' photographs, cropped to a square (see [`square_camera`]) and resized to `side × side` in
/// display values. Cameras follow.
///
/// # Errors
/// Names a view that has no photograph.
pub fn photographs(scene: &Scene, views: &[usize], side: usize) -> Result<Vec<View>> {
    let shown = views.iter().map(|&i| {
        let view = &scene.views[i];
        let Some(image) = &view.image else {
            let expected = "expected a photograph; this scene has only one-light-at-a-time images, so name a lighting";
            return Err(Error::value(format!("view `{}`", view.name), expected));
        };
        let (corner, size) = square(scene, &view.camera);
        Ok(View {
            name: view.name.clone(),
            role: view.role,
            camera: square_camera(scene, &view.camera, side),
            image: Some(image.cropped(corner, size).resized(side, side)),
        })
    });
    shown.collect()
}

/// The camera of a view's square at `side × side` pixels, as [`views_under`] and [`photographs`] use
/// it. The square is as large as the image allows; on an image that is not square it slides along the
/// longer side until the scene's centre is in its middle, as far as the image reaches.
#[must_use]
pub fn square_camera(scene: &Scene, camera: &Camera, side: usize) -> Camera {
    let (corner, size) = square(scene, camera);
    camera.cropped(corner, size).resized(side, side)
}

/// Top-left corner and size of a view's square.
fn square(scene: &Scene, camera: &Camera) -> ((usize, usize), (usize, usize)) {
    let side = camera.width.min(camera.height);
    let centre = scene.to_model.inverse().point(Vec3::ZERO);
    let (x, y, depth) = camera.project(centre);
    let corner = |length: usize, middle: f32| {
        let middle = if depth > 0.0 {
            middle
        } else {
            0.5 * length as f32
        };
        let first = (middle - 0.5 * side as f32).round().max(0.0) as usize;
        first.min(length - side)
    };
    let corner = (corner(camera.width, x), corner(camera.height, y));
    (corner, (side, side))
}
