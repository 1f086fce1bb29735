//! Protocols `multi-view` and `novel-view`: inputs under one light, views under others (paper §4, supplement).

use crate::Result;
use crate::baselines::{colour_ratio, nearest};
use crate::cases::Subject;
use crate::figures::{Detail, Figures};
use crate::gallery::{Gallery, error_map};
use crate::metrics::{Judge, psnr};
use crate::report::{Case, ObjectRecord};
use lumi_core::glam::Vec3;
use lumi_core::{DisplayImage, Light, Point};
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
    let tokens = model.encode(&subject.inputs, subject.scene.to_model)?;
    // Neither depends on the target lighting.
    let unedited = model.render(&tokens, &subject.cameras)?;
    let nearest = nearest(subject);
    let mut cases = BTreeMap::new();
    for (i, (target, lighting)) in subject.cases.targets.iter().enumerate() {
        let truth = subject.truth(lighting)?;
        let edited = model.edit(&tokens, &Edit::set(subject.lights(lighting)?))?;
        let renders = model.render(&edited, &subject.cameras)?;
        let ratio = colour_ratio(subject, &nearest, lighting)?;
        let brief = |images: &[DisplayImage]| judge.figures(images, &truth, Detail::Brief);
        let trivial: BTreeMap<String, Figures> = [
            ("nearest".to_owned(), brief(&nearest)?),
            ("unedited".to_owned(), brief(&unedited)?),
            ("colour_ratio".to_owned(), brief(&ratio)?),
        ]
        .into();
        let figures = judge.figures(&renders, &truth, Detail::Full)?;
        // Another view for each lighting.
        let view = i % subject.views.len();
        let shown = [&nearest, &ratio, &unedited, &renders, &truth].map(|images| &images[view]);
        compare(gallery, target, &subject.views[view], shown);
        for (name, image) in subject.views.iter().zip(renders) {
            gallery.predictions.push((target.clone(), name.clone(), image));
        }
        let case = Case {
            views: subject.views.clone(),
            figures,
            trivial,
        };
        cases.insert(target.clone(), case);
    }
    sweep(model, subject, &tokens, gallery)?;
    Ok(ObjectRecord::from_cases(cases))
}

/// A row of the qualitative grid; PSNR as it is.
fn compare(gallery: &mut Gallery, target: &str, view: &str, shown: [&DisplayImage; 5]) {
    let [nearest, ratio, unedited, ours, truth] = shown;
    let row = format!("{target}\n{view}");
    let mut add = |what: &str, image: &DisplayImage| {
        let caption = format!("{what} {:.1} dB", psnr(image, truth));
        gallery.add("grid", &row, caption, image.clone());
    };
    add("nearest input", nearest);
    add("colour ratio", ratio);
    add("unedited", unedited);
    add("ours", ours);
    gallery.add("grid", &row, "truth", truth.clone());
    gallery.add("grid", &row, "error of ours", error_map(ours, truth));
}

/// Positions of the light in a sweep.
const POSITIONS: usize = 8;

/// One view while a point light goes around the object.
fn sweep(
    model: &Relighter,
    subject: &Subject,
    tokens: &SceneTokens,
    gallery: &mut Gallery,
) -> Result<()> {
    let Some(camera) = subject.cameras.first() else {
        return Ok(());
    };
    let to_world = subject.scene.to_model.inverse();
    let ahead = camera.transformed(&subject.scene.to_model).centre();
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
