//! The shifted input under a tile of pixels, one row per channel and weight.

use std::ops::Range;

use super::ConvShape;
use crate::buffer::Buf;

/// Some channels of one image under consecutive pixels.
pub(super) struct Part {
    pub image: usize,
    pub channels: Range<usize>,
    pub start: usize,
    pub len: usize,
}

/// Memory for gathered rows, reused from part to part.
#[derive(Default)]
pub(super) struct Columns(Option<Buf<f32>>);

impl Columns {
    /// Rows of `part.len` values with their stride: row `(channel, ky, kx)` holds, for every pixel
    /// (y, x), the input at (y + ky - k/2, x + kx - k/2), and zero outside the image.
    pub fn gather<'a>(
        &'a mut self,
        shape: ConvShape,
        x: &'a [f32],
        part: &Part,
    ) -> (&'a [f32], usize) {
        let pixels = shape.pixels();
        let first = (part.image * shape.input + part.channels.start) * pixels;
        if shape.kernel == 1 {
            return (&x[first + part.start..], pixels);
        }
        let planes = &x[first..][..part.channels.len() * pixels];
        let needed = part.channels.len() * shape.taps() * part.len;
        if self.0.as_ref().is_none_or(|buf| buf.len() < needed) {
            self.0 = Some(Buf::new(needed));
        }
        let Some(buf) = &mut self.0 else {
            unreachable!("made above");
        };
        let mut rows = buf.chunks_exact_mut(part.len);
        for plane in planes.chunks_exact(pixels) {
            for ky in 0..shape.kernel {
                for kx in 0..shape.kernel {
                    if let Some(row) = rows.next() {
                        shifted(shape, plane, part.start, [ky, kx], row);
                    }
                }
            }
        }
        (&buf[..needed], part.len)
    }
}

/// One row: the plane moved by the weight's place, from pixel `start` on.
fn shifted(shape: ConvShape, plane: &[f32], start: usize, [ky, kx]: [usize; 2], row: &mut [f32]) {
    let (h, w, half) = (shape.height, shape.width, shape.kernel / 2);
    let mut done = 0;
    while done < row.len() {
        let (y, x) = ((start + done) / w, (start + done) % w);
        // To the end of this row of the image, or of the tile.
        let line = &mut row[done..];
        let n = line.len().min(w - x);
        let line = &mut line[..n];
        done += n;
        let from_y = y + ky;
        if from_y < half || from_y >= h + half {
            line.fill(0.0);
            continue;
        }
        let source = &plane[(from_y - half) * w..][..w];
        // Pixel x + i reads column x + i + kx - half.
        let left = half.saturating_sub(x + kx).min(n);
        let right = (w + half).saturating_sub(x + kx).min(n).max(left);
        line[..left].fill(0.0);
        line[right..].fill(0.0);
        if left < right {
            let from = x + left + kx - half;
            line[left..right].copy_from_slice(&source[from..][..right - left]);
        }
    }
}
