//! The whole network: encode, edit, decode.

use crate::block::{Block, KeyValues};
use crate::config::{DecoderAttention, Mode};
use crate::head::{Head, HeadInput, PixelMlp};
use crate::layers::{LayerNorm, Linear, normal};
use crate::lights::{EditLight, LightShape, LightTokenizer, MOMENTS, RayTokenizer, seen_from};
use crate::places::{Places, Sight};
use crate::{Error, ModelConfig, Result};
use burn::module::{Module, Param};
use burn::tensor::{Device, Tensor, TensorData};
use lumi_core::seed::Rng;
use lumi_core::{Camera, Seed};
use lumi_kernels::{Precision, Save};
use std::sync::Arc;

/// The network's weights.
#[derive(Module, Debug)]
pub struct Network {
    /// Learned start of the scene tokens, `[K, d]`.
    pub latents: Param<Tensor<2>>,
    /// Posed image patches, `[d, c·p²]` with c = [`ModelConfig::posed_channels`].
    pub image: Linear,
    /// Target view patches, `[d, c·p²]` with c = [`ModelConfig::told_channels`].
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
    /// What finishes each pixel, where the config has `pixel_mlp`.
    pub pixel: Option<PixelMlp>,
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
            "head" | "pixel" => Self::Head,
            "albedo" => Self::Albedo,
            _ => Self::Decoder,
        }
    }
}

