//! Radiance pictures (`.hdr`, `.pic`): any `#?` signature, both run-length codings, all eight orientations.
//!
//! Radiance is pixels divided by the product of all `EXPOSURE` and `COLORCORR` lines. `PRIMARIES` and XYZE pixels are
//! converted to Rec. 709.
//!
//! Source: Radiance's documentation, "RADIANCE File Formats", section "Picture File Format".

use super::LinearImage;
use super::io::{check_plausible, check_size};
use super::primaries::{Primaries, convert};
use crate::{Error, Result};

/// A pixel as it is stored: three mantissas and the exponent that they share.
type Rgbe = [u8; 4];

/// The picture, opaque, and what there is to say of it. Values are not checked here.
///
/// # Errors
/// Names the part of the file that is wrong or missing.
pub(super) fn decode(bytes: &[u8]) -> Result<(LinearImage, Vec<String>)> {
    let mut lines = Lines { bytes, at: 0 };
    let header = Header::read(&mut lines)?;
    let size = Size::read(lines.next()?)?;
    let (width, height) = (size.width(), size.height());
    check_size(width, height, width.saturating_mul(height))?;
    check_plausible(width, height, bytes.len())?;
    let mut data = Data(&bytes[lines.at..]);
    let mut image = LinearImage::new(width, height);
    let mut scan = vec![[0; 4]; size.length];
    for i in 0..size.scans {
        data.scan(&mut scan).ok_or_else(|| {
            let expected = format!(
                "expected a complete file of {} scan lines, found {i}",
                size.scans
            );
            Error::value("scan lines", expected)
        })?;
        for (j, pixel) in scan.iter().enumerate() {
            let [r, g, b] = color(*pixel);
            let [x, y, z] = header.factor;
            image.pixels[size.index(i, j)] = [r / x, g / y, b / z, 1.0];
        }
    }
    let mut warnings = header.warnings;
    if let Some(primaries) = header.primaries {
        match primaries.to_rec_709() {
            Ok(Some(matrix)) => warnings.extend(convert(&mut image, &matrix)),
            Ok(None) => {}
            Err(()) => warnings.push(format!(
                "PRIMARIES: expected three colours around a white, found {primaries:?}; ignored"
            )),
        }
    }
    Ok((image, warnings))
}

/// Width and height, from the header.
pub(super) fn size(bytes: &[u8]) -> Result<(usize, usize)> {
    let mut lines = Lines { bytes, at: 0 };
    Header::read(&mut lines)?;
    let size = Size::read(lines.next()?)?;
    Ok((size.width(), size.height()))
}

fn color([r, g, b, exponent]: Rgbe) -> [f32; 3] {
    if exponent == 0 {
        return [0.0; 3];
    }
    let scale = f32::from(exponent) - 136.0;
    [r, g, b].map(|v| f32::from(v) * scale.exp2())
}

struct Lines<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl Lines<'_> {
    fn next(&mut self) -> Result<String> {
        let rest = &self.bytes[self.at..];
        let end = rest.iter().position(|b| *b == b'\n').ok_or_else(|| {
            let expected = "expected lines, one of them empty, and then the picture's size";
            Error::value("header", expected)
        })?;
        self.at += end + 1;
        Ok(String::from_utf8_lossy(&rest[..end]).trim().to_owned())
    }
}

struct Header {
    /// What pixels are divided by.
    factor: [f32; 3],
    primaries: Option<Primaries>,
    warnings: Vec<String>,
}

impl Header {
    /// The lines up to the empty one.
    fn read(lines: &mut Lines) -> Result<Self> {
        let mut header = Self {
            factor: [1.0; 3],
            primaries: None,
            warnings: Vec::new(),
        };
        let _signature = lines.next()?;
        loop {
            let line = lines.next()?;
            if line.is_empty() {
                return Ok(header);
            }
            if let Some((key, value)) = line.split_once('=') {
                header.field(key.trim(), value.trim())?;
            }
        }
    }

    fn field(&mut self, key: &str, value: &str) -> Result<()> {
        match key {
            "FORMAT" if value == "32-bit_rle_rgbe" => {}
            "FORMAT" if value == "32-bit_rle_xyze" => self.primaries = Some(Primaries::XYZ),
            "FORMAT" => {
                let expected =
                    format!("expected 32-bit_rle_rgbe or 32-bit_rle_xyze, found `{value}`");
                return Err(Error::value("FORMAT", expected));
            }
            "EXPOSURE" => match numbers(value) {
                Some([v]) if v > 0.0 => self.factor = self.factor.map(|f| f * v as f32),
                _ => self.ignored(key, value),
            },
            "COLORCORR" => match numbers::<3>(value) {
                Some(v) if v.iter().all(|v| *v > 0.0) => {
                    self.factor = std::array::from_fn(|c| self.factor[c] * v[c] as f32);
                }
                _ => self.ignored(key, value),
            },
            "PRIMARIES" => match numbers(value) {
                // XYZE pixels have no primaries of their own.
                Some(v) => self.primaries = self.primaries.or(Some(Primaries::new(v))),
                None => self.ignored(key, value),
            },
            _ => {}
        }
        Ok(())
    }

