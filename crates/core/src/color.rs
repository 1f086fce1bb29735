//! The sRGB transfer function (IEC 61966-2-1); the only place where it is written down.

/// Exponent of the curve that is nearly it and goes on beyond white: on it networks make colours, and are told of light.
pub const CURVE: f32 = 2.2;

/// Linear value in [0, 1] to its sRGB encoding in [0, 1]; values outside are clipped.
#[must_use]
pub fn srgb_encode(linear: f32) -> f32 {
    let v = linear.clamp(0.0, 1.0);
    if v <= 0.003_130_8 {
        12.92 * v
    } else {
        1.055 * v.powf(1.0 / 2.4) - 0.055
    }
}

/// sRGB encoding in [0, 1] to the linear value.
#[must_use]
pub fn srgb_decode(encoded: f32) -> f32 {
    let v = encoded.clamp(0.0, 1.0);
    if v <= 0.040_45 {
        v / 12.92
    } else {
        ((v + 0.055) / 1.055).powf(2.4)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn decode_inverts_encode() {
        for i in 0..=1000 {
            let v = i as f32 / 1000.0;
            assert!((srgb_decode(srgb_encode(v)) - v).abs() < 1e-5);
        }
        assert!((srgb_encode(0.5) - 0.735_357).abs() < 1e-5);
    }
}
