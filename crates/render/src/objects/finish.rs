//! Random materials: colours over the whole range, patterns, roughness, some metal.

use crate::draw::Draw;
use crate::material::{Material, Patterned, Surface};
use crate::texture::{Pattern, PatternKind};
use lumi_core::color::srgb_decode;
use lumi_core::glam::Vec3;

/// A colour given as on a screen, made linear.
fn screen(r: f32, g: f32, b: f32) -> Vec3 {
    Vec3::new(srgb_decode(r), srgb_decode(g), srgb_decode(b))
}

fn hsv(h: f32, s: f32, v: f32) -> Vec3 {
    let channel = |n: f32| {
        let k = (n + 6.0 * h) % 6.0;
        v - v * s * k.min(4.0 - k).clamp(0.0, 1.0)
    };
    screen(channel(5.0), channel(3.0), channel(1.0))
}

/// A base colour of a dielectric.
pub fn color(draw: &mut Draw) -> Vec3 {
    let kind = draw.unit();
    if kind < 0.28 {
        hsv(draw.unit(), draw.range(0.6, 1.0), draw.range(0.5, 1.0))
    } else if kind < 0.5 {
        hsv(draw.unit(), draw.range(0.15, 0.6), draw.range(0.4, 0.95))
    } else if kind < 0.62 {
        let v = draw.range(0.75, 0.95);
        screen(v, v * draw.range(0.94, 1.0), v * draw.range(0.86, 1.0))
    } else if kind < 0.72 {
        let v = draw.range(0.08, 0.3);
        hsv(draw.unit(), draw.range(0.0, 0.4), v)
    } else if kind < 0.84 {
        // Wood, leather, earth.
        hsv(
            draw.range(0.03, 0.12),
            draw.range(0.35, 0.8),
            draw.range(0.25, 0.8),
        )
    } else if kind < 0.92 {
        // Skin.
        screen(0.93, 0.74, 0.62) * draw.range(0.12, 1.0)
    } else {
        let v = draw.range(0.3, 0.7);
        screen(v, v, v)
    }
}

/// A metal's colour.
fn metal(draw: &mut Draw) -> Vec3 {
    let known = [
        Vec3::new(1.0, 0.78, 0.34),
        Vec3::new(0.95, 0.64, 0.54),
        Vec3::new(0.91, 0.92, 0.92),
        Vec3::new(0.56, 0.57, 0.58),
        Vec3::new(0.97, 0.96, 0.91),
        Vec3::new(0.4, 0.36, 0.33),
    ];
    let base = draw.pick(&known);
    if draw.chance(0.2) {
        // Anodised.
        base.lerp(color(draw), 0.7)
    } else {
        base
    }
}

fn roughness(draw: &mut Draw) -> f32 {
    if draw.chance(0.3) {
        draw.range(0.1, 0.35)
    } else {
        draw.range(0.3, 1.0)
    }
}

/// A plain surface; metal with probability `metal_share`.
pub fn surface(draw: &mut Draw, metal_share: f32) -> Surface {
    if draw.chance(metal_share) {
        Surface::metal(metal(draw), draw.range(0.12, 0.6))
    } else {
        Surface::dielectric(color(draw), roughness(draw))
    }
}

/// A random pattern for parts of about unit size.
fn pattern(draw: &mut Draw) -> (Pattern, bool) {
    let kinds = [
        PatternKind::Noise(4),
        PatternKind::Noise(2),
        PatternKind::Bands,
        PatternKind::Slabs,
        PatternKind::Checks,
        PatternKind::Bricks,
        PatternKind::Spots,
        PatternKind::Mosaic,
        PatternKind::Rings,
        PatternKind::Gradient,
        PatternKind::Veins,
    ];
    let kind = draw.pick(&kinds);
    let mut scale = Vec3::splat(draw.log_range(1.5, 7.0));
    if matches!(kind, PatternKind::Bricks) {
        scale = Vec3::new(0.5, 0.5, 1.0) * draw.log_range(3.0, 8.0);
    } else if matches!(kind, PatternKind::Rings) {
        // Grain is long along the trunk.
        scale *= Vec3::new(1.0, 1.0, 0.15);
    } else if draw.chance(0.25) {
        scale *= draw.vector(0.3, 1.5);
    }
    // Bands and slabs run along any axis.
    if matches!(kind, PatternKind::Gradient) {
        scale = Vec3::splat(draw.range(0.35, 0.6));
    }
    let smooth = match kind {
        PatternKind::Noise(_) | PatternKind::Gradient | PatternKind::Rings => draw.chance(0.75),
        PatternKind::Bands | PatternKind::Veins => draw.chance(0.5),
        _ => false,
    };
    let offset = match kind {
        PatternKind::Gradient => Vec3::splat(0.5),
        PatternKind::Rings => draw.vector(-0.5, 0.5),
        _ => draw.vector(-5.0, 5.0),
    };
    let warp = if draw.chance(0.35) {
        draw.range(0.05, 0.5)
    } else {
        0.0
    };
    let pattern = Pattern {
        kind,
        axis: draw.count(0, 2),
        scale,
        offset,
        warp,
        seed: draw.bits(),
    };
    (pattern, smooth)
}

/// A material: plain or patterned with two to four surfaces.
pub fn material(draw: &mut Draw) -> Material {
    if draw.chance(0.45) {
        return Material::Plain(surface(draw, 0.18));
    }
    let (pattern, smooth) = pattern(draw);
    let first = surface(draw, 0.12);
    let mut palette = vec![first];
    for _ in 0..draw.count(1, 3) {
        let base = match draw.count(0, 2) {
            // A shade of the first, or a colour of its own.
            0 => first.base * draw.range(0.25, 0.8),
            1 => first.base.lerp(Vec3::ONE, draw.range(0.1, 0.5)),
            _ => color(draw),
        };
        let roughness = if draw.chance(0.5) {
            first.roughness
        } else {
            roughness(draw)
        };
        // Metal keeps metal mostly; a mixture is paint or rust.
        let metallic = if draw.chance(0.85) {
            first.metallic
        } else {
            0.0
        };
        palette.push(Surface {
            metallic,
            ..Surface::dielectric(base, roughness)
        });
    }
    Material::Patterned(Patterned {
        pattern,
        palette,
        smooth,
        bump: None,
    })
}

/// Changes the colours and the roughness of a model's material.
pub fn vary(material: &mut Material, draw: &mut Draw) {
    let tint = if draw.chance(0.5) {
        let c = color(draw);
        Vec3::ONE.lerp(c / c.max_element().max(0.05), draw.range(0.0, 0.9))
    } else {
        Vec3::ONE
    };
    let rougher = draw.log_range(0.6, 1.6);
    let surface = match material {
        Material::Plain(surface) => surface,
        Material::Textured(textured) => &mut textured.factor,
        Material::Patterned(_) | Material::Layered(_) => return,
    };
    surface.base = (surface.base * tint).min(Vec3::ONE);
    surface.roughness = (surface.roughness * rougher).clamp(0.1, 1.0);
}
