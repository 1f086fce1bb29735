//! Gradients to new weights: which parts train, global-norm clipping, AdamW, and averaged weights.

use crate::Result;
use crate::config::{OptimizerConfig, OptimizerKind, Parts};
use crate::reduce::Reduce;
use burn::module::{Module, ModuleMapper, ModuleVisitor, Param, ParamGroup, ParamId};
use burn::optim::decay::WeightDecayConfig;
use burn::optim::{
    AdamWConfig, AdjustLrFn, GradientsAccumulator, GradientsParams, ModuleOptimizer, MuonConfig,
};
use burn::tensor::{Gradients, Tensor, TensorData};
use lumi_model::Network;
use lumi_model::network::Part;
use lumi_model::params::{self, LazyParam, NamedTensor};
use std::collections::HashMap;

/// The optimiser of a config, with every parameter stated (Burn's defaults differ from the usual ones).
#[must_use]
pub fn optimizer<M: Module>(config: &OptimizerConfig, network: &M) -> ModuleOptimizer {
    let adamw = AdamWConfig::new()
        .with_beta_1(config.beta1)
        .with_beta_2(config.beta2)
        .with_epsilon(config.epsilon)
        .with_weight_decay(config.weight_decay)
        .init();
    match config.kind {
        OptimizerKind::Adamw => adamw,
        OptimizerKind::Muon => {
            // Matching AdamW's update size, so that one learning rate serves both. (Burn's other
            // choice scales by rows over columns, which assumes weights stored the other way.)
            let muon = MuonConfig::new()
                .with_weight_decay(Some(WeightDecayConfig::new(config.weight_decay)))
                .with_adjust_lr_fn(AdjustLrFn::MatchRmsAdamW)
                .build();
            adamw.with_group(ParamGroup::from_ids(block_matrices(network)), muon, None)
        }
    }
}

/// The matrices of the transformer blocks, which Muon is meant for.
fn block_matrices<M: Module>(network: &M) -> Vec<ParamId> {
    let blocks = ["encoder.", "editor.", "decoder."];
    let params = params::list(network).into_iter();
    let matrices = params.filter(|param| {
        param.shape.len() == 2 && blocks.iter().any(|block| param.name.starts_with(block))
    });
    matrices.map(|param| param.id).collect()
}

/// The part that each parameter belongs to.
type PartOf = HashMap<ParamId, Part>;

fn part_of<M: Module>(network: &M) -> PartOf {
    let params = params::list(network).into_iter();
    params
        .map(|param| (param.id, Part::of(&param.name)))
        .collect()
}

/// The network with gradients switched on for the parts that learn, and off for the others.
#[must_use]
pub fn select<M: Module>(network: M, parts: Parts) -> M {
    struct Select(PartOf, Parts);
    impl ModuleMapper for Select {
        fn map_float<const D: usize>(&mut self, param: Param<Tensor<D>>) -> Param<Tensor<D>> {
            let learns = self.1.train(self.0[&param.id]);
            param.set_require_grad(learns)
        }
    }
    let part_of = part_of(&network);
    network.map(&mut Select(part_of, parts))
}

/// What a step leaves.
pub struct Stepped {
    /// The network after it; as before where loss or gradients are no numbers.
    pub network: Network,
    /// The mean loss before it, over all workers.
    pub loss: f32,
    /// Global L2 norm of the gradients, before clipping.
    pub norm: f64,
}

/// How far a step goes.
#[derive(Clone, Copy, Debug)]
pub struct Pace {
    /// Learning rate.
    pub rate: f64,
    /// Factor on it for everything but the head.
    pub backbone: f64,
    /// Further factor on it for the editor and the light tokenizers.
    pub editor: f64,
    /// Largest global norm of the mean gradient.
    pub limit: f64,
}

impl Pace {
    /// One learning rate for all.
    #[must_use]
    pub fn even(rate: f64, limit: f64) -> Self {
        Self {
            rate,
            backbone: 1.0,
            editor: 1.0,
            limit,
        }
    }

    /// The learning rate of a part.
    #[must_use]
    pub fn of(&self, part: Part) -> f64 {
        match part {
            Part::Head => self.rate,
            Part::Editor => self.rate * self.backbone * self.editor,
            Part::Encoder | Part::Decoder | Part::Albedo => self.rate * self.backbone,
        }
    }
}

/// One optimiser step down the mean `loss` of `batches`, of which each worker has its share. They are worked through one
/// after the other, so that only one at a time needs memory.
///
/// # Errors
/// Those of `loss`, and another worker's failure.
pub fn descend<B>(
    network: Network,
    optimizer: &mut ModuleOptimizer,
    parts: Parts,
    pace: Pace,
    batches: &[B],
    worker: &dyn Reduce,
    loss: impl Fn(&Network, &B) -> Result<Tensor<1>>,
) -> Result<Stepped> {
    let share = 1.0 / batches.len() as f64;
    let mut sum = GradientsAccumulator::new();
    let mut mean_loss = 0.0;
    for batch in batches {
        let loss = loss(&network, batch)? * share;
        mean_loss += loss.clone().into_scalar::<f32>();
        let grads = collect(&mut loss.backward(), &network, parts);
        sum.accumulate(&network, grads);
    }
    let grads = mean(sum.grads(), &mut mean_loss, &network, worker)?;
    let norm = global_norm(&grads, &network);
    let network = if mean_loss.is_finite() && norm.is_finite() {
        let grads = clip(grads, &network, norm, pace.limit);
        let groups = by_rate(grads, &network, pace);
        let step = |network, (rate, grads)| optimizer.step(rate, network, grads);
        groups.into_iter().fold(network, step)
    } else {
        network
    };
    Ok(Stepped {
        network,
        loss: mean_loss,
        norm,
    })
}

