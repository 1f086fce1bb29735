//! A whole pre-LN transformer block with QK-norm, all layers without bias:
//!
//! ```text
//! q, k, v = LayerNorm(x) Wqkvᵀ            q, k: RMSNorm over each head's channels
//! x1      = x + softmax(q kᵀ / sqrt(dh)) v Wprojᵀ
//! out     = x1 + gelu(LayerNorm(x1) W1ᵀ) W2ᵀ
//! ```
//!
//! Tokens may have frames; then q, k and v move to the world before the norms of q and k, and what the softmax gathers moves
//! back (see `frames`).

mod backward;
mod cached;
mod forward;

pub use cached::KeyValues;

use crate::attention::{Layout, Pattern};
use crate::buffer::Buf;
use crate::cpu::Compute;
use crate::frames::Frames;
#[cfg(target_arch = "x86_64")]
use crate::gemm::{AmxBf16, Avx2F32, Avx512Bf16, Avx512F32};
use crate::gemm::{AnyBuf, PortableF32, with_kernel};
use crate::threads::pooled;
use forward::{Pass, Weights};

/// Columns of the hidden layer a task computes at once; they stay in the second-level cache.
const CHUNK: usize = 512;

/// Sizes of a block.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BlockShape {
    /// Channels of a token.
    pub dim: usize,
    /// Channels of a head; divides `dim`.
    pub head_dim: usize,
    /// Channels of the hidden layer, usually `4 * dim`.
    pub hidden: usize,
}

impl BlockShape {
    fn heads(self) -> usize {
        self.dim / self.head_dim
    }

    fn check(self) {
        let Self {
            dim,
            head_dim,
            hidden,
        } = self;
        assert!(
            dim > 0 && head_dim > 0 && hidden > 0 && dim.is_multiple_of(head_dim),
            "block shape: dim {dim}, head_dim {head_dim}, hidden {hidden}"
        );
    }

    fn layout(self, batch: usize, n: usize, pattern: Pattern) -> Layout {
        Layout::new(batch, n, self.heads(), self.head_dim, pattern)
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
    fn check(&self, batch: usize, n: usize, shape: BlockShape) {
        check_length("x", self.x, batch, n, shape);
        let frames = self.frames.map_or(batch * n, Frames::len);
        assert_eq!(frames, batch * n, "block: number of frames");
    }
}

/// A block's weights; matrices are [out, in], row-major.
#[derive(Clone, Copy, Debug)]
pub struct BlockWeights<'a> {
    /// `[dim]`
    pub norm1: &'a [f32],
    /// `[3·dim, dim]`: rows of q, then k, then v.
    pub qkv: &'a [f32],
    /// `[head_dim]`
    pub q_norm: &'a [f32],
    /// `[head_dim]`
    pub k_norm: &'a [f32],
    /// `[dim, dim]`
    pub proj: &'a [f32],
    /// `[dim]`
    pub norm2: &'a [f32],
    /// `[hidden, dim]`
    pub fc1: &'a [f32],
    /// `[dim, hidden]`
    pub fc2: &'a [f32],
}

impl BlockWeights<'_> {
    fn check(&self, shape: BlockShape) {
        shape.check();
        let (d, m, dh) = (shape.dim, shape.hidden, shape.head_dim);
        let lengths = [
            ("norm1", self.norm1, d),
            ("qkv", self.qkv, 3 * d * d),
            ("q_norm", self.q_norm, dh),
            ("k_norm", self.k_norm, dh),
            ("proj", self.proj, d * d),
            ("norm2", self.norm2, d),
            ("fc1", self.fc1, m * d),
            ("fc2", self.fc2, d * m),
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
    pub norm1: Vec<f32>,
    pub qkv: Vec<f32>,
    pub q_norm: Vec<f32>,
    pub k_norm: Vec<f32>,
    pub proj: Vec<f32>,
    pub norm2: Vec<f32>,
    pub fc1: Vec<f32>,
    pub fc2: Vec<f32>,
}

/// What a forward pass keeps for its backward pass.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Save {
    /// Everything the backward pass would otherwise compute again: per token `6·dim` floats and
    /// the hidden layer in operand precision.
    #[default]
    Activations,
    /// The input alone; backward runs the forward pass again.
    Input,
}

