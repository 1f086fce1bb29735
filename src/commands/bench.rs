//! `lumi bench`: how long the stages of a model take, and how much memory.

use crate::device::OnDevice;
use crate::output::say;
use anyhow::{Context, Result, ensure};
use burn::tensor::{Device, Distribution, Tensor};
use lumi_core::light::RayPattern;
use lumi_core::{Camera, Light, Point, Seed, glam::Vec3, memory};
use lumi_kernels::{Precision, Save};
use lumi_model::config::{DecoderAttention, HeadConfig, LightConfig, Output, RayFeatures};
use lumi_model::lights::{EditLight, LightShape};
use lumi_model::network::Scene;
use lumi_model::places::Places;
use lumi_model::{Illumination, Mode, ModelConfig, Network};
use lumi_train::config::{OptimizerConfig, Parts};
use lumi_train::optim::{Pace, descend, optimizer, select};
use lumi_train::reduce::Solo;
use serde::Serialize;
use std::f32::consts::TAU;
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Arc;
use std::time::Instant;

/// Time encode, edit, decode and a training step with random weights
#[derive(clap::Args)]
pub struct Args {
    /// small64, small128, paper256, paper512 (sizes of published models), or a model preset
    #[arg(long, default_value = "small64")]
    preset: String,
    #[command(flatten)]
    on: OnDevice,
    /// Precision of matrix operands
    #[arg(long, default_value = "bf16", value_parser = ["bf16", "f32"])]
    dtype: String,
    /// Threads; all of the machine's if not given
    #[arg(long)]
    threads: Option<usize>,
    /// Samples at a time
    #[arg(long, default_value_t = 1)]
    batch: usize,
    /// Repetitions, after one to warm up; the median counts
    #[arg(long, default_value_t = 5)]
    reps: usize,
    /// Stages, separated by commas
    #[arg(long, value_delimiter = ',', default_value = "encode,edit,decode,train_step",
          value_parser = ["encode", "edit", "decode", "train_step"])]
    stages: Vec<String>,
    /// Decoder attention instead of the preset's: joint or one-way
    #[arg(long, value_parser = ["joint", "one-way"])]
    decoder: Option<String>,
    /// Target views per sample instead of the preset's
    #[arg(long)]
    targets: Option<usize>,
    /// Keep only the blocks' inputs for the backward pass
    #[arg(long)]
    recompute: bool,
    /// Write the rows as JSON
    #[arg(long)]
    json: Option<PathBuf>,
}

/// What is timed: a model and how much goes through it.
struct Workload {
    model: ModelConfig,
    inputs: usize,
    /// Light tokens of an edit.
    lights: usize,
    targets: usize,
}

/// Sizes that are published for other implementations: name, width, blocks per stack, scene tokens, side,
/// light tokens, target views. Patches of 8, heads of 64, four input views, the MLP head.
const PUBLISHED: [(&str, usize, usize, usize, usize, usize, usize); 4] = [
    ("small64", 256, 6, 256, 64, 256, 4),
    ("small128", 256, 6, 256, 128, 256, 4),
    ("paper256", 768, 12, 3072, 256, 2048, 1),
    ("paper512", 768, 12, 3072, 512, 2048, 1),
];

impl Workload {
    fn new(args: &Args) -> Result<Self> {
        let published = PUBLISHED.iter().find(|p| p.0 == args.preset);
        let mut workload = match published {
            Some(&(_, dim, layers, scene_tokens, resolution, lights, targets)) => Self {
                model: ModelConfig {
                    dim,
                    head_dim: 64,
                    encoder_layers: layers,
                    editor_layers: layers,
                    decoder_layers: layers,
                    scene_tokens,
                    patch: 8,
                    resolution,
                    rays: RayFeatures::Plucker,
                    decoder: DecoderAttention::Joint,
                    albedo: false,
                    overlap: false,
                    reprojection: false,
                    surface: false,
                    margins: false,
                    direct: false,
                    pixel_context: 0,
                    pixel_mlp: 0,
                    view_tokens: false,
                    anchors: false,
                    streams: 1,
                    output: Output::Display,
                    head: HeadConfig::Mlp,
                    lights: LightConfig::Rays {
                        environment_grid: [32, lights / 32],
                        local_rays: 1,
                        modes: Mode::ALL.to_vec(),
                    },
                },
                inputs: 4,
                lights,
                targets,
            },
            None => {
                let model = ModelConfig::preset(&args.preset).with_context(|| {
                    let names = PUBLISHED.map(|p| p.0).join(", ");
                    format!("--preset: expected one of {names}, or a model preset")
                })?;
                let LightConfig::Rays { .. } = model.lights else {
                    anyhow::bail!(
                        "--preset {}: expected a model that takes light rays",
                        args.preset
                    );
                };
                let pattern = model.lights.pattern();
                Self {
                    lights: pattern.environment_rows * pattern.environment_columns,
                    model,
                    inputs: 4,
                    targets: 1,
                }
            }
        };
        match args.decoder.as_deref() {
            Some("joint") => workload.model.decoder = DecoderAttention::Joint,
            Some("one-way") => workload.model.decoder = DecoderAttention::OneWay,
            _ => {}
        }
        workload.targets = args.targets.unwrap_or(workload.targets);
        Ok(workload)
    }

