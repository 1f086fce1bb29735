//! What tokens attend to.

use super::{BlockShape, Tokens};
use crate::attention::{Anchors, Layout, Pattern};

/// What tokens attend to; a [`Pattern`] is one answer.
///
/// `groups` are the lengths of consecutive spans of tokens, n in all; with anchors each of them sees its own version of
/// every key.
#[derive(Clone, Copy, Debug)]
pub enum Sight<'a> {
    /// Tokens of their own sequence.
    Pattern(Pattern),
    /// All n tokens of their own sequence, in groups that turn its keys.
    #[allow(missing_docs)]
    Anchored {
        groups: &'a [usize],
        anchors: Anchors<'a>,
    },
    /// All m tokens of an external context `[batch, m, dim]` and those of their own group. The context gives keys and
    /// values, from this block's weights, and is not changed.
    #[allow(missing_docs)]
    Context {
        context: Tokens<'a>,
        groups: &'a [usize],
        anchors: Option<Anchors<'a>>,
    },
}

impl From<Pattern> for Sight<'_> {
    fn from(pattern: Pattern) -> Self {
        Self::Pattern(pattern)
    }
}

impl<'a> Sight<'a> {
    /// What `n` tokens see of one another, and the external context with its number of tokens.
    ///
    /// # Panics
    /// If a length does not match.
    pub(super) fn layout(
        self,
        shape: BlockShape,
        batch: usize,
        n: usize,
    ) -> (Layout<'a>, Option<(Tokens<'a>, usize)>) {
        let sizes = shape.attention(batch);
        match self {
            Self::Pattern(pattern) => (Layout::pattern(sizes, n, pattern), None),
            Self::Anchored { groups, anchors } => {
                (Layout::anchored(sizes, n, groups, anchors), None)
            }
            Self::Context {
                context,
                groups,
                anchors,
            } => {
                let m = context.x.len() / (batch * shape.dim).max(1);
                context.check("context", batch, m, shape);
                let layout = Layout::external(sizes, n, m, groups, anchors);
                (layout, Some((context, m)))
            }
        }
    }
}
