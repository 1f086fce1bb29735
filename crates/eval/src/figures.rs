//! What one method scores: every alignment, on whole images and on the object alone, and its per-view scales.

use crate::Result;
use crate::align::{Scale, apply, fit, fit_scalar, spread};
use crate::exposure;
use crate::metrics::{Judge, Pair, Scores, rounded};
use crate::picture::Picture;
use lumi_core::DisplayImage;
use serde::{Deserialize, Serialize};

/// Scores after each alignment.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Aligned {
    /// As it is.
    pub raw: Scores,
    /// After one scale per image and channel.
    pub ilr: Scores,
    /// After one scale per scene (all views of a case) and channel.
    pub slr: Scores,
    /// After one scale per image for all channels.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub ilr_scalar: Option<Scores>,
    /// After one scale per scene for all channels.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub slr_scalar: Option<Scores>,
    /// After the exposure and colour balance of Objects with Lighting, per image; only by its rules.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub exposure: Option<Scores>,
}

/// Scores of one method on a case, an object or a set.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Figures {
    /// Whole images.
    #[serde(flatten)]
    pub whole: Aligned,
    /// The object's pixels alone (coverage above a half).
    pub object_only: Aligned,
    /// Least-squares scales of single views.
    pub tone: Tone,
}

/// The scales that single views want: equal ones for a method whose exposure is consistent across views.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Tone {
    /// Standard deviation of the natural logarithm of the scalar scales over the views, mean over cases.
    pub spread: Option<f64>,
    /// Scale of each view, all channels alike; only for single cases.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub per_view: Vec<f32>,
    /// Scale of each view and channel; only for single cases.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub per_view_channels: Vec<Scale>,
}

/// How much is measured.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Detail {
    /// Everything.
    Full,
    /// Without the scalar alignments.
    Brief,
}

impl Judge {
    /// Scores the views of one case.
    ///
    /// # Errors
    /// If a prediction and its truth differ in number or size.
    pub fn figures(
        &self,
        predictions: &[Picture],
        truth: &[Picture],
        detail: Detail,
    ) -> Result<Figures> {
        let prepared = self.prepared(predictions, truth)?;
        let pairs: Vec<(&Picture, &Picture)> = prepared.iter().map(|(p, t)| (p, t)).collect();
        let compared: Vec<Picture> = pairs.iter().map(|(_, t)| self.rules.encoded(t)).collect();
        let each = |fit: fn(&[(&Picture, &Picture)]) -> Scale| -> Vec<Scale> {
            pairs.iter().map(|pair| fit(&[*pair])).collect()
        };
        let (channels, scalars) = (each(fit), each(fit_scalar));
        let measured = |images: &[Picture]| -> Result<[Scores; 2]> {
            let of = |object_only| {
                let pairs = images.iter().zip(&compared);
                let pairs: Vec<Pair> = pairs
                    .map(|(prediction, truth)| Pair {
                        prediction,
                        truth,
                        object_only,
                    })
                    .collect();
                self.measure(&pairs)
            };
            Ok([of(false)?, of(true)?])
        };
        let scores = |scales: &[Scale]| -> Result<[Scores; 2]> {
            let scaled = pairs.iter().zip(scales.iter().cycle());
            let scaled: Vec<Picture> = scaled
                .map(|((p, t), scale)| self.rules.encoded(&apply(p, t, *scale)))
                .collect();
            measured(&scaled)
        };
        // A scale of exactly 1 would still pass through the display encoding and back.
        let raw: Vec<Picture> = pairs.iter().map(|(p, _)| self.rules.encoded(p)).collect();
        let [mut whole, mut object_only] = [Aligned::default(), Aligned::default()];
        [whole.raw, object_only.raw] = measured(&raw)?;
        [whole.ilr, object_only.ilr] = scores(&channels)?;
        [whole.slr, object_only.slr] = scores(&[fit(&pairs)])?;
        if detail == Detail::Full {
            [whole.ilr_scalar, object_only.ilr_scalar] = scores(&scalars)?.map(Some);
            [whole.slr_scalar, object_only.slr_scalar] = scores(&[fit_scalar(&pairs)])?.map(Some);
        }
        if let Some(gamma) = self.rules.exposure_search {
            let found = pairs.iter().map(|(p, t)| exposure::search(p, t, gamma));
            let found: Vec<Scale> = found.collect();
            [whole.exposure, object_only.exposure] = scores(&found)?.map(Some);
        }
        let per_view: Vec<f32> = scalars.iter().map(|s| s[0]).collect();
        Ok(Figures {
            whole,
            object_only,
            tone: Tone {
                spread: spread(&per_view).map(rounded),
                per_view,
                per_view_channels: channels,
            },
        })
    }
}

