//! Which queries see which keys, and how the work is cut.

use super::Anchors;

/// Largest number of query rows a task holds.
const TILE: usize = 96;
/// Query tiles that share one turning and packing of their keys, at most.
const SHARING: usize = 4;
/// Elements of a cache line, for the narrowest element.
const PANEL_ALIGN: usize = 32;

/// Which tokens of a sequence see which: the first `context` tokens see each other only; the
/// others are consecutive groups of `group` tokens, which see the context and their own group.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Pattern {
    /// Number of leading context tokens.
    pub context: usize,
    /// Tokens of one group; not read if all tokens are context.
    pub group: usize,
}

impl Pattern {
    /// All `n` tokens see each other.
    pub fn full(n: usize) -> Self {
        Self {
            context: n,
            group: 0,
        }
    }

    /// # Panics
    /// If `n` tokens do not split into the context and whole groups.
    fn check(self, n: usize) {
        let Self { context, group } = self;
        assert!(
            context <= n,
            "pattern: context {context} of only {n} tokens"
        );
        assert!(
            context == n || (group > 0 && (n - context).is_multiple_of(group)),
            "pattern: {} tokens after the context are not whole groups of {group}",
            n - context
        );
    }
}

/// Consecutive tokens of a sequence.
#[derive(Clone, Copy)]
pub(crate) struct Span {
    pub start: usize,
    pub len: usize,
}

/// Sizes that do not depend on the number of tokens.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) struct Shape {
    pub batch: usize,
    pub heads: usize,
    pub head_dim: usize,
}

impl Shape {
    pub fn dim(self) -> usize {
        self.heads * self.head_dim
    }

    /// Heads of all batch elements.
    pub fn all_heads(self) -> usize {
        self.batch * self.heads
    }

    /// Batch element and head of head `head` of all.
    pub fn head(self, head: usize) -> (usize, usize) {
        (head / self.heads, head % self.heads)
    }
}

/// Queries that see the same keys: besides an external context, if there is one, spans of their own sequence.
struct Group {
    tokens: Span,
    seen: Vec<usize>,
}

/// Queries of one group that a micro-kernel works on at once.
#[derive(Clone, Copy)]
pub(super) struct Tile {
    pub tokens: Span,
    pub group: usize,
}

/// Everything the two passes need to know about the queries.
pub(crate) struct Layout<'a> {
    pub shape: Shape,
    /// Query tokens of a batch element.
    pub n: usize,
    /// Spans of the sequence whose keys are seen as a whole.
    pub spans: Vec<Span>,
    pub anchors: Option<Anchors<'a>>,
    groups: Vec<Group>,
    /// Whether the anchors' keys are those of an external context.
    external: bool,
}

impl<'a> Layout<'a> {
    /// Tokens of one sequence that see each other by a pattern.
    ///
    /// # Panics
    /// If `n` tokens do not fit `pattern`.
    pub fn pattern(shape: Shape, n: usize, pattern: Pattern) -> Self {
        pattern.check(n);
        let context = (pattern.context > 0).then_some(pattern.context);
        let others = (n - pattern.context).checked_div(pattern.group);
        let others = std::iter::repeat_n(pattern.group, others.unwrap_or(0));
        let spans = consecutive(context.into_iter().chain(others));
        let groups = spans.iter().enumerate().map(|(i, &tokens)| Group {
            tokens,
            seen: if i > 0 && context.is_some() {
                vec![0, i]
            } else {
                vec![i]
            },
        });
        Self {
            shape,
            n,
            groups: groups.collect(),
            spans,
            anchors: None,
            external: false,
        }
    }

    /// All `n` tokens see each other, with a set of key rotations for each of the consecutive `groups`.
    ///
    /// # Panics
    /// If the groups are not `n` tokens, one is empty, or a table's length does not match.
    pub fn anchored(shape: Shape, n: usize, groups: &[usize], anchors: Anchors<'a>) -> Self {
        check_groups(groups, n);
        anchors.check(shape.batch, n, groups.len(), n, shape.head_dim);
        let groups = consecutive(groups.iter().copied());
        let groups = groups.into_iter().map(|tokens| Group {
            tokens,
            seen: vec![0],
        });
        Self {
            shape,
            n,
            groups: groups.collect(),
            spans: consecutive((n > 0).then_some(n)),
            anchors: Some(anchors),
            external: false,
        }
    }

