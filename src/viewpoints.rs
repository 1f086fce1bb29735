//! Where to look from: `targets`, `inputs`, `orbit:N`, a file of cameras or a path.

use crate::path;
use anyhow::{Context, Result, bail};
use lumi_core::{Camera, Light, Role, Scene, View};
use lumi_data::Orbit;
use serde::Deserialize;
use std::collections::HashSet;
use std::path::Path;

/// Where to look from at a capture without held-out views, if nobody says.
const ORBIT: &str = "orbit:24";

/// The views to render.
pub struct Viewpoints {
    /// Names and cameras in world space.
    pub cameras: Vec<(String, Camera)>,
    /// Of paths with light: all light of each view, in world space. Else empty.
    pub lights: Vec<Vec<Light>>,
}

/// The views to render, square at `side` pixels: held-out views or an orbit, if nobody says.
///
/// # Errors
/// If `what` names no views.
pub fn read(what: Option<&str>, scene: &Scene, side: usize) -> Result<Viewpoints> {
    let Some(path) = what.filter(|what| what.ends_with(".toml")) else {
        let cameras = cameras(what, scene, side)?;
        let lights = Vec::new();
        return Ok(Viewpoints { cameras, lights });
    };
    let frames = path::frames(Path::new(path), scene, side)?;
    let lit = frames.iter().any(|frame| !frame.lights.is_empty());
    let named = frames.iter().enumerate();
    let cameras = named.map(|(i, frame)| (format!("frame{i:04}"), frame.camera));
    Ok(Viewpoints {
        cameras: cameras.collect(),
        lights: match lit {
            true => frames.into_iter().map(|frame| frame.lights).collect(),
            false => Vec::new(),
        },
    })
}

fn cameras(what: Option<&str>, scene: &Scene, side: usize) -> Result<Vec<(String, Camera)>> {
    let held_out = !scene.with_role(Role::Target).is_empty();
    let what = what.unwrap_or(if held_out { "targets" } else { ORBIT });
    let of_role = |role| {
        let views = scene.with_role(role).into_iter().map(|i| &scene.views[i]);
        let square = |v: &View| {
            (
                v.name.clone(),
                lumi_data::views::square_camera(scene, &v.camera, side),
            )
        };
        views.map(square).collect::<Vec<_>>()
    };
    let cameras = match what {
        "inputs" => of_role(Role::Input),
        "targets" if !held_out => bail!(
            "--views targets: expected a capture with held-out views; inputs or orbit:N render others"
        ),
        "targets" => of_role(Role::Target),
        _ => match what.strip_prefix("orbit:") {
            Some(count) => orbit(count, scene, side)?,
            None => read_cameras(Path::new(what))?,
        },
    };
    if cameras.is_empty() {
        bail!("--views {what}: expected at least one view");
    }
    Ok(cameras)
}

/// Cameras once around the scene's ball, at the mean distance and elevation of the scene's own cameras.
fn orbit(count: &str, scene: &Scene, side: usize) -> Result<Vec<(String, Camera)>> {
    let n = match count.parse::<usize>() {
        Ok(n) if (1..=10_000).contains(&n) => n,
        _ => bail!("--views orbit:{count}: expected a number from 1 to 10000"),
    };
    let cameras = Orbit::of(scene).cameras(n, side, &scene.to_model);
    let named = cameras.into_iter().enumerate();
    Ok(named
        .map(|(i, camera)| (format!("orbit{i:04}"), camera))
        .collect())
}

/// A JSON list of {name, camera}, or of cameras.
fn read_cameras(path: &Path) -> Result<Vec<(String, Camera)>> {
    #[derive(Deserialize)]
    struct Named {
        name: String,
        camera: Camera,
    }
    let text = std::fs::read_to_string(path).with_context(|| {
        format!(
            "--views {}: expected targets, inputs, orbit:N, a JSON file of cameras or a TOML file of a path",
            path.display()
        )
    })?;
    let entries: Vec<serde_json::Value> =
        serde_json::from_str(&text).with_context(|| path.display().to_string())?;
    let mut files = HashSet::new();
    let read = |(i, entry): (usize, serde_json::Value)| {
        let named = if entry.get("camera").is_some() {
            serde_json::from_value(entry).map(|Named { name, camera }| (name, camera))
        } else {
            serde_json::from_value(entry).map(|camera| (format!("view{i:04}"), camera))
        };
        let place = || format!("{}: entry {i}", path.display());
        let (name, camera) = named.with_context(place)?;
        // Only a name's last part decides where its picture goes.
        if !files.insert(Path::new(&name).file_name().map(ToOwned::to_owned)) {
            let expected = "expected names that differ in their last part";
            bail!("{}: name: {expected}, found `{name}` again", place());
        }
        Ok((name, camera))
    };
    entries.into_iter().enumerate().map(read).collect()
}
