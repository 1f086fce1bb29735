//! `lumi relight`: a capture under new light.

use crate::assets;
use crate::device::OnDevice;
use crate::edits::{self, Edits};
use crate::groups;
use crate::output::{say, say_aside};
use crate::progress::Terminal;
use crate::results::Results;
use crate::sheet::{self, Row};
use crate::viewpoints::{self, Viewpoints};
use anyhow::{Context, Result, bail};
use lumi_core::image::{write_exr, write_png};
use lumi_core::light::LightSpec;
use lumi_core::{Camera, DisplayImage, Event, Light, LinearImage, Progress, Role, Scene, View};
use lumi_data::{Lighting, formats, input_light, spread_inputs};
use lumi_model::config::Output;
use lumi_model::{Edit, Relighter, SceneTokens};
use serde_json::json;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Instant;

/// Relight a capture and render views of it
///
/// LIGHT is env:FILE[,rotate=DEG][,strength=S], point:X,Y,Z[,power=W][,color=R,G,B] or
/// area:X,Y,Z[,target=X,Y,Z][,size=S][,power=W][,color=R,G,B], in the scene's world (z up).
/// Each --set, --add or --remove is one edit with all its lights; their order is the order of the edits.
#[derive(clap::Args)]
pub struct Args {
    /// Folder of the capture (see `lumi scene check`)
    scene: PathBuf,
    /// Weights file; the bundled model if absent
    #[arg(long)]
    model: Option<PathBuf>,
    #[command(flatten)]
    on: OnDevice,
    /// Number of input views to encode, spread over those there are; 8, or all of fewer, if absent
    #[arg(long)]
    inputs: Option<usize>,
    /// Steps in which the scene tokens are fitted to the inputs, for detail that the encoder leaves; about 30
    #[arg(
        long,
        default_value_t = 0,
        value_name = "STEPS",
        conflicts_with = "tokens"
    )]
    refine: usize,
    /// For scenes rendered one light at a time: the light of the inputs, as NAME or NAME=GAIN
    #[arg(long, num_args = 1.., value_name = "NAME=GAIN")]
    source: Vec<String>,
    /// The light that the photographs were taken in, which tells how bright the object is in itself; `known`, what the capture
    /// says, if absent and it says so; `unknown` to leave it to the model
    #[arg(long, num_args = 1.., value_name = "LIGHT", conflicts_with = "tokens")]
    captured_light: Vec<String>,
    /// Take the photographs as they are where they have no masks: the background belongs to what is captured
    #[arg(long)]
    no_mask: bool,
    #[command(flatten)]
    edits: Edits,
    /// More edits, from a TOML file with [[edit]] tables of mode and lights; they come last
    #[arg(long = "edits", value_name = "FILE")]
    file: Option<PathBuf>,
    /// Let `--set` go on from the edited tokens, as the paper's progressive edits do, instead of the captured ones
    #[arg(long)]
    chain: bool,
    /// Also write one multilayer OpenEXR per view: what each light of the result alone brings, times its power
    #[arg(long)]
    layers: bool,
    /// How many times as large as the model's own the pictures are, with detail from the photographs; as far as they have it,
    /// up to 4, if absent
    #[arg(long)]
    detail: Option<usize>,
    /// What to render: targets (held-out views), inputs, orbit:N, a cameras.json, or a path.toml with keys of a camera and of
    /// lights (docs/capture.md); targets if absent, or orbit:24 where the capture has none
    #[arg(long)]
    views: Option<String>,
    /// Start from saved scene tokens instead of encoding
    #[arg(long)]
    tokens: Option<PathBuf>,
    /// Save the scene tokens after the last edit
    #[arg(long)]
    save_tokens: Option<PathBuf>,
    /// Also write linear OpenEXR images
    #[arg(long)]
    exr: bool,
    /// Render after every edit, into one folder each
    #[arg(long)]
    every_step: bool,
    /// Also write the views as an animation, views.gif
    #[arg(long)]
    video: bool,
    /// Also write the views after the last edit as a capture, pictures with alpha and a transforms.json, for whatever reads those
    #[arg(long)]
    to_dataset: bool,
    /// Folder for the results, new or empty
    #[arg(long)]
    out: PathBuf,
    /// Replace the earlier results that the folder holds, as a whole
    #[arg(long)]
    overwrite: bool,
}

/// Input views if nobody says how many.
const INPUTS: usize = 8;

