//! Training memory without our kernels grows linearly in the number of tokens. Alone in this file, since it reads the
//! peak of the whole process, which Linux tells.
#![cfg(target_os = "linux")]
#![allow(clippy::unwrap_used)]

use burn::tensor::{Device, Distribution, Tensor};
use lumi_core::{Seed, memory};
use lumi_model::block::Block;

#[test]
fn a_composed_block_keeps_no_scores_for_its_backward_pass() {
    let device = Device::flex().autodiff();
    let mut rng = Seed(1).stream("block");
    let block = Block::new(16, 16, 1, 0.2, &mut rng, &device);
    // The 8192² scores of the one head would be 256 MiB for each tensor of that size.
    let n = 8192;
    let x = Tensor::<3>::random([1, n, 16], Distribution::Default, &device).require_grad();
    assert!(memory::reset_peak());
    let before = memory::peak().unwrap();
    let out = block.forward_composed(x.clone(), None);
    let grads = out.sum().backward();
    assert!(x.grad(&grads).is_some());
    let added = (memory::peak().unwrap() - before) >> 20;
    assert!(added < 256, "{added} MiB");
}
