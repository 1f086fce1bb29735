//! Single pictures of a record, without the rest of its file.

use super::{HEADER_KEY, Header, environment_key};
use crate::store::header;
use half::f16;
use lumi_core::{EnvMap, Error, Result};
use safetensors::Dtype;
use safetensors::tensor::{Metadata, TensorInfo};
use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

/// Most bytes that a file's own description may have.
const LARGEST_HEADER: u64 = 64 << 20;

/// Where a file has what. It is opened for every picture, since nobody may hold thousands of open files.
pub(in crate::store) struct Pictures {
    path: PathBuf,
    tensors: Metadata,
    /// Where tensors begin.
    start: u64,
    /// Values of one picture of one channel.
    pixels: usize,
    views: usize,
}

impl Pictures {
    /// Reads what describes a record, and checks that its arrays are as that says.
    pub fn open(path: &Path) -> Result<(Header, Self)> {
        let io = |e| Error::io(path, e);
        let invalid =
            |field: &str, e: &dyn std::fmt::Display| Error::invalid(path, field, e.to_string());
        let mut file = File::open(path).map_err(io)?;
        let length = file.metadata().map_err(io)?.len();
        let mut size = [0; 8];
        file.read_exact(&mut size).map_err(io)?;
        let size = u64::from_le_bytes(size);
        if size > LARGEST_HEADER.min(length.saturating_sub(8)) {
            let expected = format!("expected a header within the file, found {size} bytes");
            return Err(invalid("safetensors header", &expected));
        }
        let mut bytes = Vec::new();
        file.take(size).read_to_end(&mut bytes).map_err(io)?;
        // Checks that the tensors' bytes follow each other and are as many as their shapes say.
        let tensors: Metadata =
            serde_json::from_slice(&bytes).map_err(|e| invalid("safetensors header", &e))?;
        let json = tensors.metadata().as_ref().and_then(|m| m.get(HEADER_KEY));
        let json = json
            .ok_or_else(|| invalid(HEADER_KEY, &"expected this key in the metadata, found none"))?;
        let header: Header = serde_json::from_str(json).map_err(|e| invalid(HEADER_KEY, &e))?;
        let (width, height) = header.check().map_err(|e| e.at(path))?;
        let (lights, views) = (header.lights.len(), header.cameras.len());
        let pictures = Self {
            path: path.to_owned(),
            start: 8 + size,
            pixels: width * height,
            views,
            tensors,
        };
        let shape = [lights, views, height, width, 3];
        pictures.info("radiance", &shape)?;
        pictures.info("alpha", &shape[1..4])?;
        if pictures.has_albedo() {
            pictures.info("albedo", &shape[1..])?;
        }
        let ends = pictures.tensors.tensors();
        let end = ends.values().map(|t| t.data_offsets.1).max().unwrap_or(0);
        if length != pictures.start + end as u64 {
            let expected = format!(
                "expected {} bytes, found {length}",
                pictures.start + end as u64
            );
            return Err(invalid("tensors", &expected));
        }
        Ok((header, pictures))
    }

    pub fn has_albedo(&self) -> bool {
        self.tensors.info("albedo").is_some()
    }

    pub fn radiance(&self, light: usize, view: usize) -> Result<Vec<f16>> {
        self.read("radiance", light * self.views + view, self.pixels * 3)
    }

    pub fn alpha(&self, view: usize) -> Result<Vec<f16>> {
        self.read("alpha", view, self.pixels)
    }

    /// `None` if the record has none.
    pub fn albedo(&self, view: usize) -> Result<Option<Vec<f16>>> {
        let read = || self.read("albedo", view, self.pixels * 3);
        self.has_albedo().then(read).transpose()
    }

    pub fn map(&self, light: &str) -> Result<EnvMap> {
        let key = environment_key(light);
        let shape = self.tensors.info(&key).map(|t| t.shape.clone());
        let Some(&[height, width, 3]) = shape.as_deref() else {
            let expected = format!("expected [rows, columns, 3], found {shape:?}");
            return Err(Error::invalid(&self.path, key, expected));
        };
        self.info(&key, &[height, width, 3])?;
        let values = self.read(&key, 0, height * width * 3)?;
        Ok(header::map(height, width, &values))
    }

    /// Where tensor `key` is, which must have this shape.
    fn info(&self, key: &str, shape: &[usize]) -> Result<&TensorInfo> {
        let found = self.tensors.info(key);
        match found {
            Some(t) if t.dtype == Dtype::F16 && t.shape == shape => Ok(t),
            _ => {
                let found = found.map(|t| (t.dtype, &t.shape));
                let expected = format!("expected F16 {shape:?}, found {found:?}");
                Err(Error::invalid(&self.path, key, expected))
            }
        }
    }

    /// The `number`-th run of `count` values of tensor `key`.
    fn read(&self, key: &str, number: usize, count: usize) -> Result<Vec<f16>> {
        let io = |e| Error::io(&self.path, e);
        let begin = self.tensors.info(key).map_or(0, |t| t.data_offsets.0);
        let offset = self.start + (begin + 2 * number * count) as u64;
        let mut file = File::open(&self.path).map_err(io)?;
        file.seek(SeekFrom::Start(offset)).map_err(io)?;
        let mut bytes = vec![0; 2 * count];
        file.read_exact(&mut bytes).map_err(io)?;
        let values = bytes.chunks_exact(2);
        Ok(values.map(|b| f16::from_le_bytes([b[0], b[1]])).collect())
    }
}
