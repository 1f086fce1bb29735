//! The authors' own encodings of light, for their checkpoints (SPEC: environment PNGs and light-ray files).
