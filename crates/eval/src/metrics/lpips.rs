//! LPIPS, the learned perceptual distance of Zhang et al. 2018 (version 0.1), over AlexNet or VGG16.
//!
//! Written in Burn's operations, so that training can use it as a loss: on an autodiff device the weights are
//! constants and the gradient flows to the images.

use crate::Result;
use burn::tensor::activation::relu;
use burn::tensor::module::{conv2d, interpolate, max_pool2d};
use burn::tensor::ops::{ConvOptions, InterpolateMode, InterpolateOptions, MaxPoolOptions};
use burn::tensor::{Device, Tensor, TensorData};
use lumi_core::Error;
use lumi_model::checkpoint::{LazyTensor, fingerprint, read_all};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// The network whose features are compared.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Net {
    /// AlexNet: what LPIPS is usually reported with; its weights are part of this crate.
    Alex,
    /// VGG16: what training losses usually take; its weights are a file of 29 MB.
    Vgg,
}

/// One step through a network.
enum Layer {
    /// Convolution `features.N`, then ReLU: kernel side, stride, padding, channels in and out.
    Conv(usize, [usize; 3], [usize; 2]),
    /// Max pooling: kernel side and stride.
    Pool(usize, usize),
    /// The features here are compared.
    Tap,
}
use Layer::{Conv, Pool, Tap};

const ALEX: &[Layer] = &[
    Conv(0, [11, 4, 2], [3, 64]),
    Tap,
    Pool(3, 2),
    Conv(3, [5, 1, 2], [64, 192]),
    Tap,
    Pool(3, 2),
    Conv(6, [3, 1, 1], [192, 384]),
    Tap,
    Conv(8, [3, 1, 1], [384, 256]),
    Tap,
    Conv(10, [3, 1, 1], [256, 256]),
    Tap,
];

const VGG: &[Layer] = &[
    Conv(0, [3, 1, 1], [3, 64]),
    Conv(2, [3, 1, 1], [64, 64]),
    Tap,
    Pool(2, 2),
    Conv(5, [3, 1, 1], [64, 128]),
    Conv(7, [3, 1, 1], [128, 128]),
    Tap,
    Pool(2, 2),
    Conv(10, [3, 1, 1], [128, 256]),
    Conv(12, [3, 1, 1], [256, 256]),
    Conv(14, [3, 1, 1], [256, 256]),
    Tap,
    Pool(2, 2),
    Conv(17, [3, 1, 1], [256, 512]),
    Conv(19, [3, 1, 1], [512, 512]),
    Conv(21, [3, 1, 1], [512, 512]),
    Tap,
    Pool(2, 2),
    Conv(24, [3, 1, 1], [512, 512]),
    Conv(26, [3, 1, 1], [512, 512]),
    Conv(28, [3, 1, 1], [512, 512]),
    Tap,
];

/// Mean and deviation of the networks' training images, for inputs in [−1, 1] (LPIPS' own constants).
const SHIFT: [f32; 3] = [-0.030, -0.088, -0.188];
const SCALE: [f32; 3] = [0.458, 0.448, 0.450];

/// Where VGG16's weights may be named.
pub const VGG_VARIABLE: &str = "LUMI_LPIPS_VGG16";
/// Name of the weights file in the cache folder.
pub const VGG_FILE: &str = "vgg16.fp16.safetensors";

impl Net {
    fn layers(self) -> &'static [Layer] {
        match self {
            Self::Alex => ALEX,
            Self::Vgg => VGG,
        }
    }

    /// Shortest side in pixels that leaves the deepest features at least one pixel: 31 for AlexNet, 16 for VGG16.
    #[must_use]
    pub fn least_side(self) -> usize {
        let reaches = |side: usize| {
            let step = |n: Option<usize>, layer: &Layer| {
                let (kernel, stride, padding) = match layer {
                    Conv(_, [k, s, p], _) => (*k, *s, *p),
                    Pool(k, s) => (*k, *s, 0),
                    Tap => return n,
                };
                Some(((n? + 2 * padding).checked_sub(kernel)?) / stride + 1)
            };
            self.layers().iter().fold(Some(side), step).is_some()
        };
        (1..).find(|side| reaches(*side)).unwrap_or(usize::MAX)
    }
}

