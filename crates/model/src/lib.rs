//! Model (placeholder while dependencies build).
