//! Edits as a person writes them: `--set`, `--add`, `--remove`, and files of them.

use anyhow::Result;
use clap::{ArgAction, ArgMatches, FromArgMatches};
use lumi_core::Light;
use lumi_core::light::LightSpec;
use lumi_model::{Edit, EditsFile, Mode};
use std::path::Path;

/// `--set`, `--add`, `--remove` in the order in which they were given.
#[derive(Clone, Debug)]
pub struct Edits(Vec<(Mode, Vec<LightSpec>)>);

const MODES: [(&str, Mode, &str); 3] = [
    ("set", Mode::Set, "Replace all light"),
    ("add", Mode::Add, "Add lights"),
    ("remove", Mode::Remove, "Take lights away"),
];

impl clap::Args for Edits {
    fn augment_args(command: clap::Command) -> clap::Command {
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
                edits.push((first, mode, lights));
            }
        }
        edits.sort_by_key(|(index, ..)| *index);
        Ok(Self(
            edits
                .into_iter()
                .map(|(_, mode, lights)| (mode, lights))
                .collect(),
        ))
    }

    fn update_from_arg_matches(&mut self, matches: &ArgMatches) -> Result<(), clap::Error> {
        *self = Self::from_arg_matches(matches)?;
        Ok(())
    }
}

/// Edits of the command line, then those of the file; all maps are read before any work.
///
/// # Errors
/// If a file is missing or malformed, by name.
pub fn read(given: &Edits, file: Option<&Path>) -> Result<Vec<Edit>> {
    let open = |specs: &[LightSpec], base: &Path| -> Result<Vec<Light>> {
        let mut lights = Vec::with_capacity(specs.len());
        for spec in specs {
            let (light, warnings) = spec.open_with_warnings(base)?;
            for warning in warnings {
                eprintln!("warning: {warning}");
            }
            lights.push(light);
        }
        Ok(lights)
    };
    let mut edits = Vec::new();
    for (mode, specs) in &given.0 {
        edits.push(Edit {
            mode: *mode,
            lights: open(specs, Path::new(""))?,
        });
    }
    if let Some(path) = file {
        edits.extend(EditsFile::read(path)?);
    }
    Ok(edits)
}
