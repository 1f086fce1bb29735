//! The authors' checkpoints: names, config schema, `.pt` files. Nothing in a file is ever executed.

use crate::checkpoint::{LazyTensor, is_pytorch, load_into, read_all, to_f32};
use crate::config::{DecoderAttention, HeadConfig, LightConfig, Output, RayFeatures};
use crate::{Error, ModelConfig, Network, Result};
use burn::tensor::Device;
use pytorch_reader::{DType, PytorchReader, Tensor};
use serde_json::Value;
use std::collections::BTreeMap;
use std::io::Read;
use std::path::Path;
use std::sync::Arc;

/// Their matrix of queries, keys and values, one below the other.
const QKV: &str = "attn.to_qkv.weight";

/// The name in the authors' files of our parameter `name`; a third of one has `[q]`, `[k]` or `[v]` behind it.
#[must_use]
pub fn authors_name(name: &str, config: &ModelConfig) -> String {
    let parts: Vec<&str> = name.split('.').collect();
    let block = |stack: &str, index: &str, field: &str| {
        let (field, third) = match field {
            "q" => (QKV, "[q]"),
            "k" => (QKV, "[k]"),
            "v" => (QKV, "[v]"),
            "proj" => ("attn.fc.weight", ""),
            "q_norm" => ("attn.q_norm.weight", ""),
            "k_norm" => ("attn.k_norm.weight", ""),
            "fc1" => ("mlp.mlp.0.weight", ""),
            "fc2" => ("mlp.mlp.2.weight", ""),
            "norm1" => ("norm1.weight", ""),
            _ => ("norm2.weight", ""),
        };
        format!("transformer_{stack}.{index}.{field}{third}")
    };
    let layer = |index: &str| {
        index
            .parse::<usize>()
            .ok()
            .and_then(|i| config.head.layers().get(i).copied())
            .unwrap_or(0)
    };
    let refine = |conv: &str| {
        if conv == "conv1" {
            "0.weight"
        } else {
            "2.weight"
        }
    };
    let last = parts.len() - 1;
    match parts.as_slice() {
        ["latents"] => "n_light_field_latent".into(),
        ["image", _] => "image_tokenizer.1.weight".into(),
        ["ray", _] => "target_pose_tokenizer.1.weight".into(),
        ["lights", .., "environment", _] => "env_tokenizer.1.weight".into(),
        ["lights", .., "point", _] => "point_light_tokenizer.0.weight".into(),
        [stack @ ("encoder" | "editor" | "decoder"), index, field, ..] => {
            block(stack, index, field)
        }
        ["decoder_norm", _] => "transformer_input_layernorm_decoder.weight".into(),
        ["head", .., "norm", "weight"] => "image_token_decoder.0.weight".into(),
        ["head", .., "layers", index, "project", "weight"] => {
            format!("image_token_decoder.layer_projs.{}.weight", layer(index))
        }
        ["head", .., "layers", index, "refine", conv] => {
            format!(
                "image_token_decoder.layer_refines.{}.{}",
                layer(index),
                refine(conv)
            )
        }
        ["head", .., "layers", index, "gate"] => {
            format!("image_token_decoder.layer_gates.{}", layer(index))
        }
        ["head", .., "fuse", conv] => format!("image_token_decoder.fuse_refine.{}", refine(conv)),
        ["head", .., "pixels", "weight"] => "image_token_decoder.1.weight".into(),
        ["head", .., "pixels"] if last > 0 => "image_token_decoder.to_patch_pixels.weight".into(),
        _ => name.into(),
    }
}

/// Reads a model config: our TOML, or the JSON form of the authors' config files.
///
/// # Errors
/// On unreadable files and on what does not fit.
pub fn read_config(path: &Path) -> Result<ModelConfig> {
    let text = std::fs::read_to_string(path).map_err(|e| lumi_core::Error::io(path, e))?;
    let source = path.display().to_string();
    if text.trim_start().starts_with('{') {
        let value: Value = serde_json::from_str(&text)
            .map_err(|e| Error::config(&source, "(file)", format!("expected JSON: {e}")))?;
        if value.get("model").is_some() {
            return authors_config(&value, &source);
        }
        let config: ModelConfig = serde_json::from_value(value)
            .map_err(|e| Error::config(&source, "model", e.to_string()))?;
        config.validate(&source)?;
        return Ok(config);
    }
    ModelConfig::from_toml(&text, &source)
}

/// A config file, or a preset by name.
///
/// # Errors
/// As [`read_config`]; for a name without a file, lists the presets.
pub fn config_or_preset(name: &str) -> Result<ModelConfig> {
    let path = Path::new(name);
    if path.extension().is_some() {
        read_config(path)
    } else {
        ModelConfig::preset(name)
    }
}

