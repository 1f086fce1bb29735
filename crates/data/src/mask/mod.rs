//! Which pixels are the object's, from several posed photographs at once.
//!
//! Nobody says what the object is; that cameras go around it does. So the ball of the scene ([`crate::ball`]) is where it
//! begins: what lies outside of it is background, and colours that are more frequent near its centre than outside are
//! taken for the object's. From there on, for a few rounds:
//!
//! 1. Colour models of object and background say how each pixel looks.
//! 2. The views vote in space: a voxel whose pixel looks like background in more than a few views is empty. What
//!    is left is the visual hull; its outline tells each view what the others think.
//! 3. Each view is cut (GrabCut's energy: Rother, Kolmogorov and Blake, 2004) with both as costs of a pixel, and costs
//!    between neighbours that fall with contrast.
//!
//! That views agree through the hull is the idea of Campbell, Vogiatzis, Hernández and Cipolla ("Automatic 3D Object
//! Segmentation in Multiple Views using Volumetric Graph-Cuts", 2010); so is that cameras fixate the object.

mod color;
mod cut;
mod hull;
mod soften;

use color::Colors;
use cut::Grid;
use glam::Vec3;
use hull::{Evidence, Hull};
use lumi_core::image::area_resize;
use lumi_core::{Camera, Error, Event, Progress, Result, Scene};
use rayon::prelude::*;
use soften::soften;

/// Rounds of colours, hull and cut.
const ROUNDS: usize = 5;

/// Views are cut at this many pixels along their longer side.
const SIDE: usize = 320;

/// Rays that pass the centre nearer than this, in ball radii, see the object at first.
const CORE: f32 = 0.45;

/// Evidence of one pixel counts for this much at the most, in nats.
const SURE: f32 = 4.0;

/// Weight of what the other views say against the pixel's own colour.
const OTHERS: f32 = 1.0;

/// Cost of parting two neighbours of one colour.
const EDGE: f32 = 6.0;

/// Share of a view's own colours in its background model; the rest is all views'.
const OWN: f32 = 0.5;

/// Pixels within which edges are soft, at 1024 pixels along the longer side.
const SOFT: f32 = 6.0;

/// A view at the size that is cut.
struct Small {
    /// In model space.
    camera: Camera,
    pixels: Vec<[f32; 3]>,
    /// How far each pixel's ray passes from the centre, in ball radii.
    passes: Vec<f32>,
}

/// Coverage of every view's photograph by the object, in [0, 1], row-major and as large as the photograph.
///
/// # Errors
/// Names the view without a photograph; fails if there are fewer than two, or if no object can be told from the background.
pub fn masks(scene: &Scene, progress: &dyn Progress) -> Result<Vec<Vec<f32>>> {
    let views = scene.views.iter().map(|view| {
        let image = view.image.as_ref();
        let image = image.ok_or_else(|| {
            Error::value(format!("view `{}`", view.name), "expected a photograph")
        })?;
        let longer = image.width.max(image.height);
        let side = |s: usize| (s * SIDE.min(longer)).div_ceil(longer);
        let (width, height) = (side(image.width), side(image.height));
        Ok(Small::new(
            view.camera.transformed(&scene.to_model).resized(width, height),
            image.resized(width, height).pixels,
        ))
    });
    let views: Vec<Small> = views.collect::<Result<_>>()?;
    if views.len() < 2 {
        let expected = format!("expected two views or more, found {}", views.len());
        return Err(Error::value("masks", expected));
    }
    progress.event(Event::Begin {
        stage: "masks".into(),
        total: ROUNDS as u64,
    });
    let mut evidence = views[0].first(&views);
    let mut cuts: Vec<Vec<bool>> = Vec::new();
    for round in 0..ROUNDS {
        let seen: Vec<Evidence> = views
            .iter()
            .zip(&evidence)
            .map(|(view, pixels)| Evidence {
                camera: view.camera,
                pixels,
            })
            .collect();
        let hull = Hull::of(&seen, -SURE);
        cuts = views
            .par_iter()
            .zip(&evidence)
            .map(|(view, own)| view.cut(own, &hull.seen(&view.camera, -SURE)))
            .collect();
        if std::env::var("DUMP").is_ok() {
            let c: Vec<String> = cuts.iter().map(|c| format!("{:.2}", c.iter().filter(|x| **x).count() as f32 / c.len() as f32)).collect();
            eprintln!("{round} {}", c.join(" "));
        }
        evidence = colored(&views, &cuts);
        progress.event(Event::Step {
            done: round as u64 + 1,
            note: String::new(),
        });
    }
    progress.event(Event::End);
    let found = scene.views.iter().zip(&views).zip(&cuts);
    let full = found.map(|((view, small), cut)| {
        let Some(image) = &view.image else {
            return Vec::new();
        };
        let inside: Vec<f32> = cut.iter().map(|c| f32::from(u8::from(*c))).collect();
        let (width, height) = (image.width, image.height);
        let from = (small.camera.width, small.camera.height, 1);
        let large = area_resize(&inside, from, (width, height));
        let large: Vec<f32> = large
            .iter()
            .map(|a| if *a >= 0.5 { 1.0 } else { 0.0 })
            .collect();
        let grey: Vec<f32> = image
            .pixels
            .iter()
            .map(|p| (p[0] + p[1] + p[2]) / 3.0)
            .collect();
        let radius = SOFT * width.max(height) as f32 / 1024.0;
        soften((width, height), &grey, &large, (radius.round() as usize).max(2))
    });
    Ok(full.collect())
}

