//! PNG, JPEG, EXR and HDR files, as photographs, radiance, masks and maps.
#![no_main]

use libfuzzer_sys::fuzz_target;
use std::path::Path;

fuzz_target!(init: lumi_fuzz::seed("images"), |bytes: &[u8]| {
    let path = Path::new("fuzz");
    let _ = lumi_core::image::decode_display(path, bytes);
    let _ = lumi_core::image::decode_linear(path, bytes);
    let _ = lumi_core::image::decode_mask(path, bytes);
    let _ = lumi_core::EnvMap::decode(path, bytes);
});
