//! glTF's materials as ours.

use super::accessor::Buffers;
use super::source;
use crate::image_file;
use crate::image_texture::{Image, Texture, Wrap};
use crate::material::{Material, NormalMap, Opacity, Surface, Textured};
use gltf::json::Value;
use gltf::texture::WrappingMode;
use image::RgbaImage;
use lumi_core::glam::{Affine2, Vec2, Vec3};
use std::collections::HashMap;
use std::path::Path;
use std::sync::Arc;

/// What was wrong with a material.
type Result<T> = std::result::Result<T, String>;

/// A finished material, and which of the file's sets of texture coordinates its textures use.
#[derive(Clone, Debug)]
pub struct Made {
    /// The material.
    pub material: Material,
    /// The file's set for each of our two.
    pub sets: [u32; 2],
}

/// Makes materials, and each image once.
pub struct Maker<'a> {
    /// The model's file.
    pub path: &'a Path,
    /// Whose materials they are.
    pub document: &'a gltf::Document,
    /// Its bytes.
    pub buffers: &'a Buffers,
    /// Images by index and whether they are colours; none where they cannot be read.
    pub images: HashMap<(usize, bool), Option<Arc<Image>>>,
    /// Images of roughness, by that of glossiness and its factor's bits.
    pub rough: HashMap<(usize, u32), Arc<Image>>,
    /// What is not shown.
    pub warnings: Vec<String>,
}

/// Sets of texture coordinates in the order in which a material asks for them.
#[derive(Default)]
struct Sets(Vec<u32>);

/// A texture as a material refers to it.
struct Reference<'a> {
    texture: gltf::Texture<'a>,
    set: u32,
    transform: Affine2,
}

impl<'a> Reference<'a> {
    fn new(info: &gltf::texture::Info<'a>) -> Self {
        let t = info.texture_transform();
        let set = t.as_ref().and_then(|t| t.tex_coord());
        let transform = t.map_or(Affine2::IDENTITY, |t| {
            placed(t.offset(), t.rotation(), t.scale())
        });
        Self {
            texture: info.texture(),
            set: set.unwrap_or_else(|| info.tex_coord()),
            transform,
        }
    }

    fn normal(info: &gltf::material::NormalTexture<'a>) -> Self {
        let mut reference = Self {
            texture: info.texture(),
            set: info.tex_coord(),
            transform: Affine2::IDENTITY,
        };
        reference.place(info.extension_value("KHR_texture_transform"));
        reference
    }

    /// A texture of an extension that the parser does not know.
    fn raw(document: &'a gltf::Document, info: &Value) -> Result<Self> {
        let index = info.get("index").and_then(Value::as_u64);
        let texture = index.and_then(|i| document.textures().nth(usize::try_from(i).ok()?));
        let set = info.get("texCoord").and_then(Value::as_u64).unwrap_or(0);
        let mut reference = Self {
            texture: texture.ok_or("expected the index of a texture")?,
            set: u32::try_from(set).map_err(|e| e.to_string())?,
            transform: Affine2::IDENTITY,
        };
        let extensions = info.get("extensions");
        reference.place(extensions.and_then(|e| e.get("KHR_texture_transform")));
        Ok(reference)
    }

    fn place(&mut self, transform: Option<&Value>) {
        let Some(t) = transform else { return };
        let pair = |name: &str, default: f32| {
            let at = |i: usize| t.get(name)?.get(i)?.as_f64();
            [0, 1].map(|i| at(i).map_or(default, |v| v as f32))
        };
        let rotation = t.get("rotation").and_then(Value::as_f64).unwrap_or(0.0);
        self.transform = placed(pair("offset", 0.0), rotation as f32, pair("scale", 1.0));
        if let Some(set) = t.get("texCoord").and_then(Value::as_u64) {
            self.set = u32::try_from(set).unwrap_or(self.set);
        }
    }
}

/// KHR_texture_transform: scaled, then turned clockwise in an image whose v points down, then moved.
fn placed(offset: [f32; 2], rotation: f32, scale: [f32; 2]) -> Affine2 {
    Affine2::from_translation(offset.into())
        * Affine2::from_angle(-rotation)
        * Affine2::from_scale(Vec2::from(scale))
}

