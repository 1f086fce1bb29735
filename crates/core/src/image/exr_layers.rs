//! Which channels of an OpenEXR file are the picture.
//!
//! A file holds parts, a part holds layers (what stands before the last dot of its channels' names), and renderers
//! put beauty, normals and depth into any order of both. So names and types decide, and order only between equals.

use crate::{Error, Result};
use exr::meta::attribute::SampleType;
use exr::meta::header::Header;

/// Names of layers that are the picture.
const PICTURES: &[&str] = &[
    "rgb",
    "rgba",
    "beauty",
    "c",
    "ci",
    "combined",
    "color",
    "colour",
    "composite",
    "main",
    "image",
    "default",
    "final",
    "primary",
    "picture",
    "render",
    "left",
];

/// Names of layers that hold something else about the picture.
const OTHERS: &[&str] = &[
    "n",
    "nn",
    "p",
    "pp",
    "z",
    "uv",
    "uvs",
    "st",
    "mv",
    "id",
    "ids",
    "index",
    "indexob",
    "indexma",
    "ao",
    "occlusion",
    "mist",
    "emit",
    "emission",
    "env",
    "environment",
    "shadow",
    "diffuse",
    "diffdir",
    "diffind",
    "diffcol",
    "gloss",
    "glossdir",
    "glossind",
    "glosscol",
    "trans",
    "transdir",
    "transind",
    "transcol",
    "specular",
    "reflection",
    "refraction",
    "transmission",
    "sss",
    "subsurface",
    "volume",
    "direct",
    "indirect",
    "gi",
    "light",
    "roughness",
    "metallic",
    "metalness",
    "variance",
    "noise",
    "curvature",
    "facing",
    "tangent",
    "displacement",
    "mask",
    "matte",
    "alpha",
    "debug",
    "sample",
    "samples",
    "right",
];

/// The same as parts of words, as in `WorldNormals` or `CryptoAsset00`.
const WITHIN: &[&str] = &[
    "normal",
    "depth",
    "position",
    "crypto",
    "albedo",
    "velocity",
    "motion",
    "vector",
    "lightgroup",
    "basecolor",
];

/// Most channels that a message lists.
const LISTED: usize = 40;

/// A channel of a part, by their indices.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Channel {
    pub part: usize,
    pub index: usize,
}

/// The picture's channels.
pub(super) struct Chosen {
    /// Red, green and blue; three times the same of grey pictures.
    pub color: [Channel; 3],
    pub alpha: Option<Channel>,
    pub warnings: Vec<String>,
}

/// Channels of a part that share what stands before the last dot of their names.
struct Layer {
    part: usize,
    /// Name of the part and of the layer in it; may be empty.
    name: String,
    /// Last parts of the channels' names in lower case, and their indices.
    channels: Vec<(String, usize)>,
}

impl Layer {
    fn channel(&self, names: [&str; 2]) -> Option<Channel> {
        let mut channels = self.channels.iter();
        let (_, index) = channels.find(|(name, _)| names.contains(&name.as_str()))?;
        Some(Channel {
            part: self.part,
            index: *index,
        })
    }

    fn color(&self) -> Option<[Channel; 3]> {
        Some([
            self.channel(["r", "red"])?,
            self.channel(["g", "green"])?,
            self.channel(["b", "blue"])?,
        ])
    }

    /// A single channel of luminance.
    fn grey(&self) -> Option<[Channel; 3]> {
        let subsampled = self.channel(["ry", "by"]).is_some();
        self.channel(["y", "y"])
            .filter(|_| !subsampled)
            .map(|y| [y; 3])
    }

    fn alpha(&self) -> Option<Channel> {
        self.channel(["a", "alpha"])
    }

    /// Alpha in a layer or part of its own, whatever its one channel is called there.
    fn only_alpha(&self) -> Option<Channel> {
        if self.color().is_some() {
            return None;
        }
        let single = || {
            let named = words(&self.name).any(|w| w == "alpha");
            let (_, index) = self
                .channels
                .first()
                .filter(|_| named && self.channels.len() == 1)?;
            Some(Channel {
                part: self.part,
                index: *index,
            })
        };
        self.alpha().or_else(single)
    }

    /// 3 for no name, 2 for a picture's, 0 for something else's, 1 where the name does not say.
    fn rank(&self) -> u8 {
        let lower = self.name.to_lowercase();
        let is = |names: &[&str]| words(&lower).any(|w| names.contains(&w));
        if words(&lower).next().is_none() {
            3
        } else if is(OTHERS) || WITHIN.iter().any(|w| lower.contains(w)) {
            0
        } else if is(PICTURES) {
            2
        } else {
            1
        }
    }

