//! `lumi demo`: the bundled model relights the bundled scene step by step.

use crate::assets;
use crate::device::OnDevice;
use crate::output::say;
use crate::progress::Terminal;
use crate::sheet::{self, Row};
use anyhow::{Context, Result};
use lumi_core::image::write_png;
use lumi_core::{Camera, DisplayImage, Event, Progress, Scene, Similarity};
use lumi_data::manifest::ObjectCases;
use lumi_data::{Lighting, Manifest, Orbit, views_under};
use lumi_eval::metrics::psnr;
use lumi_model::{Edit, Relighter, SceneTokens};
use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Instant;

/// Relight the bundled scene step by step beside path-traced truth; writes a contact sheet and a turntable
#[derive(clap::Args)]
pub struct Args {
    /// Folder for the pictures
    #[arg(long, default_value = "out/demo")]
    out: PathBuf,
    /// Weights file; the bundled model if absent
    #[arg(long)]
    model: Option<PathBuf>,
    /// Steps in which the scene tokens are fitted to the inputs; with none, what the encoder alone gives
    #[arg(long, default_value_t = 0, value_name = "STEPS")]
    refine: usize,
    #[command(flatten)]
    on: OnDevice,
}

/// The object of the bundled scene.
const OBJECT: &str = "spot";
/// Frames of the turntable, and of the strip in which a light moves.
const FRAMES: usize = 48;
const STRIP: usize = 8;
/// Enlarged side of pictures on the sheet and in the animation.
const TILE: usize = 160;
const FRAME_SIDE: usize = 320;

pub fn run(args: &Args) -> Result<ExitCode> {
    let started = Instant::now();
    super::check_output(&args.out)?;
    let progress = Terminal::new();
    let model = assets::model(args.model.as_deref(), &args.on.device)?.with_refinement(args.refine);
    let folder = assets::demo_folder()?;
    let manifest = Manifest::read(folder.path())?;
    let scene = manifest.open(OBJECT)?;
    let detail = model.detail_of(&scene);
    let model = model.with_detail(detail)?;
    let story = Story::new(&model, &scene, manifest.cases(OBJECT)?)?;

    let total = 2 + story.edits.len() as u64;
    progress.event(Event::Begin {
        stage: "relighting".into(),
        total,
    });
    let (rows, last) = story.rows(&progress)?;
    let page = sheet::draw(
        "LumiTokens: light built up step by step, in token space",
        &rows,
        TILE,
    )?;
    let strip = story.moving_light()?;
    progress.event(Event::Step {
        done: total - 1,
        note: "moving light".into(),
    });
    let orbit = Orbit {
        elevation: 0.45,
        distance: 2.75,
        fov: 50_f32.to_radians(),
    };
    let cameras = orbit.cameras(FRAMES, model.side(), &Similarity::IDENTITY);
    let turntable = model.render(&last, &cameras)?;
    progress.event(Event::Step {
        done: total,
        note: "turntable".into(),
    });
    progress.event(Event::End);

    super::make_folder(&args.out)?;
    write_png(args.out.join("contact_sheet.png"), &page)?;
    write_png(args.out.join("moving_light.png"), &strip)?;
    sheet::write_gif(&args.out.join("turntable.gif"), &turntable, FRAME_SIDE, 16)?;
    say!(
        "wrote contact_sheet.png, moving_light.png and turntable.gif to {} in {:.1} s",
        args.out.display(),
        started.elapsed().as_secs_f32()
    );
    Ok(ExitCode::SUCCESS)
}

/// The demo's inputs and edits.
struct Story<'a> {
    model: &'a Relighter,
    scene: &'a Scene,
    cases: &'a ObjectCases,
    inputs: Vec<lumi_core::View>,
    tokens: SceneTokens,
    /// Label, lights of the step, and all light after it.
    edits: Vec<(String, Lighting, Lighting)>,
}

