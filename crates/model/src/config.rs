//! What a network is made of: a TOML table with unknown keys rejected, and presets.

use crate::head::{CONTEXT, FEATURES};
use crate::{Error, Result};
use lumi_core::light::RayPattern;
use lumi_core::reprojection;
use serde::{Deserialize, Serialize};

/// A network's architecture; stored with its weights.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ModelConfig {
    /// Width of a token.
    pub dim: usize,
    /// Width of an attention head; divides `dim`.
    pub head_dim: usize,
    /// Blocks of the encoder.
    pub encoder_layers: usize,
    /// Blocks of the Scene Token Editor.
    pub editor_layers: usize,
    /// Blocks of the decoder.
    pub decoder_layers: usize,
    /// Number of learned scene tokens: all of the K that a scene has, unless `view_tokens`.
    pub scene_tokens: usize,
    /// Whether a scene also keeps the encoded tokens of the input views' patches, behind the learned ones. Edits change
    /// them and the decoder sees them like those, so K grows with the inputs. Not in the paper: it lets small, briefly
    /// trained models find their way from pixels to pixels (docs/decisions/0007-view-tokens.md).
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub view_tokens: bool,
    /// Whether attention knows where its tokens are: half of each head's channels is turned by the tokens' frames, the
    /// other half by where a key's ray shows in the query's view. Not in the paper: docs/decisions/0012-depth-anchors.md.
    /// Needs patches of two pixels or more and a `head_dim` that 8 divides.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub anchors: bool,
    /// Streams that a token's channels fall into, with norms, values and MLPs of their own; 1 is the usual block.
    #[serde(default = "one", skip_serializing_if = "is_one")]
    pub streams: usize,
    /// Side of an image patch in pixels.
    pub patch: usize,
    /// Side of the square images it was made for, in pixels.
    pub resolution: usize,
    /// How a pixel's ray is described to the network.
    #[serde(default)]
    pub rays: RayFeatures,
    /// Who attends to whom in the decoder.
    #[serde(default)]
    pub decoder: DecoderAttention,
    /// Whether a second head, made as the first, learns base colour: the explicit albedo of the paper's ablation.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub albedo: bool,
    /// Whether views are rendered twice, with patches half a side apart, and blended, so that patches do not show: for
    /// large patches of small models. Not in the paper, and training looks at single renders.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub overlap: bool,
    /// Whether the decoder is also given the photographs, carried into the target view by geometry alone
    /// ([`lumi_core::reprojection`]): each target pixel comes with what they show there, and what is made of it begins with
    /// that. Scene tokens then keep their photographs. Not in the paper: it spares small models from learning to
    /// copy (docs/decisions/0014-reprojection.md). Needs `anchors` and `output = "radiance"`.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub reprojection: bool,
    /// Whether input views also come with where they see the visual hull of all photographs, so that the encoder begins with
    /// a shape. Needs `reprojection`.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub surface: bool,
    /// Whether target pixels also come with how far their rays are inside the photographs' silhouettes. Needs `reprojection`
    /// ([`lumi_core::reprojection::MARGINS`], docs/decisions/0016-margins.md).
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub margins: bool,
    /// Whether the decoder is also told how direct light falls on the hull: the light of the edits so far, which scene tokens then
    /// keep. Needs `reprojection` ([`lumi_core::reprojection::Surface::lit`], docs/decisions/0015-direct-light.md).
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub direct: bool,
    /// Width of the MLP that finishes each pixel from the head's numbers and what the photographs show there
    /// ([`crate::head::PixelMlp`]); 0 for none. Needs `reprojection`.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub pixel_mlp: usize,
    /// Convolutions of 3 × 3 through which that MLP also sees a pixel's neighbours, one behind each of its first layers: 0 to
    /// [`crate::head::CONTEXT`]. Needs `pixel_mlp` (docs/decisions/0018-neighbours.md).
    #[serde(default, skip_serializing_if = "is_zero")]
    pub pixel_context: usize,
    /// What the head's numbers mean.
    #[serde(default, skip_serializing_if = "Output::is_display")]
    pub output: Output,
    /// From output tokens to pixels.
    pub head: HeadConfig,
    /// From lights to tokens.
    pub lights: LightConfig,
}

