//! Renders an object of an interchange scene and compares with the scene's images, which another renderer made:
//! `reference SCENE_DIR [--spp N] [--views N] [--denoise true|false] [--sheet FILE.png]`.
//!
//! The scene's `object.json` must name its `model` (glTF) and `model_to_world` (rows). Prints per light the ratio of the
//! mean radiance and the PSNR of the displayed object; the sheet shows reference and render side by side.

use anyhow::{Context, bail};
use image::{Rgb, RgbImage, imageops};
use lumi_core::glam::{Affine3A, Mat4, Vec4};
use lumi_core::{Camera, DisplayImage, Seed};
use lumi_render::film::{RenderSettings, render_basis};
use lumi_render::{integrator::PathSettings, models, scene::Geometry};
use std::path::PathBuf;

#[derive(serde::Deserialize)]
struct Object {
    model: PathBuf,
    model_to_world: [[f32; 4]; 4],
    /// What the other renderer's material had instead of the file's.
    roughness: Option<f32>,
}

fn main() -> anyhow::Result<()> {
    let (mut folder, mut sheet) = (None, None);
    let (mut samples, mut count, mut denoise) = (64, 4, true);
    let mut arguments = std::env::args().skip(1);
    while let Some(argument) = arguments.next() {
        let mut value = || {
            arguments
                .next()
                .with_context(|| format!("{argument} needs a value"))
        };
        match argument.as_str() {
            "--spp" => samples = value()?.parse()?,
            "--views" => count = value()?.parse()?,
            "--denoise" => denoise = value()?.parse()?,
            "--sheet" => sheet = Some(value()?),
            _ if argument.starts_with("--") => bail!("unknown option {argument}"),
            _ => folder = Some(PathBuf::from(&argument)),
        }
    }
    let folder = folder.context("usage: reference SCENE_DIR [options]")?;
    let scene = lumi_data::open(&folder)?;
    let truth = scene
        .basis
        .context("the scene has no images under single lights")?;
    let object: Object = serde_json::from_slice(&std::fs::read(folder.join("object.json"))?)?;

    let mut model = models::read(&folder.join(object.model))?.model;
    if let Some(roughness) = object.roughness {
        for material in &mut model.materials {
            if let Material::Textured(t) = material {
                t.factor.roughness = roughness;
            }
        }
    }
    let to_world = Mat4::from_cols_array_2d(&object.model_to_world).transpose();
    anyhow::ensure!(to_world.row(3) == Vec4::W, "model_to_world is not affine");
    model.mesh.transform(&Affine3A::from_mat4(to_world));
    let geometry = Geometry::new(model);
    let views: Vec<usize> = (0..scene.views.len())
        .step_by((scene.views.len() / count).max(1))
        .collect();
    let cameras: Vec<Camera> = views.iter().map(|&v| scene.views[v].camera).collect();
    let settings = RenderSettings {
        samples,
        paths: PathSettings::default(),
        denoise,
    };
    let start = std::time::Instant::now();
    let ours = render_basis(
        &geometry,
        truth.lights.clone(),
        &cameras,
        &settings,
        Seed(1),
    );
    println!(
        "{} triangles, {} views, {:.1} s",
        geometry.triangles(),
        views.len(),
        start.elapsed().as_secs_f32()
    );

    let mut tiles = Vec::new();
    for (l, light) in truth.lights.iter().enumerate() {
        let (mut error, mut values, mut sums) = (0.0_f64, 0.0_f64, [0.0_f64; 2]);
        for (i, &v) in views.iter().enumerate() {
            let (a, b) = (&truth.radiance[l][v], &ours.radiance[l][i]);
            let (shown_a, shown_b) = (a.to_display(), b.to_display());
            for p in (0..a.pixels.len()).filter(|&p| a.pixels[p][3] > 0.99) {
                for c in 0..3 {
                    error += f64::from(shown_a.pixels[p][c] - shown_b.pixels[p][c]).powi(2);
                    values += 1.0;
                    sums[0] += f64::from(a.pixels[p][c]);
                    sums[1] += f64::from(b.pixels[p][c]);
                }
            }
            tiles.extend([tile(&shown_a), tile(&shown_b)]);
        }
        let psnr = -10.0 * (error / values).log10();
        println!(
            "{:8} mean ratio {:.3}, object PSNR {psnr:.1} dB",
            light.name,
            sums[1] / sums[0]
        );
    }
    if let Some(sheet) = sheet {
        let (columns, side) = (2 * views.len() as u32, tiles[0].width());
        let mut all = RgbImage::new(columns * side, tiles.len() as u32 / columns * side);
        for (i, tile) in (0..).zip(&tiles) {
            imageops::replace(
                &mut all,
                tile,
                (i % columns * side).into(),
                (i / columns * side).into(),
            );
        }
        all.save(sheet)?;
    }
    Ok(())
}

fn tile(shown: &DisplayImage) -> RgbImage {
    RgbImage::from_fn(shown.width as u32, shown.height as u32, |x, y| {
        let p = shown.pixels[y as usize * shown.width + x as usize];
        Rgb(p.map(|v| (v * 255.0 + 0.5) as u8))
    })
}
