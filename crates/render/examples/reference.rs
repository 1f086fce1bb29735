//! Compares our renders with Blender Cycles' and prints a table:
//! `reference CYCLES_DIR|COMPARE_DIR.. [--spp N] [--step N] [--sheet FILE.png]`.
//!
//! A folder is an object of `data/cycles` (interchange layout with an `object.json` that names its `model`), of which
//! every `--step`-th view is compared, or `data/compare` with its `scene.json`. The sheet shows theirs and ours side
//! by side, a row per light, for the last folder.

#![allow(clippy::unwrap_used, dead_code)]

#[path = "../tests/support/mod.rs"]
mod support;

use anyhow::{Context, bail};
use image::{Rgb, RgbImage, imageops};
use lumi_core::LinearImage;
use std::path::Path;
use std::time::Instant;

fn main() -> anyhow::Result<()> {
    let (mut folders, mut sheet) = (Vec::new(), None);
    let (mut samples, mut step) = (64, 4);
    let mut arguments = std::env::args().skip(1);
    while let Some(argument) = arguments.next() {
        let mut value = || {
            arguments
                .next()
                .with_context(|| format!("{argument} needs a value"))
        };
        match argument.as_str() {
            "--spp" => samples = value()?.parse()?,
            "--step" => step = value()?.parse()?,
            "--sheet" => sheet = Some(value()?),
            _ if argument.starts_with("--") => bail!("unknown option {argument}"),
            _ => folders.push(argument.clone()),
        }
    }
    if folders.is_empty() {
        bail!("usage: reference FOLDER.. [--spp N] [--step N] [--sheet FILE.png]");
    }
    println!("| scene | part | light | mean, ours by Cycles − 1 | mean absolute difference |");
    println!("|---|---|---|---|---|");
    for folder in &folders {
        let folder = Path::new(folder);
        let cases = if folder.join("scene.json").exists() {
            vec![
                support::spheres(folder, false)?,
                support::spheres(folder, true)?,
            ]
        } else {
            vec![support::object(folder, step)]
        };
        for case in &cases {
            let start = Instant::now();
            let (rows, ours) = support::compare(case, samples);
            let seconds = start.elapsed().as_secs_f32();
            for r in rows {
                let (name, mean, absolute) = (&case.name, 100.0 * r.mean, 100.0 * r.absolute);
                println!(
                    "| {name} | {} | {} | {mean:+.1} % | {absolute:.1} % |",
                    r.part, r.light
                );
            }
            eprintln!("{}: {seconds:.1} s", case.name);
            if let Some(sheet) = &sheet {
                draw(&case.truth, &ours).save(sheet)?;
            }
        }
    }
    Ok(())
}

fn draw(theirs: &[Vec<LinearImage>], ours: &[Vec<LinearImage>]) -> RgbImage {
    let (width, height) = (ours[0][0].width as u32, ours[0][0].height as u32);
    let columns = 2 * ours[0].len() as u32;
    let mut all = RgbImage::new(columns * width, ours.len() as u32 * height);
    for (y, (a, b)) in (0..).zip(theirs.iter().zip(ours)) {
        let pairs = a.iter().zip(b).flat_map(|(a, b)| [a, b]);
        for (x, image) in (0..).zip(pairs) {
            let (x, y) = (i64::from(x * width), i64::from(y * height));
            imageops::replace(&mut all, &tile(image), x, y);
        }
    }
    all
}

fn tile(image: &LinearImage) -> RgbImage {
    let shown = image.to_display();
    RgbImage::from_fn(shown.width as u32, shown.height as u32, |x, y| {
        let p = shown.pixels[y as usize * shown.width + x as usize];
        Rgb(p.map(|v| (v * 255.0 + 0.5) as u8))
    })
}
