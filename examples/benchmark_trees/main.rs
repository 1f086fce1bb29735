//! Makes data sets in the published layouts of Stanford-ORB and Objects with Lighting from one rendered object, to
//! try `lumi eval` on without the real downloads. Tests make theirs with the same code.
//!
//! `cargo run --release --example benchmark_trees -- assets/demo/spot out/trees`

mod trees;

use anyhow::{Context, Result};
use std::path::PathBuf;

fn main() -> Result<()> {
    let mut args = std::env::args_os().skip(1).map(PathBuf::from);
    let from = args.next().context("expected the folder of an object")?;
    let to = args.next().context("expected a folder to write to")?;
    let scene = lumi_data::open(from)?;
    trees::stanford_orb(&scene, &to.join("stanford-orb"))?;
    trees::objects_with_lighting(&scene, &to.join("objects-with-lighting"))?;
    println!(
        "wrote {0}/stanford-orb/blender_LDR, blender_HDR and {0}/objects-with-lighting/dataset",
        to.display()
    );
    Ok(())
}
