//! What the server answers with: the JSON of each route, which is also its schema.

use crate::camera::OrbitCamera;
use crate::engine::Engine;
use crate::form::{self, EditForm};
use crate::maps::MapInfo;
use crate::session::{Session, Source};
use crate::sessions::Listed;
use crate::tree::{Node, NodeId};
use crate::upload::Checked;
use lumi_core::Similarity;
use lumi_model::{Exposure, Mode};
use schemars::JsonSchema;
use serde::Serialize;

/// An answer with a status of 4xx or 5xx.
#[derive(Serialize, JsonSchema)]
#[schemars(rename = "Error")]
pub struct Failed {
    /// What is wrong, for people.
    pub error: String,
}

/// What the studio is.
#[derive(Serialize, JsonSchema)]
#[schemars(rename = "Studio")]
pub struct StudioInfo {
    version: &'static str,
    model: ModelInfo,
    modes: Vec<ModeInfo>,
    /// The session that a page opens first.
    opening: Option<String>,
}

/// The model at hand.
#[derive(Serialize, JsonSchema)]
#[schemars(rename = "Model")]
struct ModelInfo {
    fingerprint: String,
    /// Side of a full picture in pixels.
    resolution: usize,
    /// Where its weights come from.
    origin: String,
}

/// What edits may do.
#[derive(Serialize, JsonSchema)]
#[schemars(rename = "Mode")]
struct ModeInfo {
    #[schemars(schema_with = "form::modes")]
    mode: Mode,
    available: bool,
    /// Why it is not available.
    reason: Option<&'static str>,
}

impl StudioInfo {
    /// Of an engine.
    pub fn new(engine: &Engine, opening: Option<String>) -> Self {
        let model = engine.model();
        let modes = Mode::ALL.map(|mode| {
            let available = engine.knows(mode);
            ModeInfo {
                mode,
                available,
                reason: (!available).then_some("This model was not trained to do this."),
            }
        });
        Self {
            version: env!("CARGO_PKG_VERSION"),
            model: ModelInfo {
                fingerprint: model.fingerprint.clone(),
                resolution: model.side(),
                origin: model.provenance.origin.clone(),
            },
            modes: modes.into(),
            opening,
        }
    }
}

/// All environment maps, in the order in which they came.
#[derive(Serialize, JsonSchema)]
pub struct MapList {
    pub maps: Vec<MapInfo>,
}

/// A map that is there now.
#[derive(Serialize, JsonSchema)]
pub struct AddedMap {
    pub id: String,
    /// What had to be assumed of it.
    pub warnings: Vec<String>,
}

/// A capture that was received.
#[derive(Serialize, JsonSchema)]
pub struct Uploaded {
    pub id: String,
    pub check: Checked,
}

/// Done, and nothing to say of it.
#[derive(Serialize, JsonSchema)]
pub struct Done {}

/// All sessions, newest first.
#[derive(Serialize, JsonSchema)]
pub struct SessionList {
    pub sessions: Vec<Listed>,
}

/// A step that is there again.
#[derive(Serialize, JsonSchema)]
pub struct Restored {
    pub node: NodeId,
}

/// How many steps went.
#[derive(Serialize, JsonSchema)]
pub struct Removed {
    pub removed: usize,
}

/// A command line for a POSIX shell.
#[derive(Serialize, JsonSchema)]
pub struct Command {
    pub command: String,
}

/// A step of a session.
#[derive(Serialize, JsonSchema)]
#[schemars(rename = "Node")]
pub struct NodeView {
    id: NodeId,
    /// The step that it stands on; none for the capture.
    parent: Option<NodeId>,
    edit: Option<EditForm>,
    /// How long the model took.
    seconds: f32,
    /// Counts the changes of this step since the session was `opened`.
    version: u32,
}

impl From<&Node> for NodeView {
    fn from(node: &Node) -> Self {
        Self {
            id: node.id,
            parent: node.parent,
            edit: node.edit.clone(),
            seconds: node.seconds,
            version: node.version,
        }
    }
}

/// A whole session.
#[derive(Serialize, JsonSchema)]
#[schemars(rename = "Session")]
pub struct SessionView {
    id: String,
    /// Drawn anew whenever the server reads the session from its file: with it, a step's number and version name one picture for
    /// good.
    opened: u32,
    /// Name of the scene.
    name: String,
    source: Source,
    /// World to model space.
    to_model: Similarity,
    /// What light is multiplied with, per channel, to come out as the photographs' camera has shown it; 1 where the captured light
    /// is not known.
    #[schemars(with = "[f64; 3]")]
    exposure: Exposure,
    /// Where the camera begins.
    camera: OrbitCamera,
    /// The views that the scene was encoded from.
    inputs: Vec<InputInfo>,
    nodes: Vec<NodeView>,
    /// The step that was made or changed last.
    latest: NodeId,
    /// Removed steps that can be brought back.
    removed: usize,
    /// Counts all changes since the session was `opened`.
    revision: u64,
}

/// A view that a scene was encoded from.
#[derive(Serialize, JsonSchema)]
#[schemars(rename = "Input")]
struct InputInfo {
    name: String,
    camera: OrbitCamera,
}

impl From<&Session> for SessionView {
    fn from(session: &Session) -> Self {
        let capture = &session.capture;
        let inputs = capture.inputs.iter().map(|view| InputInfo {
            name: view.name.clone(),
            camera: OrbitCamera::from_camera(&view.camera, &capture.to_model),
        });
        let tree = session.tree();
        let exposure = tree.get(0).map(|root| root.tokens.frame().exposure);
        Self {
            id: session.id.clone(),
            opened: session.opened,
            name: capture.name.clone(),
            source: capture.source.clone(),
            to_model: capture.to_model,
            exposure: exposure.unwrap_or_default(),
            camera: capture.camera,
            inputs: inputs.collect(),
            nodes: tree.nodes().map(NodeView::from).collect(),
            latest: tree.latest(),
            removed: tree.removed(),
            revision: session.revision(),
        }
    }
}
