//! Pictures of networks with `output = "radiance"`: colour and alpha of each pixel, over no background.
//!
//! The first three channels are colour c ≥ 0 on a curve that is nearly the display's, the fourth is alpha in (0, 1). With
//! the scene's illumination scale g, the radiance is g·c^2.2, of the object alone: it is not premultiplied by alpha.

use crate::config::Output;
use crate::illumination::Illumination;
use burn::tensor::Tensor;
use burn::tensor::activation::sigmoid;
use lumi_core::LinearImage;
/// Exponent of the curve on which the network makes colours. A squared error there is nearly one of displayed pictures.
pub use lumi_core::color::CURVE;

/// Where colours begin, since no head has biases: a middling grey.
const GREY: f64 = 0.4;
/// Logit of alpha where the photographs' coverage is whole, and of its opposite where it is nothing.
const SURE: f64 = 3.0;
/// Colours come from any real number by (x + √(x² + s²)) / 2 with this s: straight but near black.
const SOFT: f64 = 0.1;

impl Output {
    /// Pictures from a head's logits. Radiance may also be made with what is `carried` from the photographs, colour times coverage
    /// (display-encoded, which is nearly our curve) and coverage: then logits of zero mean just that, and four more say by how
    /// much to multiply it.
    ///
    /// # Shapes
    /// logits `[m, channels, h, w]`, or `[m, 8, h, w]` and carried `[m, 4, h, w]` → `[m, channels, h, w]`
    #[must_use]
    pub fn squash(self, logits: Tensor<4>, carried: Option<Tensor<4>>) -> Tensor<4> {
        match self {
            Self::Display => sigmoid(logits),
            Self::Radiance => {
                let mut colour = logits.clone().narrow(1, 0, 3);
                let mut alpha = logits.clone().narrow(1, 3, 1);
                if let Some(carried) = carried {
                    let factor =
                        |first: usize, count: usize| logits.clone().narrow(1, first, count) + 1.0;
                    let coverage = carried.clone().narrow(1, 3, 1);
                    let empty = coverage.clone().neg() + 1.0;
                    colour = colour + factor(4, 3) * carried.narrow(1, 0, 3) + empty * GREY;
                    alpha = alpha + factor(7, 1) * (coverage * 2.0 - 1.0) * SURE;
                } else {
                    colour = colour + GREY;
                }
                let root = (colour.clone().square() + SOFT * SOFT).sqrt();
                let alpha = sigmoid(alpha);
                Tensor::cat(vec![(colour + root) * 0.5, alpha], 1)
            }
        }
    }
}

/// Pictures of a `[1, v, 4, h, w]` render under an illumination.
#[must_use]
pub fn to_linear(render: Tensor<5>, illumination: Illumination) -> Vec<LinearImage> {
    let [_, v, _, height, width] = render.dims();
    let values = crate::params::to_vec(render);
    let n = height * width;
    let gain = illumination.0.map(|g| g as f32);
    let pixel = |i: usize, p: usize| {
        let at = |c: usize| values[(i * 4 + c) * n + p];
        let alpha = at(3).clamp(0.0, 1.0);
        let colour = |c: usize| alpha * gain[c] * at(c).max(0.0).powf(CURVE);
        [colour(0), colour(1), colour(2), alpha]
    };
    (0..v)
        .map(|i| LinearImage {
            width,
            height,
            pixels: (0..n).map(|p| pixel(i, p)).collect(),
        })
        .collect()
}

/// Nearly display-encoded pictures over white of a render under the light of its capture, with gradients: `[b, v, 4, h, w]` →
/// `[b, v, 3, h, w]`.
#[must_use]
pub(crate) fn over_white(render: Tensor<5>) -> Tensor<5> {
    let alpha = render.clone().narrow(2, 3, 1);
    render.narrow(2, 0, 3).clamp_max(1.0) * alpha.clone() + (alpha.neg() + 1.0)
}
