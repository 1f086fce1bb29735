//! Image files that models name: where they are, and their pixels.

use image::{ImageFormat, ImageReader, Limits, RgbaImage};
use lumi_core::image::{decode_jpeg, type_of};
use std::io::Cursor;
use std::path::{Path, PathBuf};

/// Largest side of an image in pixels.
const MOST_PIXELS: u32 = 16_384;
/// Most bytes that decoding an image may take.
const MOST_BYTES: u64 = 1 << 30;

/// The pixels of an image file, or what was wrong with it.
///
/// # Errors
/// If it cannot be read, or is none of the formats that [`decode`] knows.
pub fn read(file: &Path) -> Result<RgbaImage, String> {
    let bytes = std::fs::read(file).map_err(|e| e.to_string())?;
    decode(&bytes, file)
}

/// The pixels of a PNG, JPEG, WebP, BMP or TGA file. Its content says which it is, but for TGA, which has no mark: that
/// is what `name` ends with.
///
/// # Errors
/// Says what was wrong.
pub fn decode(bytes: &[u8], name: &Path) -> Result<RgbaImage, String> {
    let tga = name
        .extension()
        .is_some_and(|e| e.eq_ignore_ascii_case("tga"));
    use ImageFormat::{Bmp, Jpeg, Png, WebP};
    let format = match image::guess_format(bytes) {
        Ok(format @ (Png | Jpeg | WebP | Bmp)) => format,
        _ if tga => ImageFormat::Tga,
        _ => {
            let found = type_of(bytes).map_or_else(String::new, |t| format!(", found {t}"));
            return Err(format!(
                "expected a PNG, JPEG, WebP, BMP or TGA image{found}"
            ));
        }
    };
    let mut reader = ImageReader::with_format(Cursor::new(bytes), format);
    let mut limits = Limits::default();
    limits.max_image_width = Some(MOST_PIXELS);
    limits.max_image_height = Some(MOST_PIXELS);
    limits.max_alloc = Some(MOST_BYTES);
    reader.limits(limits);
    let image = match format {
        // The decoder behind `image` shows a cut file with a grey part.
        Jpeg => {
            let (width, height) = reader.into_dimensions().map_err(|e| e.to_string())?;
            if width > MOST_PIXELS || height > MOST_PIXELS {
                return Err(format!("expected sides of at most {MOST_PIXELS} pixels"));
            }
            decode_jpeg(bytes)?.0
        }
        _ => reader.decode().map_err(|e| e.to_string())?,
    };
    if image.width() == 0 || image.height() == 0 {
        return Err("expected at least one pixel".to_owned());
    }
    Ok(image.into_rgba8())
}

/// The file that a model means by `name`: as it is written, which may be with Windows' separators, or else its last
/// part alone, since many files hold paths of the machine that made them; in each of `folders`, capitals aside.
#[must_use]
pub fn beside(folders: &[&Path], name: &[u8]) -> Option<PathBuf> {
    let name: Vec<u8> = name
        .iter()
        .map(|&b| if b == b'\\' { b'/' } else { b })
        .collect();
    let written = path(&name);
    let last = path(name.rsplit(|&b| b == b'/').next()?);
    let there = |p: PathBuf| p.is_file().then_some(p);
    let exact = |name: &Path| folders.iter().find_map(|f| there(f.join(name)));
    let alike = |folder: &&Path| {
        let entries = std::fs::read_dir(folder).ok()?.flatten();
        let mut found: Vec<PathBuf> = entries
            .filter(|e| e.file_name().eq_ignore_ascii_case(&last))
            .map(|e| e.path())
            .collect();
        found.sort();
        found.into_iter().find_map(there)
    };
    exact(&written)
        .or_else(|| exact(&last))
        .or_else(|| folders.iter().find_map(alike))
}

