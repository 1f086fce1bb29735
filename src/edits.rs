//! Edits as a person writes them: `--set`, `--add`, `--remove`, `--scale`, and files of them.

use crate::output::say_aside;
use anyhow::{Context, Result};
use clap::{ArgAction, ArgMatches, FromArgMatches};
use lumi_core::light::LightSpec;
use lumi_core::{Light, Similarity};
use lumi_model::{Edit, EditsFile, Mode, Relighter, SceneTokens};
use std::path::Path;

/// `--set`, `--add`, `--remove` and `--scale` in the order in which they were given.
#[derive(Clone, Debug)]
pub struct Edits(Vec<Given>);

#[derive(Clone, Debug)]
enum Given {
    Lights(Mode, Vec<LightSpec>),
    Scale(f64),
}

/// What is done to a scene's light.
#[derive(Clone, Debug)]
pub enum Step {
    /// Lights are set, added or removed.
    Edit {
        /// The edit.
        edit: Edit,
        /// Its lights as they were written.
        written: Vec<LightSpec>,
    },
    /// All light so far, times a factor.
    Scale(f64),
}

/// Of lights that were not written anywhere.
impl From<Edit> for Step {
    fn from(edit: Edit) -> Self {
        let written = Vec::new();
        Self::Edit { edit, written }
    }
}

impl Step {
    /// The scene after it.
    ///
    /// # Errors
    /// As [`Relighter::edit`].
    pub fn apply(&self, model: &Relighter, tokens: &SceneTokens) -> Result<SceneTokens> {
        Ok(match self {
            Self::Edit { edit, .. } => model.edit(tokens, edit)?,
            Self::Scale(factor) => tokens.scaled([*factor; 3]),
        })
    }

    /// It in a few words.
    #[must_use]
    pub fn describe(&self) -> String {
        match self {
            Self::Edit { edit, .. } => edit.describe(),
            Self::Scale(factor) => format!("scale {factor}"),
        }
    }

    /// The lights that it brings, as they were written.
    #[must_use]
    pub fn lights(&self) -> &[LightSpec] {
        match self {
            Self::Edit { written, .. } => written,
            Self::Scale(_) => &[],
        }
    }

    /// Whether its lights are sensible ones of a scene, which `to_model` takes to the unit ball: told before any work.
    ///
    /// # Errors
    /// Names the light, the field and what was expected.
    pub fn check(&self, to_model: &Similarity) -> Result<()> {
        let Self::Edit { edit, written } = self else {
            return Ok(());
        };
        for (light, written) in edit.lights.iter().zip(written) {
            let checked = light.transformed(to_model).validate();
            checked.with_context(|| written.to_string())?;
        }
        Ok(())
    }
}

const MODES: [(&str, Mode, &str); 3] = [
    ("set", Mode::Set, "Replace all light"),
    ("add", Mode::Add, "Add lights"),
    ("remove", Mode::Remove, "Take lights away"),
];

const SCALE: &str = "scale";

fn factor(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(factor) if factor >= 0.0 && factor.is_finite() => Ok(factor),
        _ => Err("expected a number that is not negative".into()),
    }
}

impl clap::Args for Edits {
    fn augment_args(command: clap::Command) -> clap::Command {
        let scale = clap::Arg::new(SCALE)
            .long(SCALE)
            .help("Make all light so far FACTOR times as strong; exact, and no network runs")
            .value_name("FACTOR")
            .action(ArgAction::Append)
            .value_parser(factor);
        let command = command.arg(scale);
        MODES.into_iter().fold(command, |command, (name, _, help)| {
            command.arg(
                clap::Arg::new(name)
                    .long(name)
                    .help(help)
                    .value_name("LIGHT")
                    .num_args(1..)
                    .action(ArgAction::Append)
                    .value_parser(|text: &str| text.parse::<LightSpec>()),
            )
        })
    }

    fn augment_args_for_update(command: clap::Command) -> clap::Command {
        Self::augment_args(command)
    }
}

impl FromArgMatches for Edits {
    fn from_arg_matches(matches: &ArgMatches) -> Result<Self, clap::Error> {
        let mut edits = Vec::new();
        for (name, mode, _) in MODES {
            let Some(given) = matches.get_occurrences::<LightSpec>(name) else {
                continue;
            };
            let mut indices = matches.indices_of(name).into_iter().flatten();
            for lights in given {
                let lights: Vec<LightSpec> = lights.cloned().collect();
                let first = indices.next().unwrap_or(0);
                // The other indices of this occurrence belong to its other lights.
                for _ in 1..lights.len() {
                    indices.next();
                }
                edits.push((first, Given::Lights(mode, lights)));
            }
        }
        let factors = matches.get_many::<f64>(SCALE).into_iter().flatten();
        for (index, factor) in matches.indices_of(SCALE).into_iter().flatten().zip(factors) {
            edits.push((index, Given::Scale(*factor)));
        }
        edits.sort_by_key(|(index, _)| *index);
        Ok(Self(edits.into_iter().map(|(_, given)| given).collect()))
    }

    fn update_from_arg_matches(&mut self, matches: &ArgMatches) -> Result<(), clap::Error> {
        *self = Self::from_arg_matches(matches)?;
        Ok(())
    }
}

/// The lights of specifications, and what there is to say of their maps on the terminal.
///
/// # Errors
/// If a map is missing or malformed, by name.
pub fn open(specs: &[LightSpec]) -> Result<Vec<Light>> {
    let mut lights = Vec::with_capacity(specs.len());
    for spec in specs {
        let (light, warnings) = spec.open_with_warnings(Path::new(""))?;
        for warning in warnings {
            say_aside!("warning: {warning}");
        }
        lights.push(light);
    }
    Ok(lights)
}

/// Edits of the command line, then those of the file; all maps are read before any work. With `chain`, `set` goes on from
/// the edited tokens ([`Edit::chained`]).
///
/// # Errors
/// If a file is missing or malformed, by name.
pub fn read(given: &Edits, file: Option<&Path>, chain: bool) -> Result<Vec<Step>> {
    let edit = |mode: Mode, written: Vec<LightSpec>| -> Result<Step> {
        let mut edit = Edit::new(mode, open(&written)?);
        edit.chained = chain;
        Ok(Step::Edit { edit, written })
    };
    let mut edits = Vec::new();
    for given in &given.0 {
        edits.push(match given {
            Given::Lights(mode, written) => edit(*mode, written.clone())?,
            Given::Scale(factor) => Step::Scale(*factor),
        });
    }
    if let Some(path) = file {
        for (mode, written) in EditsFile::written(path)? {
            edits.push(edit(mode, written)?);
        }
    }
    Ok(edits)
}
