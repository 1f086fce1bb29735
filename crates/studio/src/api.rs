//! What answers each HTTP route; the table of them is `routes.rs`.

use crate::export::{self, Download, PictureQuery, ViewQuery};
use crate::form::EditForm;
use crate::limits::INPUTS;
use crate::reply::{
    AddedMap, Command, Done, MapList, NodeView, Removed, Restored, SessionList, SessionView,
    StudioInfo, Uploaded,
};
use crate::server::Studio;
use crate::session::Source;
use crate::tree::NodeId;
use crate::{Error, Result, open, page, routes, session_file, sessions, socket};
use axum::Json;
use axum::body::Bytes;
use axum::extract::rejection::{BytesRejection, JsonRejection, QueryRejection};
use axum::extract::{Multipart, Path, Query, State, WebSocketUpgrade};
use axum::http::StatusCode;
use axum::http::header::{CACHE_CONTROL, CONTENT_DISPOSITION, CONTENT_TYPE};
use axum::response::{IntoResponse, Response};
use schemars::JsonSchema;
use serde::Deserialize;
use std::sync::Arc;

type Server = State<Arc<Studio>>;

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

pub async fn index() -> Result<Response> {
    let (mime, bytes) = page::file("index.html")?;
    Ok(typed(mime, bytes))
}

pub async fn asset(Path(file): Path<String>) -> Result<Response> {
    let (mime, bytes) = page::file(&file)?;
    Ok(typed(mime, bytes))
}

pub async fn openapi() -> Response {
    typed("application/json", routes::OPENAPI.as_str())
}

pub async fn studio(State(studio): Server) -> Json<StudioInfo> {
    Json(StudioInfo::new(&studio.engine, studio.opening()))
}

pub async fn maps(State(studio): Server) -> Json<MapList> {
    let maps = studio.maps.list();
    Json(MapList { maps })
}

#[derive(Deserialize, JsonSchema)]
pub struct Named {
    /// What it is to be called.
    name: String,
}

pub async fn add_map(
    State(studio): Server,
    named: std::result::Result<Query<Named>, QueryRejection>,
    bytes: std::result::Result<Bytes, BytesRejection>,
) -> Result<Json<AddedMap>> {
    let (name, bytes) = (query(named)?.name, raw(bytes)?);
    let maps = Arc::clone(&studio.maps);
    let added = tokio::task::spawn_blocking(move || maps.add(&name, &bytes)).await??;
    let (id, warnings) = added;
    Ok(Json(AddedMap { id, warnings }))
}

pub async fn map_preview(State(studio): Server, Path(map): Path<String>) -> Result<Response> {
    Ok(lasting(studio.maps.get(&map)?.preview.clone()))
}

pub async fn upload(State(studio): Server, parts: Multipart) -> Result<Json<Uploaded>> {
    let upload = studio.uploads.receive(parts).await?;
    Ok(Json(Uploaded {
        id: upload.id.clone(),
        check: upload.checked.clone(),
    }))
}

pub async fn drop_upload(State(studio): Server, Path(upload): Path<String>) -> Json<Done> {
    studio.uploads.remove(&upload);
    Json(Done {})
}

pub async fn upload_view(
    State(studio): Server,
    Path((upload, index)): Path<(String, usize)>,
) -> Result<Response> {
    let upload = studio.uploads.get(&upload)?;
    let png = upload.previews.get(index);
    let missing = || Error::NotFound(format!("view {index}: there is no such view"));
    Ok(lasting(png.ok_or_else(missing)?.clone()))
}

pub async fn upload_picture(State(studio): Server, Path(upload): Path<String>) -> Result<Response> {
    Ok(lasting(studio.uploads.get(&upload)?.picture.clone()))
}

pub async fn list(State(studio): Server) -> Result<Json<SessionList>> {
    let sessions = Arc::clone(&studio.sessions);
    let sessions = tokio::task::spawn_blocking(move || sessions.list()).await?;
    Ok(Json(SessionList { sessions }))
}

/// What to encode.
#[derive(Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Create {
    upload: String,
    /// How many input views to encode.
    #[schemars(range(min = 1, max = INPUTS))]
    inputs: usize,
    /// Light of the inputs, for captures rendered one light at a time.
    source: Option<String>,
}

pub async fn create(
    State(studio): Server,
    json: std::result::Result<Json<Create>, JsonRejection>,
) -> Result<Json<SessionView>> {
    let asked = body(json)?;
    let upload = studio.uploads.get(&asked.upload)?;
    let source = Source {
        path: None,
        inputs: asked.inputs,
        light: asked.source,
    };
    let turn = studio.uploads.turn().await?;
    let name = Some(upload.checked.report.name.clone());
    let folder = upload.scene.clone();
    let read = move || lumi_data::open(&folder);
    let session = open::open(&studio.engine, read, name, source, turn).await?;
    studio.insert(Arc::clone(&session)).await?;
    Ok(Json(SessionView::from(&*session)))
}

