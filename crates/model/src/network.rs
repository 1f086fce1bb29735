//! The whole network: encode, edit, decode.

use crate::block::{Block, KeyValues};
use crate::config::{DecoderAttention, Mode};
use crate::frames::{self, Frames};
use crate::head::{Head, HeadInput};
use crate::layers::{LayerNorm, Linear, normal};
use crate::lights::{EditLight, LightTokenizer, seen_from};
use crate::{Error, ModelConfig, Result};
use burn::module::{Module, Param};
use burn::tensor::{Device, Tensor};
use lumi_core::Seed;
use lumi_core::seed::Rng;
use lumi_kernels::{FRAME, Pattern, Precision, Save};

/// The network's weights.
#[derive(Module, Debug)]
pub struct Network {
    /// Learned start of the scene tokens, `[K, d]`.
    pub latents: Param<Tensor<2>>,
    /// Posed image patches, `[d, (3 + c)·p²]` with c the ray features.
    pub image: Linear,
    /// Target ray patches, `[d, c·p²]`.
    pub ray: Linear,
    /// Lights to tokens.
    pub lights: LightTokenizer,
    /// Encoder blocks.
    pub encoder: Vec<Block>,
    /// Scene Token Editor blocks.
    pub editor: Vec<Block>,
    /// Norm before the decoder blocks.
    pub decoder_norm: LayerNorm,
    /// Decoder blocks.
    pub decoder: Vec<Block>,
    /// Tokens to pixels.
    pub head: Head,
    /// Tokens to base colour, where the config has `albedo`.
    pub albedo: Option<Head>,
}

/// The parts of a network that training may freeze.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Part {
    /// Latents, image tokenizer, encoder.
    Encoder,
    /// Light tokenizers, editor.
    Editor,
    /// Ray tokenizer, decoder.
    Decoder,
    /// Tokens to pixels.
    Head,
    /// Tokens to base colour.
    Albedo,
}

impl Part {
    /// The part that a parameter belongs to, by its name.
    #[must_use]
    pub fn of(name: &str) -> Self {
        match name.split('.').next().unwrap_or_default() {
            "latents" | "image" | "encoder" => Self::Encoder,
            "lights" | "editor" => Self::Editor,
            "head" => Self::Head,
            "albedo" => Self::Albedo,
            _ => Self::Decoder,
        }
    }
}

impl Network {
    /// Random weights. Standard deviations are the release's at its width of 768 and grow as
    /// 1/√d for narrower networks, so that activations start alike at every size.
    #[must_use]
    pub fn new(config: &ModelConfig, seed: Seed, device: &Device) -> Self {
        let base = 0.02 * (768.0 / config.dim as f32).sqrt();
        Self::with_std(config, base, &mut seed.stream("weights"), device)
    }

    /// A network of zeros, for weights to be loaded into.
    #[must_use]
    pub fn blank(config: &ModelConfig, device: &Device) -> Self {
        Self::with_std(config, 0.0, &mut Seed(0).stream("weights"), device)
    }

    fn with_std(config: &ModelConfig, base: f32, rng: &mut Rng, device: &Device) -> Self {
        let (d, patch) = (config.dim, config.patch * config.patch);
        let rays = config.rays.channels();
        let mut stack = |layers: usize, scale: f32| -> Vec<Block> {
            let std = |i: usize| scale * base / (2.0 * (i + 1) as f32).sqrt();
            (0..layers)
                .map(|i| Block::new(d, config.head_dim, std(i), rng, device))
                .collect()
        };
        let (encoder, editor, decoder) = (
            stack(config.encoder_layers, 1.0),
            stack(config.editor_layers, 0.1),
            stack(config.decoder_layers, 1.0),
        );
        Self {
            latents: normal([config.scene_tokens, d], base, rng, device),
            image: Linear::new(d, (3 + rays) * patch, base, rng, device),
            ray: Linear::new(d, rays * patch, base, rng, device),
            lights: LightTokenizer::new(&config.lights, d, base, rng, device),
            encoder,
            editor,
            decoder_norm: LayerNorm::new(d, device),
            decoder,
            head: Head::new(config, base, rng, device),
            // Last, so that the other weights are the same with and without it.
            albedo: config.albedo.then(|| Head::new(config, base, rng, device)),
        }
    }

