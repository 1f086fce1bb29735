//! (filled with the bf16 kernel)