/// LPIPS with its weights.
#[derive(Debug, Clone)]
pub struct Lpips {
    /// The network.
    pub net: Net,
    /// Fingerprint of the weights' file.
    pub fingerprint: String,
    /// Weight `[out, in, k, k]` and bias `[out]` of each convolution.
    convolutions: Vec<(Tensor<4>, Tensor<1>)>,
    /// Channel weights of each tap, `[1, c, 1, 1]`.
    linear: Vec<Tensor<4>>,
    shift: Tensor<4>,
    scale: Tensor<4>,
}

impl Lpips {
    /// Over AlexNet, with the weights that this crate carries (`assets/lpips/NOTICE`).
    ///
    /// # Errors
    /// None in a sound build; the weights are checked like any others.
    pub fn alex(device: &Device) -> Result<Self> {
        let bytes = include_bytes!("../../../../assets/lpips/alexnet.fp16.safetensors");
        Self::from_bytes(Net::Alex, bytes, Path::new("(bundled AlexNet)"), device)
    }

    /// Over VGG16. Its weights are taken from `path`, else from the file that the environment variable
    /// `LUMI_LPIPS_VGG16` names, else from the cache folder ([`vgg_cache`]).
    ///
    /// # Errors
    /// If there is no such file (the message says where to get it), or its tensors do not fit.
    pub fn vgg(path: Option<&Path>, device: &Device) -> Result<Self> {
        let named = path.map(Path::to_owned);
        let named = named.or_else(|| std::env::var_os(VGG_VARIABLE).map(PathBuf::from));
        let path = match named {
            Some(path) => path,
            None => vgg_cache()
                .filter(|p| p.is_file())
                .ok_or_else(missing_vgg)?,
        };
        let bytes = lumi_core::fs::read_bytes(&path)?;
        Self::from_bytes(Net::Vgg, &bytes, &path, device)
    }

    /// From a safetensors file in memory with torchvision's names (`features.N.weight`, `features.N.bias`) and
    /// LPIPS' (`linK.model.1.weight`); `path` names it in errors.
    ///
    /// # Errors
    /// Names a tensor that is missing or misshapen.
    pub fn from_bytes(net: Net, bytes: &[u8], path: &Path, device: &Device) -> Result<Self> {
        let tensors = read_all(bytes, path)?;
        let read = |name: String, shape: &[usize]| -> Result<Vec<f32>> {
            let wrong = |expected: String| lumi_model::Error::weights(path, &name, expected);
            let tensor = tensors.get(&name);
            let tensor = tensor
                .ok_or_else(|| wrong(format!("expected shape {shape:?}, but it is missing")))?;
            if tensor.shape() != shape {
                let found = tensor.shape();
                return Err(wrong(format!("expected shape {shape:?}, found {found:?}")));
            }
            tensor.read()
        };
        let (mut convolutions, mut linear, mut channels) = (Vec::new(), Vec::new(), 0);
        for layer in net.layers() {
            match *layer {
                Conv(i, [k, ..], [input, output]) => {
                    let shape = [output, input, k, k];
                    let weight = read(format!("features.{i}.weight"), &shape)?;
                    let bias = read(format!("features.{i}.bias"), &[output])?;
                    convolutions.push((
                        Tensor::from_data(TensorData::new(weight, shape), device),
                        Tensor::from_data(TensorData::new(bias, [output]), device),
                    ));
                    channels = output;
                }
                Pool(..) => {}
                Tap => {
                    let shape = [1, channels, 1, 1];
                    let weight = read(format!("lin{}.model.1.weight", linear.len()), &shape)?;
                    linear.push(Tensor::from_data(TensorData::new(weight, shape), device));
                }
            }
        }
        let constant =
            |v: [f32; 3]| Tensor::from_data(TensorData::new(v.to_vec(), [1, 3, 1, 1]), device);
        Ok(Self {
            net,
            fingerprint: fingerprint(bytes),
            convolutions,
            linear,
            shift: constant(SHIFT),
            scale: constant(SCALE),
        })
    }

    /// The distance of each pair of display-encoded images in [0, 1].
    ///
    /// # Shapes
    /// `[n, 3, h, w]` both → `[n]`
    ///
    /// # Errors
    /// If the images are smaller than [`Net::least_side`].
    pub fn distance(&self, a: Tensor<4>, b: Tensor<4>) -> Result<Tensor<1>> {
        let [n, ..] = a.dims();
        let maps = self.maps(a, b)?;
        let means = maps.into_iter().map(|map| {
            let [_, _, h, w] = map.dims();
            map.reshape([n, h * w]).mean_dim(1).reshape([n])
        });
        Ok(means
            .reduce(|a, b| a + b)
            .unwrap_or_else(|| unreachable!("five taps")))
    }