/// A file's name from bytes in an unknown encoding: where names are bytes, the same ones.
fn path(name: &[u8]) -> PathBuf {
    #[cfg(unix)]
    {
        use std::os::unix::ffi::OsStrExt;
        PathBuf::from(std::ffi::OsStr::from_bytes(name))
    }
    #[cfg(not(unix))]
    {
        PathBuf::from(String::from_utf8_lossy(name).into_owned())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::Rgba;

    fn encoded(format: ImageFormat) -> Vec<u8> {
        let mut bytes = Cursor::new(Vec::new());
        let image = RgbaImage::from_fn(2, 2, |x, y| Rgba([50 * x as u8, 90 * y as u8, 200, 255]));
        let image = image::DynamicImage::from(image);
        match format {
            ImageFormat::Jpeg => image.to_rgb8().write_to(&mut bytes, format),
            _ => image.write_to(&mut bytes, format),
        }
        .expect("encoded");
        bytes.into_inner()
    }

    #[test]
    fn formats_are_known_by_their_content_and_tga_by_its_name() {
        for (format, name) in [
            (ImageFormat::Png, "a.jpg"),
            (ImageFormat::WebP, "a.png"),
            (ImageFormat::Bmp, "a"),
            (ImageFormat::Tga, "a.TGA"),
        ] {
            let pixels = decode(&encoded(format), Path::new(name)).expect("decoded");
            assert_eq!(pixels.dimensions(), (2, 2));
            assert_eq!(pixels.get_pixel(1, 0).0, [50, 0, 200, 255], "{name}");
            assert_eq!(pixels.get_pixel(0, 1).0, [0, 90, 200, 255], "{name}");
        }
        assert!(decode(&encoded(ImageFormat::Jpeg), Path::new("a.png")).is_ok());
        let error = decode(b"II*\0 and more", Path::new("a.png")).expect_err("TIFF");
        assert!(error.contains("found a TIFF image"), "{error}");
        for bytes in [&b"no image"[..], b""] {
            assert!(decode(bytes, Path::new("a.png")).is_err());
            assert!(decode(bytes, Path::new("a.tga")).is_err());
        }
    }

    #[test]
    fn a_cut_jpeg_is_an_error() {
        let noise = |x: u32, y: u32| image::Rgb([(x * 37 + y * 101) as u8, (x * y) as u8, 7]);
        let mut bytes = Cursor::new(Vec::new());
        let image = image::RgbImage::from_fn(64, 64, noise);
        image
            .write_to(&mut bytes, ImageFormat::Jpeg)
            .expect("encoded");
        let bytes = bytes.into_inner();
        let name = Path::new("a.jpg");
        assert_eq!(decode(&bytes, name).expect("whole").dimensions(), (64, 64));
        for n in [bytes.len() / 2, bytes.len() - 40] {
            assert!(decode(&bytes[..n], name).is_err(), "cut at {n}");
        }
    }

    #[test]
    fn images_that_lie_about_their_size_are_errors() {
        for format in [ImageFormat::Png, ImageFormat::Tga, ImageFormat::Bmp] {
            let (name, good) = (Path::new("a.tga"), encoded(format));
            let mut huge = good.clone();
            match format {
                ImageFormat::Png => huge[16..20].copy_from_slice(&0x7fff_ffff_u32.to_be_bytes()),
                ImageFormat::Tga => huge[12..16].copy_from_slice(&[0xff; 4]),
                _ => huge[18..22].copy_from_slice(&0x7fff_ffff_u32.to_le_bytes()),
            }
            assert!(decode(&huge, name).is_err(), "{format:?}");
            // The last chunk of a PNG says nothing, nor does the footer of a TGA.
            let needed = match format {
                ImageFormat::Png => good.len() - 12,
                ImageFormat::Tga => 18,
                _ => good.len(),
            };
            for n in 0..needed {
                assert!(decode(&good[..n], name).is_err(), "{format:?} cut at {n}");
            }
        }
    }

    #[test]
    fn files_are_found_as_windows_writes_them() {
        let folder = tempfile::tempdir().expect("folder");
        let (root, other) = (folder.path(), folder.path().join("mtl"));
        std::fs::create_dir_all(root.join("tex")).expect("folder");
        std::fs::create_dir_all(&other).expect("folder");
        for file in ["tex/a.png", "b.png", "mtl/b.png", "Big.PNG"] {
            std::fs::write(root.join(file), b"").expect("written");
        }
        let folders = [other.as_path(), root];
        let found = |name: &str| beside(&folders, name.as_bytes());
        for (name, file) in [
            ("tex\\a.png", "tex/a.png"),
            ("./b.png", "mtl/./b.png"),
            ("C:\\Users\\me\\tex\\b.png", "mtl/b.png"),
            ("big.png", "Big.PNG"),
        ] {
            assert_eq!(found(name), Some(root.join(file)), "{name}");
        }
        assert_eq!(found("a.png"), None);
        assert_eq!(found("tex"), None);
        assert_eq!(found(""), None);
    }
}
