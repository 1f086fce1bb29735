//! Every HTTP route: the table, and a function each. `openapi.json` says the same for others; a test compares them.

use crate::export::{self, Download, PictureQuery, ViewQuery};
use crate::form::EditForm;
use crate::limits::{MAP_BYTES, SESSION_BYTES};
use crate::server::Studio;
use crate::session::Source;
use crate::tree::NodeId;
use crate::{Error, Result, open, page, session_file, sessions, socket};
use axum::Json;
use axum::body::Bytes;
use axum::extract::rejection::{BytesRejection, JsonRejection, QueryRejection};
use axum::extract::{DefaultBodyLimit, Multipart, Path, Query, State, WebSocketUpgrade};
use axum::http::StatusCode;
use axum::http::header::{CACHE_CONTROL, CONTENT_DISPOSITION, CONTENT_TYPE};
use axum::response::{IntoResponse, Response};
use axum::routing::{MethodRouter, any, delete, get, post};
use lumi_model::Mode;
use serde::Deserialize;
use serde_json::{Value, json};
use std::sync::Arc;

type Server = State<Arc<Studio>>;

/// The interface as OpenAPI 3.1.
const OPENAPI: &str = include_str!("../openapi.json");

/// Path, methods and handlers of a route.
type Route = (
    &'static str,
    &'static [&'static str],
    MethodRouter<Arc<Studio>>,
);

/// Every route.
pub fn routes() -> Vec<Route> {
    vec![
        ("/", &["get"], get(index)),
        ("/assets/{file}", &["get"], get(asset)),
        ("/api/openapi.json", &["get"], get(openapi)),
        ("/api/studio", &["get"], get(studio)),
        (
            "/api/maps",
            &["get", "post"],
            get(maps).merge(post(add_map).layer(DefaultBodyLimit::max(MAP_BYTES))),
        ),
        ("/api/maps/{map}/preview", &["get"], get(map_preview)),
        (
            "/api/uploads",
            &["post"],
            post(upload).layer(DefaultBodyLimit::disable()),
        ),
        ("/api/uploads/{upload}", &["delete"], delete(drop_upload)),
        (
            "/api/uploads/{upload}/views/{index}",
            &["get"],
            get(upload_view),
        ),
        (
            "/api/uploads/{upload}/picture",
            &["get"],
            get(upload_picture),
        ),
        ("/api/sessions", &["get", "post"], get(list).post(create)),
        (
            "/api/sessions/load",
            &["post"],
            post(load).layer(DefaultBodyLimit::max(SESSION_BYTES)),
        ),
        (
            "/api/sessions/{session}",
            &["get", "delete"],
            get(session).delete(forget),
        ),
        ("/api/sessions/{session}/file", &["get"], get(save)),
        ("/api/sessions/{session}/socket", &["get"], any(connect)),
        (
            "/api/sessions/{session}/inputs/{index}",
            &["get"],
            get(input),
        ),
        ("/api/sessions/{session}/restore", &["post"], post(restore)),
        ("/api/sessions/{session}/nodes", &["post"], post(add)),
        (
            "/api/sessions/{session}/nodes/{node}",
            &["put", "delete"],
            axum::routing::put(change).delete(remove),
        ),
        (
            "/api/sessions/{session}/nodes/{node}/thumbnail",
            &["get"],
            get(thumbnail),
        ),
        (
            "/api/sessions/{session}/nodes/{node}/picture/{format}",
            &["get"],
            get(picture),
        ),
        (
            "/api/sessions/{session}/nodes/{node}/turntable",
            &["get"],
            get(turntable),
        ),
        (
            "/api/sessions/{session}/nodes/{node}/edits",
            &["get"],
            get(edits),
        ),
        (
            "/api/sessions/{session}/nodes/{node}/command",
            &["get"],
            get(command),
        ),
    ]
}

/// Bytes of a media type.
fn typed(mime: &'static str, bytes: impl Into<Bytes>) -> Response {
    ([(CONTENT_TYPE, mime)], bytes.into()).into_response()
}

/// A PNG that never changes under its address.
fn lasting(png: Vec<u8>) -> Response {
    let headers = [
        (CONTENT_TYPE, "image/png"),
        (CACHE_CONTROL, "private, max-age=86400"),
    ];
    (headers, png).into_response()
}

impl IntoResponse for Download {
    fn into_response(self) -> Response {
        let disposition = format!("attachment; filename=\"{}\"", self.name);
        let headers = [
            (CONTENT_TYPE, self.mime.to_owned()),
            (CONTENT_DISPOSITION, disposition),
        ];
        (headers, self.bytes).into_response()
    }
}

/// A JSON body, or what is wrong with it.
fn body<T>(json: std::result::Result<Json<T>, JsonRejection>) -> Result<T> {
    json.map(|j| j.0)
        .map_err(|e| refusal(e.status(), e.body_text()))
}

/// A body of raw bytes, or what is wrong with it.
fn raw(bytes: std::result::Result<Bytes, BytesRejection>) -> Result<Bytes> {
    bytes.map_err(|e| refusal(e.status(), e.body_text()))
}

