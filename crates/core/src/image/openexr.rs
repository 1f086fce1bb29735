//! OpenEXR through the `exr` crate: the part and layer that is the picture, placed where the file says.
//!
//! * The picture fills the display window; the data window is where its pixels are known. Outside is black, and
//!   transparent where the file has alpha.
//! * Which channels are the picture is for [`super::exr_layers`] to choose.
//! * `chromaticities` other than Rec. 709's are converted.

use super::LinearImage;
use super::exr_layers::{Channel, choose};
use super::io::{check_plausible, check_size};
use super::primaries::{Primaries, convert};
use crate::{Error, Result};
use exr::block::reader::ChunksReader;
use exr::error::Error::NotSupported;
use exr::meta::attribute::Chromaticities;
use exr::meta::header::Header;
use exr::prelude::*;
use half::f16;
use std::io::Cursor;
use std::path::Path;

/// A display window of up to this many pixels needs no data that justify it: a crop may be small in it.
const SMALL_WINDOW: usize = 4096 * 4096;

/// A decoded file.
pub(super) struct Decoded {
    pub image: LinearImage,
    /// Whether the file has an alpha channel.
    pub has_alpha: bool,
    pub warnings: Vec<String>,
}

/// Reads the picture of a file. Values are not checked here.
pub(super) fn decode(path: &Path, bytes: &[u8]) -> Result<Decoded> {
    let bad = |e: exr::error::Error| {
        let expected = match e {
            // Of a whole file, which is worth saying: another program can convert it.
            NotSupported(what) => format!("this kind of OpenEXR file is not read: {what}"),
            e => format!("expected a complete OpenEXR file with channels R, G, B; {e}"),
        };
        Error::invalid(path, "EXR", expected)
    };
    let reader = exr::block::read(Cursor::new(bytes), false).map_err(bad)?;
    let chosen = choose(reader.headers()).map_err(|e| e.at(path))?;
    let mut warnings = chosen.warnings;
    let window = reader.headers()[chosen.color[0].part]
        .shared_attributes
        .display_window;
    let headers: Vec<&Header> = chosen
        .color
        .iter()
        .chain(&chosen.alpha)
        .map(|c| &reader.headers()[c.part])
        .collect();
    // Sizes come first: decoding allocates what the header asks for.
    check_window(window, &headers, bytes.len()).map_err(|e| e.at(path))?;
    if let Some(aspect) = odd_aspect(headers[0]) {
        warnings.push(format!(
            "pixelAspectRatio {aspect}: not applied, pixels are taken as square"
        ));
    }
    let chromaticities = headers[0]
        .shared_attributes
        .chromaticities
        .as_ref()
        .map(primaries);
    let mut image = LinearImage::new(window.size.width(), window.size.height());
    if chosen.alpha.is_none() {
        image.pixels.iter_mut().for_each(|p| p[3] = 1.0);
    }
    let slots: Vec<(Channel, usize)> = chosen
        .color
        .into_iter()
        .chain(chosen.alpha)
        .zip(0..)
        .collect();
    let expected: usize = headers.iter().map(|h| h.layer_size.area()).sum();
    let read = fill(&mut image, window.position, reader, &slots).map_err(bad)?;
    if read != expected {
        let text = format!("expected a complete OpenEXR file of {expected} samples, found {read}");
        return Err(Error::invalid(path, "EXR", text));
    }
    match chromaticities.map(Primaries::to_rec_709) {
        Some(Ok(Some(matrix))) => warnings.extend(convert(&mut image, &matrix)),
        Some(Err(())) => {
            let text = "chromaticities: expected three colours around a white; ignored";
            warnings.push(text.to_owned());
        }
        None | Some(Ok(None)) => {}
    }
    Ok(Decoded {
        image,
        has_alpha: chosen.alpha.is_some(),
        warnings,
    })
}

/// Width and height of the display window or of the largest part, whichever has more pixels.
pub(super) fn size(bytes: &[u8]) -> Option<(usize, usize)> {
    let meta = MetaData::read_from_buffered(Cursor::new(bytes), false).ok()?;
    let parts = meta.headers.iter().map(|h| h.layer_size);
    let window = meta.headers.first()?.shared_attributes.display_window;
    let sizes = parts.chain([window.size]);
    let largest = sizes.max_by_key(|s| s.width().saturating_mul(s.height()))?;
    Some((largest.width(), largest.height()))
}

