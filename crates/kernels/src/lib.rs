//! Fast CPU transformer kernels on plain slices.
//!
//! One pre-LN, QK-normalised transformer block, forward and backward, with the keys and values of a
//! context kept where it is asked again, split streams, frames and depth anchors; convolutions of image heads, forward and backward; and the
//! three matrix products their neighbours need. Everything works on row-major `f32` slices and knows nothing of a
//! tensor library.
//!
//! ```text
//! cpu        which instructions, which precision
//! gemm/      packed matrix products: one kernel per file behind the `Kernel` trait
//! norm gelu softmax   row-wise passes, compiled once per instruction set
//! frames     where tokens are, for attention that knows it
//! attention/ tiled attention, memory linear in the number of tokens
//! block/     the whole block: API, forward, backward
//! conv/      convolutions, forward and backward
//! reference  the same mathematics, slow and obvious, in f64
//! ```
//!
//! Results never depend on the number of threads: every sum has one fixed order.
#![allow(unsafe_code)] // Kernels: intrinsics and disjoint writes from parallel tiles.

mod attention;
mod block;
mod buffer;
mod conv;
mod cpu;
mod frames;
mod gelu;
mod gemm;
mod norm;
pub mod reference;
mod simd;
mod softmax;
mod threads;

pub use attention::{Anchors, Pattern};
pub use block::{
    BlockGrads, BlockShape, BlockWeights, KeyValues, PackedBlock, Save, Saved, Sight, Tokens,
    Wanted, block_backward, block_forward, block_forward_saved,
};
pub use conv::{ConvGrads, ConvShape, ConvWanted, conv2d, conv2d_backward};
pub use cpu::{Compute, Cpu, Precision};
pub use frames::{FRAME, Frames};
pub use gemm::{matmul, matmul_nn, matmul_tn};
