//! How well masks are found: photographs whose alpha is known, and whose colours under transparent pixels are still there,
//! are given without alpha, and what comes out is compared with it.
//!
//! `cargo run --release -p lumi-data --example mask_iou CAPTURE… [--out DIR]`

use lumi_core::{DisplayImage, Error, Result};
use std::path::Path;

fn main() -> Result<()> {
    let captures: Vec<String> = std::env::args().skip(1).collect();
    for capture in &captures {
        let mut scene = lumi_data::open(capture)?;
        let mut truth = Vec::new();
        for view in &mut scene.views {
            let path = Path::new(capture).join(format!("images/{}.png", view.name));
            let image = image::open(&path).map_err(|e| Error::invalid(&path, "image", e.to_string()))?;
            let rgba = image.to_rgba8();
            truth.push(rgba.pixels().map(|p| f32::from(p[3]) / 255.0).collect::<Vec<f32>>());
            view.image = Some(DisplayImage {
                width: rgba.width() as usize,
                height: rgba.height() as usize,
                pixels: rgba.pixels().map(|p| [0, 1, 2].map(|c| f32::from(p[c]) / 255.0)).collect(),
                alpha: None,
            });
        }
        let cameras: Vec<_> = scene.views.iter().map(|v| v.camera).collect();
        let views: Vec<_> = cameras.iter().map(|camera| lumi_data::ball::Silhouette { camera, alpha: None }).collect();
        let was = scene.to_model.inverse();
        let ball = lumi_data::ball::estimate(&views)?;
        println!("{capture}: radius by masks {:.2}, by cameras {:.2}, apart {:.2}", was.scale, ball.radius, was.point(glam::Vec3::ZERO).distance(ball.centre));
        scene.to_model = lumi_core::Similarity::to_unit_ball(ball.centre, ball.radius);
        let started = std::time::Instant::now();
        let found = lumi_data::mask::masks(&scene, &())?;
        let mut sum = 0.0;
        for ((view, found), truth) in scene.views.iter().zip(&found).zip(&truth) {
            let (mut both, mut either) = (0, 0);
            for (f, t) in found.iter().zip(truth) {
                both += usize::from(*f >= 0.5 && *t >= 0.5);
                either += usize::from(*f >= 0.5 || *t >= 0.5);
            }
            let iou = both as f32 / either.max(1) as f32;
            print!("{} {iou:.3}  ", view.name);
            sum += iou;
            if let Ok(dir) = std::env::var("DUMP") {
                let image = view.image.as_ref().expect("image");
                let side = DisplayImage {
                    pixels: image.pixels.iter().zip(found).zip(truth).map(|((p, f), t)| {
                        let g = 0.7 * (p[0] + p[1] + p[2]) / 3.0;
                        [g + 0.3 * f * 1.0, g + 0.3 * t, g]
                    }).collect(),
                    ..image.clone()
                };
                let name = Path::new(capture).file_name().unwrap_or_default().to_string_lossy().into_owned();
                lumi_core::image::write_png(format!("{dir}/{name}-{}.png", view.name), &side)?;
            }
        }
        println!("\n  mean {:.3} in {:.1} s", sum / found.len() as f32, started.elapsed().as_secs_f32());
    }
    Ok(())
}
