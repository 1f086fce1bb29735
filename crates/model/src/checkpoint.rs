//! Weights files: our safetensors with config and provenance in the metadata.

use crate::params::{self, NamedTensor};
use crate::{Error, ModelConfig, Network, Result};
use burn::tensor::Device;
use half::{bf16, f16};
use safetensors::tensor::{Dtype, TensorView};
use serde::{Deserialize, Serialize};
use std::borrow::Cow;
use std::collections::{BTreeMap, HashMap};
use std::path::Path;

/// Version of our weights files.
const FORMAT: &str = "lumitokens-1";

/// Where weights came from; free text, shown by `lumi` and kept through conversions.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Provenance {
    /// How they were made: imported from, or trained by.
    pub origin: String,
    /// Training steps of each stage, in order.
    pub steps: Vec<u64>,
    /// Data they were trained on.
    pub data: String,
    /// Licence, where one was stated.
    pub licence: String,
}

/// Element type of stored weights.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Storage {
    /// 4 bytes, exact.
    F32,
    /// 2 bytes.
    Bf16,
}

/// A tensor that is read when asked for.
pub trait LazyTensor {
    /// Shape.
    fn shape(&self) -> &[usize];
    /// Values as f32, row-major.
    ///
    /// # Errors
    /// If the file disagrees with itself or cannot be read.
    fn read(&self) -> Result<Vec<f32>>;
}

/// Writes a network; the file appears complete or not at all.
///
/// # Errors
/// If the file cannot be written.
pub fn save(
    path: &Path,
    network: &Network,
    config: &ModelConfig,
    provenance: &Provenance,
    storage: Storage,
) -> Result<()> {
    write(path, params::export(network), config, provenance, storage)
}

/// Writes named tensors as a weights file; atomic.
///
/// # Errors
/// If the file cannot be written.
pub fn write(
    path: &Path,
    tensors: Vec<NamedTensor>,
    config: &ModelConfig,
    provenance: &Provenance,
    storage: Storage,
) -> Result<()> {
    struct Stored(NamedTensor, Storage);
    impl safetensors::View for Stored {
        fn dtype(&self) -> Dtype {
            match self.1 {
                Storage::F32 => Dtype::F32,
                Storage::Bf16 => Dtype::BF16,
            }
        }
        fn shape(&self) -> &[usize] {
            &self.0.shape
        }
        fn data(&self) -> Cow<'_, [u8]> {
            Cow::Owned(match self.1 {
                Storage::F32 => self.0.values.iter().flat_map(|v| v.to_le_bytes()).collect(),
                Storage::Bf16 => self
                    .0
                    .values
                    .iter()
                    .flat_map(|v| bf16::from_f32(*v).to_le_bytes())
                    .collect(),
            })
        }
        fn data_len(&self) -> usize {
            self.0.values.len() * if self.1 == Storage::F32 { 4 } else { 2 }
        }
    }
    let text = |value: serde_json::Result<String>| {
        value.map_err(|e| Error::Unsupported(format!("metadata cannot be written: {e}")))
    };
    let metadata = HashMap::from([
        ("format".to_owned(), FORMAT.to_owned()),
        ("config".to_owned(), text(serde_json::to_string(config))?),
        (
            "provenance".to_owned(),
            text(serde_json::to_string(provenance))?,
        ),
    ]);
    let views = tensors
        .into_iter()
        .map(|t| (t.name.clone(), Stored(t, storage)));
    let bytes = safetensors::serialize(views, Some(metadata))
        .map_err(|e| Error::weights(path, "(all)", e.to_string()))?;
    lumi_core::fs::atomic_write(path, &bytes)?;
    Ok(())
}

/// Whether the file is one of ours, told by its metadata alone.
///
/// # Errors
/// If it cannot be read.
pub fn is_ours(path: &Path) -> Result<bool> {
    use std::io::Read;
    let io = |e| lumi_core::Error::io(path, e);
    let mut file = std::fs::File::open(path).map_err(io)?;
    let mut head = vec![0; 4096];
    let read = file.read(&mut head).map_err(io)?;
    let text = String::from_utf8_lossy(&head[..read]).into_owned();
    Ok(text.contains(&format!("\"{FORMAT}\"")))
}

/// Reads a weights file: the network, its config and where it came from.
///
/// # Errors
/// If the file is no LumiTokens weights file, or a tensor is missing, unexpected or misshapen.
pub fn load(path: &Path, device: &Device) -> Result<(Network, ModelConfig, Provenance)> {
    let bytes = std::fs::read(path).map_err(|e| lumi_core::Error::io(path, e))?;
    load_bytes(&bytes, path, device)
}

