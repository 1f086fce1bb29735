//! Checks weights against golden tensors, one row per tensor (`lumi verify`).

use crate::block::Block;
use crate::checkpoint::{LazyTensor, SafeTensor, read_all};
use crate::head::Head;
use crate::lights::{AuthorsTokenizer, LightTokenizer};
use crate::network::{Scene, patches};
use crate::{Error, ModelConfig, Network, Result};
use burn::tensor::{Device, Tensor, TensorData};
use serde::Serialize;
use std::collections::BTreeMap;
use std::path::Path;

/// Largest absolute error allowed in tokens.
pub const TOKEN_TOLERANCE: f32 = 5e-5;
/// Largest absolute error allowed in images.
pub const IMAGE_TOLERANCE: f32 = 1e-5;

/// One compared tensor.
#[derive(Clone, Debug, Serialize)]
pub struct Row {
    /// Its name in the case file.
    pub tensor: String,
    /// Largest absolute difference; infinite where shapes differ or a value is not finite.
    pub max_error: f32,
    /// Mean absolute difference; infinite where the largest is.
    pub mean_error: f32,
    /// What the largest may be.
    pub tolerance: f32,
}

impl Row {
    /// Whether the error is allowed.
    #[must_use]
    pub fn ok(&self) -> bool {
        self.max_error <= self.tolerance
    }
}

/// A case file in the layout of the golden cases: inputs and expected tensors.
struct Case<'a> {
    tensors: BTreeMap<String, SafeTensor<'a>>,
    path: &'a Path,
    device: Device,
    rows: Vec<Row>,
}

impl Case<'_> {
    fn has(&self, name: &str) -> bool {
        self.tensors.contains_key(name)
    }

    fn get<const D: usize>(&self, name: &str) -> Result<Tensor<D>> {
        let missing = || Error::weights(self.path, name, "expected in the case, but missing");
        let tensor = self.tensors.get(name).ok_or_else(missing)?;
        let shape: [usize; D] = tensor.shape().try_into().map_err(|_| {
            let expected = format!("expected {D} dimensions, found shape {:?}", tensor.shape());
            Error::weights(self.path, name, expected)
        })?;
        Ok(Tensor::from_data(
            TensorData::new(tensor.read()?, shape),
            &self.device,
        ))
    }

    /// Compares with the golden tensor `name`, if the case has it.
    fn check<const D: usize>(&mut self, name: &str, ours: Tensor<D>, tolerance: f32) -> Result<()> {
        if !self.has(name) {
            return Ok(());
        }
        let golden = self.get::<D>(name)?;
        let mut row = Row {
            tensor: name.into(),
            max_error: f32::INFINITY,
            mean_error: f32::INFINITY,
            tolerance,
        };
        if golden.dims() == ours.dims() {
            let (a, b) = (crate::params::to_vec(golden), crate::params::to_vec(ours));
            let errors: Vec<f32> = a.iter().zip(&b).map(|(a, b)| (a - b).abs()).collect();
            if errors.iter().all(|e| e.is_finite()) {
                let sum: f64 = errors.iter().map(|e| f64::from(*e)).sum();
                row.mean_error = (sum / errors.len().max(1) as f64) as f32;
                row.max_error = errors.into_iter().fold(0.0, f32::max);
            }
        }
        self.rows.push(row);
        Ok(())
    }

    fn tokens<const D: usize>(&mut self, name: &str, ours: Tensor<D>) -> Result<()> {
        self.check(name, ours, TOKEN_TOLERANCE)
    }
}

impl Case<'_> {
    /// Environment tokens of the named maps, of all input views or the first few; `None` where case or network has none.
    fn environment(
        &self,
        tokenizers: &AuthorsTokenizer,
        ldr: &str,
        hdr: &str,
        views: Option<usize>,
    ) -> Result<Option<Tensor<3>>> {
        if tokenizers.environment.is_none() || !self.has(ldr) {
            return Ok(None);
        }
        let directions = self.get::<5>("env_dir")?;
        let maps = [self.get::<5>(ldr)?, self.get(hdr)?];
        let [b, all, ..] = maps[0].dims();
        let v = views.unwrap_or(all);
        let first = |t: Tensor<5>| t.narrow(0, 0, b).narrow(1, 0, v);
        let [ldr, hdr] = maps.map(first);
        Ok(tokenizers.environment_tokens(ldr, hdr, first(directions)))
    }

    /// Point-light tokens of all input views or the first few; `None` where case or network has none.
    fn point(
        &self,
        tokenizers: &AuthorsTokenizer,
        views: Option<usize>,
    ) -> Result<Option<Tensor<3>>> {
        if tokenizers.point.is_none() || !self.has("point_light_rays") {
            return Ok(None);
        }
        let rows = self.get::<4>("point_light_rays")?;
        let v = views.unwrap_or(rows.dims()[1]);
        Ok(tokenizers.point_tokens(rows.narrow(1, 0, v)))
    }
}

