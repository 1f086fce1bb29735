//! The block in two steps: a context once, then any number of queries that see it.
//!
//! The context's tokens see each other only, or are not processed at all, so nothing about them depends on the
//! groups that follow: their keys and values can be kept from one call to the next.

use super::forward::{self, Pass};
use super::{BlockShape, PackedBlock, Tokens, check_length, with_weights};
use crate::attention::{self, Anchors, Layout, Pattern};
use crate::cpu::Compute;
use crate::threads::pooled;

/// A context's keys (normalised, not turned by anchors) and values in one block, as its attention reads them.
///
/// They belong to the block that made them.
pub struct KeyValues {
    shape: BlockShape,
    compute: Compute,
    batch: usize,
    context: usize,
    anchored: bool,
    kept: attention::KeyValues,
}

impl KeyValues {
    /// Batch elements.
    pub fn batch(&self) -> usize {
        self.batch
    }

    /// Tokens of each batch element.
    pub fn context(&self) -> usize {
        self.context
    }

    /// Memory held, in bytes: `2·batch·context·dim` operands of 2 bytes in bf16 or 4 in f32, and
    /// padding (buffers are reused, so at most twice as much). Keys that anchors will turn are f32.
    pub fn bytes(&self) -> usize {
        self.kept.bytes()
    }
}

impl PackedBlock {
    /// `out = block(x)` where all `context` tokens see each other, and the keys and values that
    /// [`Self::forward_queries`] needs; `x`, `out`: [batch, context, dim].
    ///
    /// # Panics
    /// If a length does not match.
    pub fn forward_context<'a>(
        &self,
        x: impl Into<Tokens<'a>>,
        batch: usize,
        context: usize,
        out: &mut [f32],
    ) -> KeyValues {
        let x = x.into();
        x.check("x", batch, context, self.shape);
        check_length("out", out, batch, context, self.shape);
        let sizes = self.shape.attention(batch);
        let layout = Layout::pattern(sizes, context, Pattern::full(context));
        let pass = Pass {
            keep: true,
            ..Pass::default()
        };
        let kept = with_weights!(&self.weights, w => forward::forward(w, &layout, x, out, pass).1);
        self.keep(
            batch,
            context,
            false,
            kept.expect("asked for the keys and values"),
        )
    }

    /// The keys and values alone, where nobody reads the context's output: in the last block of a
    /// stack, and of an external context. `anchored` says whether [`Self::forward_queries`] will have anchors.
    /// `x`: [batch, context, dim].
    ///
    /// # Panics
    /// If a length does not match.
    pub fn key_values<'a>(
        &self,
        x: impl Into<Tokens<'a>>,
        batch: usize,
        context: usize,
        anchored: bool,
    ) -> KeyValues {
        let x = x.into();
        x.check("x", batch, context, self.shape);
        let kept = with_weights!(&self.weights, w => {
            forward::key_values(w, batch, x, context, anchored).1
        });
        self.keep(batch, context, anchored, kept)
    }

    fn keep(
        &self,
        batch: usize,
        context: usize,
        anchored: bool,
        kept: attention::KeyValues,
    ) -> KeyValues {
        KeyValues {
            shape: self.shape,
            compute: self.compute,
            batch,
            context,
            anchored,
            kept,
        }
    }

    /// `out = block(x)` for consecutive groups of tokens, of the lengths `groups`, that see the kept context and their
    /// own group: what [`Self::forward`] gives with [`Sight::Context`](super::Sight::Context), or, without anchors, for
    /// these tokens after the context of a [`Pattern`]. `x`, `out`: [batch, n, dim].
    ///
    /// # Panics
    /// If a length does not match, the groups are not `n` tokens, or `context` comes from a block
    /// of other sizes, precision or instructions, from another batch size, or is not for anchors just where there are
    /// some.
    #[allow(clippy::too_many_arguments)]
    pub fn forward_queries<'a>(
        &self,
        context: &KeyValues,
        x: impl Into<Tokens<'a>>,
        batch: usize,
        n: usize,
        groups: &[usize],
        anchors: Option<Anchors>,
        out: &mut [f32],
    ) {
        let x = x.into();
        x.check("x", batch, n, self.shape);
        check_length("out", out, batch, n, self.shape);
        assert!(
            (self.shape, self.compute) == (context.shape, context.compute),
            "queries: keys and values of another block"
        );
        assert_eq!(
            batch, context.batch,
            "queries: batch size of the keys and values"
        );
        assert_eq!(
            anchors.is_some(),
            context.anchored,
            "queries: anchors, and keys and values for anchors"
        );
        let sizes = self.shape.attention(batch);
        let layout = Layout::external(sizes, n, context.context, groups, anchors);
        let pass = Pass {
            kept: Some(&context.kept),
            ..Pass::default()
        };
        pooled(|| {
            with_weights!(&self.weights, w => {
                forward::forward(w, &layout, x, out, pass);
            });
        });
    }
}
