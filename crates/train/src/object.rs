//! An object to draw samples from: it reads the pictures that a sample needs, and no others.

use half::f16;
use lumi_core::seed::Rng;
use lumi_core::{Camera, Error, LinearImage, NamedLight, Result};
use lumi_data::downscale;
use lumi_data::store::{LightKind, RecordReader, compose};
use rand::RngExt;
use rand::seq::SliceRandom;
use std::collections::HashMap;
use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

/// Lights of a record, all of one kind, that count as one: each with its gain per channel.
#[derive(Clone, Debug, PartialEq)]
pub struct Mixture {
    /// One, or several environments, which add up to an environment.
    pub parts: Vec<(usize, [f32; 3])>,
}

/// What lights an object.
pub type Lighting = Vec<Mixture>;

/// Bytes that a run's objects may still keep in memory together.
///
/// What is read is kept until they are used up, and then nothing more is: samples are drawn evenly, so that what was
/// used last is no likelier to be wanted next, and forgetting it would gain nothing.
pub struct Budget(AtomicUsize);

impl Budget {
    /// So many bytes.
    #[must_use]
    pub fn new(bytes: usize) -> Arc<Self> {
        Arc::new(Self(AtomicUsize::new(bytes)))
    }

    fn take(&self, bytes: usize) -> bool {
        let take = |left: usize| left.checked_sub(bytes);
        let order = Ordering::Relaxed;
        self.0.fetch_update(order, order, take).is_ok()
    }
}

/// A record at the training resolution.
pub struct Object {
    reader: RecordReader,
    /// At the training resolution.
    cameras: Vec<Camera>,
    /// Stored pixels each way that become one.
    factor: usize,
    /// Lights by kind: environments, points, areas.
    kinds: [Vec<usize>; 3],
    budget: Arc<Budget>,
    pictures: Mutex<HashMap<Picture, Arc<[f16]>>>,
    lights: Mutex<HashMap<usize, NamedLight>>,
}

/// The place of environments among the kinds.
const ENVIRONMENTS: usize = 0;

#[derive(Clone, Copy, PartialEq, Eq, Hash)]
enum Picture {
    Radiance(usize, usize),
    Alpha(usize),
    Albedo(usize),
}

impl Object {
    /// Opens a record to be shown at `resolution`.
    ///
    /// # Errors
    /// If it cannot be opened or reduced to that size, or lacks a kind of light, without which samples of a batch could not
    /// bring equally many.
    pub fn open(path: &Path, resolution: usize, budget: &Arc<Budget>) -> Result<Self> {
        let reader = RecordReader::open(path)?;
        let first = reader.cameras()[0];
        let factor = downscale::factor((first.width, first.height), resolution);
        let factor = factor.map_err(|e| e.at(path))?;
        let cameras = reader.cameras().iter();
        let cameras = cameras.map(|c| c.resized(resolution, resolution)).collect();
        let mut kinds = [Vec::new(), Vec::new(), Vec::new()];
        for (i, kind) in reader.kinds().enumerate() {
            let kind = match kind {
                LightKind::Environment => 0,
                // As many rays as a point light.
                LightKind::Point | LightKind::Spot | LightKind::Sun => 1,
                LightKind::Area => 2,
            };
            kinds[kind].push(i);
        }
        if kinds.iter().any(Vec::is_empty) {
            let found = kinds.map(|k| k.len());
            let expected = format!(
                "expected at least one environment, point and area light, found {found:?} of them"
            );
            return Err(Error::invalid(path, "lights", expected));
        }
        Ok(Self {
            reader,
            cameras,
            factor,
            kinds,
            budget: Arc::clone(budget),
            pictures: Mutex::default(),
            lights: Mutex::default(),
        })
    }

    /// The record's name.
    #[must_use]
    pub fn name(&self) -> &str {
        self.reader.name()
    }

    /// One camera per view, at the training resolution.
    #[must_use]
    pub fn cameras(&self) -> &[Camera] {
        &self.cameras
    }

    /// Whether its views' base colour is known.
    #[must_use]
    pub fn has_albedo(&self) -> bool {
        self.reader.has_albedo()
    }

