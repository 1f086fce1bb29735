//! The program as tests run it.
#![allow(clippy::unwrap_used, dead_code)]

use std::path::Path;
use std::process::{Command, Output};

pub fn lumi(args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_lumi"))
        .args(args)
        .output()
        .unwrap()
}

/// Fails with `status`, says all `words`, does not panic, and leaves no output.
pub fn fails(args: &[&str], status: i32, words: &[&str]) {
    let output = lumi(args);
    let text = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(status), "{args:?}: {text}");
    assert!(!text.contains("panicked"), "{text}");
    for word in words {
        assert!(
            text.contains(word),
            "{args:?}: expected `{word}` in: {text}"
        );
    }
    if let Some(i) = args.iter().position(|a| *a == "--out") {
        assert!(
            !Path::new(args[i + 1]).exists(),
            "{args:?} left output behind"
        );
    }
}
