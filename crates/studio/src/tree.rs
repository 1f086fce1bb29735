//! The tree of edits: every step keeps its scene tokens, so going back, branching and comparing cost nothing.

use crate::form::EditForm;
use crate::limits::{NODES, RELIT, REMOVALS, TOKEN_BYTES};
use crate::{Error, Result};
use lumi_model::SceneTokens;
use std::collections::{BTreeMap, HashSet, VecDeque};
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
    /// What each removal took away, the step that was removed first; the oldest removal first.
    removed: VecDeque<Vec<Node>>,
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
            removed: VecDeque::new(),
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
            removed: VecDeque::new(),
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

    /// Removed steps that can be brought back.
    #[must_use]
    pub fn removed(&self) -> usize {
        self.removed.iter().map(Vec::len).sum()
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

    /// Whether one more step than `count` is too many.
    fn full(&self, count: usize) -> bool {
        count >= NODES || (count + 1) * self.token_bytes > TOKEN_BYTES
    }

    /// Whether there is room for one more step, at the cost of removed ones if need be.
    ///
    /// # Errors
    /// Says how many steps there are.
    pub fn check_room(&self) -> Result<()> {
        let count = self.nodes.len();
        if self.full(count) {
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
        while self.full(self.nodes.len() + self.removed()) && self.removed.pop_front().is_some() {}
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

    /// Gives a step that still is at `version` the name of `edit`, if that is all in which they differ; says whether it
    /// did. Tokens and pictures stay.
    pub fn rename(&mut self, (id, version): (NodeId, u32), edit: &EditForm) -> bool {
        let node = self.nodes.get_mut(&id).filter(|n| n.version == version);
        let same = |n: &&mut Node| n.edit.as_ref().is_some_and(|e| e.lights_as(edit));
        let Some(node) = node.filter(same) else {
            return false;
        };
        node.edit = Some(edit.clone());
        node.version += 1;
        self.latest = id;
        true
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
            self.forget_on(before.iter().map(|n| n.id).collect());
            self.nodes.extend(after.into_iter().map(|n| (n.id, n)));
        }
        kept && same
    }

    /// Forgets what was taken away from changed steps: it was made from tokens that are gone.
    fn forget_on(&mut self, mut changed: HashSet<NodeId>) {
        // A removal can stand on what a later one took away, never the other way round.
        for i in (0..self.removed.len()).rev() {
            let stood_on = self.removed[i].first().and_then(|n| n.parent);
            if stood_on.is_some_and(|parent| changed.contains(&parent)) {
                let gone = self.removed.remove(i).unwrap_or_default();
                changed.extend(gone.iter().map(|n| n.id));
            }
        }
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
        let removed = gone.iter().filter_map(|id| self.nodes.remove(id)).collect();
        self.removed.push_back(removed);
        if self.removed.len() > REMOVALS {
            self.removed.pop_front();
        }
        self.latest = parent;
        Ok(gone.len())
    }

    /// Brings a removed step back, with everything that was removed together with it.
    ///
    /// # Errors
    /// If no removal of that step is kept, or the step it stood on is gone too.
    pub fn restore(&mut self, id: NodeId) -> Result<()> {
        let removal = |r: &Vec<Node>| r.first().is_some_and(|n| n.id == id);
        let Some(i) = self.removed.iter().position(removal) else {
            let text = format!("node {id}: there is no removal of this step to take back");
            return Err(Error::Conflict(text));
        };
        let stood_on = self.removed[i].first().and_then(|n| n.parent);
        if let Some(parent) = stood_on.filter(|p| !self.nodes.contains_key(p)) {
            let text = format!("node {id}: step {parent}, on which it stood, is gone too");
            return Err(Error::Conflict(text));
        }
        for node in self.removed.remove(i).unwrap_or_default() {
            self.nodes.insert(node.id, node);
        }
        self.latest = id;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use burn::tensor::Device;
    use lumi_core::{Seed, Similarity};
    use lumi_model::{Mode, ModelConfig, Relighter, SceneFrame};

    /// A tree with room for `most` steps, and what adds a step to it.
    fn tree(most: usize) -> (Tree, impl Fn(&mut Tree, NodeId) -> Result<NodeId>) {
        let config = ModelConfig::preset("nano").expect("nano");
        let model = Relighter::random(&config, Seed(1), &Device::flex());
        let tokens = move || {
            let values = vec![0.0; config.scene_tokens * config.dim];
            let frame = SceneFrame {
                to_model: Similarity::IDENTITY,
                authors: None,
                views: Vec::new(),
                exposure: lumi_model::Exposure::default(),
            };
            let tokens = model.captured_from_values(values, frame, None, Vec::new());
            tokens.expect("tokens")
        };
        let tree = Tree::new(tokens(), 0.0, TOKEN_BYTES / most);
        let add = move |tree: &mut Tree, parent| {
            let on = Arc::clone(&tree.get(parent)?.tokens);
            let edit = EditForm {
                name: None,
                mode: Mode::Add,
                lights: Vec::new(),
            };
            let made = tree.add((parent, &on), edit, tokens(), 0.0)?;
            Ok(made.expect("nobody else changes the tree"))
        };
        (tree, add)
    }

    fn ids(tree: &Tree) -> Vec<NodeId> {
        tree.nodes().map(|n| n.id).collect()
    }

    #[test]
    fn every_removal_can_be_taken_back() {
        let (mut tree, add) = tree(100);
        for parent in [0, 1, 2, 0] {
            add(&mut tree, parent).expect("room");
        }
        for (id, count) in [(3, 1), (4, 1), (1, 2)] {
            assert_eq!(tree.remove(id).expect("there"), count);
        }
        assert_eq!((ids(&tree), tree.removed()), (vec![0], 4));
        // What was built on a removed step waits for it; another branch does not.
        let early = tree.restore(3).expect_err("its step is gone");
        assert!(early.to_string().contains("step 2"), "{early}");
        for id in [4, 1, 3] {
            tree.restore(id).expect("kept");
        }
        assert_eq!((ids(&tree), tree.removed()), (vec![0, 1, 2, 3, 4], 0));
        tree.restore(3).expect_err("taken back already");
    }

    #[test]
    fn what_stood_on_a_changed_step_is_forgotten() {
        let (mut tree, add) = tree(100);
        for parent in [0, 1, 2, 0] {
            add(&mut tree, parent).expect("room");
        }
        for id in [3, 2, 4] {
            tree.remove(id).expect("there");
        }
        let on = Arc::clone(&tree.get(0).expect("root").tokens);
        let before = tree.changeable(1, 0).expect("as it was");
        let after = before.clone();
        assert!(tree.replace(&on, &before, after));
        for id in [2, 3] {
            tree.restore(id)
                .expect_err("made from tokens that are gone");
        }
        tree.restore(4).expect("another branch");
    }

    #[test]
    fn another_name_leaves_the_tokens() {
        let (mut tree, add) = tree(100);
        let id = add(&mut tree, 0).expect("room");
        let before = tree.get(id).expect("there").clone();
        let mut named = before.edit.clone().expect("an edit");
        named.name = Some("Key".into());
        assert!(tree.rename((id, 0), &named));
        assert!(!tree.rename((id, 0), &named), "of an older version");
        assert!(!tree.rename((0, 0), &named), "the capture has no name");
        let after = tree.get(id).expect("there");
        assert!(Arc::ptr_eq(&after.tokens, &before.tokens));
        assert_eq!((after.version, &after.edit), (1, &Some(named.clone())));
        named.mode = Mode::Set;
        assert!(!tree.rename((id, 1), &named), "more than a name");
    }

    #[test]
    fn removed_steps_make_room_the_oldest_first() {
        let (mut tree, add) = tree(4);
        for _ in 0..3 {
            add(&mut tree, 0).expect("room");
        }
        let full = add(&mut tree, 0).expect_err("full");
        assert!(full.to_string().contains("4 steps"), "{full}");
        for id in [1, 2] {
            tree.remove(id).expect("there");
        }
        assert_eq!(add(&mut tree, 0).expect("room"), 4);
        tree.restore(1).expect_err("forgotten");
        tree.restore(2).expect("kept");
        assert_eq!(ids(&tree), [0, 2, 3, 4]);
    }
}
