//! Reflection at a surface, as Blender's Principled BSDF has it for metallic-roughness inputs: Lambert under a GGX
//! dielectric, a GGX metal, any mixture of the two, and a clear coat over all.
//!
//! - A dielectric's reflectance is Fresnel's, scaled so that it is `0.04 · specular · specular_color` head on, and then
//!   by `specular_weight`; beyond what glass reflects it is Schlick's, as glTF's extensions have it. What it reflects
//!   (its directional albedo; of a tinted one the greatest of three) is taken from the Lambert below. So is what the
//!   coat reflects from all below it.
//! - A metal's reflectance is Schlick's with the base colour head on.
//! - Light that bounces between microfacets is given back by scaling the single bounce (Kulla and Conty 2017 for the
//!   amount, Turquin 2019 for the shape), unless [`Scattering::Single`] is asked for.

mod albedo;

use crate::material::Surface;
use crate::sampling::{cosine_hemisphere, frame};
use crate::scene::Shading;
use albedo::{lookup, mean};
use lumi_core::glam::{Vec2, Vec3};
use std::f32::consts::{PI, TAU};

/// Reflectance at normal incidence of a dielectric with index of refraction 1.5.
const DIELECTRIC_F0: f32 = 0.04;
/// What the densest glass with a table (an index of 1.8) reflects head on.
const GLASS_F0: f32 = 0.0817;
/// Smallest GGX α: sharper lobes than this are noise at any resolution we render.
const MIN_ALPHA: f32 = 2e-3;

/// Whether microfacets reflect light once or until it leaves.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Scattering {
    /// Rough surfaces keep their energy; Blender's "Multiscatter GGX", its default.
    #[default]
    Multiple,
    /// Rough surfaces lose the light that bounces twice; Blender's "GGX".
    Single,
}

/// Unit normals of a point, on the viewer's side of the triangle.
#[derive(Clone, Copy, Debug)]
pub struct Normals {
    /// Of the surface without relief.
    pub smooth: Vec3,
    /// Of the surface with relief.
    pub shading: Vec3,
    /// Of the coat.
    pub coat: Vec3,
}

impl Normals {
    /// Without relief.
    #[must_use]
    pub fn all(normal: Vec3) -> Self {
        Self {
            smooth: normal,
            shading: normal,
            coat: normal,
        }
    }
}

impl From<&Shading> for Normals {
    fn from(s: &Shading) -> Self {
        Self {
            smooth: s.smooth,
            shading: s.normal,
            coat: s.coat_normal,
        }
    }
}

/// A GGX lobe about a normal.
#[derive(Clone, Copy, Debug)]
struct Lobe {
    tangent: Vec3,
    bitangent: Vec3,
    normal: Vec3,
    /// Viewing direction in this frame.
    view: Vec3,
    alpha: f32,
    /// Whether the view is on the normal's side. A smooth normal may face away at the outline of a coarse mesh, where
    /// Cycles has no specular reflection; bending it to the viewer would draw bright rims around metals.
    facing: bool,
}

/// The reflection of one surface point for one viewing direction; directions are in the world.
#[derive(Clone, Copy, Debug)]
pub struct Bsdf {
    base: Lobe,
    smooth: Vec3,
    diffuse: Vec3,
    /// Base colour of the metal, and the weight of its lobe per channel.
    metal: (Vec3, Vec3),
    /// Reflectance head on and index of refraction of the dielectric (none for Schlick's curve), and the weight of its
    /// lobe.
    dielectric: (Vec3, Option<f32>, Vec3),
    /// Lobe and weight.
    coat: Option<(Lobe, f32)>,
    /// Probabilities of sampling the specular lobe and the coat.
    shares: [f32; 2],
}

/// A sampled direction.
#[derive(Clone, Copy, Debug)]
pub struct BsdfSample {
    /// Unit direction away from the surface.
    pub direction: Vec3,
    /// Reflection · cosine / density.
    pub weight: Vec3,
    /// Density per steradian of all lobes together.
    pub pdf: f32,
    /// Whether a specular lobe was chosen.
    pub specular: bool,
}

