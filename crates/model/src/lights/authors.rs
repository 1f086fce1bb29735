//! The authors' light tokens: camera-aligned environment patches, and rows of local light rays, once per input view.

use crate::layers::Linear;
use crate::network::patches;
use crate::{Error, Result, config::LightConfig};
use burn::module::Module;
use burn::tensor::module::interpolate;
use burn::tensor::ops::{InterpolateMode, InterpolateOptions};
use burn::tensor::{Device, Tensor, TensorData};
use lumi_core::authors::{SCENE_SCALE, normalise};
use lumi_core::glam::{Mat3, Mat4};
use lumi_core::light::authors::{self, ENVIRONMENT_SIZE, RAYS};
use lumi_core::light::{EnvMap, Environment};
use lumi_core::{Camera, Light, Seed, Similarity};
use rand::seq::index;
use serde::{Deserialize, Serialize};

/// Rows of local light rays that a network is given per input view.
const ROWS: usize = 1024;

/// Radius of an object in the world in which the authors' lights stand.
const RADIUS: f32 = 0.5;

/// The authors' tokenizers; what a checkpoint lacks is `None`.
#[derive(Module, Debug)]
pub struct AuthorsTokenizer {
    /// Environment patches `[d, 9·p²]`
    pub environment: Option<Linear>,
    /// Local light rays `[d, 10]`
    pub point: Option<Linear>,
}

impl AuthorsTokenizer {
    /// Tokens of environment images, brought to the directions' size; `None` if the network takes none.
    ///
    /// # Shapes
    /// ldr, hdr `[b, v, 3, h, w]` in [0, 1], directions `[b, v, 3, h', w']` → `[b, v·(h'/p)·(w'/p), d]`
    #[must_use]
    pub fn environment_tokens(
        &self,
        ldr: Tensor<5>,
        hdr: Tensor<5>,
        directions: Tensor<5>,
    ) -> Option<Tensor<3>> {
        let tokenizer = self.environment.as_ref()?;
        let [.., h, w] = directions.dims();
        let maps = Tensor::cat(vec![resized(ldr, h, w), resized(hdr, h, w), directions], 2);
        let patch = (tokenizer.weight.dims()[1] / maps.dims()[2]).isqrt();
        Some(tokenizer.forward(patches(maps, patch)))
    }

    /// Tokens of rows [intensity, r, g, b, origin, direction]; `None` if the network takes none.
    ///
    /// # Shapes
    /// `[b, v, n, 10]` → `[b, v·n, d]`
    #[must_use]
    pub fn point_tokens(&self, rows: Tensor<4>) -> Option<Tensor<3>> {
        let tokenizer = self.point.as_ref()?;
        Some(tokenizer.forward(point_features(rows)))
    }

    /// Light tokens of `lights`, which stand in the scene's world: at most one environment, and local lights.
    ///
    /// # Shapes
    /// → `[1, m, d]`
    ///
    /// # Errors
    /// On a light that the network takes no tokens for, on a second environment, and on lights out of range.
    pub(crate) fn tokens(
        &self,
        lights: &[Light],
        frame: &AuthorsFrame,
        config: &LightConfig,
        device: &Device,
    ) -> Result<Tensor<3>> {
        let (mut environment, mut local) = (None, Vec::new());
        for light in lights {
            match light.transformed(&frame.world) {
                Light::Environment(map) if environment.is_none() => environment = Some(map),
                Light::Environment(_) => {
                    let expected = "this model's light encoding takes one environment at a time";
                    return Err(Error::Unsupported(expected.into()));
                }
                other => local.push(other),
            }
        }
        let lacks = |kind: &str| {
            Err(Error::Unsupported(format!(
                "this model was trained without {kind} lights"
            )))
        };
        if environment.is_some() && self.environment.is_none() {
            return lacks("environment");
        }
        if !local.is_empty() && self.point.is_none() {
            return lacks("point and area");
        }
        let single = matches!(
            config,
            LightConfig::Authors {
                single_environment: true,
                ..
            }
        );
        let views = if single { 1 } else { frame.cameras.len() };
        // A network that takes both kinds always gets tokens of both, black ones for a kind that is off.
        let [ldr, hdr, directions] = frame.environment_images(environment.as_ref(), views, device);
        let rows = frame.ray_rows(&local, device)?;
        let parts = [
            self.environment_tokens(ldr, hdr, directions),
            self.point_tokens(rows),
        ];
        let parts: Vec<_> = parts.into_iter().flatten().collect();
        Ok(Tensor::cat(parts, 1))
    }
}

/// Where the authors' lights and cameras stand, for one set of input views; goes with scene tokens of their models.
#[derive(PartialEq, Clone, Debug, Serialize, Deserialize)]
pub struct AuthorsFrame {
    /// The scene's world to the world of their renderer, in which the object's ball has radius ½.
    pub(crate) world: Similarity,
    /// From there to the space of normalised cameras.
    pub(crate) normal: Similarity,
    /// Camera-to-world rotations of the input views in their renderer's world.
    pub(crate) cameras: Vec<Mat3>,
}

