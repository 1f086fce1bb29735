//! The tree of edits: every step keeps its scene tokens, so going back, branching and comparing cost nothing.

use crate::form::EditForm;
use crate::limits::{NODES, RELIT, TOKEN_BYTES};
use crate::{Error, Result};
use lumi_model::SceneTokens;
use std::collections::{BTreeMap, HashSet};
use std::sync::{Arc, OnceLock};

/// A step's number; the root, the capture as encoded, is 0.
pub type NodeId = u32;

/// One step.
#[derive(Clone)]
pub struct Node {
    /// Its number, never used again in this session.
    pub id: NodeId,
    /// The step it was made from; `None` for the root.
    pub parent: Option<NodeId>,
    /// The edit that led here; `None` for the root.
    pub edit: Option<EditForm>,
    /// The scene after the edit.
    pub tokens: Arc<SceneTokens>,
    /// How long encoding or editing took.
    pub seconds: f32,
    /// Counts the changes of this step, so that pictures of it can be cached.
    pub version: u32,
    /// A PNG of it, made when first asked for.
    pub thumbnail: Arc<OnceLock<Vec<u8>>>,
}

/// All steps of a session.
pub struct Tree {
    nodes: BTreeMap<NodeId, Node>,
    next: NodeId,
    /// The step that was made or changed last.
    latest: NodeId,
    /// What the last removal took away.
    removed: Vec<Node>,
    /// Bytes of one step's tokens.
    token_bytes: usize,
}

impl Tree {
    /// A tree of the capture alone.
    #[must_use]
    pub fn new(tokens: SceneTokens, seconds: f32, token_bytes: usize) -> Self {
        let root = Node {
            id: 0,
            parent: None,
            edit: None,
            tokens: Arc::new(tokens),
            seconds,
            version: 0,
            thumbnail: Arc::default(),
        };
        Self {
            nodes: BTreeMap::from([(0, root)]),
            next: 1,
            latest: 0,
            removed: Vec::new(),
            token_bytes,
        }
    }

    /// A tree out of a file: the nodes in ascending order of their numbers, root first.
    ///
    /// # Errors
    /// If numbers repeat or a parent does not stand before its child.
    pub fn from_nodes(nodes: Vec<Node>, token_bytes: usize) -> Result<Self> {
        let wrong = |what: String| Err(Error::Invalid(format!("session file: nodes: {what}")));
        let mut tree = BTreeMap::<NodeId, Node>::new();
        for node in nodes {
            let (id, parent) = (node.id, node.parent);
            let rooted = match parent {
                None => tree.is_empty() && id == 0 && node.edit.is_none(),
                Some(parent) => parent < id && tree.contains_key(&parent) && node.edit.is_some(),
            };
            if !rooted || id == NodeId::MAX || tree.insert(id, node).is_some() {
                return wrong(format!(
                    "expected a tree with its root 0 first, found step {id} from {parent:?}"
                ));
            }
        }
        let Some(latest) = tree.keys().last().copied() else {
            return wrong("expected at least one".into());
        };
        Ok(Self {
            nodes: tree,
            next: latest + 1,
            latest,
            removed: Vec::new(),
            token_bytes,
        })
    }

    /// All steps, ascending by number: parents before children.
    pub fn nodes(&self) -> impl Iterator<Item = &Node> {
        self.nodes.values()
    }

    /// The step that was made or changed last.
    #[must_use]
    pub fn latest(&self) -> NodeId {
        self.latest
    }

    /// Steps that the last removal took away.
    #[must_use]
    pub fn removed(&self) -> usize {
        self.removed.len()
    }

    /// A step.
    ///
    /// # Errors
    /// If there is none of this number.
    pub fn get(&self, id: NodeId) -> Result<&Node> {
        self.nodes
            .get(&id)
            .ok_or_else(|| Error::NotFound(format!("node {id}: there is no such step")))
    }

    /// The steps from the root to `id`.
    ///
    /// # Errors
    /// As [`Self::get`].
    pub fn path(&self, id: NodeId) -> Result<Vec<&Node>> {
        let mut path = vec![self.get(id)?];
        while let Some(parent) = path[path.len() - 1].parent {
            path.push(self.get(parent)?);
        }
        path.reverse();
        Ok(path)
    }

    /// Whether there is room for one more step.
    ///
    /// # Errors
    /// Says which limit is reached.
    pub fn check_room(&self) -> Result<()> {
        let count = self.nodes.len() + self.removed.len();
        if count >= NODES || (count + 1) * self.token_bytes > TOKEN_BYTES {
            let text = format!("this session is full ({count} steps): save it and start another");
            return Err(Error::TooLarge(text));
        }
        Ok(())
    }