/// All tokens of both kinds in one sequence.
fn join(parts: [&Option<Tensor<3>>; 2]) -> Option<Tensor<3>> {
    let parts: Vec<_> = parts.into_iter().flatten().cloned().collect();
    (!parts.is_empty()).then(|| Tensor::cat(parts, 1))
}

/// The loss whose gradients the golden cases hold: the mean squared error of the targets rendered after
/// one edit with all environment and point tokens. On an autodiff device it can be differentiated.
///
/// # Errors
/// If the case lacks an input, or the network has not the authors' light tokenizers.
pub fn loss(
    network: &Network,
    config: &ModelConfig,
    path: &Path,
    device: &Device,
) -> Result<Tensor<1>> {
    let bytes = lumi_core::fs::read_bytes(path)?;
    let case = Case {
        tensors: read_all(&bytes, path)?,
        path,
        device: device.clone(),
        rows: Vec::new(),
    };
    let lights = authors_tokenizers(network)?;
    let posed = posed_images(&case, "images", "ray_o", "ray_d")?;
    let light = join([
        &case.environment(lights, "env_ldr", "env_hdr", None)?,
        &case.point(lights, None)?,
    ]);
    let light = light.ok_or_else(|| Error::weights(path, "(lights)", "expected light tokens"))?;
    let scene = network.edit(&network.encode(posed, &[], config), light, config);
    let rays = target_rays(&case, "target_ray_o", "target_ray_d")?;
    let render = network.decode(&scene, rays, &[], config);
    Ok((render - case.get("target_images")?).square().mean())
}

fn authors_tokenizers(network: &Network) -> Result<&AuthorsTokenizer> {
    match &network.lights {
        LightTokenizer::Authors(lights) => Ok(lights),
        LightTokenizer::Rays(_) => Err(Error::Unsupported(
            "golden cases hold the authors' light tokens; this config has unified light rays"
                .into(),
        )),
    }
}

/// Runs `network` on every input of the case at `path` and compares all tensors that apply.
///
/// # Errors
/// If the case lacks an input or is malformed; differences are rows, not errors.
pub fn verify(
    network: &Network,
    config: &ModelConfig,
    path: &Path,
    device: &Device,
) -> Result<Vec<Row>> {
    let bytes = lumi_core::fs::read_bytes(path)?;
    let tensors = read_all(&bytes, path)?;
    let mut case = Case {
        tensors,
        path,
        device: device.clone(),
        rows: Vec::new(),
    };
    let lights = authors_tokenizers(network)?;

    // Tokenizers.
    let posed = posed_images(&case, "images", "ray_o", "ray_d")?;
    case.tokens(
        "posed_input_b0_v0",
        posed.clone().narrow(0, 0, 1).narrow(1, 0, 1),
    )?;
    let image_tokens = network.image.forward(patches(posed.clone(), config.patch));
    case.tokens("image_tokens", image_tokens.clone())?;

    // Encoder, block by block.
    let [b, _, d] = image_tokens.dims();
    let latents = network
        .latents
        .val()
        .unsqueeze::<3>()
        .expand([b, config.scene_tokens, d]);
    let mut x = Tensor::cat(vec![latents, image_tokens], 1);
    for (i, block) in network.encoder.iter().enumerate() {
        if i == 0 {
            first_block(&mut case, block, x.clone().narrow(0, 0, 1))?;
        }
        x = block.forward(x, None);
        case.tokens(&format!("enc{i}.out_b0"), x.clone().narrow(0, 0, 1))?;
    }
    let latents = network.encode(posed, &[], config);
    case.tokens("latents", latents.channels.clone())?;

    // Lights.
    let all_env = case.environment(lights, "env_ldr", "env_hdr", None)?;
    let all_point = case.point(lights, None)?;
    if let Some(t) = &all_env {
        case.tokens("env_tokens", t.clone())?;
    }
    if let Some(t) =
        case.environment(lights, "envresize.env_ldr_b0", "envresize.env_hdr_b0", None)?
    {
        case.tokens("envresize.env_tokens_b0", t)?;
    }
    if let Some(t) = &all_point {
        case.tokens("point_tokens_b0", t.clone().narrow(0, 0, 1))?;
    }
    let edit = |z: &Scene, light: Option<Tensor<3>>| match light {
        Some(light) => network.edit(z, light, config),
        None => z.clone(),
    };

    // Edits, single and chained.
    let both = join([&all_env, &all_point]);
    let env_edit = edit(&latents, all_env.clone());
    let chain2 = edit(&env_edit, all_point.clone());
    let single_env = case.environment(lights, "env_ldr", "env_hdr", Some(1))?;
    let single = join([&single_env, &case.point(lights, Some(1))?]);
    let edits = [
        ("env", env_edit.clone()),
        ("point", edit(&latents, all_point)),
        ("env_point", edit(&latents, both.clone())),
        ("single_env_point", edit(&latents, single)),
        ("chain2", chain2.clone()),
        ("chain3", edit(&chain2, both)),
    ];

    // Decoder and renders.
    let rays = target_rays(&case, "target_ray_o", "target_ray_d")?;
    case.tokens(
        "target_posed_input_b0_v0",
        rays.clone().narrow(0, 0, 1).narrow(1, 0, 1),
    )?;
    decoder(&mut case, network, config, &env_edit, &rays)?;
    case.check(
        "render.unedited",
        network.decode(&latents, rays.clone(), &[], config),
        IMAGE_TOLERANCE,
    )?;
    for (name, z) in edits {
        case.tokens(&format!("edit.{name}"), z.channels.clone())?;
        let render = network.decode(&z, rays.clone(), &[], config);
        case.check(&format!("render.{name}"), render, IMAGE_TOLERANCE)?;
    }

    // Other sizes: first batch row, first target camera.
    let row = Scene {
        channels: env_edit.channels.narrow(0, 0, 1),
        places: None,
    };
    let origin = case
        .get::<5>("target_ray_o")?
        .narrow(0, 0, 1)
        .narrow(1, 0, 1);
    for kind in ["resize", "nonsquare"] {
        let name = format!("{kind}.ray_d");
        if !case.has(&name) {
            continue;
        }
        let d = case.get::<5>(&name)?;
        let [_, _, _, h, w] = d.dims();
        // One pinhole camera has one centre, so the first pixel's origin serves all.
        let o = origin
            .clone()
            .narrow(3, 0, 1)
            .narrow(4, 0, 1)
            .expand([1, 1, 3, h, w]);
        let render = network.decode(&row, plucker(o, d), &[], config);
        case.check(&format!("{kind}.render_env"), render, IMAGE_TOLERANCE)?;
    }
    Ok(case.rows)
}

