//! The figures of a [`Report`].

use super::agreement;
use super::report::{Background, Exposure, LightReport, Report, ViewReport};
use crate::ball::{MASK_THRESHOLD, Silhouette, percentile, stray};
use crate::upright;
use glam::Vec3;
use lumi_core::{Camera, DisplayImage, Light, Role, Scene, View};
use std::collections::BTreeSet;

/// Display values from here on count as clipped, and up to one minus this as black (8-bit ends).
const CLIPPED: f32 = 254.5 / 255.0;

pub(super) fn measure(scene: &Scene, format: &str) -> Report {
    let masks: Vec<Option<Vec<f32>>> = (0..scene.views.len()).map(|i| mask(scene, i)).collect();
    let hulls = hull(scene, &masks);
    let views: Vec<ViewReport> = scene
        .views
        .iter()
        .enumerate()
        .map(|(i, view)| view_report(scene, view, masks[i].as_deref(), hulls[i]))
        .collect();
    let cameras: Vec<Camera> = scene.views.iter().map(|v| v.camera).collect();
    let fov = |c: &Camera| 2.0 * (0.5 * c.width as f32 / c.fx).atan().to_degrees();
    let ball = scene.to_model.inverse();
    let sizes: BTreeSet<_> = cameras.iter().map(|c| [c.width, c.height]).collect();
    let mut coverage: Vec<f32> = views.iter().filter_map(|v| v.coverage).collect();
    let mut ious: Vec<f32> = hulls.iter().flatten().copied().collect();
    Report {
        name: scene.name.clone(),
        format: format.to_owned(),
        inputs: scene.with_role(Role::Input).len(),
        targets: scene.with_role(Role::Target).len(),
        sizes: sizes.into_iter().collect(),
        focal_over_width: range(cameras.iter().map(|c| c.fx / c.width as f32)),
        fov_degrees: range(cameras.iter().map(fov)),
        distance: range(views.iter().map(|v| v.distance)),
        ball_centre: ball.point(Vec3::ZERO).to_array(),
        ball_radius: ball.scale,
        sound_cameras: cameras.iter().filter(|c| c.validate().is_ok()).count(),
        masks: masks.iter().flatten().count(),
        coverage: (!coverage.is_empty())
            .then(|| [0.0, 0.5, 1.0].map(|share| percentile(&mut coverage, share))),
        look_at_degrees: views.iter().map(|v| v.look_at_degrees).fold(0.0, f32::max),
        hull_median: (!ious.is_empty()).then(|| percentile(&mut ious, 0.5)),
        spread_degrees: spread(scene).0,
        repeated: spread(scene).1,
        tilt_degrees: upright::vertical(&cameras).map(|up| up.angle_between(Vec3::Z).to_degrees()),
        background: background(scene, &masks),
        exposure: exposure(scene),
        views,
        lights: lights(scene),
        photographs_lit: scene.lit_by.iter().filter(|l| !l.is_empty()).count(),
        photograph_lights: different_lights(scene),
        problems: Vec::new(),
    }
}

/// Coverage of view `i`, from its photograph or from the light basis.
fn mask(scene: &Scene, i: usize) -> Option<Vec<f32>> {
    let from_basis = || {
        let image = scene.basis.as_ref()?.radiance.first()?.get(i)?;
        Some(image.pixels.iter().map(|p| p[3]).collect())
    };
    let image = scene.views[i].image.as_ref();
    let alpha = image.map_or_else(from_basis, |image| image.alpha.clone())?;
    let camera = &scene.views[i].camera;
    (alpha.len() == camera.width * camera.height).then_some(alpha)
}

