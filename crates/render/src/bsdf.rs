//! Reflection at a surface: Lambert under a GGX coat, or a GGX metal; Blender's Principled with specular IOR 1.5.

use crate::material::Surface;
use crate::sampling::{cosine_hemisphere, frame};
use lumi_core::glam::{Vec2, Vec3};
use std::f32::consts::{PI, TAU};
use std::sync::LazyLock;

/// Reflectance at normal incidence of a dielectric with index of refraction 1.5.
const DIELECTRIC_F0: f32 = 0.04;
/// Smallest GGX α: sharper lobes than this are noise at any resolution we render.
const MIN_ALPHA: f32 = 2e-3;

/// The reflection of one surface point for one viewing direction; directions are in the world.
#[derive(Clone, Copy, Debug)]
pub struct Bsdf {
    tangent: Vec3,
    bitangent: Vec3,
    normal: Vec3,
    /// Viewing direction in the local frame.
    view: Vec3,
    diffuse: Vec3,
    f0: Vec3,
    /// Scale on single-scattering specular which gives back what bounces among microfacets (Turquin 2019).
    compensation: Vec3,
    alpha: f32,
    /// Probability of sampling the specular lobe.
    specular_share: f32,
}

/// A sampled direction.
#[derive(Clone, Copy, Debug)]
pub struct BsdfSample {
    /// Unit direction away from the surface.
    pub direction: Vec3,
    /// Reflection · cosine / density.
    pub weight: Vec3,
    /// Density per steradian of both lobes together.
    pub pdf: f32,
    /// Whether the specular lobe was chosen.
    pub specular: bool,
}

impl Bsdf {
    /// Reflection about `normal` toward `view` (unit, away from the surface, on the normal's side);
    /// α is at least `alpha_floor`.
    #[must_use]
    pub fn new(surface: &Surface, normal: Vec3, view: Vec3, alpha_floor: f32) -> Self {
        let (tangent, bitangent) = frame(normal);
        let local = Vec3::new(
            view.dot(tangent),
            view.dot(bitangent),
            view.dot(normal).max(1e-4),
        );
        let alpha = (surface.roughness * surface.roughness)
            .max(MIN_ALPHA)
            .max(alpha_floor);
        let metallic = surface.metallic.clamp(0.0, 1.0);
        let base = surface.base.clamp(Vec3::ZERO, Vec3::ONE);
        let f0 = Vec3::splat(DIELECTRIC_F0 * (1.0 - metallic)) + metallic * base;
        let (scale, bias) = ALBEDO.lookup(local.z, alpha);
        let single = scale + bias;
        let compensation = Vec3::ONE + f0 * ((1.0 - single) / single);
        // The coat keeps what it reflects from the diffuse base, as in Blender's albedo scaling.
        let coat = (DIELECTRIC_F0 * scale + bias) * (1.0 + DIELECTRIC_F0 * (1.0 - single) / single);
        let diffuse = base * ((1.0 - metallic) * (1.0 - coat).max(0.0));
        let specular = ((f0 * scale + bias) * compensation).element_sum();
        let share = specular / (specular + diffuse.element_sum()).max(1e-6);
        let specular_share = if metallic >= 1.0 {
            1.0
        } else {
            share.clamp(0.15, 0.9)
        };
        Self {
            tangent,
            bitangent,
            normal,
            view: local,
            diffuse,
            f0,
            compensation,
            alpha,
            specular_share,
        }
    }

    fn local(&self, d: Vec3) -> Vec3 {
        Vec3::new(
            d.dot(self.tangent),
            d.dot(self.bitangent),
            d.dot(self.normal),
        )
    }

    /// Reflection · cosine toward the world direction `light`, and the density with which
    /// [`Self::sample`] draws it.
    #[must_use]
    pub fn evaluate(&self, light: Vec3) -> (Vec3, f32) {
        self.evaluate_local(self.local(light))
    }