    /// Floating-point operations of a stage's blocks for one sample; tokenizers and heads are left out.
    fn flops(&self, stage: &str) -> f64 {
        let (m, r) = (&self.model, self.model.resolution);
        let scene = m.scene_of(self.inputs, r);
        let parts = [
            ("encode", m.encode_flops(self.inputs, r)),
            ("edit", m.edit_flops(scene, self.lights)),
            ("decode", m.decode_flops(scene, self.targets, r)),
        ];
        let one = parts.iter().find(|(name, _)| *name == stage);
        one.map_or_else(
            || 3.0 * parts.iter().map(|(_, flops)| flops).sum::<f64>(),
            |(_, flops)| *flops,
        )
    }
}

/// One measurement; the fields' names and units are kept stable for other programs.
#[derive(Serialize)]
struct Row<'a> {
    stage: &'a str,
    preset: &'a str,
    device: String,
    dtype: &'a str,
    threads: usize,
    batch: usize,
    /// Target views of decode and train_step.
    targets: usize,
    decoder: DecoderAttention,
    /// Median.
    ms: f64,
    gflops: f64,
    /// Largest resident memory during the stage; null where the system does not say it.
    peak_mib: Option<f64>,
    /// Decode with the scene's keys and values at hand, as for every further view.
    #[serde(skip_serializing_if = "Option::is_none")]
    prepared_ms: Option<f64>,
}

/// Views that are decoded at a time, as in `Relighter::render`.
const VIEWS_AT_ONCE: usize = 8;

pub fn run(args: &Args) -> Result<ExitCode> {
    ensure!(args.reps > 0, "--reps: expected at least 1");
    ensure!(
        (1..=4096).contains(&args.batch),
        "--batch: expected 1 to 4096"
    );
    ensure!(
        args.targets != Some(0),
        "--targets: expected at least 1 view"
    );
    super::check_outputs(None, args.json.as_deref())?;
    let threads = match args.threads {
        Some(n) => {
            ensure!((1..=1024).contains(&n), "--threads: expected 1 to 1024");
            n
        }
        None => std::thread::available_parallelism().map_or(1, usize::from),
    };
    rayon::ThreadPoolBuilder::new()
        .num_threads(threads)
        .build_global()
        .context("starting threads")?;
    let workload = Workload::new(args)?;
    let device = args.on.device.open();
    let precision = if args.dtype == "bf16" {
        Precision::Bf16
    } else {
        Precision::F32
    };
    let mut rows = Vec::new();
    say!(
        "{:12} {:>10} {:>10} {:>10}",
        "stage",
        "ms",
        "GFLOP/s",
        "peak MiB"
    );
    for stage in &args.stages {
        memory::reset_peak();
        let (ms, prepared_ms) = measure(args, &workload, stage, precision, &device)?;
        let row = Row {
            stage,
            preset: &args.preset,
            device: args.on.device.to_string(),
            dtype: &args.dtype,
            threads,
            batch: args.batch,
            targets: workload.targets,
            decoder: workload.model.decoder,
            ms,
            gflops: args.batch as f64 * workload.flops(stage) / ms / 1e6,
            peak_mib: memory::peak_mib(),
            prepared_ms,
        };
        let peak = row.peak_mib.map_or("?".into(), |m| format!("{m:.0}"));
        say!("{stage:12} {ms:10.2} {:10.1} {peak:>10}", row.gflops);
        if let Some(ms) = prepared_ms {
            say!("{:12} {ms:10.2}", "  prepared");
        }
        rows.push(row);
    }
    if let Some(path) = &args.json {
        super::write_json(path, &rows)?;
    }
    Ok(ExitCode::SUCCESS)
}

