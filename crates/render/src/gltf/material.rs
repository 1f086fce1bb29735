//! glTF's materials as ours.

use super::accessor::Buffers;
use super::source;
use crate::image_texture::{Image, Texture, Wrap};
use crate::material::{Material, NormalMap, Opacity, Surface, Textured};
use gltf::json::Value;
use gltf::texture::WrappingMode;
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
    /// The document's bytes.
    pub buffers: &'a Buffers,
    /// Images by index and whether they are colours.
    pub images: HashMap<(usize, bool), Arc<Image>>,
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
    pub fn make(&mut self, document: &gltf::Document, source: &gltf::Material<'_>) -> Result<Made> {
        let mut sets = Sets::default();
        let pbr = source.pbr_metallic_roughness();
        let [r, g, b, mut alpha] = pbr.base_color_factor();
        let mut made = Textured::new(Surface {
            metallic: pbr.metallic_factor(),
            ..Surface::dielectric(Vec3::new(r, g, b), pbr.roughness_factor())
        });
        let texture =
            |info: Option<gltf::texture::Info<'_>>, color, sets: &mut Sets, this: &mut Self| {
                let reference = info.map(|i| Reference::new(&i));
                reference.map(|r| this.texture(&r, color, sets)).transpose()
            };
        made.base = texture(pbr.base_color_texture(), true, &mut sets, self)?;
        let info = pbr.metallic_roughness_texture();
        made.metallic_roughness = texture(info, false, &mut sets, self)?;
        if let Some(old) = source.pbr_specular_glossiness() {
            let [r, g, b, a] = old.diffuse_factor();
            alpha = a;
            made.factor = Surface::dielectric(Vec3::new(r, g, b), 1.0 - old.glossiness_factor());
            made.base = texture(old.diffuse_texture(), true, &mut sets, self)?;
            made.metallic_roughness = None;
        }
        if let Some(info) = source.normal_texture() {
            made.normal = Some(NormalMap {
                texture: self.texture(&Reference::normal(&info), false, &mut sets)?,
                scale: info.scale(),
            });
        }
        if let Some(ior) = source.ior() {
            let ior = if ior >= 1.0 { ior } else { 1.5 };
            made.factor.specular = ((ior - 1.0) / (ior + 1.0)).powi(2) / 0.04;
        }
        if let Some(specular) = source.specular() {
            made.factor.specular *= specular.specular_factor();
            made.specular = texture(specular.specular_texture(), false, &mut sets, self)?;
        }
        if let Some(coat) = source.extension_value("KHR_materials_clearcoat") {
            self.coat(document, coat, &mut made, &mut sets)?;
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

    fn coat(
        &mut self,
        document: &gltf::Document,
        coat: &Value,
        made: &mut Textured,
        sets: &mut Sets,
    ) -> Result<()> {
        let number = |name: &str| coat.get(name).and_then(Value::as_f64).unwrap_or(0.0) as f32;
        made.factor.coat = number("clearcoatFactor").clamp(0.0, 1.0);
        made.factor.coat_roughness = number("clearcoatRoughnessFactor").clamp(0.0, 1.0);
        let mut texture = |name: &str| {
            let info = coat.get(name);
            let reference = info.map(|i| Reference::raw(document, i)).transpose()?;
            reference.map(|r| self.texture(&r, false, sets)).transpose()
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

    fn texture(&mut self, from: &Reference<'_>, srgb: bool, sets: &mut Sets) -> Result<Texture> {
        let sampler = from.texture.sampler();
        let wrap = |mode| match mode {
            WrappingMode::ClampToEdge => Wrap::Clamp,
            WrappingMode::MirroredRepeat => Wrap::Mirror,
            WrappingMode::Repeat => Wrap::Repeat,
        };
        Ok(Texture {
            image: self.image(&from.texture.source(), srgb)?,
            wrap: [wrap(sampler.wrap_s()), wrap(sampler.wrap_t())],
            nearest: sampler.mag_filter() == Some(gltf::texture::MagFilter::Nearest),
            set: sets.slot(from.set),
            transform: from.transform,
        })
    }

    fn image(&mut self, source: &gltf::Image<'_>, srgb: bool) -> Result<Arc<Image>> {
        let key = (source.index(), srgb);
        if let Some(image) = self.images.get(&key) {
            return Ok(image.clone());
        }
        let wrong = |e: String| format!("images[{}]: {e}", source.index());
        let decoded = match source.source() {
            gltf::image::Source::View { view, .. } => {
                source::decode(self.buffers.view(&view).map_err(wrong)?)
            }
            gltf::image::Source::Uri { uri, .. } => {
                source::decode(&source::resolve(self.path, uri).map_err(wrong)?)
            }
        };
        let image = Arc::new(Image::new(&decoded.map_err(wrong)?, srgb));
        self.images.insert(key, image.clone());
        Ok(image)
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