impl Maker<'_> {
    /// The material as metallic-roughness; extensions that change it beyond that are ignored.
    pub fn make(&mut self, source: &gltf::Material<'_>) -> Result<Made> {
        let mut sets = Sets::default();
        let pbr = source.pbr_metallic_roughness();
        let [r, g, b, mut alpha] = pbr.base_color_factor();
        let mut made = Textured::new(Surface {
            metallic: pbr.metallic_factor(),
            ..Surface::dielectric(Vec3::new(r, g, b), pbr.roughness_factor())
        });
        let texture =
            |this: &mut Self, info: Option<gltf::texture::Info<'_>>, color, sets: &mut Sets| {
                let reference = info.map(|i| Reference::new(&i));
                reference.and_then(|r| this.texture(&r, color, sets))
            };
        made.base = texture(self, pbr.base_color_texture(), true, &mut sets);
        let info = pbr.metallic_roughness_texture();
        made.metallic_roughness = texture(self, info, false, &mut sets);
        if let Some(old) = source.pbr_specular_glossiness() {
            let [r, g, b, a] = old.diffuse_factor();
            alpha = a;
            made.base = texture(self, old.diffuse_texture(), true, &mut sets);
            made.metallic_roughness = None;
            made.factor = Surface {
                // What is reflected head on is the specular colour itself.
                specular: 1.0 / 0.04,
                specular_color: old.specular_factor().into(),
                ..Surface::dielectric(Vec3::new(r, g, b), 1.0 - old.glossiness_factor())
            };
            if let Some(info) = old.specular_glossiness_texture() {
                let reference = Reference::new(&info);
                made.specular_color = self.texture(&reference, true, &mut sets);
                made.metallic_roughness =
                    self.glossy(&reference, old.glossiness_factor(), &mut sets);
                if made.metallic_roughness.is_some() {
                    made.factor.roughness = 1.0;
                }
            }
        } else {
            if let Some(ior) = source.ior() {
                // 0 stands for endless, at which all is reflected that the specular colour lets through.
                let ior = if ior >= 1.0 || ior == 0.0 { ior } else { 1.5 };
                made.factor.specular = ((ior - 1.0) / (ior + 1.0)).powi(2) / 0.04;
            }
            if let Some(specular) = source.specular() {
                made.factor.specular_weight = specular.specular_factor();
                made.factor.specular_color = specular.specular_color_factor().into();
                made.specular = texture(self, specular.specular_texture(), false, &mut sets);
                let info = specular.specular_color_texture();
                made.specular_color = texture(self, info, true, &mut sets);
            }
        }
        if let Some(info) = source.normal_texture() {
            let found = self.texture(&Reference::normal(&info), false, &mut sets);
            made.normal = found.map(|texture| NormalMap {
                texture,
                scale: info.scale(),
            });
        }
        self.tame(source, &mut made.factor);
        if let Some(coat) = source.extension_value("KHR_materials_clearcoat") {
            self.coat(coat, &mut made, &mut sets)?;
        }
        made.opacity = match source.alpha_mode() {
            gltf::material::AlphaMode::Opaque => Opacity::Opaque,
            gltf::material::AlphaMode::Mask => Opacity::Mask {
                factor: alpha,
                cutoff: source.alpha_cutoff().unwrap_or(0.5),
            },
            gltf::material::AlphaMode::Blend => Opacity::Blend { factor: alpha },
        };
        if source.emissive_factor() != [0.0; 3] {
            let name = source.name().unwrap_or("without a name");
            self.warnings
                .push(format!("material `{name}`: its own light is left out"));
        }
        if source.unlit() {
            self.warnings
                .push("KHR_materials_unlit: shown as a lit material".to_owned());
        }
        let slots = sets.0.len();
        if slots > 2 {
            self.warnings.push(format!(
                "a material uses {slots} sets of texture coordinates; the first two are used"
            ));
        }
        let set = |i: usize| sets.0.get(i).copied();
        let sets = [set(0).unwrap_or(0), set(1).unwrap_or(u32::MAX)];
        Ok(Made {
            material: Material::Textured(Box::new(made)),
            sets,
        })
    }

    /// Factors beyond 1 would make light out of nothing.
    fn tame(&mut self, source: &gltf::Material<'_>, factor: &mut Surface) {
        let name = source.name().unwrap_or("without a name");
        let mut check = |what: &str, low: f32, high: f32| {
            if low < 0.0 || high > 1.0 {
                self.warnings.push(format!(
                    "material `{name}`: its {what} is not within 0 and 1; taken as the nearest"
                ));
            }
        };
        check(
            "base colour",
            factor.base.min_element(),
            factor.base.max_element(),
        );
        check("roughness", factor.roughness, factor.roughness);
        check("metallicness", factor.metallic, factor.metallic);
        factor.base = factor.base.clamp(Vec3::ZERO, Vec3::ONE);
        factor.roughness = factor.roughness.clamp(0.0, 1.0);
        factor.metallic = factor.metallic.clamp(0.0, 1.0);
        factor.specular_weight = factor.specular_weight.clamp(0.0, 1.0);
        factor.specular_color = factor.specular_color.max(Vec3::ZERO);
    }

    fn coat(&mut self, coat: &Value, made: &mut Textured, sets: &mut Sets) -> Result<()> {
        let number = |name: &str| coat.get(name).and_then(Value::as_f64).unwrap_or(0.0) as f32;
        made.factor.coat = number("clearcoatFactor").clamp(0.0, 1.0);
        made.factor.coat_roughness = number("clearcoatRoughnessFactor").clamp(0.0, 1.0);
        let document = self.document;
        let mut texture = |name: &str| {
            let info = coat.get(name);
            let reference = info.map(|i| Reference::raw(document, i)).transpose()?;
            Ok::<_, String>(reference.and_then(|r| self.texture(&r, false, sets)))
        };
        made.coat = texture("clearcoatTexture")?;
        made.coat_roughness = texture("clearcoatRoughnessTexture")?;
        let scale = coat
            .get("clearcoatNormalTexture")
            .and_then(|i| i.get("scale"));
        let scale = scale.and_then(Value::as_f64).unwrap_or(1.0) as f32;
        made.coat_normal =
            texture("clearcoatNormalTexture")?.map(|texture| NormalMap { texture, scale });
        Ok(())
    }

    /// A texture, or nothing and a warning if its image cannot be read.
    fn texture(&mut self, from: &Reference<'_>, srgb: bool, sets: &mut Sets) -> Option<Texture> {
        let sampler = from.texture.sampler();
        let wrap = |mode| match mode {
            WrappingMode::ClampToEdge => Wrap::Clamp,
            WrappingMode::MirroredRepeat => Wrap::Mirror,
            WrappingMode::Repeat => Wrap::Repeat,
        };
        Some(Texture {
            image: self.image(&from.texture, srgb)?,
            wrap: [wrap(sampler.wrap_s()), wrap(sampler.wrap_t())],
            nearest: sampler.mag_filter() == Some(gltf::texture::MagFilter::Nearest),
            set: sets.slot(from.set),
            transform: from.transform,
        })
    }

    /// An image of glossiness in alpha as one of roughness in green.
    fn glossy(&mut self, from: &Reference<'_>, factor: f32, sets: &mut Sets) -> Option<Texture> {
        let glossy = self.texture(from, false, sets)?;
        let rough = |pixel: &[u8; 4]| {
            let rough = 255.0 - factor.clamp(0.0, 1.0) * f32::from(pixel[3]);
            [255, rough.round() as u8, 255, 255]
        };
        let key = (from.texture.index(), factor.to_bits());
        let image = self.rough.entry(key).or_insert_with(|| {
            Arc::new(Image {
                pixels: glossy.image.pixels.iter().map(rough).collect(),
                ..(*glossy.image).clone()
            })
        });
        let image = image.clone();
        Some(Texture { image, ..glossy })
    }

    fn image(&mut self, texture: &gltf::Texture<'_>, srgb: bool) -> Option<Arc<Image>> {
        let Some(index) = self.source(texture) else {
            // The same texture may be named by many materials.
            let text = format!(
                "textures[{}] has no image in a format that is read; it is left out",
                texture.index()
            );
            if !self.warnings.contains(&text) {
                self.warnings.push(text);
            }
            return None;
        };
        if let Some(image) = self.images.get(&(index, srgb)) {
            return image.clone();
        }
        // Another use of it has warned already.
        let known = self
            .images
            .get(&(index, !srgb))
            .is_some_and(Option::is_none);
        let image = match self.decode(index) {
            Ok(decoded) => Some(Arc::new(Image::new(&decoded, srgb))),
            Err(e) => {
                if !known {
                    self.warnings
                        .push(format!("images[{index}]: {e}; shown without"));
                }
                None
            }
        };
        self.images.insert((index, srgb), image.clone());
        image
    }

    /// Index of a texture's image: its own, or that of an extension that we read.
    fn source(&self, texture: &gltf::Texture<'_>) -> Option<usize> {
        if let Some(image) = texture.source() {
            return Some(image.index());
        }
        let webp = texture.extension_value("EXT_texture_webp")?;
        let index = usize::try_from(webp.get("source")?.as_u64()?).ok()?;
        (index < self.document.images().len()).then_some(index)
    }

    /// Reads an image from what the JSON says, since the parser panics where that is neither a file nor a view.
    fn decode(&self, index: usize) -> Result<RgbaImage> {
        let image = self.document.as_json().images.get(index);
        let image = image.ok_or("expected an image")?;
        if let Some(view) = image.buffer_view {
            let view = self.document.views().nth(view.value());
            let view = view.ok_or("expected a bufferView")?;
            return image_file::decode(self.buffers.view(&view)?, Path::new(""));
        }
        let uri = image.uri.as_ref();
        let uri = uri.ok_or("expected a uri or a bufferView, found neither")?;
        image_file::decode(&source::resolve(self.path, uri)?, Path::new(uri))
    }
}

impl Sets {
    /// Which of our two sets holds the file's `set`.
    fn slot(&mut self, set: u32) -> usize {
        let slot = self.0.iter().position(|&s| s == set).unwrap_or_else(|| {
            self.0.push(set);
            self.0.len() - 1
        });
        slot.min(1)
    }
}
