//! Rendering over a WebSocket: the newest request is answered, older ones are dropped, never queued.

use crate::camera::OrbitCamera;
use crate::engine::{Engine, Frame};
use crate::form::EditForm;
use crate::limits::{DRAFT, DRAFT_BYTES, MESSAGE_BYTES};
use crate::look::{Look, cut_out};
use crate::maps::Maps;
use crate::session::Session;
use crate::tree::NodeId;
use crate::{Error, Result};
use axum::extract::ws::{Message, WebSocket};
use futures_util::stream::SplitSink;
use futures_util::{SinkExt, StreamExt};
use lumi_model::SceneTokens;
use serde::{Deserialize, Serialize};
use serde_json::json;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::watch;
use tokio::time::timeout;

/// A page that does not take a frame for this long is gone.
const PATIENCE: Duration = Duration::from_secs(20);

/// What a page asks for.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Request {
    /// Chosen by the page; comes back with the frames.
    id: u64,
    /// The step to show.
    node: NodeId,
    /// Edits to try out after that step, without keeping them.
    #[serde(default)]
    draft: Vec<EditForm>,
    /// Another step, to be shown beside it.
    compare: Option<NodeId>,
    /// Where from.
    camera: OrbitCamera,
    /// How it is shown.
    #[serde(default)]
    look: Look,
    /// Whether more requests are about to come, so that a quick frame will do.
    #[serde(default)]
    moving: bool,
}

/// What stands before the pixels of a frame.
#[derive(Serialize)]
struct Header {
    id: u64,
    width: usize,
    height: usize,
    /// Pictures, one after the other: the step, and the one to compare with.
    panes: usize,
    quality: &'static str,
    edit_ms: f32,
    render_ms: f32,
}

/// The last draft with the tokens after each edit: a camera that moves around it does not edit again.
struct Draft {
    node: NodeId,
    version: u32,
    steps: Vec<Step>,
}

/// An edit of a draft, and the scene after it unless [`forget_early`] dropped that.
struct Step {
    form: EditForm,
    tokens: Option<Arc<SceneTokens>>,
}

/// Drops tokens before the last ones that together fit `budget` bytes: what a page changes is mostly its last edits, and
/// the others can be made again. The very last are kept whatever their size.
fn forget_early(steps: &mut [Step], budget: usize) {
    let mut bytes = 0;
    for (i, step) in steps.iter_mut().rev().enumerate() {
        bytes += step.tokens.as_ref().map_or(0, |tokens| tokens.bytes());
        if i > 0 && bytes > budget {
            step.tokens = None;
        }
    }
}

/// Answers one page until it leaves.
pub async fn serve(socket: WebSocket, engine: Arc<Engine>, maps: Arc<Maps>, session: Arc<Session>) {
    let (sink, mut stream) = socket.split();
    let (newest, requests) = watch::channel(None);
    let page = Page {
        engine,
        maps,
        changes: session.watch(),
        session,
        requests,
        sink,
        draft: None,
    };
    let answering = tokio::spawn(page.answer());
    while let Some(Ok(message)) = stream.next().await {
        match message {
            Message::Text(text) if text.len() <= MESSAGE_BYTES => {
                let parsed = serde_json::from_str::<Request>(&text).map_err(|e| e.to_string());
                if newest.send(Some(parsed)).is_err() {
                    break;
                }
            }
            Message::Close(_) => break,
            _ => {}
        }
    }
    // Without a sender the other half ends too.
    drop(newest);
    let _ = answering.await;
}

/// The answering half of a connection.
struct Page {
    engine: Arc<Engine>,
    maps: Arc<Maps>,
    session: Arc<Session>,
    requests: watch::Receiver<Option<std::result::Result<Request, String>>>,
    changes: watch::Receiver<u64>,
    sink: SplitSink<WebSocket, Message>,
    draft: Option<Draft>,
}

impl Page {
    async fn answer(mut self) {
        loop {
            let done = tokio::select! {
                asked = self.requests.changed() => match asked {
                    Ok(()) => self.request().await,
                    Err(_) => return,
                },
                changed = self.changes.changed() => match changed {
                    Ok(()) => {
                        let revision = *self.changes.borrow_and_update();
                        self.say(&json!({"type": "changed", "revision": revision})).await
                    }
                    Err(_) => return,
                },
            };
            if done.is_err() {
                return;
            }
        }
    }

    /// Answers the newest request; an error here means that the page is gone.
    async fn request(&mut self) -> std::result::Result<(), ()> {
        let newest = self.requests.borrow_and_update().clone();
        match newest {
            None => Ok(()),
            Some(Err(e)) => {
                let error = format!("expected a request as docs/studio.md says: {e}");
                self.say(&json!({"type": "error", "id": null, "error": error}))
                    .await
            }
            Some(Ok(request)) => match self.frames(&request).await {
                Ok(sent) => sent,
                Err(e) => {
                    let error = e.to_string();
                    self.say(&json!({"type": "error", "id": request.id, "error": error}))
                        .await
                }
            },
        }
    }