    /// A light.
    ///
    /// # Errors
    /// If it cannot be read.
    pub fn light(&self, index: usize) -> Result<NamedLight> {
        let lock = || self.lights.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(light) = lock().get(&index) {
            return Ok(light.clone());
        }
        let light = self.reader.light(index)?;
        let bytes = match &light.light {
            lumi_core::Light::Environment(e) => size_of_val(&e.map.pixels[..]),
            _ => size_of::<NamedLight>(),
        };
        if self.budget.take(bytes) {
            lock().insert(index, light.clone());
        }
        Ok(light)
    }

    fn picture(&self, which: Picture) -> Result<Arc<[f16]>> {
        let lock = || self.pictures.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(picture) = lock().get(&which) {
            return Ok(Arc::clone(picture));
        }
        let (values, channels) = match which {
            Picture::Radiance(light, view) => (self.reader.radiance(light, view)?, 3),
            Picture::Alpha(view) => (self.reader.alpha(view)?, 1),
            Picture::Albedo(view) => (self.reader.albedo(view)?, 3),
        };
        let width = self.reader.cameras()[0].width;
        let picture: Arc<[f16]> = downscale::reduced(&values, width, self.factor, channels).into();
        if self.budget.take(size_of_val(&picture[..])) {
            lock().insert(which, Arc::clone(&picture));
        }
        Ok(picture)
    }

    /// The radiance of `view` under a lighting.
    ///
    /// # Errors
    /// If a picture cannot be read.
    pub fn lit(&self, view: usize, lighting: &Lighting) -> Result<LinearImage> {
        let pictures = lighting
            .iter()
            .flat_map(|mixture| &mixture.parts)
            .map(|&(light, gain)| Ok((self.picture(Picture::Radiance(light, view))?, gain)))
            .collect::<Result<Vec<_>>>()?;
        self.shown(view, &pictures)
    }

    /// The base colour in `view`.
    ///
    /// # Errors
    /// If the picture cannot be read, or the record has none.
    pub fn albedo(&self, view: usize) -> Result<LinearImage> {
        let albedo = self.picture(Picture::Albedo(view))?;
        self.shown(view, &[(albedo, [1.0; 3])])
    }

    fn shown(&self, view: usize, pictures: &[(Arc<[f16]>, [f32; 3])]) -> Result<LinearImage> {
        let camera = &self.cameras[view];
        let alpha = self.picture(Picture::Alpha(view))?;
        let pictures: Vec<_> = pictures.iter().map(|(p, gain)| (&p[..], *gain)).collect();
        Ok(compose((camera.width, camera.height), &alpha, &pictures))
    }

    /// Mean luminance of the object's pixels in `views`, of one kind of picture.
    fn mean(&self, views: &[usize], kind: impl Fn(usize) -> Picture) -> Result<f32> {
        let (mut sum, mut coverage) = (0.0, 0.0);
        for &view in views {
            let picture = self.picture(kind(view))?;
            sum += picture.chunks_exact(3).map(luminance).sum::<f32>();
            let alpha = self.picture(Picture::Alpha(view))?;
            coverage += alpha.iter().map(|a| a.to_f32()).sum::<f32>();
        }
        Ok(sum / coverage.max(1.0))
    }

    /// Mean luminance in `views` under one light alone.
    fn brightness(&self, light: usize, views: &[usize]) -> Result<f32> {
        let mean = self.mean(views, |view| Picture::Radiance(light, view))?;
        Ok(mean.max(1e-4))
    }

    /// Mean luminance of the base colour in `views`, where it is known.
    fn reflectance(&self, views: &[usize]) -> Result<Option<f32>> {
        let known = self.has_albedo();
        known.then(|| self.mean(views, Picture::Albedo)).transpose()
    }

    /// The light of the inputs: usually an environment, as captures have it, and exposed and balanced as cameras do it: one that
    /// meters what is around the object shows a white object bright and a dark one dark, one that meters the object shows both alike.
    ///
    /// # Errors
    /// As [`Self::draw_lights`].
    pub fn draw_source(&self, views: &[usize], augment: bool, rng: &mut Rng) -> Result<Lighting> {
        let counts = match rng.random::<f32>() {
            u if u < 0.65 => [1, 0, 0],
            u if u < 0.85 => [1, 1, 0],
            u if u < 0.93 => [0, 0, 1],
            _ => [0, 2, 0],
        };
        let exposure = rng.random::<f32>();
        let metered = rng.random::<bool>();
        let total = match self.reflectance(views)? {
            Some(mean) if !metered => (mean * between(SHADE, exposure)).clamp(0.02, 0.8),
            _ => between(EXPOSED, exposure),
        };
        let look = Look {
            total,
            darkest: [0.75, 0.5],
        };
        self.draw_looking(counts, views, augment, &look, rng)
    }