fn one() -> usize {
    1
}

fn is_one(n: &usize) -> bool {
    *n == 1
}

fn is_zero(n: &usize) -> bool {
    *n == 0
}

/// What a head's numbers mean.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Output {
    /// Display-encoded RGB over white, as the paper and the authors' checkpoints. Lights are told with their power.
    #[default]
    Display,
    /// Radiance over the scene's illumination scale, and alpha: power and tint of light are exact by construction, and
    /// lights are told by their shape alone (`crate::illumination`, docs/decisions/0013-illumination-scale.md).
    Radiance,
}

impl Output {
    /// Numbers per pixel.
    #[must_use]
    pub fn channels(self) -> usize {
        match self {
            Self::Display => 3,
            Self::Radiance => 4,
        }
    }

    fn is_display(&self) -> bool {
        *self == Self::Display
    }
}

/// How a pixel's ray (origin o, unit direction d, in model space) is described to the network.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum RayFeatures {
    /// Plücker coordinates o × d, d: 6 numbers, as the paper and the authors' checkpoints.
    #[default]
    Plucker,
    /// Plücker coordinates and the ray's point nearest to the origin, c = o − (o·d) d: 9 numbers. Rays of
    /// different views that meet near the scene's centre have alike c, which attention can use at once.
    Nearest,
    /// As `nearest`, with sines and cosines of c at three octaves (π, 2π, 4π): 27 numbers.
    Fourier,
}

impl RayFeatures {
    /// Numbers per ray.
    #[must_use]
    pub fn channels(self) -> usize {
        match self {
            Self::Plucker => 6,
            Self::Nearest => 9,
            Self::Fourier => 27,
        }
    }
}

/// Who attends to whom in the decoder.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum DecoderAttention {
    /// One sequence per view: its tokens and the scene tokens all see each other (as LVSM and the authors).
    #[default]
    Joint,
    /// A view's tokens see the scene's, which the decoder leaves as they are, and themselves.
    OneWay,
}

/// From output tokens to pixels. A new head is one file in `head/` plus one variant.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "type", rename_all = "kebab-case", deny_unknown_fields)]
pub enum HeadConfig {
    /// LayerNorm, linear, sigmoid: each token becomes its patch.
    Mlp,
    /// The authors' DPT head: gated layers fused on the patch grid, then a pixel shuffle.
    Dpt {
        /// Channels of the feature maps.
        features: usize,
        /// Decoder blocks whose outputs are used, 1-based, ascending.
        layers: Vec<usize>,
    },
    /// The paper's words: multi-scale maps from several decoder blocks, fused progressively by convolutions to full resolution.
    DptPyramid {
        /// Channels of the feature maps.
        features: usize,
        /// Decoder blocks whose outputs are used, 1-based, ascending; the shallowest becomes the finest map.
        layers: Vec<usize>,
    },
}

/// What an edit does to the light that is there.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Mode {
    /// Replaces all light.
    Set,
    /// Adds the lights.
    Add,
    /// Takes the lights away.
    Remove,
}

impl Mode {
    /// All modes; the position is the row of the mode's embedding.
    pub const ALL: [Self; 3] = [Self::Set, Self::Add, Self::Remove];
}

