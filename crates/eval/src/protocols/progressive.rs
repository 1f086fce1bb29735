//! Protocol `progressive`: one edit after the other (paper §4, supplement). In **token space** an edit continues
//! from the edited tokens; in **pixel space** the edited scene is rendered at the input poses and encoded anew
//! before each edit, which is all that a method without tokens can do; **direct** makes each edit on the tokens
//! of the original inputs, which no chain can be expected to beat.

use crate::Result;
use crate::baselines::{self, Seen};
use crate::cases::{Basis, Subject};
use crate::figures::{Detail, Figures};
use crate::gallery::Gallery;
use crate::metrics::{Judge, psnr};
use crate::picture::Picture;
use crate::report::{Chains, ObjectRecord, Step};
use lumi_core::{Camera, DisplayImage, View};
use lumi_data::Lighting;
use lumi_data::manifest::ObjectCases;
use lumi_model::{Edit, Mode, Relighter, SceneTokens};
use std::collections::BTreeMap;

/// An edit of a chain: what it does, with which light, and what should then be seen.
struct Link {
    label: String,
    mode: Mode,
    lights: Lighting,
    after: Lighting,
}

/// Scores an object's chains. Its figures are those of the token-space replacement chain, means over its steps.
///
/// # Errors
/// If the model refuses the object's views or lights.
pub fn object(
    model: &Relighter,
    subject: &Subject,
    judge: &Judge,
    gallery: &mut Gallery,
) -> Result<ObjectRecord> {
    let basis = subject.basis()?;
    let walk = Walk {
        model,
        subject,
        basis,
        judge,
        start: subject.encode(model)?,
        seen: Seen::by(subject, &basis.cameras),
    };
    let mut replacements = Vec::new();
    for name in &basis.cases.progressive.sequence {
        let lighting = basis.cases.targets.get(name).ok_or_else(|| {
            lumi_core::Error::value(
                format!("progressive `{name}`"),
                "expected the name of a target",
            )
        })?;
        replacements.push(Link {
            label: name.clone(),
            mode: Mode::Set,
            lights: lighting.clone(),
            after: lighting.clone(),
        });
    }
    let (mut methods, trivial) = walk.chain("replace", &replacements, gallery)?;
    let figures = mean(methods.get("token").map_or(&[][..], Vec::as_slice));
    let mut chains = Chains::new();
    let mut trivial: BTreeMap<String, Figures> = trivial
        .iter()
        .map(|(name, steps)| (name.clone(), mean(steps)))
        .collect();
    if let Some(steps) = methods.get("pixel") {
        trivial.insert("pixel_chain".to_owned(), mean(steps));
    }
    chains
        .entry("replace".to_owned())
        .or_default()
        .append(&mut methods);
    if model.config.lights.modes().contains(&Mode::Add) {
        for sequence in basis.cases.additive.iter().take(1) {
            let sums = ObjectCases::sums(sequence);
            let links = sequence
                .iter()
                .zip(sums)
                .enumerate()
                .map(|(i, (step, after))| Link {
                    label: step.0.keys().cloned().collect::<Vec<_>>().join("+"),
                    mode: if i == 0 { Mode::Set } else { Mode::Add },
                    lights: step.clone(),
                    after,
                });
            let (mut methods, _) = walk.chain("add", &links.collect::<Vec<_>>(), gallery)?;
            chains
                .entry("add".to_owned())
                .or_default()
                .append(&mut methods);
        }
    }
    Ok(ObjectRecord {
        figures,
        trivial,
        cases: BTreeMap::new(),
        chains,
    })
}

fn mean(steps: &[Step]) -> Figures {
    Figures::mean(steps.iter().map(|s| &s.figures))
}

/// A lighting's name as a caption: `env2+point1+area0` becomes `env2 + 2`.
fn brief(label: &str) -> String {
    match label.split_once('+') {
        None => label.to_owned(),
        Some((first, rest)) => format!("{first} + {}", rest.split('+').count()),
    }
}

/// Steps by method.
type Steps = BTreeMap<String, Vec<Step>>;

struct Walk<'a> {
    model: &'a Relighter,
    subject: &'a Subject,
    basis: &'a Basis,
    judge: &'a Judge,
    start: SceneTokens,
    seen: Seen,
}

impl Walk<'_> {
    /// Walks a chain: steps of the model's three ways, and of the trivial answers.
    fn chain(&self, name: &str, links: &[Link], gallery: &mut Gallery) -> Result<(Steps, Steps)> {
        let (subject, basis) = (self.subject, self.basis);
        let cameras = &basis.cameras;
        let (mut ours, mut trivial) = (Steps::new(), Steps::new());
        let unedited = Picture::rendered(self.model, &self.start, cameras)?;
        let mut tokens = self.start.clone();
        let mut inputs = subject.inputs.clone();
        let input_cameras: Vec<Camera> = inputs.iter().map(|v| v.camera).collect();
        let mut pictures: Vec<[DisplayImage; 3]> = Vec::new();
        for link in links {
            let target = basis.target(&link.after)?;
            let lights = basis.lights(&link.lights)?;
            let mode = link.mode;
            let edit = Edit::new(mode, lights).chained();
            tokens = self.model.edit(&tokens, &edit)?;
            let by_tokens = Picture::rendered(self.model, &tokens, cameras)?;

            let seen = self.model.encode(&inputs, subject.to_model)?;
            let seen = self.model.edit(&seen, &edit)?;
            let by_pixels = Picture::rendered(self.model, &seen, cameras)?;
            let again = self.model.render(&seen, &input_cameras)?;
            let renewed = inputs.into_iter().zip(again);
            inputs = renewed
                .map(|(view, image)| View {
                    image: Some(image),
                    ..view
                })
                .collect();

            let direct = Edit::set(target.lights_of(0));
            let direct = self.model.edit(&self.start, &direct)?;
            let direct = Picture::rendered(self.model, &direct, cameras)?;

            let label = format!("{} {}", format!("{mode:?}").to_lowercase(), link.label);
            let note = |all: &mut Steps, method: &str, figures: Figures| {
                let edit = label.clone();
                all.entry(method.to_owned())
                    .or_default()
                    .push(Step { edit, figures });
            };
            let score =
                |pictures: &[Picture]| self.judge.figures(pictures, &target.truth, Detail::Brief);
            note(&mut ours, "token", score(&by_tokens)?);
            note(&mut ours, "pixel", score(&by_pixels)?);
            note(&mut ours, "direct", score(&direct)?);
            note(&mut trivial, "unedited", score(&unedited)?);
            for (method, figures) in baselines::figures(subject, &self.seen, &target, self.judge)? {
                note(&mut trivial, &method, figures);
            }
            let first = |mut pictures: Vec<Picture>| pictures.swap_remove(0).shown;
            pictures.push([target.truth, by_tokens, by_pixels].map(first));
        }
        let sheet = format!("steps-{name}");
        for (k, row) in ["truth", "token space", "pixel space"]
            .into_iter()
            .enumerate()
        {
            for (link, images) in links.iter().zip(&pictures) {
                let caption = if k == 0 {
                    brief(&link.label)
                } else {
                    format!("{:.1} dB", psnr(&images[k], &images[0]))
                };
                let row = format!("{}\n{row}", subject.name);
                gallery.add(&sheet, &row, caption, images[k].clone());
            }
        }
        Ok((ours, trivial))
    }
}
