//! Masks from photographs alone: a rendered object before a made-up room, and real captures whose alpha is known and whose
//! background is still there under it.
#![allow(clippy::unwrap_used)]

use lumi_core::glam::Vec3;
use lumi_core::{DisplayImage, Scene, Similarity};
use lumi_data::ball::{Silhouette, estimate};
use lumi_data::{Lighting, mask, views};
use lumi_testkit::{demo, extra};
use std::path::Path;

/// Intersection over union of two masks.
fn iou(found: &[f32], truth: &[f32]) -> f32 {
    let (mut both, mut either) = (0, 0);
    for (f, t) in found.iter().zip(truth) {
        both += usize::from(*f >= 0.5 && *t >= 0.5);
        either += usize::from(*f >= 0.5 || *t >= 0.5);
    }
    both as f32 / either.max(1) as f32
}

/// Takes the photographs' alpha away, and what was known by it: the ball is the one that cameras alone show.
fn forget_alpha(scene: &mut Scene) -> Vec<Vec<f32>> {
    let truth = scene.views.iter_mut().map(|view| {
        let image = view.image.as_mut().unwrap();
        image.alpha.take().unwrap()
    });
    let truth = truth.collect();
    let silhouettes = scene.views.iter().map(|view| Silhouette {
        camera: &view.camera,
        alpha: None,
    });
    let ball = estimate(&silhouettes.collect::<Vec<_>>()).unwrap();
    scene.to_model = Similarity::to_unit_ball(ball.centre, ball.radius);
    truth
}

/// Finds masks, and prints how they agree with the truth; the mean of that.
fn agreement(name: &str, scene: &Scene, truth: &[Vec<f32>]) -> f32 {
    let found = mask::masks(scene, &()).unwrap();
    let ious: Vec<f32> = found.iter().zip(truth).map(|(f, t)| iou(f, t)).collect();
    let mean = ious.iter().sum::<f32>() / ious.len() as f32;
    println!(
        "{name}: mean IoU {mean:.3}, least {:.3}",
        ious.iter().fold(1.0_f32, |m, v| m.min(*v))
    );
    mean
}

/// A room without end: a tiled floor below, a striped wall around, in colours that the object has, too.
fn room(direction: Vec3) -> [f32; 3] {
    if direction.z < -0.05 {
        let tile = (direction.x / -direction.z).floor() + (direction.y / -direction.z).floor();
        let light = if tile.rem_euclid(2.0) < 1.0 {
            0.55
        } else {
            0.35
        };
        [light, 0.8 * light, 0.6 * light]
    } else {
        let stripe = (9.0 * direction.y.atan2(direction.x)).sin();
        [0.4 + 0.1 * stripe, 0.5, 0.6 - 0.1 * stripe]
    }
}

#[test]
fn a_rendered_object_is_found_in_a_room() {
    let scene = lumi_data::open(demo().join("spot")).unwrap();
    let mut scene = views::photographed(&scene, &Lighting::single("env0")).unwrap();
    for view in &mut scene.views {
        let directions = view.camera.directions();
        let image = view.image.as_mut().unwrap();
        let alpha = image.alpha.clone().unwrap();
        for ((pixel, a), direction) in image.pixels.iter_mut().zip(alpha).zip(directions) {
            let behind = room(direction);
            *pixel = [0, 1, 2].map(|c| pixel[c] - (1.0 - a) * (1.0 - behind[c]));
        }
    }
    let truth = forget_alpha(&mut scene);
    assert!(agreement("spot in a room", &scene, &truth) > 0.92);

    scene.views[3].image = None;
    let message = mask::masks(&scene, &()).unwrap_err().to_string();
    assert!(message.contains(&scene.views[3].name), "{message}");
    scene.views.truncate(1);
    let message = mask::masks(&scene, &()).unwrap_err().to_string();
    assert!(message.contains("two views"), "{message}");
}

/// The photographs' own colours, also under transparent pixels.
fn uncovered(folder: &Path, scene: &mut Scene) {
    for view in &mut scene.views {
        let path = folder.join(format!("images/{}.png", view.name));
        let rgba = image::open(path).unwrap().to_rgba8();
        let alpha = rgba.pixels().map(|p| f32::from(p[3]) / 255.0);
        view.image = Some(DisplayImage {
            width: rgba.width() as usize,
            height: rgba.height() as usize,
            alpha: Some(alpha.collect()),
            pixels: rgba
                .pixels()
                .map(|p| [0, 1, 2].map(|c| f32::from(p[c]) / 255.0))
                .collect(),
        });
    }
}

#[test]
fn real_captures_are_found_before_their_backgrounds() {
    for name in ["ethiopian_head", "goldcape", "mother_child"] {
        let Some(folder) = extra(&format!("data/captures/{name}")) else {
            continue;
        };
        let mut scene = lumi_data::open(&folder).unwrap();
        uncovered(&folder, &mut scene);
        let truth = forget_alpha(&mut scene);
        assert!(agreement(name, &scene, &truth) >= 0.9, "{name}");
    }
}