/// From lights to tokens.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "encoding", rename_all = "kebab-case", deny_unknown_fields)]
pub enum LightConfig {
    /// Every light becomes Plücker light rays of one format (paper §3.3); version 1 of the feature layout.
    Rays {
        /// Rows and columns of the environment grid.
        environment_grid: [usize; 2],
        /// Rays per point or area light.
        local_rays: usize,
        /// Edit modes it was trained for.
        modes: Vec<Mode>,
    },
    /// The authors' release: camera-aligned environment patches, and rays for local lights.
    #[serde(alias = "release")]
    Authors {
        /// Side of an environment patch in pixels; `None` if it takes no environment maps.
        environment_patch: Option<usize>,
        /// Whether it takes point-light rays.
        point_rays: bool,
        /// One input view's maps instead of every view's.
        single_environment: bool,
    },
}

impl LightConfig {
    /// Edit modes it was trained for.
    #[must_use]
    pub fn modes(&self) -> &[Mode] {
        match self {
            Self::Rays { modes, .. } => modes,
            Self::Authors { .. } => &[Mode::Set],
        }
    }

    /// The same with other edit modes; the authors' encoding knows only one.
    #[must_use]
    pub fn with_modes(&self, with: &[Mode]) -> Self {
        let mut lights = self.clone();
        if let Self::Rays { modes, .. } = &mut lights {
            *modes = with.to_vec();
        }
        lights
    }

    /// How finely lights become rays (`rays` encoding).
    #[must_use]
    pub fn pattern(&self) -> RayPattern {
        match self {
            Self::Rays {
                environment_grid: [rows, columns],
                local_rays,
                ..
            } => RayPattern {
                environment_rows: *rows,
                environment_columns: *columns,
                local_rays: *local_rays,
            },
            Self::Authors { .. } => RayPattern::default(),
        }
    }
}

/// Names and texts of the presets in `configs/model/`.
pub const PRESETS: &[(&str, &str)] = &[
    ("nano", include_str!("../../../configs/model/nano.toml")),
    ("mini", include_str!("../../../configs/model/mini.toml")),
    ("small", include_str!("../../../configs/model/small.toml")),
    (
        "paper-512",
        include_str!("../../../configs/model/paper-512.toml"),
    ),
    (
        "authors-256-mlp",
        include_str!("../../../configs/model/authors-256-mlp.toml"),
    ),
    (
        "authors-512-mlp",
        include_str!("../../../configs/model/authors-512-mlp.toml"),
    ),
    (
        "authors-512-dpt",
        include_str!("../../../configs/model/authors-512-dpt.toml"),
    ),
];

impl ModelConfig {
    /// A preset by name.
    ///
    /// # Errors
    /// Lists the presets if there is none of that name.
    pub fn preset(name: &str) -> Result<Self> {
        let text = PRESETS
            .iter()
            .find(|(n, _)| *n == name)
            .map(|(_, text)| *text);
        let Some(text) = text else {
            let names: Vec<_> = PRESETS.iter().map(|(n, _)| *n).collect();
            let expected = format!("expected one of {}", names.join(", "));
            return Err(Error::config("preset", name, expected));
        };
        Self::from_toml(text, name)
    }

    /// Parses and checks a TOML config; `source` names it in errors.
    ///
    /// # Errors
    /// On syntax, unknown or missing keys, and values that do not fit together.
    pub fn from_toml(text: &str, source: &str) -> Result<Self> {
        let config: Self =
            toml::from_str(text).map_err(|e| Error::config(source, "model", e.to_string()))?;
        config.validate(source)?;
        Ok(config)
    }

