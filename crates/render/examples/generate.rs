//! Generates a training set: `generate OUT_DIR --config FILE --hdri DIR --models DIR --shard i/n`, or with the options
//! one by one; those after `--config` change what it says.

use anyhow::{Context, bail};
use lumi_core::{Event, Progress};
use lumi_render::generate::{Backend, GenerateConfig, generate};
use std::path::PathBuf;
use std::time::Instant;

/// Prints every hundredth part of the work, at least every object of a small set.
struct Lines {
    start: Instant,
    total: std::sync::atomic::AtomicU64,
}

impl Progress for Lines {
    fn event(&self, event: Event) {
        use std::sync::atomic::Ordering::Relaxed;
        match event {
            Event::Begin { stage, total } => {
                self.total.store(total, Relaxed);
                println!("{stage}: {total}");
            }
            Event::Step { done, note } => {
                let total = self.total.load(Relaxed);
                if done % (total / 100).max(1) == 0 || done == total {
                    let seconds = self.start.elapsed().as_secs_f64();
                    println!("{done}/{total} {note} {:.2} s each", seconds / done as f64);
                }
            }
            Event::End => println!("done in {:.1} s", self.start.elapsed().as_secs_f64()),
            Event::Picture { .. } => {}
            Event::Warning(text) => println!("warning: {text}"),
        }
    }
}

fn main() -> anyhow::Result<()> {
    let mut arguments = std::env::args().skip(1);
    let mut out = None;
    let mut config = GenerateConfig::default();
    while let Some(argument) = arguments.next() {
        if !argument.starts_with("--") {
            out = Some(PathBuf::from(argument));
            continue;
        }
        let value = arguments
            .next()
            .with_context(|| format!("{argument} needs a value"))?;
        match argument.as_str() {
            "--config" => {
                let text = std::fs::read_to_string(&value).with_context(|| value.clone())?;
                config = toml::from_str(&text).with_context(|| value.clone())?;
            }
            "--objects" => config.objects = value.parse()?,
            "--first" => config.first = value.parse()?,
            "--resolution" => config.resolution = value.parse()?,
            "--spp" => config.samples = value.parse()?,
            "--light-samples" => config.light_samples = value.parse()?,
            "--views" => config.views = value.parse()?,
            "--seed" => config.seed = value.parse()?,
            "--hdri" => config.hdri = Some(value.into()),
            "--hdri-share" => config.hdri_share = value.parse()?,
            "--models" => config.models = Some(value.into()),
            "--model-share" => config.model_share = value.parse()?,
            "--scene-share" => config.scene_share = value.parse()?,
            "--filled-share" => config.filled_share = value.parse()?,
            "--denoise" => config.denoise = value.parse()?,
            "--shard" => {
                let (i, n) = value.split_once('/').context("--shard i/n")?;
                config.shard = [i.parse()?, n.parse()?];
            }
            _ => bail!("unknown option {argument}"),
        }
    }
    let out = out.context("usage: generate OUT_DIR [--config FILE] [--objects N] [--first K] [--shard i/n] [--resolution R] [--spp N] [--views N] [--hdri DIR] [--hdri-share P] [--models DIR] [--model-share P] [--scene-share P] [--filled-share P] [--seed S]")?;
    let lines = Lines {
        start: Instant::now(),
        total: 0.into(),
    };
    let summary = generate(&config, &Backend::Native, &out, &lines)?;
    println!(
        "{} rendered, {} were there",
        summary.rendered, summary.skipped
    );
    Ok(())
}