impl Bsdf {
    /// Reflection toward `view` (unit, away from the surface, on the normals' side); α is at least `alpha_floor`.
    #[must_use]
    pub fn new(
        surface: &Surface,
        normals: Normals,
        view: Vec3,
        alpha_floor: f32,
        scattering: Scattering,
    ) -> Self {
        let base = Lobe::new(normals.shading, view, surface.roughness, alpha_floor);
        let metallic = surface.metallic.clamp(0.0, 1.0);
        let color = surface.base.clamp(Vec3::ZERO, Vec3::ONE);
        let multiple = |f0: Vec3| match scattering {
            Scattering::Single => Vec3::ONE,
            Scattering::Multiple => base.compensation(f0),
        };
        let (cosine, alpha) = (base.view.z, base.alpha);

        let schlick = lookup(None, cosine, alpha);
        let metal_scale = metallic * multiple(color);
        let metal_albedo = (color * (schlick.whole - schlick.edge) + schlick.edge) * metal_scale;

        let f0 = DIELECTRIC_F0 * surface.specular * surface.specular_color;
        let f0 = f0.clamp(Vec3::ZERO, Vec3::ONE);
        let highest = f0.max_element();
        let ior = (highest <= GLASS_F0).then(|| (1.0 + highest.sqrt()) / (1.0 - highest.sqrt()));
        let (mut dielectric_scale, mut taken) = (Vec3::ZERO, Vec3::ZERO);
        if highest > 0.0 && metallic < 1.0 {
            let table = lookup(ior, cosine, alpha);
            dielectric_scale = surface.specular_weight.clamp(0.0, 1.0) * multiple(f0);
            taken = (f0 * (table.whole - table.edge) + table.edge) * dielectric_scale;
        }
        let diffuse = color * ((1.0 - metallic) * (1.0 - taken.max_element()).max(0.0));

        let mut this = Self {
            base,
            smooth: normals.smooth,
            diffuse,
            metal: (color, metal_scale),
            dielectric: (f0, ior, (1.0 - metallic) * dielectric_scale),
            coat: None,
            shares: [0.0; 2],
        };
        let mut weights = [
            this.diffuse.element_sum(),
            metal_albedo.element_sum() + (1.0 - metallic) * taken.element_sum(),
            0.0,
        ];
        if surface.coat > 0.0 {
            let weight = surface.coat.min(1.0);
            let lobe = Lobe::new(normals.coat, view, surface.coat_roughness, alpha_floor);
            let t = lookup(Some(1.5), lobe.view.z, lobe.alpha);
            let reflected = weight * (DIELECTRIC_F0 * (t.whole - t.edge) + t.edge);
            let left = 1.0 - reflected;
            this.diffuse *= left;
            this.metal.1 *= left;
            this.dielectric.2 *= left;
            this.coat = Some((lobe, weight));
            weights = [left * weights[0], left * weights[1], 3.0 * reflected];
        }
        this.shares = shares(weights);
        this
    }

    /// Reflection · cosine toward the world direction `light`, and the density with which
    /// [`Self::sample`] draws it.
    #[must_use]
    pub fn evaluate(&self, light: Vec3) -> (Vec3, f32) {
        let [specular_share, coat_share] = self.shares;
        let local = self.base.local(light);
        let (mut value, mut pdf) = (Vec3::ZERO, 0.0);
        if local.z > 0.0 {
            let cosine_density = local.z / PI;
            let lit = shadowing(self.smooth, self.base.normal, light);
            value += self.diffuse * (cosine_density * lit);
            pdf += (1.0 - specular_share - coat_share) * cosine_density;
        }
        if let Some((d, density, cosine)) = self.base.reflect(local) {
            let (color, metal) = self.metal;
            let (f0, ior, dielectric) = self.dielectric;
            let mut reflectance = metal * schlick(color, cosine);
            if dielectric != Vec3::ZERO {
                let share = ior.map_or_else(|| schlick_share(cosine), |n| fresnel_share(n, cosine));
                reflectance += dielectric * (f0 + (Vec3::ONE - f0) * share);
            }
            value += reflectance * d;
            pdf += specular_share * density;
        }
        if let Some((lobe, weight)) = &self.coat
            && let Some((d, density, cosine)) = lobe.reflect(lobe.local(light))
        {
            let fresnel = DIELECTRIC_F0 + (1.0 - DIELECTRIC_F0) * fresnel_share(1.5, cosine);
            value += weight * fresnel * d;
            pdf += coat_share * density;
        }
        (value, pdf)
    }

    /// Draws a direction; `lobe` in [0, 1) chooses among diffuse, specular and coat.
    #[must_use]
    pub fn sample(&self, lobe: f32, u: Vec2) -> Option<BsdfSample> {
        let [specular_share, coat_share] = self.shares;
        let specular = lobe < specular_share + coat_share;
        let direction = if lobe < specular_share {
            self.base.sample(u)
        } else if let Some((coat, _)) = self.coat.as_ref().filter(|_| specular) {
            coat.sample(u)
        } else {
            self.base.world(cosine_hemisphere(u))
        };
        let (value, pdf) = self.evaluate(direction);
        (pdf > 1e-9).then(|| BsdfSample {
            direction,
            weight: value / pdf,
            pdf,
            specular,
        })
    }
}

/// Probabilities of the second and third of `weights`, none of the present ones too small to be found.
fn shares(weights: [f32; 3]) -> [f32; 2] {
    let total = weights.iter().sum::<f32>().max(1e-6);
    let p = weights.map(|w| if w > 0.0 { (w / total).max(0.15) } else { 0.0 });
    let total = p.iter().sum::<f32>();
    if total > 0.0 {
        [p[1] / total, p[2] / total]
    } else {
        [0.0; 2]
    }
}