impl Small {
    fn new(camera: Camera, pixels: Vec<[f32; 3]>) -> Self {
        let to_centre = -camera.centre();
        let pass = |d: Vec3| {
            if d.dot(to_centre) > 0.0 {
                d.cross(to_centre).length()
            } else {
                f32::INFINITY
            }
        };
        Self {
            passes: camera.directions().into_iter().map(pass).collect(),
            camera,
            pixels,
        }
    }

    fn first(&self, views: &[Self]) -> Vec<Vec<f32>> {
        let core: Vec<Vec<bool>> = views
            .iter()
            .map(|v| v.passes.iter().map(|p| *p < CORE).collect())
            .collect();
        colored(views, &core)
    }

    /// The cut of least cost, of a pixel's own evidence and what the other views say.
    fn cut(&self, own: &[f32], others: &[f32]) -> Vec<bool> {
        let terminal = own
            .iter()
            .zip(others)
            .zip(&self.passes)
            .map(|((own, others), pass)| {
                if *pass > 1.0 {
                    -50.0
                } else {
                    own + OTHERS * others
                }
            })
            .collect();
        let difference = |p: usize, q: usize| -> f32 {
            let pairs = self.pixels[p].iter().zip(&self.pixels[q]);
            pairs.map(|(a, b)| (a - b) * (a - b)).sum()
        };
        let width = self.camera.width;
        let count = self.pixels.len();
        let mean = (1..count).map(|p| difference(p - 1, p)).sum::<f32>() / count as f32;
        let falls = 1.0 / (2.0 * mean).max(1e-6);
        let mut grid = Grid::new(width, self.camera.height, terminal);
        grid.connect(|p, q| {
            let apart = if p % width == q % width || p / width == q / width {
                1.0
            } else {
                std::f32::consts::FRAC_1_SQRT_2
            };
            EDGE * apart * (-falls * difference(p, q)).exp()
        });
        grid.cut()
    }
}

/// Evidence of each pixel from colour models of what is cut out now and what is not.
fn colored(views: &[Small], cuts: &[Vec<bool>]) -> Vec<Vec<f32>> {
    let mut object = Colors::new();
    let mut around = Colors::new();
    let mut own = Vec::new();
    for (view, cut) in views.iter().zip(cuts) {
        let mut background = Colors::new();
        for ((color, inside), pass) in view.pixels.iter().zip(cut).zip(&view.passes) {
            if *inside {
                object.add(*color, 1.0);
            } else if *pass > 1.0 || true {
                background.add(*color, 1.0);
                around.add(*color, 1.0);
            }
        }
        background.smooth();
        own.push(background);
    }
    object.smooth();
    around.smooth();
    let of = |(view, own): (&Small, &Colors)| -> Vec<f32> {
        let ratio = |color: &[f32; 3]| {
            let background = OWN * own.density(*color) + (1.0 - OWN) * around.density(*color);
            (object.density(*color) / background).ln().clamp(-SURE, SURE)
        };
        view.pixels.iter().map(ratio).collect()
    };
    views.par_iter().zip(&own).map(of).collect()
}
