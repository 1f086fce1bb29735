//! The file of a record: a safetensors file whose metadata hold a JSON header.

use super::{ObjectRecord, VERSION, stored_map, to_half};
use half::f16;
use lumi_core::glam::{Mat3, Vec3};
use lumi_core::{Area, Camera, EnvMap, Environment, Error, Light, NamedLight, Point, Result};
use safetensors::{Dtype, SafeTensors, tensor::TensorView};
use serde::{Deserialize, Serialize};
use std::borrow::Cow;
use std::collections::HashMap;
use std::path::Path;
use std::sync::Arc;

/// Key of the JSON header in the file's metadata.
const HEADER_KEY: &str = "lumi.light_basis";

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Header {
    version: u32,
    name: String,
    cameras: Vec<Camera>,
    lights: Vec<LightHeader>,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct LightHeader {
    name: String,
    light: LightFields,
}

/// A light without its map, whose tensor is `environment.<name>`.
#[derive(Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case", deny_unknown_fields)]
enum LightFields {
    Environment {
        rotation: Mat3,
        strength: [f32; 3],
    },
    Point {
        position: Vec3,
        power: f32,
        color: [f32; 3],
        radius: f32,
    },
    Area {
        position: Vec3,
        direction: Vec3,
        side: Vec3,
        size: f32,
        power: f32,
        color: [f32; 3],
    },
}

impl ObjectRecord {
    /// Writes the record; the file is there under its name only once it is complete.
    ///
    /// # Errors
    /// If the record is not valid or the file cannot be written.
    pub fn write(&self, path: &Path) -> Result<()> {
        self.validate().map_err(|e| e.at(path))?;
        let (width, height) = self.size();
        let (lights, views) = (self.lights.len(), self.cameras.len());
        let mut tensors = vec![
            Tensor::new(
                "radiance",
                vec![lights, views, height, width, 3],
                Cow::Borrowed(&self.radiance),
            ),
            Tensor::new(
                "alpha",
                vec![views, height, width],
                Cow::Borrowed(&self.alpha),
            ),
        ];
        for light in &self.lights {
            if let Light::Environment(l) = &light.light {
                let map = stored_map(&l.map);
                let values = map.pixels.iter().flatten().map(|&v| to_half(v)).collect();
                tensors.push(Tensor::new(
                    &environment_key(&light.name),
                    vec![map.height, map.width, 3],
                    Cow::Owned(values),
                ));
            }
        }
        let header = serde_json::to_string(&self.header())
            .map_err(|e| Error::invalid(path, "header", e.to_string()))?;
        let metadata = HashMap::from([(HEADER_KEY.to_owned(), header)]);
        let views = tensors
            .iter()
            .map(Tensor::view)
            .collect::<std::result::Result<Vec<_>, _>>()
            .map_err(|e| Error::invalid(path, "tensors", e.to_string()))?;
        let bytes = safetensors::serialize(views, Some(metadata))
            .map_err(|e| Error::invalid(path, "tensors", e.to_string()))?;
        lumi_core::fs::atomic_write(path, &bytes)
    }

    /// Reads and checks a record.
    ///
    /// # Errors
    /// Names the file and the field that is missing or wrong.
    pub fn read(path: &Path) -> Result<Self> {
        let bytes = lumi_core::fs::read_bytes(path)?;
        let invalid =
            |field: &str, e: &dyn std::fmt::Display| Error::invalid(path, field, e.to_string());
        let (_, metadata) =
            SafeTensors::read_metadata(&bytes).map_err(|e| invalid("safetensors header", &e))?;
        let tensors = SafeTensors::deserialize(&bytes).map_err(|e| invalid("tensors", &e))?;
        let json = metadata
            .metadata()
            .as_ref()
            .and_then(|m| m.get(HEADER_KEY))
            .ok_or_else(|| invalid(HEADER_KEY, &"expected this key in the metadata, found none"))?;
        let header: Header = serde_json::from_str(json).map_err(|e| invalid(HEADER_KEY, &e))?;
        if header.version != VERSION {
            let expected = format!("expected {VERSION}, found {}", header.version);
            return Err(invalid("version", &expected));
        }
        let first = header
            .cameras
            .first()
            .ok_or_else(|| invalid("cameras", &"expected at least one"))?;
        let (width, height) = (first.width, first.height);
        let (lights, views) = (header.lights.len(), header.cameras.len());
        let radiance = halves(
            path,
            &tensors,
            "radiance",
            &[lights, views, height, width, 3],
        )?;
        let alpha = halves(path, &tensors, "alpha", &[views, height, width])?;
        let mut named = Vec::with_capacity(lights);
        for light in header.lights {
            named.push(light.with_map(path, &tensors)?);
        }
        let record = Self {
            name: header.name,
            cameras: header.cameras,
            lights: named,
            radiance,
            alpha,
        };
        record.validate().map_err(|e| e.at(path))?;
        Ok(record)
    }

    fn header(&self) -> Header {
        Header {
            version: VERSION,
            name: self.name.clone(),
            cameras: self.cameras.clone(),
            lights: self.lights.iter().map(LightHeader::new).collect(),
        }
    }
}

fn environment_key(light: &str) -> String {
    format!("environment.{light}")
}

impl LightHeader {
    fn new(named: &NamedLight) -> Self {
        let light = match &named.light {
            Light::Environment(l) => LightFields::Environment {
                rotation: l.rotation,
                strength: l.strength,
            },
            Light::Point(l) => LightFields::Point {
                position: l.position,
                power: l.power,
                color: l.color,
                radius: l.radius,
            },
            Light::Area(l) => LightFields::Area {
                position: l.position,
                direction: l.direction,
                side: l.side,
                size: l.size,
                power: l.power,
                color: l.color,
            },
        };
        Self {
            name: named.name.clone(),
            light,
        }
    }

    fn with_map(self, path: &Path, tensors: &SafeTensors<'_>) -> Result<NamedLight> {
        let light = match self.light {
            LightFields::Environment { rotation, strength } => {
                let key = environment_key(&self.name);
                let tensor = tensors
                    .tensor(&key)
                    .map_err(|e| Error::invalid(path, &key, e.to_string()))?;
                let &[height, width, 3] = tensor.shape() else {
                    let expected =
                        format!("expected [rows, columns, 3], found {:?}", tensor.shape());
                    return Err(Error::invalid(path, key, expected));
                };
                let values = halves(path, tensors, &key, &[height, width, 3])?;
                let pixels = values
                    .chunks_exact(3)
                    .map(|p| [p[0].to_f32(), p[1].to_f32(), p[2].to_f32()])
                    .collect();
                Light::Environment(Environment {
                    map: Arc::new(EnvMap {
                        width,
                        height,
                        pixels,
                    }),
                    rotation,
                    strength,
                })
            }
            LightFields::Point {
                position,
                power,
                color,
                radius,
            } => Light::Point(Point {
                position,
                power,
                color,
                radius,
            }),
            LightFields::Area {
                position,
                direction,
                side,
                size,
                power,
                color,
            } => Light::Area(Area {
                position,
                direction,
                side,
                size,
                power,
                color,
            }),
        };
        Ok(NamedLight {
            name: self.name,
            light,
        })
    }
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