pub async fn load(
    State(studio): Server,
    bytes: std::result::Result<Bytes, BytesRejection>,
) -> Result<Json<SessionView>> {
    let bytes = raw(bytes)?;
    let state = Arc::clone(&studio);
    let read = move || {
        let id = sessions::new_id();
        session_file::decode(id, &bytes, &state.engine, &state.maps)
    };
    let session = tokio::task::spawn_blocking(read).await??;
    studio.insert(Arc::clone(&session)).await?;
    Ok(Json(SessionView::from(&*session)))
}

pub async fn session(State(studio): Server, Path(id): Path<String>) -> Result<Json<SessionView>> {
    Ok(Json(SessionView::from(&*studio.session(id).await?)))
}

pub async fn forget(State(studio): Server, Path(id): Path<String>) -> Result<Json<Done>> {
    let sessions = Arc::clone(&studio.sessions);
    tokio::task::spawn_blocking(move || sessions.remove(&id)).await??;
    Ok(Json(Done {}))
}

pub async fn save(State(studio): Server, Path(id): Path<String>) -> Result<Download> {
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

pub async fn connect(
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

pub async fn input(
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
#[derive(Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Restore {
    /// The step that was removed.
    node: NodeId,
}

pub async fn restore(
    State(studio): Server,
    Path(id): Path<String>,
    json: std::result::Result<Json<Restore>, JsonRejection>,
) -> Result<Json<Restored>> {
    let node = body(json)?.node;
    studio.session(id).await?.restore(node)?;
    Ok(Json(Restored { node }))
}

/// A new step.
#[derive(Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Add {
    parent: NodeId,
    edit: EditForm,
}

pub async fn add(
    State(studio): Server,
    Path(id): Path<String>,
    json: std::result::Result<Json<Add>, JsonRejection>,
) -> Result<Json<NodeView>> {
    let asked = body(json)?;
    let session = studio.session(id).await?;
    let node = session.add(&studio.engine, &studio.maps, asked.parent, asked.edit);
    Ok(Json(node.await?))
}

/// A step in another form.
#[derive(Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Change {
    /// The version that it has.
    version: u32,
    edit: EditForm,
}

pub async fn change(
    State(studio): Server,
    Path((id, node)): Path<(String, NodeId)>,
    json: std::result::Result<Json<Change>, JsonRejection>,
) -> Result<Json<NodeView>> {
    let asked = body(json)?;
    let session = studio.session(id).await?;
    let place = (node, asked.version);
    let node = session.change(&studio.engine, &studio.maps, place, asked.edit);
    Ok(Json(node.await?))
}

pub async fn remove(
    State(studio): Server,
    Path((id, node)): Path<(String, NodeId)>,
) -> Result<Json<Removed>> {
    let removed = studio.session(id).await?.remove(node)?;
    Ok(Json(Removed { removed }))
}

pub async fn thumbnail(
    State(studio): Server,
    Path((id, node)): Path<(String, NodeId)>,
) -> Result<Response> {
    let session = studio.session(id).await?;
    Ok(lasting(session.thumbnail(&studio.engine, node).await?))
}

pub async fn picture(
    State(studio): Server,
    Path((id, node, format)): Path<(String, NodeId, String)>,
    asked: std::result::Result<Query<PictureQuery>, QueryRejection>,
) -> Result<Download> {
    let session = studio.session(id).await?;
    export::picture(&session, &studio.engine, node, &format, &query(asked)?).await
}

pub async fn turntable(
    State(studio): Server,
    Path((id, node)): Path<(String, NodeId)>,
    asked: std::result::Result<Query<PictureQuery>, QueryRejection>,
) -> Result<Download> {
    let session = studio.session(id).await?;
    export::turntable(&session, &studio.engine, node, &query(asked)?).await
}

pub async fn edits(
    State(studio): Server,
    Path((id, node)): Path<(String, NodeId)>,
) -> Result<Download> {
    let session = studio.session(id).await?;
    export::edits(&session, &studio.maps, node)
}

pub async fn command(
    State(studio): Server,
    Path((id, node)): Path<(String, NodeId)>,
    asked: std::result::Result<Query<ViewQuery>, QueryRejection>,
) -> Result<Json<Command>> {
    let session = studio.session(id).await?;
    let model = studio.model_path();
    let folder = studio.maps_folder();
    let maps = (&*studio.maps, folder.as_path());
    let place = (node, &query(asked)?);
    let command = export::command(&session, &studio.engine, maps, model, place)?;
    Ok(Json(Command { command }))
}
