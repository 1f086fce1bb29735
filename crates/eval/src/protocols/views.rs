//! Protocols `multi-view` and `novel-view`: inputs under one light, views under others (paper §4, supplement).

use crate::Result;
use crate::baselines::{self, Seen, colour_ratio};
use crate::cases::{Subject, Target};
use crate::figures::Detail;
use crate::gallery::{Gallery, error_map};
use crate::metrics::{Judge, psnr};
use crate::picture::Picture;
use crate::report::{Case, ObjectRecord};
use lumi_core::glam::Vec3;
use lumi_core::{Camera, DisplayImage, Light, Point};
use lumi_model::{Edit, Relighter, SceneTokens};
use std::collections::BTreeMap;
use std::f32::consts::TAU;

/// Scores every target lighting of an object.
///
/// # Errors
/// If the model refuses the object's views or lights.
pub fn object(
    model: &Relighter,
    subject: &Subject,
    judge: &Judge,
    gallery: &mut Gallery,
) -> Result<ObjectRecord> {
    let tokens = subject.encode(model)?;
    let mut cases = BTreeMap::new();
    let mut before: Option<Before> = None;
    for (i, name) in subject.targets.iter().enumerate() {
        let target = subject.target(name)?;
        // Neither depends on the target lighting, and mostly the cameras are the same.
        let before = match before.take().filter(|b| b.cameras == target.cameras) {
            Some(same) => before.insert(same),
            None => before.insert(Before {
                seen: Seen::by(subject, &target.cameras),
                unedited: Picture::rendered(model, &tokens, &target.cameras)?,
                cameras: target.cameras.clone(),
            }),
        };
        let renders = relit(model, &tokens, &target)?;
        let mut trivial = baselines::figures(subject, &before.seen, &target, judge)?;
        let unedited = judge.figures(&before.unedited, &target.truth, Detail::Brief)?;
        trivial.insert("unedited".to_owned(), unedited);
        let figures = judge.figures(&renders, &target.truth, Detail::Full)?;
        // Another view for each lighting.
        let view = i % target.views.len();
        let pictures =
            |images: &[DisplayImage]| images.iter().cloned().map(Picture::from).collect();
        let nearest: Vec<Picture> = pictures(&before.seen.nearest);
        let ratio = colour_ratio(subject, &before.seen.nearest, &target);
        let ratio: Option<Vec<Picture>> = ratio.map(|images| pictures(&images));
        let shown = [
            ("nearest input", Some(&nearest)),
            ("colour ratio", ratio.as_ref()),
            ("unedited", Some(&before.unedited)),
            ("ours", Some(&renders)),
        ];
        let row = format!("{name}\n{}", target.views[view]);
        compare(gallery, judge, &row, shown, &target.truth, view)?;
        for (view, image) in target.views.iter().zip(renders) {
            gallery
                .predictions
                .push((name.clone(), view.clone(), image.shown));
        }
        let views = target.views;
        cases.insert(
            name.clone(),
            Case {
                views,
                figures,
                trivial,
            },
        );
    }
    if let Some(camera) = before.as_ref().and_then(|b| b.cameras.first()) {
        sweep(model, subject, &tokens, camera, gallery)?;
    }
    Ok(ObjectRecord::from_cases(cases))
}

/// Answers that do not depend on the target lighting.
struct Before {
    cameras: Vec<Camera>,
    seen: Seen,
    unedited: Vec<Picture>,
}

/// The target's views under its light: one edit where all views share it.
fn relit(model: &Relighter, tokens: &SceneTokens, target: &Target) -> Result<Vec<Picture>> {
    if let [lights] = target.lights.as_slice() {
        let edited = model.edit(tokens, &Edit::set(lights.clone()))?;
        return Picture::rendered(model, &edited, &target.cameras);
    }
    let mut images = Vec::new();
    for (i, camera) in target.cameras.iter().enumerate() {
        let edited = model.edit(tokens, &Edit::set(target.lights_of(i)))?;
        images.extend(Picture::rendered(
            model,
            &edited,
            std::slice::from_ref(camera),
        )?);
    }
    Ok(images)
}

/// A row of the qualitative grid, ours last: one view of a case, after one scale per channel for all its views.
fn compare(
    gallery: &mut Gallery,
    judge: &Judge,
    row: &str,
    shown: [(&str, Option<&Vec<Picture>>); 4],
    truth: &[Picture],
    view: usize,
) -> Result<()> {
    let expected = &truth[view].shown;
    let mut error = None;
    for (what, pictures) in shown {
        let Some(pictures) = pictures else { continue };
        let image = judge.aligned(pictures, truth)?.swap_remove(view);
        let caption = format!("{what} {:.1} dB", psnr(&image, expected));
        // The last one is ours.
        error = Some(error_map(&image, expected));
        gallery.add("grid", row, caption, image);
    }
    gallery.add("grid", row, "truth", expected.clone());
    if let Some(error) = error {
        gallery.add("grid", row, "error of ours", error);
    }
    Ok(())
}

/// Positions of the light in a sweep.
const POSITIONS: usize = 8;

/// One view while a point light goes around the object.
fn sweep(
    model: &Relighter,
    subject: &Subject,
    tokens: &SceneTokens,
    camera: &Camera,
    gallery: &mut Gallery,
) -> Result<()> {
    let to_world = subject.to_model.inverse();
    let ahead = camera.transformed(&subject.to_model).centre();
    let start = ahead.y.atan2(ahead.x);
    for i in 0..POSITIONS {
        let turn = TAU * i as f32 / POSITIONS as f32;
        let (s, c) = (start + turn).sin_cos();
        let position = Vec3::new(3.0 * c, 3.0 * s, 2.2);
        let light = Light::Point(Point::new(position, 600.0)).transformed(&to_world);
        let edited = model.edit(tokens, &Edit::set([light]))?;
        let caption = format!("{:.0}° from the camera", turn.to_degrees());
        for image in model.render(&edited, std::slice::from_ref(camera))? {
            gallery.add("light-sweep", &subject.name, caption.clone(), image);
        }
    }
    Ok(())
}
