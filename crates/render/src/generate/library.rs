//! Models of a folder, of which only those drawn last are in memory.

use super::assets::{Failed, none_read};
use crate::image_texture::Image;
use crate::material::{Material, Textured};
use crate::models::{self, Import};
use crate::scene::mesh::Model;
use lumi_core::{Error, Result};
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Bytes of models that are kept for when they are drawn again.
const KEPT: usize = 1 << 30;

/// Model files that are read when they are drawn.
#[derive(Default)]
pub struct Library {
    folder: PathBuf,
    paths: Vec<PathBuf>,
    state: Mutex<State>,
}

#[derive(Default)]
struct State {
    /// The last one drawn is last.
    kept: Vec<(usize, Arc<Model>)>,
    /// Why files could not be read.
    failed: BTreeMap<usize, String>,
    /// Files whose warnings were said.
    said: BTreeSet<usize>,
    /// Warnings that nobody has taken yet.
    warnings: Vec<String>,
}

impl Library {
    /// The files `paths`, all of `folder`.
    #[must_use]
    pub fn new(folder: &Path, paths: Vec<PathBuf>) -> Self {
        Self {
            folder: folder.to_owned(),
            paths,
            state: Mutex::default(),
        }
    }

    /// How many files there are, good and bad.
    #[must_use]
    pub fn len(&self) -> usize {
        self.paths.len()
    }

    /// Whether there are none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.paths.is_empty()
    }

    /// Model `i`, or if it cannot be read the next one that can. So which model it is depends on the files alone.
    ///
    /// # Errors
    /// If none can be read.
    pub fn model(&self, i: usize) -> Result<Arc<Model>> {
        let n = self.paths.len();
        (0..n).find_map(|k| self.get((i + k) % n)).ok_or_else(|| {
            let state = self.state();
            let first = state.failed.values().next().map_or("", String::as_str);
            Error::invalid(&self.folder, "models", none_read(first))
        })
    }

    /// Up to `most` images of base colours of at least `side` pixels each way, each once, of the first models that have
    /// any. Which they are depends on the files alone.
    #[must_use]
    pub fn base_colors(&self, most: usize, side: usize) -> Vec<Arc<Image>> {
        let mut found: Vec<Arc<Image>> = Vec::new();
        for model in (0..self.len()).filter_map(|i| self.get(i)) {
            for material in &model.materials {
                let Material::Textured(textured) = material else {
                    continue;
                };
                let Some(base) = &textured.base else {
                    continue;
                };
                let image = &base.image;
                let large = image.width.min(image.height) >= side;
                if large && !found.iter().any(|f| Arc::ptr_eq(f, image)) {
                    found.push(Arc::clone(image));
                }
            }
            if found.len() >= most {
                break;
            }
        }
        found.truncate(most);
        found
    }

    /// What has been found in the models' files since the last call that is not shown.
    #[must_use]
    pub fn take_warnings(&self) -> Vec<String> {
        std::mem::take(&mut self.state().warnings)
    }

    /// The files that could not be read so far.
    #[must_use]
    pub fn failed(&self) -> Vec<Failed> {
        let state = self.state();
        let failed = state.failed.iter().map(|(&i, reason)| Failed {
            path: self.paths[i].clone(),
            reason: reason.clone(),
        });
        failed.collect()
    }

    /// Every change is whole, so a thread that panicked leaves nothing half done.
    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn get(&self, i: usize) -> Option<Arc<Model>> {
        let mut state = self.state();
        if state.failed.contains_key(&i) {
            return None;
        }
        if let Some(at) = state.kept.iter().position(|(k, _)| *k == i) {
            let found = state.kept.remove(at);
            state.kept.push(found.clone());
            return Some(found.1);
        }
        // Others may draw meanwhile; that two read the same file is rare and harmless.
        drop(state);
        let read = models::read(&self.paths[i]);
        let mut state = self.state();
        match read {
            Ok(Import { model, warnings }) => {
                if state.said.insert(i) {
                    let path = self.paths[i].display();
                    let named = warnings.iter().map(|w| format!("{path}: {w}"));
                    state.warnings.extend(named);
                }
                let model = Arc::new(model);
                state.keep(i, model.clone(), KEPT);
                Some(model)
            }
            Err(e) => {
                state.failed.insert(i, e.to_string());
                None
            }
        }
    }
}

