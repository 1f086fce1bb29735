//! The loss and its terms.
#![allow(clippy::unwrap_used)]

use burn::tensor::{Device, Distribution, Tensor, TensorData};
use lumi_core::Seed;
use lumi_train::TrainConfig;
use lumi_train::objective::{Objective, Outcome, Pair};
use rand::RngExt;

fn config(extra: &str) -> TrainConfig {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("train.toml");
    let text = format!(
        "model = 'nano'\ndata = 'd'\noutput = 'o'\nbatch = 1\n\
         perceptual = {{ net = 'alex' }}\n\
         [[stages]]\nkind = 'relight'\nsteps = 1\nlearning_rate = 1e-3\ninputs = [1, 1]\ntargets = 1\n{extra}"
    );
    std::fs::write(&path, text).unwrap();
    TrainConfig::read(&path).unwrap()
}

/// Pictures of random values, always the same for a name.
fn images(name: &str, device: &Device) -> Tensor<5> {
    let rng = &mut Seed(1).stream(name);
    let shape = [1, 2, 3, 32, 32];
    let count = shape.iter().product();
    let values: Vec<f32> = (0..count).map(|_| rng.random_range(0.1..0.9)).collect();
    Tensor::from_data(TensorData::new(values, shape), device)
}

fn pair(render: Tensor<5>, truth: Tensor<5>) -> Pair {
    Pair {
        render,
        truth,
        alpha: None,
        aligned: None,
    }
}

fn value(loss: Tensor<1>) -> f64 {
    f64::from(loss.into_scalar::<f32>())
}

#[test]
fn terms_add_up() {
    let device = Device::flex();
    let of = |a, b| pair(images(a, &device), images(b, &device));
    let (source, edit) = (of("a", "b"), of("c", "d"));
    let tokens = || Tensor::<3>::random([1, 4, 8], Distribution::Normal(0.0, 1.0), &device);
    let tokens = (tokens(), tokens());
    let mean = |a: &Tensor<5>, b: &Tensor<5>| value((a.clone() - b.clone()).square().mean());
    let apart = value((tokens.0.clone() - tokens.1.clone()).square().mean());
    let number = |x: f32| Tensor::<1>::from_data([x], &device);
    let detours = vec![number(0.5), number(0.25)];
    let outcome = |edits: Vec<Pair>| Outcome {
        source: Some(pair(source.render.clone(), source.truth.clone())),
        edits,
        tokens: Some(tokens.clone()),
        detours: detours.clone(),
        sums: vec![number(0.75), number(0.25)],
        albedo: Vec::new(),
    };
    let run = |extra: &str, edits: Vec<Pair>| {
        let config = config(extra);
        let objective = Objective::new(&config, &device).unwrap();
        value(objective.loss(&outcome(edits), &config.stages[0]).unwrap())
    };
    let squares = 0.5 * mean(&source.render, &source.truth) + mean(&edit.render, &edit.truth);
    let both = || {
        let edit = || pair(edit.render.clone(), edit.truth.clone());
        vec![edit(), edit()]
    };
    assert!((run("", both()) - squares).abs() < 1e-6);
    assert!((run("invariance = 0.1", both()) - squares - 0.1 * apart).abs() < 1e-6);
    let detour = 0.1 * 0.5 * (0.5 + 0.25);
    assert!((run("consistency = 0.1", both()) - squares - detour).abs() < 1e-6);
    assert!((run("additivity = 3.0", both()) - squares - 3.0 * 0.5).abs() < 1e-6);
    // The paper's relight stage looks at edits alone.
    let edits = mean(&edit.render, &edit.truth);
    assert!((run("reconstruction = 0.0", both()) - edits).abs() < 1e-6);
    // After edits a share of the error is that of the scaled render; under the light of the inputs none.
    let scaled = images("e", &device);
    let with_scaled = |p: &Pair| Pair {
        aligned: Some(scaled.clone()),
        ..pair(p.render.clone(), p.truth.clone())
    };
    let expected = squares + 0.25 * (mean(&scaled, &edit.truth) - mean(&edit.render, &edit.truth));
    let found = run(
        "aligned = 0.25",
        vec![with_scaled(&edit), with_scaled(&edit)],
    );
    assert!((found - expected).abs() < 1e-6, "{found} for {expected}");
    // LPIPS of random pictures is far from nothing, and its weight counts.
    let [one, two] = ["lpips = 1.0", "lpips = 2.0"].map(|w| run(w, both()) - squares);
    assert!(one > 0.05 && (two - 2.0 * one).abs() < 1e-5, "{one} {two}");
}

/// The gradient of the whole loss against a finite difference along itself.
#[test]
fn the_perceptual_loss_differentiates() {
    let device = Device::flex().autodiff();
    let config = config("lpips = 0.9");
    let objective = Objective::new(&config, &device).unwrap();
    let (render, truth) = (images("a", &device), images("b", &device));
    let loss = |render: Tensor<5>| {
        let outcome = Outcome {
            source: Some(pair(render, truth.clone())),
            edits: Vec::new(),
            tokens: None,
            detours: Vec::new(),
            sums: Vec::new(),
            albedo: Vec::new(),
        };
        objective.loss(&outcome, &config.stages[0]).unwrap()
    };
    let tracked = render.clone().require_grad();
    let grads = loss(tracked.clone()).backward();
    // Along the gradient the difference stands farthest above rounding; one that were wrong anywhere would be longer than
    // the slope along it.
    let gradient = Tensor::<5>::from_inner(tracked.grad(&grads).unwrap());
    let rms = value(gradient.clone().square().mean()).sqrt();
    let direction = gradient.clone() / rms;
    let slope = value((gradient * direction.clone()).sum());
    let step = 1e-3;
    let [up, down] = [step, -step].map(|s| value(loss(render.clone() + direction.clone() * s)));
    let found = (up - down) / (2.0 * step);
    assert!(
        (found - slope).abs() < 0.02 * slope.abs() + 1e-4,
        "{found} against {slope}"
    );
}