    fn evaluate_local(&self, light: Vec3) -> (Vec3, f32) {
        if light.z <= 0.0 {
            return (Vec3::ZERO, 0.0);
        }
        let cosine_density = light.z / PI;
        let half = (self.view + light).normalize();
        let (d, g1, g2) = self.microfacets(half, light);
        let fresnel = schlick(self.f0, self.view.dot(half));
        let specular = fresnel * self.compensation * (d * g2 / (4.0 * self.view.z));
        let visible_density = d * g1 / (4.0 * self.view.z);
        (
            self.diffuse * cosine_density + specular,
            self.specular_share * visible_density + (1.0 - self.specular_share) * cosine_density,
        )
    }

    /// GGX's distribution, Smith masking of the view and height-correlated masking of both.
    fn microfacets(&self, half: Vec3, light: Vec3) -> (f32, f32, f32) {
        let a2 = self.alpha * self.alpha;
        let t = half.z * half.z * (a2 - 1.0) + 1.0;
        let d = a2 / (PI * t * t).max(1e-20);
        let lambda = |c: f32| 0.5 * ((1.0 + a2 * (1.0 / (c * c) - 1.0)).sqrt() - 1.0);
        let (view, light) = (lambda(self.view.z), lambda(light.z.max(1e-4)));
        (d, 1.0 / (1.0 + view), 1.0 / (1.0 + view + light))
    }

    /// Draws a direction; `lobe` in [0, 1) chooses diffuse or specular.
    #[must_use]
    pub fn sample(&self, lobe: f32, u: Vec2) -> Option<BsdfSample> {
        let specular = lobe < self.specular_share;
        let light = if specular {
            let half = visible_normal(self.view, self.alpha, u);
            2.0 * self.view.dot(half) * half - self.view
        } else {
            cosine_hemisphere(u)
        };
        let (value, pdf) = self.evaluate_local(light);
        (pdf > 1e-9).then(|| BsdfSample {
            direction: (light.x * self.tangent + light.y * self.bitangent + light.z * self.normal)
                .normalize(),
            weight: value / pdf,
            pdf,
            specular,
        })
    }
}

/// Schlick's Fresnel reflectance.
fn schlick(f0: Vec3, cosine: f32) -> Vec3 {
    let c = (1.0 - cosine).clamp(0.0, 1.0);
    let c2 = c * c;
    f0 + (Vec3::ONE - f0) * (c2 * c2 * c)
}

/// A normal of the GGX microsurface as seen from `view` (spherical caps, Dupuy and Benyoub 2023).
fn visible_normal(view: Vec3, alpha: f32, u: Vec2) -> Vec3 {
    let stretch = Vec3::new(alpha, alpha, 1.0);
    let v = (view * stretch).normalize();
    let z = (1.0 - u.x) * (1.0 + v.z) - v.z;
    let r = (1.0 - z * z).max(0.0).sqrt();
    let (s, c) = (TAU * u.y).sin_cos();
    let half = Vec3::new(r * c, r * s, z) + v;
    (half * stretch).normalize_or(Vec3::Z)
}

/// Directional albedo of single-scattering GGX as `f0 · scale + bias`, over cosine and √α.
struct Albedo {
    values: Vec<(f32, f32)>,
}

const ALBEDO_SIDE: usize = 32;

static ALBEDO: LazyLock<Albedo> = LazyLock::new(Albedo::new);

impl Albedo {
    fn new() -> Self {
        let mut values = Vec::with_capacity(ALBEDO_SIDE * ALBEDO_SIDE);
        for i in 0..ALBEDO_SIDE * ALBEDO_SIDE {
            let cosine = ((i % ALBEDO_SIDE) as f32 / (ALBEDO_SIDE - 1) as f32).max(1e-3);
            let root = (i / ALBEDO_SIDE) as f32 / (ALBEDO_SIDE - 1) as f32;
            values.push(integrate(cosine, (root * root).max(MIN_ALPHA)));
        }
        Self { values }
    }

    fn lookup(&self, cosine: f32, alpha: f32) -> (f32, f32) {
        let last = (ALBEDO_SIDE - 1) as f32;
        let (x, y) = (cosine.min(1.0) * last, alpha.min(1.0).sqrt() * last);
        let (i, j) = (
            (x as usize).min(ALBEDO_SIDE - 2),
            (y as usize).min(ALBEDO_SIDE - 2),
        );
        let (tx, ty) = (x - i as f32, y - j as f32);
        let row = |j: usize| {
            let (a, b) = (
                self.values[j * ALBEDO_SIDE + i],
                self.values[j * ALBEDO_SIDE + i + 1],
            );
            (a.0 + tx * (b.0 - a.0), a.1 + tx * (b.1 - a.1))
        };
        let (a, b) = (row(j), row(j + 1));
        (a.0 + ty * (b.0 - a.0), a.1 + ty * (b.1 - a.1))
    }
}