    /// Checks that the values fit together.
    ///
    /// # Errors
    /// Names the field and what was expected.
    pub fn validate(&self, source: &str) -> Result<()> {
        let error = |field: &str, expected: String| Err(Error::config(source, field, expected));
        let positive = [
            ("dim", self.dim),
            ("head_dim", self.head_dim),
            ("encoder_layers", self.encoder_layers),
            ("decoder_layers", self.decoder_layers),
            ("scene_tokens", self.scene_tokens),
            ("patch", self.patch),
            ("resolution", self.resolution),
        ];
        // Far above any use; it stops a hostile config from asking for absurd allocations.
        const LIMIT: usize = 65_536;
        for (field, value) in positive {
            if value == 0 || value > LIMIT {
                return error(field, format!("expected 1 to {LIMIT}, found {value}"));
            }
        }
        if self.editor_layers > LIMIT {
            return error("editor_layers", format!("expected 0 to {LIMIT}"));
        }
        if !self.dim.is_multiple_of(self.head_dim) {
            let expected = format!(
                "expected a divisor of dim = {}, found {}",
                self.dim, self.head_dim
            );
            return error("head_dim", expected);
        }
        if self.overlap && !self.patch.is_multiple_of(2) {
            let expected = format!("expected false, since patch = {} has no half", self.patch);
            return error("overlap", expected);
        }
        if self.anchors && (self.patch < 2 || !self.head_dim.is_multiple_of(8)) {
            let (patch, head_dim) = (self.patch, self.head_dim);
            let expected = format!(
                "expected patch = 2 or more and head_dim a multiple of 8, found {patch} and {head_dim}"
            );
            return error("anchors", expected);
        }
        if !(1..=8).contains(&self.streams) || !self.head_dim.is_multiple_of(4 * self.streams) {
            let (streams, head_dim) = (self.streams, self.head_dim);
            let expected = format!(
                "expected 1 to 8 streams of which each has a multiple of 4 of head_dim = {head_dim} channels, found {streams}"
            );
            return error("streams", expected);
        }
        if self.anchors && self.decoder == DecoderAttention::Joint {
            return error("anchors", "expected false, or decoder = \"one-way\"".into());
        }
        if self.reprojection && !(self.anchors && self.output == Output::Radiance) {
            let expected = "expected false, or anchors = true and output = \"radiance\"";
            return error("reprojection", expected.into());
        }
        let told = [
            ("surface", self.surface),
            ("margins", self.margins),
            ("direct", self.direct),
        ];
        for (field, value) in told {
            if value && !self.reprojection {
                return error(field, "expected false, or reprojection = true".into());
            }
        }
        if self.pixel_mlp > LIMIT || (self.pixel_mlp > 0 && !self.reprojection) {
            let expected = format!("expected 0, or reprojection = true and at most {LIMIT}");
            return error("pixel_mlp", expected);
        }
        if self.pixel_context > CONTEXT || (self.pixel_context > 0 && self.pixel_mlp == 0) {
            let expected = format!("expected 0, or a pixel_mlp and at most {CONTEXT}");
            return error("pixel_context", expected);
        }
        if self.output == Output::Radiance {
            let rays = matches!(self.lights, LightConfig::Rays { .. });
            if self.head != HeadConfig::Mlp || !rays {
                let expected = "expected \"display\", or an `mlp` head and lights as `rays`";
                return error("output", expected.into());
            }
        }
        if !self.resolution.is_multiple_of(self.patch) {
            let expected = format!(
                "expected a multiple of patch = {}, found {}",
                self.patch, self.resolution
            );
            return error("resolution", expected);
        }
        if let HeadConfig::Dpt { features, layers } | HeadConfig::DptPyramid { features, layers } =
            &self.head
        {
            if *features == 0 || *features > LIMIT {
                return error(
                    "head.features",
                    format!("expected 1 to {LIMIT}, found {features}"),
                );
            }
            let ascending = layers.windows(2).all(|w| w[0] < w[1]);
            let inside = layers.iter().all(|l| (1..=self.decoder_layers).contains(l));
            let pyramid = matches!(self.head, HeadConfig::DptPyramid { .. });
            if pyramid && layers.len() > 1 + self.patch.ilog2() as usize {
                let most = 1 + self.patch.ilog2();
                let expected = format!(
                    "expected at most {most}: each doubles the resolution, up to patch = {}",
                    self.patch
                );
                return error("head.layers", expected);
            }
            if layers.is_empty() || !ascending || !inside {
                let expected = format!(
                    "expected ascending block numbers from 1 to decoder_layers = {}, found {layers:?}",
                    self.decoder_layers
                );
                return error("head.layers", expected);
            }
        }
        match &self.lights {
            LightConfig::Rays {
                environment_grid,
                local_rays,
                modes,
                ..
            } => {
                if environment_grid.iter().any(|n| *n == 0 || *n > 1024) {
                    return error(
                        "lights.environment_grid",
                        "expected 1 to 1024 each way".into(),
                    );
                }
                if *local_rays == 0 || *local_rays > LIMIT {
                    return error("lights.local_rays", format!("expected 1 to {LIMIT}"));
                }
                if modes.is_empty() {
                    return error("lights.modes", "expected at least one edit mode".into());
                }
            }
            LightConfig::Authors {
                environment_patch,
                point_rays,
                ..
            } => {
                if environment_patch.is_none() && !point_rays {
                    return error("lights", "expected environment_patch or point_rays".into());
                }
                if matches!(environment_patch, Some(p) if *p == 0 || 256 % *p != 0) {
                    let expected = "expected a divisor of 256, the rows of a map";
                    return error("lights.environment_patch", expected.into());
                }
            }
        }
        Ok(())
    }

