//! Weights for another patch size, so that training can climb in resolution: what a network has learned at
//! 32 px in patches of 4 goes on at 64 px in patches of 8, with as many tokens as before.
//!
//! Patches grow by whole factors `s`. The tokenizers take each small patch's weight for all `s × s` pixels that it
//! becomes, over `s²`: the new network sees a picture as the old one sees its box-filtered reduction (exactly so
//! for colours; a ray's features are close to the mean of its four neighbours'). The head draws its pixels' logits
//! as the linear interpolation of the old ones within each patch.

use crate::head::pixel::blank_context;
use crate::head::{Head, PixelMlp};
use crate::layers::Linear;
use crate::params::to_vec;
use crate::{Error, ModelConfig, Network, Result};
use burn::module::Param;
use burn::tensor::{Tensor, TensorData};
use lumi_core::Seed;

/// The weights of `network`, made for `from`, as a start for a network of `to`.
///
/// The configs may differ in `patch` (a multiple), `resolution`, `view_tokens`, `overlap` and the edit modes; and `to` may have
/// `reprojection`, `surface`, `margins`, `direct` and `pixel_mlp` where `from` has none, and more of `pixel_context`: the new network makes the same pictures until it learns, but
/// that with `reprojection` its colours are what the photographs show. What is drawn anew comes from `seed`.
///
/// # Errors
/// If they differ in anything else, or the head has no patches to resize (DPT heads with another patch).
pub fn resized(
    network: Network,
    from: &ModelConfig,
    to: &ModelConfig,
    seed: Seed,
) -> Result<Network> {
    let error = |field: &str, expected: String| Err(Error::config("the model", field, expected));
    let alike = ModelConfig {
        patch: to.patch,
        resolution: to.resolution,
        overlap: to.overlap,
        view_tokens: to.view_tokens,
        reprojection: from.reprojection || to.reprojection,
        surface: from.surface || to.surface,
        margins: from.margins || to.margins,
        direct: from.direct || to.direct,
        pixel_mlp: match from.pixel_mlp {
            0 => to.pixel_mlp,
            width => width,
        },
        pixel_context: from.pixel_context.max(to.pixel_context),
        lights: from.lights.with_modes(to.lights.modes()),
        ..from.clone()
    };
    if alike != *to {
        let expected = "expected the starting weights' architecture but for patch, resolution, view_tokens, overlap, lights.modes, and new reprojection, surface, margins, direct, pixel_mlp and pixel_context";
        return error("init", expected.into());
    }
    if !to.patch.is_multiple_of(from.patch) {
        let expected = format!(
            "expected a multiple of the starting weights' {}, found {}",
            from.patch, to.patch
        );
        return error("patch", expected);
    }
    let mut network = network;
    let told = |c: &ModelConfig| {
        let pixel = (c.pixel_mlp, c.pixel_context);
        (c.reprojection, c.surface, c.margins, c.direct, pixel)
    };
    if told(from) != told(to) {
        network = told_more(network, from, to, seed);
    }
    let (p, s) = (from.patch, to.patch / from.patch);
    if s == 1 {
        return Ok(network);
    }
    let Head::Mlp(mut head) = network.head else {
        let expected =
            format!("expected the starting weights' {p}; only `mlp` heads can be resized");
        return error("patch", expected);
    };
    head.pixels.weight = interpolated(&head.pixels.weight, p, s);
    Ok(Network {
        image: spread(&network.image, p, s),
        ray: spread(&network.ray, p, s),
        head: Head::Mlp(head),
        ..network
    })
}

