//! Bytes that a glTF document refers to: files beside it and data URIs.

use crate::image_file;
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use std::path::Path;

/// What `uri` holds, or what was wrong with it.
pub fn resolve(path: &Path, uri: &str) -> Result<Vec<u8>, String> {
    if let Some(data) = uri.strip_prefix("data:") {
        let (_, encoded) = data
            .split_once(";base64,")
            .ok_or("expected a data URI in base64")?;
        return STANDARD.decode(encoded).map_err(|e| e.to_string());
    }
    if uri.contains("://") {
        return Err(format!("expected a file beside the model, found `{uri}`"));
    }
    let folder = path.parent().unwrap_or(Path::new(""));
    let found = |name: &[u8]| image_file::beside(&[folder], name);
    // Some files are written with a bare `%`.
    let file = found(&percent_decoded(uri)).or_else(|| found(uri.as_bytes()));
    let file = file.ok_or_else(|| format!("`{uri}` is not there"))?;
    std::fs::read(&file).map_err(|e| format!("{}: {e}", file.display()))
}

/// `%20` and the like as the bytes that they stand for.
fn percent_decoded(uri: &str) -> Vec<u8> {
    let bytes = uri.as_bytes();
    let (mut out, mut i) = (Vec::with_capacity(bytes.len()), 0);
    while i < bytes.len() {
        let hex = uri.get(i + 1..i + 3).filter(|_| bytes[i] == b'%');
        match hex.and_then(|h| u8::from_str_radix(h, 16).ok()) {
            Some(byte) => {
                out.push(byte);
                i += 3;
            }
            None => {
                out.push(bytes[i]);
                i += 1;
            }
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn uris_of_every_kind() {
        let folder = tempfile::tempdir().expect("folder");
        let model = folder.path().join("a.gltf");
        std::fs::write(folder.path().join("ä b.bin"), b"file").expect("written");
        assert_eq!(resolve(&model, "%C3%A4%20b.bin").expect("file"), b"file");
        let data = "data:application/octet-stream;base64,ZGF0YQ==";
        assert_eq!(resolve(&model, data).expect("data"), b"data");
        assert_eq!(percent_decoded("100%-%zz%4"), b"100%-%zz%4");
        for (uri, word) in [
            ("data:,x", "base64"),
            ("data:a;base64,*", "Invalid"),
            ("https://example.org/a.bin", "beside"),
            ("nothing.bin", "nothing.bin"),
        ] {
            let message = resolve(&model, uri).expect_err("wrong");
            assert!(message.contains(word), "{message}");
        }
    }
}
