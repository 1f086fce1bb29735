//! How a benchmark prepares and compares images: a new benchmark is a row of [`RULES`].

use crate::metrics::{Net, Window};
use crate::picture::Picture;
use lumi_core::DisplayImage;
use lumi_core::color::{srgb_decode, srgb_encode};
use serde::Serialize;

/// The rules of a benchmark.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Rules {
    /// Name on the command line and in reports.
    pub name: &'static str,
    /// What they are, in words.
    pub about: &'static str,
    /// Whether everything but the object is made black in both images (else the background stays as it is).
    pub black_background: bool,
    /// The object's mask shrinks by this many pixels (coverage above a half, square neighbourhood).
    pub erode: usize,
    /// The window of SSIM.
    pub window: Window,
    /// The network of LPIPS.
    pub net: Net,
    /// Whether LPIPS is averaged over the pixels that count, from maps at full resolution.
    pub spatial_lpips: bool,
    /// What LPIPS is shown.
    pub lpips_input: LpipsInput,
    /// Whether images are aligned before they are clipped, and PSNR-H is measured where the truth has linear values.
    pub high_range: bool,
    /// Whether the PSNR of whole images is never below that of an object of uniform grey, 0.5.
    pub grey_floor: bool,
    /// Whether the exposure of linear predictions is searched for ([`crate::exposure`]); images are then compared as
    /// linear^(1/γ), with this γ.
    pub exposure_search: Option<f32>,
    /// The figures that the benchmark itself publishes, as keys of a report.
    pub headline: &'static str,
}

/// What LPIPS is shown.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub enum LpipsInput {
    /// The images as they are compared.
    AsCompared,
    /// Display-encoded once more, as Stanford-ORB's script does.
    EncodedTwice,
    /// With the background 0.5, the middle of LPIPS' range, as in Objects with Lighting's script.
    GreyBackground,
}

/// The paper's rules, used where nothing else is asked for.
pub const PAPER: Rules = Rules {
    name: "paper",
    about: "display-encoded images on the scene's background; one least-squares scale per channel in linear \
            colour over the object's pixels, per image (ilr) or per scene (slr)",
    black_background: false,
    erode: 0,
    window: Window::GAUSSIAN,
    net: Net::Alex,
    spatial_lpips: false,
    lpips_input: LpipsInput::AsCompared,
    high_range: false,
    grey_floor: false,
    exposure_search: None,
    headline: "slr",
};

/// Every set of rules.
pub const RULES: &[Rules] = &[
    PAPER,
    Rules {
        name: "stanford-orb",
        about: "object on black, its mask eroded by a 5×5 square; one least-squares scale per image and channel \
                in linear colour before clipping; PSNR-L of display values and PSNR-H of linear values up to 4 over \
                the whole masked image, SSIM with a 3×3 Gaussian window, LPIPS over VGG16",
        black_background: true,
        erode: 2,
        window: Window::Gaussian {
            sigma: 1.5,
            radius: 1,
        },
        net: Net::Vgg,
        spatial_lpips: false,
        lpips_input: LpipsInput::EncodedTwice,
        high_range: true,
        grey_floor: true,
        exposure_search: None,
        headline: "ilr",
    },
    Rules {
        name: "objects-with-lighting",
        about: "object on black, compared as linear^(1/2.2); tone-mapped predictions are taken as they are, the \
                exposure and colour balance of linear ones are fitted per image; PSNR over the mask, SSIM with a \
                7×7 uniform window and LPIPS over AlexNet as means of their maps over the mask",
        black_background: true,
        erode: 0,
        window: Window::Uniform { radius: 3 },
        net: Net::Alex,
        spatial_lpips: true,
        lpips_input: LpipsInput::GreyBackground,
        high_range: false,
        grey_floor: false,
        exposure_search: Some(2.2),
        headline: "object_only.raw",
    },
];

impl Rules {
    /// The rules of that name.
    #[must_use]
    pub fn find(name: &str) -> Option<Self> {
        RULES.iter().find(|r| r.name == name).copied()
    }

    /// Prediction and truth as the benchmark aligns them: linear values are kept where it uses them, and the truth's
    /// alpha becomes its mask.
    #[must_use]
    pub fn prepare(&self, prediction: &Picture, truth: &Picture) -> (Picture, Picture) {
        let (mut prediction, mut truth) = (prediction.clone(), truth.clone());
        if self.high_range {
            // Scaled up, even a clipped prediction goes beyond white.
            let pixels = 0..prediction.shown.pixels.len();
            prediction.linear = Some(pixels.map(|i| prediction.linear_at(i)).collect());
        } else {
            truth.linear = None;
            prediction.linear = prediction.linear.filter(|_| self.exposure_search.is_some());
        }
        if let (true, Some(alpha)) = (self.black_background, &truth.shown.alpha) {
            let size = (truth.shown.width, truth.shown.height);
            let mask = eroded(alpha, size, self.erode);
            for picture in [&mut prediction, &mut truth] {
                blacken(&mut picture.shown.pixels, &mask);
                if let Some(linear) = &mut picture.linear {
                    blacken(linear, &mask);
                }
            }
            truth.shown.alpha = Some(mask);
        }
        if self.high_range {
            // What is shown follows from the linear values: photographs were reduced as both, apart.
            for picture in [&mut prediction, &mut truth] {
                let linear = picture.linear.iter().flatten();
                for (pixel, linear) in picture.shown.pixels.iter_mut().zip(linear) {
                    *pixel = linear.map(srgb_encode);
                }
            }
        }
        (prediction, truth)
    }

