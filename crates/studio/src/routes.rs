//! The table of HTTP routes: what answers each, and how the OpenAPI document describes it.

use crate::api::*;
use crate::export::{PictureQuery, ViewQuery};
use crate::limits::{MAP_BYTES, SESSION_BYTES};
use crate::openapi::{self, Operation};
use crate::reply::{
    AddedMap, Command, Done, MapList, NodeView, Removed, Restored, SessionList, SessionView,
    StudioInfo, Uploaded,
};
use crate::server::Studio;
use axum::extract::DefaultBodyLimit;
use axum::routing::{MethodRouter, any, delete, get, post, put};
use serde_json::{Map, Value};
use std::sync::{Arc, LazyLock};

/// A route: its path, what its methods are described as, and what answers them.
pub struct Route {
    pub path: &'static str,
    pub operations: Vec<Operation>,
    pub handler: MethodRouter<Arc<Studio>>,
}

fn route(
    path: &'static str,
    handler: MethodRouter<Arc<Studio>>,
    operations: impl Into<Vec<Operation>>,
) -> Route {
    Route {
        path,
        operations: operations.into(),
        handler,
    }
}

/// Every route.
pub fn routes() -> Vec<Route> {
    let op = Operation::new;
    vec![
        route(
            "/",
            get(index),
            [
                op("get", "The page").gives_bytes("text/html"),
            ],
        ),
        route(
            "/assets/{file}",
            get(asset),
            [
                op("get", "A file of the page"),
            ],
        ),
        route(
            "/api/openapi.json",
            get(openapi),
            [
                op("get", "This document").gives::<Map<String, Value>>(),
            ],
        ),
        route(
            "/api/studio",
            get(studio),
            [
                op("get", "The model, its edit modes, and the session that a page opens first").gives::<StudioInfo>(),
            ],
        ),
        route(
            "/api/maps",
            get(maps).merge(post(add_map).layer(DefaultBodyLimit::max(MAP_BYTES))),
            [
                op("get", "All environment maps").gives::<MapList>(),
                op("post", "Adds an environment map: a Radiance HDR or OpenEXR file, or a PNG or JPEG panorama").asks::<Named>().takes_bytes().gives::<AddedMap>(),
            ],
        ),
        route(
            "/api/maps/{map}/preview",
            get(map_preview),
            [
                op("get", "A tone-mapped picture of a map").gives_bytes("image/png"),
            ],
        ),
        route(
            "/api/uploads",
            post(upload).layer(DefaultBodyLimit::disable()),
            [
                op("post", "Receives a capture and checks it. Each part of the form is one file, its name the file's path in the folder; or one part with a zip").takes_files().gives::<Uploaded>(),
            ],
        ),
        route(
            "/api/uploads/{upload}",
            delete(drop_upload),
            [
                op("delete", "Forgets an upload").gives::<Done>(),
            ],
        ),
        route(
            "/api/uploads/{upload}/views/{index}",
            get(upload_view),
            [
                op("get", "A small picture of an input view").gives_bytes("image/png"),
            ],
        ),
        route(
            "/api/uploads/{upload}/picture",
            get(upload_picture),
            [
                op("get", "The check on one page, as `lumi scene check --picture` draws it").gives_bytes("image/png"),
            ],
        ),
        route(
            "/api/sessions",
            get(list).post(create),
            [
                op("get", "All sessions, newest first").gives::<SessionList>(),
                op("post", "Encodes an upload as a new session").takes::<Create>().gives::<SessionView>(),
            ],
        ),
        route(
            "/api/sessions/load",
            post(load).layer(DefaultBodyLimit::max(SESSION_BYTES)),
            [
                op("post", "Opens a session file as a new session").takes_bytes().gives::<SessionView>(),
            ],
        ),
        route(
            "/api/sessions/{session}",
            get(session).delete(forget),
            [
                op("get", "A session").gives::<SessionView>(),
                op("delete", "Deletes a session and its file").gives::<Done>(),
            ],
        ),
        route(
            "/api/sessions/{session}/file",
            get(save),
            [
                op("get", "The session as one file"),
            ],
        ),
        route(
            "/api/sessions/{session}/socket",
            any(connect),
            [
                op("get", "WebSocket for frames; messages in docs/studio.md").opens_socket(),
            ],
        ),
        route(
            "/api/sessions/{session}/inputs/{index}",
            get(input),
            [
                op("get", "An encoded input view").gives_bytes("image/png"),
            ],
        ),
        route(
            "/api/sessions/{session}/restore",
            post(restore),
            [
                op("post", "Brings a removed step back, with what was removed together with it").takes::<Restore>().gives::<Restored>(),
            ],
        ),
        route(
            "/api/sessions/{session}/nodes",
            post(add),
            [
                op("post", "Makes a new step").takes::<Add>().gives::<NodeView>(),
            ],
        ),
        route(
            "/api/sessions/{session}/nodes/{node}",
            put(change).delete(remove),
            [
                op("put", "Changes a step that still is at `version`, and makes what was built on it anew").takes::<Change>().gives::<NodeView>(),
                op("delete", "Removes a step with all that was built on it").gives::<Removed>(),
            ],
        ),
        route(
            "/api/sessions/{session}/nodes/{node}/thumbnail",
            get(thumbnail),
            [
                op("get", "A small picture of a step. Browsers keep it for a day: add `?v=` with the session's `opened` and the step's `version`").gives_bytes("image/png"),
            ],
        ),
        route(
            "/api/sessions/{session}/nodes/{node}/picture/{format}",
            get(picture),
            [
                op("get", "A picture of a step: `png` as shown, `exr` its radiance with alpha").asks::<PictureQuery>().gives_bytes("image/png"),
            ],
        ),
        route(
            "/api/sessions/{session}/nodes/{node}/turntable",
            get(turntable),
            [
                op("get", "A turntable of a step as a GIF").asks::<PictureQuery>().gives_bytes("image/gif"),
            ],
        ),
        route(
            "/api/sessions/{session}/nodes/{node}/edits",
            get(edits),
            [
                op("get", "The edits up to a step for `lumi relight --edits`: TOML, or a zip with the maps that it needs").gives_bytes("application/toml"),
            ],
        ),
        route(
            "/api/sessions/{session}/nodes/{node}/command",
            get(command),
            [
                op("get", "The `lumi relight` command line of a step, as it runs on the server's machine").asks::<ViewQuery>().gives::<Command>(),
            ],
        ),
    ]
}

/// The interface as OpenAPI 3.1.
pub static OPENAPI: LazyLock<String> = LazyLock::new(|| {
    let routes = routes();
    let table = routes.iter().map(|r| (r.path, r.operations.as_slice()));
    openapi::document(table).to_string()
});