/// A network that is told more of each pixel: its tokenizers make nothing of that yet, and what its head has to say besides is
/// zero. Where photographs are new, it does not tell colours of its own, and so shows theirs.
fn told_more(network: Network, from: &ModelConfig, to: &ModelConfig, seed: Seed) -> Network {
    // Rows of numbers, so many for each pixel of a patch: zeros go in behind the first `at`, and at the end.
    let widened = |values: &[f32], per: usize, at: usize, [inner, outer]: [usize; 2]| {
        let with_more = |own: &[f32]| {
            let (first, last) = own.split_at(at);
            [first, &vec![0.0; inner], last, &vec![0.0; outer]].concat()
        };
        values
            .chunks_exact(per)
            .flat_map(with_more)
            .collect::<Vec<f32>>()
    };
    let (pixels, d) = (from.patch * from.patch, from.dim);
    let tokenizer = |linear: &Linear, old: usize, at: usize, more: [usize; 2]| {
        let values = widened(&to_vec(linear.weight.val()), old, at, more);
        let new = old + more[0] + more[1];
        Linear {
            weight: parameter(values, [d, pixels * new], &linear.weight),
        }
    };
    let posed = from.posed_channels();
    let image = tokenizer(
        &network.image,
        posed,
        posed,
        [0, to.posed_channels() - posed],
    );
    // Direct light stands between the rays and the photographs, margins at the end.
    let ([rays, had, _], [_, has, _]) = (from.target_parts(), to.target_parts());
    let (old, new) = (from.told_channels(), to.told_channels());
    let more = [has - had, new - old - (has - had)];
    let ray = tokenizer(&network.ray, old, rays, more);
    let (old, new) = (from.head_channels(), to.head_channels());
    let head = match network.head {
        Head::Mlp(mut head) => {
            let mut values = to_vec(head.pixels.weight.val());
            if to.reprojection && !from.reprojection {
                let each = values.chunks_exact_mut(old * d);
                each.for_each(|pixel| pixel[..3 * d].fill(0.0));
            }
            let values = widened(&values, old * d, old * d, [0, (new - old) * d]);
            head.pixels.weight = parameter(values, [pixels * new, d], &head.pixels.weight);
            Head::Mlp(head)
        }
        other => other,
    };
    let device = ray.weight.val().device();
    let pixel = (to.pixel_mlp > 0).then(|| {
        let Some(mut mlp) = network.pixel else {
            return PixelMlp::new(to, &mut seed.stream("pixel"), &device);
        };
        let [width, inputs] = mlp.first.weight.val().dims();
        let values = to_vec(mlp.first.weight.val());
        // Direct light stands before what photographs show, margins behind what they show of the surface.
        let direct = has - had;
        let margins = to.surface_channels() - from.surface_channels();
        let values = widened(&values, inputs, from.head_channels(), [direct, 0]);
        let (inputs, at) = (
            inputs + direct,
            from.head_channels() + has + from.surface_channels(),
        );
        let values = widened(&values, inputs, at, [margins, 0]);
        mlp.first.weight = parameter(values, [width, inputs + margins], &mlp.first.weight);
        let more = blank_context(to, &device).into_iter();
        let had = mlp.context.len();
        mlp.context.extend(more.skip(had));
        mlp
    });
    Network {
        image,
        ray,
        head,
        pixel,
        ..network
    }
}

/// A tokenizer for patches `s` times as large: `[d, p·p·c]` → `[d, (s·p)²·c]`.
fn spread(linear: &Linear, p: usize, s: usize) -> Linear {
    let [d, inputs] = linear.weight.val().dims();
    let (old, c, q) = (to_vec(linear.weight.val()), inputs / (p * p), p * s);
    let share = 1.0 / (s * s) as f32;
    let mut new = Vec::with_capacity(d * q * q * c);
    for row in old.chunks_exact(inputs) {
        for (y, x) in (0..q * q).map(|i| (i / q, i % q)) {
            let pixel = (y / s * p + x / s) * c;
            new.extend(row[pixel..pixel + c].iter().map(|w| w * share));
        }
    }
    Linear {
        weight: parameter(new, [d, q * q * c], &linear.weight),
    }
}

