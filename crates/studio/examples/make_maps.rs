//! Made the bundled environment maps: Poly Haven's (CC0) at 192×96 pixels in half floats, energy kept.
//!
//! `cargo run --release -p lumi-studio --example make_maps -- OUT IN.hdr..`

use lumi_core::{EnvMap, image::write_exr};
use std::path::Path;

fn main() -> lumi_core::Result<()> {
    let mut files = std::env::args().skip(1);
    let out = files.next().unwrap_or_else(|| ".".into());
    for file in files {
        let map = EnvMap::read(&file)?.prefiltered(96, 192);
        let name = Path::new(&file).with_extension("exr");
        write_exr(
            Path::new(&out).join(name.file_name().unwrap_or_default()),
            &map.to_image(),
        )?;
    }
    Ok(())
}