fn refusal(status: StatusCode, text: String) -> Error {
    if status == StatusCode::PAYLOAD_TOO_LARGE {
        Error::TooLarge(text)
    } else {
        Error::Invalid(text)
    }
}

fn query<T>(query: std::result::Result<Query<T>, QueryRejection>) -> Result<T> {
    query
        .map(|q| q.0)
        .map_err(|e| Error::Invalid(e.body_text()))
}

async fn index() -> Result<Response> {
    let (mime, bytes) = page::file("index.html")?;
    Ok(typed(mime, bytes))
}

async fn asset(Path(file): Path<String>) -> Result<Response> {
    let (mime, bytes) = page::file(&file)?;
    Ok(typed(mime, bytes))
}

async fn openapi() -> Response {
    typed("application/json", OPENAPI)
}

async fn studio(State(studio): Server) -> Json<Value> {
    let model = studio.engine.model();
    let modes = Mode::ALL.map(|mode| {
        let name = json!(mode);
        let available = studio.engine.knows(mode);
        let reason = (!available).then_some("This model was not trained to do this.");
        json!({"mode": name, "available": available, "reason": reason})
    });
    Json(json!({
        "version": env!("CARGO_PKG_VERSION"),
        "model": {
            "fingerprint": model.fingerprint,
            "resolution": model.side(),
            "origin": model.provenance.origin,
        },
        "modes": modes,
        "opening": studio.opening(),
    }))
}

async fn maps(State(studio): Server) -> Json<Value> {
    Json(json!({"maps": studio.maps.list()}))
}

#[derive(Deserialize)]
struct Named {
    name: String,
}

async fn add_map(
    State(studio): Server,
    named: std::result::Result<Query<Named>, QueryRejection>,
    bytes: std::result::Result<Bytes, BytesRejection>,
) -> Result<Json<Value>> {
    let (name, bytes) = (query(named)?.name, raw(bytes)?);
    let maps = Arc::clone(&studio.maps);
    let added = tokio::task::spawn_blocking(move || maps.add(&name, &bytes)).await??;
    let (id, warnings) = added;
    Ok(Json(json!({"id": id, "warnings": warnings})))
}

async fn map_preview(State(studio): Server, Path(map): Path<String>) -> Result<Response> {
    Ok(lasting(studio.maps.get(&map)?.preview.clone()))
}

async fn upload(State(studio): Server, parts: Multipart) -> Result<Json<Value>> {
    let upload = studio.uploads.receive(parts).await?;
    Ok(Json(json!({"id": upload.id, "check": upload.checked})))
}

async fn drop_upload(State(studio): Server, Path(upload): Path<String>) -> Json<Value> {
    studio.uploads.remove(&upload);
    Json(json!({}))
}

async fn upload_view(
    State(studio): Server,
    Path((upload, index)): Path<(String, usize)>,
) -> Result<Response> {
    let upload = studio.uploads.get(&upload)?;
    let png = upload.previews.get(index);
    let missing = || Error::NotFound(format!("view {index}: there is no such view"));
    Ok(lasting(png.ok_or_else(missing)?.clone()))
}

async fn upload_picture(State(studio): Server, Path(upload): Path<String>) -> Result<Response> {
    Ok(lasting(studio.uploads.get(&upload)?.picture.clone()))
}

async fn list(State(studio): Server) -> Result<Json<Value>> {
    let sessions = Arc::clone(&studio.sessions);
    let listed = tokio::task::spawn_blocking(move || sessions.list()).await?;
    Ok(Json(json!({"sessions": listed})))
}

/// What to encode.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Create {
    upload: String,
    inputs: usize,
    source: Option<String>,
}

async fn create(
    State(studio): Server,
    json: std::result::Result<Json<Create>, JsonRejection>,
) -> Result<Json<Value>> {
    let asked = body(json)?;
    let upload = studio.uploads.get(&asked.upload)?;
    let source = Source {
        path: None,
        inputs: asked.inputs,
        light: asked.source,
    };
    let turn = studio.uploads.turn().await?;
    let name = Some(upload.checked.report.name.clone());
    let session = open::open(&studio.engine, upload.scene.clone(), name, source, turn).await?;
    studio.insert(Arc::clone(&session)).await?;
    Ok(Json(session.json()))
}

async fn load(
    State(studio): Server,
    bytes: std::result::Result<Bytes, BytesRejection>,
) -> Result<Json<Value>> {
    let bytes = raw(bytes)?;
    let state = Arc::clone(&studio);
    let read = move || {
        let id = sessions::new_id();
        session_file::decode(id, &bytes, &state.engine, &state.maps)
    };
    let session = tokio::task::spawn_blocking(read).await??;
    studio.insert(Arc::clone(&session)).await?;
    Ok(Json(session.json()))
}

async fn session(State(studio): Server, Path(id): Path<String>) -> Result<Json<Value>> {
    Ok(Json(studio.session(id).await?.json()))
}