/// Hull agreement of each view that has a mask; it takes two to tell anything.
fn hull(scene: &Scene, masks: &[Option<Vec<f32>>]) -> Vec<Option<f32>> {
    let with_mask: Vec<usize> = (0..masks.len()).filter(|&i| masks[i].is_some()).collect();
    let mut ious = vec![None; masks.len()];
    if with_mask.len() < 2 {
        return ious;
    }
    let views: Vec<(Camera, &[f32])> = with_mask
        .iter()
        .filter_map(|&i| {
            let camera = scene.views[i].camera.transformed(&scene.to_model);
            Some((camera, masks[i].as_deref()?))
        })
        .collect();
    let silhouettes = with_mask.iter().map(|&i| Silhouette {
        camera: &scene.views[i].camera,
        alpha: masks[i].as_deref(),
    });
    let stray = stray(&silhouettes.collect::<Vec<_>>());
    for (i, iou) in with_mask.into_iter().zip(agreement(&views, &stray)) {
        ious[i] = Some(iou);
    }
    ious
}

fn view_report(scene: &Scene, view: &View, mask: Option<&[f32]>, hull: Option<f32>) -> ViewReport {
    let camera = view.camera.transformed(&scene.to_model);
    let covered = |m: &[f32]| m.iter().sum::<f32>() / m.len() as f32;
    ViewReport {
        name: view.name.clone(),
        role: match view.role {
            Role::Input => "input",
            Role::Target => "target",
        },
        distance: camera.centre().length(),
        look_at_degrees: camera
            .forward()
            .angle_between(-camera.centre())
            .to_degrees(),
        coverage: mask.map(covered),
        hull,
        cut_off: mask.map(|m| touching(&view.camera, m)),
        brightness: view.image.as_ref().and_then(brightness),
    }
}

/// Pixels along the edge of an image, each once.
fn edge(width: usize, height: usize) -> impl Iterator<Item = usize> {
    let on_edge = move |i: &usize| {
        let (x, y) = (i % width, i / width);
        x == 0 || y == 0 || x + 1 == width || y + 1 == height
    };
    (0..width * height).filter(on_edge)
}

/// Share of the image's edge that the object covers.
fn touching(camera: &Camera, mask: &[f32]) -> f32 {
    let (mut covered, mut all) = (0, 0);
    for i in edge(camera.width, camera.height) {
        covered += usize::from(mask[i] >= MASK_THRESHOLD);
        all += 1;
    }
    covered as f32 / all.max(1) as f32
}

/// Mean display value of the object's pixels, or of all where there is no mask.
fn brightness(image: &DisplayImage) -> Option<f32> {
    let (mut sum, mut count) = (0.0_f64, 0_usize);
    for (i, p) in image.pixels.iter().enumerate() {
        if image.alpha.as_ref().is_none_or(|a| a[i] >= MASK_THRESHOLD) {
            sum += f64::from(p[0] + p[1] + p[2]) / 3.0;
            count += 1;
        }
    }
    (count > 0).then(|| (sum / count as f64) as f32)
}

/// Widest angle between input views from the scene's centre, and how many inputs repeat an earlier one.
fn spread(scene: &Scene) -> (f32, usize) {
    let inputs = scene.with_role(Role::Input);
    let towards = |&i: &usize| {
        let camera = scene.views[i].camera.transformed(&scene.to_model);
        camera.centre().normalize_or_zero()
    };
    let directions: Vec<Vec3> = inputs.iter().map(towards).collect();
    let (mut widest, mut repeated) = (0.0_f32, 0);
    for (i, a) in directions.iter().enumerate() {
        let angles = directions[..i]
            .iter()
            .map(|b| a.angle_between(*b).to_degrees());
        let (nearest, farthest) = angles.fold((f32::MAX, 0.0_f32), |(n, f), angle| {
            (n.min(angle), f.max(angle))
        });
        widest = widest.max(farthest);
        repeated += usize::from(nearest < 1.0);
    }
    (widest, repeated)
}