fn check_window(window: IntegerBounds, headers: &[&Header], bytes: usize) -> Result<()> {
    let (width, height) = (window.size.width(), window.size.height());
    let area = width.saturating_mul(height);
    check_size(width, height, area).map_err(|e| e.within("display window"))?;
    if area > SMALL_WINDOW {
        check_plausible(width, height, bytes)?;
    }
    for header in headers {
        let size = header.layer_size;
        let area = size.width().saturating_mul(size.height());
        check_size(size.width(), size.height(), area)?;
        check_plausible(size.width(), size.height(), bytes)?;
        // First pixel and the one after the last, from the left or from the top.
        let range = |at: i32, length: usize| (i64::from(at), i64::from(at) + length as i64);
        let data = header.data_window();
        let apart = [
            (
                range(window.position.x(), width),
                range(data.position.x(), size.width()),
            ),
            (
                range(window.position.y(), height),
                range(data.position.y(), size.height()),
            ),
        ]
        .iter()
        .any(|(a, b)| a.0.max(b.0) >= a.1.min(b.1));
        if apart {
            let expected =
                format!("expected pixels inside the display window {window:?}, found {data:?}");
            return Err(Error::value("data window", expected));
        }
    }
    Ok(())
}

fn odd_aspect(header: &Header) -> Option<f32> {
    let aspect = header.shared_attributes.pixel_aspect;
    ((aspect - 1.0).abs() > 1e-3).then_some(aspect)
}

fn primaries(c: &Chromaticities) -> Primaries {
    let [r, g, b, w] =
        [c.red, c.green, c.blue, c.white].map(|v| [f64::from(v.x()), f64::from(v.y())]);
    Primaries::new([r[0], r[1], g[0], g[1], b[0], b[1], w[0], w[1]])
}

/// Reads each channel into its place of the pixels, and nothing else of the file. The display window begins at
/// `origin`. Returns how many samples there were.
fn fill(
    image: &mut LinearImage,
    origin: Vec2<i32>,
    reader: exr::block::reader::Reader<Cursor<&[u8]>>,
    slots: &[(Channel, usize)],
) -> exr::error::Result<usize> {
    let part = |layer| slots.iter().any(|(c, _)| c.part == layer);
    let chunks = reader.filter_chunks(false, |_, _, block| {
        part(block.layer) && block.level == Vec2(0, 0)
    })?;
    let (width, height) = (image.width as i64, image.height as i64);
    let mut count = 0;
    let mut samples = Vec::new();
    chunks.decompress_sequential(false, |meta, block| {
        let header = &meta.headers[block.index.layer];
        let corner = header.own_attributes.layer_position;
        for line in block.lines(&header.channels) {
            let at = line.location;
            let here = |c: &Channel| c.part == at.layer && c.index == at.channel;
            // A grey channel fills three places.
            let places: Vec<usize> = slots.iter().filter(|(c, _)| here(c)).map(|s| s.1).collect();
            if places.is_empty() {
                continue;
            }
            samples.clear();
            match header.channels.list[at.channel].sample_type {
                SampleType::F16 => {
                    for v in line.read_samples::<f16>() {
                        samples.push(v?.to_f32());
                    }
                }
                SampleType::F32 => {
                    for v in line.read_samples::<f32>() {
                        samples.push(v?);
                    }
                }
                SampleType::U32 => return Err(NotSupported("integer colours".into())),
            }
            count += samples.len() * places.len();
            let y = at.position.y() as i64 + i64::from(corner.y()) - i64::from(origin.y());
            if !(0..height).contains(&y) {
                continue;
            }
            let left = at.position.x() as i64 + i64::from(corner.x()) - i64::from(origin.x());
            for (x, value) in (left..).zip(&samples) {
                if (0..width).contains(&x) {
                    let pixel = &mut image.pixels[(y * width + x) as usize];
                    places.iter().for_each(|slot| pixel[*slot] = *value);
                }
            }
        }
        Ok(())
    })?;
    Ok(count)
}

/// An RGBA file with ZIP compression: half floats, or whole ones where a value lies beyond them.
pub(super) fn encode(image: &LinearImage) -> Result<Vec<u8>> {
    let beyond = |v: &f32| v.abs() > f32::from(f16::MAX);
    if image.pixels.as_flattened().iter().any(beyond) {
        encode_as(image, |v| v)
    } else {
        encode_as(image, f16::from_f32)
    }
}

fn encode_as<T>(image: &LinearImage, sample: impl Fn(f32) -> T + Sync) -> Result<Vec<u8>>
where
    T: IntoSample,
{
    let channels = SpecificChannels::rgba(|at: Vec2<usize>| {
        let [r, g, b, a] = image.pixels[at.y() * image.width + at.x()];
        (sample(r), sample(g), sample(b), sample(a))
    });
    let size = (image.width, image.height);
    let layer = Layer::new(
        size,
        LayerAttributes::default(),
        Encoding::SMALL_LOSSLESS,
        channels,
    );
    let mut file = Cursor::new(Vec::new());
    Image::from_layer(layer)
        .write()
        .non_parallel()
        .to_buffered(&mut file)
        .map_err(|e| Error::value("EXR", format!("could not be encoded: {e}")))?;
    Ok(file.into_inner())
}
