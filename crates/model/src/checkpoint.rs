//! Weights files: our safetensors with config and provenance in the metadata.

use crate::params::{self, LazyParam};
use crate::{Error, ModelConfig, Network, Result};
use burn::tensor::Device;
use half::{bf16, f16};
use safetensors::tensor::{Dtype, TensorView};
use serde::{Deserialize, Serialize};
use std::borrow::Cow;
use std::collections::{BTreeMap, HashMap};
use std::path::Path;

/// Version of our weights files.
const FORMAT: &str = "lumitokens-2";

/// Key of the header in the file's metadata.
const HEADER_KEY: &str = "lumitokens";

/// What stands in the metadata, as JSON.
#[derive(Serialize, Deserialize)]
struct Header {
    format: String,
    config: ModelConfig,
    #[serde(default)]
    provenance: Provenance,
}

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

/// Writes a network, one tensor at a time; the file appears complete or not at all.
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
    write(path, params::lazy(network), config, provenance, storage)
}

/// Writes tensors as a weights file; each one's values are read when its turn comes. Atomic.
///
/// # Errors
/// If the file cannot be written.
pub fn write<'a>(
    path: &Path,
    tensors: Vec<LazyParam<'a>>,
    config: &ModelConfig,
    provenance: &Provenance,
    storage: Storage,
) -> Result<()> {
    struct Stored<'a>(LazyParam<'a>, Storage);
    impl safetensors::View for Stored<'_> {
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
            let values = (self.0.read)();
            Cow::Owned(match self.1 {
                Storage::F32 => values.iter().flat_map(|v| v.to_le_bytes()).collect(),
                Storage::Bf16 => {
                    let halves = values.iter().map(|v| bf16::from_f32(*v));
                    halves.flat_map(|v| v.to_le_bytes()).collect()
                }
            })
        }
        fn data_len(&self) -> usize {
            let bytes = if self.1 == Storage::F32 { 4 } else { 2 };
            self.0.shape.iter().product::<usize>() * bytes
        }
    }
    let header = Header {
        format: FORMAT.to_owned(),
        config: config.clone(),
        provenance: provenance.clone(),
    };
    let header = serde_json::to_string(&header)
        .map_err(|e| Error::Failed(format!("metadata cannot be written: {e}")))?;
    // One key: several would be written in an order that changes from run to run.
    let metadata = HashMap::from([(HEADER_KEY.to_owned(), header)]);
    let views = tensors
        .into_iter()
        .map(|t| (t.name.clone(), Stored(t, storage)));
    lumi_core::fs::atomic_file(path, |temporary| {
        safetensors::serialize_to_file(views, Some(metadata), temporary)
            .map_err(std::io::Error::other)
    })?;
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
    Ok(text.contains(FORMAT))
}

/// Reads a weights file: the network, its config and where it came from.
///
/// # Errors
/// If the file is no LumiTokens weights file, or a tensor is missing, unexpected or misshapen.
pub fn load(path: &Path, device: &Device) -> Result<(Network, ModelConfig, Provenance)> {
    let bytes = lumi_core::fs::read_bytes(path)?;
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
        let found = not_safetensors(bytes).unwrap_or_else(|| e.to_string());
        let expected = format!("expected a safetensors file: {found}");
        Error::weights(path, "(header)", expected)
    };
    let (_, metadata) = safetensors::SafeTensors::read_metadata(bytes).map_err(malformed)?;
    let wrong = |expected: String| Error::weights(path, "(metadata)", expected);
    let text = metadata
        .metadata()
        .as_ref()
        .and_then(|entries| entries.get(HEADER_KEY))
        .ok_or_else(|| {
            wrong(format!(
                "expected `{HEADER_KEY}`; is it a LumiTokens weights file?"
            ))
        })?;
    // First the version: another one's config may be of other fields.
    #[derive(Deserialize)]
    struct Stated {
        format: String,
    }
    let unreadable = |e: serde_json::Error| wrong(format!("{HEADER_KEY}: {e}"));
    let Stated { format } = serde_json::from_str(text).map_err(unreadable)?;
    if format != FORMAT {
        return Err(wrong(format!("expected format {FORMAT}, found {format}")));
    }
    let Header {
        config, provenance, ..
    } = serde_json::from_str(text).map_err(unreadable)?;
    config.validate(&path.display().to_string())?;
    // Before anything is allocated for them: weights take at least two bytes each.
    let least = config.least_weights();
    if 2 * least > bytes.len() as u128 {
        let found = bytes.len();
        return Err(wrong(format!(
            "expected at least {least} weights for this config, found a file of {found} bytes"
        )));
    }
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
/// Names each kind of misfit: a missing, misshapen, unreadable or left-over tensor, and one with numbers that are not finite.
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
            None => {
                let close = closest(&theirs, tensors.keys());
                let close = close.map_or_else(String::new, |c| format!("; the closest is `{c}`"));
                let expected = format!("expected by the config, but missing{close}");
                Err(Error::weights(path, &theirs, expected))
            }
            // A scalar of theirs is a one-element vector of ours.
            Some(t) if t.shape() != shape && !(t.shape().is_empty() && shape == [1]) => {
                let expected = format!("expected shape {shape:?}, found {:?}", t.shape());
                Err(Error::weights(path, &theirs, expected))
            }
            Some(t) => t.read().and_then(|values| finite(values, path, &theirs)),
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

/// A tensor's values, if they are all numbers.
fn finite(values: Vec<f32>, path: &Path, name: &str) -> Result<Vec<f32>> {
    match values.iter().position(|v| !v.is_finite()) {
        None => Ok(values),
        Some(at) => {
            let expected = format!("expected finite numbers, found {} at {at}", values[at]);
            Err(Error::weights(path, name, expected))
        }
    }
}

/// What a file is whose first bytes are no safetensors file's.
fn not_safetensors(bytes: &[u8]) -> Option<String> {
    if bytes.get(8) == Some(&b'{') {
        return None;
    }
    let found = if is_pytorch(bytes) {
        "a PyTorch checkpoint, which `lumi import` converts"
    } else {
        lumi_core::image::type_of(bytes)?
    };
    Some(format!("found {found}"))
}

/// Whether a file begins as PyTorch's do: with a ZIP archive's mark, or a pickle's.
#[must_use]
pub fn is_pytorch(bytes: &[u8]) -> bool {
    bytes.starts_with(b"PK\x03\x04") || matches!(bytes, [0x80, 2..=5, ..])
}

/// Of some names the one most like `name`, if it is like it at all.
fn closest<'a>(name: &str, names: impl Iterator<Item = &'a String>) -> Option<&'a str> {
    let like = |other: &'a String| (strsim::jaro_winkler(name, other), other.as_str());
    let best = names.map(like).max_by(|a, b| a.0.total_cmp(&b.0));
    best.filter(|(likeness, _)| *likeness > 0.8)
        .map(|(_, other)| other)
}
