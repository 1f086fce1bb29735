//! The `lumi` command line.
fn main() {}
