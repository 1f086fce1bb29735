//! What is printed, painted or stuck on surfaces: pictures, labels, logos, text.

use super::finish::{bold, color, roughness};
use crate::draw::Draw;
use crate::image_texture::{Image, Texture, Wrap};
use crate::material::{Layered, Material, Patterned, Surface, Textured};
use crate::scene::mesh::{Mesh, Model};
use crate::texture::{Pattern, PatternKind};
use lumi_core::glam::{Affine2, Vec2, Vec3};
use std::sync::Arc;

/// Which set of texture coordinates pictures use; the first is part of the solid pattern's space.
const PICTURE_SET: usize = 1;
/// Longest side of a crop in pixels: a period of the texture on the surface is 30 to 300 pixels of a render.
const CROP: usize = 256;

/// A crop of one of the pictures of `draw`, repeated and mirrored over the surface with a period of about `period`;
/// none if there are no pictures.
pub fn picture(draw: &mut Draw, period: [f32; 2]) -> Option<Material> {
    let source = draw.picture()?;
    // Of three places the one with most to see.
    let mut crops: Vec<Image> = (0..3).map(|_| crop(&source, draw)).collect();
    crops.sort_by(|a, b| contrast(a).total_cmp(&contrast(b)));
    let mut chosen = crops.pop()?;
    recolour(&mut chosen, draw);
    let mut texture = Texture::new(Arc::new(chosen));
    texture.wrap = [Wrap::Mirror; 2];
    texture.set = PICTURE_SET;
    let scale = Vec2::splat(1.0 / draw.log_range(period[0], period[1]));
    let shift = Vec2::new(draw.unit(), draw.unit());
    let quarter = 0.25 * std::f32::consts::TAU * draw.count(0, 3) as f32;
    texture.transform = Affine2::from_scale_angle_translation(scale, quarter, shift);
    let mut surface = Surface::dielectric(Vec3::ONE, roughness(draw));
    if draw.chance(0.25) {
        surface.coat = draw.range(0.4, 1.0);
        surface.coat_roughness = draw.range(0.02, 0.2);
    }
    let mut textured = Textured::new(surface);
    textured.base = Some(texture);
    Some(Material::Textured(Box::new(textured)))
}

/// A window of 1/8 to all of the shorter side, thinned out to at most [`CROP`] pixels.
fn crop(source: &Image, draw: &mut Draw) -> Image {
    let shorter = source.width.min(source.height);
    let side = ((shorter as f32 * draw.log_range(0.125, 1.0)) as usize).clamp(1, shorter);
    let left = draw.count(0, source.width - side);
    let top = draw.count(0, source.height - side);
    let step = side.div_ceil(CROP);
    let n = side / step;
    let at = |i: usize| {
        let (x, y) = (left + step * (i % n), top + step * (i / n));
        let [r, g, b, _] = source.pixels[y * source.width + x];
        [r, g, b, 255]
    };
    Image {
        width: n,
        height: n,
        pixels: (0..n * n).map(at).collect(),
        srgb: source.srgb,
    }
}

/// Sum of the variances of the channels.
fn contrast(image: &Image) -> f32 {
    let n = image.pixels.len() as f32;
    let variance = |k: usize| {
        let values = image.pixels.iter().map(|p| f32::from(p[k]));
        let (sum, squares) = values.fold((0.0, 0.0), |(s, q), v| (s + v, q + v * v));
        (squares / n - (sum / n) * (sum / n)).max(0.0)
    };
    variance(0) + variance(1) + variance(2)
}

/// Swaps channels and stretches contrast, so that few pictures show many colours.
fn recolour(image: &mut Image, draw: &mut Draw) {
    let order = if draw.chance(0.4) {
        let orders = [[0, 2, 1], [1, 0, 2], [1, 2, 0], [2, 0, 1], [2, 1, 0]];
        draw.pick(&orders)
    } else {
        [0, 1, 2]
    };
    let stretch = if draw.chance(0.5) {
        draw.range(1.0, 2.0)
    } else {
        1.0
    };
    let n = image.pixels.len().max(1) as f32;
    let sum: f32 = image.pixels.iter().map(|p| f32::from(p[1])).sum();
    // Dark pictures become middling: a black ground shows no shadows.
    let (mean, target) = (sum / n, (sum / n).clamp(90.0, 200.0));
    for pixel in &mut image.pixels {
        let old = *pixel;
        for (new, from) in pixel.iter_mut().zip(order) {
            let value = target + stretch * (f32::from(old[from]) - mean);
            *new = value.clamp(6.0, 245.0) as u8;
        }
    }
}