/// Tokens after a step, and what the step was.
struct Step {
    label: String,
    tokens: SceneTokens,
    seconds: f32,
}

pub fn run(args: &Args) -> Result<ExitCode> {
    super::check_outputs(Some(&args.out), args.save_tokens.as_deref())?;
    // Whether the results have a place is known before the work, and nothing of them is there until it is done.
    drop(Results::begin(&args.out, args.overwrite)?);
    if args.layers && args.tokens.is_some() {
        bail!(
            "--layers: expected a capture to start from, not --tokens, whose lights are not known"
        );
    }
    // Lights are told to be wrong before a model is loaded, let alone run.
    let edits = edits::read(&args.edits, args.file.as_deref(), args.chain)?;
    let scene = lumi_data::open(&args.scene)?;
    for edit in &edits {
        edit.check(&scene.to_model)?;
    }
    // What spoils the result is said before there is one. Tokens were made of photographs that may be gone.
    if args.tokens.is_some() {
        super::warn(&scene);
    } else if super::foretell(&scene).lacks_masks() && !args.no_mask {
        let (place, views) = (args.scene.display(), scene.views.len());
        bail!(
            "{place}: expected masks, found some of {views} photographs without one, whose background would be taken for the \
             object; `lumi scene mask {place} --out FOLDER` makes a capture that has them, --no-mask says that the background \
             belongs to it"
        );
    }
    let progress = Terminal::new();
    let model = assets::model(args.model.as_deref(), &args.on.device)?.with_refinement(args.refine);
    let detail = args.detail.unwrap_or_else(|| model.detail_of(&scene));
    let model = model.with_detail(detail)?;
    let side = model.side();
    let views = viewpoints::read(args.views.as_deref(), &scene, side)?;
    let cameras = &views.cameras;
    if !views.lights.is_empty() && (args.layers || args.every_step) {
        bail!("--views: a path that brings all light goes with neither --layers nor --every-step");
    }

    let started = Instant::now();
    let (inputs, tokens) = match &args.tokens {
        Some(path) => (Vec::new(), model.load_tokens(path)?),
        None => {
            let inputs = inputs(args, &scene, side)?;
            let mut tokens = model.encode(&inputs, scene.to_model)?;
            if let Some(lights) = captured_light(args, &scene, &model)? {
                match model.with_captured_light(&tokens, &lights) {
                    Ok(told) => tokens = told,
                    Err(e) if args.captured_light.is_empty() => {
                        say_aside!("warning: the captured light is left out: {e}");
                    }
                    Err(e) => return Err(e).context("--captured-light"),
                }
            }
            model.wait()?;
            (inputs, tokens)
        }
    };
    let label = "no edit".to_owned();
    let mut steps = vec![Step {
        label,
        tokens,
        seconds: started.elapsed().as_secs_f32(),
    }];
    for edit in &edits {
        let started = Instant::now();
        let tokens = edit.apply(&model, &steps[steps.len() - 1].tokens)?;
        model.wait()?;
        steps.push(Step {
            label: edit.describe(),
            tokens,
            seconds: started.elapsed().as_secs_f32(),
        });
    }

    let shown = if args.every_step { 0 } else { steps.len() - 1 };
    let stage = format!("rendering {} views", cameras.len());
    progress.event(Event::Begin {
        stage,
        total: (steps.len() - shown) as u64,
    });
    let mut rendered = Vec::new();
    // What is shown follows from radiance, where a model makes it.
    let linear = args.exr && model.config.output == Output::Radiance;
    let mut radiance = Vec::new();
    for (i, step) in steps[shown..].iter().enumerate() {
        let started = Instant::now();
        let images = if linear {
            let seen = seen(&model, &step.tokens, &views, Relighter::render_radiance)?;
            radiance.push(seen);
            radiance[i].iter().map(LinearImage::to_display).collect()
        } else {
            seen(&model, &step.tokens, &views, Relighter::render)?
        };
        rendered.push((images, started.elapsed().as_secs_f32()));
        progress.event(Event::Step {
            done: i as u64 + 1,
            note: step.label.clone(),
        });
    }
    progress.event(Event::End);

    let results = Results::begin(&args.out, args.overwrite)?;
    let out = results.folder();
    let names: Vec<&str> = cameras.iter().map(|(name, _)| name.as_str()).collect();
    for (i, (images, _)) in rendered.iter().enumerate() {
        let folder = if args.every_step {
            let label = steps[shown + i]
                .label
                .replace([' ', '+'], "-")
                .replace("---", "-");
            out.join(format!("step-{}-{label}", shown + i))
        } else {
            out.join("views")
        };
        write_views(&folder, &names, images, args.exr && !linear)?;
        if linear {
            write_radiance(&folder, &names, &radiance[i])?;
        }
    }
    if args.layers {
        let groups = groups::of(&model, &steps[0].tokens, &edits)?;
        let cameras: Vec<Camera> = cameras.iter().map(|(_, camera)| *camera).collect();
        groups::write(&out.join("layers"), &model, &groups, &names, &cameras)?;
    }
    if let (true, Some((images, _))) = (args.video, rendered.last()) {
        sheet::write_gif(&out.join("views.gif"), images, 320, 12)?;
    }
    if let (true, Some((images, _))) = (args.to_dataset, rendered.last()) {
        write_dataset(&out.join("dataset"), &scene, cameras, images)?;
    }
    if let Some(path) = &args.save_tokens {
        model.save_tokens(&steps[steps.len() - 1].tokens, &results.file(path))?;
    }
    let page = contact_sheet(&scene.name, &inputs, &steps[shown..], &names, &rendered)?;
    write_png(out.join("contact_sheet.png"), &page)?;
    let report = report(args, &model, &scene, &inputs, &edits, &steps, &rendered);
    super::write_json(&out.join("report.json"), &report)?;
    results.finish()?;
    say!("wrote {} views to {}", names.len(), args.out.display());
    Ok(ExitCode::SUCCESS)
}

