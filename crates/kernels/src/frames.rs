//! Tokens with frames: attention that knows how two tokens lie to each other (geometric transform attention, Miyato et
//! al. 2024).
//!
//! A frame is a rigid motion M = [R t; 0 1] from a token's own space to the world. Every four consecutive channels of a
//! head are a vector there in homogeneous coordinates; channels that are left over stay as they are. Keys and values move
//! to the world, queries do as covectors, and what a token gathers moves into its own space:
//!
//! ```text
//! q' = M⁻ᵀ q      k' = M k      v' = M v      o = M⁻¹ o'
//! ```
//!
//! so that qᵢ'·kⱼ' = qᵢᵀ Mᵢ⁻¹ Mⱼ kⱼ holds one token's motion relative to the other's, and nothing of where both are.

use crate::threads::{Shared, par_tiles};

/// Tokens of a tile where nothing else is done to them at once.
const TILE: usize = 64;

/// Numbers of a frame: R row by row, then t.
pub const FRAME: usize = 12;

/// Frames of tokens, [`FRAME`] numbers each.
#[derive(Clone, Copy, Debug)]
pub struct Frames<'a>(&'a [[f32; FRAME]]);

impl<'a> Frames<'a> {
    /// Frames from `[tokens, 12]` numbers; the rotations must be rotations, which nobody checks.
    ///
    /// # Panics
    /// If they are not whole frames.
    #[must_use]
    pub fn new(values: &'a [f32]) -> Self {
        let (frames, rest) = values.as_chunks::<FRAME>();
        assert!(rest.is_empty(), "frames: not {FRAME} numbers each");
        Self(frames)
    }

    /// The numbers, `[tokens, 12]`.
    #[must_use]
    pub fn values(self) -> &'a [f32] {
        self.0.as_flattened()
    }

    pub(crate) fn len(self) -> usize {
        self.0.len()
    }

    /// Those of the tokens from `start`.
    pub(crate) fn from(self, start: usize) -> Self {
        Self(&self.0[start..])
    }

    /// Rows q‖k‖v of `head_dim` channels per head into the world.
    pub(crate) fn enter(self, qkv: &mut [f32], dim: usize, head_dim: usize) {
        self.turn(qkv, dim, head_dim, |m| {
            let to_world = columns(m);
            [transposed(&inverse(m)), to_world, to_world]
        });
    }

    /// Gradients of [`Self::enter`]'s rows, from after it to before it.
    pub(crate) fn enter_backward(self, qkv: &mut [f32], dim: usize, head_dim: usize) {
        self.turn(qkv, dim, head_dim, |m| {
            let back = transposed(&columns(m));
            [inverse(m), back, back]
        });
    }

    /// Rows that tokens gathered, into their own spaces.
    pub(crate) fn leave(self, rows: &mut [f32], dim: usize, head_dim: usize) {
        self.turn(rows, dim, head_dim, |m| [inverse(m)]);
    }

    /// The way back from [`Self::leave`].
    pub(crate) fn undo_leave(self, rows: &mut [f32], dim: usize, head_dim: usize) {
        self.turn(rows, dim, head_dim, |m| [columns(m)]);
    }

    /// Runs `turn` on tiles of `rows`, `width` numbers per token, in parallel.
    pub(crate) fn tiled(
        self,
        rows: &mut [f32],
        width: usize,
        turn: impl Fn(Self, &mut [f32]) + Sync,
    ) {
        let shared = Shared::new(rows);
        par_tiles(self.len(), TILE, |t, tokens| {
            // SAFETY: tiles are disjoint rows.
            let rows = unsafe { shared.slice(t * width, tokens * width) };
            turn(self.from(t), rows);
        });
    }

    /// Gradients of [`Self::leave`]'s rows, from after it to before it.
    pub(crate) fn leave_backward(self, rows: &mut [f32], dim: usize, head_dim: usize) {
        self.turn(rows, dim, head_dim, |m| [transposed(&inverse(m))]);
    }

    /// Rows of `P` parts of `dim` channels, each times its matrix of the row's frame.
    fn turn<const P: usize>(
        self,
        rows: &mut [f32],
        dim: usize,
        head_dim: usize,
        matrices: impl Fn(&[f32; FRAME]) -> [Columns; P],
    ) {
        for (row, frame) in rows.chunks_exact_mut(P * dim).zip(self.0) {
            for (part, columns) in row.chunks_exact_mut(dim).zip(&matrices(frame)) {
                for head in part.chunks_exact_mut(head_dim) {
                    for x in head.as_chunks_mut::<4>().0 {
                        *x = times(columns, *x);
                    }
                }
            }
        }
    }
}

/// A matrix of four by four, column by column, so that a product is four steps of one register.
type Columns = [[f32; 4]; 4];

fn times(m: &Columns, x: [f32; 4]) -> [f32; 4] {
    std::array::from_fn(|i| (m[0][i] * x[0] + m[1][i] * x[1]) + (m[2][i] * x[2] + m[3][i] * x[3]))
}

fn columns(m: &[f32; FRAME]) -> Columns {
    [
        [m[0], m[3], m[6], 0.0],
        [m[1], m[4], m[7], 0.0],
        [m[2], m[5], m[8], 0.0],
        [m[9], m[10], m[11], 1.0],
    ]
}

/// Of [Rᵀ, −Rᵀt; 0, 1].
fn inverse(m: &[f32; FRAME]) -> Columns {
    let t = [0, 1, 2].map(|i| -(m[i] * m[9] + m[3 + i] * m[10] + m[6 + i] * m[11]));
    [
        [m[0], m[1], m[2], 0.0],
        [m[3], m[4], m[5], 0.0],
        [m[6], m[7], m[8], 0.0],
        [t[0], t[1], t[2], 1.0],
    ]
}

fn transposed(m: &Columns) -> Columns {
    std::array::from_fn(|i| std::array::from_fn(|j| m[j][i]))
}
