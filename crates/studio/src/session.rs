//! A session: a capture, its scene tokens and the tree of edits.

use crate::camera::OrbitCamera;
use crate::engine::Engine;
use crate::form::EditForm;
use crate::look::Look;
use crate::maps::Maps;
use crate::reply::NodeView;
use crate::tree::{Node, NodeId, Tree};
use crate::{Error, Result};
use lumi_core::{Camera, DisplayImage, Similarity};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use tokio::sync::watch;

/// How often an edit is made again because what it stands on has changed.
const ATTEMPTS: usize = 8;

/// Where a session's capture came from, for the command line that repeats it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Source {
    /// Folder of the capture on the server's machine; `None` for an upload.
    pub path: Option<String>,
    /// How many input views were asked for.
    pub inputs: usize,
    /// The light that the inputs were composed under, where it was chosen.
    pub light: Option<String>,
}

/// A view that the scene was encoded from.
#[derive(Clone)]
pub struct InputView {
    /// Its name.
    pub name: String,
    /// World-space camera.
    pub camera: Camera,
    /// The picture, at the model's size.
    pub image: DisplayImage,
}

/// What does not change in a session.
#[derive(Clone)]
pub struct Capture {
    /// Name of the scene.
    pub name: String,
    /// Where it came from.
    pub source: Source,
    /// World to model space.
    pub to_model: Similarity,
    /// Where the camera begins.
    pub camera: OrbitCamera,
    /// The encoded views.
    pub inputs: Vec<InputView>,
}

/// A session that can be shared between requests.
pub struct Session {
    /// Its id.
    pub id: String,
    /// Drawn anew whenever the session is read from its file, which holds no versions: with it, a step's number and
    /// version name one picture for good.
    pub opened: u32,
    /// The capture.
    pub capture: Capture,
    tree: Mutex<Tree>,
    /// Counts changes; pages watch it.
    revision: watch::Sender<u64>,
}

impl Session {
    /// A session of a tree.
    #[must_use]
    pub fn new(id: String, capture: Capture, tree: Tree) -> Arc<Self> {
        Arc::new(Self {
            id,
            opened: rand::random(),
            capture,
            tree: Mutex::new(tree),
            revision: watch::Sender::new(0),
        })
    }

    /// The tree, for as long as the guard lives; never across an `await`.
    pub fn tree(&self) -> MutexGuard<'_, Tree> {
        self.tree.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Number of changes since the session was opened.
    #[must_use]
    pub fn revision(&self) -> u64 {
        *self.revision.borrow()
    }

    /// Tells of every change from now on.
    #[must_use]
    pub fn watch(&self) -> watch::Receiver<u64> {
        self.revision.subscribe()
    }

    /// Makes a new step after `parent`. If somebody changes the parent meanwhile, the edit is made again.
    ///
    /// # Errors
    /// On a bad edit, an unknown parent and a full session.
    pub async fn add(
        &self,
        engine: &Arc<Engine>,
        maps: &Maps,
        parent: NodeId,
        form: EditForm,
    ) -> Result<NodeView> {
        let edit = form.edit(maps)?;
        for _ in 0..ATTEMPTS {
            let on = {
                let tree = self.tree();
                tree.check_room()?;
                Arc::clone(&tree.get(parent)?.tokens)
            };
            let (tokens, seconds) = engine.edit(Arc::clone(&on), edit.clone()).await?;
            let made = self
                .tree()
                .add((parent, &on), form.clone(), tokens, seconds)?;
            if let Some(id) = made {
                self.changed();
                return self.view(id);
            }
        }
        Err(restless())
    }

