//! Lens distortion, removed by resampling.

use glam::DVec2;
use lumi_core::{Camera, DisplayImage, Error, Result};

/// How a lens departs from a pinhole, in the terms of OpenCV and COLMAP. A point at (x, y) of the plane
/// z = 1 before the camera, r² = x² + y², appears at
///
/// * x·d + 2 p₁ x y + p₂ (r² + 2 x²)
/// * y·d + p₁ (r² + 2 y²) + 2 p₂ x y, with d = 1 + k₁ r² + k₂ r⁴ + k₃ r⁶ + k₄ r⁸.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Distortion {
    /// k₁ to k₄.
    pub radial: [f64; 4],
    /// p₁ and p₂.
    pub tangential: [f64; 2],
}

impl Distortion {
    /// Whether the lens is a pinhole.
    #[must_use]
    pub fn is_none(&self) -> bool {
        *self == Self::default()
    }

    /// Where the ray through `p` of the plane z = 1 meets that plane after the lens.
    #[must_use]
    pub fn distort(&self, p: DVec2) -> DVec2 {
        let (r2, [p1, p2]) = (p.length_squared(), self.tangential);
        let d = 1.0 + self.radial.iter().rev().fold(0.0, |sum, k| r2 * (k + sum));
        let xy = p.x * p.y;
        DVec2::new(
            p.x * d + 2.0 * p1 * xy + p2 * (r2 + 2.0 * p.x * p.x),
            p.y * d + p1 * (r2 + 2.0 * p.y * p.y) + 2.0 * p2 * xy,
        )
    }

    /// The picture that a pinhole with the same intrinsics takes, by bilinear resampling of `image`. A
    /// pixel that the lens did not see is white, and transparent where the picture has alpha.
    ///
    /// # Errors
    /// If a coefficient is not finite, or the formula folds the image over itself, which no lens does.
    pub fn undistort(&self, camera: &Camera, image: &DisplayImage) -> Result<DisplayImage> {
        self.check(camera)?;
        let (width, height) = (image.width, image.height);
        let mut out = DisplayImage::filled(width, height, [1.0; 3]);
        let mut alpha = image.alpha.as_ref().map(|a| vec![0.0; a.len()]);
        for i in 0..width * height {
            let at = self.source(camera, (i % width) as f64 + 0.5, (i / width) as f64 + 0.5);
            // A pixel reaches half a pixel beyond its centre, and so does the picture.
            let (x, y) = (at.x - 0.5, at.y - 0.5);
            let beyond = |v: f64, side: usize| !(-0.5..=side as f64 - 0.5).contains(&v);
            if beyond(x, width) || beyond(y, height) {
                continue;
            }
            let (x, y) = (
                x.clamp(0.0, width as f64 - 1.0),
                y.clamp(0.0, height as f64 - 1.0),
            );
            let (x0, y0) = (x as usize, y as usize);
            let (x1, y1) = ((x0 + 1).min(width - 1), (y0 + 1).min(height - 1));
            let (tx, ty) = ((x - x0 as f64) as f32, (y - y0 as f64) as f32);
            let weights = [
                (y0 * width + x0, (1.0 - tx) * (1.0 - ty)),
                (y0 * width + x1, tx * (1.0 - ty)),
                (y1 * width + x0, (1.0 - tx) * ty),
                (y1 * width + x1, tx * ty),
            ];
            for c in 0..3 {
                let sum: f32 = weights.iter().map(|(k, w)| w * image.pixels[*k][c]).sum();
                out.pixels[i][c] = sum.min(1.0);
            }
            if let (Some(alpha), Some(source)) = (&mut alpha, &image.alpha) {
                let sum: f32 = weights.iter().map(|(k, w)| w * source[*k]).sum();
                alpha[i] = sum.min(1.0);
            }
        }
        out.alpha = alpha;
        Ok(out)
    }

    /// Where the pinhole's image point (x, y) lies in the distorted image, in pixels.
    fn source(&self, camera: &Camera, x: f64, y: f64) -> DVec2 {
        let focal = DVec2::new(camera.fx.into(), camera.fy.into());
        let centre = DVec2::new(camera.cx.into(), camera.cy.into());
        focal * self.distort((DVec2::new(x, y) - centre) / focal) + centre
    }

