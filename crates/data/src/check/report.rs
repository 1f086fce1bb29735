//! What `lumi scene check` says: the record, and how it reads as text.

use serde::Serialize;
use std::fmt;

/// Everything that was found out about a scene.
#[derive(Clone, Debug, Serialize)]
pub struct Report {
    /// The scene's name.
    pub name: String,
    /// The format it was read as.
    pub format: String,
    /// Number of input views.
    pub inputs: usize,
    /// Number of held-out views.
    pub targets: usize,
    /// Distinct image sizes, `[width, height]`.
    pub sizes: Vec<[usize; 2]>,
    /// Smallest and largest horizontal focal length over the image width.
    pub focal_over_width: [f32; 2],
    /// Smallest and largest horizontal field of view in degrees.
    pub fov_degrees: [f32; 2],
    /// Smallest and largest distance of a camera from the scene's centre, in ball radii.
    pub distance: [f32; 2],
    /// Centre of the bounding ball in world units.
    pub ball_centre: [f32; 3],
    /// Radius of the bounding ball in world units.
    pub ball_radius: f32,
    /// Views whose pose is rigid and whose intrinsics are sound.
    pub sound_cameras: usize,
    /// Views with a mask or alpha.
    pub masks: usize,
    /// Smallest, median and largest share of the pixels that the object covers.
    pub coverage: Option<[f32; 3]>,
    /// Largest angle in degrees between an optical axis and the scene's centre.
    pub look_at_degrees: f32,
    /// Median over the views of mask against reprojected visual hull (intersection over union).
    pub hull_median: Option<f32>,
    /// Widest angle in degrees between two input views, seen from the scene's centre.
    pub spread_degrees: f32,
    /// Input views within a degree of another one, which add nothing.
    pub repeated: usize,
    /// Angle in degrees between +z and what the cameras take for up; `None` if they do not say.
    pub tilt_degrees: Option<f32>,
    /// Contrast of the background of views without a mask (standard deviation of display values along the
    /// image's edge, the largest of all views), and how far it is from white on average.
    pub background: Option<Background>,
    /// Exposure of the photographs.
    pub exposure: Option<Exposure>,
    /// Each view.
    pub views: Vec<ViewReport>,
    /// Each light of the basis.
    pub lights: Vec<LightReport>,
    /// Photographs whose light is known.
    pub photographs_lit: usize,
    /// The different lights that photographs were taken under.
    pub photograph_lights: usize,
    /// What is wrong or doubtful, worst first.
    pub problems: Vec<Problem>,
}

/// Display values of the object's pixels (all pixels where there is no mask), over all photographs.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Exposure {
    /// Mean of the three channels, 0 to 1.
    pub mean: f32,
    /// Share of pixels with a channel at the upper end.
    pub clipped: f32,
    /// Share of pixels with all channels at the lower end.
    pub black: f32,
    /// Largest difference of a view's mean from the mean of all: automatic exposure shows here.
    pub spread: f32,
}

/// What surrounds the object where no mask says which pixels are its own.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Background {
    /// Standard deviation of display values along the edge of the most cluttered view.
    pub clutter: f32,
    /// Mean distance of the edges' display values from white.
    pub from_white: f32,
}

/// One view.
#[derive(Clone, Debug, Serialize)]
pub struct ViewReport {
    /// Its name.
    pub name: String,
    /// `input` or `target`.
    pub role: &'static str,
    /// Distance from the scene's centre in ball radii.
    pub distance: f32,
    /// Angle in degrees between the optical axis and the scene's centre.
    pub look_at_degrees: f32,
    /// Share of the pixels that the object covers.
    pub coverage: Option<f32>,
    /// Mask against reprojected visual hull.
    pub hull: Option<f32>,
    /// Share of the image's edge that the object touches.
    pub cut_off: Option<f32>,
    /// Mean display value of the object's pixels.
    pub brightness: Option<f32>,
}

