//! OpenEXR through the `exr` crate: the first layer with R, G, B and optionally A.

use super::LinearImage;
use super::io::{check_plausible, check_size};
use crate::{Error, Result};
use exr::prelude::*;
use half::f16;
use std::io::Cursor;
use std::path::Path;

/// The image, and whether the file has an alpha channel. Values are not checked here.
pub(super) fn decode(path: &Path, bytes: &[u8]) -> Result<(LinearImage, bool)> {
    let bad = |e: exr::error::Error| {
        Error::invalid(
            path,
            "EXR",
            format!("expected a complete OpenEXR file with channels R, G, B; {e}"),
        )
    };
    // Sizes come first: decoding allocates what the header asks for.
    let meta = MetaData::read_from_buffered(Cursor::new(bytes), false).map_err(bad)?;
    let mut has_alpha = false;
    for header in &meta.headers {
        let size = header.layer_size;
        check_size(
            size.width(),
            size.height(),
            size.width().saturating_mul(size.height()),
        )
        .and_then(|()| check_plausible(size.width(), size.height(), bytes.len()))
        .map_err(|e| e.at(path))?;
        has_alpha |= header.channels.list.iter().any(|c| c.name == *"A");
    }
    let image = read()
        .no_deep_data()
        .largest_resolution_level()
        .rgba_channels(
            |size, _| LinearImage::new(size.width(), size.height()),
            |image: &mut LinearImage, at, (r, g, b, a): (f32, f32, f32, f32)| {
                image.pixels[at.y() * image.width + at.x()] = [r, g, b, a];
            },
        )
        .first_valid_layer()
        .all_attributes()
        .non_parallel()
        .from_buffered(Cursor::new(bytes))
        .map_err(bad)?;
    Ok((image.layer_data.channel_data.pixels, has_alpha))
}

/// A half-float RGBA file with ZIP compression.
pub(super) fn encode(image: &LinearImage) -> Result<Vec<u8>> {
    let half = |v: f32| f16::from_f32(v.clamp(-f32::from(f16::MAX), f32::from(f16::MAX)));
    let channels = SpecificChannels::rgba(|at: Vec2<usize>| {
        let [r, g, b, a] = image.pixels[at.y() * image.width + at.x()].map(half);
        (r, g, b, a)
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