    fn ignored(&mut self, key: &str, value: &str) {
        self.warnings.push(format!(
            "{key}: expected positive numbers, found `{value}`; ignored"
        ));
    }
}

/// Exactly `N` finite numbers.
fn numbers<const N: usize>(text: &str) -> Option<[f64; N]> {
    let words: Option<Vec<f64>> = text.split_whitespace().map(|w| w.parse().ok()).collect();
    let numbers: [f64; N] = words?.try_into().ok()?;
    numbers.iter().all(|v| v.is_finite()).then_some(numbers)
}

/// The picture's size and how its scan lines lie.
struct Size {
    /// Whether scan lines are columns.
    columns: bool,
    /// Whether the first scan line is the bottom or the right one.
    scans_back: bool,
    /// Whether scan lines begin at the bottom or on the right.
    back: bool,
    scans: usize,
    length: usize,
}

impl Size {
    /// Such as `-Y 512 +X 1024`.
    fn read(line: String) -> Result<Self> {
        let words: Vec<&str> = line.split_whitespace().collect();
        let sides = || {
            let [first, scans, second, length] = words[..] else {
                return None;
            };
            // Rows from the top and columns from the left are −Y and +X.
            let (columns, scans_back) = match first {
                "-Y" => (false, false),
                "+Y" => (false, true),
                "+X" => (true, false),
                "-X" => (true, true),
                _ => return None,
            };
            let back = match (columns, second) {
                (false, "+X") | (true, "-Y") => false,
                (false, "-X") | (true, "+Y") => true,
                _ => return None,
            };
            Some(Self {
                columns,
                scans_back,
                back,
                scans: scans.parse().ok()?,
                length: length.parse().ok()?,
            })
        };
        sides().ok_or_else(|| {
            let expected = format!("expected such as `-Y 512 +X 1024`, found `{line}`");
            Error::value("size", expected)
        })
    }

    fn width(&self) -> usize {
        if self.columns {
            self.scans
        } else {
            self.length
        }
    }

    fn height(&self) -> usize {
        if self.columns {
            self.length
        } else {
            self.scans
        }
    }

    /// Where pixel `j` of scan line `i` lies, row-major.
    fn index(&self, i: usize, j: usize) -> usize {
        let i = if self.scans_back {
            self.scans - 1 - i
        } else {
            i
        };
        let j = if self.back { self.length - 1 - j } else { j };
        let (x, y) = if self.columns { (i, j) } else { (j, i) };
        y * self.width() + x
    }
}

/// What is left of the file; `None` where it ends too early or runs over.
struct Data<'a>(&'a [u8]);

