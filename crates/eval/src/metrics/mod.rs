//! Image metrics between display-encoded images of one size: one file each, and one row of [`METRICS`].

pub mod lpips;
mod psnr;
mod ssim;

pub use lpips::{Lpips, Net};
pub use psnr::{psnr, psnr_high_range, psnr_linear_where, psnr_where};
pub use ssim::{Window, ssim, ssim_map};

use crate::Result;
use crate::picture::Picture;
use crate::rules::Rules;
use burn::tensor::{Device, Tensor, TensorData};
use lumi_core::DisplayImage;
use lumi_model::params::to_vec;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// A row of [`METRICS`].
pub struct Metric {
    /// Key in reports.
    pub name: &'static str,
    /// Head of a table's column.
    pub label: &'static str,
    /// Unit, empty if it has none.
    pub unit: &'static str,
    /// Whether more is better.
    pub higher_is_better: bool,
    /// Decimals that tables show.
    pub decimals: usize,
    /// One value per pair; `None` where images are too small for it, or show no object.
    measure: Measure,
    /// Whether rules ask for it.
    wanted: fn(&Rules) -> bool,
}

/// One value per pair; `None` where there is none.
type Measure = fn(&Judge, &[Pair]) -> Result<Vec<Option<f64>>>;

/// Every metric; tables, plots and reports read this.
pub const METRICS: &[Metric] = &[
    Metric {
        name: "psnr",
        label: "PSNR",
        unit: "dB",
        higher_is_better: true,
        decimals: 2,
        measure: |judge, pairs| each(pairs, |p| display_psnr(judge, p)),
        wanted: |_| true,
    },
    Metric {
        name: "ssim",
        label: "SSIM",
        unit: "",
        higher_is_better: true,
        decimals: 3,
        measure: |judge, pairs| each(pairs, |p| structural(judge, p)),
        wanted: |_| true,
    },
    Metric {
        name: "lpips",
        label: "LPIPS",
        unit: "",
        higher_is_better: false,
        decimals: 3,
        measure: perceptual,
        wanted: |_| true,
    },
    Metric {
        name: "psnr_linear",
        label: "PSNR (linear)",
        unit: "dB",
        higher_is_better: true,
        decimals: 2,
        measure: |_, pairs| each(pairs, |p| psnr_of(p, psnr_linear_where)),
        wanted: |_| true,
    },
    Metric {
        name: "psnr_hdr",
        label: "PSNR-H",
        unit: "dB",
        higher_is_better: true,
        decimals: 2,
        measure: |judge, pairs| each(pairs, |p| high_range(judge, p)),
        wanted: |rules| rules.high_range,
    },
];

/// A metric by name.
#[must_use]
pub fn metric(name: &str) -> Option<&'static Metric> {
    METRICS.iter().find(|m| m.name == name)
}

/// Values by the names of [`METRICS`]; a value that could not be measured is `None`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Scores(pub BTreeMap<String, Option<f64>>);

impl Scores {
    /// The value of a metric.
    #[must_use]
    pub fn get(&self, metric: &str) -> Option<f64> {
        self.0.get(metric).copied().flatten()
    }

    /// Mean of each metric over those that have it.
    #[must_use]
    pub fn mean<'a>(all: impl IntoIterator<Item = &'a Self>) -> Self {
        let mut sums: BTreeMap<String, (f64, u32)> = BTreeMap::new();
        for scores in all {
            for (name, value) in &scores.0 {
                let (sum, count) = sums.entry(name.clone()).or_default();
                if let Some(value) = value {
                    *sum += value;
                    *count += 1;
                }
            }
        }
        let mean = |(sum, count)| (count > 0).then(|| rounded(sum / f64::from(count)));
        Self(sums.into_iter().map(|(n, s)| (n, mean(s))).collect())
    }
}

/// Nine decimals: far below what any metric means, and short enough that JSON gives back the very same number,
/// so that an interrupted evaluation ends with the figures of an uninterrupted one.
pub(crate) fn rounded(value: f64) -> f64 {
    (value * 1e9).round() / 1e9
}