    /// Weights of the blocks' matrices, the scene tokens, the tokenizers and the first matrices of the head: a lower
    /// bound of all weights, exact enough to tell that a file cannot hold them.
    #[must_use]
    pub fn least_weights(&self) -> u128 {
        let blocks = (self.encoder_layers + self.editor_layers + self.decoder_layers) as u128;
        let d = self.dim as u128;
        let tokenizers =
            (self.posed_channels() + self.told_channels()) as u128 * (self.patch as u128).pow(2);
        let lights = match self.lights {
            LightConfig::Authors {
                environment_patch: Some(p),
                ..
            } => 9 * (p as u128).pow(2),
            _ => 0,
        };
        let head = match &self.head {
            HeadConfig::Mlp => 3 * (self.patch as u128).pow(2),
            HeadConfig::Dpt { features, layers } | HeadConfig::DptPyramid { features, layers } => {
                (*features * layers.len()) as u128
            }
        };
        let each = 2 * d * d + 10 * d * d / self.streams as u128;
        each * blocks + d * (self.scene_tokens as u128 + tokenizers + lights + head)
    }

    /// Whether input pictures come with their alpha, so that a white object is told from a white background.
    #[must_use]
    pub fn takes_alpha(&self) -> bool {
        self.output == Output::Radiance
    }

    /// Numbers per pixel of a posed input picture: colours, alpha where it is taken, ray features, and where it sees the hull
    /// for models that are told.
    #[must_use]
    pub fn posed_channels(&self) -> usize {
        3 + usize::from(self.takes_alpha()) + self.rays.channels() + usize::from(self.surface)
    }

    /// Numbers per pixel of a target view: ray features; how direct light falls there, for models that are told; and what the
    /// photographs show there, for models that are given them.
    #[must_use]
    pub fn target_channels(&self) -> usize {
        let [rays, direct, carried] = self.target_parts();
        rays + direct + carried
    }

    /// Those of each of the three.
    #[must_use]
    pub fn target_parts(&self) -> [usize; 3] {
        let where_so = |so: bool, channels: usize| if so { channels } else { 0 };
        let direct = where_so(self.direct, reprojection::DIRECT);
        let without = where_so(!self.margins, reprojection::MARGINS);
        let carried = where_so(self.reprojection, reprojection::CHANNELS - without);
        [self.rays.channels(), direct, carried]
    }

    /// The first so many of them make target tokens.
    #[must_use]
    pub fn told_channels(&self) -> usize {
        let [rays, direct, carried] = self.target_parts();
        rays + direct + carried.min(self.surface_channels())
    }