impl Lobe {
    fn new(normal: Vec3, view: Vec3, roughness: f32, alpha_floor: f32) -> Self {
        let (tangent, bitangent) = frame(normal);
        let alpha = (roughness * roughness).max(MIN_ALPHA).max(alpha_floor);
        let mut lobe = Self {
            tangent,
            bitangent,
            normal,
            view,
            alpha: alpha.min(1.0),
            facing: true,
        };
        lobe.view = lobe.local(view);
        lobe.facing = lobe.view.z > 0.0;
        lobe.view.z = lobe.view.z.max(1e-4);
        lobe
    }

    fn local(&self, d: Vec3) -> Vec3 {
        Vec3::new(
            d.dot(self.tangent),
            d.dot(self.bitangent),
            d.dot(self.normal),
        )
    }

    fn world(&self, d: Vec3) -> Vec3 {
        (d.x * self.tangent + d.y * self.bitangent + d.z * self.normal).normalize()
    }

    /// Reflection · cosine without Fresnel, density of [`Self::sample`], and the cosine at the microfacet.
    fn reflect(&self, light: Vec3) -> Option<(f32, f32, f32)> {
        if light.z <= 0.0 || !self.facing {
            return None;
        }
        let half = (self.view + light).normalize();
        let (d, g1, g2) = self.microfacets(half, light);
        let scale = d / (4.0 * self.view.z);
        Some((scale * g2, scale * g1, self.view.dot(half)))
    }

    /// GGX's distribution, Smith masking of the view and height-correlated masking of both.
    fn microfacets(&self, half: Vec3, light: Vec3) -> (f32, f32, f32) {
        let a2 = self.alpha * self.alpha;
        let t = half.z * half.z * (a2 - 1.0) + 1.0;
        let d = a2 / (PI * t * t).max(1e-20);
        let (view, light) = (masking(a2, self.view.z), masking(a2, light.z.max(1e-4)));
        (d, 1.0 / (1.0 + view), 1.0 / (1.0 + view + light))
    }

    fn sample(&self, u: Vec2) -> Vec3 {
        let half = visible_normal(self.view, self.alpha, u);
        self.world(2.0 * self.view.dot(half) * half - self.view)
    }

    /// Scale on the single bounce of a surface with reflectance `f0` head on that adds all further bounces.
    fn compensation(&self, f0: Vec3) -> Vec3 {
        let once = lookup(None, self.view.z, self.alpha).whole;
        let mean_once = mean(self.alpha);
        let fresnel = f0 + (Vec3::ONE - f0) / 21.0;
        let further = fresnel * mean_once / (Vec3::ONE - fresnel * (1.0 - mean_once));
        Vec3::ONE + further * ((1.0 - once) / once)
    }
}

/// Smith's Λ of GGX.
fn masking(a2: f32, cosine: f32) -> f32 {
    0.5 * ((1.0 + a2 * (1.0 / (cosine * cosine) - 1.0)).sqrt() - 1.0)
}

/// Schlick's Fresnel reflectance.
fn schlick(f0: Vec3, cosine: f32) -> Vec3 {
    f0 + (Vec3::ONE - f0) * schlick_share(cosine)
}

fn schlick_share(cosine: f32) -> f32 {
    let c = (1.0 - cosine).clamp(0.0, 1.0);
    let c2 = c * c;
    c2 * c2 * c
}

/// Fresnel's reflectance of a dielectric, mapped from [F0, 1] to [0, 1]: how far an angle is on the way from head on
/// to grazing.
fn fresnel_share(ior: f32, cosine: f32) -> f32 {
    let c = cosine.clamp(0.0, 1.0);
    let g = (ior * ior - 1.0 + c * c).max(0.0).sqrt();
    let (a, b) = ((g - c) / (g + c), (c * (g + c) - 1.0) / (c * (g - c) + 1.0));
    let f = 0.5 * a * a * (1.0 + b * b);
    let f0 = ((ior - 1.0) / (ior + 1.0)).powi(2);
    ((f - f0) / (1.0 - f0)).clamp(0.0, 1.0)
}

/// Darkens diffuse light where relief would let it reach faces that the surface itself shades, without a hard edge
/// (Chiang, Li and Burley, "Taming the Shadow Terminator", 2019).
fn shadowing(smooth: Vec3, normal: Vec3, light: Vec3) -> f32 {
    let below = normal.dot(light) * smooth.dot(normal);
    if below <= 0.0 || smooth == normal {
        return 1.0;
    }
    let g = smooth.dot(light) / below;
    if g >= 1.0 {
        1.0
    } else if g <= 0.0 {
        0.0
    } else {
        g * (1.0 + g * (1.0 - g))
    }
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

#[cfg(test)]
mod tests;
