//! From cameras and images to the tensors the network takes; the only such place.

use crate::config::RayFeatures;
use crate::{Illumination, ModelConfig};
use burn::tensor::{Device, Tensor, TensorData};
use lumi_core::glam::Vec3;
use lumi_core::light::LightRay;
use lumi_core::reprojection::Surface;
use lumi_core::{Camera, DisplayImage, Reprojection, reprojection};
use rayon::prelude::*;
use std::f32::consts::PI;

/// Channel-first ray features of a camera, `[c, h, w]` with c = [`RayFeatures::channels`]; moment first: o × d, d.
#[must_use]
pub fn ray_channels(camera: &Camera, features: RayFeatures) -> Vec<f32> {
    let n = camera.width * camera.height;
    let origin = camera.centre();
    let mut channels = vec![0.0; features.channels() * n];
    let mut planes: Vec<&mut [f32]> = channels.chunks_exact_mut(n.max(1)).collect();
    for (i, d) in camera.directions().into_iter().enumerate() {
        let mut channel = 0;
        let mut put = |values: Vec3| {
            for value in values.to_array() {
                planes[channel][i] = value;
                channel += 1;
            }
        };
        put(origin.cross(d));
        put(d);
        if features == RayFeatures::Plucker {
            continue;
        }
        let nearest = origin - origin.dot(d) * d;
        put(nearest);
        if features == RayFeatures::Fourier {
            // Each octave from the one below it: sines and cosines took most of the time here.
            let [x, y, z] = (PI * nearest).to_array().map(f32::sin_cos);
            let mut sines = Vec3::new(x.0, y.0, z.0);
            let mut cosines = Vec3::new(x.1, y.1, z.1);
            for _octave in 0..3 {
                put(sines);
                put(cosines);
                (sines, cosines) = (2.0 * sines * cosines, cosines * cosines - sines * sines);
            }
        }
    }
    channels
}

/// An image's values, channel-first.
pub fn colours(image: &DisplayImage) -> impl Iterator<Item = f32> {
    (0..3).flat_map(|c| image.pixels.iter().map(move |rgb| rgb[c]))
}

/// Channel-first posed image: RGB·2−1, alpha·2−1 for models that take it (1 where the image has none), ray features, and for models
/// with `surface` where it sees the hull, as one of all photographs; `[ModelConfig::posed_channels, h, w]`.
///
/// # Panics
/// If the image and the camera differ in size.
#[must_use]
pub fn posed_channels(
    image: &DisplayImage,
    camera: &Camera,
    photograph: Option<(&Reprojection, usize)>,
    config: &ModelConfig,
) -> Vec<f32> {
    assert_eq!(
        (image.width, image.height),
        (camera.width, camera.height),
        "an image and its camera must have one size"
    );
    let mut channels: Vec<f32> = colours(image).map(|v| 2.0 * v - 1.0).collect();
    if config.takes_alpha() {
        match &image.alpha {
            Some(alpha) => channels.extend(alpha.iter().map(|a| 2.0 * a - 1.0)),
            None => channels.resize(channels.len() + image.pixels.len(), 1.0),
        }
    }
    channels.extend(ray_channels(camera, config.rays));
    if config.surface {
        channels.extend(photograph.iter().flat_map(|(all, i)| all.depths(*i)));
    }
    channels
}

/// Stacks `b·v` equally sized channel-first pictures: `[b, v, c, h, w]`.
///
/// # Panics
/// If `data` does not fill the shape.
#[must_use]
pub fn stack(data: Vec<f32>, shape: [usize; 5], device: &Device) -> Tensor<5> {
    Tensor::from_data(TensorData::new(data, shape), device)
}

/// Posed views of one scene: `[1, v, ModelConfig::posed_channels, h, w]`.
#[must_use]
pub fn posed_views(
    views: &[(DisplayImage, Camera)],
    photographs: Option<&Reprojection>,
    config: &ModelConfig,
    device: &Device,
) -> Tensor<5> {
    let (h, w) = views
        .first()
        .map_or((0, 0), |(image, _)| (image.height, image.width));
    let posed = views.iter().enumerate().map(|(i, (image, camera))| {
        let photograph = photographs.map(|all| (all, i));
        posed_channels(image, camera, photograph, config)
    });
    let data = posed.collect::<Vec<_>>().concat();
    stack(
        data,
        [1, views.len(), config.posed_channels(), h, w],
        device,
    )
}

/// Photographs, and the light that edits have put on what they show.
#[derive(Clone, Copy)]
pub struct Given<'a> {
    /// In model space.
    pub photographs: &'a Reprojection,
    /// Rays of the lights, in model space.
    pub lights: &'a [LightRay],
    /// The scene's illumination scale, of which they are a part.
    pub scale: Illumination,
}

impl<'a> Given<'a> {
    /// Photographs under the light that they were taken in, of which nothing is known.
    #[must_use]
    pub fn captured(photographs: &'a Reprojection) -> Self {
        Self {
            photographs,
            lights: &[],
            scale: Illumination::CAPTURED,
        }
    }
}

