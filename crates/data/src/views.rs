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

/// `count` input views (all, if there are fewer), spread evenly over those there are, as the encoder takes them:
/// photographs, or for a light basis its sums under `source`, by default [`usual_source`].
///
/// # Errors
/// If there are none, if `source` is given for photographs, whose light is what it is, and as [`views_under`].
pub fn spread_inputs(
    scene: &Scene,
    count: usize,
    source: Option<&Lighting>,
    side: usize,
) -> Result<Vec<View>> {
    let all = scene.with_role(Role::Input);
    if count == 0 || all.is_empty() {
        let expected = "expected at least one input view";
        return Err(Error::value("inputs", expected));
    }
    let n = count.min(all.len());
    let chosen: Vec<usize> = (0..n).map(|i| all[i * all.len() / n]).collect();
    if scene.basis.is_some() {
        let usual = usual_source(scene)?;
        return views_under(scene, &chosen, source.unwrap_or(&usual), side);
    }
    if source.is_some() {
        let expected = format!(
            "{} holds photographs, whose light cannot be chosen",
            scene.name
        );
        return Err(Error::value("source", expected));
    }
    photographs(scene, &chosen, side)
}

/// The light of the inputs where nobody names one: the basis' first environment, else its first light.
///
/// # Errors
/// If the scene has no light basis or no light in it.
pub fn usual_source(scene: &Scene) -> Result<Lighting> {
    let lights = &basis(scene)?.lights;
    let first = lights.iter().find(|l| l.light.kind() == "environment");
    match first.or(lights.first()) {
        Some(light) => Ok(Lighting::single(&light.name)),
        None => Err(Error::value("lights", "expected at least one light")),
    }
}

/// A circle of cameras around the scene in model space.
#[derive(Clone, Copy, Debug)]
pub struct Orbit {
    /// Angle above the horizon in radians.
    pub elevation: f32,
    /// Distance from the scene's centre in ball radii.
    pub distance: f32,
    /// Horizontal field of view in radians.
    pub fov: f32,
}

impl Orbit {
    /// The mean distance, elevation and field of view of the scene's own square views.
    #[must_use]
    pub fn of(scene: &Scene) -> Self {
        let square = |v: &View| square_camera(scene, &v.camera, 64).transformed(&scene.to_model);
        let moved: Vec<Camera> = scene.views.iter().map(square).collect();
        let mean = |f: &dyn Fn(&Camera) -> f32| {
            moved.iter().map(f).sum::<f32>() / moved.len().max(1) as f32
        };
        Self {
            elevation: mean(&|c| (c.centre().z / c.centre().length()).asin()),
            distance: mean(&|c| c.centre().length()).max(1.2),
            fov: mean(&|c| 2.0 * (0.5 * c.width as f32 / c.fx).atan()),
        }
    }
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
