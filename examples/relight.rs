//! The README's library example: the bundled scene under one lamp, seen from its input views.
//!
//! `cargo run --release --example relight -- out/relit`

use lumi_core::glam::Vec3;
use lumi_core::{Camera, Light, Point, image};
use lumi_model::{Device, Edit, Relighter};
use std::path::PathBuf;

fn main() -> anyhow::Result<()> {
    let folder = std::env::args_os()
        .nth(1)
        .map_or("out/relit".into(), PathBuf::from);
    // What the README shows.
    let model = Relighter::load("assets/lumi-mini.safetensors", &Device::flex())?;
    let scene = lumi_data::open("assets/demo/spot")?;
    let inputs = lumi_data::spread_inputs(&scene, 8, None, model.side())?;
    let captured = model.encode(&inputs, scene.to_model)?;
    let lamp = Point::new(Vec3::new(1.0, -2.0, 3.0), 800.0);
    let relit = model.edit(&captured, &Edit::set([Light::Point(lamp)]))?;
    let cameras: Vec<Camera> = inputs.iter().map(|view| view.camera).collect();
    let images = model.render(&relit, &cameras)?;
    // That is all.
    std::fs::create_dir_all(&folder)?;
    for (view, image) in inputs.iter().zip(&images) {
        image::write_png(folder.join(format!("{}.png", view.name)), image)?;
    }
    Ok(())
}
