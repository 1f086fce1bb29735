//! Blender's Cycles as a second renderer: the same jobs, rendered by Blender's Python module `bpy`, one light at a time.
//!
//! Blender runs as a program of its own: `bpy` 4.5 for Python 3.11, installed once with
//!
//! ```text
//! python3.11 -m venv blender && blender/bin/pip install "bpy==4.5.*"
//! ```
//!
//! and named with `--python blender/bin/python`. What it needs of a job is written to a temporary folder
//! ([`export`]); `render.py` builds the scene from it and writes an EXR file per view and light.

mod bake;

use crate::generate::Job;
use crate::scene::Geometry;
use lumi_core::image::{read_linear, write_exr};
use lumi_core::{Camera, Error, Light, LightBasis, LinearImage, NamedLight, Result};
use serde_json::{Value, json};
use std::path::{Path, PathBuf};
use std::process::Command;

/// The script that drives Blender.
const SCRIPT: &str = include_str!("render.py");
/// How to get what is missing.
const INSTALL: &str =
    "an interpreter with Blender's module: python3.11 -m pip install \"bpy==4.5.*\"";

/// Blender, as a Python interpreter that has `bpy`.
#[derive(Clone, Debug)]
pub struct Cycles {
    /// The interpreter's path or name.
    pub python: PathBuf,
    /// Threads that Blender uses; 0 for all.
    pub threads: u32,
}

/// What Blender made of a job.
#[derive(Clone, Debug)]
pub struct Rendered {
    /// The images.
    pub basis: LightBasis,
    /// Base colour and coverage per view, premultiplied.
    pub albedo: Vec<LinearImage>,
    /// Seconds of each image's render, light by light and in each view by view.
    pub seconds: Vec<f64>,
}

impl Cycles {
    /// Blender with all threads.
    #[must_use]
    pub fn new(python: impl Into<PathBuf>) -> Self {
        Self {
            python: python.into(),
            threads: 0,
        }
    }

    /// Renders the job with `samples` paths per pixel, each light by itself.
    ///
    /// # Errors
    /// If Blender cannot be run or fails: with the last lines of what it said.
    pub fn render(&self, job: &Job, samples: u32, denoise: bool) -> Result<Rendered> {
        let folder = tempfile::tempdir().map_err(|e| Error::io(std::env::temp_dir(), e))?;
        let path = folder.path();
        let mut scene = export(job, path)?;
        scene["samples"] = samples.into();
        scene["denoise"] = denoise.into();
        scene["threads"] = self.threads.into();
        scene["seed"] = (job.pixels.0 as u32 & 0x7fff_ffff).into();
        let text = scene.to_string();
        lumi_core::fs::atomic_write(path.join("scene.json"), text.as_bytes())?;
        let script = path.join("render.py");
        lumi_core::fs::atomic_write(&script, SCRIPT.as_bytes())?;

        let output = Command::new(&self.python).arg(&script).arg(path).output();
        let output = output.map_err(|e| {
            let found = format!("expected {INSTALL}; `{}`: {e}", self.python.display());
            Error::value("python", found)
        })?;
        if !output.status.success() {
            let said = String::from_utf8_lossy(&output.stderr);
            let mut last: Vec<&str> = said.lines().rev().take(4).collect();
            last.reverse();
            let found = format!("Blender failed ({}): {}", output.status, last.join(" | "));
            let hint = if said.contains("No module named 'bpy'") {
                format!("; expected {INSTALL}")
            } else {
                String::new()
            };
            return Err(Error::value("cycles", found + &hint));
        }
        let seconds = lumi_core::fs::read_bytes(path.join("seconds.json"))?;
        let seconds = serde_json::from_slice(&seconds)
            .map_err(|e| Error::invalid(path, "seconds.json", e.to_string()))?;
        let images = |what: String| -> Result<Vec<LinearImage>> {
            (0..job.cameras.len())
                .map(|v| read_linear(path.join(format!("v{v:03}_{what}.exr"))))
                .collect()
        };
        let radiance = (0..job.lights.len()).map(|l| images(format!("l{l:03}")));
        Ok(Rendered {
            basis: LightBasis {
                lights: job.lights.clone(),
                radiance: radiance.collect::<Result<_>>()?,
            },
            albedo: images("albedo".to_owned())?,
            seconds,
        })
    }
}

/// Writes meshes, textures and maps to `folder`, and says in JSON what they are: everything that `render.py` reads.
///
/// # Errors
/// If a file cannot be written.
pub fn export(job: &Job, folder: &Path) -> Result<Value> {
    let baked = bake::bake(&Geometry::new(job.model.clone()));
    lumi_core::fs::atomic_write(folder.join("mesh.bin"), &baked.mesh)?;
    for (name, image) in [
        ("base", &baked.base),
        ("properties", &baked.properties),
        ("relief", &baked.relief),
    ] {
        write_exr(folder.join(format!("{name}.exr")), image)?;
    }
    if let Some(tint) = &baked.tint {
        write_exr(folder.join("tint.exr"), tint)?;
    }
    let lights = job.lights.iter().enumerate();
    let lights: Result<Vec<Value>> = lights.map(|(i, l)| light(i, l, folder)).collect();
    Ok(json!({
        "triangles": baked.triangles,
        "has_relief": baked.has_relief,
        "has_tint": baked.tint.is_some(),
        "see_through": baked.see_through,
        "cameras": job.cameras.iter().map(camera).collect::<Vec<_>>(),
        "lights": lights?,
        "max_bounces": 12,
    }))
}