/// A label, a logo or lettering on top of another material.
pub fn labelled(draw: &mut Draw, below: Material) -> Material {
    let size = draw.range(0.35, 1.1);
    let kind = match draw.count(0, 3) {
        0 => PatternKind::Emblem(draw.pick(&[0, 3, 4, 5, 6, 8])),
        1 => PatternKind::Bands,
        _ => PatternKind::Patch,
    };
    let mask = if kind == PatternKind::Bands {
        // A printed band around.
        Pattern {
            axis: 1,
            offset: Vec3::splat(draw.unit()),
            ..flat(kind, Vec3::splat(draw.range(0.4, 0.9)), draw)
        }
    } else {
        let aspect = Vec3::new(draw.range(0.6, 1.6), 1.0, 1.0);
        let mut mask = flat(kind, aspect / size, draw);
        let shift = draw.vector(-0.3, 0.3);
        mask.offset = Vec3::new(shift.x, 0.0, shift.z);
        mask.axis = draw.count(0, 2);
        mask
    };
    let edge = if kind == PatternKind::Bands {
        let low = draw.range(0.4, 0.8);
        [low, low + 1e-3]
    } else {
        [0.5, 0.501]
    };
    let axis = if kind == PatternKind::Bands {
        0
    } else {
        mask.axis
    };
    let mut above = if draw.chance(0.3) {
        picture(draw, [0.3, 1.0]).unwrap_or_else(|| lettering(draw, size))
    } else {
        lettering(draw, size)
    };
    if let Material::Patterned(p) = &mut above {
        p.pattern.axis = axis;
    }
    Material::Layered(Box::new(Layered {
        below,
        above,
        mask,
        edge,
    }))
}

/// A pattern without shift or wobble.
pub fn flat(kind: PatternKind, scale: Vec3, draw: &mut Draw) -> Pattern {
    Pattern {
        kind,
        axis: 0,
        scale,
        offset: Vec3::ZERO,
        warp: 0.0,
        seed: draw.bits(),
    }
}

/// Marks in ink on paper, or a bold figure, about `size` across.
pub fn lettering(draw: &mut Draw, size: f32) -> Material {
    let kinds = [
        PatternKind::Print,
        PatternKind::Print,
        PatternKind::Print,
        PatternKind::Dots,
        PatternKind::Slabs,
        PatternKind::Zigzag,
        PatternKind::Checks,
        PatternKind::Rings,
    ];
    let kind = draw.pick(&kinds);
    let per_size = match kind {
        PatternKind::Print => draw.log_range(1.5, 9.0),
        _ => draw.log_range(2.0, 6.0),
    };
    let mut pattern = flat(kind, Vec3::splat(per_size / size), draw);
    if kind == PatternKind::Rings {
        pattern.scale.z = 0.1;
    } else {
        pattern.offset = draw.vector(-5.0, 5.0);
    }
    let rough = roughness(draw);
    let count = if kind == PatternKind::Print { 2 } else { 3 };
    let colors = if kind == PatternKind::Print && draw.chance(0.6) {
        let light = Vec3::ONE.lerp(color(draw), draw.range(0.0, 0.3)) * draw.range(0.7, 0.92);
        let ink = if draw.chance(0.5) {
            Vec3::splat(draw.range(0.01, 0.06))
        } else {
            bold(draw, 1)[0]
        };
        if draw.chance(0.75) {
            vec![light, ink]
        } else {
            vec![ink, light]
        }
    } else {
        bold(draw, count)
    };
    Material::Patterned(Patterned {
        pattern,
        palette: colors
            .into_iter()
            .map(|c| Surface::dielectric(c, rough))
            .collect(),
        smooth: false,
        bump: None,
    })
}

/// Whether a material looks up pictures of [`picture`].
fn pictured(material: &Material) -> bool {
    match material {
        Material::Textured(t) => t.base.as_ref().is_some_and(|b| b.set == PICTURE_SET),
        Material::Layered(l) => pictured(&l.below) || pictured(&l.above),
        Material::Plain(_) | Material::Patterned(_) => false,
    }
}