impl AuthorsFrame {
    /// The frame of input cameras, where `to_unit_ball` takes the scene to the unit ball. The authors normalise over
    /// input and target cameras of one pass; here targets come later, so the inputs decide alone.
    ///
    /// # Errors
    /// If the cameras stand at one point or look opposite ways.
    pub(crate) fn new(cameras: &[Camera], to_unit_ball: &Similarity) -> Result<Self> {
        let half = Similarity {
            scale: RADIUS,
            ..Similarity::IDENTITY
        };
        let world = to_unit_ball.then(&half);
        let poses: Vec<Mat4> = cameras
            .iter()
            .map(|c| world.pose(&c.camera_to_world))
            .collect();
        Ok(Self {
            world,
            normal: normalise(&poses, SCENE_SCALE)?,
            cameras: poses.into_iter().map(Mat3::from_mat4).collect(),
        })
    }

    /// The scene's world to the space of normalised cameras.
    #[must_use]
    pub fn to_model(&self) -> Similarity {
        self.world.then(&self.normal)
    }

    /// The scene's world to the unit ball.
    pub(crate) fn unit_ball(&self) -> Similarity {
        let double = Similarity {
            scale: 1.0 / RADIUS,
            ..Similarity::IDENTITY
        };
        self.world.then(&double)
    }

    /// LDR and HDR encodings and directions of the first `views` views, `[1, v, 3, h, w]` each; black without a map.
    fn environment_images(
        &self,
        environment: Option<&Environment>,
        views: usize,
        device: &Device,
    ) -> [Tensor<5>; 3] {
        let (height, width) = ENVIRONMENT_SIZE;
        let black = EnvMap::uniform([0.0; 3]);
        let map = environment.map_or(&black, |e| &*e.map);
        // Finer maps are averaged first, since both their resampling and the network's only interpolate.
        let map = map.at_most(height);
        let turn = environment.map_or(Mat3::IDENTITY, Environment::orientation);
        let mut planes: [Vec<f32>; 3] = Default::default();
        for &camera in &self.cameras[..views] {
            let images = authors::encode(&authors::align(&map, 0.0, turn.transpose() * camera));
            let byte = |v: u8| f32::from(v) / 255.0;
            for channel in 0..3 {
                planes[0].extend(images.ldr.iter().map(|p| byte(p[channel])));
                planes[1].extend(images.hdr.iter().map(|p| byte(p[channel])));
            }
            let directions =
                authors::world_directions(self.normal.rotation * camera, height, width);
            for channel in 0..3 {
                planes[2].extend(directions.iter().map(|d| d[channel]));
            }
        }
        let sizes = [
            (map.height, map.width),
            (map.height, map.width),
            (height, width),
        ];
        let mut sizes = sizes.into_iter();
        planes.map(|values| {
            let (h, w) = sizes.next().unwrap_or_default();
            Tensor::from_data(TensorData::new(values, [1, views, 3, h, w]), device)
        })
    }

    /// Each view's own draw of light rays, `[1, v, n, 10]`; zeros without lights.
    fn ray_rows(&self, local: &[Light], device: &Device) -> Result<Tensor<4>> {
        let shape = [1, self.cameras.len(), ROWS, 10];
        if local.is_empty() {
            return Ok(Tensor::zeros(shape, device));
        }
        // Positions on an area light's square: the R2 low-discrepancy sequence.
        let place = |i: usize, _| {
            [0.754_877_7, 0.569_840_3].map(|step| (i as f64 * step).fract() as f32 - 0.5)
        };
        let rows = authors::rays(local, RAYS, place)?;
        let mut values = Vec::with_capacity(shape.iter().product());
        for view in 0..self.cameras.len() as u64 {
            let mut rng = Seed(0)
                .child("authors light rays")
                .index(view)
                .stream("rows");
            for i in index::sample(&mut rng, rows.len(), ROWS.min(rows.len())) {
                let [intensity, r, g, b, ox, oy, oz, dx, dy, dz] = rows[i];
                let origin = self.normal.point([ox, oy, oz].into());
                let direction = self.normal.direction([dx, dy, dz].into());
                values.extend([intensity, r, g, b]);
                values.extend(origin.to_array());
                values.extend(direction.to_array());
            }
        }
        Ok(Tensor::from_data(TensorData::new(values, shape), device))
    }
}

/// Bilinear with half-pixel centres and no antialiasing, `[b, v, c, h, w]` to another height and width.
fn resized(maps: Tensor<5>, height: usize, width: usize) -> Tensor<5> {
    let [b, v, c, h, w] = maps.dims();
    if (h, w) == (height, width) {
        return maps;
    }
    let options = InterpolateOptions::new(InterpolateMode::Bilinear).with_align_corners(false);
    let flat = maps.reshape([b * v, c, h, w]);
    interpolate(flat, options.with_output_size([height, width])).reshape([b, v, c, height, width])
}

/// Rows [intensity, rgb, o, d] of `[b, v, n, 10]` to the authors' features [intensity, rgb, o × d, d], `[b, v·n, 10]`.
fn point_features(rows: Tensor<4>) -> Tensor<3> {
    let [b, v, n, _] = rows.dims();
    let rows = rows.reshape([b, v * n, 10]);
    let part = |from: usize, len: usize| rows.clone().narrow(2, from, len);
    let d = part(7, 3);
    let length = d.clone().square().sum_dim(2).sqrt();
    let d = d / (length + 1e-8);
    let o = part(4, 3);
    let c = |t: &Tensor<3>, i: usize| t.clone().narrow(2, i, 1);
    let moment = |i: usize, j: usize| c(&o, i) * c(&d, j) - c(&o, j) * c(&d, i);
    Tensor::cat(
        vec![
            part(0, 4),
            moment(1, 2),
            moment(2, 0),
            moment(0, 1),
            d.clone(),
        ],
        2,
    )
}
