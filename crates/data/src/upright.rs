//! Which way is up in a capture.

use glam::{DMat3, DVec3, Mat3, Quat, Vec3};
use lumi_core::{Camera, Similarity};

/// Cameras whose common vertical is within this angle of +z stand in a world that is z up already; hands
/// hold cameras no straighter than that.
const UPRIGHT_DEGREES: f32 = 30.0;

/// The direction that is up for the people who took the pictures: what is most nearly perpendicular to the
/// cameras' horizontal axes (people hold cameras level), on the side of their tops. Where the axes do not
/// settle it, because all cameras look the same way, the mean of the cameras' tops. `None` if tops cancel out.
#[must_use]
pub fn vertical(cameras: &[Camera]) -> Option<Vec3> {
    let top = cameras
        .iter()
        .map(|c| -c.camera_to_world.y_axis.truncate())
        .sum::<Vec3>()
        .try_normalize()?;
    let mut spread = DMat3::ZERO;
    for camera in cameras {
        let x = camera.camera_to_world.x_axis.truncate().as_dvec3();
        spread += DMat3::from_cols(x * x.x, x * x.y, x * x.z) * (1.0 / cameras.len() as f64);
    }
    let (values, axes) = symmetric_eigen(spread);
    // The second smallest must stand out from the smallest, or any direction between them would do.
    if values[1] < 0.05 || values[0] > 0.3 * values[1] {
        return Some(top);
    }
    let up = axes[0].as_vec3();
    Some(if up.dot(top) < 0.0 { -up } else { up })
}

/// The turn after which the cameras' [`vertical`] is +z; the identity for worlds that are z up already.
#[must_use]
pub fn levelling(cameras: &[Camera]) -> Similarity {
    let up = vertical(cameras).unwrap_or(Vec3::Z);
    if up.angle_between(Vec3::Z).to_degrees() <= UPRIGHT_DEGREES {
        return Similarity::IDENTITY;
    }
    turning_to_z(up)
}

/// The shortest turn that takes the unit vector `up` to +z.
#[must_use]
pub fn turning_to_z(up: Vec3) -> Similarity {
    Similarity {
        rotation: Mat3::from_quat(Quat::from_rotation_arc(up, Vec3::Z)),
        ..Similarity::IDENTITY
    }
}

/// Eigenvalues, ascending, and eigenvectors of a symmetric matrix by Jacobi's rotations.
fn symmetric_eigen(mut a: DMat3) -> ([f64; 3], [DVec3; 3]) {
    let mut axes = DMat3::IDENTITY;
    for _ in 0..16 {
        for (p, q) in [(0, 1), (0, 2), (1, 2)] {
            let off = a.col(q)[p];
            if off.abs() < 1e-15 {
                continue;
            }
            let angle = 0.5 * (2.0 * off).atan2(a.col(q)[q] - a.col(p)[p]);
            let (s, c) = angle.sin_cos();
            let mut turn = DMat3::IDENTITY;
            turn.col_mut(p)[p] = c;
            turn.col_mut(q)[q] = c;
            turn.col_mut(q)[p] = s;
            turn.col_mut(p)[q] = -s;
            a = turn.transpose() * a * turn;
            axes *= turn;
        }
    }
    let mut order = [0, 1, 2];
    order.sort_by(|&i, &j| a.col(i)[i].total_cmp(&a.col(j)[j]));
    (order.map(|i| a.col(i)[i]), order.map(|i| axes.col(i)))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Cameras on an arc of a third of a circle that look down on the scene.
    fn arc() -> Vec<Camera> {
        (0..9)
            .map(|i| Camera::orbit(0.25 * i as f32, 0.5, 3.0, 0.8, 16))
            .collect()
    }

    #[test]
    fn an_arc_of_cameras_that_look_down_tells_the_vertical() {
        let up = vertical(&arc()).expect("cameras");
        assert!(up.distance(Vec3::Z) < 1e-3, "{up}");
        assert_eq!(levelling(&arc()), Similarity::IDENTITY);
    }

    #[test]
    fn a_turned_world_is_turned_back() {
        let turn = Similarity {
            rotation: Mat3::from_rotation_x(2.0) * Mat3::from_rotation_z(0.7),
            ..Similarity::IDENTITY
        };
        let turned: Vec<_> = arc().iter().map(|c| c.transformed(&turn)).collect();
        let up = vertical(&turned).expect("cameras");
        assert!(up.distance(turn.direction(Vec3::Z)) < 1e-3, "{up}");
        let level = levelling(&turned);
        assert!(level.direction(up).distance(Vec3::Z) < 1e-5);
        assert!((level.rotation.determinant() - 1.0).abs() < 1e-5);
    }

    #[test]
    fn cameras_that_look_one_way_fall_back_to_their_tops() {
        let one = [Camera::orbit(0.3, 0.0, 3.0, 0.8, 16)];
        assert!(vertical(&one).expect("a camera").distance(Vec3::Z) < 1e-5);
        assert!(vertical(&[]).is_none());
    }
}
