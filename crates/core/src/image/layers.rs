//! Multilayer OpenEXR: pictures of one view in one file, as compositors take light groups.

use super::LinearImage;
use crate::{Error, Result};
use exr::prelude::*;
use std::path::Path;

/// Writes pictures of one view as layers of one file: channels `NAME.R`, `NAME.G`, `NAME.B` of each (32-bit floats,
/// premultiplied), and `A`, the first one's alpha. Atomic.
///
/// # Errors
/// If there is none, sizes differ, a name is empty or not unique, or the file cannot be written.
pub fn write_layers(path: impl AsRef<Path>, layers: &[(&str, LinearImage)]) -> Result<()> {
    let path = path.as_ref();
    let wrong = |expected: String| Err(Error::invalid(path, "layers", expected));
    let Some((_, first)) = layers.first() else {
        return wrong("expected at least one".into());
    };
    let size = (first.width, first.height);
    let mut channels = SmallVec::<[AnyChannel<FlatSamples>; 4]>::new();
    let mut put = |name: &str, image: &LinearImage, c: usize| {
        let values = image.pixels.iter().map(|pixel| pixel[c]).collect();
        channels.push(AnyChannel::new(name, FlatSamples::F32(values)));
    };
    put("A", first, 3);
    for (i, (name, image)) in layers.iter().enumerate() {
        if (image.width, image.height) != size {
            let (w, h) = (image.width, image.height);
            return wrong(format!(
                "expected {}×{} as the first, found {w}×{h} for `{name}`",
                size.0, size.1
            ));
        }
        if name.is_empty() || layers[..i].iter().any(|(other, _)| other == name) {
            return wrong(format!(
                "expected names that tell layers apart, found `{name}`"
            ));
        }
        for (c, letter) in ["R", "G", "B"].into_iter().enumerate() {
            put(&format!("{name}.{letter}"), image, c);
        }
    }
    let layer = Layer::new(
        size,
        LayerAttributes::default(),
        Encoding::SMALL_LOSSLESS,
        AnyChannels::sort(channels),
    );
    let image = Image::from_layer(layer);
    crate::fs::atomic_file(path, |temporary| {
        image
            .write()
            .non_parallel()
            .to_file(temporary)
            .map_err(std::io::Error::other)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_light_has_its_layer() {
        let folder = tempfile::tempdir().expect("folder");
        let path = folder.path().join("view.exr");
        let image = |value: f32| LinearImage {
            width: 2,
            height: 1,
            pixels: vec![[value, 2.0 * value, 3.0 * value, 0.5], [0.0, 0.0, 7e4, 1.0]],
        };
        write_layers(&path, &[("captured", image(1.0)), ("1-point", image(5.0))]).expect("written");
        let read = read_first_flat_layer_from_file(&path).expect("read");
        let channels = &read.layer_data.channel_data.list;
        let names: Vec<String> = channels.iter().map(|c| c.name.to_string()).collect();
        let expected = [
            "1-point.B",
            "1-point.G",
            "1-point.R",
            "A",
            "captured.B",
            "captured.G",
            "captured.R",
        ];
        assert_eq!(names, expected);
        let values = |i: usize| channels[i].sample_data.values_as_f32().collect::<Vec<_>>();
        assert_eq!(values(2), [5.0, 0.0]);
        assert_eq!(values(4), [3.0, 7e4]);
        assert_eq!(values(3), [0.5, 1.0]);
        let twice = [("a", image(1.0)), ("a", image(2.0))];
        let error = write_layers(&path, &twice)
            .expect_err("one name for two")
            .to_string();
        assert!(error.contains("`a`"), "{error}");
    }
}
