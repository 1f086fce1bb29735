//! Light groups: the pictures of one light each, which add up to those of all.

use crate::commands::relight::place;
use crate::edits::Step;
use anyhow::{Result, bail};
use lumi_core::image::write_layers;
use lumi_core::{Camera, Light};
use lumi_model::{Edit, Mode, Relighter, SceneTokens};
use std::path::Path;

/// A light of the result and the scene under it alone.
pub struct Group {
    /// `captured`, or the light's number and kind, such as `2-point`.
    pub name: String,
    /// The light; none for the captured one.
    light: Option<Light>,
    tokens: SceneTokens,
}

impl Group {
    /// The scene under it alone.
    #[must_use]
    pub fn tokens(&self) -> &SceneTokens {
        &self.tokens
    }
}

/// The lights that are on after `steps`, each with one `set` from the captured tokens.
///
/// # Errors
/// If a light is removed that is not there, and as [`Relighter::edit`].
pub fn of(model: &Relighter, captured: &SceneTokens, steps: &[Step]) -> Result<Vec<Group>> {
    let first = || Group {
        name: "captured".into(),
        light: None,
        tokens: captured.clone(),
    };
    let mut groups = vec![first()];
    let mut number = 0;
    for step in steps {
        let edit = match step {
            Step::Scale(factor) => {
                for group in &mut groups {
                    group.tokens = group.tokens.scaled([*factor; 3]);
                }
                continue;
            }
            Step::Edit { edit, .. } => edit,
        };
        if edit.mode == Mode::Set {
            groups.clear();
        }
        for light in &edit.lights {
            if edit.mode == Mode::Remove {
                let found = groups.iter().position(|g| g.light.as_ref() == Some(light));
                let Some(found) = found else {
                    bail!(
                        "--layers: expected to remove a light as it was set or added, found another {}",
                        light.kind()
                    );
                };
                groups.remove(found);
                continue;
            }
            number += 1;
            groups.push(Group {
                name: format!("{number}-{}", light.kind()),
                tokens: model.edit(captured, &Edit::set([light.clone()]))?,
                light: Some(light.clone()),
            });
        }
    }
    Ok(groups)
}

/// One multilayer OpenEXR per view: a layer of linear radiance per group, and alpha.
///
/// # Errors
/// If the model makes no radiance, or a file cannot be written.
pub fn write(
    folder: &Path,
    model: &Relighter,
    groups: &[Group],
    names: &[&str],
    cameras: &[Camera],
) -> Result<()> {
    crate::commands::make_folder(folder)?;
    let mut rendered = Vec::new();
    for group in groups {
        rendered.push(model.render_radiance(&group.tokens, cameras)?.into_iter());
    }
    for name in names {
        let layers = groups.iter().zip(&mut rendered);
        let layers: Vec<_> = layers
            .filter_map(|(group, images)| Some((group.name.as_str(), images.next()?)))
            .collect();
        write_layers(place(folder, name, "exr")?, &layers)?;
    }
    Ok(())
}
