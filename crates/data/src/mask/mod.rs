//! Which pixels are the object's, from several posed photographs at once.
//!
//! Nobody says what the object is; that the cameras go around it does. So it begins with the ball of the scene
//! ([`crate::ball`]): what lies well outside of it is background, and colours that are more frequent near its centre than
//! elsewhere are taken for the object's. From there on, for a few rounds:
//!
//! 1. Models of the object's and the background's colours say how each pixel looks.
//! 2. The views vote in space: a voxel that looks like background to more than a few of them is empty. What is left is the
//!    visual hull, which tells each view what the others think.
//! 3. Each view is cut at the least cost: pixels cost what both say against them, and neighbours that are parted the more
//!    the more they look alike (GrabCut's energy: Rother, Kolmogorov and Blake, 2004).
//!
//! That cameras fixate the object, and that the views agree in space, is how Campbell, Vogiatzis, Hernández and Cipolla
//! segment ("Automatic 3D Object Segmentation in Multiple Views using Volumetric Graph-Cuts", 2010).

mod color;
mod cut;
mod hull;
mod soften;

use color::Colors;
use cut::Grid;
use glam::Vec3;
use hull::{Evidence, Hull};
use lumi_core::image::area_resize;
use lumi_core::{Camera, DisplayImage, Error, Event, Progress, Result, Scene, Similarity, View};
use rayon::prelude::*;
use std::f32::consts::FRAC_1_SQRT_2;

/// Rounds of colours, hull and cut; after three hardly a pixel changes.
const ROUNDS: usize = 5;

/// Views are cut at this many pixels along their longer side.
const SIDE: usize = 320;

/// What lies beyond this many radii of the scene's ball is background, and what lies between is so the likelier the farther
/// out it is: without masks the ball is a guess from the cameras alone.
const REACH: f32 = 1.25;

/// Rays that pass the centre within this many radii of the ball see the object at first.
const CORE: f32 = 0.45;

/// Evidence of one pixel counts for this much at the most, in nats: a view can be outvoted.
const SURE: f32 = 4.0;

/// Cost of parting two neighbours of one colour, in nats.
const EDGE: f32 = 6.0;

/// Share of a view's own colours in the model of its background; the rest is all views'.
const OWN: f32 = 0.5;

/// Pixels on both sides of the outline within which the mask follows the photograph, of 1024 along the longer side.
const SOFT: f32 = 6.0;

/// A view as it is cut.
struct Small {
    /// In a space where the unit ball is what may be the object.
    camera: Camera,
    pixels: Vec<[f32; 3]>,
    /// How far each pixel's ray passes from the ball's centre.
    passes: Vec<f32>,
}

/// Coverage of every view's photograph by the object: in [0, 1], row-major, as large as the photograph. Photographs must
/// have their background; an alpha of theirs is not looked at.
///
/// # Errors
/// Names the view without a photograph; fails if there are fewer than two views.
pub fn masks(scene: &Scene, progress: &dyn Progress) -> Result<Vec<Vec<f32>>> {
    let images = scene.views.iter().map(photograph);
    let images: Vec<&DisplayImage> = images.collect::<Result<_>>()?;
    if images.len() < 2 {
        let expected = format!("expected two views or more, found {}", images.len());
        return Err(Error::value("masks", expected));
    }
    let ball = scene.to_model.inverse();
    let space = Similarity::to_unit_ball(ball.point(Vec3::ZERO), REACH * ball.scale);
    let views: Vec<Small> = scene
        .views
        .par_iter()
        .zip(&images)
        .map(|(view, image)| Small::new(&view.camera.transformed(&space), image))
        .collect();
    progress.event(Event::Begin {
        stage: "finding masks".into(),
        total: ROUNDS as u64,
    });
    let core = |view: &Small| view.passes.iter().map(|p| *p < CORE / REACH).collect();
    let mut cuts: Vec<Vec<bool>> = views.iter().map(core).collect();
    for round in 1..=ROUNDS as u64 {
        cuts = cut_again(&views, &cuts);
        progress.event(Event::Step {
            done: round,
            note: String::new(),
        });
    }
    progress.event(Event::End);
    let found = images.par_iter().zip(&views).zip(&cuts);
    Ok(found
        .map(|((image, view), cut)| enlarged(image, &view.camera, cut))
        .collect())
}

fn photograph(view: &View) -> Result<&DisplayImage> {
    let missing = || Error::value(format!("view `{}`", view.name), "expected a photograph");
    view.image.as_ref().ok_or_else(missing)
}

