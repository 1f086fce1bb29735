//! Records of which only some pictures are wanted, as training wants them.

use super::header::{Header, LightKind};
use super::place::Place;
use super::{file, group, is_file, within};
use half::f16;
use lumi_core::{Camera, Error, LinearImage, NamedLight, Result};
use std::path::{Path, PathBuf};

/// A record whose lights and pictures are read when they are asked for. Opening it reads its description alone.
pub struct RecordReader {
    path: PathBuf,
    header: Header,
    pictures: Pictures,
}

enum Pictures {
    File(file::Pictures),
    Group(Box<group::Pictures>),
}

impl RecordReader {
    /// Opens a record: its cameras are checked, its arrays must be there in the right shapes.
    ///
    /// # Errors
    /// Names the file or group, and the field that is missing or wrong.
    pub fn open(path: &Path) -> Result<Self> {
        let (header, pictures) = if is_file(path) {
            let (header, pictures) = file::Pictures::open(path)?;
            (header, Pictures::File(pictures))
        } else {
            let (header, pictures) = group::Pictures::open(Place::of(path)?)?;
            (header, Pictures::Group(Box::new(pictures)))
        };
        let size = (header.cameras[0].width, header.cameras[0].height);
        for (i, camera) in header.cameras.iter().enumerate() {
            let field = format!("cameras[{i}]");
            let checked = camera.validate().map_err(|e| within(&field, e));
            checked.map_err(|e| e.at(path))?;
            if (camera.width, camera.height) != size {
                let expected = format!("expected {}×{} like the first", size.0, size.1);
                return Err(Error::invalid(path, field, expected));
            }
        }
        Ok(Self {
            path: path.to_owned(),
            header,
            pictures,
        })
    }

    /// The record's name.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.header.name
    }

    /// Where it is.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// One camera per view, all of one size.
    #[must_use]
    pub fn cameras(&self) -> &[Camera] {
        &self.header.cameras
    }

    /// What kinds its lights are.
    pub fn kinds(&self) -> impl ExactSizeIterator<Item = LightKind> {
        self.header.lights.iter().map(|light| light.kind())
    }

    /// Whether its views' base colour is known.
    #[must_use]
    pub fn has_albedo(&self) -> bool {
        match &self.pictures {
            Pictures::File(file) => file.has_albedo(),
            Pictures::Group(group) => group.has_albedo(),
        }
    }

    /// A light, in world space, with its map if it is an environment.
    ///
    /// # Errors
    /// If it cannot be read or has values that no light has.
    ///
    /// # Panics
    /// If the index is out of range.
    pub fn light(&self, index: usize) -> Result<NamedLight> {
        let named = self.header.lights[index]
            .clone()
            .with_map(|name| match &self.pictures {
                Pictures::File(file) => file.map(name),
                Pictures::Group(group) => group.map(name),
            })?;
        let field = format!("lights[{index}] ({})", named.name);
        let checked = named.light.validate().map_err(|e| within(&field, e));
        checked.map_err(|e| e.at(&self.path))?;
        Ok(named)
    }

    /// Linear radiance of one light in one view, premultiplied by alpha, `[y, x, 3]`.
    ///
    /// # Errors
    /// If it cannot be read, or holds values that are negative or not finite.
    pub fn radiance(&self, light: usize, view: usize) -> Result<Vec<f16>> {
        let values = match &self.pictures {
            Pictures::File(file) => file.radiance(light, view)?,
            Pictures::Group(group) => group.radiance(light, view)?,
        };
        self.checked("radiance", values)
    }

    /// Coverage in one view, `[y, x]`.
    ///
    /// # Errors
    /// As [`Self::radiance`].
    pub fn alpha(&self, view: usize) -> Result<Vec<f16>> {
        let values = match &self.pictures {
            Pictures::File(file) => file.alpha(view)?,
            Pictures::Group(group) => group.alpha(view)?,
        };
        self.checked("alpha", values)
    }

    /// Base colour in one view, premultiplied by alpha, `[y, x, 3]`.
    ///
    /// # Errors
    /// As [`Self::radiance`], and if the record has none.
    pub fn albedo(&self, view: usize) -> Result<Vec<f16>> {
        let values = match &self.pictures {
            Pictures::File(file) => file.albedo(view)?,
            Pictures::Group(group) => group.albedo(view)?,
        };
        let missing = || Error::invalid(&self.path, "albedo", "expected this array, found none");
        self.checked("albedo", values.ok_or_else(missing)?)
    }

    fn checked(&self, field: &str, values: Vec<f16>) -> Result<Vec<f16>> {
        let wrong = |v: &&f16| !v.is_finite() || v.to_f32() < 0.0;
        match values.iter().find(wrong) {
            None => Ok(values),
            Some(value) => {
                let expected = format!("expected finite values ≥ 0, found {value}");
                Err(Error::invalid(&self.path, field, expected))
            }
        }
    }
}

