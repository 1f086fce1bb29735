//! Where tokens are, for attention that knows how two of them lie to each other (docs/decisions/0008-token-frames.md).
//!
//! A frame is a rigid motion from a token's own space to model space: `[12]`, rotation row by row, then translation; what
//! attention does with it stands in `lumi_kernels`' `frames`. A patch has the frame of its rays: z along their mean, x to the
//! picture's right, the origin where that ray comes nearest to the model space's. Learned tokens and lights have model
//! space itself.

use crate::bridge;
use crate::params::to_vec;
use burn::tensor::{Device, Tensor};
use lumi_kernels::FRAME;
use std::cell::OnceCell;
use std::sync::Arc;

/// Frames of one sequence of tokens per batch element, ready for its blocks.
pub struct Frames {
    /// `[b, n, 12]`, without gradients.
    values: Tensor<3>,
    /// The same for our kernels, where those run.
    host: Option<Arc<Vec<f32>>>,
    /// What Burn's operations need instead, made by the first block that they run.
    motions: OnceCell<[Tensor<4>; 2]>,
}

impl Frames {
    /// Of `[b, n, 12]` numbers.
    #[must_use]
    pub fn new(values: Tensor<3>) -> Self {
        let values = values.detach();
        let host = bridge::has_kernels(&values.device());
        Self {
            host: host.then(|| Arc::new(to_vec(values.clone()))),
            values,
            motions: OnceCell::new(),
        }
    }

    /// What the kernels read.
    pub(crate) fn host(&self) -> Option<&Arc<Vec<f32>>> {
        self.host.as_ref()
    }

    /// M and M⁻¹ with `M = [R t; 0 1]`, `[b, n, 4, 4]` each.
    fn motions(&self) -> [Tensor<4>; 2] {
        self.motions.get_or_init(|| self.make_motions()).clone()
    }

    fn make_motions(&self) -> [Tensor<4>; 2] {
        let [b, n, _] = self.values.dims();
        let part = |from: usize, columns: usize| {
            let part = self.values.clone().narrow(2, from, 3 * columns);
            part.reshape([b, n, 3, columns])
        };
        let (rotation, translation) = (part(0, 3), part(9, 1));
        let last = Tensor::<1>::from_floats([0.0, 0.0, 0.0, 1.0], &self.values.device());
        let last = last.reshape([1, 1, 1, 4]).expand([b, n, 1, 4]);
        let whole = |r: Tensor<4>, t: Tensor<4>| {
            Tensor::cat(vec![Tensor::cat(vec![r, t], 3), last.clone()], 2)
        };
        let back = rotation.clone().swap_dims(2, 3);
        let origin = back.clone().matmul(translation.clone()).neg();
        [whole(rotation, translation), whole(back, origin)]
    }

    /// Queries, keys and values, `[b, h, n, dh]` each, into model space: `M⁻ᵀ q`, `M k`, `M v`.
    pub(crate) fn enter(&self, [q, k, v]: [Tensor<4>; 3]) -> [Tensor<4>; 3] {
        let [to_model, back] = self.motions();
        let to_model = to_model.swap_dims(2, 3);
        // Rows times matrices, so each matrix stands transposed.
        [turn(q, &back), turn(k, &to_model), turn(v, &to_model)]
    }

    /// What tokens gathered, `[b, h, n, dh]`, into their own spaces: `M⁻¹ o`.
    pub(crate) fn leave(&self, gathered: Tensor<4>) -> Tensor<4> {
        let [_, back] = self.motions();
        turn(gathered, &back.swap_dims(2, 3))
    }
}

/// Every four channels of each head times the token's matrix: `[b, h, n, dh]` by `[b, n, 4, 4]`.
fn turn(x: Tensor<4>, matrices: &Tensor<4>) -> Tensor<4> {
    let [b, h, n, dh] = x.dims();
    let matrices = matrices.clone().unsqueeze_dim::<5>(1);
    x.reshape([b, h, n, dh / 4, 4])
        .matmul(matrices.expand([b, h, n, 4, 4]))
        .reshape([b, h, n, dh])
}

/// The frame of model space for `n` tokens: `[b, n, 12]`.
#[must_use]
pub(crate) fn of_model_space(b: usize, n: usize, device: &Device) -> Tensor<3> {
    let frame = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0];
    Tensor::<1>::from_floats(frame, device)
        .reshape([1, 1, FRAME])
        .expand([b, n, FRAME])
}

