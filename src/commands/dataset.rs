//! `lumi dataset`: light-basis data to train on.

use crate::output::{say, say_aside};
use crate::progress::Terminal;
use anyhow::{Context, Result, bail};
use lumi_data::store::{self, ObjectRecord};
use lumi_render::cycles::Cycles;
use lumi_render::generate::{Backend, GenerateConfig, generate};
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// Make data sets, look at them, put them together
#[derive(clap::Args)]
pub struct Args {
    #[command(subcommand)]
    command: Command,
}

#[derive(clap::Subcommand)]
enum Command {
    /// Render objects one light at a time; finished objects are kept, so a stopped run goes on
    Generate(Generate),
    /// Read every record, which checks its checksums, and say what the set holds; exit status 1 if one is damaged
    Inspect {
        /// Folder of records, or s3://BUCKET/FOLDER
        store: PathBuf,
        /// Draw records on a page, as PNG
        #[arg(long)]
        picture: Option<PathBuf>,
        /// Number of records on the page, evenly spread over the set
        #[arg(long, default_value_t = 12)]
        shown: usize,
    },
    /// Copy records of one or more sets into one; what is there already stays, so a stopped run goes on
    Pack {
        /// Folders of records, or s3://BUCKET/FOLDER
        #[arg(required = true)]
        from: Vec<PathBuf>,
        /// Folder for the records, or s3://BUCKET/FOLDER
        #[arg(long)]
        out: PathBuf,
        /// Write one safetensors file per record instead of a Zarr group
        #[arg(long)]
        files: bool,
        /// Average the images down to this many pixels a side
        #[arg(long)]
        resolution: Option<usize>,
    },
}

#[derive(clap::Args)]
struct Generate {
    /// Recipe (TOML, see configs/data); the options below override it
    recipe: Option<PathBuf>,
    /// Folder for the objects, or s3://BUCKET/FOLDER
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
    /// Folder of .glb, .gltf and .obj models to mix in, searched with its subfolders
    #[arg(long)]
    models: Option<PathBuf>,
    /// Exit with status 1 if a model or map could not be read; others take its place either way
    #[arg(long)]
    strict: bool,
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
    match &args.command {
        Command::Generate(args) => run_generate(args),
        Command::Inspect {
            store,
            picture,
            shown,
        } => inspect(store, picture.as_deref(), *shown),
        Command::Pack {
            from,
            out,
            files,
            resolution,
        } => pack(from, out, *files, *resolution),
    }
}

/// Reads one record after the other; of the whole set only counts are kept.
fn inspect(folder: &Path, picture: Option<&Path>, shown: usize) -> Result<ExitCode> {
    let paths = store::list(folder)?;
    let step = paths.len().div_ceil(shown.max(1)).max(1);
    let (mut views, mut lights, mut damaged) = (0, 0, 0);
    let (mut sizes, mut on_page) = (BTreeSet::new(), Vec::new());
    for (i, path) in paths.iter().enumerate() {
        let record = match ObjectRecord::read(path) {
            Ok(record) => record,
            Err(error) => {
                say_aside!("{error}");
                damaged += 1;
                continue;
            }
        };
        views += record.cameras.len();
        lights += record.lights.len();
        sizes.insert(record.size());
        if picture.is_some() && i % step == 0 {
            on_page.push(record);
        }
    }
    let sizes: Vec<_> = sizes.iter().map(|(w, h)| format!("{w}×{h}")).collect();
    say!(
        "{} records, {damaged} damaged; {views} views, {lights} lights; {}",
        paths.len(),
        sizes.join(", ")
    );
    if let Some(path) = picture {
        let title = format!("{} of {} records", on_page.len(), paths.len());
        lumi_core::image::write_png(path, &store::sheet(&title, &on_page)?)?;
    }
    Ok(if damaged > 0 || paths.is_empty() {
        ExitCode::FAILURE
    } else {
        ExitCode::SUCCESS
    })
}

fn pack(from: &[PathBuf], out: &Path, files: bool, resolution: Option<usize>) -> Result<ExitCode> {
    let (mut seen, mut copied, mut kept) = (BTreeSet::new(), 0, 0);
    for folder in from {
        for path in store::list(folder)? {
            // A group's name may hold a dot; only a file's extension goes.
            let stem = if path.extension().is_some_and(|e| e == store::EXTENSION) {
                path.file_stem()
            } else {
                path.file_name()
            };
            let stem = stem.unwrap_or_default().to_string_lossy();
            if !seen.insert(stem.to_string()) {
                bail!("record `{stem}`: expected names that differ, found it in two sets");
            }
            let name = if files {
                format!("{stem}.{}", store::EXTENSION)
            } else {
                stem.to_string()
            };
            let target = out.join(name);
            if store::holds(out, &stem)? {
                kept += 1;
                continue;
            }
            let mut record = ObjectRecord::read(&path)?;
            if let Some(side) = resolution {
                record = record
                    .downscaled(side)
                    .with_context(|| path.display().to_string())?;
            }
            record.write(&target)?;
            copied += 1;
        }
    }
    say!("copied {copied} records, {kept} were there already");
    Ok(ExitCode::SUCCESS)
}

fn run_generate(args: &Generate) -> Result<ExitCode> {
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
    say!(
        "rendered {} objects, {} were there already",
        summary.rendered,
        summary.skipped
    );
    if !summary.failed.is_empty() {
        say_aside!("{} files could not be read:", summary.failed.len());
        for failed in &summary.failed {
            say_aside!("  {}", failed.reason);
        }
    }
    Ok(if args.strict && !summary.failed.is_empty() {
        ExitCode::FAILURE
    } else {
        ExitCode::SUCCESS
    })
}