/// Median milliseconds of a stage, and of decoding a prepared scene.
fn measure(
    args: &Args,
    workload: &Workload,
    stage: &str,
    precision: Precision,
    device: &Device,
) -> Result<(f64, Option<f64>)> {
    let Workload {
        model,
        inputs,
        lights,
        targets,
    } = workload;
    let (b, r, c) = (args.batch, model.resolution, model.target_channels());
    let normal = Distribution::Normal(0.0, 1.0);
    let posed = Tensor::<5>::random([b, *inputs, model.posed_channels(), r, r], normal, device);
    let around = |views: usize| -> Vec<Camera> {
        let one = |i: usize| Camera::orbit(TAU * i as f32 / views as f32, 0.4, 2.75, 0.87, r);
        (0..b * views).map(|i| one(i % views)).collect()
    };
    let (seen, shown) = (around(*inputs), around(*targets));
    let light = |network: &Network, device: &Device| -> lumi_model::Result<EditLight> {
        if model.output == Output::Radiance {
            let pattern = RayPattern {
                local_rays: *lights,
                ..RayPattern::default()
            };
            let lamp = Light::Point(Point::new(Vec3::new(1.0, -2.0, 3.0), 800.0));
            let rays = lamp.rays(&pattern);
            let (shape, _) = LightShape::new(&rays, Mode::Set, Illumination::CAPTURED)?;
            return network.shaped_light(&vec![shape; b], Mode::Set);
        }
        let size = [b, *lights, lumi_model::lights::RAY_FEATURES];
        let features = Tensor::<3>::random(size, normal, device);
        network.light_tokens(features, Mode::Set)
    };
    let rays = Tensor::<5>::random([b, *targets, c, r, r], normal, device);
    let size = [b, model.scene_of(*inputs, r), model.dim];
    let scene = Scene {
        channels: Tensor::random(size, normal, device),
        places: model.anchors.then(|| {
            let kept: &[Camera] = if model.view_tokens { &seen } else { &[] };
            Arc::new(Places::new(b, model.scene_tokens, kept, model.patch))
        }),
    };
    if stage == "train_step" {
        let device = device.clone().autodiff();
        let save = if args.recompute {
            Save::Input
        } else {
            Save::Activations
        };
        let network = Network::new(model, Seed(0), &device)
            .with_precision(precision)
            .with_save(save);
        let network = select(network, Parts::ALL);
        let mut optimizer = optimizer(&OptimizerConfig::default(), &network);
        let [posed, rays] = [posed, rays].map(Tensor::from_inner);
        let mut network = Some(network);
        let ms = median(args.reps, || {
            let now = network.take().context("the network of the step before")?;
            let loss = |network: &Network, (): &()| {
                let light = light(network, &device)?;
                let encoded = network.encode(posed.clone(), &seen, model);
                let edited = network.edit(&encoded, light, model);
                let render = network.decode(&edited, rays.clone(), &shown, model);
                Ok((render - 0.5).square().mean())
            };
            let done = descend(
                now,
                &mut optimizer,
                Parts::ALL,
                Pace::even(1e-4, 1.0),
                &[()],
                &Solo,
                loss,
            )?;
            network = Some(done.network);
            Ok(())
        })?;
        return Ok((ms, None));
    }
    let network = Network::new(model, Seed(0), device)
        .with_precision(precision)
        .packed();
    let decode = |prepared: &_| {
        for first in (0..*targets).step_by(VIEWS_AT_ONCE) {
            let count = VIEWS_AT_ONCE.min(targets - first);
            let some = rays.clone().narrow(1, first, count);
            // Of the first sample's views for all samples: where they look from costs nothing.
            let cameras = shown[first..first + count].repeat(b);
            let _ = network
                .decode_prepared(prepared, some, &cameras, model)
                .into_data();
        }
    };
    let ms = median(args.reps, || {
        match stage {
            "encode" => drop(
                network
                    .encode(posed.clone(), &seen, model)
                    .channels
                    .into_data(),
            ),
            "edit" => {
                let light = light(&network, device)?;
                drop(network.edit(&scene, light, model).channels.into_data());
            }
            _ => decode(&network.prepare(&scene, model)),
        }
        Ok(())
    })?;
    let prepared_ms = if stage == "decode" && model.decoder == DecoderAttention::OneWay {
        let prepared = network.prepare(&scene, model);
        Some(median(args.reps, || {
            decode(&prepared);
            Ok(())
        })?)
    } else {
        None
    };
    Ok((ms, prepared_ms))
}

/// Median milliseconds of `reps` runs after one that does not count.
fn median(reps: usize, mut run: impl FnMut() -> Result<()>) -> Result<f64> {
    run()?;
    let mut times = Vec::with_capacity(reps);
    for _ in 0..reps {
        let start = Instant::now();
        run()?;
        times.push(start.elapsed().as_secs_f64() * 1e3);
    }
    times.sort_by(f64::total_cmp);
    Ok(times[reps / 2])
}