/// A head's rows for patches `s` times as large: `[c·p², d]` → `[c·(s·p)², d]`, linear in each direction, continued
/// linearly to the patch's border.
fn interpolated(weight: &Param<Tensor<2>>, p: usize, s: usize) -> Param<Tensor<2>> {
    let [rows, d] = weight.val().dims();
    let (old, c, q) = (to_vec(weight.val()), rows / (p * p), p * s);
    // Left neighbour and the right one's share of the new pixel centre `i`.
    let place = |i: usize| {
        let at = (i as f32 + 0.5) / s as f32 - 0.5;
        let left = (at.floor().max(0.0) as usize).min(p.saturating_sub(2));
        (left, if p == 1 { 0.0 } else { at - left as f32 })
    };
    let mut new = Vec::with_capacity(3 * q * q * d);
    for (y, x) in (0..q * q).map(|i| (i / q, i % q)) {
        let ((top, down), (left, right)) = (place(y), place(x));
        for channel in 0..c {
            let row = |dy: usize, dx: usize| {
                let (r, k) = ((top + dy).min(p - 1), (left + dx).min(p - 1));
                let start = ((r * p + k) * c + channel) * d;
                &old[start..start + d]
            };
            let (a, b, e, f) = (row(0, 0), row(0, 1), row(1, 0), row(1, 1));
            new.extend((0..d).map(|i| {
                let (above, below) = (a[i] + right * (b[i] - a[i]), e[i] + right * (f[i] - e[i]));
                above + down * (below - above)
            }));
        }
    }
    parameter(new, [c * q * q, d], weight)
}