    /// A quick frame where full ones are slow, and a full one unless a newer request has come.
    async fn frames(&mut self, request: &Request) -> Result<std::result::Result<(), ()>> {
        request.look.check()?;
        let (tokens, edit_ms) = self.tokens(request).await?;
        let mut steps = vec![tokens];
        if let Some(other) = request.compare {
            steps.push(Arc::clone(&self.session.tree().get(other)?.tokens));
        }
        let quick = self.engine.quick_side();
        let full = Some(self.engine.side()).filter(|_| !request.moving || quick.is_none());
        let sides = [(quick, "quick"), (full, "full")];
        for (side, quality) in sides.into_iter().filter_map(|(s, q)| Some((s?, q))) {
            let mut panes = Vec::new();
            for tokens in &steps {
                let to_model = &self.session.capture.to_model;
                let tokens = Arc::clone(tokens);
                let frame =
                    self.engine
                        .render(tokens, to_model, request.camera, side, request.look);
                panes.push(frame.await?);
            }
            let sent = self.send(request.id, &panes, quality, edit_ms).await;
            let stale = self.requests.has_changed().unwrap_or(true);
            if sent.is_err() || stale {
                return Ok(sent);
            }
        }
        Ok(Ok(()))
    }

    /// The tokens to show, and the milliseconds that a draft took.
    async fn tokens(&mut self, request: &Request) -> Result<(Arc<SceneTokens>, f32)> {
        let (base, version) = {
            let tree = self.session.tree();
            let node = tree.get(request.node)?;
            (Arc::clone(&node.tokens), node.version)
        };
        if request.draft.len() > DRAFT {
            let text = format!("draft: expected at most {DRAFT} edits");
            return Err(Error::TooLarge(text));
        }
        let (node, mut tokens, mut ms) = (request.node, base, 0.0);
        let known = self.draft.take();
        let known = known.filter(|d| (d.node, d.version) == (node, version));
        let mut known = known.map(|d| d.steps).unwrap_or_default();
        let same = known
            .iter()
            .zip(&request.draft)
            .take_while(|(step, asked)| step.form == **asked)
            .count();
        let kept = known[..same].iter().rposition(|step| step.tokens.is_some());
        known.truncate(kept.map_or(0, |last| last + 1));
        if let Some(kept) = known.last().and_then(|step| step.tokens.as_ref()) {
            tokens = Arc::clone(kept);
        }
        for form in &request.draft[known.len()..] {
            let edit = form.edit(&self.maps)?;
            let (after, seconds) = self.engine.edit(tokens, edit).await?;
            tokens = Arc::new(after);
            ms += 1e3 * seconds;
            known.push(Step {
                form: form.clone(),
                tokens: Some(Arc::clone(&tokens)),
            });
            forget_early(&mut known, DRAFT_BYTES);
        }
        self.draft = Some(Draft {
            node,
            version,
            steps: known,
        });
        Ok((tokens, ms))
    }

    async fn send(
        &mut self,
        id: u64,
        panes: &[Frame],
        quality: &'static str,
        edit_ms: f32,
    ) -> std::result::Result<(), ()> {
        let Some(first) = panes.first() else {
            return Ok(());
        };
        let header = Header {
            id,
            width: first.image.width,
            height: first.image.height,
            panes: panes.len(),
            quality,
            edit_ms,
            render_ms: panes.iter().map(|p| p.ms).sum(),
        };
        let header = serde_json::to_vec(&header).map_err(|_| ())?;
        let mut bytes = Vec::from((header.len() as u32).to_le_bytes());
        bytes.extend(header);
        for pane in panes {
            bytes.extend(cut_out(&pane.image));
        }
        self.push(Message::Binary(bytes.into())).await
    }

    async fn say(&mut self, value: &serde_json::Value) -> std::result::Result<(), ()> {
        self.push(Message::Text(value.to_string().into())).await
    }

    async fn push(&mut self, message: Message) -> std::result::Result<(), ()> {
        let sent = timeout(PATIENCE, self.sink.send(message)).await;
        sent.map_err(|_| ())?.map_err(|_| ())
    }
}

/// Refuses one connection too many.
#[must_use]
pub fn full() -> Error {
    Error::Busy("too many pages are connected".into())
}

#[cfg(test)]
mod tests {
    use super::*;
    use burn::tensor::Device;
    use lumi_core::{Seed, Similarity};
    use lumi_model::{Exposure, Mode, ModelConfig, Relighter, SceneFrame};

    #[test]
    fn a_draft_keeps_its_last_tokens_first() {
        let config = ModelConfig::preset("nano").expect("nano");
        let model = Relighter::random(&config, Seed(1), &Device::flex());
        let step = || {
            let values = vec![0.0; config.scene_tokens * config.dim];
            let frame = SceneFrame {
                to_model: Similarity::IDENTITY,
                authors: None,
                views: Vec::new(),
                exposure: Exposure::default(),
            };
            let tokens = model.captured_from_values(values, frame, None, Vec::new());
            Step {
                form: EditForm {
                    name: None,
                    mode: Mode::Add,
                    lights: Vec::new(),
                },
                tokens: tokens.ok().map(Arc::new),
            }
        };
        let bytes = step().tokens.expect("tokens").bytes();
        for (budget, kept) in [(0, 1), (2 * bytes, 2), (3 * bytes - 1, 2), (9 * bytes, 4)] {
            let mut steps: Vec<Step> = (0..4).map(|_| step()).collect();
            forget_early(&mut steps, budget);
            let is_kept: Vec<bool> = steps.iter().map(|s| s.tokens.is_some()).collect();
            let expected: Vec<bool> = (0..4).map(|i| i >= 4 - kept).collect();
            assert_eq!(is_kept, expected, "budget {budget}");
        }
    }
}