/// The authors' config schema (`model.transformer.d` and so on).
fn authors_config(value: &Value, source: &str) -> Result<ModelConfig> {
    let at = |pointer: &str| value.pointer(pointer);
    let number = |pointer: &str, default: Option<u64>| -> Result<usize> {
        let found = at(pointer).map(Value::as_u64);
        match (found, default) {
            (Some(Some(n)), _) => Ok(n as usize),
            (None, Some(n)) => Ok(n as usize),
            _ => Err(Error::config(
                source,
                pointer,
                "expected a whole number ≥ 0",
            )),
        }
    };
    let flag = |pointer: &str| at(pointer).and_then(Value::as_bool).unwrap_or(false);
    if !flag("/model/transformer/use_qk_norm") {
        return Err(Error::config(
            source,
            "model.transformer.use_qk_norm",
            "expected true",
        ));
    }
    let head = match at("/model/decoder_head/type").and_then(Value::as_str) {
        None | Some("mlp") => HeadConfig::Mlp,
        Some("dpt") => {
            let listed = at("/model/decoder_head/dpt/layer_indices").and_then(Value::as_array);
            let layers = listed.map(|l| {
                l.iter()
                    .filter_map(Value::as_u64)
                    .map(|l| l as usize)
                    .collect()
            });
            let depth = number("/model/transformer/decoder_n_layer", None)?;
            let mut layers: Vec<usize> = layers.unwrap_or_else(|| vec![3, 6, 9, 12]);
            // The authors' code skips layers beyond the decoder's depth.
            layers.retain(|l| *l <= depth);
            HeadConfig::Dpt {
                features: number("/model/decoder_head/dpt/feature_dim", Some(256))?,
                layers,
            }
        }
        Some(other) => {
            let expected = format!("expected mlp or dpt, found {other}");
            return Err(Error::config(source, "model.decoder_head.type", expected));
        }
    };
    let signals: Vec<&str> = at("/training/relight_signals")
        .and_then(Value::as_array)
        .map(|s| s.iter().filter_map(Value::as_str).collect())
        .unwrap_or_default();
    let environment_patch = if signals.contains(&"envmap") {
        Some(number("/model/env_tokenizer/patch_size", Some(8))?)
    } else {
        None
    };
    let config = ModelConfig {
        dim: number("/model/transformer/d", None)?,
        head_dim: number("/model/transformer/d_head", None)?,
        encoder_layers: number("/model/transformer/encoder_n_layer", None)?,
        editor_layers: number("/model/transformer/editor/n_layer", Some(0))?,
        decoder_layers: number("/model/transformer/decoder_n_layer", None)?,
        scene_tokens: number("/model/transformer/n_latent_vectors", None)?,
        patch: number("/model/image_tokenizer/patch_size", None)?,
        resolution: number("/model/image_tokenizer/image_size", None)?,
        rays: RayFeatures::Plucker,
        decoder: DecoderAttention::Joint,
        albedo: false,
        overlap: false,
        reprojection: false,
        surface: false,
        margins: false,
        direct: false,
        pixel_mlp: 0,
        pixel_context: 0,
        anchors: false,
        streams: 1,
        view_tokens: false,
        output: Output::Display,
        head,
        lights: LightConfig::Authors {
            environment_patch,
            point_rays: signals.contains(&"point_light"),
            single_environment: flag("/training/single_env_map"),
        },
    };
    config.validate(source)?;
    Ok(config)
}

/// A tensor of a `.pt` file.
struct TorchTensor(Tensor, std::path::PathBuf);

impl LazyTensor for TorchTensor {
    fn shape(&self) -> &[usize] {
        self.0.shape()
    }

    fn read(&self) -> Result<Vec<f32>> {
        let dtype = match self.0.dtype() {
            DType::F32 => "F32",
            DType::F64 => "F64",
            DType::F16 => "F16",
            DType::BF16 => "BF16",
            other => {
                let expected = format!("expected floating-point values, found {other:?}");
                return Err(Error::weights(&self.1, &self.0.name, expected));
            }
        };
        let bytes = self
            .0
            .read()
            .map_err(|e| lumi_core::Error::io(&self.1, e))?;
        to_f32(&bytes, dtype)
            .ok_or_else(|| Error::weights(&self.1, &self.0.name, "cannot be converted"))
    }
}

/// Loads weights in the authors' names: `checkpoint.pt` (tensor by tensor) or safetensors.
///
/// # Errors
/// If a tensor is missing, unexpected, misshapen or not finite, by name; `loss_computer.*` is skipped.
pub fn load_authors(path: &Path, config: &ModelConfig, device: &Device) -> Result<Network> {
    let network = Network::blank(config, device);
    let rename = |ours: &str| authors_name(ours, config);
    // Its content says what a file is, whatever it is called.
    let mut head = [0; 4];
    let read = std::fs::File::open(path).and_then(|mut file| file.read(&mut head));
    let read = read.map_err(|e| lumi_core::Error::io(path, e))?;
    let named = path.extension().is_some_and(|e| e == "safetensors");
    if named && !is_pytorch(&head[..read]) {
        let bytes = lumi_core::fs::read_bytes(path)?;
        let tensors = bare(read_all(&bytes, path)?, path)?;
        return load_into(network, &thirds(without_loss(tensors)), path, &rename);
    }
    let reader = PytorchReader::new(path).map_err(|e| {
        let expected = format!("expected a PyTorch checkpoint, a dictionary of tensors: {e}");
        Error::weights(path, "(file)", expected)
    })?;
    let tensors = reader.into_tensors().into_iter();
    let tensors = tensors.map(|(name, tensor)| (name, TorchTensor(tensor, path.to_owned())));
    let tensors = bare(tensors, path)?;
    load_into(network, &thirds(without_loss(tensors)), path, &rename)
}