impl Network {
    /// Random weights. Standard deviations are the authors' at its width of 768 and grow as
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
        let told = config.told_channels();
        let mut stack = |layers: usize, scale: f32| -> Vec<Block> {
            let std = |i: usize| scale * base / (2.0 * (i + 1) as f32).sqrt();
            (0..layers)
                .map(|i| Block::new(d, config.head_dim, config.streams, std(i), rng, device))
                .collect()
        };
        let (encoder, editor, decoder) = (
            stack(config.encoder_layers, 1.0),
            stack(config.editor_layers, 0.1),
            stack(config.decoder_layers, 1.0),
        );
        Self {
            latents: normal([config.scene_tokens, d], base, rng, device),
            image: Linear::new(d, config.posed_channels() * patch, base, rng, device),
            ray: Linear::new(d, told * patch, base, rng, device),
            lights: LightTokenizer::new(config, base, rng, device),
            encoder,
            editor,
            decoder_norm: LayerNorm::new(d, device),
            decoder,
            head: Head::new(config, config.head_channels(), base, rng, device),
            // Last, so that the other weights are the same with and without them.
            albedo: config
                .albedo
                .then(|| Head::new(config, 3, base, rng, device)),
            pixel: (config.pixel_mlp > 0).then(|| PixelMlp::new(config, rng, device)),
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
    /// posed `[b, v, ModelConfig::posed_channels, h, w]`, their `[b, v]` cameras in model space (which nobody reads without `anchors`) →
    /// `[b, K, d]`, K = [`ModelConfig::scene_length`]
    #[must_use]
    pub fn encode(&self, posed: Tensor<5>, cameras: &[Camera], config: &ModelConfig) -> Scene {
        let b = posed.dims()[0];
        let k = config.scene_tokens;
        let tokens = self.image.forward(patches(posed, config.patch));
        let d = tokens.dims()[2];
        let latents = self.latents.val().unsqueeze::<3>().expand([b, k, d]);
        let kept = config.scene_length(tokens.dims()[1]);
        let places = config
            .anchors
            .then(|| Arc::new(Places::new(b, k, cameras, config.patch)));
        let sight = places
            .as_ref()
            .map(|p| p.among_themselves(0, config.head_dim));
        let tokens = Tensor::cat(vec![latents, tokens], 1);
        let channels = run(&self.encoder, tokens, sight.as_ref()).narrow(1, 0, kept);
        let places = places.map(|places| match config.view_tokens {
            true => places,
            false => Arc::new(Places::new(b, k, &[], config.patch)),
        });
        Scene { channels, places }
    }

    /// Scene tokens under other light. Light tokens take part in the attention and are then dropped. Where the light is told
    /// by its shape, its moments are added to the scene's tokens before, and its share says how far they change.
    ///
    /// # Shapes
    /// scene `[b, K, d]`, light's tokens `[b, m, d]` → `[b, K, d]`
    #[must_use]
    pub fn edit(&self, scene: &Scene, light: impl Into<EditLight>, config: &ModelConfig) -> Scene {
        let EditLight { tokens, shapes } = light.into();
        let [b, kept, _] = scene.channels.dims();
        let sight = scene
            .places
            .as_ref()
            .map(|p| p.among_themselves(tokens.dims()[1], config.head_dim));
        let before = scene.channels.clone();
        let mut told = before.clone();
        if let (Some(shapes), LightTokenizer::Rays(rays)) = (&shapes, &self.lights)
            && let Some(linear) = &rays.moments
        {
            let moments = seen_by(scene, shapes, &told.device());
            told = told + linear.forward(moments);
        }
        let tokens = Tensor::cat(vec![told, tokens], 1);
        let after = run(&self.editor, tokens, sight.as_ref()).narrow(1, 0, kept);
        let channels = match shapes {
            Some(shapes) => {
                let reach: Vec<f32> = shapes.iter().map(|(_, reach)| *reach).collect();
                let reach =
                    Tensor::<3>::from_data(TensorData::new(reach, [b, 1, 1]), &after.device());
                before.clone() + (after - before) * reach
            }
            None => after,
        };
        Scene {
            channels,
            places: scene.places.clone(),
        }
    }

    /// An edit's light from its ray features, for networks that are told lights with their power.
    ///
    /// # Shapes
    /// features `[b, rays, 10]` → tokens `[b, rays, d]`
    ///
    /// # Errors
    /// If the network has other light tokenizers.
    pub fn light_tokens(&self, features: Tensor<3>, mode: Mode) -> Result<EditLight> {
        let rays = self.ray_tokenizer()?;
        match rays.moments {
            None => Ok(rays.forward(features, mode).into()),
            Some(_) => Err(Error::Unsupported(
                "this model is told lights by their shape, not by ray features with power".into(),
            )),
        }
    }

    /// An edit's light, a shape for each sample, for networks with `output = "radiance"`.
    ///
    /// # Errors
    /// If the network has other light tokenizers.
    pub fn shaped_light(&self, shapes: &[LightShape], mode: Mode) -> Result<EditLight> {
        let rays = self.ray_tokenizer()?;
        match rays.moments {
            Some(_) => Ok(rays.of_shapes(shapes, mode)),
            None => Err(Error::Unsupported(
                "this model is told lights with their power, not by their shape".into(),
            )),
        }
    }

    fn ray_tokenizer(&self) -> Result<&RayTokenizer> {
        match &self.lights {
            LightTokenizer::Rays(rays) => Ok(rays),
            LightTokenizer::Authors(_) => Err(Error::Unsupported(
                "this model takes the authors' light encoding, not unified light rays".into(),
            )),
        }
    }

    /// Pictures seen along target rays, as [`crate::config::Output`] says; radiance as [`crate::radiance`] does.
    ///
    /// # Shapes
    /// scene `[b, K, d]`, targets `[b, v, c, h, w]` with c = [`ModelConfig::target_channels`] (rays, and what photographs show
    /// there: [`crate::batch::targets`]) and their `[b, v]` cameras in model space (which nobody reads without
    /// `anchors`) → `[b, v, 3 or 4, h, w]`
    #[must_use]
    pub fn decode(
        &self,
        scene: &Scene,
        targets: Tensor<5>,
        cameras: &[Camera],
        config: &ModelConfig,
    ) -> Tensor<5> {
        let input = self.decoder_tokens(scene, targets.clone(), cameras, config);
        self.picture(&input, targets, config)
    }

    /// What the decoder can work out of the scene alone, for [`Self::decode_prepared`].
    #[must_use]
    pub fn prepare(&self, scene: &Scene, config: &ModelConfig) -> Prepared {
        match config.decoder {
            DecoderAttention::Joint => Prepared::Scene(Box::new(scene.clone())),
            DecoderAttention::OneWay => {
                let sight = scene.places.as_ref().map(|places| places.as_keys());
                let x = self.decoder_norm.forward(scene.channels.clone());
                let keys = |block: &Block| block.key_values(x.clone(), sight.as_ref());
                Prepared::Cache(
                    self.decoder.iter().map(keys).collect(),
                    scene.places.clone(),
                )
            }
        }
    }

    /// As [`Self::decode`], with the scene's part done before, once for all views.
    ///
    /// # Shapes
    /// targets `[b, v, c, h, w]` → `[b, v, 3 or 4, h, w]`
    #[must_use]
    pub fn decode_prepared(
        &self,
        scene: &Prepared,
        targets: Tensor<5>,
        cameras: &[Camera],
        config: &ModelConfig,
    ) -> Tensor<5> {
        let logits = self.logits_prepared(scene, targets.clone(), cameras, config);
        self.shown(logits, behind_rays(targets, config), 1, config)
    }

    /// The head's numbers, of which [`Self::shown`] makes the pictures of [`Self::decode_prepared`].
    ///
    /// # Shapes
    /// targets `[b, v, c, h, w]` → `[b, v, ModelConfig::head_channels, h, w]`
    #[must_use]
    pub fn logits_prepared(
        &self,
        scene: &Prepared,
        targets: Tensor<5>,
        cameras: &[Camera],
        config: &ModelConfig,
    ) -> Tensor<5> {
        let (cache, places) = match scene {
            Prepared::Scene(scene) => {
                let size = targets.dims();
                let tokens = self.decoder_tokens(scene, targets, cameras, config);
                return self.logits(&tokens, size, config);
            }
            Prepared::Cache(cache, places) => (cache, places),
        };
        let size = targets.dims();
        let views = Views::new(&targets, config, self.precision());
        let sight = toward(cameras, places.as_deref(), size[0], config);
        let tokens = self.target_tokens(targets, config);
        let tokens = self.through_decoder(tokens, &views, config, |i, x| {
            self.decoder[i].against(x, views.tokens(), &cache[i], sight.as_ref())
        });
        self.logits(&tokens, size, config)
    }

    /// `[b, v, c, h, w]` → `[b, v·n, d]`
    fn target_tokens(&self, targets: Tensor<5>, config: &ModelConfig) -> Tensor<3> {
        let told = targets.narrow(2, 0, config.told_channels());
        self.ray.forward(patches(told, config.patch))
    }

    fn logits(
        &self,
        tokens: &HeadInput,
        [b, v, _, h, w]: [usize; 5],
        config: &ModelConfig,
    ) -> Tensor<5> {
        let logits = self.head.logits(tokens, config.patch, &[]);
        logits.reshape([b, v, config.head_channels(), h, w])
    }

    /// Pictures from the head's numbers, and for models with `reprojection` what the photographs show; `finer` times as large each
    /// way as those that the network has learnt on.
    ///
    /// # Shapes
    /// logits `[b, v, ModelConfig::head_channels, h, w]`, given `[b, v, c, h, w]`, the targets' channels behind the rays →
    /// `[b, v, 3 or 4, h, w]`
    #[must_use]
    pub fn shown(
        &self,
        logits: Tensor<5>,
        given: Option<Tensor<5>>,
        finer: usize,
        config: &ModelConfig,
    ) -> Tensor<5> {
        let [b, v, c, h, w] = logits.dims();
        let [_, direct, carried] = config.target_parts();
        let logits = logits.reshape([b * v, c, h, w]);
        let given = given.map(|x| x.reshape([b * v, direct + carried, h, w]));
        let (logits, carried) = match (&self.pixel, given) {
            (Some(mlp), Some(given)) => {
                let (logits, carried) = mlp.forward(logits, given, finer, self.precision(), config);
                (logits, Some(carried))
            }
            (_, given) => (logits, given.map(|x| x.narrow(1, direct, 4))),
        };
        let picture = config.output.squash(logits, carried);
        picture.reshape([b, v, config.output.channels(), h, w])
    }

    /// What the head makes of the decoder's tokens.
    ///
    /// # Shapes
    /// tokens of `b·v` views, and what the decoder was given of them, `[b, v, c, h, w]` → `[b, v, 3 or 4, h, w]`
    #[must_use]
    pub fn picture(
        &self,
        tokens: &HeadInput,
        targets: Tensor<5>,
        config: &ModelConfig,
    ) -> Tensor<5> {
        let logits = self.logits(tokens, targets.dims(), config);
        self.shown(logits, behind_rays(targets, config), 1, config)
    }

    /// What the head works on, views as rows `b·v`.
    ///
    /// # Shapes
    /// scene `[b, K, d]`, targets `[b, v, c, h, w]`, cameras as in [`Self::decode`]
    #[must_use]
    pub fn decoder_tokens(
        &self,
        scene: &Scene,
        targets: Tensor<5>,
        cameras: &[Camera],
        config: &ModelConfig,
    ) -> HeadInput {
        let [b, v, ..] = targets.dims();
        let (k, d) = (scene.channels.dims()[1], config.dim);
        let views = Views::new(&targets, config, self.precision());
        let n = views.tokens();
        let targets = self.target_tokens(targets, config);
        match config.decoder {
            DecoderAttention::Joint => {
                let targets = targets.reshape([b * v, n, d]);
                let scene = scene.channels.clone();
                let scene = scene.unsqueeze_dim::<4>(1).expand([b, v, k, d]);
                let sequence = Tensor::cat(vec![targets, scene.reshape([b * v, k, d])], 1);
                self.through_decoder(sequence, &views, config, |i, x| {
                    self.decoder[i].forward(x, None)
                })
            }
            DecoderAttention::OneWay => {
                let sight = toward(cameras, scene.places.as_deref(), b, config);
                let context = self.decoder_norm.forward(scene.channels.clone());
                self.through_decoder(targets, &views, config, |i, x| {
                    self.decoder[i].cross(x, context.clone(), n, sight.as_ref())
                })
            }
        }
    }

    /// Norm and blocks over `tokens` `[s, _, d]`, which begin with the views'; `block` runs the i-th.
    fn through_decoder(
        &self,
        tokens: Tensor<3>,
        views: &Views,
        config: &ModelConfig,
        block: impl Fn(usize, Tensor<3>) -> Tensor<3>,
    ) -> HeadInput {
        let mut x = self.decoder_norm.forward(tokens);
        let mut taps = Vec::new();
        for i in 0..self.decoder.len() {
            x = block(i, x);
            if config.head.layers().contains(&(i + 1)) {
                taps.push(views.split(&x));
            }
        }
        views.head_input(&x, taps)
    }
}

/// Scene tokens: what they hold, and where they are.
#[derive(Clone, Debug)]
pub struct Scene {
    /// `[b, K, d]`, which edits change.
    pub channels: Tensor<3>,
    /// Where they are, for models with `anchors`; edits leave it alone.
    pub places: Option<Arc<Places>>,
}

/// What targets `[b, v, c, h, w]` hold behind the rays, for models with `reprojection`: direct light and photographs.
pub(crate) fn behind_rays(targets: Tensor<5>, config: &ModelConfig) -> Option<Tensor<5>> {
    let [rays, direct, carried] = config.target_parts();
    let of = |targets: Tensor<5>| targets.narrow(2, rays, direct + carried);
    config.reprojection.then(|| of(targets))
}

/// A scene made ready for views of it.
#[derive(Clone, Debug)]
pub enum Prepared {
    /// `joint` decoders: the scene tokens, since what the decoder makes of them differs from view to view.
    Scene(Box<Scene>),
    /// `one-way` decoders: the scene's keys and values in each decoder block, and where its tokens are.
    Cache(Vec<KeyValues>, Option<Arc<Places>>),
}

/// How the targets of `cameras` `[b, v]` see a scene's places.
fn toward(
    cameras: &[Camera],
    scene: Option<&Places>,
    batch: usize,
    config: &ModelConfig,
) -> Option<Sight> {
    let targets = |_| Places::new(batch, 0, cameras, config.patch);
    scene.map(|scene| targets(scene).toward(scene, config.head_dim))
}

/// Each sample's moments as its scene's tokens see them: `[b, K, MOMENTS]`, or `[b, 1, MOMENTS]` where tokens have no places.
fn seen_by(scene: &Scene, shapes: &[([f32; MOMENTS], f32)], device: &Device) -> Tensor<3> {
    let mut seen = Vec::new();
    match &scene.places {
        Some(places) => {
            let frames = places.frames();
            let each = frames.len() / shapes.len();
            for ((moments, _), frames) in shapes.iter().zip(frames.chunks_exact(each)) {
                seen_from(moments, frames, &mut seen);
            }
        }
        None => seen.extend(shapes.iter().flat_map(|(moments, _)| moments)),
    }
    let b = shapes.len();
    let n = seen.len() / (b * MOMENTS);
    Tensor::from_data(TensorData::new(seen, [b, n, MOMENTS]), device)
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
    fn new(targets: &Tensor<5>, config: &ModelConfig, precision: Precision) -> Self {
        let [b, v, _, h, w] = targets.dims();
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

    /// The views' tokens, which come first: `[s, _, d]` → `[count, tokens, d]`.
    fn split(&self, x: &Tensor<3>) -> Tensor<3> {
        let [sequences, _, d] = x.dims();
        let n = self.tokens();
        x.clone()
            .narrow(1, 0, self.count / sequences * n)
            .reshape([self.count, n, d])
    }

    fn head_input(&self, x: &Tensor<3>, taps: Vec<Tensor<3>>) -> HeadInput {
        HeadInput {
            last: self.split(x),
            taps,
            precision: self.precision,
            rows: self.rows,
            columns: self.columns,
        }
    }
}

/// Runs `blocks` over `tokens` `[b, n, d]` that all see each other.
fn run(blocks: &[Block], tokens: Tensor<3>, sight: Option<&Sight>) -> Tensor<3> {
    let through = |x, block: &Block| block.forward(x, sight);
    blocks.iter().fold(tokens, through)
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