/// One light of the basis.
#[derive(Clone, Debug, Serialize)]
pub struct LightReport {
    /// Its name.
    pub name: String,
    /// `environment`, `point` or `area`.
    pub kind: &'static str,
    /// Power in watts in the world (point, area).
    pub power: Option<f32>,
    /// Integral of the radiance over the sphere, strength included, mean of the channels (environment).
    pub energy: Option<f32>,
    /// Distance from the scene's centre in ball radii (point, area).
    pub distance: Option<f32>,
    /// Mean linear value of the object's pixels at gain 1, over all views and channels.
    pub mean_radiance: f32,
}

/// How bad a problem is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Severity {
    /// Results will be wrong.
    Error,
    /// Results may suffer.
    Warning,
}

/// Something wrong or doubtful.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Problem {
    /// How bad it is.
    pub severity: Severity,
    /// The view, light or property.
    pub field: String,
    /// What was expected, and what was found.
    pub text: String,
}

impl Report {
    /// Whether any problem is an error.
    #[must_use]
    pub fn has_errors(&self) -> bool {
        self.problems.iter().any(|p| p.severity == Severity::Error)
    }
}

impl fmt::Display for Severity {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Error => "error",
            Self::Warning => "warning",
        })
    }
}

impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let sizes: Vec<_> = self.sizes.iter().map(|[w, h]| format!("{w}×{h}")).collect();
        let [near, far] = self.distance;
        let [narrow, wide] = self.fov_degrees;
        writeln!(f, "{} ({})", self.name, self.format)?;
        writeln!(
            f,
            "  views     {} inputs, {} held out; {}",
            self.inputs,
            self.targets,
            sizes.join(", ")
        )?;
        writeln!(
            f,
            "  cameras   {} of {} sound; field of view {narrow:.1}–{wide:.1}°",
            self.sound_cameras,
            self.views.len()
        )?;
        writeln!(
            f,
            "  poses     {near:.2}–{far:.2} radii from the centre, axes within {:.1}° of it; inputs span {:.0}°",
            self.look_at_degrees, self.spread_degrees
        )?;
        let [x, y, z] = self.ball_centre;
        writeln!(
            f,
            "  ball      centre ({x:.3}, {y:.3}, {z:.3}), radius {:.3}",
            self.ball_radius
        )?;
        write!(f, "  masks     {} of {}", self.masks, self.views.len())?;
        if let Some([low, median, high]) = self.coverage {
            write!(
                f,
                "; object covers {:.1}–{:.1} % (median {:.1} %)",
                100.0 * low,
                100.0 * high,
                100.0 * median
            )?;
        }
        if let Some(iou) = self.hull_median {
            write!(f, "; visual hull agrees at median IoU {iou:.3}")?;
        }
        writeln!(f)?;
        if let Some(e) = &self.exposure {
            writeln!(
                f,
                "  exposure  mean {:.2} (± {:.2} between views), {:.1} % clipped, {:.1} % black",
                e.mean,
                e.spread,
                100.0 * e.clipped,
                100.0 * e.black
            )?;
        }
        if let Some(b) = &self.background {
            writeln!(
                f,
                "  ground    contrast {:.2}, {:.2} from white, where there is no mask",
                b.clutter, b.from_white
            )?;
        }
        if self.photographs_lit > 0 {
            writeln!(
                f,
                "  light     known of {} photographs of {}: {} different",
                self.photographs_lit,
                self.views.len(),
                self.photograph_lights
            )?;
        } else if self.lights.is_empty() {
            writeln!(f, "  light     unknown")?;
        }
        for light in &self.lights {
            writeln!(f, "  light     {light}")?;
        }
        if self.problems.is_empty() {
            writeln!(f, "  no problems")?;
        }
        for problem in &self.problems {
            writeln!(
                f,
                "  {}: {}: {}",
                problem.severity, problem.field, problem.text
            )?;
        }
        Ok(())
    }
}

impl fmt::Display for LightReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} ({})", self.name, self.kind)?;
        if let Some(power) = self.power {
            write!(f, " {power:.0} W")?;
        }
        if let Some(distance) = self.distance {
            write!(f, " at {distance:.2} radii")?;
        }
        if let Some(energy) = self.energy {
            write!(f, " energy {energy:.2}")?;
        }
        write!(f, ", mean radiance {:.3}", self.mean_radiance)
    }
}
