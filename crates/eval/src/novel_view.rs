//! Protocol `novel-view`: inputs under one light, held-out views under others (paper §4, supplement).

use crate::Result;
use crate::align::{apply, fit};
use crate::metrics::{psnr, psnr_where};
use crate::report::{Report, Row, Scores};
use lumi_core::{DisplayImage, Event, Progress, View};
use lumi_data::manifest::ObjectCases;
use lumi_data::views::square_camera;
use lumi_data::{Manifest, views_under};
use lumi_model::{Edit, Relighter};
use std::collections::BTreeMap;
use std::path::Path;

/// Evaluates every object of the manifest in `folder`, except those named in `skip`, at the model's
/// resolution. Objects that fail are listed with the cause; the others count.
///
/// # Errors
/// If the manifest cannot be read, or no object could be evaluated.
pub fn novel_view(
    model: &Relighter,
    folder: &Path,
    skip: &[String],
    progress: &dyn Progress,
) -> Result<Report> {
    let manifest = Manifest::read(folder)?;
    for name in skip {
        manifest.cases(name)?;
    }
    let objects: Vec<_> = manifest
        .objects
        .iter()
        .filter(|(name, _)| !skip.contains(name))
        .collect();
    progress.event(Event::Begin {
        stage: "evaluating".into(),
        total: objects.len() as u64,
    });
    let mut per_object = BTreeMap::new();
    let mut targets: BTreeMap<String, Vec<Row>> = BTreeMap::new();
    let mut failures = BTreeMap::new();
    for (i, (name, cases)) in objects.iter().enumerate() {
        match object(model, &manifest, name, cases) {
            Ok(rows) => {
                let all: Vec<Row> = rows.values().copied().collect();
                per_object.insert((*name).clone(), Row::mean(&all));
                for (target, row) in rows {
                    targets.entry(target).or_default().push(row);
                }
            }
            Err(e) => {
                failures.insert((*name).clone(), e.to_string());
            }
        }
        progress.event(Event::Step {
            done: i as u64 + 1,
            note: (*name).clone(),
        });
    }
    progress.event(Event::End);
    if per_object.is_empty() {
        let causes: Vec<_> = failures.values().cloned().collect();
        let expected = format!(
            "expected at least one object to evaluate: {}",
            causes.join("; ")
        );
        return Err(lumi_core::Error::invalid(folder, "objects", expected).into());
    }
    let mean = Row::mean(&per_object.values().copied().collect::<Vec<_>>());
    let per_target = targets.into_iter().map(|(name, rows)| {
        let row = Row::mean(&rows);
        (name, [row.model.slr, row.nearest.slr, row.unedited.slr])
    });
    Ok(Report {
        protocol: "novel-view".into(),
        model: format!("{} ({})", model.fingerprint, model.provenance.origin),
        data: folder.display().to_string(),
        resolution: model.config.resolution,
        mean,
        per_target: per_target.collect(),
        per_object,
        failures,
    })
}

/// One row per target lighting of an object.
fn object(
    model: &Relighter,
    manifest: &Manifest,
    name: &str,
    cases: &ObjectCases,
) -> Result<BTreeMap<String, Row>> {
    let side = model.config.resolution;
    let scene = manifest.open(name)?;
    let inputs = ObjectCases::indices(&scene, &cases.inputs)?;
    let inputs = views_under(&scene, &inputs, &cases.source, side)?;
    let held = ObjectCases::indices(&scene, &cases.views)?;
    let square = |&i: &usize| square_camera(&scene, &scene.views[i].camera, side);
    let cameras: Vec<_> = held.iter().map(square).collect();
    let tokens = model.encode(&inputs, scene.to_model)?;
    // The trivial answers do not depend on the target lighting.
    let unedited = model.render(&tokens, &cameras)?;
    let nearest: Vec<_> = cameras
        .iter()
        .filter_map(|c| nearest(&inputs, c.forward()))
        .collect();
    let mut rows = BTreeMap::new();
    for (target, lighting) in &cases.targets {
        let truth = views_under(&scene, &held, lighting, side)?;
        let truth: Vec<DisplayImage> = truth.into_iter().filter_map(|v| v.image).collect();
        let edited = model.edit(&tokens, &Edit::set(lighting.lights(&scene)?))?;
        rows.insert(
            target.clone(),
            Row {
                model: score(&model.render(&edited, &cameras)?, &truth),
                nearest: score(&nearest, &truth),
                unedited: score(&unedited, &truth),
            },
        );
    }
    Ok(rows)
}

/// The input whose optical axis is closest in angle.
fn nearest(inputs: &[View], forward: lumi_core::glam::Vec3) -> Option<DisplayImage> {
    let closeness = |v: &&View| v.camera.forward().dot(forward);
    inputs
        .iter()
        .max_by(|a, b| closeness(a).total_cmp(&closeness(b)))?
        .image
        .clone()
}

/// Scores of one case's views.
fn score(predictions: &[DisplayImage], truth: &[DisplayImage]) -> Scores {
    let pairs: Vec<_> = predictions.iter().zip(truth).collect();
    let mean = |f: &dyn Fn(&DisplayImage, &DisplayImage) -> f64| {
        pairs.iter().map(|(p, t)| f(p, t)).sum::<f64>() / pairs.len().max(1) as f64
    };
    let scale = fit(&pairs);
    Scores {
        raw: mean(&psnr),
        ilr: mean(&|p, t| psnr(&apply(p, t, fit(&[(p, t)])), t)),
        slr: mean(&|p, t| psnr(&apply(p, t, scale), t)),
        slr_object: mean(&|p, t| {
            let on_object = |i: usize| t.alpha.as_ref().is_none_or(|a| a[i] > 0.5);
            psnr_where(&apply(p, t, scale), t, &on_object)
        }),
    }
}
