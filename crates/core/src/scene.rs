//! The record that every scene format yields.

use crate::{Camera, DisplayImage, Light, LinearImage, Similarity};

/// What a view is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Role {
    /// May be given to the encoder.
    Input,
    /// Held out, to be compared with.
    Target,
}

/// A posed photograph, or only a pose to look from.
#[derive(Clone, Debug)]
pub struct View {
    /// Name of the view, such as `v03`.
    pub name: String,
    /// What it is for.
    pub role: Role,
    /// World-space camera at the image's resolution.
    pub camera: Camera,
    /// The photograph; `None` where only the light basis shows this view.
    pub image: Option<DisplayImage>,
}

/// A light with the name that files give it.
#[derive(Clone, Debug)]
pub struct NamedLight {
    /// Name, such as `point0`.
    pub name: String,
    /// The light in world space.
    pub light: Light,
}

/// The scene under one light at a time; sums of these are exact images under many lights.
#[derive(Clone, Debug, Default)]
pub struct LightBasis {
    /// The lights.
    pub lights: Vec<NamedLight>,
    /// `radiance[light][view]`, views as in [`Scene::views`].
    pub radiance: Vec<Vec<LinearImage>>,
}

impl LightBasis {
    /// Index of the light called `name`.
    #[must_use]
    pub fn find(&self, name: &str) -> Option<usize> {
        self.lights.iter().position(|l| l.name == name)
    }

    /// `view` under the sum of lights, each with its per-channel gain.
    ///
    /// # Panics
    /// If an index is out of range or `lights` is empty.
    #[must_use]
    pub fn compose(&self, view: usize, lights: &[(usize, [f32; 3])]) -> LinearImage {
        let first = &self.radiance[lights[0].0][view];
        let mut image = LinearImage::new(first.width, first.height);
        for (pixel, source) in image.pixels.iter_mut().zip(&first.pixels) {
            pixel[3] = source[3];
        }
        for &(light, gain) in lights {
            image.add_light(&self.radiance[light][view], gain);
        }
        image
    }
}

/// A capture: views, and what is known of its light.
#[derive(Clone, Debug)]
pub struct Scene {
    /// Name, usually the folder's.
    pub name: String,
    /// Posed views.
    pub views: Vec<View>,
    /// World to model space: the scene's bounding ball becomes the unit ball.
    pub to_model: Similarity,
    /// One-light-at-a-time images, where the data has them.
    pub basis: Option<LightBasis>,
    /// For each view, the lights that its photograph was taken under, in world space; a view's list is
    /// empty where they are not known. Empty as a whole where no photograph's light is known.
    pub lit_by: Vec<Vec<NamedLight>>,
    /// For each view, the photograph's radiance without clipping: only for held-out views whose light is known, and
    /// whose files hold linear values. Empty as a whole where there is none.
    pub radiance: Vec<Option<LinearImage>>,
    /// What the reader assumed, left out or could not apply, a line each that begins with the file, view or field.
    /// Commands print them, and `scene check` lists them with its own findings.
    pub warnings: Vec<String>,
}

impl Scene {
    /// The lights that the photograph of view `i` was taken under, in world space; empty where not known.
    #[must_use]
    pub fn lights_of(&self, i: usize) -> &[NamedLight] {
        self.lit_by.get(i).map_or(&[], Vec::as_slice)
    }

    /// The unclipped photograph of view `i`, premultiplied; `None` where only the clipped one is known.
    #[must_use]
    pub fn radiance_of(&self, i: usize) -> Option<&LinearImage> {
        self.radiance.get(i)?.as_ref()
    }

    /// Indices of the views with this role.
    #[must_use]
    pub fn with_role(&self, role: Role) -> Vec<usize> {
        (0..self.views.len())
            .filter(|&i| self.views[i].role == role)
            .collect()
    }
}