    fn shown(&self) -> String {
        if self.name.is_empty() {
            "without a name".to_owned()
        } else {
            format!("`{}`", self.name)
        }
    }
}

fn words(name: &str) -> impl Iterator<Item = &str> {
    name.split(|c: char| !c.is_ascii_alphanumeric())
        .filter(|w| !w.is_empty())
}

/// Chooses by name and type; among equals the first in the file.
///
/// # Errors
/// Lists the channels there are, if none are a picture's, or if several layers are there of which none is.
pub(super) fn choose(headers: &[Header]) -> Result<Chosen> {
    let layers = layers(headers);
    let colored: Vec<(&Layer, [Channel; 3])> = with(&layers, Layer::color);
    let found = if colored.is_empty() {
        with(&layers, Layer::grey)
    } else {
        colored
    };
    let best = found.iter().map(|(l, _)| l.rank()).max().unwrap_or(0);
    let (Some((layer, color)), true) = (
        found.iter().find(|(l, _)| l.rank() == best),
        best > 0 || found.len() == 1,
    ) else {
        let expected = format!("expected a picture's R, G, B, found {}", listed(headers));
        return Err(Error::value("EXR channels", expected));
    };
    let mut warnings = Vec::new();
    let rivals: Vec<String> = found
        .iter()
        .filter(|(l, _)| best < 2 && l.rank() == best && !std::ptr::eq(*l, *layer))
        .map(|(l, _)| l.shown())
        .collect();
    if !rivals.is_empty() {
        warnings.push(format!(
            "EXR layers: took {} for the picture; there is also {}",
            layer.shown(),
            rivals.join(", ")
        ));
    }
    if best == 0 {
        warnings.push(format!(
            "EXR layers: took {}, the only one with colours",
            layer.shown()
        ));
    }
    let alpha = layer.alpha().or_else(|| elsewhere(&layers, &mut warnings));
    Ok(Chosen {
        color: *color,
        alpha,
        warnings,
    })
}

/// The layers in which `find` finds channels, with these.
fn with<T>(layers: &[Layer], find: fn(&Layer) -> Option<T>) -> Vec<(&Layer, T)> {
    let pair = |l| find(l).map(|found| (l, found));
    layers.iter().filter_map(pair).collect()
}

/// Alpha outside the picture's layer: in a layer of its own, of which there must be one.
fn elsewhere(layers: &[Layer], warnings: &mut Vec<String>) -> Option<Channel> {
    let found = with(layers, Layer::only_alpha);
    if found.len() > 1 {
        let names: Vec<String> = found.iter().map(|(l, _)| l.shown()).collect();
        warnings.push(format!(
            "EXR layers: several hold alpha ({}), none is used",
            names.join(", ")
        ));
        return None;
    }
    found.first().map(|(_, channel)| *channel)
}

/// All layers whose samples are pictures': floats, one for each pixel, not deep.
fn layers(headers: &[Header]) -> Vec<Layer> {
    let mut layers: Vec<Layer> = Vec::new();
    for (part, header) in headers.iter().enumerate().filter(|(_, h)| !h.deep) {
        let part_name = header.own_attributes.layer_name.as_ref();
        let part_name = part_name.map(ToString::to_string).unwrap_or_default();
        for (index, channel) in header.channels.list.iter().enumerate() {
            if channel.sample_type == SampleType::U32 || channel.sampling.area() != 1 {
                continue;
            }
            let full = channel.name.to_string();
            let (before, last) = full.rsplit_once('.').unwrap_or(("", &full));
            let name = [part_name.as_str(), before]
                .into_iter()
                .filter(|n| !n.is_empty())
                .collect::<Vec<_>>()
                .join(".");
            let entry = (last.to_lowercase(), index);
            match layers.iter_mut().find(|l| l.part == part && l.name == name) {
                Some(layer) => layer.channels.push(entry),
                None => layers.push(Layer {
                    part,
                    name,
                    channels: vec![entry],
                }),
            }
        }
    }
    layers
}

/// Parts with their channels, for messages.
fn listed(headers: &[Header]) -> String {
    let names = headers.iter().flat_map(|header| {
        let part = header.own_attributes.layer_name.as_ref();
        let part = part.map(|p| format!("{p}/")).unwrap_or_default();
        let deep = if header.deep { " (deep)" } else { "" };
        let channels = header.channels.list.iter();
        channels.map(move |c| format!("{part}{}{deep}", c.name))
    });
    let names: Vec<String> = names.collect();
    let more = if names.len() > LISTED { ", …" } else { "" };
    format!("{}{more}", names[..names.len().min(LISTED)].join(", "))
}