/// A finished forward pass, ready for `block_backward`.
pub struct Saved {
    compute: Compute,
    batch: usize,
    n: usize,
    pattern: Pattern,
    x: Buf<f32>,
    frames: Option<Buf<f32>>,
    activations: Option<Activations>,
}

/// Intermediate values of a forward pass.
struct Activations {
    /// [tokens, 3·dim], before the norms of q and k; in the world, where tokens have frames.
    qkv: Buf<f32>,
    /// [batch, heads, n]
    lse: Buf<f32>,
    /// [tokens, dim]; in the tokens' own spaces
    attention: Buf<f32>,
    /// [tokens, dim], after the first residual.
    x1: Buf<f32>,
    /// [tokens, hidden], before GELU, in operand precision.
    hidden: AnyBuf,
}

/// Weights packed once for repeated forward passes.
pub struct PackedBlock {
    shape: BlockShape,
    compute: Compute,
    weights: AnyWeights,
}

enum AnyWeights {
    F32(Weights<PortableF32>),
    #[cfg(target_arch = "x86_64")]
    Avx2(Weights<Avx2F32>),
    #[cfg(target_arch = "x86_64")]
    Avx512(Weights<Avx512Bf16>),
    #[cfg(target_arch = "x86_64")]
    Avx512F32(Weights<Avx512F32>),
    #[cfg(target_arch = "x86_64")]
    Amx(Weights<AmxBf16>),
}

impl From<Weights<PortableF32>> for AnyWeights {
    fn from(weights: Weights<PortableF32>) -> Self {
        Self::F32(weights)
    }
}

#[cfg(target_arch = "x86_64")]
impl From<Weights<Avx2F32>> for AnyWeights {
    fn from(weights: Weights<Avx2F32>) -> Self {
        Self::Avx2(weights)
    }
}

#[cfg(target_arch = "x86_64")]
impl From<Weights<Avx512Bf16>> for AnyWeights {
    fn from(weights: Weights<Avx512Bf16>) -> Self {
        Self::Avx512(weights)
    }
}

#[cfg(target_arch = "x86_64")]
impl From<Weights<Avx512F32>> for AnyWeights {
    fn from(weights: Weights<Avx512F32>) -> Self {
        Self::Avx512F32(weights)
    }
}

#[cfg(target_arch = "x86_64")]
impl From<Weights<AmxBf16>> for AnyWeights {
    fn from(weights: Weights<AmxBf16>) -> Self {
        Self::Amx(weights)
    }
}

/// Runs `$body` with `$w` bound to the weights of whichever kernel `$any` holds.
macro_rules! with_weights {
    ($any:expr, $w:ident => $body:expr) => {
        match $any {
            $crate::block::AnyWeights::F32($w) => $body,
            #[cfg(target_arch = "x86_64")]
            $crate::block::AnyWeights::Avx2($w) => $body,
            #[cfg(target_arch = "x86_64")]
            $crate::block::AnyWeights::Avx512($w) => $body,
            #[cfg(target_arch = "x86_64")]
            $crate::block::AnyWeights::Avx512F32($w) => $body,
            #[cfg(target_arch = "x86_64")]
            $crate::block::AnyWeights::Amx($w) => $body,
        }
    };
}
use with_weights;

impl PackedBlock {
    /// Copies and packs the weights.
    ///
    /// # Panics
    /// If a weight's length does not match `shape`.
    pub fn new(shape: BlockShape, weights: &BlockWeights, compute: impl Into<Compute>) -> Self {
        weights.check(shape);
        let compute = compute.into();
        let weights = with_kernel!(compute, kernel => {
            AnyWeights::from(Weights::new(kernel, shape, weights))
        });
        Self {
            shape,
            compute,
            weights,
        }
    }

    /// The sizes it was packed for.
    pub fn shape(&self) -> BlockShape {
        self.shape
    }