/// The gradients of the parts that learn.
fn collect<M: Module>(grads: &mut Gradients, network: &M, parts: Parts) -> GradientsParams {
    struct Collect<'a>(&'a mut Gradients, PartOf, Parts, GradientsParams);
    impl ModuleVisitor for Collect<'_> {
        fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
            let Some(grad) = param.val().grad_remove(self.0) else {
                return;
            };
            if self.2.train(self.1[&param.id]) {
                self.3.register(param.id, grad);
            }
        }
    }
    let mut visitor = Collect(grads, part_of(network), parts, GradientsParams::new());
    network.visit(&mut visitor);
    visitor.3
}

/// The mean over all workers of gradients and `loss`, in one exchange.
fn mean<M: Module>(
    grads: GradientsParams,
    loss: &mut f32,
    network: &M,
    worker: &dyn Reduce,
) -> Result<GradientsParams> {
    struct Gather<'a>(&'a GradientsParams, Vec<f32>);
    impl ModuleVisitor for Gather<'_> {
        fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
            if let Some(grad) = self.0.get::<D>(param.id) {
                self.1.extend(params::to_vec(grad));
            }
        }
    }
    struct Scatter<'a>(GradientsParams, &'a [f32], GradientsParams);
    impl ModuleVisitor for Scatter<'_> {
        fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
            if let Some(grad) = self.0.remove::<D>(param.id) {
                let (values, rest) = self.1.split_at(grad.shape().num_elements());
                let data = TensorData::new(values.to_vec(), grad.dims());
                let mean = Tensor::<D>::from_data(data, &grad.device());
                self.2.register(param.id, mean);
                self.1 = rest;
            }
        }
    }
    if worker.workers() == 1 {
        return Ok(grads);
    }
    let mut gather = Gather(&grads, vec![*loss]);
    network.visit(&mut gather);
    let mut values = gather.1;
    worker.mean(&mut values)?;
    *loss = values[0];
    let mut scatter = Scatter(grads, &values[1..], GradientsParams::new());
    network.visit(&mut scatter);
    Ok(scatter.2)
}

/// The gradients in groups of one learning rate each.
fn by_rate(grads: GradientsParams, network: &Network, pace: Pace) -> Vec<(f64, GradientsParams)> {
    struct Split(GradientsParams, PartOf, Pace, Vec<(f64, GradientsParams)>);
    impl ModuleVisitor for Split {
        fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
            let Some(grad) = self.0.remove::<D>(param.id) else {
                return;
            };
            let rate = self.2.of(self.1[&param.id]);
            let groups = &mut self.3;
            let at = groups.iter().position(|(r, _)| *r == rate);
            let at = at.unwrap_or_else(|| {
                groups.push((rate, GradientsParams::new()));
                groups.len() - 1
            });
            groups[at].1.register(param.id, grad);
        }
    }
    let mut visitor = Split(grads, part_of(network), pace, Vec::new());
    network.visit(&mut visitor);
    visitor.3
}

/// L2 norm over all gradients; infinite or NaN where one value is.
fn global_norm<M: Module>(grads: &GradientsParams, network: &M) -> f64 {
    struct Norm<'a>(&'a GradientsParams, f64);
    impl ModuleVisitor for Norm<'_> {
        fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
            if let Some(grad) = self.0.get::<D>(param.id) {
                let square: f32 = grad.square().sum().into_scalar();
                self.1 += f64::from(square);
            }
        }
    }
    let mut visitor = Norm(grads, 0.0);
    network.visit(&mut visitor);
    visitor.1.sqrt()
}

/// Scales all gradients so that their global norm is at most `limit`.
fn clip<M: Module>(grads: GradientsParams, network: &M, norm: f64, limit: f64) -> GradientsParams {
    struct Scale(GradientsParams, GradientsParams, f64);
    impl ModuleVisitor for Scale {
        fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
            if let Some(grad) = self.0.remove::<D>(param.id) {
                self.1.register(param.id, grad * self.2);
            }
        }
    }
    if norm <= limit {
        return grads;
    }
    let mut visitor = Scale(grads, GradientsParams::new(), limit / norm);
    network.visit(&mut visitor);
    visitor.1
}

/// Exponentially averaged weights.
pub struct Average {
    /// The averages, in the module's order.
    pub tensors: Vec<NamedTensor>,
    /// Updates so far.
    pub updates: u64,
    decay: f32,
}

impl Average {
    /// Starts from the module's weights.
    #[must_use]
    pub fn new<M: Module>(module: &M, decay: f32) -> Self {
        Self {
            tensors: params::export(module),
            updates: 0,
            decay,
        }
    }

    /// Takes in the module's weights; the decay grows from 0 so that the start is soon forgotten.
    pub fn update<M: Module>(&mut self, module: &M) {
        self.updates += 1;
        let n = self.updates as f32;
        let decay = self.decay.min((1.0 + n) / (10.0 + n));
        for (mean, new) in self.tensors.iter_mut().zip(params::export(module)) {
            for (m, v) in mean.values.iter_mut().zip(new.values) {
                *m += (1.0 - decay) * (v - *m);
            }
        }
    }

    /// The averaged weights for a file.
    #[must_use]
    pub fn lazy(&self) -> Vec<LazyParam<'_>> {
        self.tensors.iter().map(LazyParam::from).collect()
    }

    /// The module with the averaged weights.
    #[must_use]
    pub fn apply<M: Module>(&self, module: M) -> M {
        let mut tensors = self.tensors.iter();
        params::replace(module, &mut |_, _| tensors.next().map(|t| t.values.clone()))
    }
}
