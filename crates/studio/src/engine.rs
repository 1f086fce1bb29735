//! The one place that runs the model: a few jobs at a time, off the threads that answer requests.

use crate::camera::OrbitCamera;
use crate::limits::PREPARED;
use crate::look::Look;
use crate::{Error, Result};
use lumi_core::{DisplayImage, Light, LinearImage, Similarity, View};
use lumi_model::config::Output;
use lumi_model::{Edit, Mode, Relighter, SceneTokens};
use std::collections::VecDeque;
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Instant;
use tokio::sync::Semaphore;

/// A full frame that takes longer than this has a quick one sent before it, and while the camera moves instead of it: with
/// the page's own work, full ones would fall below 20 in a second.
const SLOW_MS: f32 = 40.0;

/// Model and the permits to run it.
pub struct Engine {
    model: Relighter,
    /// The model without detail from the photographs, for quick pictures.
    plain: Option<Relighter>,
    permits: Arc<Semaphore>,
    /// Bits of the milliseconds that a full frame is taken to need: the mean of late, or a faster last one.
    full_ms: AtomicU32,
    /// Tokens that were looked at last, the newest at the back. Only they keep what the decoder has prepared for them.
    looked_at: Mutex<VecDeque<Arc<SceneTokens>>>,
}

/// A rendered picture.
pub struct Frame {
    /// The picture, over white, with alpha where the model makes it.
    pub image: DisplayImage,
    /// Its radiance, premultiplied by alpha.
    pub radiance: LinearImage,
    /// How long the model took, in milliseconds.
    pub ms: f32,
}

impl Engine {
    /// Runs as many jobs at a time as there are cores, up to four: each job uses several threads itself.
    #[must_use]
    pub fn new(model: Relighter) -> Arc<Self> {
        let cores = std::thread::available_parallelism().map_or(1, usize::from);
        let finer = model.side() > model.config.resolution;
        let plain = finer.then(|| model.clone().with_detail(1).ok()).flatten();
        Arc::new(Self {
            model,
            plain,
            permits: Arc::new(Semaphore::new(cores.min(4))),
            full_ms: AtomicU32::new(0),
            looked_at: Mutex::default(),
        })
    }

    /// What the model is.
    #[must_use]
    pub fn model(&self) -> &Relighter {
        &self.model
    }

    /// Side of a full picture in pixels.
    #[must_use]
    pub fn side(&self) -> usize {
        self.model.side()
    }

    /// Whether the model was trained for `mode`.
    #[must_use]
    pub fn knows(&self, mode: Mode) -> bool {
        self.model.config.lights.modes().contains(&mode)
    }

    /// Side of the quick picture, where full ones are slow enough to need it.
    #[must_use]
    pub fn quick_side(&self) -> Option<usize> {
        let config = &self.model.config;
        let half = match self.plain {
            Some(_) => config.resolution,
            None => (self.side() / 2).next_multiple_of(config.patch),
        };
        let slow = f32::from_bits(self.full_ms.load(Ordering::Relaxed)) > SLOW_MS;
        (slow && half < self.side()).then_some(half)
    }

    /// Scene tokens of input views, told the light that they were taken in where it is known, and the seconds it took.
    ///
    /// # Errors
    /// As [`Relighter::encode`].
    pub async fn encode(
        self: &Arc<Self>,
        views: Vec<View>,
        to_model: Similarity,
        captured_in: Option<Vec<Light>>,
    ) -> Result<(SceneTokens, f32)> {
        self.run(move |model| {
            let tokens = model.encode(&views, to_model)?;
            match captured_in.filter(|_| model.takes_captured_light()) {
                // A light that the model cannot take leaves brightness to the model.
                Some(lights) => Ok(model
                    .with_captured_light(&tokens, &lights)
                    .unwrap_or(tokens)),
                None => Ok(tokens),
            }
        })
        .await
    }

    /// Scene tokens after an edit, and the seconds it took.
    ///
    /// # Errors
    /// As [`Relighter::edit`].
    pub async fn edit(
        self: &Arc<Self>,
        tokens: Arc<SceneTokens>,
        edit: Edit,
    ) -> Result<(SceneTokens, f32)> {
        self.run(move |model| Ok(model.edit(&tokens, &edit)?)).await
    }