/// What `look` makes of tokens from each viewpoint, under its own light where it brings some.
fn seen<T>(
    model: &Relighter,
    tokens: &SceneTokens,
    views: &Viewpoints,
    look: impl Fn(&Relighter, &SceneTokens, &[Camera]) -> lumi_model::Result<Vec<T>>,
) -> Result<Vec<T>> {
    let cameras: Vec<Camera> = views.cameras.iter().map(|(_, camera)| *camera).collect();
    if views.lights.is_empty() {
        return Ok(look(model, tokens, &cameras)?);
    }
    let mut images = Vec::with_capacity(cameras.len());
    for ((name, camera), lights) in views.cameras.iter().zip(&views.lights) {
        let lit = model.edit(tokens, &Edit::set(lights.clone()));
        let lit = lit.with_context(|| format!("--views: {name}"))?;
        images.extend(look(model, &lit, std::slice::from_ref(camera))?);
    }
    Ok(images)
}

/// The light of the inputs that `--source` names.
fn source(args: &Args) -> Result<Option<Lighting>> {
    let gain = |text: &String| match text.split_once('=') {
        None => Ok((text.clone(), 1.0)),
        Some((name, gain)) => match gain.parse::<f32>() {
            Ok(gain) => Ok((name.to_owned(), gain)),
            Err(_) => bail!("--source {text}: expected NAME=GAIN with a number"),
        },
    };
    let source = args.source.iter().map(gain).collect::<Result<Lighting>>()?;
    Ok((!args.source.is_empty()).then_some(source))
}

/// The light that the photographs were taken in, where it is to be told.
fn captured_light(args: &Args, scene: &Scene, model: &Relighter) -> Result<Option<Vec<Light>>> {
    let known = || input_light(scene, source(args)?.as_ref()).map_err(anyhow::Error::from);
    let given: Vec<&str> = args.captured_light.iter().map(String::as_str).collect();
    match given[..] {
        [] if model.takes_captured_light() => known(),
        [] | ["unknown"] => Ok(None),
        ["known"] => match known()? {
            Some(lights) => Ok(Some(lights)),
            None => bail!(
                "--captured-light known: expected a capture that says the light of its input views, one for all"
            ),
        },
        _ => {
            let specs = given.iter().map(|text| text.parse::<LightSpec>());
            let specs = specs.collect::<Result<Vec<_>, _>>();
            let specs = specs.map_err(|e| anyhow::anyhow!("--captured-light: {e}"))?;
            edits::open(&specs).map(Some)
        }
    }
}

/// The views to encode: photographs, or compositions of a light basis.
fn inputs(args: &Args, scene: &Scene, side: usize) -> Result<Vec<View>> {
    let there = scene.with_role(Role::Input).len();
    if let Some(wanted) = args.inputs.filter(|wanted| *wanted > there) {
        bail!("--inputs {wanted}: expected at most {there}, as many as the capture's input views");
    }
    let inputs = spread_inputs(
        scene,
        args.inputs.unwrap_or(INPUTS),
        source(args)?.as_ref(),
        side,
    );
    inputs.with_context(|| args.scene.display().to_string())
}