/// A prediction and what it should be.
#[derive(Clone, Copy)]
pub struct Pair<'a> {
    /// The prediction.
    pub prediction: &'a Picture,
    /// The truth, whose alpha says where the object is.
    pub truth: &'a Picture,
    /// Whether only the object's pixels (coverage above a half) count.
    pub object_only: bool,
}

impl Pair<'_> {
    fn counts(&self, i: usize) -> bool {
        !self.object_only || self.truth.shown.alpha.as_ref().is_none_or(|a| a[i] > 0.5)
    }

    fn counts_at_all(&self) -> bool {
        (0..self.truth.shown.pixels.len()).any(|i| self.counts(i))
    }

    /// The prediction with what does not count taken from the truth.
    fn masked(&self) -> DisplayImage {
        let mut image = self.prediction.shown.clone();
        for (i, pixel) in image.pixels.iter_mut().enumerate() {
            if !self.counts(i) {
                *pixel = self.truth.shown.pixels[i];
            }
        }
        image
    }
}

/// What measures: the rules of a benchmark, and LPIPS with its weights.
pub struct Judge {
    /// How images are prepared, aligned and compared.
    pub rules: Rules,
    lpips: Lpips,
    device: Device,
}

impl Judge {
    /// A judge by `rules`; `lpips` may be over another network than the rules name.
    #[must_use]
    pub fn new(rules: Rules, lpips: Lpips, device: &Device) -> Self {
        Self {
            rules,
            lpips,
            device: device.clone(),
        }
    }

    /// The network behind LPIPS.
    #[must_use]
    pub fn net(&self) -> Net {
        self.lpips.net
    }

    /// Fingerprint of LPIPS' weights.
    #[must_use]
    pub fn lpips(&self) -> &str {
        &self.lpips.fingerprint
    }

    /// What cannot be measured on images whose shorter side has `side` pixels, in words.
    #[must_use]
    pub fn limits(&self, side: usize) -> Vec<String> {
        let least = [
            ("SSIM", self.rules.window.least_side()),
            ("LPIPS", self.lpips.net.least_side()),
        ];
        let short = least.into_iter().filter(|(_, least)| side < *least);
        let say = |(name, least)| {
            format!(
                "{name} is not reported: it needs images of at least {least} px, these have {side}"
            )
        };
        short.map(say).collect()
    }

    /// Means of every metric over the pairs.
    ///
    /// # Errors
    /// If images of one call differ in size.
    pub fn measure(&self, pairs: &[Pair]) -> Result<Scores> {
        let mut scores = BTreeMap::new();
        for metric in METRICS.iter().filter(|m| (m.wanted)(&self.rules)) {
            let values = (metric.measure)(self, pairs)?;
            let known: Vec<f64> = values.into_iter().flatten().collect();
            let mean = known.iter().sum::<f64>() / known.len() as f64;
            scores.insert(
                metric.name.to_owned(),
                (!known.is_empty()).then(|| rounded(mean)),
            );
        }
        Ok(Scores(scores))
    }
}

fn each(pairs: &[Pair], value: impl Fn(&Pair) -> Option<f64>) -> Result<Vec<Option<f64>>> {
    Ok(pairs.iter().map(value).collect())
}

/// A PSNR over the pixels that count.
type PsnrWhere = fn(&DisplayImage, &DisplayImage, &dyn Fn(usize) -> bool) -> f64;

fn psnr_of(pair: &Pair, psnr: PsnrWhere) -> Option<f64> {
    let (prediction, truth) = (&pair.prediction.shown, &pair.truth.shown);
    let value = psnr(prediction, truth, &|i| pair.counts(i));
    value.is_finite().then_some(value)
}

/// An object of uniform grey, where `truth` has one, on black.
fn grey(truth: &DisplayImage) -> DisplayImage {
    let mut image = DisplayImage::filled(truth.width, truth.height, [0.5; 3]);
    for (pixel, inside) in image.pixels.iter_mut().zip(truth.alpha.iter().flatten()) {
        *pixel = pixel.map(|v| v * inside);
    }
    image
}

