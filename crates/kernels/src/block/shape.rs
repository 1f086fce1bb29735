//! Sizes, weights, gradients and tokens of a block.

use crate::attention::Shape;
use crate::frames::Frames;

/// Sizes of a block.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BlockShape {
    /// Channels of a token.
    pub dim: usize,
    /// Channels of a head; divides `dim`.
    pub head_dim: usize,
    /// Channels of the hidden layer, usually `4 * dim`.
    pub hidden: usize,
    /// Equal parts of a token's channels that share queries and keys and nothing else: 1, or 2 for split streams. Divides
    /// `dim`, `head_dim` and `hidden`.
    pub streams: usize,
}

impl BlockShape {
    pub(super) fn heads(self) -> usize {
        self.dim / self.head_dim
    }

    /// Channels of a stream.
    pub(super) fn stream(self) -> usize {
        self.dim / self.streams
    }

    /// Channels of a stream's hidden layer.
    pub(super) fn stream_hidden(self) -> usize {
        self.hidden / self.streams
    }

    pub(super) fn attention(self, batch: usize) -> Shape {
        Shape {
            batch,
            heads: self.heads(),
            head_dim: self.head_dim,
        }
    }

    /// Channels of each head of q and k that frames turn, from the first.
    pub(super) fn turned_by_frames(self, anchored: bool) -> usize {
        if anchored {
            self.head_dim / 2
        } else {
            self.head_dim
        }
    }

    fn check(self) {
        let Self {
            dim,
            head_dim,
            hidden,
            streams,
        } = self;
        let divides = |n: usize| n > 0 && n.is_multiple_of(streams);
        assert!(
            head_dim > 0
                && dim.is_multiple_of(head_dim)
                && streams > 0
                && [dim, head_dim, hidden].into_iter().all(divides),
            "block shape: dim {dim}, head_dim {head_dim}, hidden {hidden}, streams {streams}"
        );
    }

    /// Channels of one stream, rows [rows, d/S], to their places among all: each head holds its channels of stream
    /// after stream. `all` has rows of `ld` numbers.
    pub(super) fn scatter_stream(self, stream: usize, rows: &[f32], all: &mut [f32], ld: usize) {
        let width = self.head_dim / self.streams;
        for (row, all) in rows.chunks_exact(self.stream()).zip(all.chunks_mut(ld)) {
            let heads = all.chunks_mut(self.head_dim);
            for (part, head) in row.chunks_exact(width).zip(heads) {
                head[stream * width..][..width].copy_from_slice(part);
            }
        }
    }

    /// The way back from [`Self::scatter_stream`].
    pub(super) fn gather_stream(self, stream: usize, all: &[f32], ld: usize, rows: &mut [f32]) {
        let width = self.head_dim / self.streams;
        let rows = rows.chunks_exact_mut(self.stream());
        for (row, all) in rows.zip(all.chunks(ld)) {
            let heads = all.chunks(self.head_dim);
            for (part, head) in row.chunks_exact_mut(width).zip(heads) {
                part.copy_from_slice(&head[stream * width..][..width]);
            }
        }
    }
}

/// The tokens that a block works on.
#[derive(Clone, Copy, Debug)]
pub struct Tokens<'a> {
    /// `[batch, n, dim]`
    pub x: &'a [f32],
    /// A frame for each, or none at all.
    pub frames: Option<Frames<'a>>,
}

impl<'a, T: AsRef<[f32]> + ?Sized> From<&'a T> for Tokens<'a> {
    fn from(x: &'a T) -> Self {
        Self {
            x: x.as_ref(),
            frames: None,
        }
    }
}

impl Tokens<'_> {
    pub(super) fn check(&self, name: &str, batch: usize, n: usize, shape: BlockShape) {
        check_length(name, self.x, batch, n, shape);
        let frames = self.frames.map_or(batch * n, Frames::len);
        assert_eq!(frames, batch * n, "block: number of frames");
        let BlockShape {
            head_dim, streams, ..
        } = shape;
        assert!(
            self.frames.is_none() || streams == 1 || (head_dim / streams).is_multiple_of(4),
            "block: with frames, head_dim {head_dim} of {streams} streams each is no multiple of 4"
        );
    }
}

pub(super) fn check_length(name: &str, x: &[f32], batch: usize, n: usize, shape: BlockShape) {
    assert_eq!(x.len(), batch * n * shape.dim, "block: length of {name}");
}

/// A block's weights; matrices are [out, in], row-major. With S streams, row r of `v` and `proj` is of stream
/// r / (dim/S), row r of `fc1` and `fc2` likewise, and reads that stream's channels alone.
#[derive(Clone, Copy, Debug)]
pub struct BlockWeights<'a> {
    /// `[dim]`
    pub norm1: &'a [f32],
    /// `[2·dim, dim]`: rows of q, then k.
    pub qk: &'a [f32],
    /// `[dim, dim/S]`
    pub v: &'a [f32],
    /// `[head_dim]`
    pub q_norm: &'a [f32],
    /// `[head_dim]`
    pub k_norm: &'a [f32],
    /// `[dim, dim/S]`
    pub proj: &'a [f32],
    /// `[dim]`
    pub norm2: &'a [f32],
    /// `[hidden, dim/S]`
    pub fc1: &'a [f32],
    /// `[dim, hidden/S]`
    pub fc2: &'a [f32],
}

impl BlockWeights<'_> {
    pub(super) fn check(&self, shape: BlockShape) {
        shape.check();
        let (d, dh) = (shape.dim, shape.head_dim);
        let (stream, hidden) = (shape.stream(), shape.stream_hidden());
        let lengths = [
            ("norm1", self.norm1, d),
            ("qk", self.qk, 2 * d * d),
            ("v", self.v, d * stream),
            ("q_norm", self.q_norm, dh),
            ("k_norm", self.k_norm, dh),
            ("proj", self.proj, d * stream),
            ("norm2", self.norm2, d),
            ("fc1", self.fc1, shape.hidden * stream),
            ("fc2", self.fc2, d * hidden),
        ];
        for (name, slice, len) in lengths {
            assert_eq!(slice.len(), len, "block weights: length of {name}");
        }
    }
}

/// Gradients, shaped as the weights and the input.
#[derive(Clone, Debug)]
#[allow(missing_docs)] // Named as in `BlockWeights`.
pub struct BlockGrads {
    pub x: Vec<f32>,
    /// Of an external context's tokens; empty without one.
    pub context: Vec<f32>,
    pub norm1: Vec<f32>,
    pub qk: Vec<f32>,
    pub v: Vec<f32>,
    pub q_norm: Vec<f32>,
    pub k_norm: Vec<f32>,
    pub proj: Vec<f32>,
    pub norm2: Vec<f32>,
    pub fc1: Vec<f32>,
    pub fc2: Vec<f32>,
}
