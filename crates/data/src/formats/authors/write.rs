//! From a scene to a split of the authors' layout.

use super::{FrameRecord, SceneFile, npy};
use crate::json;
use glam::Mat3;
use lumi_core::fs::atomic_write;
use lumi_core::image::{write_png, write_png_with_alpha};
use lumi_core::light::authors::{self, ENVIRONMENT_SIZE, RAYS};
use lumi_core::{DisplayImage, EnvMap, Environment, Error, Light, NamedLight, Result, Scene, View};
use std::path::{Path, PathBuf};

/// Writes `scene` into the split `folder`, which is created if need be. A light basis becomes one scene per
/// light, named by the authors' rules (`NAME_env_0`, `NAME_white_pl_0`, `NAME_rgb_pl_0`, `NAME_area_0`);
/// photographs become one, `NAME_env_0`, with their light where it is one and the same for all views.
/// Cameras and lights are in world units. Which views are held out, and powers beyond 10–1500 W, are lost.
///
/// # Errors
/// Names the view that has no photograph, the light that the layout has no place for, or the file that cannot be written.
pub fn write(folder: &Path, scene: &Scene) -> Result<()> {
    // The name becomes part of paths.
    if scene.name.is_empty()
        || scene.name.starts_with('.')
        || scene.name.contains(['/', '\\', '\0'])
    {
        let expected = format!("expected a plain name, found `{}`", scene.name);
        return Err(Error::value("name", expected));
    }
    let lights = scene.basis.iter().flat_map(|b| &b.lights);
    if let Some(odd) = lights
        .chain(common_light(scene))
        .find(|l| tag(&l.light).is_none())
    {
        let kind = odd.light.kind();
        let expected = format!("expected environments, point and area lights, found a {kind}");
        return Err(Error::value(format!("light `{}`", odd.name), expected));
    }
    std::fs::create_dir_all(folder).map_err(|e| Error::io(folder, e))?;
    let split = Split {
        folder: folder.canonicalize().map_err(|e| Error::io(folder, e))?,
    };
    let mut files = Vec::new();
    if let Some(basis) = &scene.basis {
        let mut counts = [0_usize; 4];
        for (light, images) in basis.lights.iter().zip(&basis.radiance) {
            let (kind, tag) = tag(&light.light).unwrap_or_default();
            let name = format!("{}_{tag}_{}", scene.name, counts[kind]);
            counts[kind] += 1;
            let shown = images.iter().map(lumi_core::LinearImage::to_display);
            let images: Vec<_> = shown.collect();
            files.push(split.write(&name, &scene.views, &images, std::slice::from_ref(light))?);
        }
    } else {
        let image = |v: &View| {
            let missing = || Error::value(format!("view `{}`", v.name), "expected a photograph");
            v.image.clone().ok_or_else(missing)
        };
        let images = scene.views.iter().map(image).collect::<Result<Vec<_>>>()?;
        let name = format!("{}_env_0", scene.name);
        files.push(split.write(&name, &scene.views, &images, common_light(scene))?);
    }
    let list: String = files.iter().map(|f| format!("{}\n", f.display())).collect();
    atomic_write(split.folder.join("full_list.txt"), list.as_bytes())
}

/// What the authors' code calls the folder of a light, and which of its kinds it is; it has no spots and suns.
fn tag(light: &Light) -> Option<(usize, &'static str)> {
    match light {
        Light::Environment(_) => Some((0, "env")),
        Light::Point(l) if l.color == [1.0; 3] => Some((1, "white_pl")),
        Light::Point(_) => Some((2, "rgb_pl")),
        Light::Area(_) => Some((3, "area")),
        Light::Spot(_) | Light::Sun(_) => None,
    }
}

/// The lights of all views, if they are the same; empty if not.
pub(in crate::formats) fn common_light(scene: &Scene) -> &[NamedLight] {
    let first = scene.lights_of(0);
    let same = |i: usize| {
        let (a, b) = (first, scene.lights_of(i));
        a.len() == b.len() && a.iter().zip(b).all(|(a, b)| a.light == b.light)
    };
    if (0..scene.views.len()).all(same) {
        first
    } else {
        &[]
    }
}

struct Split {
    folder: PathBuf,
}

impl Split {
    /// Writes one scene and returns its metadata file, which comes last.
    fn write(
        &self,
        name: &str,
        views: &[View],
        images: &[DisplayImage],
        lights: &[NamedLight],
    ) -> Result<PathBuf> {
        let pictures = self.make(&["images", name])?;
        let mut frames = Vec::with_capacity(views.len());
        for (i, (view, image)) in views.iter().zip(images).enumerate() {
            let path = pictures.join(format!("{i:05}.png"));
            write_png_with_alpha(&path, image)?;
            let c = &view.camera;
            frames.push(FrameRecord {
                image_path: path.to_string_lossy().into_owned(),
                fxfycxcy: [c.fx, c.fy, c.cx, c.cy].map(f64::from),
                w2c: json::rows(c.camera_to_world.inverse()),
            });
        }
        let local: Vec<Light> = lights
            .iter()
            .map(|l| l.light.clone())
            .filter(|l| !matches!(l, Light::Environment(_)))
            .collect();
        for light in lights {
            if let Light::Environment(environment) = &light.light {
                self.environment(name, views, environment)?;
            }
        }
        if !local.is_empty() {
            // The R2 sequence (Roberts 2018) spreads an area light's rays where the authors draw at random.
            let place = |i: usize, _| {
                [0.754_877_7, 0.569_840_3].map(|g: f32| (0.5 + g * (i + 1) as f32).fract() - 0.5)
            };
            let rows = authors::rays(&local, RAYS, place)?;
            let folder = self.make(&["point_light_rays"])?;
            atomic_write(folder.join(format!("{name}.npy")), &npy::encode(&rows))?;
        }
        let path = self.make(&["metadata"])?.join(format!("{name}.json"));
        let file = SceneFile {
            scene_name: name.to_owned(),
            frames,
        };
        json::write(&path, &file)?;
        Ok(path)
    }

    /// The camera-aligned pair of every frame. Strength is in the radiance; the authors' code leaves it out.
    fn environment(&self, name: &str, views: &[View], light: &Environment) -> Result<()> {
        let folder = self.make(&["envmaps", name])?;
        let (height, width) = ENVIRONMENT_SIZE;
        for (i, view) in views.iter().enumerate() {
            let rotation = Mat3::from_mat4(view.camera.camera_to_world);
            let directions = authors::world_directions(rotation, height, width);
            let encoded = authors::encode(&EnvMap {
                width,
                height,
                pixels: directions.into_iter().map(|d| light.radiance(d)).collect(),
            });
            for (kind, bytes) in [("ldr", &encoded.ldr), ("hdr", &encoded.hdr)] {
                let image = DisplayImage {
                    width,
                    height,
                    pixels: bytes
                        .iter()
                        .map(|p| p.map(|v| f32::from(v) / 255.0))
                        .collect(),
                    alpha: None,
                };
                write_png(folder.join(format!("{i:05}_{kind}.png")), &image)?;
            }
        }
        Ok(())
    }

    fn make(&self, parts: &[&str]) -> Result<PathBuf> {
        let folder: PathBuf = std::iter::once(self.folder.as_path())
            .chain(parts.iter().map(Path::new))
            .collect();
        std::fs::create_dir_all(&folder).map_err(|e| Error::io(&folder, e))?;
        Ok(folder)
    }
}
