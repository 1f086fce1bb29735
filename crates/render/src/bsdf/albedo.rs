//! Directional albedo of single-scattering GGX, in tables over the cosine of the view and √α.

use super::{MIN_ALPHA, fresnel_share, masking, schlick_share, visible_normal};
use lumi_core::glam::{Vec2, Vec3};
use std::sync::LazyLock;

/// Albedo for two reflectances; one that is `f0` head on has `f0 · (whole − edge) + edge`.
#[derive(Clone, Copy, Debug, Default)]
pub struct Albedo {
    /// Of a surface that reflects everything.
    pub whole: f32,
    /// Of one that reflects nothing head on and everything at grazing angles.
    pub edge: f32,
}

impl Albedo {
    fn lerp(self, other: Self, t: f32) -> Self {
        Self {
            whole: self.whole + t * (other.whole - self.whole),
            edge: self.edge + t * (other.edge - self.edge),
        }
    }
}

/// Points along each axis of a table.
const SIDE: usize = 32;
/// Indices of refraction that have a table.
const IORS: [f32; 6] = [1.02, 1.1, 1.2, 1.33, 1.5, 1.8];

struct Tables {
    schlick: Vec<Albedo>,
    dielectric: Vec<Vec<Albedo>>,
    /// Mean of `whole` over the cosine-weighted hemisphere, per √α.
    mean: Vec<f32>,
}

static TABLES: LazyLock<Tables> = LazyLock::new(Tables::new);

/// Albedo under Schlick's Fresnel term, or under that of a dielectric with this index of refraction.
pub fn lookup(ior: Option<f32>, cosine: f32, alpha: f32) -> Albedo {
    let tables = &*TABLES;
    let Some(ior) = ior else {
        return interpolate(&tables.schlick, cosine, alpha);
    };
    let last = IORS.len() - 2;
    let i = IORS[1..=last].iter().take_while(|&&n| n <= ior).count();
    let t = ((ior - IORS[i]) / (IORS[i + 1] - IORS[i])).clamp(0.0, 1.0);
    let at = |i: usize| interpolate(&tables.dielectric[i], cosine, alpha);
    if t == 0.0 {
        at(i)
    } else {
        at(i).lerp(at(i + 1), t)
    }
}

/// Mean albedo of a surface that reflects everything.
pub fn mean(alpha: f32) -> f32 {
    let (j, t) = position(alpha.min(1.0).sqrt());
    let m = &TABLES.mean;
    m[j] + t * (m[j + 1] - m[j])
}

fn position(x: f32) -> (usize, f32) {
    let x = x.clamp(0.0, 1.0) * (SIDE - 1) as f32;
    let i = (x as usize).min(SIDE - 2);
    (i, x - i as f32)
}

fn interpolate(table: &[Albedo], cosine: f32, alpha: f32) -> Albedo {
    let ((i, x), (j, y)) = (position(cosine), position(alpha.min(1.0).sqrt()));
    let row = |j: usize| table[j * SIDE + i].lerp(table[j * SIDE + i + 1], x);
    row(j).lerp(row(j + 1), y)
}

impl Tables {
    fn new() -> Self {
        let schlick = table(schlick_share);
        let mean = (0..SIDE).map(|j| {
            // ∫ 2 µ E(µ) dµ by the trapezium rule.
            let value = |i: usize| {
                let cosine = i as f32 / (SIDE - 1) as f32;
                2.0 * cosine * schlick[j * SIDE + i].whole
            };
            let inner: f32 = (1..SIDE - 1).map(value).sum();
            (inner + 0.5 * (value(0) + value(SIDE - 1))) / (SIDE - 1) as f32
        });
        Self {
            mean: mean.collect(),
            dielectric: IORS
                .iter()
                .map(|&ior| table(|c| fresnel_share(ior, c)))
                .collect(),
            schlick,
        }
    }
}

fn table(share: impl Fn(f32) -> f32) -> Vec<Albedo> {
    let value = |k: usize| {
        let cosine = ((k % SIDE) as f32 / (SIDE - 1) as f32).max(1e-3);
        let root = (k / SIDE) as f32 / (SIDE - 1) as f32;
        integrate(cosine, (root * root).max(MIN_ALPHA), &share)
    };
    (0..SIDE * SIDE).map(value).collect()
}

/// Albedo at one angle by 24 × 24 visible normals.
fn integrate(cosine: f32, alpha: f32, share: impl Fn(f32) -> f32) -> Albedo {
    const N: usize = 24;
    let view = Vec3::new((1.0 - cosine * cosine).max(0.0).sqrt(), 0.0, cosine);
    let a2 = alpha * alpha;
    let seen = 1.0 + masking(a2, view.z);
    let mut sum = Albedo::default();
    for i in 0..N * N {
        let at = |k: usize| (k as f32 + 0.5) / N as f32;
        let half = visible_normal(view, alpha, Vec2::new(at(i % N), at(i / N)));
        let light = 2.0 * view.dot(half) * half - view;
        if light.z > 0.0 {
            // Sampling visible normals leaves masking of the light only.
            let weight = seen / (seen + masking(a2, light.z.max(1e-4)));
            sum.whole += weight;
            sum.edge += weight * share(view.dot(half));
        }
    }
    let n = (N * N) as f32;
    Albedo {
        whole: sum.whole / n,
        edge: sum.edge / n,
    }
}