fn first_block(case: &mut Case, block: &Block, x: Tensor<3>) -> Result<()> {
    let normed = crate::layers::layer_norm(x, block.norm1.val());
    case.tokens("enc0.norm1_b0", normed.clone())?;
    let [q, _, _] = block.heads(normed.clone(), None);
    case.tokens("enc0.q_normed_b0", q.swap_dims(1, 2))?;
    case.tokens("enc0.attn_out_b0", block.attention(normed, None))
}

fn decoder(
    case: &mut Case,
    network: &Network,
    config: &ModelConfig,
    scene: &Scene,
    rays: &Tensor<5>,
) -> Result<()> {
    let [b, v, _, h, w] = rays.dims();
    let n = config.image_tokens(w, h);
    let targets = network.ray.forward(patches(rays.clone(), config.patch));
    let targets = targets.reshape([b * v, n, config.dim]);
    case.tokens("target_tokens", targets.clone())?;
    let first = Tensor::cat(
        vec![
            targets.narrow(0, 0, 1),
            scene.channels.clone().narrow(0, 0, 1),
        ],
        1,
    );
    case.tokens("dec.input_normed_row0", network.decoder_norm.forward(first))?;
    let input = network.decoder_tokens(scene, rays.clone(), &[], config);
    case.tokens("dec.image_tokens", input.last.clone())?;
    for (layer, tap) in config.head.layers().iter().zip(&input.taps) {
        case.tokens(&format!("dec.tokens_layer{layer}"), tap.clone())?;
    }
    if let Head::Dpt(head) = &network.head {
        let maps = head.maps(&input);
        for (layer, map) in config.head.layers().iter().zip(maps.refined) {
            case.tokens(&format!("dpt.refined_layer{layer}"), map)?;
        }
        case.tokens("dpt.fused", maps.fused)?;
        case.tokens("dpt.patch_pixels", maps.patch_pixels)?;
    }
    Ok(())
}

/// `[b, v, 3, h, w]` origins and directions to `[b, v, 6, h, w]`: o × d, d.
fn plucker(o: Tensor<5>, d: Tensor<5>) -> Tensor<5> {
    let c = |t: &Tensor<5>, i: usize| t.clone().narrow(2, i, 1);
    let moment = |i: usize, j: usize| c(&o, i) * c(&d, j) - c(&o, j) * c(&d, i);
    Tensor::cat(vec![moment(1, 2), moment(2, 0), moment(0, 1), d.clone()], 2)
}

fn target_rays(case: &Case, origins: &str, directions: &str) -> Result<Tensor<5>> {
    Ok(plucker(case.get(origins)?, case.get(directions)?))
}

fn posed_images(case: &Case, images: &str, origins: &str, directions: &str) -> Result<Tensor<5>> {
    let rays = target_rays(case, origins, directions)?;
    Ok(Tensor::cat(
        vec![case.get::<5>(images)? * 2.0 - 1.0, rays],
        2,
    ))
}
