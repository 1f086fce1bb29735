//! Contact sheets: rows of labelled pictures on one page, and animations.

use ab_glyph::{Font, FontRef, PxScale, ScaleFont, point};
use anyhow::{Context, Result};
use lumi_core::DisplayImage;
use lumi_core::image::{encode_gif, enlarged};
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
const PAPER: [f32; 3] = [0.965, 0.965, 0.955];
const INK: [f32; 3] = [0.13, 0.13, 0.15];
const FAINT: [f32; 3] = [0.45, 0.45, 0.48];

/// Lays the rows out below a title, each picture enlarged to `side` pixels.
///
/// # Errors
/// If the built-in font cannot be read.
pub fn draw(title: &str, rows: &[Row], side: usize) -> Result<DisplayImage> {
    let font = FontRef::try_from_slice(epaint_default_fonts::UBUNTU_LIGHT).context("font")?;
    let columns = rows.iter().map(|r| r.tiles.len()).max().unwrap_or(0);
    let width = LABELS + columns * (side + GAP) + 2 * GAP;
    let row_height = side + LINE + GAP;
    let height = 3 * LINE + rows.len() * row_height + GAP;
    let mut page = DisplayImage::filled(width, height, PAPER);
    text(&mut page, &font, title, (GAP as f32, 10.0), 27.0, INK);
    for (r, row) in rows.iter().enumerate() {
        let top = 3 * LINE + r * row_height;
        for (i, line) in row.label.lines().enumerate() {
            let y = (top + side / 3 + i * LINE) as f32;
            text(
                &mut page,
                &font,
                line,
                (GAP as f32, y),
                19.0,
                if i == 0 { INK } else { FAINT },
            );
        }
        for (c, (image, caption)) in row.tiles.iter().enumerate() {
            let left = LABELS + c * (side + GAP) + GAP;
            paste(&mut page, &enlarged(image, side), (left, top));
            let at = (left as f32 + 2.0, (top + side + 1) as f32);
            text(&mut page, &font, caption, at, 16.0, FAINT);
        }
    }
    Ok(page)
}

fn paste(page: &mut DisplayImage, image: &DisplayImage, (left, top): (usize, usize)) {
    for y in 0..image.height.min(page.height.saturating_sub(top)) {
        let row = &image.pixels[y * image.width..][..image.width];
        page.pixels[(top + y) * page.width + left..][..image.width].copy_from_slice(row);
    }
}

/// One line of text with its top-left corner at `at`.
fn text(
    page: &mut DisplayImage,
    font: &FontRef,
    line: &str,
    (x, y): (f32, f32),
    size: f32,
    color: [f32; 3],
) {
    let scale = PxScale::from(size);
    let scaled = font.as_scaled(scale);
    let mut cursor = x;
    let baseline = y + scaled.ascent();
    for c in line.chars() {
        let id = font.glyph_id(c);
        let glyph = id.with_scale_and_position(scale, point(cursor, baseline));
        cursor += scaled.h_advance(id);
        let Some(outline) = font.outline_glyph(glyph) else {
            continue;
        };
        let bounds = outline.px_bounds();
        outline.draw(|gx, gy, coverage| {
            let (px, py) = (
                bounds.min.x as i64 + i64::from(gx),
                bounds.min.y as i64 + i64::from(gy),
            );
            if (0..page.width as i64).contains(&px) && (0..page.height as i64).contains(&py) {
                let pixel = &mut page.pixels[py as usize * page.width + px as usize];
                for k in 0..3 {
                    pixel[k] += coverage.min(1.0) * (color[k] - pixel[k]);
                }
            }
        });
    }
}

/// Writes frames as an endless GIF of `side` pixels, whole or not at all.
///
/// # Errors
/// If the file cannot be written.
pub fn write_gif(path: &Path, frames: &[DisplayImage], side: usize, per_second: u32) -> Result<()> {
    let bytes = encode_gif(frames, side, per_second)?;
    Ok(lumi_core::fs::atomic_write(path, &bytes)?)
}