/// A view from its coverage `[y, x]` and the sum of pictures `[y, x, 3]`, each with its per-channel gain; all
/// premultiplied. No pictures give black.
#[must_use]
pub fn compose(
    (width, height): (usize, usize),
    alpha: &[f16],
    pictures: &[(&[f16], [f32; 3])],
) -> LinearImage {
    let mut image = LinearImage::new(width, height);
    for (pixel, alpha) in image.pixels.iter_mut().zip(alpha) {
        pixel[3] = alpha.to_f32();
    }
    for &(source, gain) in pictures {
        for (pixel, s) in image.pixels.iter_mut().zip(source.chunks_exact(3)) {
            for c in 0..3 {
                pixel[c] += gain[c] * s[c].to_f32();
            }
        }
    }
    image
}

#[cfg(test)]
mod tests {
    use super::super::ObjectRecord;
    use super::super::tests::record;
    use super::*;

    #[test]
    fn pictures_are_those_of_the_whole_record() {
        let folder = tempfile::tempdir().expect("folder");
        for (name, albedo) in [
            ("a.safetensors", false),
            ("b", true),
            ("c.safetensors", true),
        ] {
            let path = folder.path().join(name);
            let mut whole = record();
            whole.albedo = albedo.then(|| whole.radiance[..2 * 16 * 3].to_vec());
            // Black all over, as a light behind everything leaves it.
            whole.radiance[48..96].fill(f16::ZERO);
            whole.write(&path).expect("written");
            let whole = ObjectRecord::read(&path).expect("read");
            let reader = RecordReader::open(&path).expect("opened");
            assert_eq!(reader.name(), whole.name);
            assert_eq!(reader.cameras(), whole.cameras);
            assert_eq!(reader.has_albedo(), albedo);
            for (l, kind) in reader.kinds().enumerate() {
                let light = reader.light(l).expect("light");
                assert_eq!(format!("{light:?}"), format!("{:?}", whole.lights[l]));
                let name = format!("{kind:?}").to_lowercase();
                assert!(name.starts_with(&whole.lights[l].name[..3]), "{name}");
                for v in 0..2 {
                    let radiance = reader.radiance(l, v).expect("radiance");
                    assert_eq!(radiance, whole.radiance_of(l, v));
                }
            }
            for v in 0..2 {
                assert_eq!(reader.alpha(v).expect("alpha"), whole.alpha_of(v));
                match &whole.albedo {
                    Some(all) => {
                        let albedo = reader.albedo(v).expect("albedo");
                        assert_eq!(albedo, all[v * 48..][..48]);
                    }
                    None => assert!(reader.albedo(v).is_err()),
                }
            }
        }
    }

    #[test]
    fn damage_is_noticed() {
        let folder = tempfile::tempdir().expect("folder");
        let path = folder.path().join("b");
        record().write(&path).expect("written");
        let shard = path.join("radiance/c/0/0/0/0/0");
        let whole = std::fs::read(&shard).expect("one shard holds it all");
        let all = |path: &Path| -> Result<()> {
            let reader = RecordReader::open(path)?;
            for light in 0..reader.kinds().len() {
                for view in 0..reader.cameras().len() {
                    reader.radiance(light, view)?;
                }
            }
            Ok(())
        };
        all(&path).expect("as written");
        for i in 0..whole.len() {
            let mut flipped = whole.clone();
            flipped[i] ^= 0x10;
            std::fs::write(&shard, &flipped).expect("flipped");
            let message = all(&path).expect_err("damaged").to_string();
            assert!(message.contains("radiance"), "{message}");
        }
        // An index that is whole, but says where no picture could be.
        let index = whole.len() - 4 - 16 * record().lights.len() * record().cameras.len();
        for [offset, length] in [
            [0, 1 << 40],
            [u64::MAX - 7, 8],
            [u64::MAX, 1],
            [1 << 62, 60],
            [0, 0],
        ] {
            let mut bent = whole.clone();
            bent[index..][..8].copy_from_slice(&offset.to_le_bytes());
            bent[index + 8..][..8].copy_from_slice(&length.to_le_bytes());
            let end = bent.len() - 4;
            let sum = crc32c::crc32c(&bent[index..end]);
            bent[end..].copy_from_slice(&sum.to_le_bytes());
            std::fs::write(&shard, &bent).expect("bent");
            let message = all(&path).expect_err("bent").to_string();
            assert!(message.contains("radiance"), "{message}");
        }
        std::fs::remove_file(&shard).expect("removed");
        let message = all(&path).expect_err("missing").to_string();
        assert!(message.contains("radiance"), "{message}");

        let path = folder.path().join("a.safetensors");
        record().write(&path).expect("written");
        let whole = std::fs::read(&path).expect("file");
        for length in [4, 100, whole.len() / 2, whole.len() - 1] {
            std::fs::write(&path, &whole[..length]).expect("cut");
            let message = all(&path).expect_err("cut").to_string();
            assert!(message.contains("a.safetensors"), "{message}");
        }
    }
}
