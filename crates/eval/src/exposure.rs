//! The alignment of Objects with Lighting for linear predictions: the exposure, then the balance of the colours,
//! that bring a prediction closest to its photograph. The objective is the benchmark's, the mean absolute difference
//! of tone-mapped values over the mask without overexposed pixels; the minimum is found by a grid and golden sections.

use crate::align::Scale;
use crate::picture::Picture;
use lumi_core::color::srgb_decode;

/// Exposures that are tried, in powers of two; the upper end also depends on the prediction.
const EXPOSURES: (f64, f64) = (-10.0, 20.0);
/// Balances that are tried, in powers of two: factors between a half and two.
const BALANCES: (f64, f64) = (-1.0, 1.0);
/// The benchmark's tone curve brings the darkest pixel to no more than this.
const BRIGHTEST: f64 = 0.95;
/// Above this a photograph's pixel (8 bits) is overexposed.
const WHITE: f32 = 254.5 / 255.0;

/// Factors on the prediction's linear colour. One where nothing can be compared.
#[must_use]
pub fn search(prediction: &Picture, truth: &Picture, gamma: f32) -> Scale {
    let tone = |v: f64| v.clamp(0.0, 1.0).powf(1.0 / f64::from(gamma));
    let inside = |i: &usize| {
        let covered = truth.shown.alpha.as_ref().is_none_or(|a| a[*i] > 0.9);
        covered && truth.shown.pixels[*i].iter().all(|v| *v < WHITE)
    };
    let pixels: Vec<([f64; 3], [f64; 3])> = (0..truth.shown.pixels.len())
        .filter(inside)
        .map(|i| {
            let seen = truth.shown.pixels[i].map(|v| tone(f64::from(srgb_decode(v))));
            (prediction.linear_at(i).map(f64::from), seen)
        })
        .collect();
    let darkest = pixels
        .iter()
        .map(|(p, _)| p.iter().copied().fold(f64::INFINITY, f64::min))
        .filter(|v| *v > 0.0)
        .fold(f64::INFINITY, f64::min);
    if !darkest.is_finite() {
        return [1.0; 3];
    }
    let error = |c: usize, factor: f64| -> f64 {
        let one = |(p, t): &([f64; 3], [f64; 3])| (tone(factor * p[c]) - t[c]).abs();
        pixels.iter().map(one).sum()
    };
    let high = (BRIGHTEST.powf(f64::from(gamma)) / darkest).log2();
    let range = (EXPOSURES.0, high.clamp(EXPOSURES.0 + 1.0, EXPOSURES.1));
    let exposure = minimum(range, |x| (0..3).map(|c| error(c, x.exp2())).sum());
    std::array::from_fn(|c| {
        let balance = minimum(BALANCES, |b| error(c, (exposure + b).exp2()));
        (exposure + balance).exp2() as f32
    })
}

/// Steps of the grid.
const GRID: u32 = 64;
/// Sections after which the interval is some millionth of a step.
const SECTIONS: u32 = 30;

/// Where `f` is smallest in a range: the best point of a grid, refined between its neighbours.
fn minimum((low, high): (f64, f64), f: impl Fn(f64) -> f64) -> f64 {
    let step = (high - low) / f64::from(GRID);
    let points = (0..=GRID).map(|i| low + step * f64::from(i));
    let best = points.map(|x| (x, f(x))).min_by(|a, b| a.1.total_cmp(&b.1));
    let (x, least) = best.unwrap_or((low, f64::INFINITY));
    let (mut a, mut b) = ((x - step).max(low), (x + step).min(high));
    let shrink = 0.5 * (5.0_f64.sqrt() - 1.0);
    for _ in 0..SECTIONS {
        let (c, d) = (b - shrink * (b - a), a + shrink * (b - a));
        if f(c) < f(d) { b = d } else { a = c }
    }
    let refined = 0.5 * (a + b);
    if f(refined) <= least { refined } else { x }
}

#[cfg(test)]
mod tests {
    use super::*;
    use lumi_core::DisplayImage;
    use lumi_core::color::srgb_encode;

    #[test]
    fn exposure_and_balance_are_found() {
        let value = |i: usize| 0.02 + 0.8 * (i as f32 / 50.0);
        let mut truth: Picture = DisplayImage::filled(50, 1, [0.0; 3]).into();
        for (i, p) in truth.shown.pixels.iter_mut().enumerate() {
            *p = [value(i), 0.5 * value(i), 0.9 * value(i)].map(srgb_encode);
        }
        // An overexposed pixel says nothing.
        truth.shown.pixels[7] = [1.0; 3];
        let mut linear = vec![[0.0; 3]; 50];
        for (i, p) in linear.iter_mut().enumerate() {
            *p = [
                5.0 * value(i),
                5.0 * 0.5 * value(i) * 0.8,
                5.0 * 0.9 * value(i) * 1.25,
            ];
        }
        let prediction = Picture {
            linear: Some(linear),
            ..truth.clone()
        };
        let found = search(&prediction, &truth, 2.2);
        for (found, expected) in found.into_iter().zip([0.2, 0.25, 0.16]) {
            assert!(
                (found / expected - 1.0).abs() < 1e-3,
                "{found}, expected {expected}"
            );
        }
        let dark: Picture = DisplayImage::filled(50, 1, [0.0; 3]).into();
        assert_eq!(search(&dark, &truth, 2.2), [1.0; 3]);
    }
}
