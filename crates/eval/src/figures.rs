//! What one method scores: every alignment, on whole images and on the object alone, and its per-view scales.

use crate::Result;
use crate::align::{Scale, apply, fit, fit_scalar, spread};
use crate::metrics::{Judge, Pair, Scores, rounded};
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
        predictions: &[DisplayImage],
        truth: &[DisplayImage],
        detail: Detail,
    ) -> Result<Figures> {
        check(predictions, truth)?;
        let prepared: Vec<_> = predictions
            .iter()
            .zip(truth)
            .map(|(p, t)| self.rules.prepare(p, t))
            .collect();
        let pairs: Vec<(&DisplayImage, &DisplayImage)> =
            prepared.iter().map(|(p, t)| (p, t)).collect();
        let each = |fit: fn(&[(&DisplayImage, &DisplayImage)]) -> Scale| -> Vec<Scale> {
            pairs.iter().map(|pair| fit(&[*pair])).collect()
        };
        let (channels, scalars) = (each(fit), each(fit_scalar));
        let scores = |scales: &[Scale]| -> Result<[Scores; 2]> {
            let scaled: Vec<DisplayImage> = pairs
                .iter()
                .zip(scales.iter().cycle())
                .map(|((p, t), scale)| apply(p, t, *scale))
                .collect();
            let of = |object_only| -> Result<Scores> {
                let pairs = scaled
                    .iter()
                    .zip(&pairs)
                    .map(|(prediction, (_, truth))| Pair {
                        prediction,
                        truth,
                        object_only,
                    });
                self.measure(&pairs.collect::<Vec<_>>())
            };
            Ok([of(false)?, of(true)?])
        };
        let mut both = [Aligned::default(), Aligned::default()];
        // A scale of exactly 1 would still pass through the display encoding and back.
        let raw = |object_only| -> Result<Scores> {
            let pairs = pairs.iter().map(|(prediction, truth)| Pair {
                prediction,
                truth,
                object_only,
            });
            self.measure(&pairs.collect::<Vec<_>>())
        };
        let (ilr, slr) = (scores(&channels)?, scores(&[fit(&pairs)])?);
        for (k, (ilr, slr)) in ilr.into_iter().zip(slr).enumerate() {
            both[k].raw = raw(k == 1)?;
            (both[k].ilr, both[k].slr) = (ilr, slr);
        }
        if detail == Detail::Full {
            let (ilr, slr) = (scores(&scalars)?, scores(&[fit_scalar(&pairs)])?);
            for (k, (ilr, slr)) in ilr.into_iter().zip(slr).enumerate() {
                (both[k].ilr_scalar, both[k].slr_scalar) = (Some(ilr), Some(slr));
            }
        }
        let [whole, object_only] = both;
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

fn check(predictions: &[DisplayImage], truth: &[DisplayImage]) -> Result<()> {
    if predictions.len() != truth.len() {
        let expected = format!(
            "expected {} views, found {}",
            truth.len(),
            predictions.len()
        );
        return Err(lumi_core::Error::value("predictions", expected).into());
    }
    for (i, (p, t)) in predictions.iter().zip(truth).enumerate() {
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