    /// Consecutive `groups` that see an external context of `context` tokens and their own group.
    ///
    /// # Panics
    /// As [`Self::anchored`].
    pub fn external(
        shape: Shape,
        n: usize,
        context: usize,
        groups: &[usize],
        anchors: Option<Anchors<'a>>,
    ) -> Self {
        check_groups(groups, n);
        if let Some(anchors) = anchors {
            anchors.check(shape.batch, n, groups.len(), context, shape.head_dim);
        }
        let spans = consecutive(groups.iter().copied());
        let groups = spans.iter().enumerate().map(|(i, &tokens)| Group {
            tokens,
            seen: vec![i],
        });
        Self {
            shape,
            n,
            groups: groups.collect(),
            spans,
            anchors,
            external: true,
        }
    }

    /// Spans of the sequence that a group sees.
    pub(super) fn seen(&self, group: usize) -> &[usize] {
        &self.groups[group].seen
    }

    /// Query tiles, multiples of a micro-kernel's `unit` rows.
    pub(super) fn tiles(&self, unit: usize) -> Vec<Tile> {
        let mut tiles = Vec::new();
        for (group, Group { tokens: span, .. }) in self.groups.iter().enumerate() {
            // Equal tiles, rather than full ones and a rest.
            let len = span.len.div_ceil(span.len.div_ceil(TILE));
            let len = len.next_multiple_of(unit).min(TILE);
            tiles.extend(super::blocks(span.len, len).map(|tokens| Tile {
                tokens: Span {
                    start: span.start + tokens.start,
                    ..tokens
                },
                group,
            }));
        }
        tiles
    }

    /// Tiles cut into tasks: single ones, or with anchors a few of one group.
    pub(super) fn tasks<'t>(&self, tiles: &'t [Tile]) -> Vec<&'t [Tile]> {
        let most = if self.anchors.is_some() { SHARING } else { 1 };
        let groups = tiles.chunk_by(|a, b| a.group == b.group);
        groups.flat_map(|group| group.chunks(most)).collect()
    }

    /// How a span of the sequence's own keys turns for a query group of a head.
    pub(super) fn own_table(&self, head: usize, group: usize, span: Span) -> Option<&'a [f32]> {
        if self.external {
            self.query_table(head, span)
        } else {
            self.key_table(head, group, self.n)
        }
    }

    /// How the queries of `span` turn.
    pub(super) fn query_table(&self, head: usize, span: Span) -> Option<&'a [f32]> {
        let pairs = self.shape.head_dim / 2;
        let from = head / self.shape.heads * self.n + span.start;
        let table = self.anchors?.queries;
        Some(&table[from * pairs..][..span.len * pairs])
    }

    /// How the `keys` keys that the anchors have for each group turn.
    pub(super) fn key_table(&self, head: usize, group: usize, keys: usize) -> Option<&'a [f32]> {
        let Anchors {
            depths, keys: all, ..
        } = self.anchors?;
        let (b, h) = self.shape.head(head);
        let at = (b * self.groups.len() + group) * depths + h % depths;
        let len = keys * self.shape.head_dim / 2;
        Some(&all[at * len..][..len])
    }
}

/// # Panics
/// If they are not `n` tokens, or one is empty.
fn check_groups(groups: &[usize], n: usize) {
    let sum = groups.iter().fold(0usize, |sum, g| sum.saturating_add(*g));
    assert!(
        sum == n && !groups.contains(&0),
        "groups: lengths {groups:?} are not {n} tokens in groups of at least one"
    );
}

fn consecutive(lengths: impl IntoIterator<Item = usize>) -> Vec<Span> {
    let mut start = 0;
    let spans = lengths.into_iter().map(|len| {
        let span = Span { start, len };
        start += len;
        span
    });
    spans.collect()
}

/// Spans packed one after the other: elements of the packing and where each starts.
pub(super) fn offsets(spans: &[Span], len_of: impl Fn(usize) -> usize) -> (usize, Vec<usize>) {
    let mut total = 0;
    let starts = spans.iter().map(|s| {
        let start = total;
        // Keeps every span's packing on a cache line.
        total += len_of(s.len).next_multiple_of(PANEL_ALIGN);
        start
    });
    let starts = starts.collect();
    (total, starts)
}
