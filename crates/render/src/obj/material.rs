//! MTL's materials as ours.

use super::lines::text;
use super::mtl::{Kind, Map, Mtl};
use crate::image_file;
use crate::image_texture::{Image, Texture};
use crate::material::{NormalMap, Opacity, Surface, Textured};
use lumi_core::glam::{Affine2, Mat2, Vec2, Vec3};
use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// What is shown without a material: Blender's default grey.
pub fn grey() -> Textured {
    Textured::new(Surface::dielectric(GREY, 0.5))
}

const GREY: Vec3 = Vec3::splat(0.8);

/// Makes materials, and each image once.
pub struct Maker<'a> {
    /// The model's folder.
    pub folder: &'a Path,
    /// Files that were read, or why not.
    pub images: HashMap<PathBuf, Option<Decoded>>,
    /// What is not shown.
    pub warnings: Vec<String>,
}

/// An image as colours and as numbers; whichever was asked for.
#[derive(Clone, Default)]
pub struct Decoded {
    srgb: Option<Arc<Image>>,
    linear: Option<Arc<Image>>,
}

impl Maker<'_> {
    /// The material as Blender's importer makes it.
    pub fn make(&mut self, m: &Mtl) -> Textured {
        let roughness = m.roughness.or_else(|| {
            let shine = (m.shine? / 1000.0).clamp(0.0, 1.0);
            Some(1.0 - shine.sqrt())
        });
        let share = |v: Option<f32>| v.unwrap_or(0.0).clamp(0.0, 1.0);
        let base = m.diffuse.unwrap_or(GREY);
        if base.max_element() > 1.0 {
            self.warn(m, &format!("Kd {base} is over 1; shown as 1"));
        }
        let mut made = Textured::new(Surface {
            metallic: share(m.metallic),
            coat: share(m.coat),
            coat_roughness: share(m.coat_roughness),
            ..Surface::dielectric(
                base.clamp(Vec3::ZERO, Vec3::ONE),
                roughness.unwrap_or(0.5).clamp(0.0, 1.0),
            )
        });
        if let Some(ks) = m.specular {
            made.factor.specular = 2.0 * (ks.element_sum() / 3.0).clamp(0.0, 1.0);
        }
        self.color(m, &mut made);
        self.properties(m, &mut made);
        self.relief(m, &mut made);
        if m.glows {
            self.warn(m, "its own light is left out");
        }
        made
    }

    /// Base colour and opacity.
    fn color(&mut self, m: &Mtl, made: &mut Textured) {
        let (color, mask) = (map(m, Kind::Color), map(m, Kind::Opacity));
        made.base = color.and_then(|c| self.texture(m, c, true));
        if made.base.is_some() {
            // The image takes the place of Kd, which many files have as black then.
            made.factor.base = Vec3::ONE;
        } else if color.is_some() && made.factor.base == Vec3::ZERO {
            made.factor.base = GREY;
        }
        let mut opacity = m.opacity.unwrap_or(1.0).clamp(0.0, 1.0);
        let mut blended = opacity < 1.0;
        if let Some(mask) = mask
            && let Some(texture) = self.texture(m, mask, true)
        {
            match &made.base {
                None => made.base = Some(texture.showing(texture.image.white_masked())),
                Some(base) if Arc::ptr_eq(&base.image, &texture.image) => {}
                Some(base) if base.transform == texture.transform => {
                    made.base = Some(base.showing(base.image.masked_by(&texture.image)));
                }
                Some(_) => self.warn(m, "map_d has other options than map_Kd; left out"),
            }
            // As for Kd, the image takes the place of the number.
            (blended, opacity) = (true, 1.0);
        }
        if opacity == 0.0 {
            self.warn(m, "d 0: it cannot be seen");
        }
        if blended {
            made.opacity = Opacity::Blend { factor: opacity };
        }
    }

    /// Roughness is read from green and metallicness from blue; grey images have both alike.
    fn properties(&mut self, m: &Mtl, made: &mut Textured) {
        let (rough, metal) = (map(m, Kind::Roughness), map(m, Kind::Metallic));
        if let (Some(r), Some(m_)) = (rough, metal)
            && r.file != m_.file
        {
            self.warn(m, "map_Pm beside map_Pr is left out");
        }
        let Some(map) = rough.or(metal) else { return };
        made.metallic_roughness = self.texture(m, map, false);
        if made.metallic_roughness.is_some() {
            if rough.is_some() {
                made.factor.roughness = 1.0;
            }
            if metal.is_some_and(|m| m.file == map.file) {
                made.factor.metallic = 1.0;
            }
        }
    }

    fn relief(&mut self, m: &Mtl, made: &mut Textured) {
        let (normal, bump) = (map(m, Kind::Normal), map(m, Kind::Bump));
        let Some(map) = normal.or(bump) else { return };
        let Some(texture) = self.texture(m, map, false) else {
            return;
        };
        if normal.is_none() && texture.image.is_grey() {
            self.warn(m, "map_Bump holds heights, which are left out");
            return;
        }
        made.normal = Some(NormalMap {
            texture,
            scale: map.strength.max(0.0),
        });
    }

    fn warn(&mut self, m: &Mtl, what: &str) {
        self.warnings
            .push(format!("material `{}`: {what}", text(&m.name)));
    }

    /// An image with its options, or a warning that it is not there.
    fn texture(&mut self, m: &Mtl, map: &Map, srgb: bool) -> Option<Texture> {
        let Some(file) = image_file::beside(&[&m.folder, self.folder], &map.file) else {
            let name = text(&map.file);
            // One warning, however many materials use it.
            if self.images.insert(PathBuf::from(&name), None).is_none() {
                self.warn(m, &format!("texture `{name}` is not there; shown without"));
            }
            return None;
        };
        let seen = self.images.get(&file).cloned();
        let mut decoded = match seen {
            Some(known) => known?,
            None => Decoded::default(),
        };
        let slot = if srgb {
            &mut decoded.srgb
        } else {
            &mut decoded.linear
        };
        if slot.is_none() {
            match image_file::read(&file) {
                Ok(pixels) => *slot = Some(Arc::new(Image::new(&pixels, srgb))),
                Err(e) => {
                    self.images.insert(file, None);
                    let name = text(&map.file);
                    self.warn(m, &format!("texture `{name}`: {e}; shown without"));
                    return None;
                }
            }
        }
        let image = slot.clone()?;
        self.images.insert(file, Some(decoded));
        let (s, o) = (map.scale, map.offset);
        Some(Texture {
            // In images v points down: 1 − ((1 − v)·s + o).
            transform: Affine2::from_mat2_translation(
                Mat2::from_diagonal(s),
                Vec2::new(o.x, 1.0 - s.y - o.y),
            ),
            ..Texture::new(image)
        })
    }
}

fn map(m: &Mtl, kind: Kind) -> Option<&Map> {
    m.maps.iter().find(|map| map.kind == kind)
}