    /// An aligned picture in the encoding in which the benchmark compares.
    #[must_use]
    pub fn encoded(&self, picture: &Picture) -> Picture {
        let mut picture = picture.clone();
        if let Some(gamma) = self.exposure_search {
            let encode = |v: f32| srgb_decode(v).powf(1.0 / gamma);
            let pixels = picture.shown.pixels.iter_mut();
            pixels.for_each(|p| *p = p.map(encode));
        }
        picture
    }

    /// What LPIPS is shown of a compared image, whose object is where `truth` says.
    #[must_use]
    pub fn for_lpips(&self, mut image: DisplayImage, truth: &DisplayImage) -> DisplayImage {
        match (self.lpips_input, &truth.alpha) {
            (LpipsInput::EncodedTwice, _) => {
                let pixels = image.pixels.iter_mut();
                pixels.for_each(|p| *p = p.map(srgb_encode));
            }
            (LpipsInput::GreyBackground, Some(mask)) => {
                for (pixel, inside) in image.pixels.iter_mut().zip(mask) {
                    if *inside == 0.0 {
                        *pixel = [0.5; 3];
                    }
                }
            }
            _ => {}
        }
        image
    }
}

fn blacken(pixels: &mut [[f32; 3]], mask: &[f32]) {
    for (pixel, inside) in pixels.iter_mut().zip(mask) {
        if *inside == 0.0 {
            *pixel = [0.0; 3];
        }
    }
}

/// One where every pixel within `radius` (as a square, cut off at the borders) is covered by more than a half.
fn eroded(alpha: &[f32], (width, height): (usize, usize), radius: usize) -> Vec<f32> {
    let inside = |x: usize, y: usize| {
        let (xs, ys) = (
            x.saturating_sub(radius)..(x + radius + 1).min(width),
            y.saturating_sub(radius)..(y + radius + 1).min(height),
        );
        ys.into_iter()
            .all(|y| alpha[y * width..][xs.clone()].iter().all(|a| *a > 0.5))
    };
    (0..width * height)
        .map(|i| f32::from(u8::from(inside(i % width, i / width))))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn erosion_takes_the_rim() {
        let (w, h) = (7, 6);
        let alpha: Vec<f32> = (0..w * h)
            .map(|i| f32::from(u8::from(i % w > 0 && i / w > 0)))
            .collect();
        let mask = eroded(&alpha, (w, h), 2);
        // Borders of the image do not erode, the first row and column do.
        let expected = |x: usize, y: usize| x > 2 && y > 2;
        for (i, m) in mask.iter().enumerate() {
            assert_eq!(*m == 1.0, expected(i % w, i / w), "{i}");
        }
    }

    #[test]
    fn black_rules_hide_the_background() {
        let mut truth: Picture = DisplayImage::filled(2, 1, [0.8; 3]).into();
        truth.shown.alpha = Some(vec![1.0, 0.2]);
        let prediction: Picture = DisplayImage::filled(2, 1, [0.4; 3]).into();
        let rules = Rules::find("objects-with-lighting").expect("a row");
        let (p, t) = rules.prepare(&prediction, &truth);
        assert_eq!((p.shown.pixels[1], t.shown.pixels[1]), ([0.0; 3], [0.0; 3]));
        assert_eq!(p.shown.pixels[0], [0.4; 3]);
        assert_eq!(t.shown.alpha, Some(vec![1.0, 0.0]));
        let seen = rules.for_lpips(p.shown, &t.shown);
        assert_eq!(seen.pixels, [[0.4; 3], [0.5; 3]]);
        let (p, t) = PAPER.prepare(&prediction, &truth);
        assert_eq!((p, t), (prediction, truth));
    }

    #[test]
    fn only_some_rules_look_beyond_white() {
        let bright = Picture {
            linear: Some(vec![[3.0; 3]]),
            ..DisplayImage::filled(1, 1, [1.0; 3]).into()
        };
        let kept = |name: &str| {
            let rules = Rules::find(name).expect("a row");
            let (p, t) = rules.prepare(&bright, &bright);
            (p.linear.is_some(), t.linear.is_some())
        };
        assert_eq!(kept("paper"), (false, false));
        assert_eq!(kept("stanford-orb"), (true, true));
        assert_eq!(kept("objects-with-lighting"), (true, false));
        // 8-bit values of the benchmark come back as they were.
        let rules = Rules::find("objects-with-lighting").expect("a row");
        let byte = 100.0 / 255.0_f32;
        let shown = DisplayImage::filled(1, 1, [srgb_encode(byte.powf(2.2)); 3]);
        let encoded = rules.encoded(&shown.into()).shown.pixels[0][0];
        assert!((encoded - byte).abs() < 1e-5, "{encoded}");
    }
}
