//! The server: what it holds, who may talk to it, and how it starts and ends.

use crate::engine::Engine;
use crate::limits::{MESSAGE_BYTES, SOCKETS};
use crate::maps::Maps;
use crate::reply::Failed;
use crate::session::{Session, Source};
use crate::sessions::Sessions;
use crate::upload::Uploads;
use crate::{Error, Result, open, routes};
use axum::extract::{DefaultBodyLimit, Request, State};
use axum::http::header::{CACHE_CONTROL, CONTENT_TYPE, HOST, ORIGIN};
use axum::http::{HeaderMap, HeaderName, HeaderValue, Method};
use axum::middleware::{self, Next};
use axum::response::{IntoResponse, Response};
use axum::{Json, Router};
use lumi_core::Scene;
use lumi_model::Relighter;
use std::net::IpAddr;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;
use tokio::net::TcpListener;
use tokio::sync::Semaphore;

/// Path and methods of every route, for tests and documentation.
#[must_use]
pub fn routes() -> Vec<(&'static str, Vec<&'static str>)> {
    let methods = |route: routes::Route| {
        let methods = route.operations.iter().map(|operation| operation.method);
        (route.path, methods.collect())
    };
    routes::routes().into_iter().map(methods).collect()
}

/// How often changed sessions are written.
const SAVE_EVERY: Duration = Duration::from_millis(500);

/// How a studio is set up.
#[derive(Clone, Debug, Default)]
pub struct Config {
    /// Where sessions are kept.
    pub sessions: PathBuf,
    /// A folder of environment maps to offer besides the bundled ones.
    pub maps: Option<PathBuf>,
    /// Names besides localhost under which pages may reach the server.
    pub allow_hosts: Vec<String>,
    /// The weights file, for command lines; `None` if it is the bundled one.
    pub model: Option<String>,
}

/// A studio: model, maps, uploads and sessions.
pub struct Studio {
    pub(crate) engine: Arc<Engine>,
    pub(crate) maps: Arc<Maps>,
    pub(crate) uploads: Uploads,
    pub(crate) sessions: Arc<Sessions>,
    pub(crate) sockets: Arc<Semaphore>,
    /// The session that a page opens first.
    opening: Mutex<Option<String>>,
    config: Config,
}

impl Studio {
    /// How many times larger than the model's own pictures usually are, each way: more where it is given the photographs' detail.
    #[must_use]
    pub fn usual_detail(model: &Relighter) -> usize {
        if model.config.reprojection { 2 } else { 1 }
    }

    /// Reads the maps and finds the sessions.
    ///
    /// # Errors
    /// If a map cannot be read or the folder of the sessions cannot be made.
    pub fn new(model: Relighter, config: Config) -> Result<Arc<Self>> {
        let engine = Engine::new(model);
        let maps = Arc::new(Maps::load(config.maps.as_deref())?);
        let sessions = Sessions::new(
            config.sessions.clone(),
            Arc::clone(&engine),
            Arc::clone(&maps),
        )?;
        Ok(Arc::new(Self {
            engine,
            maps,
            uploads: Uploads::default(),
            sessions: Arc::new(sessions),
            sockets: Arc::new(Semaphore::new(SOCKETS)),
            opening: Mutex::default(),
            config,
        }))
    }

    /// What a person should know before others use it, too.
    #[must_use]
    pub fn warning(&self) -> Option<String> {
        let folder = self.config.sessions.display();
        (!self.sessions.are_alone()).then(|| {
            format!(
                "another studio keeps its sessions in {folder}, too: of one that both change, what is saved last stays; \
                 another data folder gives this one its own"
            )
        })
    }

    /// Encodes `scene`, the capture in `folder`, as the session that pages open first; returns its id.
    ///
    /// # Errors
    /// If it has no usable inputs, or cannot be encoded.
    pub async fn open(&self, scene: Scene, folder: &Path, inputs: usize) -> Result<String> {
        let full = folder.canonicalize().unwrap_or_else(|_| folder.to_owned());
        let source = Source {
            path: Some(full.display().to_string()),
            inputs,
            light: None,
        };
        let session = open::open(&self.engine, move || Ok(scene), None, source, ()).await?;
        let id = session.id.clone();
        let sessions = Arc::clone(&self.sessions);
        tokio::task::spawn_blocking(move || sessions.insert_opening(session)).await??;
        *self.opening.lock().unwrap_or_else(PoisonError::into_inner) = Some(id.clone());
        Ok(id)
    }

    /// Answers requests on `listener` until `stop` resolves, then writes what is not written yet.
    ///
    /// # Errors
    /// If the socket fails or a session cannot be written at the end.
    pub async fn serve(
        self: Arc<Self>,
        listener: TcpListener,
        stop: impl Future<Output = ()> + Send + 'static,
    ) -> Result<()> {
        let io = |e: std::io::Error| Error::Internal(format!("socket: {e}"));
        let address = listener.local_addr().map_err(io)?;
        let saver = tokio::spawn(save_from_time_to_time(Arc::clone(&self.sessions)));
        let router = self.router(address.ip());
        let served = axum::serve(listener, router).with_graceful_shutdown(stop);
        served.await.map_err(io)?;
        saver.abort();
        let sessions = Arc::clone(&self.sessions);
        tokio::task::spawn_blocking(move || sessions.save_all()).await?
    }

    fn router(self: &Arc<Self>, address: IpAddr) -> Router {
        let guard = Arc::new(Guard {
            loopback: address.is_loopback(),
            names: self.config.allow_hosts.clone(),
        });
        let mut router = Router::new();
        for route in routes::routes() {
            router = router.route(route.path, route.handler);
        }
        router
            .fallback(async || Error::NotFound("there is nothing here".into()))
            .layer(DefaultBodyLimit::max(MESSAGE_BYTES))
            .layer(middleware::from_fn_with_state(guard, guarded))
            .with_state(Arc::clone(self))
    }

