//! COLMAP's models, binary and text, and the authors' light rays.
#![no_main]

use libfuzzer_sys::fuzz_target;
use lumi_data::parsers;

fuzz_target!(init: lumi_fuzz::seed("models"), |bytes: &[u8]| {
    let _ = parsers::colmap_cameras(bytes);
    let _ = parsers::colmap_images(bytes);
    let _ = parsers::light_rays(bytes);
    if let Ok(text) = std::str::from_utf8(bytes) {
        let _ = parsers::colmap_text(text);
    }
});
