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
//! so that qᵢ'·kⱼ' = qᵢᵀ Mᵢ⁻¹ Mⱼ kⱼ holds one token's motion relative to the other's, and nothing of where both are. With
//! anchors the first half of q's and k's channels is left to the frames.

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

    /// Rows of a projection into the world: q‖k‖v, or k‖v, of `head_dim` channels per head, of which `turned` at the
    /// start of q's and k's are to turn.
    pub(crate) fn enter(
        self,
        rows: &mut [f32],
        asks: bool,
        dim: usize,
        head_dim: usize,
        turned: usize,
    ) {
        let of_queries = |m: &_| transposed(&inverse(m));
        self.turn_parts(rows, asks, dim, head_dim, turned, of_queries, columns);
    }

    /// Gradients of [`Self::enter`]'s rows, from after it to before it.
    pub(crate) fn enter_backward(
        self,
        rows: &mut [f32],
        asks: bool,
        dim: usize,
        head_dim: usize,
        turned: usize,
    ) {
        let others = |m: &_| transposed(&columns(m));
        self.turn_parts(rows, asks, dim, head_dim, turned, inverse, others);
    }

    /// Rows that tokens gathered, into their own spaces.
    pub(crate) fn leave(self, rows: &mut [f32], dim: usize, head_dim: usize) {
        for (row, frame) in rows.chunks_exact_mut(dim).zip(self.0) {
            turn(row, head_dim, head_dim, &inverse(frame));
        }
    }

    /// Gradients of [`Self::leave`]'s rows, from after it to before it.
    pub(crate) fn leave_backward(self, rows: &mut [f32], dim: usize, head_dim: usize) {
        for (row, frame) in rows.chunks_exact_mut(dim).zip(self.0) {
            turn(row, head_dim, head_dim, &transposed(&inverse(frame)));
        }
    }

    /// Rows of parts of `dim` channels: q, if there is one, times one matrix, k and v times another.
    #[allow(clippy::too_many_arguments)]
    fn turn_parts(
        self,
        rows: &mut [f32],
        asks: bool,
        dim: usize,
        head_dim: usize,
        turned: usize,
        of_queries: impl Fn(&[f32; FRAME]) -> Columns,
        of_others: impl Fn(&[f32; FRAME]) -> Columns,
    ) {
        let width = if asks { 3 * dim } else { 2 * dim };
        for (row, frame) in rows.chunks_exact_mut(width).zip(self.0) {
            let (q, kv) = row.split_at_mut(width - 2 * dim);
            let (k, v) = kv.split_at_mut(dim);
            if asks {
                turn(q, head_dim, turned, &of_queries(frame));
            }
            let others = of_others(frame);
            turn(k, head_dim, turned, &others);
            turn(v, head_dim, head_dim, &others);
        }
    }
}

/// The first `turned` channels of each head times a matrix.
fn turn(row: &mut [f32], head_dim: usize, turned: usize, columns: &Columns) {
    for head in row.chunks_exact_mut(head_dim) {
        for x in head[..turned].as_chunks_mut::<4>().0 {
            *x = times(columns, *x);
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
