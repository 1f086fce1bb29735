//! A contact sheet of a data set, sRGB over white.
//!
//! `contact DATA_DIR SHEET.png [--objects N] [--first K] [--views N] [--lights each|mix] [--exposure E] [--columns N]`:
//! per object its first views under each light in turn, or under the sum of environment 0 and half of point light 0.

use anyhow::{Context, bail};
use image::{Rgb, RgbImage, imageops};
use lumi_data::store::{ObjectRecord, list};
use std::path::Path;

fn main() -> anyhow::Result<()> {
    let mut paths = Vec::new();
    let (mut objects, mut first, mut views, mut exposure) = (12, 0, 1, 1.0_f32);
    let (mut mix, mut columns) = (false, 0);
    let mut arguments = std::env::args().skip(1);
    while let Some(argument) = arguments.next() {
        if !argument.starts_with("--") {
            paths.push(argument);
            continue;
        }
        let value = arguments
            .next()
            .with_context(|| format!("{argument} needs a value"))?;
        match argument.as_str() {
            "--objects" => objects = value.parse()?,
            "--first" => first = value.parse()?,
            "--views" => views = value.parse()?,
            "--exposure" => exposure = value.parse()?,
            "--columns" => columns = value.parse()?,
            "--lights" => mix = value == "mix",
            _ => bail!("unknown option {argument}"),
        }
    }
    let [folder, sheet] = &paths[..] else {
        bail!("usage: contact DATA_DIR SHEET.png [options]");
    };
    let mut tiles = Vec::new();
    for path in list(Path::new(folder))?.iter().skip(first).take(objects) {
        let record = ObjectRecord::read(path)?;
        let find = |name: &str| record.lights.iter().position(|l| l.name == name);
        let mixed = [("env0", exposure), ("point0", 0.5 * exposure)];
        let mixed: Vec<_> = mixed
            .iter()
            .filter_map(|&(name, gain)| Some((find(name)?, [gain; 3])))
            .collect();
        for view in 0..views.min(record.cameras.len()) {
            if mix {
                tiles.push(tile(&record, view, &mixed));
            } else {
                let each = 0..record.lights.len();
                tiles.extend(each.map(|l| tile(&record, view, &[(l, [exposure; 3])])));
                if columns == 0 {
                    columns = record.lights.len() * views;
                }
                // Objects may have fewer lights than the first; keep a row per object.
                while tiles.len() % columns != 0 {
                    tiles.push(RgbImage::from_pixel(1, 1, Rgb([255; 3])));
                }
            }
        }
    }
    let side = tiles.first().context("no objects found")?.width();
    let columns = if columns == 0 { 12 } else { columns };
    let rows = tiles.len().div_ceil(columns) as u32;
    let mut all = RgbImage::from_pixel(columns as u32 * side, rows * side, Rgb([255; 3]));
    for (i, tile) in tiles.iter().enumerate() {
        let (x, y) = ((i % columns) as u32 * side, (i / columns) as u32 * side);
        imageops::replace(&mut all, tile, x.into(), y.into());
    }
    all.save(sheet)?;
    Ok(())
}

fn tile(record: &ObjectRecord, view: usize, lights: &[(usize, [f32; 3])]) -> RgbImage {
    let shown = record.compose(view, lights).to_display();
    RgbImage::from_fn(shown.width as u32, shown.height as u32, |x, y| {
        let p = shown.pixels[y as usize * shown.width + x as usize];
        Rgb(p.map(|v| (v * 255.0 + 0.5) as u8))
    })
}
