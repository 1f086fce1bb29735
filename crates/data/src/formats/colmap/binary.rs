//! `cameras.bin` and `images.bin`: little-endian, each a count and then as many records.

use super::{CameraModel, Model, ModelCamera, ModelImage};
use lumi_core::fs::read_bytes;
use lumi_core::{Error, Result};
use std::collections::BTreeMap;
use std::path::Path;

/// Bytes of one observed point of an image, which are skipped: x, y and the id of its 3D point.
const POINT: u64 = 24;

pub(super) fn read(cameras: &Path, images: &Path) -> Result<Model> {
    Ok(Model {
        cameras: parse_cameras(&read_bytes(cameras)?).map_err(|e| e.at(cameras))?,
        images: parse_images(&read_bytes(images)?).map_err(|e| e.at(images))?,
    })
}

/// Camera id, model, width, height and parameters of each camera.
pub(crate) fn parse_cameras(bytes: &[u8]) -> Result<BTreeMap<u32, ModelCamera>> {
    let mut reader = Reader { bytes, at: 0 };
    let mut cameras = BTreeMap::new();
    // The stated count only bounds the loop; every record must be there in full.
    for i in 0..reader.u64()? {
        let at = |e: Error| e.within(format!("camera {i}"));
        let id = reader.u32().map_err(at)?;
        let number = reader.u32().map_err(at)?;
        let model = CameraModel::by_number(number).map_err(at)?;
        let (width, height) = (reader.u64().map_err(at)?, reader.u64().map_err(at)?);
        let params = (0..model.parameters()).map(|_| reader.f64());
        let params = params.collect::<Result<_>>().map_err(at)?;
        let camera = ModelCamera {
            model,
            width,
            height,
            params,
        };
        if cameras.insert(id, camera).is_some() {
            return Err(at(Error::value("camera id", "expected ids that differ")));
        }
    }
    reader.end()?;
    Ok(cameras)
}

/// Image id, quaternion, translation, camera id, name and points of each image.
pub(crate) fn parse_images(bytes: &[u8]) -> Result<Vec<ModelImage>> {
    let mut reader = Reader { bytes, at: 0 };
    let mut images = Vec::new();
    for i in 0..reader.u64()? {
        let image = reader.image();
        images.push(image.map_err(|e| e.within(format!("image {i}")))?);
    }
    reader.end()?;
    Ok(images)
}

/// A place in the bytes of a file.
struct Reader<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl Reader<'_> {
    fn image(&mut self) -> Result<ModelImage> {
        let _id = self.u32()?;
        let rotation = [self.f64()?, self.f64()?, self.f64()?, self.f64()?];
        let translation = [self.f64()?, self.f64()?, self.f64()?];
        let camera = self.u32()?;
        let name = self.name()?;
        let points = self.u64()?;
        let length = points
            .checked_mul(POINT)
            .and_then(|n| usize::try_from(n).ok());
        self.skip(length.ok_or_else(|| self.cut())?)?;
        Ok(ModelImage {
            rotation,
            translation,
            camera,
            name,
        })
    }

    /// Bytes up to a zero.
    fn name(&mut self) -> Result<String> {
        let rest = &self.bytes[self.at..];
        let length = rest
            .iter()
            .position(|b| *b == 0)
            .ok_or_else(|| self.cut())?;
        let name = std::str::from_utf8(&rest[..length]);
        let name = name
            .map_err(|_| Error::value("name", "expected UTF-8"))?
            .to_owned();
        self.at += length + 1;
        Ok(name)
    }

    fn skip(&mut self, length: usize) -> Result<&[u8]> {
        let end = self
            .at
            .checked_add(length)
            .filter(|e| *e <= self.bytes.len());
        let end = end.ok_or_else(|| self.cut())?;
        let skipped = &self.bytes[self.at..end];
        self.at = end;
        Ok(skipped)
    }

    fn array<const N: usize>(&mut self) -> Result<[u8; N]> {
        let mut out = [0; N];
        out.copy_from_slice(self.skip(N)?);
        Ok(out)
    }

    fn u32(&mut self) -> Result<u32> {
        Ok(u32::from_le_bytes(self.array()?))
    }

    fn u64(&mut self) -> Result<u64> {
        Ok(u64::from_le_bytes(self.array()?))
    }

    fn f64(&mut self) -> Result<f64> {
        Ok(f64::from_le_bytes(self.array()?))
    }

    fn cut(&self) -> Error {
        let expected = format!("expected more than {} bytes", self.bytes.len());
        Error::value(format!("byte {}", self.at), expected)
    }

    fn end(&self) -> Result<()> {
        if self.at == self.bytes.len() {
            return Ok(());
        }
        let rest = self.bytes.len() - self.at;
        let expected = format!("expected the end of the file, found {rest} more bytes");
        Err(Error::value(format!("byte {}", self.at), expected))
    }
}