/// Where training scripts put the weights beside other state.
const CONTAINERS: [&str; 3] = ["model", "state_dict", "model_state_dict"];
/// What PyTorch's wrappers (`DistributedDataParallel`, `torch.compile`) put into names.
const WRAPPERS: [&str; 2] = ["module", "_orig_mod"];

/// The network's tensors by their bare names: out of the container that they are in, if they are, without wrappers' names.
fn bare<T>(
    tensors: impl IntoIterator<Item = (String, T)>,
    path: &Path,
) -> Result<BTreeMap<String, T>> {
    let mut found: Vec<(String, String, T)> = Vec::new();
    for (name, tensor) in tensors {
        let parts = name.split('.').filter(|part| !WRAPPERS.contains(part));
        let bare = parts.collect::<Vec<_>>().join(".");
        found.push((bare, name, tensor));
    }
    let inside = |found: &[(String, String, T)]| {
        let holds = |container: &&str| {
            let begins = |name: &str| {
                name.split_once('.')
                    .is_some_and(|(first, _)| first == *container)
            };
            found.iter().any(|(bare, ..)| begins(bare))
        };
        CONTAINERS.into_iter().find(holds)
    };
    while let Some(container) = inside(&found) {
        let within = |(bare, name, tensor): (String, String, T)| {
            let rest = bare.strip_prefix(container)?.strip_prefix('.')?.to_owned();
            Some((rest, name, tensor))
        };
        found = found.into_iter().filter_map(within).collect();
    }
    let mut named = BTreeMap::new();
    for (bare, name, tensor) in found {
        if named.insert(bare.clone(), tensor).is_some() {
            let expected = format!("expected one tensor `{bare}`, found it under several names");
            return Err(Error::weights(path, &name, expected));
        }
    }
    Ok(named)
}

/// A tensor of theirs, or a third of its rows.
struct Rows<T> {
    tensor: Arc<T>,
    shape: Vec<usize>,
    third: Option<usize>,
}

impl<T: LazyTensor> LazyTensor for Rows<T> {
    fn shape(&self) -> &[usize] {
        &self.shape
    }

    fn read(&self) -> Result<Vec<f32>> {
        let mut values = self.tensor.read()?;
        if let Some(third) = self.third {
            let len = values.len() / 3;
            values = values[third * len..][..len].to_vec();
        }
        Ok(values)
    }
}

/// The same tensors, with those of queries, keys and values taken apart as ours are.
fn thirds<T: LazyTensor>(tensors: BTreeMap<String, T>) -> BTreeMap<String, Rows<T>> {
    let mut parts = BTreeMap::new();
    for (name, tensor) in tensors {
        let mut shape = tensor.shape().to_vec();
        let apart = name.ends_with(QKV) && shape.len() == 2 && shape[0].is_multiple_of(3);
        if apart {
            shape[0] /= 3;
        }
        let tensor = Arc::new(tensor);
        let mut put = |name: String, third| {
            let (tensor, shape) = (Arc::clone(&tensor), shape.clone());
            parts.insert(
                name,
                Rows {
                    tensor,
                    shape,
                    third,
                },
            );
        };
        if apart {
            for (third, part) in ["[q]", "[k]", "[v]"].into_iter().enumerate() {
                put(format!("{name}{part}"), Some(third));
            }
        } else {
            put(name, None);
        }
    }
    parts
}

/// Weights of the training loss, which some checkpoints carry along, are nobody's parameters.
fn without_loss<T>(mut tensors: BTreeMap<String, T>) -> BTreeMap<String, T> {
    tensors.retain(|name, _| !name.starts_with("loss_computer."));
    tensors
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    fn names(given: &[&str]) -> Result<Vec<String>> {
        let tensors = given.iter().map(|name| ((*name).to_owned(), ()));
        Ok(bare(tensors, Path::new("x.pt"))?.into_keys().collect())
    }

    #[test]
    fn weights_are_found_in_whatever_training_scripts_put_them() {
        let expected = ["a.0.weight", "b"];
        for given in [
            &["a.0.weight", "b"][..],
            &["model.a.0.weight", "model.b", "optimizer.state.0.exp_avg"],
            &["state_dict.a.0.weight", "state_dict.b", "epoch.x"],
            &["module.a.0.weight", "module.b"],
            &["_orig_mod.a.0.weight", "_orig_mod.b"],
            &[
                "model._orig_mod.module.a.0.weight",
                "model._orig_mod.module.b",
                "other",
            ],
            &[
                "state_dict.model.a._orig_mod.0.weight",
                "state_dict.model.b",
            ],
        ] {
            assert_eq!(names(given).unwrap(), expected, "{given:?}");
        }
        let error = names(&["module.b", "b"]).unwrap_err().to_string();
        assert!(
            error.contains("`b`") && error.contains("several"),
            "{error}"
        );
    }
}
