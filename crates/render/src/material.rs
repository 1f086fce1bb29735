//! What surfaces are made of: metallic-roughness materials, textured by a pattern.

use crate::texture::{Image, Pattern};
use lumi_core::glam::Vec3;
use std::sync::Arc;

/// The material at one point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Surface {
    /// Base colour, linear, in [0, 1].
    pub base: Vec3,
    /// Perceptual roughness in [0, 1]; GGX's α is its square.
    pub roughness: f32,
    /// 0 for dielectrics with index of refraction 1.5, 1 for metals.
    pub metallic: f32,
}

/// How a surface varies.
#[derive(Clone, Debug)]
pub enum Material {
    /// The same everywhere.
    Plain(Surface),
    /// Colours, roughness and metallicness chosen by a solid pattern.
    Patterned(Patterned),
    /// Images over (u, v).
    Textured(Textured),
}

/// Surfaces along the values 0 to 1 of a pattern.
#[derive(Clone, Debug)]
pub struct Patterned {
    /// The field in [0, 1].
    pub pattern: Pattern,
    /// At least one surface; value `v` picks from it.
    pub palette: Vec<Surface>,
    /// Whether to blend neighbours of the palette or to pick one.
    pub smooth: bool,
}

/// glTF's metallic-roughness textures.
#[derive(Clone, Debug)]
pub struct Textured {
    /// Factors that multiply the images.
    pub factor: Surface,
    /// Base colour, linear.
    pub base: Option<Arc<Image>>,
    /// Roughness in channel 1 and metallicness in channel 2.
    pub metallic_roughness: Option<Arc<Image>>,
}

impl Surface {
    /// A rough or glossy dielectric.
    #[must_use]
    pub fn dielectric(base: Vec3, roughness: f32) -> Self {
        Self {
            base,
            roughness,
            metallic: 0.0,
        }
    }

    /// A metal.
    #[must_use]
    pub fn metal(base: Vec3, roughness: f32) -> Self {
        Self {
            base,
            roughness,
            metallic: 1.0,
        }
    }

    fn lerp(self, other: Self, t: f32) -> Self {
        Self {
            base: self.base.lerp(other.base, t),
            roughness: self.roughness + t * (other.roughness - self.roughness),
            metallic: self.metallic + t * (other.metallic - self.metallic),
        }
    }
}

impl Material {
    /// The material at texture coordinates `coords`.
    #[must_use]
    pub fn surface(&self, coords: Vec3) -> Surface {
        match self {
            Self::Plain(surface) => *surface,
            Self::Patterned(p) => {
                let v = p.pattern.value(coords).clamp(0.0, 1.0);
                let n = p.palette.len();
                if p.smooth {
                    let x = v * (n - 1) as f32;
                    let i = (x as usize).min(n.saturating_sub(2));
                    p.palette[i].lerp(p.palette[(i + 1).min(n - 1)], x - i as f32)
                } else {
                    p.palette[((v * n as f32) as usize).min(n - 1)]
                }
            }
            Self::Textured(t) => {
                let mut surface = t.factor;
                if let Some(image) = &t.base {
                    surface.base *= image.lookup(coords.x, coords.y);
                }
                if let Some(image) = &t.metallic_roughness {
                    let v = image.lookup(coords.x, coords.y);
                    surface.roughness *= v.y;
                    surface.metallic *= v.z;
                }
                surface
            }
        }
    }
}