    /// A new step after `parent`, whose tokens it was made `on`; `None` if they have changed meanwhile.
    ///
    /// # Errors
    /// If the parent is gone or the session is full.
    pub fn add(
        &mut self,
        (parent, on): (NodeId, &Arc<SceneTokens>),
        edit: EditForm,
        tokens: SceneTokens,
        seconds: f32,
    ) -> Result<Option<NodeId>> {
        self.check_room()?;
        if !Arc::ptr_eq(&self.get(parent)?.tokens, on) {
            return Ok(None);
        }
        let id = self.next;
        self.next += 1;
        self.latest = id;
        let node = Node {
            id,
            parent: Some(parent),
            edit: Some(edit),
            tokens: Arc::new(tokens),
            seconds,
            version: 0,
            thumbnail: Arc::default(),
        };
        self.nodes.insert(id, node);
        Ok(Some(id))
    }

    /// A step and everything that was built on it, parents before children.
    ///
    /// # Errors
    /// As [`Self::get`].
    pub fn branch(&self, id: NodeId) -> Result<Vec<&Node>> {
        let mut branch = vec![self.get(id)?];
        let mut ids = HashSet::from([id]);
        // Children have larger numbers than their parents, so one ascending pass finds them all.
        for node in self.nodes.range(id + 1..).map(|(_, node)| node) {
            if node.parent.is_some_and(|p| ids.contains(&p)) {
                ids.insert(node.id);
                branch.push(node);
            }
        }
        Ok(branch)
    }

    /// The branch of a step that may be changed: it has an edit, is still at `version`, and not too much stands on it.
    ///
    /// # Errors
    /// Says why not.
    pub fn changeable(&self, id: NodeId, version: u32) -> Result<Vec<Node>> {
        let node = self.get(id)?;
        if node.edit.is_none() {
            return Err(Error::Conflict("the capture itself has no lights".into()));
        }
        if node.version != version {
            let text = format!(
                "node {id}: expected version {version}, found {}: it was changed meanwhile",
                node.version
            );
            return Err(Error::Conflict(text));
        }
        let branch = self.branch(id)?;
        if branch.len() > RELIT {
            let text = format!(
                "node {id}: {} steps are built on it; begin a branch instead",
                branch.len() - 1
            );
            return Err(Error::Conflict(text));
        }
        Ok(branch.into_iter().cloned().collect())
    }

    /// Puts a changed branch in the place of `before`; says whether that was still there, on the same parent.
    #[must_use]
    pub fn replace(&mut self, on: &Arc<SceneTokens>, before: &[Node], after: Vec<Node>) -> bool {
        let Some(first) = before.first() else {
            return false;
        };
        let parent = first.parent.and_then(|p| self.nodes.get(&p));
        let kept = parent.is_some_and(|p| Arc::ptr_eq(&p.tokens, on));
        let key = |n: &Node| (n.id, n.version);
        let same = self
            .branch(first.id)
            .is_ok_and(|now| now.iter().map(|n| key(n)).eq(before.iter().map(key)));
        if kept && same {
            self.latest = first.id;
            // What was taken away from a changed step was made from tokens that are gone.
            let stood_on = self.removed.first().and_then(|n| n.parent);
            if before.iter().any(|n| Some(n.id) == stood_on) {
                self.removed.clear();
            }
            self.nodes.extend(after.into_iter().map(|n| (n.id, n)));
        }
        kept && same
    }

    /// Takes a step away, with everything that was built on it; [`Self::restore`] brings it back.
    ///
    /// # Errors
    /// If there is no such step, or it is the capture itself.
    pub fn remove(&mut self, id: NodeId) -> Result<usize> {
        let Some(parent) = self.get(id)?.parent else {
            return Err(Error::Conflict("the capture itself stays".into()));
        };
        let gone: Vec<NodeId> = self.branch(id)?.iter().map(|n| n.id).collect();
        self.removed = gone.iter().filter_map(|id| self.nodes.remove(id)).collect();
        self.latest = parent;
        Ok(gone.len())
    }

    /// Brings back what the last removal took away.
    ///
    /// # Errors
    /// If there is nothing, or the step it stood on is gone too.
    pub fn restore(&mut self) -> Result<NodeId> {
        let nothing = || Error::Conflict("there is nothing to bring back".into());
        let first = self.removed.first().ok_or_else(nothing)?;
        let (id, parent) = (first.id, first.parent.ok_or_else(nothing)?);
        self.get(parent)?;
        for node in std::mem::take(&mut self.removed) {
            self.nodes.insert(node.id, node);
        }
        self.latest = id;
        Ok(id)
    }
}
