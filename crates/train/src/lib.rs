//! Training stages, the loop and its state.
