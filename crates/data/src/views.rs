//! Views of a scene as a model takes them: square, at one size, under a chosen light.

use crate::lighting::{Lighting, basis};
use glam::Vec3;
use lumi_core::{
    Camera, Error, Light, LinearImage, NamedLight, Result, Role, Scene, Similarity, View,
};

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
    let chosen = spread(&all, count);
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

/// The light that [`spread_inputs`] shows the inputs in, in world space, where it is known: that of the sum, or what the photographs
/// say, if all say the same.
///
/// # Errors
/// As [`usual_source`], and if `source` names an unknown light.
pub fn input_light(scene: &Scene, source: Option<&Lighting>) -> Result<Option<Vec<Light>>> {
    if scene.basis.is_some() {
        let usual = usual_source(scene)?;
        return source.unwrap_or(&usual).lights(scene).map(Some);
    }
    let inputs = scene.with_role(Role::Input);
    let said = |&i: &usize| scene.lights_of(i).iter().map(|light| &light.light);
    let Some((first, others)) = inputs.split_first() else {
        return Ok(None);
    };
    let one = said(first).next().is_some() && others.iter().all(|i| said(i).eq(said(first)));
    Ok(one.then(|| said(first).cloned().collect()))
}

/// At most `n` of the items, evenly spread.
#[must_use]
pub fn spread<T: Clone>(items: &[T], n: usize) -> Vec<T> {
    let n = n.min(items.len());
    (0..n).map(|i| items[i * items.len() / n].clone()).collect()
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
        let square = |v: &View| square_camera(scene, &v.camera, 64);
        let cameras: Vec<Camera> = scene.views.iter().map(square).collect();
        Self::along(&cameras, &scene.to_model)
    }

    /// The mean distance, elevation and field of view of world-space cameras.
    #[must_use]
    pub fn along(cameras: &[Camera], to_model: &Similarity) -> Self {
        let moved: Vec<Camera> = cameras.iter().map(|c| c.transformed(to_model)).collect();
        let mean = |f: &dyn Fn(&Camera) -> f32| {
            moved.iter().map(f).sum::<f32>() / moved.len().max(1) as f32
        };
        Self {
            elevation: mean(&|c| (c.centre().z / c.centre().length()).asin()),
            distance: mean(&|c| c.centre().length()).max(1.2),
            fov: mean(&|c| 2.0 * (0.5 * c.width as f32 / c.fx).atan()),
        }
    }

    /// `count` world-space cameras of `side × side` pixels, once around.
    #[must_use]
    pub fn cameras(&self, count: usize, side: usize, to_model: &Similarity) -> Vec<Camera> {
        let to_world = to_model.inverse();
        let azimuth = |i: usize| std::f32::consts::TAU * i as f32 / count as f32;
        let camera = |i| Camera::orbit(azimuth(i), self.elevation, self.distance, self.fov, side);
        (0..count)
            .map(|i| camera(i).transformed(&to_world))
            .collect()
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
    let images = radiance_under(scene, views, lighting, side)?;
    let shown = views.iter().zip(images).map(|(&i, linear)| View {
        camera: square_camera(scene, &scene.views[i].camera, side),
        image: Some(linear.to_display()),
        ..scene.views[i].clone()
    });
    Ok(shown.collect())
}

/// What [`views_under`] encodes: premultiplied radiance, which is not clipped.
///
/// # Errors
/// As [`views_under`].
pub fn radiance_under(
    scene: &Scene,
    views: &[usize],
    lighting: &Lighting,
    side: usize,
) -> Result<Vec<LinearImage>> {
    let basis = basis(scene)?;
    let lights = lighting.resolve(basis)?;
    let square = views.iter().map(|&i| {
        let (corner, size) = square(scene, &scene.views[i].camera, side);
        let linear = basis.compose(i, &lights).cropped(corner, size);
        linear.resized(side, side)
    });
    Ok(square.collect())
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
        let (corner, size) = square(scene, &view.camera, side);
        Ok(View {
            name: view.name.clone(),
            role: view.role,
            camera: square_camera(scene, &view.camera, side),
            image: Some(image.cropped(corner, size).resized(side, side)),
        })
    });
    shown.collect()
}

/// The unclipped radiance of the given views' photographs, cropped and averaged (premultiplied) as [`photographs`]
/// does; `None` if one of them has only a clipped photograph.
#[must_use]
pub fn photographed_radiance(
    scene: &Scene,
    views: &[usize],
    side: usize,
) -> Option<Vec<LinearImage>> {
    let shown = views.iter().map(|&i| {
        let (corner, size) = square(scene, &scene.views[i].camera, side);
        Some(
            scene
                .radiance_of(i)?
                .cropped(corner, size)
                .resized(side, side),
        )
    });
    shown.collect()
}

/// Share of a square's side that the bounding ball takes after a crop to the object.
const CROPPED_SHARE: f32 = 0.85;

/// A ball that takes less than this share of the largest square is cropped to: models learn from views that
/// an object fills (0.75 to 0.95 of the side), and a small object would lose most of its pixels.
const SMALL_SHARE: f32 = 0.6;