/// One round, from the cuts of the last one.
fn cut_again(views: &[Small], cuts: &[Vec<bool>]) -> Vec<Vec<bool>> {
    let colored = colored(views, cuts);
    let evidence: Vec<Evidence> = views
        .iter()
        .zip(&colored)
        .map(|(view, pixels)| Evidence {
            camera: view.camera,
            pixels,
        })
        .collect();
    let hull = Hull::of(&evidence, -SURE);
    let seen = views.par_iter().zip(&colored);
    seen.map(|(view, own)| view.cut(own, &hull.seen(&view.camera, -SURE)))
        .collect()
}

/// For each pixel, how much likelier its colour is in what is cut out than in the rest, in nats.
fn colored(views: &[Small], cuts: &[Vec<bool>]) -> Vec<Vec<f32>> {
    let (mut object, mut around) = (Colors::new(), Colors::new());
    let mut backgrounds = Vec::with_capacity(views.len());
    for (view, cut) in views.iter().zip(cuts) {
        let mut background = Colors::new();
        for (color, inside) in view.pixels.iter().zip(cut) {
            if *inside {
                object.add(*color);
            } else {
                background.add(*color);
                around.add(*color);
            }
        }
        background.smooth();
        backgrounds.push(background);
    }
    object.smooth();
    around.smooth();
    let of = |(view, own): (&Small, &Colors)| -> Vec<f32> {
        let ratio = |color: &[f32; 3]| {
            let background = OWN * own.density(*color) + (1.0 - OWN) * around.density(*color);
            (object.density(*color) / background)
                .ln()
                .clamp(-SURE, SURE)
        };
        view.pixels.iter().map(ratio).collect()
    };
    views.par_iter().zip(&backgrounds).map(of).collect()
}

impl Small {
    fn new(camera: &Camera, image: &DisplayImage) -> Self {
        let longer = image.width.max(image.height);
        let side = |s: usize| (s * SIDE.min(longer)).div_ceil(longer);
        let (width, height) = (side(image.width), side(image.height));
        let camera = camera.resized(width, height);
        let to_centre = -camera.centre();
        let passes = |direction: Vec3| {
            if direction.dot(to_centre) > 0.0 {
                direction.cross(to_centre).length()
            } else {
                f32::INFINITY
            }
        };
        Self {
            passes: camera.directions().into_iter().map(passes).collect(),
            pixels: image.resized(width, height).pixels,
            camera,
        }
    }

    /// The cut of least cost, by evidence of the pixels' own colours and of the other views.
    fn cut(&self, own: &[f32], others: &[f32]) -> Vec<bool> {
        // More than all neighbours together can be worth.
        const NEVER: f32 = -8.0 * EDGE - 2.0 * SURE;
        let sum = |((own, others), pass): ((&f32, &f32), &f32)| {
            let beyond = (REACH * pass - 1.0) / (REACH - 1.0);
            if beyond > 1.0 {
                NEVER
            } else {
                own + others - 2.0 * SURE * beyond.max(0.0)
            }
        };
        let evidence = own.iter().zip(others).zip(&self.passes).map(sum).collect();
        let difference = |p: usize, q: usize| -> f32 {
            let pairs = self.pixels[p].iter().zip(&self.pixels[q]);
            pairs.map(|(a, b)| (a - b) * (a - b)).sum()
        };
        let (width, count) = (self.camera.width, self.pixels.len());
        let mean = (1..count).map(|q| difference(q - 1, q)).sum::<f32>() / count as f32;
        let sharpness = 1.0 / (2.0 * mean).max(1e-6);
        let mut grid = Grid::new(width, self.camera.height, evidence);
        grid.connect(|p, q| {
            let straight = p % width == q % width || p / width == q / width;
            let nearness = if straight { 1.0 } else { FRAC_1_SQRT_2 };
            EDGE * nearness * (-sharpness * difference(p, q)).exp()
        });
        grid.cut()
    }
}

/// A cut at the photograph's size, with edges as soft as the photograph's.
fn enlarged(image: &DisplayImage, camera: &Camera, cut: &[bool]) -> Vec<f32> {
    let hard = |inside: bool| f32::from(u8::from(inside));
    let inside: Vec<f32> = cut.iter().map(|c| hard(*c)).collect();
    let size = (image.width, image.height);
    let large = area_resize(&inside, (camera.width, camera.height, 1), size);
    let large: Vec<f32> = large.iter().map(|a| hard(*a >= 0.5)).collect();
    let grey = |p: &[f32; 3]| (p[0] + p[1] + p[2]) / 3.0;
    let grey: Vec<f32> = image.pixels.iter().map(grey).collect();
    let radius = SOFT * size.0.max(size.1) as f32 / 1024.0;
    soften::soften(size, &grey, &large, (radius.round() as usize).max(2))
}
