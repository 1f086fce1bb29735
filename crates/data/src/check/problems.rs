//! What is wrong or doubtful in a scene; the thresholds stand together here.

use super::report::{Problem, Report, Severity};
use lumi_core::{Camera, Scene, View};

/// Fewer inputs than this make a poor reconstruction (the paper uses 4 to 32).
const FEW_INPUTS: usize = 4;
/// Shares of the image between which an object should lie.
const COVERAGE: [f32; 2] = [0.01, 0.9];
/// Median hull agreement below which poses or masks are in doubt.
const HULL_MEDIAN: f32 = 0.75;
/// How far below the median a single view may fall.
const HULL_OUTLIER: f32 = 0.2;
/// Share of the object's pixels that may be clipped or black.
const CLIPPED: f32 = 0.1;
/// Mean display values between which a photograph is well exposed.
const EXPOSURE: [f32; 2] = [0.08, 0.9];
/// Lights closer than this (in ball radii) light the object very unevenly.
const CLOSE_LIGHT: f32 = 1.2;
/// Difference in alpha between the lights of one view that rounding to half floats cannot explain.
const ALPHA_DIFFERENCE: f32 = 0.01;
/// Relative difference between horizontal and vertical focal length that is unusual.
const ANISOTROPY: f32 = 0.05;

/// Horizontal fields of view, in degrees, that models learn from with a margin (the authors: 18° to 50°).
const FIELD_OF_VIEW: [f32; 2] = [12.0, 75.0];
/// Inputs closer together than this, in degrees, leave most of an object unseen.
const SPREAD: f32 = 40.0;
/// Share of the image's edge that an object may touch before it counts as cut off.
const CUT_OFF: f32 = 0.01;
/// Contrast and distance from white of a background that no mask removes.
const BACKGROUND: f32 = 0.06;
/// How far from +z up may be, in degrees.
const TILT: f32 = 35.0;
/// Difference in mean brightness between views that points to automatic exposure.
const EXPOSURE_SPREAD: f32 = 0.15;

/// Fills in `report.problems`, worst first.
pub(super) fn list(scene: &Scene, report: &mut Report) {
    let mut found = Found(Vec::new());
    for warning in &scene.warnings {
        let (field, text) = warning.split_once(": ").unwrap_or(("scene", warning));
        found.warning(field, text);
    }
    counts(report, &mut found);
    for view in &scene.views {
        camera(scene, view, &mut found);
    }
    masks(report, &mut found);
    surroundings(report, &mut found);
    exposure(report, &mut found);
    lights(scene, report, &mut found);
    found.0.sort_by_key(|p| p.severity);
    report.problems = found.0;
}

impl Report {
    /// Whether there are views without a mask whose background is not white: a model takes it for the object's.
    #[must_use]
    pub fn lacks_masks(&self) -> bool {
        self.background
            .is_some_and(|b| b.clutter > BACKGROUND || b.from_white > BACKGROUND)
    }
}

struct Found(Vec<Problem>);

impl Found {
    fn error(&mut self, field: impl Into<String>, text: impl Into<String>) {
        self.push(Severity::Error, field.into(), text.into());
    }

    fn warning(&mut self, field: impl Into<String>, text: impl Into<String>) {
        self.push(Severity::Warning, field.into(), text.into());
    }

    fn push(&mut self, severity: Severity, field: String, text: String) {
        self.0.push(Problem {
            severity,
            field,
            text,
        });
    }
}

fn counts(report: &Report, found: &mut Found) {
    if report.inputs == 0 {
        found.error("views", "expected at least one input view, found none");
    } else if report.inputs < FEW_INPUTS {
        let text = format!(
            "expected {FEW_INPUTS} or more input views for a good result, found {}",
            report.inputs
        );
        found.warning("views", text);
    }
    if report.sizes.len() > 1 {
        found.warning(
            "sizes",
            format!("expected one image size, found {}", report.sizes.len()),
        );
    }
    if report.sizes.iter().any(|[w, h]| w != h) {
        found.warning(
            "sizes",
            "images are not square: only a square around the scene's centre is used",
        );
    }
    if report.inputs >= 2 && report.spread_degrees < SPREAD {
        let text = format!(
            "expected input views that span {SPREAD}° or more around the object, found {:.0}°",
            report.spread_degrees
        );
        found.warning("views", text);
    }
    if report.repeated > 0 {
        let text = format!("{} input views repeat another one", report.repeated);
        found.warning("views", text);
    }
    let [narrow, wide] = report.fov_degrees;
    if narrow < FIELD_OF_VIEW[0] || wide > FIELD_OF_VIEW[1] {
        let [low, high] = FIELD_OF_VIEW;
        let text = format!("expected {low}° to {high}°, found {narrow:.1}° to {wide:.1}°");
        found.warning("field of view", text);
    }
    if let Some(tilt) = report.tilt_degrees.filter(|t| *t > TILT) {
        let text = format!(
            "expected a world that is z up; the cameras' up is {tilt:.0}° from it, so lights will come from elsewhere than meant"
        );
        found.warning("up", text);
    }
}