async fn forget(State(studio): Server, Path(id): Path<String>) -> Result<Json<Value>> {
    let sessions = Arc::clone(&studio.sessions);
    tokio::task::spawn_blocking(move || sessions.remove(&id)).await??;
    Ok(Json(json!({})))
}

async fn save(State(studio): Server, Path(id): Path<String>) -> Result<Download> {
    let session = studio.session(id).await?;
    let name = format!("{}.lumi-session", session.capture.name);
    let name = name.replace(
        |c: char| !c.is_ascii_alphanumeric() && !"-._".contains(c),
        "-",
    );
    let state = Arc::clone(&studio);
    let write = move || session_file::encode(&session, &state.engine, &state.maps);
    Ok(Download {
        name,
        mime: "application/octet-stream",
        bytes: tokio::task::spawn_blocking(write).await??,
    })
}

async fn connect(
    State(studio): Server,
    Path(id): Path<String>,
    upgrade: WebSocketUpgrade,
) -> Result<Response> {
    let session = studio.session(id).await?;
    let permit = Arc::clone(&studio.sockets).try_acquire_owned();
    let permit = permit.map_err(|_| socket::full())?;
    let (engine, maps) = (Arc::clone(&studio.engine), Arc::clone(&studio.maps));
    let upgrade = upgrade.max_message_size(crate::limits::MESSAGE_BYTES);
    Ok(upgrade.on_upgrade(async move |socket| {
        socket::serve(socket, engine, maps, session).await;
        drop(permit);
    }))
}

async fn input(
    State(studio): Server,
    Path((id, index)): Path<(String, usize)>,
) -> Result<Response> {
    let session = studio.session(id).await?;
    let view = session.capture.inputs.get(index);
    let missing = || Error::NotFound(format!("input {index}: there is no such view"));
    let view = view.ok_or_else(missing)?;
    Ok(lasting(lumi_core::image::encode_png(&view.image)?))
}

/// A removal to take back.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Restore {
    node: NodeId,
}

async fn restore(
    State(studio): Server,
    Path(id): Path<String>,
    json: std::result::Result<Json<Restore>, JsonRejection>,
) -> Result<Json<Value>> {
    let node = body(json)?.node;
    studio.session(id).await?.restore(node)?;
    Ok(Json(json!({"node": node})))
}

/// A new step.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Add {
    parent: NodeId,
    edit: EditForm,
}

async fn add(
    State(studio): Server,
    Path(id): Path<String>,
    json: std::result::Result<Json<Add>, JsonRejection>,
) -> Result<Json<Value>> {
    let asked = body(json)?;
    let session = studio.session(id).await?;
    let node = session.add(&studio.engine, &studio.maps, asked.parent, asked.edit);
    Ok(Json(node.await?))
}

/// A step in another form.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Change {
    version: u32,
    edit: EditForm,
}

async fn change(
    State(studio): Server,
    Path((id, node)): Path<(String, NodeId)>,
    json: std::result::Result<Json<Change>, JsonRejection>,
) -> Result<Json<Value>> {
    let asked = body(json)?;
    let session = studio.session(id).await?;
    let place = (node, asked.version);
    let node = session.change(&studio.engine, &studio.maps, place, asked.edit);
    Ok(Json(node.await?))
}

async fn remove(
    State(studio): Server,
    Path((id, node)): Path<(String, NodeId)>,
) -> Result<Json<Value>> {
    let removed = studio.session(id).await?.remove(node)?;
    Ok(Json(json!({"removed": removed})))
}

async fn thumbnail(
    State(studio): Server,
    Path((id, node)): Path<(String, NodeId)>,
) -> Result<Response> {
    let session = studio.session(id).await?;
    Ok(lasting(session.thumbnail(&studio.engine, node).await?))
}

async fn picture(
    State(studio): Server,
    Path((id, node, format)): Path<(String, NodeId, String)>,
    asked: std::result::Result<Query<PictureQuery>, QueryRejection>,
) -> Result<Download> {
    let session = studio.session(id).await?;
    export::picture(&session, &studio.engine, node, &format, &query(asked)?).await
}

async fn turntable(
    State(studio): Server,
    Path((id, node)): Path<(String, NodeId)>,
    asked: std::result::Result<Query<PictureQuery>, QueryRejection>,
) -> Result<Download> {
    let session = studio.session(id).await?;
    export::turntable(&session, &studio.engine, node, &query(asked)?).await
}

async fn edits(
    State(studio): Server,
    Path((id, node)): Path<(String, NodeId)>,
) -> Result<Download> {
    let session = studio.session(id).await?;
    export::edits(&session, &studio.maps, node)
}

async fn command(
    State(studio): Server,
    Path((id, node)): Path<(String, NodeId)>,
    asked: std::result::Result<Query<ViewQuery>, QueryRejection>,
) -> Result<Json<Value>> {
    let session = studio.session(id).await?;
    let model = studio.model_path();
    let folder = studio.maps_folder();
    let maps = (&*studio.maps, folder.as_path());
    let place = (node, &query(asked)?);
    let command = export::command(&session, &studio.engine, maps, model, place)?;
    Ok(Json(json!({"command": command})))
}