    /// Numbers per pixel that photographs tell of the surface and of the silhouettes; those of each photograph follow.
    #[must_use]
    pub fn surface_channels(&self) -> usize {
        let margins = if self.margins {
            reprojection::MARGINS
        } else {
            0
        };
        reprojection::SURFACE + margins
    }

    /// Numbers per pixel that the head makes: those of the output, as many factors of what the photographs show, and what the
    /// pixel's MLP is told.
    #[must_use]
    pub fn head_channels(&self) -> usize {
        let features = if self.pixel_mlp > 0 { FEATURES } else { 0 };
        self.output.channels() * if self.reprojection { 2 } else { 1 } + features
    }

    /// Scene tokens K of a scene whose inputs have `patches` patches together.
    #[must_use]
    pub fn scene_length(&self, patches: usize) -> usize {
        self.scene_tokens + if self.view_tokens { patches } else { 0 }
    }

    /// Checks the number of a scene's tokens.
    ///
    /// # Errors
    /// Says what was expected.
    pub(crate) fn check_scene(&self, tokens: usize) -> lumi_core::Result<()> {
        let learned = self.scene_tokens;
        let (fits, more) = match self.view_tokens {
            true => (tokens > learned, "more than "),
            false => (tokens == learned, ""),
        };
        if fits {
            return Ok(());
        }
        let expected = format!("expected {more}{learned} scene tokens, found {tokens}");
        Err(lumi_core::Error::value("tokens", expected))
    }

    /// Tokens of a `width × height` image.
    #[must_use]
    pub fn image_tokens(&self, width: usize, height: usize) -> usize {
        (width / self.patch) * (height / self.patch)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn presets_are_valid_and_round_trip() {
        for (name, _) in PRESETS {
            let config = ModelConfig::preset(name).expect(name);
            let text = toml::to_string(&config).expect("serialises");
            assert_eq!(ModelConfig::from_toml(&text, name).expect(name), config);
        }
    }

    #[test]
    fn unknown_keys_and_misfits_are_named() {
        let text = PRESETS[0].1;
        let error = ModelConfig::from_toml(&format!("colour = 3\n{text}"), "x.toml")
            .expect_err("unknown key")
            .to_string();
        assert!(
            error.contains("x.toml") && error.contains("colour"),
            "{error}"
        );
        let mut config = ModelConfig::preset("nano").expect("nano");
        config.head_dim = 7;
        assert!(
            config
                .validate("x")
                .expect_err("misfit")
                .to_string()
                .contains("head_dim")
        );
        config = ModelConfig::preset("nano").expect("nano");
        config.head = HeadConfig::Dpt {
            features: 8,
            layers: vec![1, 99],
        };
        assert!(
            config
                .validate("x")
                .expect_err("layers")
                .to_string()
                .contains("head.layers")
        );
        for (head_dim, patch) in [(4, 4), (16, 1)] {
            config = ModelConfig::preset("nano").expect("nano");
            config.decoder = DecoderAttention::OneWay;
            (config.anchors, config.head_dim, config.patch) = (true, head_dim, patch);
            let error = config.validate("x").expect_err("no anchors").to_string();
            assert!(
                error.contains("anchors") && error.contains("expected"),
                "{error}"
            );
        }
    }

    #[test]
    fn large_tokenizers_and_deep_pyramids_are_seen() {
        let nano = ModelConfig::preset("nano").expect("nano");
        let coarse = ModelConfig {
            patch: 4096,
            resolution: 4096,
            ..nano.clone()
        };
        let pixels = 4096 * 4096;
        assert!(coarse.least_weights() > (nano.dim * 3 * pixels) as u128);
        let deep = ModelConfig {
            decoder_layers: 9,
            head: HeadConfig::DptPyramid {
                features: 4,
                layers: (1..=9).collect(),
            },
            ..nano
        };
        let error = deep.validate("x").expect_err("deep").to_string();
        assert!(error.contains("head.layers"), "{error}");
    }
}