impl Data<'_> {
    fn take<const N: usize>(&mut self) -> Option<[u8; N]> {
        let (first, rest) = self.0.split_first_chunk::<N>()?;
        self.0 = rest;
        Some(*first)
    }

    fn scan(&mut self, scan: &mut [Rgbe]) -> Option<()> {
        let length = scan.len();
        let marker = [2, 2, (length >> 8) as u8, length as u8];
        if (8..0x8000).contains(&length) && self.0.starts_with(&marker) {
            self.take::<4>()?;
            return (0..4).try_for_each(|channel| self.channel(scan, channel));
        }
        self.pixels(scan)
    }

    /// One channel of a scan line: runs of up to 127 equal bytes, and stretches of up to 128 others.
    fn channel(&mut self, scan: &mut [Rgbe], channel: usize) -> Option<()> {
        let mut at = 0;
        while at < scan.len() {
            let [count] = self.take()?;
            let (count, same) = if count > 128 {
                (usize::from(count) - 128, Some(self.take::<1>()?[0]))
            } else {
                (usize::from(count), None)
            };
            if count == 0 {
                return None;
            }
            for pixel in scan.get_mut(at..at + count)? {
                pixel[channel] = match same {
                    Some(value) => value,
                    None => self.take::<1>()?[0],
                };
            }
            at += count;
        }
        Some(())
    }

    /// Whole pixels; 1, 1, 1, n repeats the one before n times, and 256 times as often for each such pixel before.
    fn pixels(&mut self, scan: &mut [Rgbe]) -> Option<()> {
        let (mut at, mut shift) = (0, 0);
        while at < scan.len() {
            let pixel: Rgbe = self.take()?;
            if pixel[..3] == [1, 1, 1] {
                let count = usize::from(pixel[3]).checked_shl(shift)?;
                let before = *scan.get(at.checked_sub(1)?)?;
                scan.get_mut(at..at.checked_add(count)?)?.fill(before);
                at += count;
                shift = (shift + 8).min(24);
            } else {
                scan[at] = pixel;
                at += 1;
                shift = 0;
            }
        }
        Some(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A file with these header lines, a size and uncompressed pixels.
    fn file(lines: &str, size: &str, pixels: &[Rgbe]) -> Vec<u8> {
        let mut bytes = format!("{lines}\n\n{size}\n").into_bytes();
        bytes.extend_from_slice(pixels.as_flattened());
        bytes
    }

    const TWO: [Rgbe; 2] = [[128, 64, 32, 129], [0, 200, 100, 130]];

    #[test]
    fn signatures_line_ends_and_factors() {
        let lines = "#?RGBE\r\nFORMAT = 32-bit_rle_rgbe\r\nEXPOSURE= 0.5\r\nEXPOSURE=4\r\nCOLORCORR=1 2 4\r";
        let (image, warnings) = decode(&file(lines, "-Y 1 +X 2\r", &TWO)).expect("reads");
        assert_eq!(warnings, Vec::<String>::new());
        assert_eq!(image.pixels[0], [0.5, 0.125, 0.03125, 1.0]);
        assert_eq!(
            image.pixels[1],
            [0.0, 200.0 / 64.0 / 4.0, 100.0 / 64.0 / 8.0, 1.0]
        );
        let (image, warnings) =
            decode(&file("#?AUTOPANO\nEXPOSURE=0", "-Y 1 +X 2", &TWO)).expect("reads");
        assert_eq!(image.pixels[0][..3], [1.0, 0.5, 0.25]);
        assert!(warnings[0].starts_with("EXPOSURE"), "{warnings:?}");
    }

    #[test]
    fn orientations() {
        let pixels: Vec<Rgbe> = (0..6).map(|i| [i * 10, 0, 0, 136]).collect();
        let reds = |size: &str| -> (usize, Vec<f32>) {
            let (image, _) = decode(&file("#?RADIANCE", size, &pixels)).expect("reads");
            (
                image.width,
                image.pixels.iter().map(|p| p[0] / 10.0).collect(),
            )
        };
        assert_eq!(reds("-Y 2 +X 3"), (3, vec![0., 1., 2., 3., 4., 5.]));
        assert_eq!(reds("+Y 2 -X 3"), (3, vec![5., 4., 3., 2., 1., 0.]));
        assert_eq!(reds("+Y 2 +X 3"), (3, vec![3., 4., 5., 0., 1., 2.]));
        assert_eq!(reds("+X 2 -Y 3"), (2, vec![0., 3., 1., 4., 2., 5.]));
        assert_eq!(reds("-X 2 +Y 3"), (2, vec![5., 2., 4., 1., 3., 0.]));
    }

    #[test]
    fn run_lengths_old_and_new() {
        let old = [
            [9, 0, 0, 136],
            [1, 1, 1, 2],
            [7, 0, 0, 136],
            [1, 1, 1, 1],
            [1, 1, 1, 1],
        ];
        let (image, _) = decode(&file("#?RADIANCE", "-Y 1 +X 261", &old)).expect("reads");
        let reds: Vec<f32> = image.pixels.iter().map(|p| p[0]).collect();
        assert_eq!(reds[..4], [9.0, 9.0, 9.0, 7.0]);
        assert_eq!(reds[4..], [7.0; 257]);
        let mut new = b"#?RADIANCE\n\n-Y 1 +X 8\n\x02\x02\x00\x08".to_vec();
        new.extend([128 + 8, 5, 3, 1, 2, 3, 128 + 5, 4, 128 + 8, 0, 128 + 8, 136]);
        let (image, _) = decode(&new).expect("reads");
        assert_eq!(image.pixels[2][..3], [5.0, 3.0, 0.0]);
        assert_eq!(image.pixels[7][..3], [5.0, 4.0, 0.0]);
        for cut in 24..new.len() {
            let message = decode(&new[..cut]).expect_err("cut").to_string();
            assert!(
                message.contains("complete file of 1 scan lines"),
                "{message}"
            );
        }
    }

    #[test]
    fn xyze_and_primaries() {
        // XYZ of D65 at 128/256.
        let white = [[121, 128, 139, 128]; 2];
        let lines = "#?RADIANCE\nFORMAT=32-bit_rle_xyze";
        let (image, _) = decode(&file(lines, "-Y 1 +X 2", &white)).expect("reads");
        assert!(
            image.pixels[0][..3].iter().all(|v| (v - 0.5).abs() < 0.01),
            "{:?}",
            image.pixels
        );
        let lines = "#?RADIANCE\nPRIMARIES=.64 .33 .3 .6 .15 .06 .3127 .329";
        let (image, _) = decode(&file(lines, "-Y 1 +X 2", &TWO)).expect("reads");
        assert_eq!(image.pixels[0][..3], [1.0, 0.5, 0.25]);
    }

    #[test]
    fn faults_are_named() {
        for (bytes, part) in [
            (&b"#?RADIANCE"[..], "header"),
            (b"#?RADIANCE\nFORMAT=64-bit\n\n-Y 1 +X 1\n", "FORMAT"),
            (b"#?RADIANCE\n\n-Y 1 +Z 1\n....", "-Y 1 +Z 1"),
            (b"#?RADIANCE\n\n-Y 0 +X 1\n....", "size"),
            (
                b"#?RADIANCE\n\n-Y 2 +X 1\n....",
                "expected a complete file of 2 scan lines, found 1",
            ),
            (b"#?RADIANCE\n\n-Y 1 +X 1\n\x01\x01\x01\x01", "complete"),
        ] {
            let message = decode(bytes).expect_err(part).to_string();
            assert!(message.contains(part), "{message}");
        }
    }
}
