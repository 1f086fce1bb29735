//! A store on one page.

use super::ObjectRecord;
use crate::page::{FAINT, INK, Page};
use glam::Vec2;
use lumi_core::{DisplayImage, LinearImage, Result};

const TILE: usize = 128;
const GAP: usize = 10;
const LINE: usize = 18;
const LABELS: usize = 200;
/// Views of a record under all its lights.
const VIEWS: usize = 4;
/// Columns before those of single lights: views, then base colour.
const BEFORE: usize = VIEWS + 1;
/// Lights of a record, one at a time, in its first view.
const LIGHTS: usize = 6;
/// Mean linear value to which an object's pixels are exposed.
const MIDDLE: f32 = 0.25;

/// Draws a row per record: some views under all lights, the first view's base colour where the record has it, then
/// that view under one light after the other. Each is exposed for itself, but for base colour, which is shown as it is.
///
/// # Errors
/// If the built-in font cannot be read.
pub fn sheet(title: &str, records: &[ObjectRecord]) -> Result<DisplayImage> {
    let row = TILE + LINE + GAP;
    let top = 4 * LINE;
    let width = LABELS + (BEFORE + LIGHTS) * (TILE + GAP) + 3 * GAP;
    let mut page = Page::new(width, top + records.len() * row + GAP)?;
    let at = |x: usize, y: usize| Vec2::new(x as f32, y as f32);
    page.text(title, at(2 * GAP, GAP), 26.0, INK);
    for (r, record) in records.iter().enumerate() {
        let y = top + r * row;
        let (w, h) = record.size();
        let name = page.fitted(&record.name, 17.0, (LABELS - GAP) as f32);
        page.text(&name, at(2 * GAP, y + TILE / 3), 17.0, INK);
        let facts = format!(
            "{} views, {} lights",
            record.cameras.len(),
            record.lights.len()
        );
        page.text(&facts, at(2 * GAP, y + TILE / 3 + LINE), 14.0, FAINT);
        page.text(
            &format!("{w}×{h}"),
            at(2 * GAP, y + TILE / 3 + 2 * LINE),
            14.0,
            FAINT,
        );
        let all: Vec<_> = (0..record.lights.len()).map(|l| (l, [1.0; 3])).collect();
        let views = (0..record.cameras.len().min(VIEWS)).map(|v| {
            let image = exposed(record.compose(v, &all));
            (v, image, format!("view {v}, all lights"))
        });
        let albedo = record.albedo_of(0).map(|image| {
            let caption = "view 0, base colour".to_owned();
            (VIEWS, image.to_display(), caption)
        });
        // Lights stand in their own columns, however few views there are.
        let lights = (0..record.lights.len().min(LIGHTS)).map(|l| {
            let image = exposed(record.compose(0, &[(l, [1.0; 3])]));
            (BEFORE + l, image, record.lights[l].name.clone())
        });
        for (column, image, caption) in views.chain(albedo).chain(lights) {
            let gap = if column >= BEFORE { 3 * GAP } else { 2 * GAP };
            let x = LABELS + column * (TILE + GAP) + gap;
            let shown = image.resized(TILE, (h * TILE).div_ceil(w).min(TILE));
            page.paste(&shown, (x, y));
            let caption = page.fitted(&caption, 13.0, TILE as f32);
            page.text(&caption, at(x, y + TILE + 2), 13.0, FAINT);
        }
    }
    Ok(page.finish())
}

fn exposed(mut image: LinearImage) -> DisplayImage {
    let (mut sum, mut covered) = (0.0, 0.0);
    for p in &image.pixels {
        sum += (p[0] + p[1] + p[2]) / 3.0;
        covered += p[3];
    }
    let gain = if sum > 0.0 {
        MIDDLE * covered / sum
    } else {
        1.0
    };
    for p in &mut image.pixels {
        p[..3].iter_mut().for_each(|v| *v *= gain);
    }
    image.to_display()
}