    /// Changes a step that still is at `version`, and makes what was built on it anew; another name makes nothing anew.
    ///
    /// # Errors
    /// On a bad edit, and if the step was changed meanwhile.
    pub async fn change(
        &self,
        engine: &Arc<Engine>,
        maps: &Maps,
        (id, version): (NodeId, u32),
        form: EditForm,
    ) -> Result<NodeView> {
        form.edit(maps)?;
        let renamed = self.tree().rename((id, version), &form);
        if renamed {
            self.changed();
            return self.view(id);
        }
        for _ in 0..ATTEMPTS {
            let (on, before) = {
                let tree = self.tree();
                let before = tree.changeable(id, version)?;
                let parent = before[0].parent.unwrap_or(0);
                (Arc::clone(&tree.get(parent)?.tokens), before)
            };
            let mut after: Vec<Node> = Vec::with_capacity(before.len());
            for node in &before {
                let made = after.iter().find(|n| Some(n.id) == node.parent);
                let from = Arc::clone(made.map_or(&on, |n| &n.tokens));
                let edit = if node.id == id {
                    Some(&form)
                } else {
                    node.edit.as_ref()
                };
                let Some(edit) = edit else { continue };
                let (tokens, seconds) = engine.edit(from, edit.edit(maps)?).await?;
                after.push(Node {
                    edit: Some(edit.clone()),
                    tokens: Arc::new(tokens),
                    seconds,
                    version: node.version + 1,
                    thumbnail: Arc::default(),
                    ..node.clone()
                });
            }
            if self.tree().replace(&on, &before, after) {
                self.changed();
                return self.view(id);
            }
        }
        Err(restless())
    }

    /// Removes a step and all that was built on it; returns how many.
    ///
    /// # Errors
    /// If there is no such step, or it is the capture itself.
    pub fn remove(&self, id: NodeId) -> Result<usize> {
        let count = self.tree().remove(id)?;
        self.changed();
        Ok(count)
    }

    /// Brings a removed step back, with what was removed together with it.
    ///
    /// # Errors
    /// If there is no such removal, or the step it stood on is gone too.
    pub fn restore(&self, id: NodeId) -> Result<()> {
        self.tree().restore(id)?;
        self.changed();
        Ok(())
    }

    /// A small picture of a step from the capture's first camera, as PNG.
    ///
    /// # Errors
    /// If there is no such step.
    pub async fn thumbnail(&self, engine: &Arc<Engine>, id: NodeId) -> Result<Vec<u8>> {
        let (cell, tokens) = {
            let tree = self.tree();
            let node = tree.get(id)?;
            (Arc::clone(&node.thumbnail), Arc::clone(&node.tokens))
        };
        if let Some(png) = cell.get() {
            return Ok(png.clone());
        }
        let capture = &self.capture;
        let frame = engine
            .render(
                tokens,
                &capture.to_model,
                capture.camera,
                engine.side(),
                Look::default(),
            )
            .await?;
        let larger = lumi_core::image::enlarged(&frame.image, 128.max(frame.image.width.min(256)));
        let png = lumi_core::image::encode_png(&larger)?;
        Ok(cell.get_or_init(|| png).clone())
    }

    fn view(&self, id: NodeId) -> Result<NodeView> {
        // Somebody may have removed it between two locks: then it is gone, which is what they wanted.
        Ok(NodeView::from(self.tree().get(id)?))
    }

    fn changed(&self) {
        self.revision.send_modify(|r| *r += 1);
    }
}

fn restless() -> Error {
    Error::Conflict("this part of the history keeps changing: try again".into())
}

impl Capture {
    /// Refuses what a file could not hold.
    ///
    /// # Errors
    /// Names the field.
    pub fn check(&self) -> Result<()> {
        let wrong = |field: &str, expected: &str| {
            Err(Error::Invalid(format!("session file: {field}: {expected}")))
        };
        let s = &self.to_model;
        let finite = s.scale.is_finite() && s.translation.is_finite() && s.rotation.is_finite();
        if !finite || s.scale <= 0.0 {
            return wrong("to_model", "expected a similarity of finite numbers");
        }
        self.camera.camera(s, 16)?;
        for view in &self.inputs {
            view.camera.validate()?;
        }
        Ok(())
    }
}
