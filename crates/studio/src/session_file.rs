//! A session in one safetensors file: `tokens.ID` of every step, `input.I` pictures, `map.ID` radiance, and the rest
//! as JSON in the metadata. The fingerprint of the weights goes with it, since tokens mean nothing to others.

use crate::camera::OrbitCamera;
use crate::engine::Engine;
use crate::form::EditForm;
use crate::limits::{INPUTS, NODES, SESSION_BYTES};
use crate::maps::Maps;
use crate::session::{Capture, InputView, Session, Source};
use crate::tree::{Node, NodeId, Tree};
use crate::{Error, Result};
use lumi_core::light::LightRay;
use lumi_core::{Camera, DisplayImage, EnvMap, Similarity};
use lumi_model::{Illumination, SceneFrame};
use safetensors::tensor::{Dtype, SafeTensors, TensorView};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, HashMap};
use std::io::Read;
use std::path::Path;
use std::sync::Arc;

/// Version of the layout.
const FORMAT: &str = "lumitokens-session-2";
/// Name of the photographs that the decoder is given, for models with `reprojection`.
const PHOTOGRAPHS: &str = "photographs";
/// Key of the header in the file's metadata.
const KEY: &str = "lumitokens.session";

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Header {
    format: String,
    model: String,
    name: String,
    source: Source,
    to_model: Similarity,
    /// Where the tokens of all steps live.
    frame: SceneFrame,
    camera: OrbitCamera,
    inputs: Vec<InputRecord>,
    maps: BTreeMap<String, String>,
    nodes: Vec<NodeRecord>,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct InputRecord {
    name: String,
    camera: Camera,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct NodeRecord {
    id: NodeId,
    parent: Option<NodeId>,
    edit: Option<EditForm>,
    illumination: Illumination,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    lights: Vec<LightRay>,
    seconds: f32,
}

/// What can be said of a file without reading its tensors.
#[derive(Serialize, JsonSchema)]
pub struct Summary {
    /// Name of the scene.
    pub name: String,
    /// Steps, the capture included.
    pub steps: usize,
    /// Fingerprint of the model that made it.
    pub model: String,
}

/// The file of a session.
///
/// # Errors
/// If it cannot be put together.
pub fn encode(session: &Session, engine: &Engine, maps: &Maps) -> Result<Vec<u8>> {
    let nodes: Vec<Node> = session.tree().nodes().cloned().collect();
    let capture = &session.capture;
    let mut used = BTreeMap::new();
    for light in nodes
        .iter()
        .flat_map(|n| n.edit.iter().flat_map(|e| &e.lights))
    {
        if let Some(id) = light.map() {
            used.insert(id.to_owned(), maps.get(id)?);
        }
    }
    let first = nodes.first();
    let first = first.ok_or_else(|| Error::Internal("a session without its capture".into()))?;
    let header = Header {
        format: FORMAT.into(),
        model: engine.model().fingerprint.clone(),
        name: capture.name.clone(),
        source: capture.source.clone(),
        to_model: capture.to_model,
        frame: first.tokens.frame().clone(),
        camera: capture.camera,
        inputs: capture
            .inputs
            .iter()
            .map(|v| InputRecord {
                name: v.name.clone(),
                camera: v.camera,
            })
            .collect(),
        maps: used
            .iter()
            .map(|(id, m)| (id.clone(), m.name.clone()))
            .collect(),
        nodes: nodes
            .iter()
            .map(|n| NodeRecord {
                id: n.id,
                parent: n.parent,
                edit: n.edit.clone(),
                illumination: n.tokens.illumination,
                lights: n.tokens.lights().to_vec(),
                seconds: n.seconds,
            })
            .collect(),
    };
    let floats = |v: &[f32]| v.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>();
    let mut parts: Vec<(String, Dtype, Vec<usize>, Vec<u8>)> = Vec::new();
    for node in &nodes {
        let values = engine.model().token_values(&node.tokens);
        let d = engine.model().config.dim;
        let shape = vec![values.len() / d, d];
        parts.push((
            format!("tokens.{}", node.id),
            Dtype::F32,
            shape,
            floats(&values),
        ));
    }
    if let Some(photographs) = first.tokens.photographs() {
        let values = photographs.values();
        let shape = vec![values.len() / 4, 4];
        parts.push((PHOTOGRAPHS.into(), Dtype::F32, shape, floats(&values)));
    }
    for (i, view) in capture.inputs.iter().enumerate() {
        let shape = vec![view.image.height, view.image.width, 3];
        parts.push((
            format!("input.{i}"),
            Dtype::U8,
            shape,
            view.image.to_bytes(),
        ));
    }
    for (id, entry) in &used {
        let shape = vec![entry.map.height, entry.map.width, 3];
        let bytes = floats(entry.map.pixels.as_flattened());
        parts.push((format!("map.{id}"), Dtype::F32, shape, bytes));
    }
    let failed = |e: String| Error::Internal(format!("session file: {e}"));
    let views = parts.iter().map(|(name, dtype, shape, bytes)| {
        let view = TensorView::new(*dtype, shape.clone(), bytes);
        view.map(|v| (name.clone(), v))
            .map_err(|e| failed(e.to_string()))
    });
    let views = views.collect::<Result<Vec<_>>>()?;
    let text = serde_json::to_string(&header).map_err(|e| failed(e.to_string()))?;
    let metadata = HashMap::from([(KEY.to_owned(), text)]);
    safetensors::serialize(views, Some(metadata)).map_err(|e| failed(e.to_string()))
}

/// The session called `id` out of its file.
///
/// # Errors
/// Names what is wrong with the file; a session of another model is a conflict.
pub fn decode(id: String, bytes: &[u8], engine: &Engine, maps: &Maps) -> Result<Arc<Session>> {
    if bytes.len() > SESSION_BYTES {
        let text = format!("session file: expected at most {} MiB", SESSION_BYTES >> 20);
        return Err(Error::TooLarge(text));
    }
    let header = header(bytes)?;
    let model = engine.model();
    if header.model != model.fingerprint {
        let text = format!(
            "session file: it was made with model {}; this is model {}, to which its tokens mean nothing",
            header.model, model.fingerprint
        );
        return Err(Error::Conflict(text));
    }
    if header.nodes.len() > NODES || header.inputs.len() > INPUTS {
        return Err(wrong("expected fewer steps or input views"));
    }
    let tensors = SafeTensors::deserialize(bytes).map_err(|e| wrong(&e.to_string()))?;
    let renamed = read_maps(&header, &tensors, maps)?;
    let mut nodes: Vec<Node> = Vec::with_capacity(header.nodes.len());
    for record in header.nodes {
        let name = format!("tokens.{}", record.id);
        let (_, values) = floats(&tensors, &name)?;
        let tokens = match nodes.first() {
            None => {
                let photographs = match tensors.tensor(PHOTOGRAPHS) {
                    Ok(_) => Some(floats(&tensors, PHOTOGRAPHS)?.1),
                    Err(_) => None,
                };
                let frame = header.frame.clone();
                model.captured_from_values(values, frame, photographs.as_deref(), Vec::new())
            }
            Some(Node { tokens, .. }) => {
                let (illumination, lights) = (record.illumination, record.lights);
                model.edited_from_values(tokens, values, illumination, lights, Vec::new())
            }
        };
        let mut edit = record.edit;
        for light in edit.iter_mut().flat_map(|e| &mut e.lights) {
            if let lumi_core::light::LightSource::Environment(light) = light {
                let known = renamed.get(&light.map).ok_or_else(|| {
                    let id = &light.map;
                    wrong(&format!("map.{id}: expected the map that a light uses"))
                })?;
                known.clone_into(&mut light.map);
            }
        }
        nodes.push(Node {
            id: record.id,
            parent: record.parent,
            edit,
            tokens: Arc::new(tokens.map_err(|e| wrong(&format!("{name}: {e}")))?),
            seconds: record.seconds,
            version: 0,
            thumbnail: Arc::default(),
        });
    }
    let capture = Capture {
        name: header.name.chars().take(200).collect(),
        source: header.source,
        to_model: header.to_model,
        camera: header.camera,
        inputs: read_inputs(header.inputs, &tensors)?,
    };
    capture.check()?;
    let bytes = nodes.iter().map(|n| n.tokens.bytes()).max();
    let tree = Tree::from_nodes(nodes, bytes.unwrap_or_default())?;
    Ok(Session::new(id, capture, tree))
}

/// Reads no more of a file than its header.
///
/// # Errors
/// If it is no session file.
pub fn summary(path: &Path) -> Result<Summary> {
    let io = |e: std::io::Error| Error::Invalid(format!("{}: {e}", path.display()));
    let mut file = std::fs::File::open(path).map_err(io)?;
    let mut length = [0; 8];
    file.read_exact(&mut length).map_err(io)?;
    let length = u64::from_le_bytes(length);
    let mut bytes = Vec::new();
    bytes.extend(length.to_le_bytes());
    // A false length reads to the end of the file, no further.
    file.take(length.min(1 << 26))
        .read_to_end(&mut bytes)
        .map_err(io)?;
    let header = header(&bytes)?;
    Ok(Summary {
        name: header.name,
        steps: header.nodes.len(),
        model: header.model,
    })
}

fn wrong(what: &str) -> Error {
    Error::Invalid(format!("session file: {what}"))
}

/// The header out of the first bytes of a file: its length, then JSON. The tensors need not be there yet.
fn header(bytes: &[u8]) -> Result<Header> {
    #[derive(Deserialize)]
    struct Listing {
        #[serde(rename = "__metadata__")]
        metadata: HashMap<String, String>,
    }
    let foreign = || wrong("expected a session saved by the studio");
    let (length, rest) = bytes.split_first_chunk::<8>().ok_or_else(foreign)?;
    let length = usize::try_from(u64::from_le_bytes(*length)).map_err(|_| foreign())?;
    let listing = rest.get(..length).ok_or_else(foreign)?;
    let listing: Listing = serde_json::from_slice(listing).map_err(|_| foreign())?;
    let text = listing.metadata.get(KEY).ok_or_else(foreign)?;
    let header: Header = serde_json::from_str(text).map_err(|e| wrong(&e.to_string()))?;
    if header.format != FORMAT {
        return Err(wrong(&format!(
            "expected format {FORMAT}, found {}",
            header.format
        )));
    }
    Ok(header)
}

/// Registers the file's maps; from their ids in the file to those they have here.
fn read_maps(
    header: &Header,
    tensors: &SafeTensors,
    maps: &Maps,
) -> Result<HashMap<String, String>> {
    let read = |(id, name): (&String, &String)| {
        let field = format!("map.{id}");
        let (shape, values) = floats(tensors, &field)?;
        let &[height, width, 3] = shape.as_slice() else {
            return Err(wrong(&format!("{field}: expected [height, width, 3]")));
        };
        let map = EnvMap {
            width,
            height,
            pixels: values.as_chunks::<3>().0.to_vec(),
        };
        map.validate()
            .map_err(|e| wrong(&format!("{field}: {e}")))?;
        Ok((id.clone(), maps.insert(name, &map, None)?))
    };
    header.maps.iter().map(read).collect()
}

fn read_inputs(records: Vec<InputRecord>, tensors: &SafeTensors) -> Result<Vec<InputView>> {
    let read = |(i, record): (usize, InputRecord)| {
        let name = format!("input.{i}");
        let tensor = tensors.tensor(&name).map_err(|e| wrong(&e.to_string()))?;
        let (shape, dtype) = (tensor.shape(), tensor.dtype());
        let &[height, width, 3] = shape else {
            return Err(wrong(&format!("{name}: expected [height, width, 3]")));
        };
        if dtype != Dtype::U8 || width == 0 || height == 0 {
            return Err(wrong(&format!("{name}: expected bytes")));
        }
        let pixels = tensor.data().as_chunks::<3>().0;
        Ok(InputView {
            name: record.name,
            camera: record.camera,
            image: DisplayImage {
                width,
                height,
                pixels: pixels
                    .iter()
                    .map(|p| p.map(|v| f32::from(v) / 255.0))
                    .collect(),
                alpha: None,
            },
        })
    };
    records.into_iter().enumerate().map(read).collect()
}

fn floats(tensors: &SafeTensors, name: &str) -> Result<(Vec<usize>, Vec<f32>)> {
    let tensor = tensors.tensor(name).map_err(|e| wrong(&e.to_string()))?;
    if tensor.dtype() != Dtype::F32 {
        return Err(wrong(&format!("{name}: expected 32-bit floats")));
    }
    let chunks = tensor.data().as_chunks::<4>().0;
    let values = chunks.iter().map(|b| f32::from_le_bytes(*b)).collect();
    Ok((tensor.shape().to_vec(), values))
}