    /// `out = block(x)`; `x`, `out`: [batch, n, dim].
    ///
    /// # Panics
    /// If a length does not match, or `n` tokens do not fit `pattern`.
    pub fn forward<'a>(
        &self,
        x: impl Into<Tokens<'a>>,
        batch: usize,
        n: usize,
        pattern: Pattern,
        out: &mut [f32],
    ) {
        let x = x.into();
        x.check(batch, n, self.shape);
        check_length("out", out, batch, n, self.shape);
        let layout = self.shape.layout(batch, n, pattern);
        pooled(|| {
            with_weights!(&self.weights, w => {
                forward::forward(w, &layout, x, out, Pass::default());
            });
        });
    }
}

fn check_length(name: &str, x: &[f32], batch: usize, n: usize, shape: BlockShape) {
    assert_eq!(x.len(), batch * n * shape.dim, "block: length of {name}");
}

/// `out = block(x)`; `x`, `out`: [batch, n, dim].
///
/// # Panics
/// If a length does not match, or `n` tokens do not fit `pattern`.
#[allow(clippy::too_many_arguments)]
pub fn block_forward<'a>(
    shape: BlockShape,
    weights: &BlockWeights,
    compute: impl Into<Compute>,
    x: impl Into<Tokens<'a>>,
    batch: usize,
    n: usize,
    pattern: Pattern,
    out: &mut [f32],
) {
    PackedBlock::new(shape, weights, compute).forward(x, batch, n, pattern, out);
}

/// As `block_forward`, and keeps what `block_backward` needs.
///
/// # Panics
/// As `block_forward`.
#[allow(clippy::too_many_arguments)]
pub fn block_forward_saved<'a>(
    shape: BlockShape,
    weights: &BlockWeights,
    compute: impl Into<Compute>,
    save: Save,
    x: impl Into<Tokens<'a>>,
    batch: usize,
    n: usize,
    pattern: Pattern,
    out: &mut [f32],
) -> Saved {
    let x = x.into();
    weights.check(shape);
    x.check(batch, n, shape);
    check_length("out", out, batch, n, shape);
    let compute = compute.into();
    let layout = shape.layout(batch, n, pattern);
    let activations = with_kernel!(compute, kernel => {
        let weights = Weights::new(kernel, shape, weights);
        let save = save == Save::Activations;
        forward::forward(&weights, &layout, x, out, Pass { save, ..Pass::default() }).0
    });
    Saved {
        compute,
        batch,
        n,
        pattern,
        x: Buf::copy_of(x.x),
        frames: x.frames.map(|frames| Buf::copy_of(frames.values())),
        activations,
    }
}

/// Which gradients a backward pass is asked for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Wanted {
    /// All of them.
    #[default]
    All,
    /// Not those of the four matrices, which are left empty: a frozen block passes gradients on for two
    /// thirds of the work.
    NoMatrices,
}

/// Gradients of the input and of every weight that is `wanted`; `grad_out`: [batch, n, dim].
///
/// # Panics
/// If a length does not match.
pub fn block_backward(
    shape: BlockShape,
    weights: &BlockWeights,
    saved: &Saved,
    grad_out: &[f32],
    wanted: Wanted,
) -> BlockGrads {
    weights.check(shape);
    check_length("grad_out", grad_out, saved.batch, saved.n, shape);
    check_length("saved x", &saved.x, saved.batch, saved.n, shape);
    let layout = shape.layout(saved.batch, saved.n, saved.pattern);
    let x = Tokens {
        x: &saved.x,
        frames: saved.frames.as_deref().map(Frames::new),
    };
    with_kernel!(saved.compute, kernel => {
        let recomputed;
        let activations = match &saved.activations {
            Some(activations) => activations,
            None => {
                let mut out = Buf::new(saved.x.len());
                let packed = Weights::new(kernel, shape, weights);
                let pass = Pass { save: true, ..Pass::default() };
                recomputed = forward::forward(&packed, &layout, x, &mut out, pass).0;
                recomputed.as_ref().expect("asked for the activations")
            }
        };
        backward::backward(kernel, shape, weights, &layout, x, activations, grad_out, wanted)
    })
}
