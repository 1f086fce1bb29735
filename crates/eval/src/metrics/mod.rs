//! Image metrics, between display-encoded images of one size; one file each.

mod psnr;

pub use psnr::{psnr, psnr_where};