impl<'a> Story<'a> {
    fn new(model: &'a Relighter, scene: &'a Scene, cases: &'a ObjectCases) -> Result<Self> {
        let indices = ObjectCases::indices(scene, &cases.inputs)?;
        let inputs = views_under(scene, &indices, &cases.source, model.side())?;
        let mut tokens = model.encode(&inputs, scene.to_model)?;
        if model.takes_captured_light() {
            let source = cases.source.lights(scene)?;
            tokens = model.with_captured_light(&tokens, &source)?;
        }
        let steps = cases
            .additive
            .first()
            .context("the demo scene has no additive sequence")?;
        let labels = [
            "set a new\nenvironment",
            "add a\npoint light",
            "add another\npoint light",
            "add an\narea light",
        ];
        let edits = steps
            .iter()
            .zip(ObjectCases::sums(steps))
            .zip(labels)
            .map(|((step, sum), label)| (label.to_owned(), step.clone(), sum))
            .collect();
        Ok(Self {
            model,
            scene,
            cases,
            inputs,
            tokens,
            edits,
        })
    }

    /// The sheet's rows and the tokens after the last edit.
    fn rows(&self, progress: &dyn Progress) -> Result<(Vec<Row>, SceneTokens)> {
        let shown = |v: &lumi_core::View| Some((v.image.clone()?, v.name.clone()));
        let inputs = self.inputs.iter().filter_map(shown).collect();
        let mut rows = vec![Row {
            label: "input views".into(),
            tiles: inputs,
        }];
        let source = "decoded,\nno edit".to_owned();
        rows.push(self.compared(source, &self.tokens, &self.cases.source)?);
        let mut tokens = self.tokens.clone();
        for (i, (label, lights, sum)) in self.edits.iter().enumerate() {
            let lights = lights.lights(self.scene)?;
            let edit = if i == 0 {
                Edit::set(lights)
            } else {
                Edit::add(lights)
            };
            tokens = self.model.edit(&tokens, &edit)?;
            rows.push(self.compared(label.clone(), &tokens, sum)?);
            progress.event(Event::Step {
                done: i as u64 + 1,
                note: edit.describe(),
            });
        }
        Ok((rows, tokens))
    }

    /// Held-out views of the tokens, each beside its truth under `light`.
    fn compared(&self, label: String, tokens: &SceneTokens, light: &Lighting) -> Result<Row> {
        let held = ObjectCases::indices(self.scene, &self.cases.views)?;
        // Four views spread over the held-out ones.
        let chosen: Vec<usize> = held.iter().step_by(2).copied().take(4).collect();
        let truth = views_under(self.scene, &chosen, light, self.model.side())?;
        let cameras: Vec<Camera> = truth.iter().map(|v| v.camera).collect();
        let renders = self.model.render(tokens, &cameras)?;
        let mut tiles = Vec::new();
        for (render, view) in renders.into_iter().zip(truth) {
            let image: DisplayImage = view.image.context("composed views have images")?;
            let score = psnr(&render, &image);
            tiles.push((render, format!("{} ours {score:.1} dB", view.name)));
            tiles.push((image, "Cycles".into()));
        }
        Ok(Row { label, tiles })
    }

    /// One view while a point light moves from left to right in front of it.
    fn moving_light(&self) -> Result<DisplayImage> {
        let camera = Camera::orbit(0.6, 0.45, 2.75, 50_f32.to_radians(), self.model.side());
        let mut tiles = Vec::new();
        for i in 0..STRIP {
            let t = i as f32 / (STRIP - 1) as f32;
            // The camera looks from azimuth 0.6; larger azimuths are on its right.
            let azimuth = 0.6 + 1.9 * (2.0 * t - 1.0);
            let (s, c) = azimuth.sin_cos();
            let position = lumi_core::glam::Vec3::new(3.0 * c, 3.0 * s, 2.2);
            let light = lumi_core::Light::Point(lumi_core::Point::new(position, 550.0));
            let tokens = self.model.edit(&self.tokens, &Edit::set([light]))?;
            let image = self.model.render(&tokens, &[camera])?.remove(0);
            tiles.push((image, format!("{:+.0}°", (azimuth - 0.6).to_degrees())));
        }
        let row = Row {
            label: "a point light\nmoves".into(),
            tiles,
        };
        sheet::draw(
            "One scene, one set of tokens, a light that moves",
            &[row],
            TILE,
        )
    }
}