/// Albedo at one angle by 32 × 32 visible normals.
fn integrate(cosine: f32, alpha: f32) -> (f32, f32) {
    const SIDE: usize = 32;
    let view = Vec3::new((1.0 - cosine * cosine).max(0.0).sqrt(), 0.0, cosine);
    let a2 = alpha * alpha;
    let lambda = |c: f32| 0.5 * ((1.0 + a2 * (1.0 / (c * c) - 1.0)).sqrt() - 1.0);
    let (mut scale, mut bias) = (0.0, 0.0);
    for i in 0..SIDE * SIDE {
        let u = Vec2::new(
            ((i % SIDE) as f32 + 0.5) / SIDE as f32,
            ((i / SIDE) as f32 + 0.5) / SIDE as f32,
        );
        let half = visible_normal(view, alpha, u);
        let light = 2.0 * view.dot(half) * half - view;
        if light.z > 0.0 {
            // Sampling visible normals leaves masking of the light only.
            let weight =
                (1.0 + lambda(view.z)) / (1.0 + lambda(view.z) + lambda(light.z.max(1e-4)));
            let f = schlick(Vec3::ZERO, view.dot(half)).x;
            scale += weight * (1.0 - f);
            bias += weight * f;
        }
    }
    let n = (SIDE * SIDE) as f32;
    (scale / n, bias / n)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sampling::Sampler;

    /// Mean weight of sampled directions: the albedo.
    fn albedo(surface: &Surface, cosine: f32) -> Vec3 {
        let view = Vec3::new((1.0 - cosine * cosine).sqrt(), 0.0, cosine);
        let bsdf = Bsdf::new(surface, Vec3::Z, view, 0.0);
        let n = 16_384;
        let mut sum = Vec3::ZERO;
        for i in 0..n {
            let mut sampler = Sampler::new(7, i, n);
            let (lobe, u) = (sampler.pair().x, sampler.pair());
            if let Some(s) = bsdf.sample(lobe, u) {
                sum += s.weight;
            }
        }
        sum / n as f32
    }

    #[test]
    fn white_surfaces_keep_energy() {
        for roughness in [0.05, 0.2, 0.5, 0.8, 1.0] {
            for cosine in [0.15, 0.5, 0.95] {
                for metallic in [0.0, 1.0] {
                    let surface = Surface {
                        base: Vec3::ONE,
                        roughness,
                        metallic,
                    };
                    let a = albedo(&surface, cosine).x;
                    let name =
                        format!("roughness {roughness} cosine {cosine} metallic {metallic}: {a}");
                    assert!(a < 1.02 && a > 0.97, "{name}");
                }
            }
        }
    }

    #[test]
    fn density_integrates_to_one_or_less() {
        let view = Vec3::new(0.6, 0.0, 0.8);
        for roughness in [0.3, 0.7, 1.0] {
            let bsdf = Bsdf::new(
                &Surface::dielectric(Vec3::splat(0.5), roughness),
                Vec3::Z,
                view,
                0.0,
            );
            let n = 400;
            let mut sum = 0.0_f64;
            for i in 0..n * n {
                let z = ((i / n) as f32 + 0.5) / n as f32;
                let (s, c) = (TAU * ((i % n) as f32 + 0.5) / n as f32).sin_cos();
                let r = (1.0 - z * z).sqrt();
                sum += f64::from(bsdf.evaluate(Vec3::new(r * c, r * s, z)).1);
            }
            let total = sum * f64::from(TAU) / f64::from(n * n);
            assert!(
                total < 1.01 && total > 0.85,
                "roughness {roughness}: {total}"
            );
        }
    }

    #[test]
    fn black_dielectric_reflects_four_percent_head_on() {
        let a = albedo(&Surface::dielectric(Vec3::ZERO, 0.1), 0.999).x;
        assert!((a - 0.04).abs() < 0.002, "{a}");
    }
}
