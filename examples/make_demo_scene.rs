//! Makes `assets/demo` from the evaluation set: the public-domain object `spot`, its environment maps
//! averaged down to 128×64 so that the scene stays small, and its manifest entry.
//!
//! `cargo run --release --example make_demo_scene -- ../shared/data/cycles assets/demo`

use anyhow::{Context, Result};
use lumi_core::Light;
use std::path::PathBuf;
use std::sync::Arc;

fn main() -> Result<()> {
    let mut args = std::env::args_os().skip(1).map(PathBuf::from);
    let (from, to) = (
        args.next().context("source folder")?,
        args.next().context("target folder")?,
    );
    let mut scene = lumi_data::open(from.join("spot"))?;
    for named in scene.basis.iter_mut().flat_map(|b| &mut b.lights) {
        if let Light::Environment(light) = &mut named.light {
            light.map = Arc::new(light.map.prefiltered(64, 128));
        }
    }
    lumi_data::formats::interchange::write(&to.join("spot"), &scene)?;
    let text = std::fs::read_to_string(from.join("manifest.json"))?;
    let mut manifest: serde_json::Value = serde_json::from_str(&text)?;
    if let Some(objects) = manifest["objects"].as_object_mut() {
        objects.retain(|name, _| name == "spot");
    }
    std::fs::write(
        to.join("manifest.json"),
        serde_json::to_string_pretty(&manifest)? + "\n",
    )?;
    Ok(())
}
