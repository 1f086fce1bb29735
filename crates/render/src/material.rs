//! What surfaces are made of: metallic-roughness materials, plain, patterned or textured with images.

use crate::image_texture::Texture;
use crate::texture::Pattern;
use lumi_core::glam::{Vec2, Vec3, Vec4};

/// The material at one point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Surface {
    /// Base colour, linear, in [0, 1].
    pub base: Vec3,
    /// Perceptual roughness in [0, 1]; GGX's α is its square.
    pub roughness: f32,
    /// 0 for dielectrics, 1 for metals.
    pub metallic: f32,
    /// Reflectance of a dielectric at normal incidence in units of 0.04, which an index of refraction of 1.5 has.
    /// Twice Blender's specular level; 0 is pure Lambert.
    pub specular: f32,
    /// Tints that reflectance, which is 1 at most; grazing reflection stays white.
    pub specular_color: Vec3,
    /// Share of a dielectric's reflection at all angles, in [0, 1].
    pub specular_weight: f32,
    /// Share of a clear coat with index of refraction 1.5 over everything, in [0, 1].
    pub coat: f32,
    /// Its perceptual roughness.
    pub coat_roughness: f32,
}

/// Where a material is looked up.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Coords {
    /// In the space of solid patterns.
    pub solid: Vec3,
    /// Two sets of (u, v) for images.
    pub uv: [Vec2; 2],
    /// Colour and opacity of the vertices, linear.
    pub color: Vec4,
}

/// How a surface varies.
#[derive(Clone, Debug)]
pub enum Material {
    /// The same everywhere.
    Plain(Surface),
    /// Colours, roughness and metallicness chosen by a solid pattern.
    Patterned(Patterned),
    /// One material over another, such as rust on paint.
    Layered(Box<Layered>),
    /// Images over (u, v).
    Textured(Box<Textured>),
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
    /// Relief, if any.
    pub bump: Option<Bump>,
}

/// Relief that turns normals: a pattern as height.
#[derive(Clone, Debug)]
pub struct Bump {
    /// The field in [0, 1].
    pub pattern: Pattern,
    /// Height of the value 1 above the value 0, in units of the pattern's space.
    pub height: f32,
}

/// A material that covers another one where a mask is high.
#[derive(Clone, Debug)]
pub struct Layered {
    /// What is covered.
    pub below: Material,
    /// What covers it.
    pub above: Material,
    /// Where.
    pub mask: Pattern,
    /// Values of the mask between these blend the two.
    pub edge: [f32; 2],
}

/// glTF's metallic-roughness material, with its specular and clear-coat extensions.
#[derive(Clone, Debug)]
pub struct Textured {
    /// Factors that multiply the images.
    pub factor: Surface,
    /// Base colour; its alpha is opacity.
    pub base: Option<Texture>,
    /// Roughness in green and metallicness in blue.
    pub metallic_roughness: Option<Texture>,
    /// Weight of the dielectric's reflection in alpha.
    pub specular: Option<Texture>,
    /// Its colour.
    pub specular_color: Option<Texture>,
    /// Coat in red.
    pub coat: Option<Texture>,
    /// The coat's roughness in green.
    pub coat_roughness: Option<Texture>,
    /// Relief.
    pub normal: Option<NormalMap>,
    /// Relief of the coat; without one it is smooth.
    pub coat_normal: Option<NormalMap>,
    /// Whether the surface can be seen through.
    pub opacity: Opacity,
}

/// Tangent-space normals.
#[derive(Clone, Debug)]
pub struct NormalMap {
    /// Components (x + 1)/2, (y + 1)/2, (z + 1)/2; y points up the image.
    pub texture: Texture,
    /// Multiplies x and y.
    pub scale: f32,
}

/// How much of what is behind shows through.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Opacity {
    /// Nothing.
    #[default]
    Opaque,
    /// All where alpha times `factor` is below `cutoff`, else nothing.
    Mask {
        /// Of the material.
        factor: f32,
        /// Threshold.
        cutoff: f32,
    },
    /// The rest of alpha times `factor`.
    Blend {
        /// Of the material.
        factor: f32,
    },
}

impl Surface {
    /// A rough or glossy dielectric.
    #[must_use]
    pub const fn dielectric(base: Vec3, roughness: f32) -> Self {
        Self {
            base,
            roughness,
            metallic: 0.0,
            specular: 1.0,
            specular_color: Vec3::ONE,
            specular_weight: 1.0,
            coat: 0.0,
            coat_roughness: 0.0,
        }
    }

    /// A metal.
    #[must_use]
    pub const fn metal(base: Vec3, roughness: f32) -> Self {
        Self {
            metallic: 1.0,
            ..Self::dielectric(base, roughness)
        }
    }

    /// Pure Lambert.
    #[must_use]
    pub const fn lambert(base: Vec3) -> Self {
        Self {
            specular: 0.0,
            ..Self::dielectric(base, 1.0)
        }
    }

    fn lerp(self, other: Self, t: f32) -> Self {
        let mix = |a: f32, b: f32| a + t * (b - a);
        Self {
            base: self.base.lerp(other.base, t),
            roughness: mix(self.roughness, other.roughness),
            metallic: mix(self.metallic, other.metallic),
            specular: mix(self.specular, other.specular),
            specular_color: self.specular_color.lerp(other.specular_color, t),
            specular_weight: mix(self.specular_weight, other.specular_weight),
            coat: mix(self.coat, other.coat),
            coat_roughness: mix(self.coat_roughness, other.coat_roughness),
        }
    }
}

