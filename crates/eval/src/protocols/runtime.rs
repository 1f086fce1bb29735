//! Protocol `runtime`: how long one object takes under a new light, seen from many new views, and how much memory.

use crate::Result;
use crate::cases::Subject;
use lumi_core::{Event, Progress, memory};
use lumi_data::Orbit;
use lumi_model::{Edit, Relighter};
use serde::{Deserialize, Serialize};
use std::time::Instant;

/// What was measured. Times are medians over the repeats, in seconds.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct RuntimeReport {
    /// [`crate::report::SCHEMA`].
    pub schema: String,
    /// `runtime`.
    pub protocol: String,
    /// Fingerprint and origin, or the preset.
    pub model: String,
    /// Whether the weights are random: times mean the same, pictures nothing.
    pub random_weights: bool,
    /// Data set and object.
    pub data: String,
    /// Side of the images in pixels.
    pub resolution: usize,
    /// Input views.
    pub inputs: usize,
    /// New views that were rendered.
    pub views: usize,
    /// Times each part was run after one run that does not count.
    pub repeats: usize,
    /// From pixels to all new views: encode, edit, render.
    pub end_to_end: f64,
    /// From existing tokens to all new views: edit, render.
    pub relight_only: f64,
    /// Encoding the inputs.
    pub encode: f64,
    /// The edit.
    pub edit: f64,
    /// Rendering all new views.
    pub render: f64,
    /// Rendering, per view.
    pub render_per_view: f64,
    /// Largest resident memory of the process during the runs, in bytes; where the system says it.
    pub peak_cpu_memory: Option<u64>,
    /// Largest memory on the accelerator; `None` where nobody says it, as Burn does not.
    pub peak_gpu_memory: Option<u64>,
    /// Instruction set, threads.
    pub device: String,
    /// What a reader should know.
    pub notes: Vec<String>,
}

/// Renders `views` new views, on a circle around the object, of the first target lighting.
///
/// # Errors
/// If the model refuses the object's views or lights.
pub fn run(
    model: &Relighter,
    subject: &Subject,
    views: usize,
    repeats: usize,
    progress: &dyn Progress,
) -> Result<RuntimeReport> {
    let first = subject.targets.first();
    let first = first.ok_or_else(|| lumi_core::Error::value("targets", "expected at least one"))?;
    let target = subject.target(first)?;
    let edit = Edit::set(target.lights_of(0));
    let orbit = Orbit::along(&target.cameras, &subject.to_model);
    let cameras = orbit.cameras(views, model.side(), &subject.to_model);
    let mut samples: [Vec<f64>; 3] = Default::default();
    let whole_run = memory::reset_peak();
    progress.event(Event::Begin {
        stage: format!("{views} views"),
        total: repeats as u64 + 1,
    });
    for i in 0..=repeats {
        let started = Instant::now();
        let tokens = subject.encode(model)?;
        model.wait()?;
        let encoded = started.elapsed().as_secs_f64();
        let edited = model.edit(&tokens, &edit)?;
        model.wait()?;
        let after_edit = started.elapsed().as_secs_f64();
        let images = model.render(&edited, &cameras)?;
        let all = started.elapsed().as_secs_f64();
        debug_assert_eq!(images.len(), views);
        // The first run fills caches and settles memory; with one repeat asked for, it still does not count.
        if i > 0 {
            let times = [encoded, after_edit - encoded, all - after_edit];
            samples.iter_mut().zip(times).for_each(|(s, t)| s.push(t));
        }
        progress.event(Event::Step {
            done: i as u64 + 1,
            note: format!("{all:.2} s"),
        });
    }
    progress.event(Event::End);
    let [encode, edit, render] = samples.map(median);
    let mut notes = Vec::new();
    if !whole_run {
        notes.push("peak memory counts from the start of the process".to_owned());
    }
    Ok(RuntimeReport {
        schema: crate::report::SCHEMA.to_owned(),
        protocol: "runtime".to_owned(),
        resolution: model.side(),
        inputs: subject.inputs.len(),
        views,
        repeats,
        end_to_end: encode + edit + render,
        relight_only: edit + render,
        encode,
        edit,
        render,
        render_per_view: render / views.max(1) as f64,
        peak_cpu_memory: memory::peak(),
        notes,
        ..RuntimeReport::default()
    })
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(f64::NAN)
}