    /// The formula must keep its orientation over the whole image.
    fn check(&self, camera: &Camera) -> Result<()> {
        const GRID: usize = 24;
        for i in 0..=GRID {
            for j in 0..=GRID {
                let at = |dx: f64, dy: f64| {
                    let x = camera.width as f64 * i as f64 / GRID as f64 + dx;
                    let y = camera.height as f64 * j as f64 / GRID as f64 + dy;
                    self.source(camera, x, y)
                };
                let (right, down) = (at(0.5, 0.0) - at(-0.5, 0.0), at(0.0, 0.5) - at(0.0, -0.5));
                let grows = right.perp_dot(down);
                if !(grows.is_finite() && grows > 0.0) {
                    let expected = format!(
                        "expected lens coefficients that fit the image; k {:?} and p {:?} fold it over itself",
                        self.radial, self.tangential
                    );
                    return Err(Error::value("distortion", expected));
                }
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LENS: Distortion = Distortion {
        radial: [-0.18, 0.05, 0.01, 0.0],
        tangential: [0.004, -0.003],
    };

    /// A smooth picture as a function of the plane z = 1.
    fn scene(p: DVec2) -> [f32; 3] {
        let wave = |a: f64, b: f64| (0.5 + 0.4 * (a * p.x + b * p.y).sin()) as f32;
        [wave(3.0, 1.0), wave(-1.0, 4.0), wave(2.0, -2.0)]
    }

    #[test]
    fn an_undistorted_picture_is_the_pinholes() {
        let camera = Camera::orbit(0.0, 0.3, 3.0, 1.0, 96);
        let focal = f64::from(camera.fx);
        let plane = |i: usize| (DVec2::new((i % 96) as f64, (i / 96) as f64) - 47.5) / focal;
        // What the lens sees at p is the scene where p comes from: invert by fixed-point iteration.
        let seen = |p: DVec2| {
            let mut from = p;
            for _ in 0..60 {
                from += p - LENS.distort(from);
            }
            scene(from)
        };
        let photograph = DisplayImage {
            width: 96,
            height: 96,
            pixels: (0..96 * 96).map(|i| seen(plane(i))).collect(),
            alpha: None,
        };
        let image = LENS.undistort(&camera, &photograph).expect("a lens");
        let (mut worst, mut before) = (0.0_f32, 0.0_f32);
        for i in 0..96 * 96 {
            let truth = scene(plane(i));
            let off = |image: &DisplayImage| {
                let pairs = image.pixels[i].iter().zip(truth);
                pairs.map(|(v, t)| (v - t).abs()).fold(0.0, f32::max)
            };
            worst = worst.max(off(&image));
            before = before.max(off(&photograph));
        }
        assert!(worst < 2e-3, "{worst}");
        assert!(before > 0.05, "the lens does something: {before}");
    }

    #[test]
    fn unseen_pixels_are_empty_and_folds_are_errors() {
        let camera = Camera::orbit(0.0, 0.3, 3.0, 1.2, 32);
        let mut photograph = DisplayImage::filled(32, 32, [0.2; 3]);
        photograph.alpha = Some(vec![1.0; 32 * 32]);
        // A cushion: the pinhole's corners come from beyond the picture.
        let lens = Distortion {
            radial: [0.3, 0.0, 0.0, 0.0],
            ..Distortion::default()
        };
        let image = lens.undistort(&camera, &photograph).expect("a lens");
        let alpha = image.alpha.as_ref().expect("alpha");
        assert_eq!((image.pixels[0], alpha[0]), ([1.0; 3], 0.0));
        assert!((alpha[16 * 32 + 16] - 1.0).abs() < 1e-6);
        for k1 in [-3.0, f64::NAN, 1e300] {
            let lens = Distortion {
                radial: [k1, 0.0, 0.0, 0.0],
                ..Distortion::default()
            };
            let message = lens
                .undistort(&camera, &photograph)
                .expect_err("folds")
                .to_string();
            assert!(message.contains("distortion"), "{message}");
        }
    }
}
