//! Fast CPU transformer kernels on plain slices.