fn camera(c: &Camera) -> Value {
    json!({
        "width": c.width, "height": c.height,
        "fx": c.fx, "fy": c.fy, "cx": c.cx, "cy": c.cy,
        "camera_to_world": c.camera_to_world.transpose().to_cols_array_2d(),
    })
}

fn light(index: usize, named: &NamedLight, folder: &Path) -> Result<Value> {
    Ok(match &named.light {
        Light::Environment(e) => {
            let file = format!("map{index:03}.exr");
            write_exr(folder.join(&file), &e.map.to_image())?;
            json!({
                "type": "environment", "file": file, "strength": e.strength,
                "rotation": e.orientation().transpose().to_cols_array_2d(),
            })
        }
        Light::Point(p) => json!({
            "type": "point", "position": p.position.to_array(), "radius": p.radius,
            "power": p.power, "color": p.color,
        }),
        Light::Area(a) => json!({
            "type": "area", "position": a.position.to_array(), "size": a.size,
            "direction": a.direction().to_array(), "side": a.sides()[0].to_array(),
            "power": a.power, "color": a.color,
        }),
        // Blender's angles are radians.
        Light::Spot(s) => json!({
            "type": "spot", "position": s.position.to_array(), "radius": s.radius,
            "direction": s.direction().to_array(), "power": s.power, "color": s.color,
            "angle": s.angle.to_radians(), "blend": s.blend,
        }),
        Light::Sun(s) => json!({
            "type": "sun", "direction": (-s.toward()).to_array(),
            "strength": s.strength, "angle": s.angle.to_radians(), "color": s.color,
        }),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::generate::{Assets, GenerateConfig};
    use lumi_core::glam::Vec3;
    use lumi_core::{Spot, Sun};
    use std::f32::consts::FRAC_PI_2;

    fn job() -> Job {
        let config = GenerateConfig {
            resolution: 16,
            views: 2,
            ..GenerateConfig::default()
        };
        config.job(3, &Assets::default()).expect("a job")
    }

    #[test]
    fn exports_everything_that_the_script_reads() {
        let folder = tempfile::tempdir().expect("folder");
        let job = job();
        let scene = export(&job, folder.path()).expect("exported");
        let mesh = std::fs::metadata(folder.path().join("mesh.bin")).expect("mesh");
        let triangles = scene["triangles"].as_u64().expect("number");
        assert_eq!(mesh.len(), triangles * 3 * 8 * 4);
        assert_eq!(scene["cameras"].as_array().expect("cameras").len(), 2);
        for light in scene["lights"].as_array().expect("lights") {
            if let Some(file) = light.get("file") {
                assert!(folder.path().join(file.as_str().expect("name")).exists());
            }
        }
        for name in ["base", "properties", "relief"] {
            let image = read_linear(folder.path().join(format!("{name}.exr"))).expect("image");
            assert!(
                image
                    .pixels
                    .iter()
                    .flatten()
                    .all(|v| (0.0..=1.0).contains(v))
            );
        }
    }

    #[test]
    fn spots_and_suns_are_told_in_radians_and_by_where_they_shine() {
        let folder = tempfile::tempdir().expect("folder");
        let spot = Spot {
            angle: 90.0,
            ..Spot::facing(Vec3::new(0.0, 0.0, 4.0), Vec3::ZERO, 500.0)
        };
        let told = |light| {
            let name = "light".to_owned();
            super::light(0, &NamedLight { name, light }, folder.path()).expect("told")
        };
        let said = told(Light::Spot(spot));
        let angle = said["angle"].as_f64().expect("a number") as f32;
        assert!((angle - FRAC_PI_2).abs() < 1e-6);
        assert_eq!(said["direction"], json!([0.0, 0.0, -1.0]));
        let said = told(Light::Sun(Sun::new(Vec3::new(0.0, 5.0, 0.0), 3.0)));
        assert_eq!(said["direction"], json!([-0.0, -1.0, -0.0]));
        assert_eq!(said["strength"], 3.0);
        // Every kind that the script is told is one it makes.
        for kind in ["point", "area", "spot", "sun"] {
            assert!(
                SCRIPT.contains(&format!("\"{}\"", kind.to_uppercase())),
                "{kind}"
            );
        }
    }

    #[test]
    fn a_missing_or_wrong_interpreter_is_told_with_the_remedy() {
        let message = |python: &str| {
            let error = Cycles::new(python).render(&job(), 1, false);
            error.expect_err("no Blender").to_string()
        };
        assert!(message("/nowhere/python").contains("bpy==4.5"));
        assert!(message("false").contains("Blender failed"));
    }
}
