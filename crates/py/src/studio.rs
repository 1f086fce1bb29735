//! The studio, served from a thread of this process.

use crate::errors::{warn, wrong};
use crate::model::Model;
use crate::scene::Scene;
use crate::work;
use anyhow::Context;
use lumi_cli::{assets, device::DeviceName};
use lumi_studio::Config;
use pyo3::prelude::*;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;
use tokio::net::TcpListener;
use tokio::sync::oneshot;

/// A studio that is being served; closing it writes what is not written yet.
#[pyclass(frozen, module = "lumitokens")]
pub struct Studio {
    url: String,
    server: Mutex<Option<Server>>,
}

struct Server {
    stop: oneshot::Sender<()>,
    thread: JoinHandle<anyhow::Result<()>>,
}

/// Serves the studio for a scene on this machine (127.0.0.1) and returns at once; open `Studio.url` in a browser.
///
/// Parameters
/// ----------
/// scene : Scene or path, optional
///     A scene that was read from files; the bundled one if left out.
/// model : Model, optional
///     The bundled one if left out.
/// inputs : int
///     Number of input views to encode.
/// port : int
///     0 takes a free one.
/// maps : path, optional
///     Folder of environment maps to offer besides the bundled ones.
/// data : path, optional
///     Where sessions are kept; by default lumi/studio in the user's data folder.
///
/// Returns
/// -------
/// Studio
#[pyfunction]
#[pyo3(signature = (scene = None, *, model = None, inputs = 8, port = 7788, maps = None, data = None))]
pub fn studio(
    py: Python<'_>,
    scene: Option<&Bound<'_, PyAny>>,
    model: Option<&Model>,
    inputs: usize,
    port: u16,
    maps: Option<PathBuf>,
    data: Option<PathBuf>,
) -> PyResult<Studio> {
    let folder = match scene {
        None => None,
        Some(given) => Some(match given.cast::<Scene>() {
            Ok(scene) => {
                let expected = "expected one that was read from files; Scene.write makes such";
                let path = scene.get().path.clone();
                path.ok_or_else(|| wrong("scene", expected))?
            }
            Err(_) => given.extract()?,
        }),
    };
    let data = data.or_else(lumi_cli::studio_folder);
    let data = data.ok_or_else(|| wrong("data", "expected a folder, since HOME is not set"))?;
    let model = model.map(|model| model.0.clone());
    let (url, server, warning) = work::run(py, move |_| {
        let folder = match folder {
            Some(folder) => folder,
            None => assets::demo_scene(&data.join("bundled"))?,
        };
        let model = match model {
            Some(model) => model,
            None => assets::model(None, &DeviceName::default())?,
        };
        let config = Config {
            sessions: data.join("sessions"),
            maps,
            ..Config::default()
        };
        let detail = lumi_studio::Studio::usual_detail(&model);
        let studio = lumi_studio::Studio::new(model.with_detail(detail)?, config)?;
        let runtime = tokio::runtime::Runtime::new()?;
        let listener = runtime.block_on(async {
            // The port first: nobody should wait for the encoder to learn that it is taken.
            let listener = TcpListener::bind(("127.0.0.1", port)).await;
            let listener = listener.with_context(|| format!("port {port}: cannot listen there"))?;
            let scene = lumi_data::open(&folder)?;
            studio.open(scene, &folder, inputs).await?;
            anyhow::Ok(listener)
        })?;
        let url = format!("http://{}/", listener.local_addr()?);
        let warning = studio.warning();
        let (stop, stopped) = oneshot::channel::<()>();
        let serve = move || {
            // A studio that nobody holds any more ends as well.
            let stopped = async { drop(stopped.await) };
            Ok(runtime.block_on(Arc::clone(&studio).serve(listener, stopped))?)
        };
        let thread = std::thread::Builder::new().name("lumitokens-studio".into());
        let thread = thread.spawn(serve)?;
        Ok((url, Server { stop, thread }, warning))
    })?;
    if let Some(text) = warning {
        warn(py, &text)?;
    }
    Ok(Studio {
        url,
        server: Mutex::new(Some(server)),
    })
}

/// How often a waiting caller is asked for Ctrl-C.
const POLL: Duration = Duration::from_millis(100);

impl Studio {
    fn server(&self) -> std::sync::MutexGuard<'_, Option<Server>> {
        self.server.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[pymethods]
impl Studio {
    /// Where a browser finds it.
    #[getter]
    fn url(&self) -> &str {
        &self.url
    }

    /// Ends it, after what is not written yet.
    fn close(&self, py: Python<'_>) -> PyResult<()> {
        let Some(Server { stop, thread }) = self.server().take() else {
            return Ok(());
        };
        // It may have ended by itself.
        let _ended = stop.send(());
        work::run(py, move |_| {
            let ended = thread.join();
            ended.map_err(|_| anyhow::anyhow!("the studio broke off, see standard error"))?
        })
    }

    /// Waits until it ends or Ctrl-C is pressed, which closes it.
    fn wait(&self, py: Python<'_>) -> PyResult<()> {
        let runs = || {
            self.server()
                .as_ref()
                .is_some_and(|s| !s.thread.is_finished())
        };
        while runs() {
            py.detach(|| std::thread::sleep(POLL));
            if let Err(interrupted) = py.check_signals() {
                self.close(py)?;
                return Err(interrupted);
            }
        }
        self.close(py)
    }

    fn __enter__(this: Py<Self>) -> Py<Self> {
        this
    }

    #[pyo3(signature = (*_args))]
    fn __exit__(&self, py: Python<'_>, _args: &Bound<'_, pyo3::types::PyTuple>) -> PyResult<()> {
        self.close(py)
    }

    fn __repr__(&self) -> String {
        format!("Studio({})", self.url)
    }
}
