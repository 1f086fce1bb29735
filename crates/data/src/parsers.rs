//! Parsers of bytes at hand, for fuzzing and property tests; not part of the interface.

use crate::formats::{authors, colmap};
use lumi_core::Result;

/// COLMAP's `cameras.bin`; the number of cameras.
///
/// # Errors
/// If the bytes are not such a file.
pub fn colmap_cameras(bytes: &[u8]) -> Result<usize> {
    Ok(colmap::binary::parse_cameras(bytes)?.len())
}

/// COLMAP's `images.bin`; the number of images.
///
/// # Errors
/// If the bytes are not such a file.
pub fn colmap_images(bytes: &[u8]) -> Result<usize> {
    Ok(colmap::binary::parse_images(bytes)?.len())
}

/// COLMAP's `cameras.txt`, then `images.txt`; the number of images.
///
/// # Errors
/// If the text is not such a file.
pub fn colmap_text(text: &str) -> Result<usize> {
    let path = std::path::Path::new("model.txt");
    let cameras = colmap::text::parse_cameras(path, text).map(|c| c.len());
    cameras.or_else(|_| Ok(colmap::text::parse_images(path, text)?.len()))
}

/// The authors' light rays and the lights they come from; the number of lights.
///
/// # Errors
/// If the bytes are not such a file.
pub fn light_rays(bytes: &[u8]) -> Result<usize> {
    Ok(authors::local_lights(bytes)?.len())
}