    /// The distance at each pixel: every tap's map, enlarged bilinearly (half-pixel centres), and summed.
    ///
    /// # Shapes
    /// `[n, 3, h, w]` both → `[n, 1, h, w]`
    ///
    /// # Errors
    /// As [`Self::distance`].
    pub fn spatial(&self, a: Tensor<4>, b: Tensor<4>) -> Result<Tensor<4>> {
        let [_, _, h, w] = a.dims();
        let options = InterpolateOptions::new(InterpolateMode::Bilinear)
            .with_align_corners(false)
            .with_output_size([h, w]);
        let maps = self.maps(a, b)?;
        let enlarged = maps
            .into_iter()
            .map(|map| interpolate(map, options.clone()));
        Ok(enlarged
            .reduce(|a, b| a + b)
            .unwrap_or_else(|| unreachable!("five taps")))
    }

    /// Each tap's weighted squared differences of unit features, `[n, 1, h', w']`.
    fn maps(&self, a: Tensor<4>, b: Tensor<4>) -> Result<Vec<Tensor<4>>> {
        let [_, _, h, w] = a.dims();
        let least = self.net.least_side();
        if h.min(w) < least {
            let expected = format!(
                "expected images of at least {least} pixels a side for {:?} features, found {w}×{h}",
                self.net
            );
            return Err(Error::value("LPIPS", expected).into());
        }
        let pairs = self.features(a).into_iter().zip(self.features(b));
        let maps = pairs.zip(&self.linear).map(|((a, b), weights)| {
            let difference = unit(a) - unit(b);
            (difference.clone() * difference * weights.clone()).sum_dim(1)
        });
        Ok(maps.collect())
    }

    /// Features at the taps of images in [0, 1].
    fn features(&self, x: Tensor<4>) -> Vec<Tensor<4>> {
        let mut x = (x * 2.0 - 1.0 - self.shift.clone()) / self.scale.clone();
        let mut convolutions = self.convolutions.iter();
        let mut taps = Vec::new();
        for layer in self.net.layers() {
            match *layer {
                Conv(_, [_, stride, padding], _) => {
                    let options = ConvOptions::new([stride; 2], [padding; 2], [1, 1], 1);
                    if let Some((weight, bias)) = convolutions.next() {
                        x = relu(conv2d(x, weight.clone(), Some(bias.clone()), options));
                    }
                }
                Pool(kernel, stride) => {
                    let options = MaxPoolOptions {
                        kernel_size: [kernel; 2],
                        stride: [stride; 2],
                        padding: [(0, 0); 2],
                        dilation: [1, 1],
                        ceil_mode: false,
                    };
                    x = max_pool2d(x, options);
                }
                Tap => taps.push(x.clone()),
            }
        }
        taps
    }
}

/// Features divided by their length over the channels. The floor under the root keeps the gradient finite
/// where ReLU left nothing.
fn unit(x: Tensor<4>) -> Tensor<4> {
    let length = ((x.clone() * x.clone()).sum_dim(1) + 1e-20).sqrt() + 1e-10;
    x / length
}

/// The file of VGG16's weights in the user's cache folder: `$XDG_CACHE_HOME/lumitokens`, else
/// `~/.cache/lumitokens` (`%LOCALAPPDATA%\lumitokens` on Windows).
#[must_use]
pub fn vgg_cache() -> Option<PathBuf> {
    let from = |name: &str| std::env::var_os(name).map(PathBuf::from);
    let folder = from("XDG_CACHE_HOME")
        .or_else(|| from("LOCALAPPDATA"))
        .or_else(|| Some(from("HOME")?.join(".cache")))?;
    Some(folder.join("lumitokens").join(VGG_FILE))
}

fn missing_vgg() -> lumi_model::Error {
    let place = vgg_cache().map_or_else(|| VGG_FILE.to_owned(), |p| p.display().to_string());
    let expected = format!(
        "expected --lpips-weights FILE, the environment variable {VGG_VARIABLE}, or the file {place}; \
         tools/lpips_weights.py makes it from torchvision's VGG16 and LPIPS' linear weights \
         (docs/evaluation.md)"
    );
    Error::value("LPIPS with VGG16", expected).into()
}
