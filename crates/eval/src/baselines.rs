//! Answers that take no relighting model. Anything worth its weights must beat them.

use crate::align::{Scale, apply};
use crate::cases::Subject;
use crate::Result;
use lumi_core::light::RayPattern;
use lumi_core::{DisplayImage, Light, Similarity, View};
use lumi_data::Lighting;

/// For each compared view, the input image whose optical axis is closest in angle.
#[must_use]
pub fn nearest(subject: &Subject) -> Vec<DisplayImage> {
    let forward = |v: &View| v.camera.forward();
    let closest = |axis| {
        let closeness = |v: &&View| forward(v).dot(axis);
        let best = subject
            .inputs
            .iter()
            .max_by(|a, b| closeness(a).total_cmp(&closeness(b)))?;
        best.image.clone()
    };
    let axes = subject.cameras.iter().map(lumi_core::Camera::forward);
    axes.filter_map(closest).collect()
}

/// Colour-ratio relighting: the object in each image scaled, in linear colour, by the ratio of the light that
/// arrives from all sides, target over source. For environments this is the ratio of the maps' mean colours.
///
/// # Errors
/// If the lighting names an unknown light.
pub fn colour_ratio(
    subject: &Subject,
    images: &[DisplayImage],
    target: &Lighting,
) -> Result<Vec<DisplayImage>> {
    let to_model = &subject.scene.to_model;
    let from = arriving(&subject.lights(&subject.cases.source)?, to_model);
    let to = arriving(&subject.lights(target)?, to_model);
    let ratio: Scale = std::array::from_fn(|c| {
        let ratio = to[c] / from[c];
        if ratio.is_finite() { ratio } else { 1.0 }
    });
    // An image is its own mask.
    Ok(images.iter().map(|image| apply(image, image, ratio)).collect())
}

/// Light that arrives at the scene's centre from all sides, per channel.
fn arriving(lights: &[Light], to_model: &Similarity) -> Scale {
    let mut sum = [0.0; 3];
    for light in lights {
        for ray in light.transformed(to_model).rays(&RayPattern::default()) {
            for c in 0..3 {
                sum[c] += ray.irradiance[c];
            }
        }
    }
    sum
}
