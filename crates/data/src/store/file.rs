//! A record as one safetensors file, whose metadata hold the header.

mod pictures;

pub(super) use pictures::Pictures;

use super::header::{self, Header};
use super::{ENVIRONMENT_ROWS, ObjectRecord};
use half::f16;
use lumi_core::{Error, Light, Result};
use safetensors::{Dtype, SafeTensors, tensor::TensorView};
use std::borrow::Cow;
use std::collections::HashMap;
use std::path::Path;

/// Key of the JSON header in the file's metadata.
const HEADER_KEY: &str = "lumi.light_basis";

/// Writes a valid record; the file is there under its name only once it is complete.
pub(super) fn write(record: &ObjectRecord, path: &Path) -> Result<()> {
    let (width, height) = record.size();
    let (lights, views) = (record.lights.len(), record.cameras.len());
    let mut tensors = vec![
        Tensor::new(
            "radiance",
            vec![lights, views, height, width, 3],
            Cow::Borrowed(&record.radiance),
        ),
        Tensor::new(
            "alpha",
            vec![views, height, width],
            Cow::Borrowed(&record.alpha),
        ),
    ];
    if let Some(albedo) = &record.albedo {
        let shape = vec![views, height, width, 3];
        tensors.push(Tensor::new("albedo", shape, Cow::Borrowed(albedo)));
    }
    for light in &record.lights {
        if let Light::Environment(l) = &light.light {
            let map = l.map.at_most(ENVIRONMENT_ROWS);
            let shape = vec![map.height, map.width, 3];
            let values = Cow::Owned(header::halves(&map));
            tensors.push(Tensor::new(&environment_key(&light.name), shape, values));
        }
    }
    let invalid =
        |field: &str, e: &dyn std::fmt::Display| Error::invalid(path, field, e.to_string());
    let json = serde_json::to_string(&Header::new(record)).map_err(|e| invalid("header", &e))?;
    let metadata = HashMap::from([(HEADER_KEY.to_owned(), json)]);
    let views = tensors
        .iter()
        .map(Tensor::view)
        .collect::<std::result::Result<Vec<_>, _>>()
        .map_err(|e| invalid("tensors", &e))?;
    let bytes =
        safetensors::serialize(views, Some(metadata)).map_err(|e| invalid("tensors", &e))?;
    lumi_core::fs::atomic_write(path, &bytes)
}

/// Reads a record, which is not validated yet.
pub(super) fn read(path: &Path) -> Result<ObjectRecord> {
    parse(path, &lumi_core::fs::read_bytes(path)?)
}

/// The record in the bytes of a file; nothing is allocated that the bytes do not hold.
pub(super) fn parse(path: &Path, bytes: &[u8]) -> Result<ObjectRecord> {
    let invalid =
        |field: &str, e: &dyn std::fmt::Display| Error::invalid(path, field, e.to_string());
    let (_, metadata) =
        SafeTensors::read_metadata(bytes).map_err(|e| invalid("safetensors header", &e))?;
    let tensors = SafeTensors::deserialize(bytes).map_err(|e| invalid("tensors", &e))?;
    let json = metadata
        .metadata()
        .as_ref()
        .and_then(|m| m.get(HEADER_KEY))
        .ok_or_else(|| invalid(HEADER_KEY, &"expected this key in the metadata, found none"))?;
    let header: Header = serde_json::from_str(json).map_err(|e| invalid(HEADER_KEY, &e))?;
    let (width, height) = header.check().map_err(|e| e.at(path))?;
    let (lights, views) = (header.lights.len(), header.cameras.len());
    let shape = [lights, views, height, width, 3];
    let radiance = halves(path, &tensors, "radiance", &shape)?;
    let alpha = halves(path, &tensors, "alpha", &shape[1..4])?;
    let albedo = match tensors.tensor("albedo") {
        Ok(_) => Some(halves(path, &tensors, "albedo", &shape[1..])?),
        Err(_) => None,
    };
    let mut named = Vec::with_capacity(lights);
    for light in header.lights {
        let map = |name: &str| {
            let key = environment_key(name);
            let tensor = tensors.tensor(&key).map_err(|e| invalid(&key, &e))?;
            let &[height, width, 3] = tensor.shape() else {
                let expected = format!("expected [rows, columns, 3], found {:?}", tensor.shape());
                return Err(invalid(&key, &expected));
            };
            let values = halves(path, &tensors, &key, &[height, width, 3])?;
            Ok(header::map(height, width, &values))
        };
        named.push(light.with_map(map)?);
    }
    Ok(ObjectRecord {
        name: header.name,
        cameras: header.cameras,
        lights: named,
        radiance,
        alpha,
        albedo,
    })
}

fn environment_key(light: &str) -> String {
    format!("environment.{light}")
}

/// The half floats of tensor `key`, which must have this shape.
fn halves(path: &Path, tensors: &SafeTensors<'_>, key: &str, shape: &[usize]) -> Result<Vec<f16>> {
    let tensor = tensors
        .tensor(key)
        .map_err(|e| Error::invalid(path, key, e.to_string()))?;
    if tensor.dtype() != Dtype::F16 || tensor.shape() != shape {
        let expected = format!(
            "expected F16 {shape:?}, found {:?} {:?}",
            tensor.dtype(),
            tensor.shape()
        );
        return Err(Error::invalid(path, key, expected));
    }
    let values = tensor.data().chunks_exact(2);
    Ok(values.map(|b| f16::from_le_bytes([b[0], b[1]])).collect())
}

/// A tensor on its way to disk, as little-endian bytes.
struct Tensor {
    name: String,
    shape: Vec<usize>,
    bytes: Vec<u8>,
}

impl Tensor {
    fn new(name: &str, shape: Vec<usize>, values: Cow<'_, [f16]>) -> Self {
        Self {
            name: name.to_owned(),
            shape,
            bytes: values.iter().flat_map(|v| v.to_le_bytes()).collect(),
        }
    }

    fn view(&self) -> std::result::Result<(&str, TensorView<'_>), safetensors::SafeTensorError> {
        let view = TensorView::new(Dtype::F16, self.shape.clone(), &self.bytes)?;
        Ok((&self.name, view))
    }
}
