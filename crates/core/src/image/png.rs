//! What a PNG says of its colours: `gAMA` and `cHRM` are applied, other profiles are told of.

use super::icc;
use super::primaries::{Primaries, apply};
use crate::color::{srgb_decode, srgb_encode};
use glam::DMat3;
use image::ImageDecoder;
use image::codecs::png::PngDecoder;
use std::io::Cursor;

/// `gAMA` of sRGB's curve, and how far from it values still mean that curve (1/2.2 and its roundings).
const SRGB: [f64; 2] = [0.45455, 0.012];

/// From stored values to ours.
#[derive(Default)]
pub(super) struct Colors {
    /// Light is the stored value to this power, if not sRGB's curve.
    exponent: Option<f32>,
    /// From the file's primaries to Rec. 709.
    matrix: Option<DMat3>,
    pub warnings: Vec<String>,
}

impl Colors {
    /// As the chunks before the pixels say. `cICP`, `iCCP` and `sRGB` go before `gAMA` and `cHRM`, as the standard has it.
    pub fn of(bytes: &[u8]) -> Self {
        let mut colors = Self::default();
        let mut chunks = Vec::new();
        let mut rest = bytes.get(8..).unwrap_or_default();
        while let Some((name, data, after)) = chunk(rest) {
            if name == b"IDAT" {
                break;
            }
            chunks.push((name, data));
            rest = after;
        }
        let find = |name: &[u8; 4]| chunks.iter().find(|(n, _)| *n == name).map(|(_, d)| *d);
        if let Some(data) = find(b"cICP") {
            // Rec. 709's primaries with sRGB's curve; anything else is another space.
            if !data.starts_with(&[1, 13]) {
                let text = format!("cICP {data:?}: not applied, colours are taken as sRGB");
                colors.warnings.push(text);
            }
        } else if find(b"iCCP").is_some() {
            let profile = PngDecoder::new(Cursor::new(bytes)).and_then(|mut d| d.icc_profile());
            let profile = profile.ok().flatten().unwrap_or_default();
            colors.warnings.extend(icc::warning(&profile));
        } else if find(b"sRGB").is_none() {
            if let Some(data) = find(b"gAMA") {
                colors.gamma(data);
            }
            if let Some(data) = find(b"cHRM") {
                colors.primaries(data);
            }
        }
        colors
    }

    fn gamma(&mut self, data: &[u8]) {
        let value = data.first_chunk().map(|b| u32::from_be_bytes(*b));
        let value = f64::from(value.unwrap_or_default()) / 1e5;
        if !(0.1..=2.0).contains(&value) {
            let text = format!("gAMA: expected 0.1 to 2, found {value}; colours are taken as sRGB");
            self.warnings.push(text);
        } else if (value - SRGB[0]).abs() > SRGB[1] {
            self.exponent = Some((1.0 / value) as f32);
        }
    }

    fn primaries(&mut self, data: &[u8]) {
        let numbers = data.as_chunks::<4>().0.iter();
        let numbers: Vec<f64> = numbers
            .map(|b| f64::from(u32::from_be_bytes(*b)) / 1e5)
            .collect();
        let matrix = <[f64; 8]>::try_from(numbers)
            .map_err(|_| ())
            // White comes first here, last elsewhere.
            .map(|[wx, wy, rx, ry, gx, gy, bx, by]| {
                Primaries::new([rx, ry, gx, gy, bx, by, wx, wy])
            })
            .and_then(Primaries::to_rec_709);
        match matrix {
            Ok(matrix) => self.matrix = matrix,
            Err(()) => {
                let text = "cHRM: expected three colours around a white; ignored";
                self.warnings.push(text.to_owned());
            }
        }
    }

    /// sRGB of a stored colour.
    pub fn shown(&self, stored: [f32; 3]) -> [f32; 3] {
        if self.exponent.is_none() && self.matrix.is_none() {
            return stored;
        }
        let light = stored.map(|v| match self.exponent {
            Some(exponent) => v.powf(exponent),
            None => srgb_decode(v),
        });
        let light = self.matrix.as_ref().map_or(light, |m| apply(m, light));
        light.map(srgb_encode)
    }
}

/// The first chunk's name and data, and what follows it.
fn chunk(bytes: &[u8]) -> Option<(&[u8; 4], &[u8], &[u8])> {
    let (length, rest) = bytes.split_first_chunk::<4>()?;
    let (name, rest) = rest.split_first_chunk::<4>()?;
    let length = u32::from_be_bytes(*length) as usize;
    let (data, rest) = rest.split_at_checked(length)?;
    Some((name, data, rest.get(4..)?))
}
