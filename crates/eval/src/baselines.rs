//! Answers that take no relighting model. Anything worth its weights must beat them.

use crate::Result;
use crate::align::{Scale, apply};
use crate::cases::{Subject, Target};
use crate::figures::{Detail, Figures};
use crate::metrics::Judge;
use crate::picture::Picture;
use lumi_core::light::RayPattern;
use lumi_core::{Camera, DisplayImage, Light, Reprojection, Similarity, View};
use std::collections::BTreeMap;

/// What cameras see of the inputs without any model.
pub struct Seen {
    /// For each, the input image whose optical axis is closest in angle.
    pub nearest: Vec<DisplayImage>,
    /// For each, the input images carried into its view by geometry alone ([`lumi_core::reprojection`]).
    pub reprojected: Vec<DisplayImage>,
}

impl Seen {
    /// By some cameras.
    #[must_use]
    pub fn by(subject: &Subject, cameras: &[Camera]) -> Self {
        Self {
            nearest: nearest(subject, cameras),
            reprojected: reprojected(subject, cameras),
        }
    }
}

fn reprojected(subject: &Subject, cameras: &[Camera]) -> Vec<DisplayImage> {
    let moved = |camera: &Camera| camera.transformed(&subject.to_model);
    let inputs = subject.inputs.iter();
    let placed = inputs.filter_map(|view| Some((view.image.as_ref()?, moved(&view.camera))));
    let placed: Vec<_> = placed.collect();
    let photographs = Reprojection::new(placed.iter().map(|(image, camera)| (*image, camera)));
    let seen = cameras.iter().map(|c| photographs.picture(&moved(c)));
    seen.collect()
}

fn nearest(subject: &Subject, cameras: &[Camera]) -> Vec<DisplayImage> {
    let closest = |axis| {
        let closeness = |v: &&View| v.camera.forward().dot(axis);
        let best = subject
            .inputs
            .iter()
            .max_by(|a, b| closeness(a).total_cmp(&closeness(b)))?;
        best.image.clone()
    };
    cameras
        .iter()
        .map(Camera::forward)
        .filter_map(closest)
        .collect()
}

/// Colour-ratio relighting: the object in each image scaled, in linear colour, by the ratio of the light that
/// arrives from all sides, target over source. For environments this is the ratio of the maps' mean colours.
/// `None` where the light of the inputs is not known.
#[must_use]
pub fn colour_ratio(
    subject: &Subject,
    images: &[DisplayImage],
    target: &Target,
) -> Option<Vec<DisplayImage>> {
    let from = arriving(subject.source.as_ref()?, &subject.to_model);
    let scaled = images.iter().enumerate().map(|(i, image)| {
        let to = arriving(target.lights_of(i), &subject.to_model);
        let ratio: Scale = std::array::from_fn(|c| {
            let ratio = to[c] / from[c];
            if ratio.is_finite() { ratio } else { 1.0 }
        });
        // An image is its own mask.
        let image = Picture::from(image.clone());
        apply(&image, &image, ratio).shown
    });
    Some(scaled.collect())
}

/// Scores of the answers that take no model at all.
///
/// # Errors
/// As [`Judge::figures`].
pub fn figures(
    subject: &Subject,
    seen: &Seen,
    target: &Target,
    judge: &Judge,
) -> Result<BTreeMap<String, Figures>> {
    let mut all = BTreeMap::new();
    let mut score = |name: &str, images: &[DisplayImage]| -> Result<()> {
        let found = judge.figures(&Picture::all(images), &target.truth, Detail::Brief)?;
        all.insert(name.to_owned(), found);
        Ok(())
    };
    score("nearest", &seen.nearest)?;
    if let Some(images) = colour_ratio(subject, &seen.nearest, target) {
        score("colour_ratio", &images)?;
    }
    if let Some(images) = colour_ratio(subject, &seen.reprojected, target) {
        score("reprojection", &images)?;
    }
    Ok(all)
}

/// Light that arrives at the scene's centre from all sides, per channel.
fn arriving(lights: &[Light], to_model: &Similarity) -> Scale {
    let mut sum = [0.0; 3];
    for light in lights {
        for ray in light.transformed(to_model).rays(&RayPattern::default()) {
            sum.iter_mut()
                .zip(ray.irradiance)
                .for_each(|(s, e)| *s += e);
        }
    }
    sum
}