    /// The network with this precision of matrix operands where our kernels run.
    #[must_use]
    pub fn with_precision(mut self, precision: Precision) -> Self {
        self.blocks().for_each(|b| b.precision = precision);
        self
    }

    /// The network with less kept for the backward pass where our kernels run: see [`Save`].
    #[must_use]
    pub fn with_save(mut self, save: Save) -> Self {
        self.blocks().for_each(|b| b.save = save);
        self
    }

    /// The network with its blocks packed for inference ([`Block::pack`]); its weights must not change afterwards.
    #[must_use]
    pub fn packed(mut self) -> Self {
        self.blocks().for_each(Block::pack);
        self
    }

    pub(crate) fn precision(&self) -> Precision {
        self.decoder.first().map_or(Precision::F32, |b| b.precision)
    }

    fn blocks(&mut self) -> impl Iterator<Item = &mut Block> {
        let stacks = [&mut self.encoder, &mut self.editor, &mut self.decoder];
        stacks.into_iter().flatten()
    }

    /// Scene tokens of posed views.
    ///
    /// # Shapes
    /// posed `[b, v, 3 + c, h, w]` → `[b, K, w]`, K = [`ModelConfig::scene_length`], w = [`ModelConfig::token_width`]
    #[must_use]
    pub fn encode(&self, posed: Tensor<5>, config: &ModelConfig) -> Tensor<3> {
        let [b, _, c, ..] = posed.dims();
        let k = config.scene_tokens;
        let places = config.frames.then(|| {
            let rays = posed.clone().narrow(2, 3, c - 3);
            let learned = frames::of_model_space(b, k, &posed.device());
            Tensor::cat(vec![learned, frames::of_rays(rays, config.patch)], 1)
        });
        let tokens = self.image.forward(patches(posed, config.patch));
        let d = tokens.dims()[2];
        let latents = self.latents.val().unsqueeze::<3>().expand([b, k, d]);
        let kept = config.scene_length(tokens.dims()[1]);
        let tokens = Tensor::cat(vec![latents, tokens], 1);
        run_and_keep(&self.encoder, tokens, places, kept)
    }

    /// Scene tokens under other light. Light tokens take part in the attention and are then dropped; the light's
    /// moments, in networks that take them, are added to the scene's tokens before.
    ///
    /// # Shapes
    /// scene `[b, K, w]`, light's tokens `[b, m, d]` → `[b, K, w]`
    #[must_use]
    pub fn edit(&self, scene: Tensor<3>, light: impl Into<EditLight>) -> Tensor<3> {
        let EditLight {
            tokens: light,
            moments,
        } = light.into();
        let [b, m, d] = light.dims();
        let kept = scene.dims()[1];
        let (mut scene, places) = parted(scene, d);
        if let (Some(moments), LightTokenizer::Rays(rays)) = (moments, &self.lights)
            && let Some(linear) = &rays.moments
        {
            scene = scene + linear.forward(seen_from(moments, places.clone()));
        }
        let places = places.map(|places| {
            let of_lights = frames::of_model_space(b, m, &places.device());
            Tensor::cat(vec![places, of_lights], 1)
        });
        run_and_keep(
            &self.editor,
            Tensor::cat(vec![scene, light], 1),
            places,
            kept,
        )
    }

    /// An edit's light from its ray features.
    ///
    /// # Shapes
    /// features `[b, rays, 10]` → tokens `[b, rays, d]`
    ///
    /// # Errors
    /// If the network has the release's light tokenizers.
    pub fn light_tokens(&self, features: Tensor<3>, mode: Mode) -> Result<EditLight> {
        match &self.lights {
            LightTokenizer::Rays(rays) => Ok(rays.forward(features, mode)),
            LightTokenizer::Release(_) => Err(Error::Unsupported(
                "this model takes the release's light encoding, not unified light rays".into(),
            )),
        }
    }

    /// Images seen along target rays.
    ///
    /// # Shapes
    /// scene `[b, K, w]`, rays `[b, v, c, h, w]` → `[b, v, 3, h, w]`, display-encoded in (0, 1)
    #[must_use]
    pub fn decode(&self, scene: Tensor<3>, rays: Tensor<5>, config: &ModelConfig) -> Tensor<5> {
        let [b, v, _, h, w] = rays.dims();
        let input = self.decoder_tokens(scene, rays, config);
        self.head
            .forward(input, config.patch)
            .reshape([b, v, 3, h, w])
    }