/// [`load`] from memory; `path` names it in errors.
///
/// # Errors
/// As [`load`].
pub fn load_bytes(
    bytes: &[u8],
    path: &Path,
    device: &Device,
) -> Result<(Network, ModelConfig, Provenance)> {
    let malformed = |e: safetensors::SafeTensorError| {
        Error::weights(
            path,
            "(header)",
            format!("expected a safetensors file: {e}"),
        )
    };
    let (_, metadata) = safetensors::SafeTensors::read_metadata(bytes).map_err(malformed)?;
    let entries = metadata.metadata().clone().unwrap_or_default();
    let entry = |key: &str| {
        entries.get(key).ok_or_else(|| {
            let expected =
                format!("expected `{key}` in the metadata; is it a LumiTokens weights file?");
            Error::weights(path, "(metadata)", expected)
        })
    };
    if entry("format")? != FORMAT {
        let expected = format!("expected format {FORMAT}, found {}", entry("format")?);
        return Err(Error::weights(path, "(metadata)", expected));
    }
    let config: ModelConfig = serde_json::from_str(entry("config")?)
        .map_err(|e| Error::config(path.display().to_string(), "config", e.to_string()))?;
    config.validate(&path.display().to_string())?;
    let provenance = serde_json::from_str(entry("provenance")?).unwrap_or_default();
    let tensors = read_all(bytes, path)?;
    let network = load_into(
        Network::blank(&config, device),
        &tensors,
        path,
        &str::to_owned,
    )?;
    Ok((network, config, provenance))
}

/// Short fingerprint of a file's bytes (FNV-1a, 64 bits): tells files apart, proves nothing.
#[must_use]
pub fn fingerprint(bytes: &[u8]) -> String {
    let hash = bytes.iter().fold(0xcbf2_9ce4_8422_2325_u64, |h, b| {
        (h ^ u64::from(*b)).wrapping_mul(0x0000_0100_0000_01b3)
    });
    format!("{hash:016x}")
}

/// The tensors of a safetensors file in memory.
///
/// # Errors
/// If it is malformed.
pub fn read_all<'a>(bytes: &'a [u8], path: &Path) -> Result<BTreeMap<String, SafeTensor<'a>>> {
    let file = safetensors::SafeTensors::deserialize(bytes).map_err(|e| {
        Error::weights(
            path,
            "(header)",
            format!("expected a safetensors file: {e}"),
        )
    })?;
    let tensors = file.tensors().into_iter();
    Ok(tensors
        .map(|(name, view)| {
            (
                name.clone(),
                SafeTensor {
                    name,
                    view,
                    path: path.into(),
                },
            )
        })
        .collect())
}

/// A tensor of a safetensors file.
pub struct SafeTensor<'a> {
    name: String,
    view: TensorView<'a>,
    path: std::path::PathBuf,
}

impl LazyTensor for SafeTensor<'_> {
    fn shape(&self) -> &[usize] {
        self.view.shape()
    }

    fn read(&self) -> Result<Vec<f32>> {
        let name = format!("{:?}", self.view.dtype());
        to_f32(self.view.data(), &name).ok_or_else(|| {
            let expected = format!("expected F32, F16, BF16 or F64 values, found {name}");
            Error::weights(&self.path, &self.name, expected)
        })
    }
}

/// Little-endian floats of the named type as f32.
#[must_use]
pub fn to_f32(bytes: &[u8], dtype: &str) -> Option<Vec<f32>> {
    fn each<const N: usize>(bytes: &[u8], f: impl Fn([u8; N]) -> f32) -> Vec<f32> {
        bytes.as_chunks::<N>().0.iter().map(|b| f(*b)).collect()
    }
    Some(match dtype {
        "F32" => each(bytes, f32::from_le_bytes),
        "F64" => each(bytes, |b| f64::from_le_bytes(b) as f32),
        "F16" => each(bytes, |b| f16::from_le_bytes(b).to_f32()),
        "BF16" => each(bytes, |b| bf16::from_le_bytes(b).to_f32()),
        _ => return None,
    })
}

/// Fills every parameter of `network` from `tensors`, whose names are `rename(ours)`.
///
/// # Errors
/// Names each kind of misfit: a missing, misshapen, unreadable or left-over tensor.
pub fn load_into<T: LazyTensor>(
    network: Network,
    tensors: &BTreeMap<String, T>,
    path: &Path,
    rename: &dyn Fn(&str) -> String,
) -> Result<Network> {
    let mut problem = None;
    let mut used = std::collections::BTreeSet::new();
    let network = params::replace(network, &mut |name, shape| {
        if problem.is_some() {
            return None;
        }
        let theirs = rename(name);
        let values = match tensors.get(&theirs) {
            None => Err(Error::weights(
                path,
                &theirs,
                "expected by the config, but missing",
            )),
            // A scalar of theirs is a one-element vector of ours.
            Some(t) if t.shape() != shape && !(t.shape().is_empty() && shape == [1]) => {
                let expected = format!("expected shape {shape:?}, found {:?}", t.shape());
                Err(Error::weights(path, &theirs, expected))
            }
            Some(t) => t.read(),
        };
        used.insert(theirs);
        values.map_err(|e| problem = Some(e)).ok()
    });
    if let Some(problem) = problem {
        return Err(problem);
    }
    if let Some(extra) = tensors.keys().find(|name| !used.contains(*name)) {
        return Err(Error::weights(
            path,
            extra,
            "unexpected: the config has no such tensor",
        ));
    }
    Ok(network)
}