fn display_psnr(judge: &Judge, pair: &Pair) -> Option<f64> {
    let value = psnr_of(pair, psnr_where)?;
    if judge.rules.grey_floor && !pair.object_only {
        let truth = &pair.truth.shown;
        return Some(value.max(psnr(&grey(truth), truth)));
    }
    Some(value)
}

/// PSNR-H of whole images, the only ones for which it is defined.
fn high_range(judge: &Judge, pair: &Pair) -> Option<f64> {
    if pair.object_only {
        return None;
    }
    let (prediction, truth) = (
        pair.prediction.linear.as_ref()?,
        pair.truth.linear.as_ref()?,
    );
    let floor = judge.rules.grey_floor.then(|| grey(&pair.truth.shown));
    Some(psnr_high_range(
        prediction,
        truth,
        floor.as_ref().map(|f| f.pixels.as_slice()),
    ))
}

fn structural(judge: &Judge, pair: &Pair) -> Option<f64> {
    let window = judge.rules.window;
    if !pair.object_only {
        return ssim(&pair.prediction.shown, &pair.truth.shown, window);
    }
    let map = ssim_map(&pair.masked(), &pair.truth.shown, window)?;
    let kept: Vec<f64> = (0..map.len())
        .filter(|i| pair.counts(*i))
        .map(|i| map[i])
        .collect();
    (!kept.is_empty()).then(|| kept.iter().sum::<f64>() / kept.len() as f64)
}

/// Images that go through the network at a time.
const AT_ONCE: usize = 8;

fn perceptual(judge: &Judge, pairs: &[Pair]) -> Result<Vec<Option<f64>>> {
    let Some(first) = pairs.first() else {
        return Ok(Vec::new());
    };
    let (w, h) = (first.truth.shown.width, first.truth.shown.height);
    if w.min(h) < judge.lpips.net.least_side() {
        return Ok(vec![None; pairs.len()]);
    }
    let mut values = Vec::with_capacity(pairs.len());
    for chunk in pairs.chunks(AT_ONCE) {
        let stack = |image: &dyn Fn(&Pair) -> DisplayImage| {
            let shown = chunk.iter().map(|p| {
                let truth = &p.truth.shown;
                judge.rules.for_lpips(image(p), truth)
            });
            stacked(shown, (w, h), &judge.device)
        };
        let (a, b) = (stack(&|p| p.masked())?, stack(&|p| p.truth.shown.clone())?);
        if !judge.rules.spatial_lpips {
            // Where nothing counts, the prediction was masked to the truth itself: no distance was measured.
            let distances = to_vec(judge.lpips.distance(a, b)?);
            let measured = |(pair, v): (&Pair, f32)| pair.counts_at_all().then(|| f64::from(v));
            values.extend(chunk.iter().zip(distances).map(measured));
            continue;
        }
        let maps = to_vec(judge.lpips.spatial(a, b)?);
        for (pair, map) in chunk.iter().zip(maps.chunks_exact(w * h)) {
            let kept = map.iter().enumerate().filter(|(i, _)| pair.counts(*i));
            let (sum, count) = kept.fold((0.0, 0_u32), |(s, n), (_, v)| (s + f64::from(*v), n + 1));
            values.push((count > 0).then(|| sum / f64::from(count)));
        }
    }
    Ok(values)
}

/// Images as `[n, 3, h, w]`.
fn stacked(
    images: impl Iterator<Item = DisplayImage>,
    (width, height): (usize, usize),
    device: &Device,
) -> Result<Tensor<4>> {
    let (mut values, mut count) = (Vec::new(), 0);
    for image in images {
        if (image.width, image.height) != (width, height) {
            let expected = format!(
                "expected images of one size, found {width}×{height} and {}×{}",
                image.width, image.height
            );
            return Err(lumi_core::Error::value("images", expected).into());
        }
        for c in 0..3 {
            values.extend(image.pixels.iter().map(|p| p[c]));
        }
        count += 1;
    }
    Ok(Tensor::from_data(
        TensorData::new(values, [count, 3, height, width]),
        device,
    ))
}