impl Judge {
    /// The pictures of one case as `slr` compares them: after one scale per channel for all of them.
    ///
    /// # Errors
    /// As [`Self::figures`].
    pub fn aligned(&self, predictions: &[Picture], truth: &[Picture]) -> Result<Vec<DisplayImage>> {
        let prepared = self.prepared(predictions, truth)?;
        let pairs: Vec<(&Picture, &Picture)> = prepared.iter().map(|(p, t)| (p, t)).collect();
        let scale = fit(&pairs);
        let shown = |(p, t): &(&Picture, &Picture)| self.rules.encoded(&apply(p, t, scale)).shown;
        Ok(pairs.iter().map(shown).collect())
    }

    /// Each prediction and its truth as the rules compare them.
    fn prepared(
        &self,
        predictions: &[Picture],
        truth: &[Picture],
    ) -> Result<Vec<(Picture, Picture)>> {
        check(predictions, truth)?;
        let both = predictions.iter().zip(truth);
        Ok(both.map(|(p, t)| self.rules.prepare(p, t)).collect())
    }
}

fn check(predictions: &[Picture], truth: &[Picture]) -> Result<()> {
    if predictions.len() != truth.len() {
        let expected = format!(
            "expected {} views, found {}",
            truth.len(),
            predictions.len()
        );
        return Err(lumi_core::Error::value("predictions", expected).into());
    }
    for (i, (p, t)) in predictions.iter().zip(truth).enumerate() {
        let (p, t) = (&p.shown, &t.shown);
        if (p.width, p.height) != (t.width, t.height) {
            let expected = format!(
                "expected {}×{} pixels as the truth has, found {}×{}",
                t.width, t.height, p.width, p.height
            );
            return Err(lumi_core::Error::value(format!("view {i}"), expected).into());
        }
    }
    Ok(())
}

impl Aligned {
    /// Name and scores of each alignment, in the order of tables.
    #[must_use]
    pub fn variants(&self) -> Vec<(&'static str, &Scores)> {
        let mut all = vec![("raw", &self.raw), ("ilr", &self.ilr), ("slr", &self.slr)];
        all.extend(self.ilr_scalar.as_ref().map(|s| ("ilr_scalar", s)));
        all.extend(self.slr_scalar.as_ref().map(|s| ("slr_scalar", s)));
        all.extend(self.exposure.as_ref().map(|s| ("exposure", s)));
        all
    }

    fn mean(all: &[&Self]) -> Self {
        let pick = |f: fn(&Self) -> &Scores| Scores::mean(all.iter().map(|a| f(a)));
        let some = |f: fn(&Self) -> Option<&Scores>| {
            let known: Vec<&Scores> = all.iter().filter_map(|a| f(a)).collect();
            (!known.is_empty()).then(|| Scores::mean(known))
        };
        Self {
            raw: pick(|a| &a.raw),
            ilr: pick(|a| &a.ilr),
            slr: pick(|a| &a.slr),
            ilr_scalar: some(|a| a.ilr_scalar.as_ref()),
            slr_scalar: some(|a| a.slr_scalar.as_ref()),
            exposure: some(|a| a.exposure.as_ref()),
        }
    }
}

impl Figures {
    /// Means over cases or objects.
    #[must_use]
    pub fn mean<'a>(all: impl IntoIterator<Item = &'a Self>) -> Self {
        let all: Vec<&Self> = all.into_iter().collect();
        let spreads: Vec<f64> = all.iter().filter_map(|f| f.tone.spread).collect();
        let n = spreads.len() as f64;
        Self {
            whole: Aligned::mean(&all.iter().map(|f| &f.whole).collect::<Vec<_>>()),
            object_only: Aligned::mean(&all.iter().map(|f| &f.object_only).collect::<Vec<_>>()),
            tone: Tone {
                spread: (!spreads.is_empty()).then(|| rounded(spreads.iter().sum::<f64>() / n)),
                ..Tone::default()
            },
        }
    }
}
