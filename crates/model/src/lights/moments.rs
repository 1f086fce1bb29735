//! The light of an edit as a whole, as each token's own space sees it (docs/decisions/0009-light-moments.md).
//!
//! With eᵢ the irradiance of ray i at the scene's centre and dᵢ its direction, the moments are Σe, Σe·d and Σe·ddᵀ for
//! each colour channel, over the largest channel of Σe, and that channel's logarithm. A matte surface's irradiance is
//! nearly a quadratic polynomial of its normal with such coefficients (Ramamoorthi and Hanrahan, SIGGRAPH 2001).

use super::{DARK, POWER_SCALE};
use crate::config::Mode;
use burn::tensor::Tensor;

/// Numbers of a light's moments: 3 of order 0, 9 of order 1, 27 of order 2, the level, and one per mode.
pub const MOMENTS: usize = 40 + Mode::ALL.len();

/// The moments in model space of ray features as [`super::ray_features`] makes them.
///
/// # Shapes
/// features `[b, rays, 10]` → `[b, 1, MOMENTS]`
#[must_use]
pub fn moments(features: Tensor<3>, mode: Mode) -> Tensor<3> {
    let [b, n, _] = features.dims();
    let device = features.device();
    let part = |from: usize, len: usize| features.clone().narrow(2, from, len);
    let directions = part(0, 3);
    let power = (part(9, 1) * POWER_SCALE).exp();
    // `[b, 3, rays]`
    let irradiance = (part(6, 3) * power).swap_dims(1, 2);
    let products =
        directions.clone().unsqueeze_dim::<4>(3) * directions.clone().unsqueeze_dim::<4>(2);
    let powers = Tensor::cat(
        vec![
            Tensor::ones([b, n, 1], &device),
            directions,
            products.reshape([b, n, 9]),
        ],
        2,
    );
    // `[b, 3, 13]`: a row per colour channel.
    let sums = irradiance.matmul(powers);
    let total = sums.clone().narrow(2, 0, 1).max_dim(1).clamp_min(DARK);
    let sums = sums / total.clone();
    let order =
        |from: usize, len: usize| sums.clone().narrow(2, from, len).reshape([b, 1, 3 * len]);
    let level = total.log() / POWER_SCALE;
    let modes = Mode::ALL.map(|m| if m == mode { 1.0 } else { 0.0 });
    let modes = Tensor::<1>::from_floats(modes, &device).reshape([1, 1, Mode::ALL.len()]);
    let modes = modes.expand([b, 1, Mode::ALL.len()]);
    Tensor::cat(vec![order(0, 1), order(1, 3), order(4, 9), level, modes], 2)
}

/// Moments as tokens with these frames see them, or all as model space does.
///
/// # Shapes
/// moments `[b, 1, MOMENTS]`, places `[b, n, 12]` → `[b, n, MOMENTS]`, or `[b, 1, MOMENTS]` without places
#[must_use]
pub fn seen_from(moments: Tensor<3>, places: Option<Tensor<3>>) -> Tensor<3> {
    let Some(places) = places else {
        return moments;
    };
    let [b, n, _] = places.dims();
    // A direction v of model space is Rᵀv in a token's own, so rows are multiplied by R.
    let rotation = places.narrow(2, 0, 9).reshape([b, n, 3, 3]);
    let part = |from: usize, len: usize| {
        let part = moments.clone().narrow(2, from, len);
        part.expand([b, n, len])
    };
    let first = part(3, 9).reshape([b, n, 3, 3]).matmul(rotation.clone());
    let second = part(12, 27).reshape([b, n, 9, 3]).matmul(rotation.clone());
    // The second moments are symmetric, so each index is turned as the last one in its turn.
    let second = second.reshape([b, n, 3, 3, 3]).swap_dims(3, 4);
    let second = second.reshape([b, n, 9, 3]).matmul(rotation);
    Tensor::cat(
        vec![
            part(0, 3),
            first.reshape([b, n, 9]),
            second.reshape([b, n, 27]),
            part(39, MOMENTS - 39),
        ],
        2,
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lights::ray_batch;
    use crate::params::to_vec;
    use burn::tensor::Device;
    use lumi_core::glam::{Mat3, Vec3};
    use lumi_core::light::{Point, RayPattern};
    use lumi_core::{Light, Similarity};

    fn lights(rotation: Mat3) -> Vec<Light> {
        let place = Similarity {
            rotation,
            ..Similarity::IDENTITY
        };
        let at = |x, y, z, power| Light::Point(Point::new(Vec3::new(x, y, z), power));
        [at(1.0, 2.5, 3.0, 900.0), at(-3.0, 0.5, 1.0, 500.0)]
            .map(|light| light.transformed(&place))
            .to_vec()
    }

    fn of(lights: Vec<Light>) -> Tensor<3> {
        let features = ray_batch(&[lights], &RayPattern::default(), &Device::flex());
        moments(features, Mode::Add)
    }

    #[test]
    fn a_single_lamp_is_its_direction() {
        let lamp = Light::Point(Point::new(Vec3::new(0.0, 0.0, 4.0), 1000.0));
        let values = to_vec(of(vec![lamp]));
        // From the centre the lamp stands along z; its rays go to all of the unit ball.
        assert!((values[0] - 1.0).abs() < 1e-5);
        let z = values[5];
        assert!(z < -0.97, "{z}");
        assert!(values[12 + 8] > 0.95, "{}", values[12 + 8]);
        let trace: f32 = [0, 4, 8].iter().map(|i| values[12 + i]).sum();
        assert!((trace - values[0]).abs() < 1e-4, "{trace}");
        assert_eq!(values[40..], [0.0, 1.0, 0.0]);
    }

    #[test]
    fn seen_from_a_turned_frame_is_turned_light_seen_from_model_space() {
        let turn = Mat3::from_rotation_z(0.8) * Mat3::from_rotation_x(-0.5);
        let rows = turn.transpose().to_cols_array();
        let frame: Vec<f32> = rows.into_iter().chain([0.3, -0.2, 0.1]).collect();
        let place = Tensor::<1>::from_floats(frame.as_slice(), &Device::flex());
        let place = place.reshape([1, 1, 12]);
        let seen = to_vec(seen_from(of(lights(Mat3::IDENTITY)), Some(place)));
        // In the frame's own space, the lights have been turned the other way.
        let want = to_vec(of(lights(turn.transpose())));
        for (i, (a, b)) in seen.iter().zip(&want).enumerate() {
            assert!((a - b).abs() < 1e-3, "{i}: {a} and {b}");
        }
    }
}
