//! Whole data sets: seeded objects, cameras and lights, one record per object.

mod assets;
mod config;
mod job;
mod library;

pub use assets::{Assets, Failed, held_out};
pub use config::{GenerateConfig, Split};
pub use job::Job;
pub use library::Library;

use crate::cycles::Cycles;
use crate::film::{RenderSettings, render};
use crate::integrator::PathSettings;
use crate::scene::Geometry;
use lumi_core::{Error, Event, Progress, Result};
use lumi_data::store::{self, ObjectRecord};
use rayon::prelude::*;
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};

/// Who renders.
#[derive(Clone, Debug, Default)]
pub enum Backend {
    /// Our path tracer, on all threads.
    #[default]
    Native,
    /// Blender, one object after the other; it uses all threads itself.
    Cycles(Cycles),
}

/// What a finished run did.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Summary {
    /// Objects rendered now.
    pub rendered: u64,
    /// Objects that were already there.
    pub skipped: u64,
    /// Maps and models that were drawn and could not be read, sorted by path; others took their place.
    pub failed: Vec<Failed>,
}

impl Backend {
    /// The record of a job.
    ///
    /// # Errors
    /// If the result is not a valid record, which would be a bug, or Blender fails.
    pub fn render(&self, job: Job, config: &GenerateConfig) -> Result<ObjectRecord> {
        let (basis, albedo) = match self {
            Self::Native => {
                let settings = RenderSettings {
                    samples: config.samples,
                    paths: PathSettings {
                        light_samples: config.light_samples,
                        ..PathSettings::default()
                    },
                    denoise: config.denoise,
                };
                let geometry = Geometry::new(job.model);
                let made = render(&geometry, job.lights, &job.cameras, &settings, job.pixels);
                let albedo = made.guides.into_iter().map(|g| g.albedo).collect();
                (made.basis, albedo)
            }
            Self::Cycles(cycles) => {
                let made = cycles.render(&job, config.samples, config.denoise)?;
                (made.basis, made.albedo)
            }
        };
        ObjectRecord::pack(&job.name, job.cameras, &basis)?.with_albedo(&albedo)
    }
}

impl GenerateConfig {
    /// Object `index` rendered under all of its lights by our path tracer.
    ///
    /// # Errors
    /// If it shows a model and none can be read; or if the result is not a valid record, which would be a bug.
    pub fn object(&self, index: usize, assets: &Assets) -> Result<ObjectRecord> {
        Backend::Native.render(self.job(index, assets)?, self)
    }
}

/// Generates the objects of this shard into the Zarr store `out`, a folder or a URL (see [`store`]); those that are
/// already there, of either kind, are left alone, so an interrupted run continues where it stopped. Files that cannot be
/// read are passed over and listed in the summary.
///
/// # Errors
/// On a wrong config, a folder without a file that can be read, or a store that cannot be written.
pub fn generate(
    config: &GenerateConfig,
    backend: &Backend,
    out: &Path,
    progress: &dyn Progress,
) -> Result<Summary> {
    config.validate()?;
    let assets = Assets::load(config)?;
    let [shard, shards] = config.shard;
    let indices: Vec<usize> = (config.first..config.first + config.objects)
        .filter(|i| i % shards == shard)
        .collect();
    progress.event(Event::Begin {
        stage: "rendering objects".to_owned(),
        total: indices.len() as u64,
    });
    let (done, skipped) = (AtomicU64::new(0), AtomicU64::new(0));
    let make = |&index: &usize| {
        let name = GenerateConfig::object_name(index);
        if store::holds(out, &name)? {
            skipped.fetch_add(1, Ordering::Relaxed);
        } else {
            let job = config.job(index, &assets)?;
            for warning in assets.models.take_warnings() {
                progress.event(Event::Warning(warning));
            }
            let record = backend.render(job, config)?;
            record.write(&out.join(&name))?;
        }
        let done = done.fetch_add(1, Ordering::Relaxed) + 1;
        progress.event(Event::Step { done, note: name });
        Ok::<(), Error>(())
    };
    match backend {
        Backend::Native => indices.par_iter().with_max_len(1).try_for_each(make)?,
        Backend::Cycles(_) => indices.iter().try_for_each(make)?,
    }
    progress.event(Event::End);
    let skipped = skipped.into_inner();
    Ok(Summary {
        rendered: done.into_inner() - skipped,
        skipped,
        failed: assets.failed(),
    })
}