/// How lights fall on a surface, `[DIRECT, h, w]` ([`Surface::lit`]): their rays in model space, and the scene's illumination scale,
/// of which they are a part.
#[must_use]
pub fn direct(surface: &Surface<'_>, lights: &[LightRay], scale: Illumination) -> Vec<f32> {
    surface.lit(lights, scale.0, scale.share(lights))
}

/// What the decoder is given of a target view: [`ray_channels`]; for models with `direct`, how the lights fall on the hull
/// ([`direct`]); then what photographs show there ([`Reprojection::seen_by`]), which are given for models with `reprojection` and
/// for no others; `[ModelConfig::target_channels, h, w]`. The camera is in model space.
#[must_use]
pub fn target_channels(
    camera: &Camera,
    given: Option<Given<'_>>,
    config: &ModelConfig,
) -> Vec<f32> {
    let mut channels = ray_channels(camera, config.rays);
    let Some(given) = given else {
        return channels;
    };
    if config.direct && given.lights.is_empty() {
        let pixels = camera.width * camera.height;
        channels.resize(channels.len() + reprojection::DIRECT * pixels, 0.0);
    } else if config.direct {
        let surface = given.photographs.surface(camera);
        channels.extend(direct(&surface, given.lights, given.scale));
    }
    channels.extend(seen_by(given.photographs, camera, 1, config));
    channels
}

/// What photographs show of a view as the config asks for it, `[c, h, w]`: [`Reprojection::seen_by`], without the silhouettes' margins
/// for models that are not told.
fn seen_by(
    photographs: &Reprojection,
    camera: &Camera,
    finer: usize,
    config: &ModelConfig,
) -> Vec<f32> {
    let mut seen = photographs.seen_by(camera, finer);
    if !config.margins {
        let pixels = camera.width * camera.height;
        let end = reprojection::SURFACE + reprojection::MARGINS;
        seen.drain(reprojection::SURFACE * pixels..end * pixels);
    }
    seen
}

/// Target views of one scene, see [`target_channels`]: `[1, v, ModelConfig::target_channels, h, w]`.
#[must_use]
pub fn targets(
    cameras: &[Camera],
    given: Option<Given<'_>>,
    config: &ModelConfig,
    device: &Device,
) -> Tensor<5> {
    let (h, w) = cameras.first().map_or((0, 0), |c| (c.height, c.width));
    let each = cameras.par_iter();
    let each: Vec<Vec<f32>> = each.map(|c| target_channels(c, given, config)).collect();
    let shape = [1, cameras.len(), config.target_channels(), h, w];
    stack(each.concat(), shape, device)
}

/// What photographs show of views of one size, `finer` times as large each way as pictures that the network has learnt on
/// ([`Reprojection::seen_by`]), `[1, v, c, h, w]`: the last of
/// [`ModelConfig::target_parts`].
#[must_use]
pub fn carried(
    cameras: &[Camera],
    photographs: &Reprojection,
    finer: usize,
    config: &ModelConfig,
    device: &Device,
) -> Tensor<5> {
    let (h, w) = cameras.first().map_or((0, 0), |c| (c.height, c.width));
    let each = cameras.par_iter();
    let seen: Vec<Vec<f32>> = each
        .map(|c| seen_by(photographs, c, finer, config))
        .collect();
    let [.., channels] = config.target_parts();
    let shape = [1, cameras.len(), channels, h, w];
    stack(seen.concat(), shape, device)
}

/// Pictures of one size as a render gives them: `[1, v, 3, h, w]`, display-encoded.
#[must_use]
pub fn images(images: &[&DisplayImage], device: &Device) -> Tensor<5> {
    let (h, w) = images.first().map_or((0, 0), |i| (i.height, i.width));
    let data = images.iter().flat_map(|image| colours(image)).collect();
    stack(data, [1, images.len(), 3, h, w], device)
}

/// Pictures of a `[1, v, 3, h, w]` render, clipped to [0, 1].
#[must_use]
pub fn to_images(render: Tensor<5>) -> Vec<DisplayImage> {
    let [_, v, _, height, width] = render.dims();
    let values = crate::params::to_vec(render);
    let n = height * width;
    (0..v)
        .map(|i| {
            let at = |c: usize, p: usize| values[(i * 3 + c) * n + p].clamp(0.0, 1.0);
            let pixels = (0..n).map(|p| [at(0, p), at(1, p), at(2, p)]).collect();
            DisplayImage {
                width,
                height,
                pixels,
                alpha: None,
            }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn octaves_are_sines_and_cosines_of_their_angles() {
        let camera = Camera::orbit(0.7, 0.4, 2.75, 0.87, 32);
        let n = camera.width * camera.height;
        let all = ray_channels(&camera, RayFeatures::Fourier);
        let nearest = ray_channels(&camera, RayFeatures::Nearest);
        assert_eq!(all[..9 * n], nearest[..]);
        for octave in 0..3_usize {
            let factor = f64::from(1_u8 << octave) * std::f64::consts::PI;
            for (i, &c) in nearest[6 * n..].iter().enumerate() {
                let angle = factor * f64::from(c);
                let at = (9 + 6 * octave) * n + i;
                assert!((f64::from(all[at]) - angle.sin()).abs() < 3e-6);
                assert!((f64::from(all[at + 3 * n]) - angle.cos()).abs() < 3e-6);
            }
        }
    }
}
