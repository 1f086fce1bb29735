//! Metrics and evaluation protocols, also used by training.