    /// What the decoder can work out of the scene alone, for [`Self::decode_prepared`].
    ///
    /// # Shapes
    /// scene `[b, K, w]`
    #[must_use]
    pub fn prepare(&self, scene: Tensor<3>, config: &ModelConfig) -> Prepared {
        match config.decoder {
            DecoderAttention::Joint => Prepared::Scene(Box::new(scene)),
            DecoderAttention::Cached => {
                let (scene, places) = parted(scene, config.dim);
                let frames = places.map(Frames::new);
                let mut x = self.decoder_norm.forward(scene);
                let mut cache = Vec::with_capacity(self.decoder.len());
                if let Some((last, earlier)) = self.decoder.split_last() {
                    for block in earlier {
                        let (y, kept) = block.context(x, frames.as_ref());
                        cache.push(kept);
                        x = y;
                    }
                    // Nobody reads what the scene's tokens become in the end.
                    cache.push(last.key_values(x, frames.as_ref()));
                }
                Prepared::Cache(cache)
            }
        }
    }

    /// As [`Self::decode`], with the scene's part done before, once for all views.
    ///
    /// # Shapes
    /// rays `[b, v, c, h, w]` → `[b, v, 3, h, w]`, display-encoded in (0, 1)
    #[must_use]
    pub fn decode_prepared(
        &self,
        scene: &Prepared,
        rays: Tensor<5>,
        config: &ModelConfig,
    ) -> Tensor<5> {
        let cache = match scene {
            Prepared::Scene(scene) => return self.decode((**scene).clone(), rays, config),
            Prepared::Cache(cache) => cache,
        };
        let [b, v, _, h, w] = rays.dims();
        let views = Views::new(&rays, config, self.precision());
        let frames = config
            .frames
            .then(|| Frames::new(frames::of_rays(rays.clone(), config.patch)));
        let targets = self.ray.forward(patches(rays, config.patch));
        let tokens = self.through_decoder(targets, &views, 0, config, |i, x| {
            self.decoder[i].against(x, views.tokens(), &cache[i], frames.as_ref())
        });
        self.head
            .forward(tokens, config.patch)
            .reshape([b, v, 3, h, w])
    }

    /// What the head works on, views as rows `b·v`.
    ///
    /// # Shapes
    /// scene `[b, K, w]`, rays `[b, v, c, h, w]`
    #[must_use]
    pub fn decoder_tokens(
        &self,
        scene: Tensor<3>,
        rays: Tensor<5>,
        config: &ModelConfig,
    ) -> HeadInput {
        let [b, v, ..] = rays.dims();
        let (k, d) = (scene.dims()[1], config.dim);
        let (scene, places) = parted(scene, d);
        let places = places.map(|places| (places, frames::of_rays(rays.clone(), config.patch)));
        let views = Views::new(&rays, config, self.precision());
        let n = views.tokens();
        let targets = self.ray.forward(patches(rays, config.patch));
        // Where the views' tokens begin: after the scene's, or, with a sequence per view, before them.
        let (sequence, places, context, group, first) = match config.decoder {
            DecoderAttention::Joint => {
                let per_view = |scene: Tensor<3>, targets: Tensor<3>| {
                    let width = scene.dims()[2];
                    let targets = targets.reshape([b * v, n, width]);
                    let scene = scene
                        .unsqueeze_dim::<4>(1)
                        .expand([b, v, k, width])
                        .reshape([b * v, k, width]);
                    Tensor::cat(vec![targets, scene], 1)
                };
                let places = places.map(|(scene, targets)| per_view(scene, targets));
                (per_view(scene, targets), places, n + k, 0, 0)
            }
            DecoderAttention::Cached => {
                let places = places.map(|(scene, targets)| Tensor::cat(vec![scene, targets], 1));
                (Tensor::cat(vec![scene, targets], 1), places, k, n, k)
            }
        };
        let frames = places.map(Frames::new);
        self.through_decoder(sequence, &views, first, config, |i, x| {
            self.decoder[i].forward(x, Pattern { context, group }, frames.as_ref())
        })
    }

