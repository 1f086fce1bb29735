//! Views without visible patches: rendered twice, with patches half a side apart, and blended.

use crate::batch::Given;
use crate::head::resize;
use crate::network::{Prepared, behind_rays};
use crate::{Relighter, SceneTokens, batch};
use burn::tensor::Tensor;
use lumi_core::Camera;

impl Relighter {
    /// The model with overlapping patches or without, whatever its config says ([`crate::ModelConfig::overlap`]).
    #[must_use]
    pub fn with_overlap(mut self, overlap: bool) -> Self {
        self.config.overlap = overlap;
        self
    }

    /// Views from cameras of one size in model space: `[1, v, 3 or 4, h, w]`.
    ///
    /// Tokens see pictures at `1 / self.detail` of the cameras' size. The head's numbers are then enlarged, and what photographs
    /// show is looked up at full size; direct light is as smooth as they are.
    pub(crate) fn views(
        &self,
        prepared: &Prepared,
        scene: &SceneTokens,
        cameras: &[Camera],
    ) -> Tensor<5> {
        let (detail, config) = (self.detail, &self.config);
        let coarser = |c: &Camera| c.resized(c.width / detail, c.height / detail);
        let coarse: Vec<Camera> = cameras.iter().map(coarser).collect();
        let (logits, given) = self.view_logits(prepared, scene, &coarse);
        let given = behind_rays(given, config);
        if detail == 1 {
            return self.network.shown(logits, given, 1, config);
        }
        let (h, w) = cameras.first().map_or((0, 0), |c| (c.height, c.width));
        let enlarged = |x: Tensor<5>| {
            let [_, v, channels, rows, columns] = x.dims();
            let x = resize(x.reshape([v, channels, rows, columns]), h, w);
            x.reshape([1, v, channels, h, w])
        };
        let photographs = scene.captured.photographs.as_ref();
        let fine =
            photographs.map(|p| batch::carried(cameras, &p.fine, detail, config, &self.device));
        let [_, direct, _] = config.target_parts();
        let given = match (given, fine) {
            (Some(coarse), Some(fine)) if direct > 0 => {
                let direct = enlarged(coarse.narrow(2, 0, direct));
                Some(Tensor::cat(vec![direct, fine], 2))
            }
            (_, fine) => fine,
        };
        self.network.shown(enlarged(logits), given, detail, config)
    }

    /// The head's numbers for views, and what the decoder was given of them: `[1, v, …, h, w]` both.
    ///
    /// Where the config says `overlap`, a second render has its patches' corners where the first one's have their centres.
    /// Each pixel takes more from the render in whose patch it is further inside, so seams between patches, where a
    /// small decoder disagrees with itself, have no weight.
    fn view_logits(
        &self,
        prepared: &Prepared,
        scene: &SceneTokens,
        cameras: &[Camera],
    ) -> (Tensor<5>, Tensor<5>) {
        let photographs = scene.captured.photographs.as_ref();
        let given = photographs.map(|p| Given {
            photographs: &p.coarse,
            lights: &scene.lights,
            scale: scene.illumination,
        });
        let targets =
            |cameras: &[Camera]| batch::targets(cameras, given, &self.config, &self.device);
        let decode = |targets: Tensor<5>, cameras: &[Camera]| {
            self.network
                .logits_prepared(prepared, targets, cameras, &self.config)
        };
        if !self.config.overlap {
            let given = targets(cameras);
            return (decode(given.clone(), cameras), given);
        }
        let (patch, half) = (self.config.patch, self.config.patch / 2);
        let wider = |camera: &Camera| Camera {
            width: camera.width + patch,
            height: camera.height + patch,
            cx: camera.cx + half as f32,
            cy: camera.cy + half as f32,
            ..*camera
        };
        // The views' own pixels are in the middle of the wider ones'.
        let wider: Vec<Camera> = cameras.iter().map(wider).collect();
        let wide = targets(&wider);
        let [_, _, _, h, w] = wide.dims();
        let (h, w) = (h - patch, w - patch);
        let middle = |views: Tensor<5>| views.narrow(3, half, h).narrow(4, half, w);
        let given = middle(wide.clone());
        let plain = decode(given.clone(), cameras);
        let moved = middle(decode(wide, &wider));
        let share = batch::stack(shares(h, w, patch), [1, 1, 1, h, w], &self.device);
        (moved.clone() + (plain - moved) * share, given)
    }
}

/// How much of each pixel of `h × w` the render whose patches begin at the corner has.
fn shares(h: usize, w: usize, patch: usize) -> Vec<f32> {
    let inside = |i: usize| {
        let place = ((i % patch) as f32 + 0.5) / patch as f32;
        1.0 - (2.0 * place - 1.0).abs()
    };
    let half = patch / 2;
    let share = |y: usize, x: usize| {
        let plain = inside(y) * inside(x);
        plain / (plain + inside(y + half) * inside(x + half))
    };
    (0..h * w).map(|i| share(i / w, i % w)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn centres_are_taken_and_corners_are_not() {
        let shares = shares(16, 24, 8);
        let at = |y: usize, x: usize| shares[y * 24 + x];
        assert!(at(3, 4) > 0.95 && at(11, 20) > 0.95);
        assert!(at(0, 0) < 0.05 && at(8, 7) < 0.05 && at(15, 23) < 0.05);
        for (y, x) in [(0, 3), (5, 8), (2, 1)] {
            // Moved by half a patch both ways, the two renders change places.
            assert!((at(y, x) + at(y + 4, x + 4) - 1.0).abs() < 1e-6);
        }
    }
}