/// The whole scene as if photographed under `lighting`: every view shows the sum of its lights, at full size and
/// uncropped, and [`Scene::lights_of`] says which they were.
///
/// # Errors
/// As [`views_under`].
pub fn photographed(scene: &Scene, lighting: &Lighting) -> Result<Scene> {
    let basis = basis(scene)?;
    let lights = lighting.resolve(basis)?;
    let named = lights.iter().map(|&(i, gain)| NamedLight {
        name: basis.lights[i].name.clone(),
        light: basis.lights[i].light.scaled(gain),
    });
    let named: Vec<_> = named.collect();
    let views = scene.views.iter().enumerate().map(|(i, view)| View {
        image: Some(basis.compose(i, &lights).to_display()),
        ..view.clone()
    });
    Ok(Scene {
        name: scene.name.clone(),
        views: views.collect(),
        to_model: scene.to_model,
        basis: None,
        lit_by: vec![named; scene.views.len()],
        radiance: Vec::new(),
        warnings: scene.warnings.clone(),
    })
}

/// The camera of a view's square at `side × side` pixels, as [`views_under`] and [`photographs`] use
/// it. The square is as large as the image allows, and smaller where the scene's ball takes less than
/// 0.6 of that: then the ball takes 0.85 of it, but at least `side` pixels of the image, so that nothing is
/// enlarged. Its middle is the image of the scene's centre, as far as the image reaches.
#[must_use]
pub fn square_camera(scene: &Scene, camera: &Camera, side: usize) -> Camera {
    let (corner, size) = square(scene, camera, side);
    camera.cropped(corner, size).resized(side, side)
}

/// Top-left corner and size of a view's square that is going to have `goal` pixels a side.
pub(crate) fn square(
    scene: &Scene,
    camera: &Camera,
    goal: usize,
) -> ((usize, usize), (usize, usize)) {
    let largest = camera.width.min(camera.height);
    let ball = scene.to_model.inverse();
    let centre = ball.point(Vec3::ZERO);
    let (x, y, depth) = camera.project(centre);
    if depth <= 0.0 {
        let corner = ((camera.width - largest) / 2, (camera.height - largest) / 2);
        return (corner, (largest, largest));
    }
    let share = ball_diameter(camera, centre, ball.scale) / largest as f32;
    let side = if share < SMALL_SHARE {
        let wanted = (share / CROPPED_SHARE * largest as f32).ceil() as usize;
        wanted.max(goal).min(largest)
    } else {
        largest
    };
    let corner = |length: usize, middle: f32| {
        let first = (middle - 0.5 * side as f32).round().max(0.0) as usize;
        first.min(length - side)
    };
    let corner = (corner(camera.width, x), corner(camera.height, y));
    (corner, (side, side))
}

/// Pixels across the image of a ball, were it in the middle; infinite for a camera inside it.
fn ball_diameter(camera: &Camera, centre: Vec3, radius: f32) -> f32 {
    let distance = camera.centre().distance(centre);
    if distance <= radius {
        return f32::INFINITY;
    }
    2.0 * camera.fx.max(camera.fy) * (radius / distance).asin().tan()
}

#[cfg(test)]
mod tests {
    use super::*;
    use lumi_core::{DisplayImage, Similarity};

    /// One view, 400 × 300, of a ball of radius `radius` at (0.6, 0, 0.3).
    fn scene(radius: f32) -> Scene {
        let target = Vec3::new(0.0, 0.2, 0.0);
        let camera = Camera::look_at(Vec3::new(0.0, -5.0, 1.0), target, 0.9, 400, 300);
        Scene {
            name: "ball".to_owned(),
            views: vec![View {
                name: "v".to_owned(),
                role: Role::Input,
                camera,
                image: Some(DisplayImage::filled(400, 300, [0.5; 3])),
            }],
            to_model: Similarity::to_unit_ball(Vec3::new(0.6, 0.0, 0.3), radius),
            basis: None,
            lit_by: Vec::new(),
            radiance: Vec::new(),
            warnings: Vec::new(),
        }
    }

    /// How much of the square's side the ball takes, and where its centre is.
    fn framing(scene: &Scene, side: usize) -> (f32, f32, f32) {
        let camera = photographs(scene, &[0], side).expect("a photograph")[0].camera;
        let ball = scene.to_model.inverse();
        let centre = ball.point(Vec3::ZERO);
        let (x, y, _) = camera.project(centre);
        let share = ball_diameter(&camera, centre, ball.scale) / side as f32;
        (share, x / side as f32, y / side as f32)
    }

    #[test]
    fn a_small_object_off_centre_fills_its_square() {
        let (share, x, y) = framing(&scene(0.3), 32);
        assert!((share - CROPPED_SHARE).abs() < 0.03, "{share}");
        assert!((x - 0.5).abs() < 0.02 && (y - 0.5).abs() < 0.02, "{x} {y}");
    }

    #[test]
    fn a_large_one_keeps_all_of_the_image_and_nothing_is_enlarged() {
        let wide = scene(1.2);
        let (share, ..) = framing(&wide, 64);
        let largest = ball_diameter(&wide.views[0].camera, Vec3::new(0.6, 0.0, 0.3), 1.2) / 300.0;
        assert!((share - largest).abs() < 1e-3 && share > SMALL_SHARE);
        // The small ball would fill 60 pixels; asked for 256, the square keeps 256 of the image.
        let camera = square_camera(&scene(0.3), &scene(0.3).views[0].camera, 256);
        assert!((camera.fx - scene(0.3).views[0].camera.fx).abs() < 1e-3);
    }
}
