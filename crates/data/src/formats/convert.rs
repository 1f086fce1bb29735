//! From one format to another: what may be written where, and what is lost.

use super::Opening;
use super::authors::common_light;
use lumi_core::light::authors::POWER_RANGE;
use lumi_core::{Error, Result, Role, Scene};
use std::path::{Path, PathBuf};

/// Checks that a scene that was read from `source` may be written into `out`: into a folder that is empty or not there
/// yet, or into any other with `overwrite`; never into the source, below it or around it.
///
/// # Errors
/// Says which it is.
pub fn check_target(source: &Path, out: &Path, overwrite: bool) -> Result<()> {
    let refused = |expected: &str| Err(Error::invalid(out, "output", expected));
    if out.exists() && !out.is_dir() {
        return refused("expected a folder, found a file");
    }
    let (from, to) = (resolved(source)?, resolved(out)?);
    // A file opens a whole folder of a format that has one file per scene.
    let from = match from.parent().and_then(Path::parent) {
        Some(split) if from.is_file() => split.to_owned(),
        _ => from,
    };
    if from == to {
        return refused("expected another folder than the capture's own");
    }
    if to.starts_with(&from) {
        return refused("expected a folder outside the capture's own");
    }
    let mut entries = match std::fs::read_dir(out) {
        Ok(entries) => entries,
        Err(_) if !out.exists() => return Ok(()),
        Err(e) => return Err(Error::io(out, e)),
    };
    if !overwrite && entries.next().is_some() {
        return refused("expected an empty folder, or --overwrite to write into this one");
    }
    if from.starts_with(&to) {
        return refused("expected a folder that does not hold the capture itself");
    }
    Ok(())
}

/// The full path of what may not exist yet: of its nearest parent that does, and the rest.
fn resolved(path: &Path) -> Result<PathBuf> {
    let full = std::path::absolute(path).map_err(|e| Error::io(path, e))?;
    for parent in full.ancestors() {
        if let Ok(real) = parent.canonicalize() {
            let rest = full.strip_prefix(parent).unwrap_or(Path::new(""));
            return Ok(real.join(rest));
        }
    }
    Ok(full)
}

/// How to read a scene that is to be converted: every pixel, unless a longest side is asked for.
#[must_use]
pub fn opening(longest_side: Option<usize>) -> Opening {
    longest_side.map_or(Opening::FULL, |longest_side| Opening {
        longest_side,
        ..Opening::FULL
    })
}

/// The scene with all images of at most `side` pixels along their longer side, cameras with them.
#[must_use]
pub fn reduced(mut scene: Scene, side: usize) -> Scene {
    for (i, view) in scene.views.iter_mut().enumerate() {
        let longer = view.camera.width.max(view.camera.height);
        if longer <= side || side == 0 {
            continue;
        }
        let scaled = |s: usize| (s * side).div_ceil(longer);
        let (width, height) = (scaled(view.camera.width), scaled(view.camera.height));
        view.camera = view.camera.resized(width, height);
        view.image = view.image.take().map(|image| image.resized(width, height));
        let basis = scene.basis.iter_mut();
        let lit = basis.flat_map(|b| b.radiance.iter_mut().filter_map(|views| views.get_mut(i)));
        let photographed = scene.radiance.get_mut(i).and_then(Option::as_mut);
        for image in lit.chain(photographed) {
            *image = image.resized(width, height);
        }
    }
    scene
}

/// What the format called `to` cannot hold of the scene, a line each.
#[must_use]
pub fn losses(scene: &Scene, to: &str) -> Vec<String> {
    let mut lost = Vec::new();
    let lit = scene.lit_by.iter().filter(|l| !l.is_empty()).count();
    let bright = scene.radiance.iter().flatten().count();
    match to {
        "transforms" => {
            if lit > 0 {
                lost.push(format!(
                    "the lights of {lit} photographs have no place in {to} and were left out"
                ));
            }
            if bright > 0 {
                lost.push(format!(
                    "{bright} photographs hold linear radiance, which PNG cannot: what is brighter than white was clipped"
                ));
            }
        }
        "authors" => {
            let held = scene.with_role(Role::Target).len();
            if held > 0 {
                lost.push(format!("{to} does not say that {held} views are held out"));
            }
            lost.push(format!(
                "{to} has no bounding ball; it is estimated when read"
            ));
            let all = scene.basis.iter().flat_map(|b| &b.lights);
            let all: Vec<_> = all.chain(scene.lit_by.iter().flatten()).collect();
            let (low, high) = POWER_RANGE;
            let beyond = |power: f32| !(low..=high).contains(&power);
            let odd = all.iter().filter_map(|l| l.light.power());
            let odd = odd.filter(|power| beyond(*power)).count();
            if odd > 0 {
                lost.push(format!(
                    "{to} holds powers of {low} to {high} W; those of {odd} lights were clipped"
                ));
            }
            if all.iter().any(|l| l.light.kind() == "environment") {
                lost.push(format!(
                    "{to} holds environment maps in 8 bits: they are coarser"
                ));
            }
            if lit > 0 && scene.basis.is_none() && common_light(scene).is_empty() {
                lost.push(format!(
                    "{to} has one light for all photographs; theirs differ and were left out"
                ));
            }
            if bright > 0 {
                lost.push(format!(
                    "{bright} photographs hold linear radiance; it was clipped"
                ));
            }
        }
        _ => {
            if scene.basis.is_some() && scene.views.iter().any(|v| v.image.is_some()) {
                lost.push(format!("{to} holds no photographs; they were left out"));
            }
        }
    }
    lost
}
