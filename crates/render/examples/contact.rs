//! A contact sheet of a data set: `contact DATA_DIR SHEET.png [OBJECTS] [VIEWS] [EXPOSURE] [FIRST]`; a row per object, its
//! first views under every light in turn, sRGB over white.

use anyhow::Context;
use lumi_data::store::{ObjectRecord, list};
use std::path::Path;

fn main() -> anyhow::Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let folder = arguments
        .first()
        .context("contact DATA_DIR SHEET.png [OBJECTS] [VIEWS] [EXPOSURE] [FIRST]")?;
    let sheet = arguments.get(1).context("the sheet's path is missing")?;
    let number = |i: usize, default: f32| arguments.get(i).map_or(Ok(default), |a| a.parse());
    let (objects, views) = (number(2, 12.0)? as usize, number(3, 1.0)? as usize);
    let exposure = number(4, 1.0)?;
    let first = number(5, 0.0)? as usize;
    let mut tiles: Vec<Vec<image::RgbImage>> = Vec::new();
    for path in list(Path::new(folder))?.iter().skip(first).take(objects) {
        let record = ObjectRecord::read(path)?;
        let mut row = Vec::new();
        for view in 0..views.min(record.cameras.len()) {
            for light in 0..record.lights.len() {
                let shown = record.compose(view, &[(light, [exposure; 3])]).to_display();
                row.push(image::RgbImage::from_fn(
                    shown.width as u32,
                    shown.height as u32,
                    |x, y| {
                        let p = shown.pixels[y as usize * shown.width + x as usize];
                        image::Rgb(p.map(|v| (v * 255.0 + 0.5) as u8))
                    },
                ));
            }
        }
        tiles.push(row);
    }
    let columns = tiles
        .iter()
        .map(Vec::len)
        .max()
        .context("no objects found")? as u32;
    let side = tiles[0][0].width();
    let mut all = image::RgbImage::from_pixel(
        columns * side,
        tiles.len() as u32 * side,
        image::Rgb([255; 3]),
    );
    for (y, row) in tiles.iter().enumerate() {
        for (x, tile) in row.iter().enumerate() {
            image::imageops::replace(
                &mut all,
                tile,
                (x as u32 * side).into(),
                (y as u32 * side).into(),
            );
        }
    }
    all.save(sheet)?;
    Ok(())
}
