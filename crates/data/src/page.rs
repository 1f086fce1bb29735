//! Pages of pictures, diagrams and words, for people to look at.

use ab_glyph::{Font, FontRef, PxScale, ScaleFont, point};
use glam::Vec2;
use lumi_core::{DisplayImage, Error, Result};

/// The page's ground.
pub const PAPER: Color = [0.965, 0.965, 0.955];
/// Main text.
pub const INK: Color = [0.13, 0.13, 0.15];
/// Captions and rulings.
pub const FAINT: Color = [0.45, 0.45, 0.48];
/// Inputs.
pub const BLUE: Color = [0.12, 0.42, 0.75];
/// Held-out views.
pub const ORANGE: Color = [0.87, 0.46, 0.1];
/// What is right.
pub const GREEN: Color = [0.1, 0.6, 0.3];
/// What is wrong.
pub const RED: Color = [0.82, 0.13, 0.13];
/// Lights.
pub const YELLOW: Color = [0.93, 0.72, 0.1];

/// Display-encoded RGB.
pub type Color = [f32; 3];

/// A page under way.
pub struct Page {
    image: DisplayImage,
    font: FontRef<'static>,
}

impl Page {
    /// An empty page, in pixels.
    ///
    /// # Errors
    /// If the built-in font cannot be read.
    pub fn new(width: usize, height: usize) -> Result<Self> {
        let font = FontRef::try_from_slice(epaint_default_fonts::UBUNTU_LIGHT);
        Ok(Self {
            image: DisplayImage::filled(width, height, PAPER),
            font: font.map_err(|e| Error::value("font", e.to_string()))?,
        })
    }

    /// The finished picture.
    #[must_use]
    pub fn finish(self) -> DisplayImage {
        self.image
    }

    /// Blends a colour into a pixel; nothing outside the page.
    fn blend(&mut self, x: i64, y: i64, color: Color, coverage: f32) {
        let (width, height) = (self.image.width as i64, self.image.height as i64);
        if (0..width).contains(&x) && (0..height).contains(&y) {
            let pixel = &mut self.image.pixels[(y * width + x) as usize];
            for c in 0..3 {
                pixel[c] += coverage.clamp(0.0, 1.0) * (color[c] - pixel[c]);
            }
        }
    }

    /// Puts a picture with its top-left corner at `at`; what reaches over the edge is cut.
    pub fn paste(&mut self, image: &DisplayImage, at: (usize, usize)) {
        for (i, pixel) in image.pixels.iter().enumerate() {
            let (x, y) = (at.0 + i % image.width, at.1 + i / image.width);
            self.blend(x as i64, y as i64, *pixel, 1.0);
        }
    }

    /// One line of text with its top-left corner at `at`.
    pub fn text(&mut self, line: &str, at: Vec2, size: f32, color: Color) {
        let scale = PxScale::from(size);
        let font = self.font.clone();
        let scaled = font.as_scaled(scale);
        let mut cursor = at.x;
        let baseline = at.y + scaled.ascent();
        for c in line.chars() {
            let id = font.glyph_id(c);
            let glyph = id.with_scale_and_position(scale, point(cursor, baseline));
            cursor += scaled.h_advance(id);
            let Some(outline) = font.outline_glyph(glyph) else {
                continue;
            };
            let bounds = outline.px_bounds();
            let (left, top) = (bounds.min.x as i64, bounds.min.y as i64);
            outline.draw(|x, y, coverage| {
                self.blend(left + i64::from(x), top + i64::from(y), color, coverage);
            });
        }
    }

    /// The line cut with an ellipsis to fit `width` pixels.
    #[must_use]
    pub fn fitted(&self, line: &str, size: f32, width: f32) -> String {
        let scaled = self.font.as_scaled(PxScale::from(size));
        let advance = |c: char| scaled.h_advance(scaled.glyph_id(c));
        if line.chars().map(advance).sum::<f32>() <= width {
            return line.to_owned();
        }
        let mut room = width - advance('…');
        let fits = |c: &char| {
            room -= advance(*c);
            room >= 0.0
        };
        line.chars().take_while(fits).chain(['…']).collect()
    }

    /// A straight line of this width.
    pub fn line(&mut self, from: Vec2, to: Vec2, width: f32, color: Color) {
        let along = to - from;
        self.shape(from.min(to), from.max(to), width, color, |p| {
            let t = ((p - from).dot(along) / along.length_squared().max(1e-9)).clamp(0.0, 1.0);
            p.distance(from + t * along) - 0.5 * width
        });
    }

    /// A filled disc.
    pub fn disc(&mut self, centre: Vec2, radius: f32, color: Color) {
        self.shape(centre - radius, centre + radius, 0.0, color, |p| {
            p.distance(centre) - radius
        });
    }

    /// A circle's line.
    pub fn circle(&mut self, centre: Vec2, radius: f32, width: f32, color: Color) {
        self.shape(centre - radius, centre + radius, width, color, |p| {
            (p.distance(centre) - radius).abs() - 0.5 * width
        });
    }

    /// A rectangle's line.
    pub fn frame(&mut self, low: Vec2, high: Vec2, width: f32, color: Color) {
        let corners = [
            low,
            Vec2::new(high.x, low.y),
            high,
            Vec2::new(low.x, high.y),
        ];
        for i in 0..4 {
            self.line(corners[i], corners[(i + 1) % 4], width, color);
        }
    }

    /// Whatever has a signed distance in pixels, inside a box; edges are smooth.
    fn shape(
        &mut self,
        low: Vec2,
        high: Vec2,
        margin: f32,
        color: Color,
        distance: impl Fn(Vec2) -> f32,
    ) {
        let size = Vec2::new(self.image.width as f32, self.image.height as f32);
        let low = (low - margin - 1.0).clamp(Vec2::ZERO, size);
        let high = (high + margin + 2.0).clamp(Vec2::ZERO, size);
        for y in low.y as i64..high.y as i64 {
            for x in low.x as i64..high.x as i64 {
                let p = Vec2::new(x as f32 + 0.5, y as f32 + 0.5);
                let coverage = 0.5 - distance(p);
                if coverage > 0.0 {
                    self.blend(x, y, color, coverage);
                }
            }
        }
    }
}