    /// Norm and blocks over `tokens` `[s, _, d]`, in which the views' begin at `first`; `block` runs the i-th.
    fn through_decoder(
        &self,
        tokens: Tensor<3>,
        views: &Views,
        first: usize,
        config: &ModelConfig,
        block: impl Fn(usize, Tensor<3>) -> Tensor<3>,
    ) -> HeadInput {
        let mut x = self.decoder_norm.forward(tokens);
        let mut taps = Vec::new();
        for i in 0..self.decoder.len() {
            x = block(i, x);
            if config.head.layers().contains(&(i + 1)) {
                taps.push(views.split(&x, first));
            }
        }
        views.head_input(&x, first, taps)
    }
}

/// A scene made ready for views of it.
#[derive(Clone, Debug)]
pub enum Prepared {
    /// `joint` decoders: the scene tokens, since what the decoder makes of them differs from view to view.
    Scene(Box<Tensor<3>>),
    /// `cached` decoders: the scene's keys and values in each decoder block.
    Cache(Vec<KeyValues>),
}

/// How many views of what size: how the decoder's tokens become the head's.
struct Views {
    /// Samples times views.
    count: usize,
    rows: usize,
    columns: usize,
    precision: Precision,
}

impl Views {
    fn new(rays: &Tensor<5>, config: &ModelConfig, precision: Precision) -> Self {
        let [b, v, _, h, w] = rays.dims();
        Self {
            count: b * v,
            rows: h / config.patch,
            columns: w / config.patch,
            precision,
        }
    }

    /// Tokens of one view.
    fn tokens(&self) -> usize {
        self.rows * self.columns
    }

    /// The views' tokens, which begin at `first`: `[s, _, d]` → `[count, tokens, d]`.
    fn split(&self, x: &Tensor<3>, first: usize) -> Tensor<3> {
        let [sequences, _, d] = x.dims();
        let n = self.tokens();
        x.clone()
            .narrow(1, first, self.count / sequences * n)
            .reshape([self.count, n, d])
    }

    fn head_input(&self, x: &Tensor<3>, first: usize, taps: Vec<Tensor<3>>) -> HeadInput {
        HeadInput {
            last: self.split(x, first),
            taps,
            precision: self.precision,
            rows: self.rows,
            columns: self.columns,
        }
    }
}

/// A scene's channels, `d` of them, and behind them the frames, if it has any.
fn parted(scene: Tensor<3>, d: usize) -> (Tensor<3>, Option<Tensor<3>>) {
    if scene.dims()[2] == d {
        return (scene, None);
    }
    let places = scene.clone().narrow(2, d, FRAME);
    (scene.narrow(2, 0, d), Some(places))
}

/// Runs `blocks` over `tokens` `[b, n, d]` with full attention and returns the first `kept`, their `places` `[b, n, 12]`
/// behind them.
fn run_and_keep(
    blocks: &[Block],
    tokens: Tensor<3>,
    places: Option<Tensor<3>>,
    kept: usize,
) -> Tensor<3> {
    let pattern = Pattern {
        context: tokens.dims()[1],
        group: 0,
    };
    let frames = places.clone().map(Frames::new);
    let tokens = blocks
        .iter()
        .fold(tokens, |x, block| {
            block.forward(x, pattern, frames.as_ref())
        })
        .narrow(1, 0, kept);
    match places {
        Some(places) => Tensor::cat(vec![tokens, places.narrow(1, 0, kept)], 2),
        None => tokens,
    }
}

/// Non-overlapping patches, row-major; inside a patch: row, column, channel fastest.
///
/// # Shapes
/// `[b, v, c, h, w]` → `[b, v·(h/p)·(w/p), p·p·c]`
#[must_use]
pub fn patches(images: Tensor<5>, p: usize) -> Tensor<3> {
    let [b, v, c, h, w] = images.dims();
    assert!(
        h.is_multiple_of(p) && w.is_multiple_of(p),
        "image side must be a multiple of the patch"
    );
    let (rows, columns) = (h / p, w / p);
    images
        .reshape([b * v, c, rows, p, columns, p])
        .permute([0, 2, 4, 3, 5, 1])
        .reshape([b, v * rows * columns, p * p * c])
}
