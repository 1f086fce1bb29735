//! Training records as safetensors files.
#![no_main]

use libfuzzer_sys::fuzz_target;
use lumi_data::store::ObjectRecord;
use std::path::Path;

fuzz_target!(init: lumi_fuzz::seed("records"), |bytes: &[u8]| {
    let _ = ObjectRecord::parse(Path::new("fuzz.safetensors"), bytes);
});