/// A parameter on the device of `like`.
fn parameter(values: Vec<f32>, shape: [usize; 2], like: &Param<Tensor<2>>) -> Param<Tensor<2>> {
    Param::from_data(TensorData::new(values, shape), &like.val().device())
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use crate::layers::normal;
    use burn::tensor::Device;

    fn pair() -> (ModelConfig, ModelConfig) {
        let from = ModelConfig::preset("nano").unwrap();
        let to = ModelConfig {
            patch: 2 * from.patch,
            resolution: 2 * from.resolution,
            ..from.clone()
        };
        (from, to)
    }

    fn radiance() -> ModelConfig {
        ModelConfig {
            anchors: true,
            decoder: crate::config::DecoderAttention::OneWay,
            output: crate::config::Output::Radiance,
            ..ModelConfig::preset("nano").unwrap()
        }
    }

    /// `[b, v, c, h, w]` with every pixel become `s × s`.
    fn enlarged(x: Tensor<5>, s: usize) -> Tensor<5> {
        let [b, v, c, h, w] = x.dims();
        x.reshape([b * v * c, h, 1, w, 1])
            .expand([b * v * c, h, s, w, s])
            .reshape([b, v, c, h * s, w * s])
    }

    #[test]
    fn a_larger_network_sees_an_enlarged_picture_as_the_smaller_one_sees_the_picture() {
        let device = Device::flex();
        let (from, to) = pair();
        let small = Network::new(&from, Seed(3), &device);
        let large = resized(small.clone(), &from, &to, Seed(5)).unwrap();
        let (side, rays) = (from.resolution, from.rays.channels());
        let mut rng = Seed(4).stream("picture");
        let posed = normal([1, 2, 3 + rays, side, side], 1.0, &mut rng, &device).val();
        let a = small.encode(posed.clone(), &[], &from);
        let b = large.encode(enlarged(posed, 2), &[], &to);
        let off = (a.channels - b.channels).abs().max().into_scalar::<f32>();
        assert!(off < 1e-4, "scene tokens differ by {off}");
    }

    #[test]
    fn a_network_that_is_given_photographs_begins_with_what_they_show() {
        let device = Device::flex();
        let from = radiance();
        let to = ModelConfig {
            reprojection: true,
            ..from.clone()
        };
        to.validate("test").unwrap();
        let network = resized(Network::new(&from, Seed(3), &device), &from, &to, Seed(5)).unwrap();
        let side = from.resolution;
        let camera = lumi_core::Camera::orbit(0.4, 0.3, 2.75, 0.87, side);
        let mut rng = Seed(4).stream("picture");
        let posed = [1, 1, to.posed_channels(), side, side];
        let posed = normal(posed, 1.0, &mut rng, &device).val();
        let scene = network.encode(posed, &[camera], &to);
        let rays = to.rays.channels();
        let view = |colour: f32| {
            let mut targets = vec![0.3; to.target_channels() * side * side];
            let (colours, coverage) = ((rays + 3) * side * side, (rays + 4) * side * side);
            targets[rays * side * side..colours].fill(colour);
            targets[colours..coverage].fill(1.0);
            let shape = [1, 1, to.target_channels(), side, side];
            let targets = crate::batch::stack(targets, shape, &device);
            to_vec(network.decode(&scene, targets, &[camera], &to))
        };
        // Nearly: colours bend softly toward zero.
        for colour in [0.4_f32, 0.9] {
            let seen = view(colour);
            let off = seen[..3 * side * side].iter().map(|c| (c - colour).abs());
            assert!(off.fold(0.0, f32::max) < 0.01, "{colour}");
        }
    }

    #[test]
    fn a_network_that_is_told_more_makes_the_same_pictures() {
        let device = Device::flex();
        let plain = ModelConfig {
            reprojection: true,
            ..radiance()
        };
        let finished = ModelConfig {
            pixel_mlp: 8,
            ..plain.clone()
        };
        let all = ModelConfig {
            surface: true,
            margins: true,
            direct: true,
            pixel_context: 2,
            ..finished.clone()
        };
        let side = plain.resolution;
        let camera = [lumi_core::Camera::orbit(0.4, 0.3, 2.75, 0.87, side)];
        let mut rng = Seed(4).stream("picture");
        let mut drawn =
            |channels: usize| normal([1, 1, channels, side, side], 1.0, &mut rng, &device).val();
        for from in [&plain, &finished] {
            let less = Network::new(from, Seed(3), &device);
            let more = resized(less.clone(), from, &all, Seed(5)).unwrap();
            let (posed, depth) = (drawn(from.posed_channels()), drawn(1));
            let [rays, direct, carried] = all.target_parts();
            let margins = all.surface_channels() - from.surface_channels();
            let nearest = carried - all.surface_channels();
            let [rays, direct, surface, margins, nearest] =
                [rays, direct, from.surface_channels(), margins, nearest].map(&mut drawn);
            let a = less.encode(posed.clone(), &camera, from);
            let b = more.encode(Tensor::cat(vec![posed, depth], 2), &camera, &all);
            let fewer = vec![rays.clone(), surface.clone(), nearest.clone()];
            let fewer = Tensor::cat(fewer, 2);
            let a = less.decode(&a, fewer, &camera, from);
            let targets = Tensor::cat(vec![rays, direct, surface, margins, nearest], 2);
            let b = more.decode(&b, targets, &camera, &all);
            let off = (a - b).abs().max().into_scalar::<f32>();
            assert!(off < 1e-4, "pictures differ by {off}");
        }
    }

    #[test]
    fn logits_that_rise_evenly_still_do() {
        let device = Device::flex();
        let (p, s, d) = (4, 2, 3);
        // Logit of pixel (y, x), colour c, under the i-th token direction: 1 + 2y − 3x + c + 10i.
        let logit = |y: f32, x: f32, c: usize, i: usize| {
            1.0 + 2.0 * y - 3.0 * x + c as f32 + 10.0 * i as f32
        };
        let mut old = Vec::new();
        for (y, x) in (0..p * p).map(|i| (i / p, i % p)) {
            for c in 0..3 {
                old.extend((0..d).map(|i| logit(y as f32, x as f32, c, i)));
            }
        }
        let weight = Param::from_data(TensorData::new(old, [3 * p * p, d]), &device);
        let new = to_vec(interpolated(&weight, p, s).val());
        let q = p * s;
        for (y, x) in (0..q * q).map(|i| (i / q, i % q)) {
            let at = |i: usize| (i as f32 + 0.5) / s as f32 - 0.5;
            for c in 0..3 {
                for i in 0..d {
                    let found = new[((y * q + x) * 3 + c) * d + i];
                    let expected = logit(at(y), at(x), c, i);
                    assert!((found - expected).abs() < 1e-4, "{found} for {expected}");
                }
            }
        }
    }

    #[test]
    fn other_differences_are_refused_by_name() {
        let device = Device::flex();
        let (from, to) = pair();
        let network = || Network::new(&from, Seed(3), &device);
        let wider = ModelConfig {
            scene_tokens: from.scene_tokens + 1,
            ..to.clone()
        };
        let error = resized(network(), &from, &wider, Seed(5))
            .unwrap_err()
            .to_string();
        assert!(error.contains("init"), "{error}");
        let odd = ModelConfig {
            patch: from.patch + 1,
            resolution: 7 * (from.patch + 1),
            ..to
        };
        let error = resized(network(), &from, &odd, Seed(5))
            .unwrap_err()
            .to_string();
        assert!(error.contains("patch"), "{error}");
    }
}
