//! A façade over random weights: for measuring time and memory, never for pictures.

use crate::checkpoint::Provenance;
use crate::{ModelConfig, Network, Relighter};
use burn::tensor::Device;
use lumi_core::Seed;
use lumi_kernels::Precision;

impl Relighter {
    /// An untrained model of this architecture; its provenance says so.
    #[must_use]
    pub fn random(config: &ModelConfig, seed: Seed, device: &Device) -> Self {
        Self {
            network: Network::new(config, seed, device),
            config: config.clone(),
            provenance: Provenance {
                origin: "random weights, untrained".to_owned(),
                ..Provenance::default()
            },
            fingerprint: format!("random-{:016x}", seed.0),
            refinement: 0,
            detail: 1,
            device: device.clone(),
        }
        .with_precision(Precision::Bf16)
    }
}