    /// The scene from one camera, `side` pixels square, as `look` shows it. `to_model` takes the world to the unit ball that the camera
    /// goes around: the capture's, since tokens of models with the authors' lights live in another frame.
    ///
    /// # Errors
    /// On a camera out of range.
    pub async fn render(
        self: &Arc<Self>,
        tokens: Arc<SceneTokens>,
        to_model: &Similarity,
        camera: OrbitCamera,
        side: usize,
        look: Look,
    ) -> Result<Frame> {
        let mut views = self
            .render_all(tokens, to_model, vec![camera], side)
            .await?;
        let (radiance, seconds) = (views.0.pop(), views.1);
        let radiance = radiance.ok_or_else(|| Error::Internal("no picture".into()))?;
        let image = look.shown(&radiance);
        let ms = 1e3 * seconds;
        if side == self.side() {
            let before = f32::from_bits(self.full_ms.load(Ordering::Relaxed));
            // One slow frame, such as the first of all, says little; one fast frame says that they can be.
            let expected = if before == 0.0 || ms < before {
                ms
            } else {
                0.8 * before + 0.2 * ms
            };
            self.full_ms.store(expected.to_bits(), Ordering::Relaxed);
        }
        Ok(Frame {
            image,
            radiance,
            ms,
        })
    }

    /// The scene's radiance from several cameras, and the seconds it took; `to_model` as in [`Self::render`]. Models that make
    /// display-encoded pictures have that of those, covered everywhere.
    ///
    /// # Errors
    /// On a camera out of range.
    pub async fn render_all(
        self: &Arc<Self>,
        tokens: Arc<SceneTokens>,
        to_model: &Similarity,
        cameras: Vec<OrbitCamera>,
        side: usize,
    ) -> Result<(Vec<LinearImage>, f32)> {
        let cameras = cameras
            .iter()
            .map(|c| c.camera(to_model, side))
            .collect::<Result<Vec<_>>>()?;
        let engine = Arc::clone(self);
        let render = move |model: &Relighter| {
            let quick = engine.plain.as_ref().filter(|_| side < engine.side());
            let model = quick.unwrap_or(model);
            let images = match model.config.output {
                Output::Radiance => model.render_radiance(&tokens, &cameras)?,
                Output::Display => {
                    let images = model.render(&tokens, &cameras)?;
                    images.iter().map(DisplayImage::to_linear).collect()
                }
            };
            engine.looked_at(tokens);
            Ok(images)
        };
        self.run(render).await
    }

    /// Notes that tokens were rendered; those that were not for longest give their preparation back.
    fn looked_at(&self, tokens: Arc<SceneTokens>) {
        let mut looked_at = self
            .looked_at
            .lock()
            .unwrap_or_else(PoisonError::into_inner);
        looked_at.retain(|other| !Arc::ptr_eq(other, &tokens));
        looked_at.push_back(tokens);
        while looked_at.len() > PREPARED {
            if let Some(oldest) = looked_at.pop_front() {
                oldest.forget_prepared();
            }
        }
    }

    /// Runs a job when its turn comes; the time it waited is not counted. The permit stays with the job: a client that
    /// leaves drops this future, and the model runs on.
    async fn run<T: Send + 'static>(
        self: &Arc<Self>,
        job: impl FnOnce(&Relighter) -> Result<T> + Send + 'static,
    ) -> Result<(T, f32)> {
        let closed = |_| Error::Busy("the server is shutting down".into());
        let permit = Arc::clone(&self.permits).acquire_owned().await;
        let permit = permit.map_err(closed)?;
        let engine = Arc::clone(self);
        let timed = move || {
            let _permit = permit;
            let started = Instant::now();
            job(&engine.model).map(|done| (done, started.elapsed().as_secs_f32()))
        };
        tokio::task::spawn_blocking(timed).await?
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use burn::tensor::Device;
    use lumi_core::Seed;
    use lumi_model::ModelConfig;
    use std::sync::mpsc;

    #[test]
    fn a_client_that_leaves_frees_no_permit_while_the_model_runs() {
        let config = ModelConfig::preset("nano").expect("nano");
        let engine = Engine::new(Relighter::random(&config, Seed(1), &Device::flex()));
        let all = engine.permits.available_permits();
        let runtime = tokio::runtime::Runtime::new().expect("runtime");
        let (started, running) = mpsc::channel();
        let (finish, finished) = mpsc::channel::<()>();
        let job = move |_: &Relighter| {
            started.send(()).expect("the test waits");
            finished.recv().expect("the test tells");
            Ok(())
        };
        let own = Arc::clone(&engine);
        let client = runtime.spawn(async move { own.run(job).await });
        running.recv().expect("the job has begun");
        client.abort();
        assert!(runtime.block_on(client).is_err(), "the client has left");
        assert_eq!(engine.permits.available_permits(), all - 1);
        finish.send(()).expect("the job waits");
        drop(runtime); // Waits for the job.
        assert_eq!(engine.permits.available_permits(), all);
    }
}