/// What is around the object, or cuts it.
fn surroundings(report: &Report, found: &mut Found) {
    for view in &report.views {
        if let Some(share) = view.cut_off.filter(|s| *s > CUT_OFF) {
            let text = format!(
                "the object is cut off: it touches {:.0} % of the image's edge",
                100.0 * share
            );
            found.warning(format!("view `{}`", view.name), text);
        }
    }
    if let Some(background) = report.background.filter(|_| report.lacks_masks()) {
        let text = format!(
            "expected white around objects without a mask, found a contrast of {:.2} and {:.2} from white; add masks",
            background.clutter, background.from_white
        );
        found.warning("background", text);
    }
}

fn camera(scene: &Scene, view: &View, found: &mut Found) {
    let field = format!("view `{}`", view.name);
    if let Err(e) = view.camera.validate() {
        found.error(field, e.to_string());
        return;
    }
    let camera: Camera = view.camera.transformed(&scene.to_model);
    if let Some(image) = &view.image {
        let (found_size, stated) = ((image.width, image.height), (camera.width, camera.height));
        if found_size != stated {
            found.error(&field, format!("expected an image of {stated:?} pixels as the camera says, found {found_size:?}"));
        }
    }
    if (camera.fx / camera.fy - 1.0).abs() > ANISOTROPY {
        found.warning(
            &field,
            format!(
                "expected square pixels, found fx {} and fy {}",
                camera.fx, camera.fy
            ),
        );
    }
    let distance = camera.centre().length();
    if distance <= 1.0 {
        found.error(&field, format!("expected a camera outside the bounding ball, found it at {distance:.2} of its radius"));
    }
    let (x, y, z) = camera.project(glam::Vec3::ZERO);
    let inside = x >= 0.0 && y >= 0.0 && x < camera.width as f32 && y < camera.height as f32;
    if z <= 0.0 {
        found.error(
            &field,
            "expected a camera that looks at the scene, found it looking away (OpenGL axes?)",
        );
    } else if !inside {
        found.warning(&field, "the scene's centre falls outside the image");
    }
}

fn masks(report: &Report, found: &mut Found) {
    let total = report.views.len();
    if report.masks < total {
        let text = format!(
            "expected alpha or a mask in every view (background turns white), found {} of {total}",
            report.masks
        );
        found.warning("masks", text);
    }
    for view in &report.views {
        let field = format!("view `{}`", view.name);
        match view.coverage {
            // Readers of photographs say so themselves.
            Some(0.0 | 1.0) if report.lights.is_empty() => {}
            Some(c) if !(COVERAGE[0]..=COVERAGE[1]).contains(&c) => {
                let text = format!("the object covers {:.1} % of the image", 100.0 * c);
                found.warning(&field, text);
            }
            _ => {}
        }
        if let Some((iou, median)) = view.hull.zip(report.hull_median)
            && iou < median - HULL_OUTLIER
        {
            found.warning(&field, format!("its mask disagrees with the other views' hull: IoU {iou:.2} against a median of {median:.2}"));
        }
    }
    if let Some(median) = report.hull_median.filter(|m| *m < HULL_MEDIAN) {
        found.warning(
            "poses",
            format!("masks and poses disagree: median IoU of the visual hull is {median:.2}"),
        );
    }
}

fn exposure(report: &Report, found: &mut Found) {
    let Some(exposure) = &report.exposure else {
        return;
    };
    if exposure.clipped > CLIPPED {
        found.warning(
            "exposure",
            format!(
                "{:.0} % of the object's pixels are clipped",
                100.0 * exposure.clipped
            ),
        );
    }
    if exposure.black > CLIPPED {
        found.warning(
            "exposure",
            format!(
                "{:.0} % of the object's pixels are black",
                100.0 * exposure.black
            ),
        );
    }
    if exposure.spread > EXPOSURE_SPREAD && report.photograph_lights < 2 {
        let text = format!(
            "views differ by {:.2} in mean brightness: automatic exposure?",
            exposure.spread
        );
        found.warning("exposure", text);
    }
    if exposure.mean < EXPOSURE[0] || exposure.mean > EXPOSURE[1] {
        let [low, high] = EXPOSURE;
        found.warning(
            "exposure",
            format!(
                "expected a mean of {low} to {high}, found {:.2}",
                exposure.mean
            ),
        );
    }
}

fn lights(scene: &Scene, report: &Report, found: &mut Found) {
    let Some(basis) = &scene.basis else {
        return;
    };
    for (named, measured) in basis.lights.iter().zip(&report.lights) {
        let field = format!("light `{}`", named.name);
        if let Err(e) = named.light.transformed(&scene.to_model).validate() {
            found.error(&field, e.to_string());
        } else if let Some(distance) = measured.distance.filter(|d| *d < CLOSE_LIGHT) {
            found.warning(
                &field,
                format!("stands very close to the object, at {distance:.2} ball radii"),
            );
        }
        if measured.mean_radiance <= 0.0 {
            found.warning(&field, "its images are black");
        }
    }
    let Some(first) = basis.radiance.first() else {
        return;
    };
    for (i, view) in scene.views.iter().enumerate() {
        let difference = |p: &[f32; 4], q: &[f32; 4]| (p[3] - q[3]).abs();
        let largest = basis.radiance[1..]
            .iter()
            .flat_map(|images| images[i].pixels.iter().zip(&first[i].pixels))
            .map(|(p, q)| difference(p, q))
            .fold(0.0, f32::max);
        if largest > ALPHA_DIFFERENCE {
            found.warning(
                format!("view `{}`", view.name),
                format!("expected one alpha for all lights, found differences of {largest:.2}"),
            );
        }
    }
}
