//! `lumi dataset`: light-basis data to train on.

use crate::progress::Terminal;
use anyhow::{Context, Result};
use lumi_render::cycles::Cycles;
use lumi_render::generate::{Backend, GenerateConfig, generate};
use std::path::PathBuf;
use std::process::ExitCode;

/// Make data sets
#[derive(clap::Args)]
pub struct Args {
    #[command(subcommand)]
    command: Command,
}

#[derive(clap::Subcommand)]
enum Command {
    /// Render objects one light at a time; finished objects are kept, so a stopped run goes on
    Generate(Generate),
}

#[derive(clap::Args)]
struct Generate {
    /// Recipe (TOML, see configs/data); the options below override it
    recipe: Option<PathBuf>,
    /// Folder for the objects
    #[arg(long)]
    out: PathBuf,
    /// Number of objects
    #[arg(long)]
    objects: Option<usize>,
    /// Seed
    #[arg(long)]
    seed: Option<u64>,
    /// Side of the images in pixels
    #[arg(long)]
    resolution: Option<usize>,
    /// Folder of .hdr maps
    #[arg(long)]
    hdri: Option<PathBuf>,
    /// Folder of .glb, .gltf and .obj models to mix in
    #[arg(long)]
    models: Option<PathBuf>,
    /// Render part I of N, as I/N with I from 0
    #[arg(long, value_parser = shard)]
    shard: Option<[usize; 2]>,
    /// Who renders
    #[arg(long, value_enum, default_value = "native")]
    backend: BackendName,
    /// Python interpreter that has Blender's module (pip install "bpy==4.5.*"), for --backend cycles
    #[arg(long, default_value = "python3")]
    python: PathBuf,
}

#[derive(Clone, Copy, clap::ValueEnum)]
enum BackendName {
    /// Our path tracer
    Native,
    /// Blender's Cycles
    Cycles,
}

fn shard(text: &str) -> Result<[usize; 2], String> {
    let parse = |t: &str| t.parse::<usize>().ok();
    let parts = text
        .split_once('/')
        .and_then(|(i, n)| Some([parse(i)?, parse(n)?]));
    match parts {
        Some([i, n]) if i < n => Ok([i, n]),
        _ => Err("expected I/N with I from 0 to N−1, such as 0/4".into()),
    }
}

pub fn run(args: &Args) -> Result<ExitCode> {
    let Command::Generate(args) = &args.command;
    let mut config = match &args.recipe {
        None => GenerateConfig::default(),
        Some(path) => {
            let text = std::fs::read_to_string(path).with_context(|| path.display().to_string())?;
            toml::from_str(&text).with_context(|| path.display().to_string())?
        }
    };
    config.objects = args.objects.unwrap_or(config.objects);
    config.seed = args.seed.unwrap_or(config.seed);
    config.resolution = args.resolution.unwrap_or(config.resolution);
    config.shard = args.shard.unwrap_or(config.shard);
    config.hdri = args.hdri.clone().or(config.hdri);
    config.models = args.models.clone().or(config.models);
    let backend = match args.backend {
        BackendName::Native => Backend::Native,
        BackendName::Cycles => Backend::Cycles(Cycles::new(&args.python)),
    };
    let summary = generate(&config, &backend, &args.out, &Terminal::new())?;
    println!(
        "rendered {} objects, {} were there already",
        summary.rendered, summary.skipped
    );
    Ok(ExitCode::SUCCESS)
}
