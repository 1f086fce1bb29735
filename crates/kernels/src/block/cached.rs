//! The block in two steps: a context once, then any number of queries that see it.
//!
//! With [`Pattern`] the context's tokens see each other only, so nothing about them depends on the
//! groups that follow: their keys and values can be kept from one call to the next.

use super::forward::{self, Pass};
use super::{BlockShape, PackedBlock, Tokens, check_length, with_weights};
use crate::attention::{self, Pattern};
use crate::cpu::Compute;
use crate::threads::pooled;

/// A context's keys (normalised) and values in one block, packed as its attention reads them.
///
/// They belong to the block that made them.
pub struct KeyValues {
    shape: BlockShape,
    compute: Compute,
    batch: usize,
    context: usize,
    packed: attention::KeyValues,
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
    /// padding (buffers are reused, so at most twice as much).
    pub fn bytes(&self) -> usize {
        self.packed.bytes()
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
        check_length("out", out, batch, context, self.shape);
        let pass = Pass {
            keep: true,
            ..Pass::default()
        };
        self.keep(
            x,
            batch,
            context,
            |layout| with_weights!(&self.weights, w => forward::forward(w, layout, x, out, pass).1),
        )
    }

    /// The keys and values alone, where nobody reads the context's output: in the last block of a
    /// stack. `x`: [batch, context, dim].
    ///
    /// # Panics
    /// If a length does not match.
    pub fn key_values<'a>(
        &self,
        x: impl Into<Tokens<'a>>,
        batch: usize,
        context: usize,
    ) -> KeyValues {
        let x = x.into();
        self.keep(
            x,
            batch,
            context,
            |layout| with_weights!(&self.weights, w => Some(forward::key_values(w, layout, x))),
        )
    }

    fn keep(
        &self,
        x: Tokens,
        batch: usize,
        context: usize,
        run: impl FnOnce(&attention::Layout) -> Option<attention::KeyValues>,
    ) -> KeyValues {
        x.check(batch, context, self.shape);
        let layout = self.shape.layout(batch, context, Pattern::full(context));
        KeyValues {
            shape: self.shape,
            compute: self.compute,
            batch,
            context,
            packed: run(&layout).expect("asked for the keys and values"),
        }
    }

    /// `out = block(x)` for groups of `group` tokens that see the kept context and their own group:
    /// what [`Self::forward`] gives for these tokens after the context, with
    /// `Pattern { context, group }`. `x`, `out`: [batch, n, dim].
    ///
    /// # Panics
    /// If a length does not match, `n` tokens are not whole groups, or `context` comes from a block
    /// of other sizes, precision or instructions, or from another batch size.
    pub fn forward_queries<'a>(
        &self,
        context: &KeyValues,
        x: impl Into<Tokens<'a>>,
        batch: usize,
        n: usize,
        group: usize,
        out: &mut [f32],
    ) {
        let x = x.into();
        x.check(batch, n, self.shape);
        check_length("out", out, batch, n, self.shape);
        assert!(
            (self.shape, self.compute) == (context.shape, context.compute),
            "queries: keys and values of another block"
        );
        assert_eq!(
            batch, context.batch,
            "queries: batch size of the keys and values"
        );
        let layout = self.shape.layout(batch, n, Pattern { context: 0, group });
        let pass = Pass {
            context: Some(&context.packed),
            ..Pass::default()
        };
        pooled(|| {
            with_weights!(&self.weights, w => {
                forward::forward(w, &layout, x, out, pass);
            });
        });
    }
}
