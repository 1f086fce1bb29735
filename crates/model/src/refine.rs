//! Scene tokens that show their photographs better than the encoder's: a few steps of descent on the tokens alone.

use crate::batch::Given;
use crate::config::Output;
use crate::network::Scene;
use crate::relighter::VIEWS_AT_ONCE;
use crate::{Network, Relighter, batch, params, radiance};
use burn::module::Module;
use burn::tensor::Tensor;
use lumi_core::{Camera, DisplayImage, Reprojection};

/// First step relative to the tokens' root mean square; later ones fall to zero. Larger or many more steps fit the
/// photographs better and new views worse.
const RATE: f32 = 0.02;
/// Decays of Adam's moments. There are few steps, so the second follows fast.
const DECAY: [f32; 2] = [0.9, 0.99];

impl Relighter {
    /// The model with `steps` of refinement in every [`Self::encode`]: Adam on the scene tokens, weights fixed, against
    /// the mean squared error of the decoded input views. About 30 steps gain detail where the encoder leaves some; each
    /// costs about three renders of all input views. 0 turns it off.
    ///
    /// Not part of the paper.
    #[must_use]
    pub fn with_refinement(mut self, steps: usize) -> Self {
        self.refinement = steps;
        self
    }

    /// A scene after `self.refinement` steps toward photographs from cameras in model space.
    pub(crate) fn refined(&self, scene: Scene, posed: &[(DisplayImage, Camera)]) -> Scene {
        let device = self.device.clone().autodiff();
        let mut weights = params::lazy(&self.network).into_iter();
        let network = params::replace(Network::blank(&self.config, &device), &mut |_, _| {
            weights.next().map(|weight| (weight.read)())
        });
        let network = network.no_grad().with_precision(self.network.precision());
        let views: Vec<_> = posed
            .chunks(VIEWS_AT_ONCE)
            .map(|some| {
                let cameras: Vec<_> = some.iter().map(|(_, camera)| *camera).collect();
                let images: Vec<_> = some.iter().map(|(image, _)| image).collect();
                let share = some.len() as f32 / posed.len() as f32;
                // Each is given the others' photographs: its own would leave nothing to fit.
                let target = |camera: &Camera| {
                    let others = posed.iter().filter(|(_, other)| other != camera);
                    let others = others.map(|(image, other)| (image, other));
                    let others = self.config.reprojection.then(|| Reprojection::new(others));
                    let given = others.as_ref().map(Given::captured);
                    batch::targets(&[*camera], given, &self.config, &device)
                };
                let targets = Tensor::cat(cameras.iter().map(target).collect(), 1);
                (targets, cameras, batch::images(&images, &device), share)
            })
            .collect();

        let mut tokens = scene.channels.clone();
        let rms: f32 = tokens.clone().square().mean().sqrt().into_scalar();
        let [mut mean, mut square] = [tokens.zeros_like(), tokens.zeros_like()];
        for step in 0..self.refinement {
            let tracked = Tensor::<3>::from_inner(tokens.clone()).require_grad();
            let mut gradient = tokens.zeros_like();
            for (targets, cameras, truth, share) in &views {
                let scene = Scene {
                    channels: tracked.clone(),
                    places: scene.places.clone(),
                };
                let render = network.decode(&scene, targets.clone(), cameras, &self.config);
                let shown = match self.config.output {
                    Output::Display => render,
                    Output::Radiance => radiance::over_white(render),
                };
                let loss = (shown - truth.clone()).square().mean() * *share;
                if let Some(some) = tracked.grad(&loss.backward()) {
                    gradient = gradient + some;
                }
            }
            let [a, b] = DECAY;
            mean = mean * a + gradient.clone() * (1.0 - a);
            square = square * b + gradient.square() * (1.0 - b);
            let [a, b] = DECAY.map(|decay| 1.0 - decay.powi(step as i32 + 1));
            let left = 1.0 - step as f32 / self.refinement as f32;
            let direction = (mean.clone() / a) / ((square.clone() / b).sqrt() + 1e-12);
            tokens = tokens - direction * (RATE * rms * left);
        }
        Scene {
            channels: tokens,
            places: scene.places,
        }
    }
}
