//! Bytes that a glTF document refers to: its own chunk, files beside it, data URIs; and images.

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use image::{ImageReader, Limits, RgbaImage};
use std::io::Cursor;
use std::path::Path;

/// Largest side of an image in pixels.
const MOST_PIXELS: u32 = 16_384;
/// Most bytes that decoding an image may take.
const MOST_BYTES: u64 = 1 << 30;

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
    let file = path.with_file_name(percent_decoded(uri));
    std::fs::read(&file).map_err(|e| format!("{}: {e}", file.display()))
}

/// `%20` and the like as the bytes that they stand for.
fn percent_decoded(uri: &str) -> String {
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
    String::from_utf8_lossy(&out).into_owned()
}

/// A PNG or JPEG file's pixels, or what was wrong with it.
pub fn decode(bytes: &[u8]) -> Result<RgbaImage, String> {
    let reader = ImageReader::new(Cursor::new(bytes)).with_guessed_format();
    let mut reader = reader.map_err(|e| e.to_string())?;
    let mut limits = Limits::default();
    limits.max_image_width = Some(MOST_PIXELS);
    limits.max_image_height = Some(MOST_PIXELS);
    limits.max_alloc = Some(MOST_BYTES);
    reader.limits(limits);
    let image = reader.decode().map_err(|e| e.to_string())?;
    if image.width() == 0 || image.height() == 0 {
        return Err("expected at least one pixel".to_owned());
    }
    Ok(image.into_rgba8())
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
        assert_eq!(percent_decoded("100%-%zz%4"), "100%-%zz%4");
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

    #[test]
    fn images_that_lie_about_their_size_are_errors() {
        let mut png = Cursor::new(Vec::new());
        RgbaImage::new(2, 2)
            .write_to(&mut png, image::ImageFormat::Png)
            .expect("png");
        let good = png.into_inner();
        assert_eq!(decode(&good).expect("good").dimensions(), (2, 2));
        let mut huge = good.clone();
        huge[16..20].copy_from_slice(&0x7fff_ffff_u32.to_be_bytes());
        assert!(decode(&huge).is_err());
        for n in 0..good.len() - 12 {
            assert!(decode(&good[..n]).is_err(), "cut at {n}");
        }
    }
}
