//! A whole pre-LN transformer block with QK-norm, all layers without bias:
//!
//! ```text
//! q, k, v = LayerNorm(x) [Wqk Wv]ᵀ        q, k: RMSNorm over each head's channels
//! x1      = x + softmax(q kᵀ / sqrt(dh)) v Wprojᵀ
//! out     = x1 + gelu(LayerNorm(x1) W1ᵀ) W2ᵀ
//! ```
//!
//! Keys and values are those of the tokens themselves, and of an external context where there is one ([`Sight`]).
//!
//! Tokens may have frames; then q, k and v move to the world before the norms of q and k, and what the softmax gathers moves
//! back (see `frames`). There may be anchors; then the last dh/2 channels of q and k turn after their norms (see
//! `attention/anchors`).
//!
//! A token's channels may be S split streams (arXiv 2605.18599) of d/S channels, one after the other. They share q and k,
//! which read all of them; LayerNorm, Wv, Wproj, W1 and W2 are each stream's own (block-diagonal). A head's value vector
//! is its dh/S channels of every stream: s·d/S + h·dh/S and on, for stream s and head h.

mod backward;
mod cached;
mod forward;
mod projection;
mod shape;
mod sight;

pub use cached::KeyValues;
pub use shape::{BlockGrads, BlockShape, BlockWeights, Tokens};
pub use sight::Sight;

use crate::buffer::Buf;
use crate::cpu::Compute;
#[cfg(target_arch = "x86_64")]
use crate::gemm::{AmxBf16, Avx2F32, Avx512Bf16, Avx512F32};
use crate::gemm::{AnyBuf, PortableF32, with_kernel};
use crate::threads::pooled;
use forward::{Pass, Weights};
use shape::check_length;

/// Columns of the hidden layer a task computes at once; they stay in the second-level cache.
const CHUNK: usize = 512;

/// What a forward pass keeps for its backward pass.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Save {
    /// Everything the backward pass would otherwise compute again: per token `6·dim` floats and
    /// the hidden layer in operand precision.
    #[default]
    Activations,
    /// Nothing; backward, which is given the input again, runs the forward pass again.
    Input,
}

/// A finished forward pass, ready for `block_backward`.
pub struct Saved {
    compute: Compute,
    batch: usize,
    n: usize,
    activations: Option<Activations>,
}

/// Intermediate values of a forward pass.
struct Activations {
    /// [tokens, 3·dim], before the norms of q and k; in the world, where tokens have frames.
    qkv: Buf<f32>,
    /// [tokens of an external context, 2·dim], likewise without q.
    context: Option<Buf<f32>>,
    /// [batch, heads, n]
    lse: Buf<f32>,
    /// [tokens, dim], heads with their channels of stream after stream; in the tokens' own spaces.
    attention: Buf<f32>,
    /// [tokens, dim], after the first residual.
    x1: Buf<f32>,
    /// [tokens, hidden], before GELU, in operand precision.
    hidden: AnyBuf,
}

impl Activations {
    /// # Panics
    /// If they are not those of a pass with this context.
    fn check(&self, context: Option<(Tokens, usize)>) {
        let values = context.map(|(context, _)| 2 * context.x.len());
        let saved = self.context.as_ref().map(|kv| kv.len());
        assert_eq!(
            saved, values,
            "block: another context than in the forward pass"
        );
    }
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
    /// If a length does not match, or `n` tokens do not fit `sight`.
    pub fn forward<'a>(
        &self,
        x: impl Into<Tokens<'a>>,
        batch: usize,
        n: usize,
        sight: impl Into<Sight<'a>>,
        out: &mut [f32],
    ) {
        let x = x.into();
        x.check("x", batch, n, self.shape);
        check_length("out", out, batch, n, self.shape);
        let (layout, context) = sight.into().layout(self.shape, batch, n);
        let pass = Pass {
            context,
            ..Pass::default()
        };
        pooled(|| {
            with_weights!(&self.weights, w => {
                forward::forward(w, &layout, x, out, pass);
            });
        });
    }
}

/// `out = block(x)`; `x`, `out`: [batch, n, dim].
///
/// # Panics
/// If a length does not match, or `n` tokens do not fit `sight`.
#[allow(clippy::too_many_arguments)]
pub fn block_forward<'a>(
    shape: BlockShape,
    weights: &BlockWeights,
    compute: impl Into<Compute>,
    x: impl Into<Tokens<'a>>,
    batch: usize,
    n: usize,
    sight: impl Into<Sight<'a>>,
    out: &mut [f32],
) {
    PackedBlock::new(shape, weights, compute).forward(x, batch, n, sight, out);
}

/// As `block_forward`, and keeps what `block_backward` needs besides the input.
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
    sight: impl Into<Sight<'a>>,
    out: &mut [f32],
) -> Saved {
    let x = x.into();
    weights.check(shape);
    x.check("x", batch, n, shape);
    check_length("out", out, batch, n, shape);
    let compute = compute.into();
    let (layout, context) = sight.into().layout(shape, batch, n);
    let pass = Pass {
        context,
        save: save == Save::Activations,
        ..Pass::default()
    };
    let activations = with_kernel!(compute, kernel => {
        let weights = Weights::new(kernel, shape, weights);
        forward::forward(&weights, &layout, x, out, pass).0
    });
    Saved {
        compute,
        batch,
        n,
        activations,
    }
}

/// Which gradients a backward pass is asked for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Wanted {
    /// All of them.
    #[default]
    All,
    /// Not those of the matrices, which are left empty: a frozen block passes gradients on for two
    /// thirds of the work.
    NoMatrices,
}

/// Gradients of the input, of an external context and of every weight that is `wanted`; `x` and `sight` are those of
/// the forward pass, `grad_out`: [batch, n, dim].
///
/// # Panics
/// If a length does not match.
pub fn block_backward<'a>(
    shape: BlockShape,
    weights: &BlockWeights,
    saved: &Saved,
    x: impl Into<Tokens<'a>>,
    sight: impl Into<Sight<'a>>,
    grad_out: &[f32],
    wanted: Wanted,
) -> BlockGrads {
    let x = x.into();
    let (batch, n) = (saved.batch, saved.n);
    weights.check(shape);
    x.check("x", batch, n, shape);
    check_length("grad_out", grad_out, batch, n, shape);
    let (layout, context) = sight.into().layout(shape, batch, n);
    with_kernel!(saved.compute, kernel => {
        let recomputed;
        let activations = match &saved.activations {
            Some(activations) => activations,
            None => {
                let mut out = Buf::new(x.x.len());
                let packed = Weights::new(kernel, shape, weights);
                let pass = Pass { context, save: true, ..Pass::default() };
                recomputed = forward::forward(&packed, &layout, x, &mut out, pass).0;
                recomputed.as_ref().expect("asked for the activations")
            }
        };
        activations.check(context);
        let call = backward::Call { shape, weights, layout: &layout, x, context };
        backward::backward(kernel, call, activations, grad_out, wanted)
    })
}