/// Gives triangles with pictures texture coordinates: their solid space seen along the axis that they face most.
pub fn unfold(model: &mut Model) {
    let with: Vec<bool> = model.materials.iter().map(pictured).collect();
    if !with.contains(&true) {
        return;
    }
    let Mesh {
        positions,
        normals,
        coords,
        second,
        colors,
        triangles,
        material,
        ..
    } = &mut model.mesh;
    second.resize(positions.len(), Vec2::ZERO);
    for (triangle, &m) in triangles.iter_mut().zip(material.iter()) {
        if !with[usize::from(m)] {
            continue;
        }
        let [a, b, c] = triangle.map(|v| coords[v as usize]);
        let facing = (b - a).cross(c - a).abs();
        for v in triangle {
            // Its own vertex: neighbours may face another axis.
            let i = *v as usize;
            let p = coords[i];
            second.push(if facing.y >= facing.x && facing.y >= facing.z {
                Vec2::new(p.x, p.z)
            } else if facing.x >= facing.z {
                Vec2::new(p.y, p.z)
            } else {
                Vec2::new(p.x, p.y)
            });
            if let Some(&color) = colors.get(i) {
                colors.push(color);
            }
            positions.push(positions[i]);
            normals.push(normals[i]);
            coords.push(p);
            *v = (positions.len() - 1) as u32;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::material::Coords;
    use crate::objects::part::Assembly;
    use crate::objects::primitives::rounded_box;
    use crate::scene::Geometry;
    use lumi_core::Seed;

    /// Red and blue diagonal stripes, of which every crop has both.
    fn stripes() -> Arc<[Arc<Image>]> {
        let row = |i: usize| {
            if (i + i / 64) % 8 < 4 {
                [240, 10, 10, 255]
            } else {
                [10, 10, 240, 255]
            }
        };
        let image = Image {
            width: 64,
            height: 64,
            pixels: (0..64 * 64).map(row).collect(),
            srgb: true,
        };
        Arc::from([Arc::new(image)])
    }

    #[test]
    fn pictures_need_a_collection_and_show_on_all_faces() {
        assert!(picture(&mut Draw::new(Seed(1), "none"), [0.5, 1.0]).is_none());
        let mut draw = Draw::new(Seed(1), "some").with_pictures(&stripes());
        let mut assembly = Assembly::default();
        let material = picture(&mut draw, [0.4, 0.41]).expect("a picture");
        let m = assembly.material(material);
        assembly.add(&rounded_box(Vec3::ONE, 0.0), m);
        let mut model = assembly.finish();
        unfold(&mut model);
        assert_eq!(model.mesh.second.len(), model.mesh.positions.len());
        let geometry = Geometry::new(model);
        // A period is 0.4 wide, so that a line across each face meets more than one colour.
        for axis in 0..3 {
            let mut seen = Vec::new();
            for i in 0..40 {
                let mut from = Vec3::splat(-0.7 + 0.035 * i as f32);
                from[axis] = 3.0;
                let mut direction = Vec3::ZERO;
                direction[axis] = -1.0;
                let hit = geometry.intersect(from, direction).expect("the box");
                seen.push(geometry.shading(from, direction, &hit).surface.base);
            }
            let far = |c: &Vec3| c.distance(seen[0]) > 0.1;
            assert!(seen.iter().any(far), "axis {axis}: {seen:?}");
        }
    }

    #[test]
    fn labels_cover_a_part() {
        let plain = Material::Plain(Surface::dielectric(Vec3::new(0.123, 0.456, 0.789), 0.5));
        let mut covered = 0;
        for i in 0..40 {
            let mut draw = Draw::new(Seed(2).index(i), "label");
            let m = labelled(&mut draw, plain.clone());
            let points = (0..1000).map(|_| draw.vector(-1.0, 1.0));
            let own = points
                .filter(|p| m.surface(&Coords::solid(*p)).base.x == 0.123)
                .count();
            assert!(own > 150, "{i}: {own}");
            covered += usize::from(own < 980);
        }
        assert!(covered > 30, "{covered}");
    }
}