    /// The last lights of each kind in a lighting: those that came last.
    #[must_use]
    pub fn of_kinds(&self, lighting: &Lighting, counts: [usize; 3]) -> Lighting {
        let mut chosen = Lighting::new();
        for (kind, count) in self.kinds.iter().zip(counts) {
            let is =
                |mixture: &&Mixture| mixture.parts.iter().any(|(light, _)| kind.contains(light));
            chosen.extend(lighting.iter().rev().filter(is).take(count).cloned());
        }
        chosen
    }

    /// Different lights of each kind, with gains such that the object's mean luminance in `views` is between 0.06 and 0.5,
    /// shared between the lights at random. With `augment`, half of the lights are tinted, and half of the environments are
    /// two in one, so that an object has more of them than were rendered.
    ///
    /// # Errors
    /// If a picture cannot be read.
    pub fn draw_lights(
        &self,
        counts: [usize; 3],
        views: &[usize],
        augment: bool,
        rng: &mut Rng,
    ) -> Result<Lighting> {
        let look = Look {
            total: between(EXPOSED, rng.random()),
            // Environments are seldom as colourful as lamps.
            darkest: [0.4, 0.15],
        };
        self.draw_looking(counts, views, augment, &look, rng)
    }

    fn draw_looking(
        &self,
        counts: [usize; 3],
        views: &[usize],
        augment: bool,
        look: &Look,
        rng: &mut Rng,
    ) -> Result<Lighting> {
        let mut chosen = Vec::new();
        for (kind, (all, &count)) in self.kinds.iter().zip(&counts).enumerate() {
            let mut all = all.clone();
            all.shuffle(rng);
            // A record with too few lights of a kind repeats one.
            let at = |i: usize| all[i % all.len()];
            for i in 0..count {
                let two = augment && kind == ENVIRONMENTS && all.len() > 1 && rng.random::<bool>();
                let parts = if two {
                    vec![at(i), at(i + 1)]
                } else {
                    vec![at(i)]
                };
                let darkest = look.darkest[usize::from(kind != ENVIRONMENTS)];
                chosen.push((parts, darkest, 0.15 + rng.random::<f32>()));
            }
        }
        let sum: f32 = chosen.iter().map(|(.., share)| share).sum();
        let mut lighting = Lighting::new();
        for (lights, darkest, share) in chosen {
            let mut shares: Vec<f32> = lights.iter().map(|_| 0.15 + rng.random::<f32>()).collect();
            let whole: f32 = shares.iter().sum();
            shares.iter_mut().for_each(|part| *part *= share / whole);
            let mut parts = Vec::new();
            for (light, share) in lights.into_iter().zip(shares) {
                let gain = (look.total * share / sum / self.brightness(light, views)?).min(50.0);
                let tint = if augment {
                    draw_tint(darkest, rng)
                } else {
                    [1.0; 3]
                };
                let tint = tint.map(|t| t * gain);
                parts.push((light, tint));
            }
            lighting.push(Mixture { parts });
        }
        Ok(lighting)
    }
}

/// What lights are to make of an object.
struct Look {
    /// Its mean luminance.
    total: f32,
    /// Least channel of tints over the strongest, of environments and of lamps.
    darkest: [f32; 2],
}

/// Least and greatest mean luminance of an object.
const EXPOSED: [f32; 2] = [0.06, 0.5];
/// The same over that of its base colour, under the light of a capture.
const SHADE: [f32; 2] = [0.4, 1.1];

/// A value of a range by its share of the way, in equal factors.
fn between([least, most]: [f32; 2], share: f32) -> f32 {
    least * (most / least).powf(share)
}

/// White half of the time, else a colour of which no channel is under `darkest` of the strongest.
fn draw_tint(darkest: f32, rng: &mut Rng) -> [f32; 3] {
    if rng.random::<bool>() {
        return [1.0; 3];
    }
    let tint = [(); 3].map(|()| darkest + (1.0 - darkest) * rng.random::<f32>());
    let most = tint[0].max(tint[1]).max(tint[2]);
    tint.map(|t| t / most)
}

fn luminance(rgb: &[f16]) -> f32 {
    0.2126 * rgb[0].to_f32() + 0.7152 * rgb[1].to_f32() + 0.0722 * rgb[2].to_f32()
}