/// The frames of views' patches, in the order of [`crate::network::patches`].
///
/// # Shapes
/// rays `[b, v, c, h, w]`, the Plücker coordinates o × d, d first → `[b, v·(h/p)·(w/p), 12]`
#[must_use]
pub(crate) fn of_rays(rays: Tensor<5>, p: usize) -> Tensor<3> {
    let [b, v, _, h, w] = rays.dims();
    let (rows, columns) = (h / p, w / p);
    // `[b·v, 2, 3, rows·columns, p]`: mean over a patch's rows.
    let lines = rays
        .narrow(2, 0, 6)
        .reshape([b * v * 6, rows, p, columns * p])
        .mean_dim(2)
        .reshape([b * v, 2, 3, rows * columns, p]);
    let part = |i: usize, from: usize, len: usize| -> Tensor<3> {
        let part = lines.clone().narrow(1, i, 1).narrow(4, from, len);
        let n = rows * columns;
        part.mean_dim(4).reshape([b * v, 3, n]).swap_dims(1, 2)
    };
    // The mean of rays through one point: lengthening direction and moment alike leaves the line.
    let (moment, along) = (part(0, 0, p), part(1, 0, p));
    let length = lengths(&along);
    let (moment, z) = (moment / length.clone(), along / length);
    let half = p / 2;
    let right = part(1, p - half, half) - part(1, 0, half);
    let right = right.clone() - z.clone() * (right * z.clone()).sum_dim(2);
    let x = right.clone() / lengths(&right);
    let y = cross(&z, &x);
    let nearest = cross(&z, &moment);
    // Rotation row by row: its columns are the axes.
    let axes = [x, y, z].map(|axis| axis.unsqueeze_dim::<4>(3)).to_vec();
    let n = rows * columns;
    let rotation = Tensor::cat(axes, 3).reshape([b * v, n, 9]);
    Tensor::cat(vec![rotation, nearest], 2).reshape([b, v * n, FRAME])
}

/// `[_, n, 3]` → `[_, n, 1]`
fn lengths(x: &Tensor<3>) -> Tensor<3> {
    x.clone().square().sum_dim(2).sqrt()
}

/// `[_, n, 3]` each.
fn cross(a: &Tensor<3>, b: &Tensor<3>) -> Tensor<3> {
    let at = |t: &Tensor<3>, i: usize| t.clone().narrow(2, i % 3, 1);
    let parts = (0..3).map(|i| at(a, i + 1) * at(b, i + 2) - at(a, i + 2) * at(b, i + 1));
    Tensor::cat(parts.collect(), 2)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::batch::target_rays;
    use crate::config::RayFeatures;
    use lumi_core::Camera;
    use lumi_core::glam::Vec3;

    #[test]
    fn a_patch_has_the_frame_of_its_middle_ray() {
        let camera = Camera::orbit(0.7, 0.4, 2.75, 0.87, 16);
        let rays = target_rays(&[camera], RayFeatures::Fourier, &Device::flex());
        let frames = to_vec(of_rays(rays, 4));
        assert_eq!(frames.len(), 16 * FRAME);
        let directions: Vec<Vec3> = camera.directions().into_iter().collect();
        for (i, frame) in frames.chunks_exact(FRAME).enumerate() {
            let column = |c: usize| Vec3::new(frame[c], frame[3 + c], frame[6 + c]);
            let [x, y, z] = [0, 1, 2].map(column);
            let corner = i / 4 * 4 * 16 + i % 4 * 4;
            let middle: Vec3 = [17, 18, 33, 34]
                .map(|p| directions[corner + p])
                .iter()
                .sum();
            assert!(z.dot(middle.normalize()) > 0.9999, "patch {i}");
            let right = directions[corner + 18] - directions[corner + 17];
            assert!(x.dot(right.normalize()) > 0.99, "patch {i}");
            for (a, b, want) in [
                (x, x, 1.0),
                (y, y, 1.0),
                (x, y, 0.0),
                (x, z, 0.0),
                (y, z, 0.0),
            ] {
                assert!((a.dot(b) - want).abs() < 1e-5, "patch {i}");
            }
            assert!((x.cross(y) - z).length() < 1e-5, "patch {i}: left-handed");
            // The origin is on the middle ray, at its point nearest to the model space's.
            let origin = Vec3::new(frame[9], frame[10], frame[11]);
            assert!(origin.dot(z).abs() < 1e-4, "patch {i}");
            let off = (origin - camera.centre()).cross(z).length();
            assert!(off < 1e-4, "patch {i}: {off}");
        }
    }
}
