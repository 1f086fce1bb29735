//! Records at a lower resolution.

use crate::store::{ObjectRecord, to_half};
use half::f16;
use lumi_core::{Error, Result};

impl ObjectRecord {
    /// The record with every view box-averaged down to `side × side`, which must divide its size.
    /// Colour and alpha are premultiplied, so averages of both are exact.
    ///
    /// # Errors
    /// If the size is not square or not a multiple of `side`.
    pub fn downscaled(self, side: usize) -> Result<Self> {
        let (width, height) = self.size();
        let k = factor((width, height), side)?;
        if k == 1 {
            return Ok(self);
        }
        let reduce = |values: &[f16], channels: usize| -> Vec<f16> {
            let pictures = values.chunks_exact(width * height * channels);
            pictures
                .flat_map(|picture| reduced(picture, width, k, channels))
                .collect()
        };
        Ok(Self {
            radiance: reduce(&self.radiance, 3),
            alpha: reduce(&self.alpha, 1),
            albedo: self.albedo.as_ref().map(|a| reduce(a, 3)),
            cameras: self.cameras.iter().map(|c| c.resized(side, side)).collect(),
            ..self
        })
    }
}

/// How many pixels each way become one where square views of this size become `side × side`.
///
/// # Errors
/// If the size is not square or not a multiple of `side`.
pub fn factor((width, height): (usize, usize), side: usize) -> Result<usize> {
    if width == height && side > 0 && width.is_multiple_of(side) {
        return Ok(width / side);
    }
    let expected =
        format!("expected square views of a multiple of {side} px, found {width}×{height}");
    Err(Error::value("radiance", expected))
}

/// A square picture `[y, x, channel]` of `width`, whose `k × k` pixels become their mean.
#[must_use]
pub fn reduced(picture: &[f16], width: usize, k: usize, channels: usize) -> Vec<f16> {
    if k == 1 {
        return picture.to_vec();
    }
    let side = width / k;
    let mut out = Vec::with_capacity(side * side * channels);
    for y in 0..side {
        for x in 0..side {
            for c in 0..channels {
                let mut sum = 0.0;
                for dy in 0..k {
                    let row = ((y * k + dy) * width + x * k) * channels + c;
                    for dx in 0..k {
                        sum += picture[row + dx * channels].to_f32();
                    }
                }
                out.push(to_half(sum / (k * k) as f32));
            }
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use lumi_core::glam::Vec3;
    use lumi_core::{Camera, Light, NamedLight, Point};

    #[test]
    fn averages_match_and_misfits_are_errors() {
        let values: Vec<f16> = (0..4 * 4 * 3).map(|i| to_half((i % 7) as f32)).collect();
        let light = Light::Point(Point::new(Vec3::new(0.0, 0.0, 3.0), 100.0));
        let record = ObjectRecord {
            name: "a".into(),
            cameras: vec![Camera::orbit(0.0, 0.5, 3.0, 0.9, 4)],
            lights: vec![NamedLight {
                name: "p".into(),
                light,
            }],
            radiance: values.clone(),
            alpha: vec![to_half(1.0); 16],
            albedo: None,
        };
        let small = record.clone().downscaled(2).expect("divides");
        assert_eq!(small.size(), (2, 2));
        let at = |x: usize, y: usize| values[(y * 4 + x) * 3].to_f32();
        let mean = (at(0, 0) + at(1, 0) + at(0, 1) + at(1, 1)) / 4.0;
        assert!((small.radiance[0].to_f32() - mean).abs() < 1e-2);
        assert_eq!(small.alpha, vec![to_half(1.0); 4]);
        assert!(record.downscaled(3).is_err());
    }
}