/// The edges of photographs without a mask.
fn background(scene: &Scene, masks: &[Option<Vec<f32>>]) -> Option<Background> {
    let (mut clutter, mut from_white, mut count) = (0.0_f32, 0.0_f64, 0_usize);
    for (view, mask) in scene.views.iter().zip(masks) {
        let (Some(image), None) = (&view.image, mask) else {
            continue;
        };
        let (mut sum, mut squares, mut n) = (0.0_f64, 0.0_f64, 0_usize);
        for i in edge(image.width, image.height) {
            for v in image.pixels[i] {
                sum += f64::from(v);
                squares += f64::from(v * v);
                n += 1;
            }
        }
        let mean = sum / n.max(1) as f64;
        let variance = (squares / n.max(1) as f64 - mean * mean).max(0.0);
        clutter = clutter.max(variance.sqrt() as f32);
        from_white += 1.0 - mean;
        count += 1;
    }
    (count > 0).then(|| Background {
        clutter,
        from_white: (from_white / count as f64) as f32,
    })
}

/// How many different sets of lights photographs were taken under.
fn different_lights(scene: &Scene) -> usize {
    let known = scene.lit_by.iter().filter(|l| !l.is_empty());
    let names: BTreeSet<Vec<&str>> = known
        .map(|lights| lights.iter().map(|l| l.name.as_str()).collect())
        .collect();
    names.len()
}

fn exposure(scene: &Scene) -> Option<Exposure> {
    let (mut sum, mut clipped, mut black, mut count) = (0.0_f64, 0_usize, 0_usize, 0_usize);
    let mut means = Vec::new();
    for image in scene.views.iter().filter_map(|v| v.image.as_ref()) {
        let (mut view_sum, mut view_count) = (0.0_f64, 0_usize);
        for (i, p) in image.pixels.iter().enumerate() {
            if image.alpha.as_ref().is_some_and(|a| a[i] < MASK_THRESHOLD) {
                continue;
            }
            view_sum += f64::from(p[0] + p[1] + p[2]) / 3.0;
            view_count += 1;
            clipped += usize::from(p.iter().any(|v| *v >= CLIPPED));
            black += usize::from(p.iter().all(|v| *v <= 1.0 - CLIPPED));
        }
        if view_count > 0 {
            means.push((view_sum / view_count as f64) as f32);
        }
        sum += view_sum;
        count += view_count;
    }
    let mean = (sum / count.max(1) as f64) as f32;
    (count > 0).then(|| Exposure {
        mean,
        clipped: clipped as f32 / count as f32,
        black: black as f32 / count as f32,
        spread: means.iter().map(|m| (m - mean).abs()).fold(0.0, f32::max),
    })
}

fn lights(scene: &Scene) -> Vec<LightReport> {
    let Some(basis) = &scene.basis else {
        return Vec::new();
    };
    let report = |(i, named): (usize, &lumi_core::NamedLight)| {
        let place = |p: Vec3| Some(scene.to_model.point(p).length());
        let (power, distance, energy) = match &named.light {
            Light::Environment(l) => {
                let energy = l.map.energy();
                let total: f64 = (0..3).map(|c| energy[c] * f64::from(l.strength[c])).sum();
                (None, None, Some((total / 3.0) as f32))
            }
            Light::Sun(l) => {
                let energy = l.irradiance().iter().sum::<f32>() / 3.0;
                (None, None, Some(energy))
            }
            lamp => (lamp.power(), lamp.position().and_then(place), None),
        };
        let (mut sum, mut alpha) = (0.0_f64, 0.0_f64);
        for p in basis.radiance[i].iter().flat_map(|image| &image.pixels) {
            sum += f64::from(p[0] + p[1] + p[2]) / 3.0;
            alpha += f64::from(p[3]);
        }
        LightReport {
            name: named.name.clone(),
            kind: named.light.kind(),
            power,
            energy,
            distance,
            mean_radiance: (sum / alpha.max(1e-9)) as f32,
        }
    };
    basis.lights.iter().enumerate().map(report).collect()
}

/// Smallest and largest value.
fn range(values: impl Iterator<Item = f32>) -> [f32; 2] {
    values.fold([f32::INFINITY, f32::NEG_INFINITY], |[low, high], v| {
        [low.min(v), high.max(v)]
    })
}
