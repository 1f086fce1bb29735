//! How a benchmark prepares and compares images: a new benchmark is a row of [`RULES`].

use crate::metrics::{Net, Window};
use lumi_core::DisplayImage;
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
    /// The figures that the benchmark itself publishes, as keys of a report.
    pub headline: &'static str,
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
    headline: "slr",
};

/// Every set of rules.
pub const RULES: &[Rules] = &[
    PAPER,
    Rules {
        name: "stanford-orb",
        about: "object on black, its mask eroded by a 5×5 square; one least-squares scale per image and channel \
                in linear colour; PSNR-L over the whole masked image, SSIM with a 3×3 Gaussian window, LPIPS \
                over VGG16",
        black_background: true,
        erode: 2,
        window: Window::Gaussian {
            sigma: 1.5,
            radius: 1,
        },
        net: Net::Vgg,
        spatial_lpips: false,
        headline: "ilr",
    },
    Rules {
        name: "objects-with-lighting",
        about: "object on black; tone-mapped predictions are taken as they are; PSNR over the mask, SSIM with a \
                7×7 uniform window and LPIPS over AlexNet as means of their maps over the mask",
        black_background: true,
        erode: 0,
        window: Window::Uniform { radius: 3 },
        net: Net::Alex,
        spatial_lpips: true,
        headline: "object_only.raw",
    },
];

impl Rules {
    /// The rules of that name.
    #[must_use]
    pub fn find(name: &str) -> Option<Self> {
        RULES.iter().find(|r| r.name == name).copied()
    }

    /// Prediction and truth as the benchmark compares them. The truth's alpha becomes the benchmark's mask.
    #[must_use]
    pub fn prepare(
        &self,
        prediction: &DisplayImage,
        truth: &DisplayImage,
    ) -> (DisplayImage, DisplayImage) {
        let (mut prediction, mut truth) = (prediction.clone(), truth.clone());
        if let (true, Some(alpha)) = (self.black_background, &truth.alpha) {
            let mask = eroded(alpha, (truth.width, truth.height), self.erode);
            for image in [&mut prediction, &mut truth] {
                for (pixel, inside) in image.pixels.iter_mut().zip(&mask) {
                    if *inside == 0.0 {
                        *pixel = [0.0; 3];
                    }
                }
            }
            truth.alpha = Some(mask);
        }
        (prediction, truth)
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
        let mut truth = DisplayImage::filled(2, 1, [0.8; 3]);
        truth.alpha = Some(vec![1.0, 0.2]);
        let prediction = DisplayImage::filled(2, 1, [0.4; 3]);
        let rules = Rules::find("objects-with-lighting").expect("a row");
        let (p, t) = rules.prepare(&prediction, &truth);
        assert_eq!((p.pixels[1], t.pixels[1]), ([0.0; 3], [0.0; 3]));
        assert_eq!((p.pixels[0], t.alpha), ([0.4; 3], Some(vec![1.0, 0.0])));
        let (p, t) = PAPER.prepare(&prediction, &truth);
        assert_eq!((p, t), (prediction, truth));
    }
}