/// Where a view's picture goes: names come from files, and only their last part may decide.
pub fn place(folder: &Path, name: &str, extension: &str) -> Result<PathBuf> {
    let name = Path::new(name).file_name();
    let name = name.context("a view without a name")?;
    Ok(folder.join(name).with_added_extension(extension))
}

/// Linear radiance with alpha, beyond white.
fn write_radiance(folder: &Path, names: &[&str], images: &[LinearImage]) -> Result<()> {
    for (name, image) in names.iter().zip(images) {
        write_exr(place(folder, name, "exr")?, image)?;
    }
    Ok(())
}

fn write_views(folder: &Path, names: &[&str], images: &[DisplayImage], exr: bool) -> Result<()> {
    super::make_folder(folder)?;
    for (name, image) in names.iter().zip(images) {
        write_png(place(folder, name, "png")?, image)?;
        if exr {
            write_exr(place(folder, name, "exr")?, &image.to_linear())?;
        }
    }
    Ok(())
}

/// Rendered views as a capture of their own, in the scene's world.
fn write_dataset(
    folder: &Path,
    scene: &Scene,
    cameras: &[(String, Camera)],
    images: &[DisplayImage],
) -> Result<()> {
    let view = |((name, camera), image): (&(String, Camera), &DisplayImage)| View {
        name: name.clone(),
        role: Role::Input,
        camera: *camera,
        image: Some(image.clone()),
    };
    let relit = Scene {
        name: scene.name.clone(),
        views: cameras.iter().zip(images).map(view).collect(),
        to_model: scene.to_model,
        basis: None,
        lit_by: Vec::new(),
        radiance: Vec::new(),
        warnings: Vec::new(),
    };
    let write = formats::named("transforms")?.write;
    let write = write.context("expected a format that can be written")?;
    Ok(write(folder, &relit)?)
}

fn contact_sheet(
    name: &str,
    inputs: &[View],
    steps: &[Step],
    names: &[&str],
    rendered: &[(Vec<DisplayImage>, f32)],
) -> Result<DisplayImage> {
    /// Pictures per row.
    const COLUMNS: usize = 8;
    let mut rows = Vec::new();
    let tiles: Vec<_> = inputs
        .iter()
        .filter_map(|v| Some((v.image.clone()?, v.name.clone())))
        .collect();
    if !tiles.is_empty() {
        rows.push(Row {
            label: "input views".into(),
            tiles: tiles.into_iter().take(COLUMNS).collect(),
        });
    }
    for (step, (images, _)) in steps.iter().zip(rendered) {
        let every = images.len().div_ceil(COLUMNS);
        let tiles = images.iter().zip(names).step_by(every);
        let tiles = tiles
            .map(|(image, name)| (image.clone(), (*name).to_owned()))
            .collect();
        rows.push(Row {
            label: step.label.replacen(' ', "\n", 1),
            tiles,
        });
    }
    sheet::draw(name, &rows, 160)
}

fn report(
    args: &Args,
    model: &Relighter,
    scene: &Scene,
    inputs: &[View],
    edits: &[edits::Step],
    steps: &[Step],
    rendered: &[(Vec<DisplayImage>, f32)],
) -> serde_json::Value {
    let edits: Vec<_> = edits
        .iter()
        .zip(&steps[1..])
        .map(|(edit, step)| {
            json!({"edit": edit.describe(), "lights": edit.lights(), "seconds": step.seconds})
        })
        .collect();
    let views: usize = rendered.iter().map(|(images, _)| images.len()).sum();
    let seconds: f32 = rendered.iter().map(|(_, seconds)| seconds).sum();
    json!({
        "scene": {"path": args.scene, "name": scene.name, "to_model": scene.to_model},
        "model": {"fingerprint": model.fingerprint, "origin": model.provenance.origin,
                  "resolution": model.side()},
        "inputs": inputs.iter().map(|v| v.name.clone()).collect::<Vec<_>>(),
        "encode_seconds": steps[0].seconds,
        "exposure": steps[0].tokens.frame().exposure,
        "edits": edits,
        "render": {"views": views, "seconds": seconds},
        "peak_memory_mib": lumi_core::memory::peak_mib(),
        "version": env!("CARGO_PKG_VERSION"),
    })
}
