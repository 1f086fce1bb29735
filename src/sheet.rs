//! Contact sheets: rows of labelled pictures on one page, and animations.

use anyhow::Result;
use lumi_core::DisplayImage;
use lumi_core::glam::Vec2;
use lumi_core::image::{encode_gif, enlarged};
use lumi_data::page::{FAINT, INK, Page};
use std::path::Path;

/// One row: a label at the left, then pictures with captions.
pub struct Row {
    /// Up to three short lines.
    pub label: String,
    /// Picture and caption.
    pub tiles: Vec<(DisplayImage, String)>,
}

/// Space between things, in pixels.
const GAP: usize = 12;
/// Height of a line of captions.
const LINE: usize = 22;
/// Width of the labels' column.
const LABELS: usize = 190;

/// Lays the rows out below a title, each picture enlarged to `side` pixels.
///
/// # Errors
/// If the built-in font cannot be read.
pub fn draw(title: &str, rows: &[Row], side: usize) -> Result<DisplayImage> {
    let columns = rows.iter().map(|r| r.tiles.len()).max().unwrap_or(0);
    let width = LABELS + columns * (side + GAP) + 2 * GAP;
    let row_height = side + LINE + GAP;
    let height = 3 * LINE + rows.len() * row_height + GAP;
    let mut page = Page::new(width, height)?;
    page.text(title, Vec2::new(GAP as f32, 10.0), 27.0, INK);
    for (r, row) in rows.iter().enumerate() {
        let top = 3 * LINE + r * row_height;
        for (i, line) in row.label.lines().enumerate() {
            let at = Vec2::new(GAP as f32, (top + side / 3 + i * LINE) as f32);
            page.text(line, at, 19.0, if i == 0 { INK } else { FAINT });
        }
        for (c, (image, caption)) in row.tiles.iter().enumerate() {
            let left = LABELS + c * (side + GAP) + GAP;
            page.paste(&enlarged(image, side), (left, top));
            let at = Vec2::new(left as f32 + 2.0, (top + side + 1) as f32);
            page.text(caption, at, 16.0, FAINT);
        }
    }
    Ok(page.finish())
}

/// Writes frames as an endless GIF of `side` pixels, whole or not at all.
///
/// # Errors
/// If the file cannot be written.
pub fn write_gif(path: &Path, frames: &[DisplayImage], side: usize, per_second: u32) -> Result<()> {
    let bytes = encode_gif(frames, side, per_second)?;
    Ok(lumi_core::fs::atomic_write(path, &bytes)?)
}
