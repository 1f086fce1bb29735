//! What colours a file's red, green and blue are, and the way from there to Rec. 709.

use super::{LEFT_OVER, LinearImage};
use glam::{DMat3, DVec2, DVec3};

/// Chromaticities (CIE x, y) of red, green, blue and white.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Primaries {
    pub red: [f64; 2],
    pub green: [f64; 2],
    pub blue: [f64; 2],
    pub white: [f64; 2],
}

/// Differences of chromaticities that only come from how many digits were written.
const ROUNDING: f64 = 2e-3;

impl Primaries {
    pub const REC_709: Self = Self {
        red: [0.64, 0.33],
        green: [0.30, 0.60],
        blue: [0.15, 0.06],
        white: [0.3127, 0.3290],
    };

    /// CIE XYZ itself, as files state it.
    pub const XYZ: Self = Self {
        red: [1.0, 0.0],
        green: [0.0, 1.0],
        blue: [0.0, 0.0],
        white: [1.0 / 3.0, 1.0 / 3.0],
    };

    /// The eight numbers x, y of red, green, blue and white.
    pub fn new(v: [f64; 8]) -> Self {
        Self {
            red: [v[0], v[1]],
            green: [v[2], v[3]],
            blue: [v[4], v[5]],
            white: [v[6], v[7]],
        }
    }

    /// Whether all is zero, as programs write it that know nothing.
    fn is_unstated(&self) -> bool {
        *self == Self::new([0.0; 8])
    }

    fn like(&self, other: &Self) -> bool {
        let pairs = [
            (self.red, other.red),
            (self.green, other.green),
            (self.blue, other.blue),
            (self.white, other.white),
        ];
        let near = |(a, b): ([f64; 2], [f64; 2])| DVec2::from(a).distance(b.into()) < ROUNDING;
        pairs.into_iter().all(near)
    }

    /// XYZ of red, green and blue at full, such that white has a luminance of 1; `None` if these are no three colours.
    fn to_xyz(self) -> Option<DMat3> {
        let full = |[x, y]: [f64; 2]| DVec3::new(x, y, 1.0 - x - y);
        let axes = DMat3::from_cols(full(self.red), full(self.green), full(self.blue));
        let white = full(self.white) / self.white[1];
        let scale = axes.inverse() * white;
        let sound = axes.determinant().abs() > 1e-6 && scale.is_finite();
        (sound && scale.cmpgt(DVec3::ZERO).all()).then(|| axes * DMat3::from_diagonal(scale))
    }

    /// The matrix from these to Rec. 709; `None` where there is nothing to do.
    ///
    /// White stays white (Bradford's adaptation), but for XYZ, whose values are colours as they are.
    ///
    /// # Errors
    /// If these are not three colours around a white.
    pub fn to_rec_709(self) -> Result<Option<DMat3>, ()> {
        if self.like(&Self::REC_709) || self.is_unstated() {
            return Ok(None);
        }
        let ours = Self::REC_709.to_xyz().ok_or(())?;
        let theirs = self.to_xyz().ok_or(())?;
        let adapted = if self.like(&Self::XYZ) {
            theirs
        } else {
            adaptation(theirs * DVec3::ONE, ours * DVec3::ONE) * theirs
        };
        Ok(Some(ours.inverse() * adapted))
    }
}

/// Bradford's matrix from colours seen under one white to those under another.
fn adaptation(from: DVec3, to: DVec3) -> DMat3 {
    let cones = DMat3::from_cols_array_2d(&[
        [0.8951, 0.2664, -0.1614],
        [-0.7502, 1.7135, 0.0367],
        [0.0389, -0.0685, 1.0296],
    ])
    .transpose();
    let gain = (cones * to) / (cones * from);
    cones.inverse() * DMat3::from_diagonal(gain) * cones
}

/// `matrix` times the colour.
pub(super) fn apply(matrix: &DMat3, color: [f32; 3]) -> [f32; 3] {
    (*matrix * DVec3::from(color.map(f64::from)))
        .as_vec3()
        .to_array()
}

/// Converts the whole picture. Colours that Rec. 709 cannot show are clipped; says so if there are any.
pub(super) fn convert(image: &mut LinearImage, matrix: &DMat3) -> Option<String> {
    let (mut outside, mut lowest, mut largest) = (0_usize, 0.0_f32, 0.0_f32);
    for pixel in &mut image.pixels {
        let [r, g, b, a] = *pixel;
        // Infinite suns are for the reader to deal with.
        if !(r.is_finite() && g.is_finite() && b.is_finite()) {
            continue;
        }
        let converted = apply(matrix, [r, g, b]);
        let negative = converted.iter().fold(0.0_f32, |m, v| m.min(*v));
        largest = converted.iter().fold(largest, |m, v| m.max(*v));
        lowest = lowest.min(negative);
        outside += usize::from(negative < 0.0);
        let [r, g, b] = converted.map(|v| v.max(0.0));
        *pixel = [r, g, b, a];
    }
    (lowest < -LEFT_OVER * largest).then(|| {
        format!("colours: {outside} pixels lie outside Rec. 709 and were clipped to its edge")
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn close(a: [f32; 3], b: [f32; 3]) -> bool {
        a.iter().zip(b).all(|(a, b)| (a - b).abs() < 2e-3)
    }

    #[test]
    fn xyz_is_the_published_matrix() {
        let matrix = Primaries::XYZ
            .to_rec_709()
            .expect("sound")
            .expect("differs");
        // IEC 61966-2-1: XYZ of D65 is white, and its rows begin with 3.2406, −0.9689 and 0.0557.
        assert!(close(apply(&matrix, [0.9505, 1.0, 1.089]), [1.0; 3]));
        assert!(close(
            apply(&matrix, [1.0, 0.0, 0.0]),
            [3.2406, -0.9689, 0.0557]
        ));
    }

    #[test]
    fn white_stays_white_and_rec_709_is_left_alone() {
        assert_eq!(Primaries::REC_709.to_rec_709(), Ok(None));
        // What map libraries write.
        assert_eq!(Primaries::new([0.0; 8]).to_rec_709(), Ok(None));
        // ACEScg (AP1) with its white near D60: the published matrix to Rec. 709 begins 1.70505, −0.13026, −0.02400.
        let ap1 = Primaries::new([0.713, 0.293, 0.165, 0.830, 0.128, 0.044, 0.32168, 0.33767]);
        let matrix = ap1.to_rec_709().expect("sound").expect("differs");
        assert!(close(apply(&matrix, [1.0; 3]), [1.0; 3]));
        assert!(close(
            apply(&matrix, [1.0, 0.0, 0.0]),
            [1.70505, -0.13026, -0.02400]
        ));
    }

    #[test]
    fn what_is_no_triangle_is_refused() {
        assert_eq!(Primaries::new([0.3; 8]).to_rec_709(), Err(()));
        let mut bad = Primaries::REC_709;
        bad.white = [0.3, 0.0];
        assert_eq!(bad.to_rec_709(), Err(()));
    }
}