    pub(crate) fn opening(&self) -> Option<String> {
        let opening = self.opening.lock();
        opening.unwrap_or_else(PoisonError::into_inner).clone()
    }

    pub(crate) fn model_path(&self) -> Option<&str> {
        self.config.model.as_deref()
    }

    /// Where maps that have no file of their own get one for command lines.
    pub(crate) fn maps_folder(&self) -> PathBuf {
        self.config.sessions.join("maps")
    }

    /// The session called `id`; it may have to be read from disk.
    pub(crate) async fn session(&self, id: String) -> Result<Arc<Session>> {
        let sessions = Arc::clone(&self.sessions);
        tokio::task::spawn_blocking(move || sessions.get(&id)).await?
    }

    pub(crate) async fn insert(&self, session: Arc<Session>) -> Result<()> {
        let sessions = Arc::clone(&self.sessions);
        tokio::task::spawn_blocking(move || sessions.insert(session)).await?
    }
}

async fn save_from_time_to_time(sessions: Arc<Sessions>) {
    loop {
        tokio::time::sleep(SAVE_EVERY).await;
        let sessions = Arc::clone(&sessions);
        match tokio::task::spawn_blocking(move || sessions.save_all()).await {
            Ok(Ok(())) => {}
            Ok(Err(e)) => eprintln!("warning: sessions are not saved: {e}"),
            Err(e) if e.is_cancelled() => return,
            Err(e) => eprintln!("warning: sessions are not saved: {e}"),
        }
    }
}

/// Who may talk to the server.
struct Guard {
    /// Whether it listens to this machine alone.
    loopback: bool,
    /// Further names of it.
    names: Vec<String>,
}

impl Guard {
    /// Browsers send the name in the address bar as Host: a name that is not ours means that somebody made their
    /// name point here (DNS rebinding). Numbers cannot be rebound.
    fn host(&self, headers: &HeaderMap) -> Result<String> {
        let host = headers.get(HOST).and_then(|h| h.to_str().ok());
        let host = host.unwrap_or_default().to_ascii_lowercase();
        let name = match host.rsplit_once(':') {
            Some((name, port)) if port.bytes().all(|b| b.is_ascii_digit()) => name,
            _ => &host,
        };
        let address = name.trim_start_matches('[').trim_end_matches(']');
        let ours = match address.parse::<IpAddr>() {
            Ok(ip) => ip.is_loopback() || !self.loopback,
            Err(_) => name == "localhost",
        };
        if ours || self.names.iter().any(|n| n.eq_ignore_ascii_case(name)) {
            return Ok(host);
        }
        Err(Error::Forbidden(format!(
            "Host: expected a name of this server, found `{name}` (see --allow-host)"
        )))
    }

    /// Pages of other origins may neither send requests nor open WebSockets, which no other rule of browsers stops.
    fn origin(&self, headers: &HeaderMap, host: &str, navigates: bool) -> Result<()> {
        let foreign = |what: &str| {
            Error::Forbidden(format!(
                "{what}: expected a request of the studio's own page"
            ))
        };
        if let Some(origin) = headers.get(ORIGIN) {
            let origin = origin.to_str().unwrap_or_default().to_ascii_lowercase();
            let own = ["http://", "https://"]
                .iter()
                .any(|scheme| origin.strip_prefix(scheme) == Some(host));
            if !own {
                return Err(foreign("Origin"));
            }
        }
        let site = headers.get("sec-fetch-site").and_then(|s| s.to_str().ok());
        if !navigates && matches!(site, Some("cross-site" | "same-site")) {
            return Err(foreign("Sec-Fetch-Site"));
        }
        Ok(())
    }
}

/// Every error is JSON with a text, also those that the HTTP library finds before a handler runs.
fn worded(response: Response) -> Response {
    let status = response.status();
    let ours = response
        .headers()
        .get(CONTENT_TYPE)
        .is_some_and(|t| t == "application/json");
    if ours || !(status.is_client_error() || status.is_server_error()) {
        return response;
    }
    let error = status.canonical_reason().unwrap_or("refused").to_owned();
    (status, Json(Failed { error })).into_response()
}

/// Checks a request before anything else sees it, and tells browsers what the answer may do.
async fn guarded(State(guard): State<Arc<Guard>>, request: Request, next: Next) -> Response {
    let navigates = request.method() == Method::GET && request.uri().path() == "/";
    let checked = guard
        .host(request.headers())
        .and_then(|host| guard.origin(request.headers(), &host, navigates));
    let mut response = match checked {
        Ok(()) => worded(next.run(request).await),
        Err(e) => e.into_response(),
    };
    const HEADERS: [(&str, &str); 5] = [
        (
            "content-security-policy",
            "default-src 'self'; img-src 'self' blob: data:; frame-ancestors 'none'; base-uri 'none'; form-action 'none'",
        ),
        ("x-content-type-options", "nosniff"),
        ("referrer-policy", "no-referrer"),
        ("cross-origin-resource-policy", "same-origin"),
        ("cross-origin-opener-policy", "same-origin"),
    ];
    let headers = response.headers_mut();
    for (name, value) in HEADERS {
        headers.insert(
            HeaderName::from_static(name),
            HeaderValue::from_static(value),
        );
    }
    headers
        .entry(CACHE_CONTROL)
        .or_insert(HeaderValue::from_static("no-store"));
    response
}
