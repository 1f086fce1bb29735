//! How likely a colour is for the object and for what is around it.

/// Cells along each channel. Photographs of one capture have millions of pixels, which fill a table of densities better
/// than a handful of Gaussians would describe it.
const CELLS: usize = 24;

/// Passes of the filter 1 2 1 along each channel.
const PASSES: usize = 2;

/// Weight, in pixels, of a colour that is as likely as any other: what was never seen speaks for nothing.
const UNSEEN: f32 = 20.0;

/// Density of sRGB-encoded colours.
pub(super) struct Colors {
    weight: Vec<f32>,
    total: f32,
}

impl Colors {
    pub fn new() -> Self {
        Self {
            weight: vec![0.0; CELLS * CELLS * CELLS],
            total: 0.0,
        }
    }

    /// Counts a pixel of this colour in [0, 1].
    pub fn add(&mut self, color: [f32; 3]) {
        for (cell, share) in corners(color) {
            self.weight[cell] += share;
        }
        self.total += 1.0;
    }

    /// Spreads what was counted to similar colours.
    pub fn smooth(&mut self) {
        for step in [1, CELLS, CELLS * CELLS] {
            for _ in 0..PASSES {
                let old = self.weight.clone();
                for (i, value) in self.weight.iter_mut().enumerate() {
                    let at = i / step % CELLS;
                    let below = if at == 0 { i } else { i - step };
                    let above = if at + 1 == CELLS { i } else { i + step };
                    *value = 0.25 * (old[below] + old[above]) + 0.5 * old[i];
                }
            }
        }
    }

    /// Density, 1 where all colours are equally likely.
    pub fn density(&self, color: [f32; 3]) -> f32 {
        let cells = self.weight.len() as f32;
        let found: f32 = corners(color)
            .map(|(cell, share)| share * self.weight[cell])
            .sum();
        (found * cells + UNSEEN) / (self.total + UNSEEN)
    }
}

/// The eight cells around a colour, and their shares of it.
fn corners(color: [f32; 3]) -> impl Iterator<Item = (usize, f32)> {
    let at = color.map(|v| v.clamp(0.0, 1.0) * (CELLS - 1) as f32);
    let low = at.map(|v| (v as usize).min(CELLS - 2));
    (0..8).map(move |corner| {
        let (mut cell, mut share) = (0, 1.0);
        for c in 0..3 {
            let up = corner >> c & 1;
            let part = at[c] - low[c] as f32;
            cell = cell * CELLS + low[c] + up;
            share *= if up == 1 { part } else { 1.0 - part };
        }
        (cell, share)
    })
}