impl Coords {
    /// A point of solid patterns, which is also its first (u, v).
    #[must_use]
    pub fn solid(p: Vec3) -> Self {
        Self {
            solid: p,
            uv: [p.truncate(), Vec2::ZERO],
            color: Vec4::ONE,
        }
    }
}

impl Material {
    /// The material at a point.
    #[must_use]
    pub fn surface(&self, at: &Coords) -> Surface {
        match self {
            Self::Plain(surface) => *surface,
            Self::Patterned(p) => p.surface(at.solid),
            Self::Layered(l) => {
                let cover = l.cover(at.solid);
                if cover <= 0.0 {
                    l.below.surface(at)
                } else if cover >= 1.0 {
                    l.above.surface(at)
                } else {
                    l.below.surface(at).lerp(l.above.surface(at), cover)
                }
            }
            Self::Textured(t) => t.surface(at),
        }
    }

    /// How much of the surface is there, in [0, 1].
    #[must_use]
    pub fn opacity(&self, at: &Coords) -> f32 {
        let Self::Textured(t) = self else {
            return 1.0;
        };
        let alpha = || t.base.as_ref().map_or(1.0, |b| b.lookup(&at.uv).w) * at.color.w;
        match t.opacity {
            Opacity::Opaque => 1.0,
            Opacity::Mask { factor, cutoff } => f32::from(u8::from(factor * alpha() >= cutoff)),
            Opacity::Blend { factor } => (factor * alpha()).clamp(0.0, 1.0),
        }
    }

    /// Whether [`Self::opacity`] may be below 1.
    #[must_use]
    pub fn see_through(&self) -> bool {
        matches!(self, Self::Textured(t) if t.opacity != Opacity::Opaque)
    }

    /// Height of the relief at a point of solid patterns, in their units.
    #[must_use]
    pub fn height(&self, p: Vec3) -> f32 {
        match self {
            Self::Patterned(Patterned { bump: Some(b), .. }) => {
                b.height * b.pattern.value(p).clamp(0.0, 1.0)
            }
            Self::Layered(l) => {
                let cover = l.cover(p);
                (1.0 - cover) * l.below.height(p) + cover * l.above.height(p)
            }
            _ => 0.0,
        }
    }

    /// Whether [`Self::height`] varies.
    #[must_use]
    pub fn bumpy(&self) -> bool {
        match self {
            Self::Patterned(p) => p.bump.is_some(),
            Self::Layered(l) => l.below.bumpy() || l.above.bumpy(),
            _ => false,
        }
    }
}

impl Patterned {
    fn surface(&self, p: Vec3) -> Surface {
        let v = self.pattern.value(p).clamp(0.0, 1.0);
        let n = self.palette.len();
        if self.smooth {
            let x = v * (n - 1) as f32;
            let i = (x as usize).min(n.saturating_sub(2));
            self.palette[i].lerp(self.palette[(i + 1).min(n - 1)], x - i as f32)
        } else {
            self.palette[((v * n as f32) as usize).min(n - 1)]
        }
    }
}

impl Layered {
    /// How much of the upper material shows.
    fn cover(&self, p: Vec3) -> f32 {
        let [low, high] = self.edge;
        ((self.mask.value(p) - low) / (high - low).max(1e-4)).clamp(0.0, 1.0)
    }
}

impl Textured {
    /// Without images.
    #[must_use]
    pub fn new(factor: Surface) -> Self {
        Self {
            factor,
            base: None,
            metallic_roughness: None,
            specular: None,
            specular_color: None,
            coat: None,
            coat_roughness: None,
            normal: None,
            coat_normal: None,
            opacity: Opacity::Opaque,
        }
    }

    fn surface(&self, at: &Coords) -> Surface {
        let mut s = self.factor;
        s.base *= at.color.truncate();
        if let Some(t) = &self.base {
            s.base *= t.lookup(&at.uv).truncate();
        }
        if let Some(t) = &self.metallic_roughness {
            let v = t.lookup(&at.uv);
            s.roughness *= v.y;
            s.metallic *= v.z;
        }
        if let Some(t) = &self.specular {
            s.specular_weight *= t.lookup(&at.uv).w;
        }
        if let Some(t) = &self.specular_color {
            s.specular_color *= t.lookup(&at.uv).truncate();
        }
        if let Some(t) = &self.coat {
            s.coat *= t.lookup(&at.uv).x;
        }
        if let Some(t) = &self.coat_roughness {
            s.coat_roughness *= t.lookup(&at.uv).y;
        }
        s
    }
}

impl NormalMap {
    /// The normal in tangent space, not of unit length.
    #[must_use]
    pub fn lookup(&self, uv: &[Vec2; 2]) -> Vec3 {
        let v = 2.0 * self.texture.lookup(uv).truncate() - 1.0;
        // A scale above 1 makes relief stronger than the map can hold; below 1 the normal tends to the surface's.
        let z = 1.0 + (v.z - 1.0) * self.scale.clamp(0.0, 1.0);
        Vec3::new(v.x * self.scale, v.y * self.scale, z)
    }
}