impl State {
    /// Keeps a model and forgets the longest undrawn ones beyond `most` bytes.
    fn keep(&mut self, i: usize, model: Arc<Model>, most: usize) {
        self.kept.retain(|(k, _)| *k != i);
        self.kept.push((i, model));
        let sizes: Vec<usize> = self.kept.iter().map(|(_, m)| bytes(m)).collect();
        let mut total: usize = sizes.iter().sum();
        let too_many = sizes.iter().take_while(|&&size| {
            let over = total > most;
            total -= size;
            over
        });
        let too_many = too_many.count();
        self.kept.drain(..too_many);
    }
}

/// About what a model takes in memory.
fn bytes(model: &Model) -> usize {
    let mesh = &model.mesh;
    let vertices = size_of_val(&*mesh.positions)
        + size_of_val(&*mesh.normals)
        + size_of_val(&*mesh.coords)
        + size_of_val(&*mesh.second)
        + size_of_val(&*mesh.colors);
    let faces =
        size_of_val(&*mesh.triangles) + size_of_val(&*mesh.tangents) + size_of_val(&*mesh.material);
    // An image that several materials share is counted for each, which errs on the safe side.
    let materials = model.materials.iter().map(|m| match m {
        Material::Textured(t) => images(t),
        _ => 0,
    });
    vertices + faces + materials.sum::<usize>()
}

fn images(t: &Textured) -> usize {
    let textures = [
        &t.base,
        &t.metallic_roughness,
        &t.specular,
        &t.specular_color,
        &t.coat,
        &t.coat_roughness,
    ];
    let relief = [&t.normal, &t.coat_normal];
    let relief = relief.into_iter().flatten().map(|n| &n.texture);
    let all = textures.into_iter().flatten().chain(relief);
    all.map(|t| size_of_val(&*t.image.pixels)).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    const TRIANGLE: &str = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\nl 1 2\n";

    #[test]
    fn bad_files_are_passed_over_and_listed_and_warnings_are_said_once() {
        let folder = tempfile::tempdir().expect("folder");
        let paths = ["a.obj", "b.obj", "c.glb"].map(|n| folder.path().join(n));
        std::fs::write(&paths[0], "no model").expect("written");
        std::fs::write(&paths[1], TRIANGLE).expect("written");
        std::fs::write(&paths[2], "no model").expect("written");
        let library = Library::new(folder.path(), paths.to_vec());
        // Nothing is read before it is drawn.
        assert_eq!(library.failed(), []);
        for i in [1, 0, 2] {
            let model = library.model(i).expect("the good one");
            assert_eq!(model.mesh.triangles.len(), 1);
        }
        let failed: Vec<PathBuf> = library.failed().into_iter().map(|f| f.path).collect();
        assert_eq!(failed, [paths[0].clone(), paths[2].clone()]);
        let warnings = library.take_warnings();
        assert!(warnings.len() == 1 && warnings[0].contains("b.obj: 1 statements are lines"));
        library.model(1).expect("again");
        assert_eq!(library.take_warnings(), Vec::<String>::new());

        let bad = Library::new(folder.path(), vec![paths[0].clone(), paths[2].clone()]);
        let message = bad.model(1).expect_err("none").to_string();
        assert!(
            message.contains("found none") && message.contains("a.obj"),
            "{message}"
        );
    }

    #[test]
    fn only_so_many_bytes_are_kept() {
        let model = |n: usize| {
            let mut model = Model::default();
            model.mesh.positions = vec![Default::default(); n];
            Arc::new(model)
        };
        let mut state = State::default();
        let kept = |s: &State| s.kept.iter().map(|(i, _)| *i).collect::<Vec<_>>();
        for i in 0..3 {
            state.keep(i, model(10), 360);
        }
        assert_eq!(kept(&state), [0, 1, 2]);
        state.keep(0, model(10), 360);
        assert_eq!(kept(&state), [1, 2, 0]);
        state.keep(3, model(15), 360);
        assert_eq!(kept(&state), [0, 3]);
        // One that is too large by itself is in use, but not kept.
        state.keep(4, model(31), 360);
        assert_eq!(kept(&state), [0; 0]);
    }
}
