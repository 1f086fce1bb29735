//! Random materials: colours over the whole range, patterns, roughness, some metal.

use super::print;
use crate::draw::Draw;
use crate::material::{Bump, Layered, Material, Patterned, Surface};
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

/// `count` colours that stand apart: saturated, of different hues, with some white and black.
pub fn bold(draw: &mut Draw, count: usize) -> Vec<Vec3> {
    let hue = draw.unit();
    (0..count)
        .map(|i| match draw.unit() {
            k if k < 0.15 => Vec3::splat(draw.range(0.7, 0.9)),
            k if k < 0.28 => Vec3::splat(draw.range(0.01, 0.05)),
            _ => {
                // Golden-ratio steps keep hues apart.
                let h = (hue + 0.618 * i as f32 + draw.range(-0.06, 0.06)).rem_euclid(1.0);
                hsv(h, draw.range(0.7, 1.0), draw.range(0.45, 1.0))
            }
        })
        .collect()
}

/// A dielectric's roughness.
pub fn roughness(draw: &mut Draw) -> f32 {
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
        PatternKind::Planks,
        PatternKind::Tiles,
        PatternKind::Plaid,
        PatternKind::Zigzag,
        PatternKind::Weave,
        PatternKind::Pebbles,
        PatternKind::Dots,
        PatternKind::Print,
    ];
    let kind = draw.pick(&kinds);
    let mut scale = Vec3::splat(draw.log_range(1.5, 7.0));
    if matches!(kind, PatternKind::Bricks) {
        scale = Vec3::new(0.5, 0.5, 1.0) * draw.log_range(3.0, 8.0);
    } else if matches!(kind, PatternKind::Rings) {
        // Grain is long along the trunk.
        scale *= Vec3::new(1.0, 1.0, 0.15);
    } else if matches!(kind, PatternKind::Plaid) {
        scale *= 0.35;
    } else if draw.chance(0.25) {
        scale *= draw.vector(0.3, 1.5);
    }
    // Bands and slabs run along any axis.
    if matches!(kind, PatternKind::Gradient) {
        scale = Vec3::splat(draw.range(0.35, 0.6));
    }
    let smooth = match kind {
        PatternKind::Noise(_) | PatternKind::Gradient | PatternKind::Rings => draw.chance(0.75),
        PatternKind::Bands | PatternKind::Veins | PatternKind::Weave => draw.chance(0.5),
        PatternKind::Planks | PatternKind::Plaid => draw.chance(0.8),
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

/// A material: plain, patterned, with a picture or a label, skin, or one that wears through another.
pub fn material(draw: &mut Draw) -> Material {
    let kind = draw.unit();
    if kind < 0.22 {
        let mut plain = surface(draw, 0.18);
        if draw.chance(0.12) {
            // Lacquer or glaze.
            plain.coat = draw.range(0.4, 1.0);
            plain.coat_roughness = draw.range(0.02, 0.2);
        }
        if draw.chance(0.25) {
            return Material::Patterned(Patterned {
                pattern: pattern(draw).0,
                palette: vec![plain],
                smooth: false,
                bump: Some(bump(draw)),
            });
        }
        return Material::Plain(plain);
    }
    if kind < 0.56 {
        return patterned(draw, 0.12);
    }
    if kind < 0.72 {
        return print::picture(draw, [0.5, 3.0]).unwrap_or_else(|| patterned(draw, 0.0));
    }
    if kind < 0.85 {
        let below = if draw.chance(0.7) {
            Material::Plain(surface(draw, 0.15))
        } else {
            patterned(draw, 0.1)
        };
        return print::labelled(draw, below);
    }
    if kind < 0.89 {
        return skin(draw);
    }
    let (below, above) = (patterned(draw, 0.5), worn(draw));
    let noise = draw.chance(0.6);
    let mask = Pattern {
        kind: if noise {
            PatternKind::Noise(5)
        } else {
            pattern(draw).0.kind
        },
        axis: draw.count(0, 2),
        scale: Vec3::splat(draw.log_range(1.0, 4.0)),
        offset: draw.vector(-5.0, 5.0),
        warp: draw.range(0.0, 0.6),
        seed: draw.bits(),
    };
    let low = draw.range(0.35, 0.65);
    let width = if noise { draw.range(0.02, 0.2) } else { 0.02 };
    Material::Layered(Box::new(Layered {
        below,
        above,
        mask,
        edge: [low, low + width],
    }))
}

/// Skin, wax or fruit: mottled, with a soft shine and fine pores.
pub fn skin(draw: &mut Draw) -> Material {
    let tone = if draw.chance(0.7) {
        screen(0.93, 0.72, 0.6) * draw.range(0.15, 1.0)
    } else {
        color(draw)
    };
    let rough = draw.range(0.35, 0.6);
    let shade = |t: Vec3| Surface::dielectric((tone * t).min(Vec3::splat(0.95)), rough);
    let flush = Vec3::new(1.05, draw.range(0.6, 0.85), draw.range(0.55, 0.85));
    Material::Patterned(Patterned {
        pattern: Pattern {
            kind: PatternKind::Noise(3),
            axis: 0,
            scale: Vec3::splat(draw.log_range(1.0, 5.0)),
            offset: draw.vector(-5.0, 5.0),
            warp: 0.0,
            seed: draw.bits(),
        },
        palette: vec![shade(flush), shade(Vec3::ONE), shade(Vec3::splat(0.85))],
        smooth: true,
        bump: draw.chance(0.5).then(|| bump(draw)),
    })
}

/// What lies over a layered material: rust, dirt, moss, snow, paint.
fn worn(draw: &mut Draw) -> Material {
    let base = match draw.count(0, 4) {
        0 => screen(0.45, 0.22, 0.1) * draw.range(0.5, 1.3),
        1 => screen(0.35, 0.3, 0.25) * draw.range(0.4, 1.2),
        2 => screen(0.3, 0.42, 0.12) * draw.range(0.4, 1.2),
        3 => Vec3::splat(draw.range(0.7, 0.9)),
        _ => color(draw),
    };
    let rough = Surface::dielectric(base, draw.range(0.5, 1.0));
    let other = Surface {
        base: rough.base * draw.range(0.4, 0.9),
        ..rough
    };
    Material::Patterned(Patterned {
        pattern: Pattern {
            kind: PatternKind::Noise(4),
            axis: 0,
            scale: Vec3::splat(draw.log_range(4.0, 12.0)),
            offset: draw.vector(-5.0, 5.0),
            warp: 0.0,
            seed: draw.bits(),
        },
        palette: vec![rough, other],
        smooth: true,
        bump: draw.chance(0.6).then(|| bump(draw)),
    })
}

/// Relief: dents, scratches, hammered or woven surfaces, tiles.
fn bump(draw: &mut Draw) -> Bump {
    let kinds = [
        PatternKind::Noise(4),
        PatternKind::Noise(2),
        PatternKind::Noise(3),
        PatternKind::Bands,
        PatternKind::Bricks,
        PatternKind::Spots,
        PatternKind::Veins,
    ];
    let kind = draw.pick(&kinds);
    let mut scale = Vec3::splat(draw.log_range(4.0, 18.0));
    if draw.chance(0.2) {
        // Brushed or fluted.
        scale *= Vec3::new(1.0, 1.0, 0.1);
    }
    // A relief as deep as it is wide would be geometry.
    let height = draw.range(0.05, 0.35) / scale.max_element();
    Bump {
        pattern: Pattern {
            kind,
            axis: draw.count(0, 2),
            scale,
            offset: draw.vector(-5.0, 5.0),
            warp: if draw.chance(0.4) {
                draw.range(0.05, 0.3)
            } else {
                0.0
            },
            seed: draw.bits(),
        },
        height,
    }
}

/// Two to four surfaces in a pattern; metals with probability `metal_share`.
pub fn patterned(draw: &mut Draw, metal_share: f32) -> Material {
    let (pattern, smooth) = pattern(draw);
    let first = surface(draw, metal_share);
    let mut palette = vec![first];
    let strong = bold(draw, 4);
    let is_bold = first.metallic == 0.0 && draw.chance(0.5);
    if is_bold {
        palette[0].base = strong[0];
    }
    for strong in strong.iter().skip(1).take(draw.count(1, 3)) {
        let base = match draw.count(0, 2) {
            _ if is_bold => *strong,
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
    let bump = match draw.count(0, 5) {
        // Relief that follows the colours: tiles, planks, pebbles.
        0 => Some(Bump {
            height: draw.range(0.05, 0.3) / pattern.scale.max_element(),
            pattern: pattern.clone(),
        }),
        1 => Some(bump(draw)),
        _ => None,
    };
    Material::Patterned(Patterned {
        pattern,
        palette,
        smooth,
        bump,
    })
}

/// Raises roughness to at least `least`, and takes metal away.
pub fn at_least(material: &mut Material, least: f32) {
    let tame = |s: &mut Surface| {
        s.roughness = s.roughness.max(least);
        s.metallic = 0.0;
        s.coat = 0.0;
    };
    match material {
        Material::Plain(s) => tame(s),
        Material::Patterned(p) => p.palette.iter_mut().for_each(tame),
        Material::Layered(l) => {
            at_least(&mut l.below, least);
            at_least(&mut l.above, least);
        }
        Material::Textured(t) => tame(&mut t.factor),
    }
}

/// Puts a clear coat over a material.
pub fn lacquer(material: &mut Material, roughness: f32) {
    let coat = |s: &mut Surface| {
        s.coat = 1.0;
        s.coat_roughness = roughness;
    };
    match material {
        Material::Plain(s) => coat(s),
        Material::Patterned(p) => p.palette.iter_mut().for_each(coat),
        Material::Layered(l) => {
            lacquer(&mut l.below, roughness);
            lacquer(&mut l.above, roughness);
        }
        Material::Textured(t) => coat(&mut t.factor),
    }
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
