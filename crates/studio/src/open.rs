//! From a folder to a session: open the scene, choose its inputs, encode them.

use crate::camera::OrbitCamera;
use crate::engine::Engine;
use crate::limits::INPUTS;
use crate::session::{Capture, InputView, Session, Source};
use crate::tree::Tree;
use crate::{Error, Result, sessions};
use lumi_core::{Light, Scene, View};
use lumi_data::{Lighting, input_light, spread_inputs};
use std::sync::Arc;

/// Encodes the capture that `read` opens, called `name` where that is given. `turn` is dropped when the capture has
/// been read: only then is the memory of its photographs free again, also if the client has left meanwhile.
///
/// # Errors
/// If it cannot be opened, has no usable inputs, or does not fit the model.
pub async fn open(
    engine: &Arc<Engine>,
    read: impl FnOnce() -> lumi_core::Result<Scene> + Send + 'static,
    name: Option<String>,
    source: Source,
    turn: impl Send + 'static,
) -> Result<Arc<Session>> {
    let side = engine.side();
    let chosen = move || {
        let _turn = turn;
        capture(read, name, source, side)
    };
    let (capture, views, lights) = tokio::task::spawn_blocking(chosen).await??;
    let (tokens, seconds) = engine.encode(views, capture.to_model, lights).await?;
    let bytes = tokens.bytes();
    let tree = Tree::new(tokens, seconds, bytes);
    Ok(Session::new(sessions::new_id(), capture, tree))
}

/// The capture, its inputs as the encoder takes them, and the light that they were taken in where it is known. The scene itself is dropped here: a session holds only
/// pictures at the model's size.
fn capture(
    read: impl FnOnce() -> lumi_core::Result<Scene>,
    name: Option<String>,
    source: Source,
    side: usize,
) -> Result<(Capture, Vec<View>, Option<Vec<Light>>)> {
    if source.inputs == 0 || source.inputs > INPUTS {
        let text = format!("inputs: expected 1 to {INPUTS}, found {}", source.inputs);
        return Err(Error::Invalid(text));
    }
    let scene = read()?;
    let light = source.light.as_deref().map(Lighting::single);
    let views = spread_inputs(&scene, source.inputs, light.as_ref(), side)?;
    let lights = input_light(&scene, light.as_ref())?;
    let shown = |v: &View| {
        v.image.clone().map(|image| InputView {
            name: v.name.clone(),
            camera: v.camera,
            image,
        })
    };
    let capture = Capture {
        name: name.unwrap_or_else(|| scene.name.clone()),
        source,
        to_model: scene.to_model,
        // A view that was captured is what the model knows best.
        camera: OrbitCamera::from_camera(&views[0].camera, &scene.to_model),
        inputs: views.iter().filter_map(shown).collect(),
    };
    Ok((capture, views, lights))
}
