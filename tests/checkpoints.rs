//! Weights of others, and of other kinds: `lumi verify`, `lumi import`, and what is refused.
#![allow(clippy::unwrap_used)]

mod common;

use common::{fails, lumi};
use std::path::Path;

fn golden(path: &str) -> String {
    lumi_testkit::shared("reference/golden")
        .join(path)
        .to_str()
        .unwrap()
        .to_owned()
}

#[test]
fn verify_passes_on_golden_weights_and_fails_on_others() {
    for variant in ["mlp", "dpt"] {
        let [config, case] = ["config.json", ""].map(|f| golden(&format!("{variant}/{f}")));
        for weights in ["weights.safetensors", "checkpoint.pt"] {
            let weights = golden(&format!("{variant}/{weights}"));
            let output = lumi(&[
                "verify",
                "--weights",
                &weights,
                "--config",
                &config,
                "--case",
                &case,
            ]);
            let text = String::from_utf8_lossy(&output.stdout);
            assert!(output.status.success(), "{text}");
            assert!(
                text.contains("render.chain3") && text.contains(" 0 beyond"),
                "{text}"
            );
        }
    }
    // Right shapes, other numbers: exit status 1, and every row is still printed.
    let folder = tempfile::tempdir().unwrap();
    let other = folder.path().join("other.safetensors");
    let mut bytes = std::fs::read(golden("mlp/weights.safetensors")).unwrap();
    let last = bytes.len() - 4000;
    bytes[last..].fill(0);
    std::fs::write(&other, bytes).unwrap();
    let (config, case) = (golden("mlp/config.json"), golden("mlp"));
    let args = [
        "verify",
        "--weights",
        other.to_str().unwrap(),
        "--config",
        &config,
        "--case",
        &case,
    ];
    let output = lumi(&args);
    assert_eq!(output.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&output.stdout).contains("too large"));
}

#[test]
fn import_converts_and_rejects_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("mlp.safetensors");
    let out = out.to_str().unwrap();
    let (checkpoint, config) = (golden("mlp/checkpoint.pt"), golden("mlp/config.json"));
    let output = lumi(&["import", &checkpoint, "--config", &config, "-o", out]);
    assert!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    // What was imported verifies like the original.
    let case = golden("mlp");
    let output = lumi(&[
        "verify",
        "--weights",
        out,
        "--config",
        &config,
        "--case",
        &case,
    ]);
    assert!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );

    let wrong = folder.path().join("wrong.safetensors");
    let wrong = wrong.to_str().unwrap();
    let import = |checkpoint: &str, config: &str, words: &[&str]| {
        fails(
            &["import", checkpoint, "--config", config, "-o", wrong],
            1,
            words,
        );
        assert!(!Path::new(wrong).exists());
    };
    // The other head: its tensors are missing.
    import(
        &checkpoint,
        &golden("dpt/config.json"),
        &["image_token_decoder", "missing"],
    );
    // Another size.
    let text = std::fs::read_to_string(&config).unwrap();
    let narrow = folder.path().join("narrow.json");
    std::fs::write(
        &narrow,
        text.replace("\"n_latent_vectors\": 32", "\"n_latent_vectors\": 31"),
    )
    .unwrap();
    import(
        &checkpoint,
        narrow.to_str().unwrap(),
        &["n_light_field_latent", "[31, 64]", "[32, 64]"],
    );
    // Fewer layers: left-over tensors.
    let short = folder.path().join("short.json");
    std::fs::write(
        &short,
        text.replace("\"encoder_n_layer\": 2", "\"encoder_n_layer\": 1"),
    )
    .unwrap();
    import(
        &checkpoint,
        short.to_str().unwrap(),
        &["transformer_encoder.1", "unexpected"],
    );
    // Not a checkpoint at all.
    let junk = folder.path().join("junk.pt");
    std::fs::write(&junk, b"junk").unwrap();
    import(junk.to_str().unwrap(), &config, &["junk.pt"]);
}

#[test]
fn weights_of_another_kind_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let scene = Path::new(env!("CARGO_MANIFEST_DIR")).join("assets/demo/spot");
    let out = folder.path().join("out");
    let [scene, out] = [&scene, &out].map(|p| p.to_str().unwrap());
    let foreign = golden("mlp/weights.safetensors");
    let args = ["relight", scene, "--model", &foreign, "--out", out];
    fails(
        &args,
        1,
        &["weights.safetensors", "LumiTokens weights file"],
    );
    let truncated = folder.path().join("half.safetensors");
    let bundled = Path::new(env!("CARGO_MANIFEST_DIR")).join("assets/lumi-mini.safetensors");
    let bytes = std::fs::read(bundled).unwrap();
    std::fs::write(&truncated, &bytes[..bytes.len() / 2]).unwrap();
    let args = [
        "relight",
        scene,
        "--model",
        truncated.to_str().unwrap(),
        "--out",
        out,
    ];
    fails(&args, 1, &["half.safetensors"]);
}
