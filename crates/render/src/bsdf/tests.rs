use super::*;
use crate::sampling::Sampler;

fn bsdf(surface: &Surface, normals: Normals, view: Vec3, scattering: Scattering) -> Bsdf {
    Bsdf::new(surface, normals, view, 0.0, scattering)
}

/// Mean weight of sampled directions: the albedo.
fn albedo(surface: &Surface, cosine: f32, scattering: Scattering) -> Vec3 {
    let view = Vec3::new((1.0 - cosine * cosine).sqrt(), 0.0, cosine);
    let bsdf = bsdf(surface, Normals::all(Vec3::Z), view, scattering);
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
            for metallic in [0.0, 0.5, 1.0] {
                let surface = Surface {
                    metallic,
                    ..Surface::dielectric(Vec3::ONE, roughness)
                };
                let a = albedo(&surface, cosine, Scattering::Multiple).x;
                let name =
                    format!("roughness {roughness} cosine {cosine} metallic {metallic}: {a}");
                assert!(a < 1.015 && a > 0.985, "{name}");
            }
        }
    }
}

#[test]
fn no_surface_gains_energy() {
    for coat in [0.0, 0.5, 1.0] {
        for specular in [0.0, 0.3, 1.0, 2.0] {
            for roughness in [0.1, 0.6, 1.0] {
                for cosine in [0.1, 0.4, 0.9] {
                    let surface = Surface {
                        coat,
                        specular,
                        coat_roughness: 0.3,
                        ..Surface::dielectric(Vec3::ONE, roughness)
                    };
                    let a = albedo(&surface, cosine, Scattering::Multiple).x;
                    assert!(a < 1.015 && a > 0.9, "{surface:?} {cosine}: {a}");
                }
            }
        }
    }
}

#[test]
fn single_scattering_loses_what_it_must() {
    // At α = 1 and head on, half vectors are cosine-distributed and masking of the light is 2c/(1 + c), so that
    // the albedo is ∫₀¹ c/(1 + c) dc = 1 − ln 2. Little is lost when smooth.
    let rough = albedo(&Surface::metal(Vec3::ONE, 1.0), 0.9999, Scattering::Single).x;
    assert!((rough - (1.0 - 2.0_f32.ln())).abs() < 0.004, "{rough}");
    let smooth = albedo(&Surface::metal(Vec3::ONE, 0.2), 0.9, Scattering::Single).x;
    assert!(smooth > 0.99 && smooth <= 1.001, "{smooth}");
}

#[test]
fn densities_integrate_to_one_or_less_and_match_the_samples() {
    let view = Vec3::new(0.6, 0.0, 0.8);
    let tilted = Normals {
        smooth: Vec3::Z,
        shading: Vec3::new(0.2, -0.1, 1.0).normalize(),
        coat: Vec3::new(-0.1, 0.1, 1.0).normalize(),
    };
    for (coat, normals) in [(0.0, Normals::all(Vec3::Z)), (1.0, tilted)] {
        for roughness in [0.3, 0.7, 1.0] {
            let surface = Surface {
                coat,
                coat_roughness: 0.4,
                ..Surface::dielectric(Vec3::splat(0.5), roughness)
            };
            let bsdf = bsdf(&surface, normals, view, Scattering::Multiple);
            let n = 400;
            let (mut sum, mut reflected) = (0.0_f64, 0.0_f64);
            for i in 0..n * n {
                // The whole sphere: relief reflects below the horizon of the smooth surface.
                let z = 2.0 * ((i / n) as f32 + 0.5) / n as f32 - 1.0;
                let (s, c) = (TAU * ((i % n) as f32 + 0.5) / n as f32).sin_cos();
                let r = (1.0 - z * z).sqrt();
                let (value, pdf) = bsdf.evaluate(Vec3::new(r * c, r * s, z));
                sum += f64::from(pdf);
                reflected += f64::from(value.x);
            }
            let cell = 2.0 * f64::from(TAU) / f64::from(n * n);
            let name = format!("roughness {roughness} coat {coat}");
            let total = sum * cell;
            assert!(total < 1.01 && total > 0.8, "{name}: {total}");
            let n = 16_384;
            let drawn: f32 = (0..n)
                .filter_map(|i| {
                    let mut sampler = Sampler::new(3, i, n);
                    let (lobe, u) = (sampler.pair().x, sampler.pair());
                    Some(bsdf.sample(lobe, u)?.weight.x)
                })
                .sum();
            let (drawn, reflected) = (f64::from(drawn) / f64::from(n), reflected * cell);
            assert!(
                (drawn - reflected).abs() < 0.01 * reflected,
                "{name}: {drawn} {reflected}"
            );
        }
    }
}

#[test]
fn black_dielectric_reflects_four_percent_head_on() {
    for (specular, expected) in [(1.0, 0.04), (0.5, 0.02), (0.0, 0.0)] {
        let surface = Surface {
            specular,
            ..Surface::dielectric(Vec3::ZERO, 0.1)
        };
        let a = albedo(&surface, 0.999, Scattering::Multiple).x;
        assert!((a - expected).abs() < 0.002, "{a}");
    }
}

#[test]
fn fresnel_is_exact() {
    // Glass at 60°: the refracted ray has cosine √(2/3).
    let t = (2.0_f32 / 3.0).sqrt();
    let parallel = ((t - 0.75) / (t + 0.75)).powi(2);
    let perpendicular = ((0.5 - 1.5 * t) / (0.5 + 1.5 * t)).powi(2);
    let f = 0.04 + 0.96 * fresnel_share(1.5, 0.5);
    assert!((f - 0.5 * (parallel + perpendicular)).abs() < 1e-5, "{f}");
    assert_eq!(fresnel_share(1.5, 0.0), 1.0);
    assert!(fresnel_share(1.5, 1.0) < 1e-6);
}

#[test]
fn specular_colours_and_weights_are_what_a_black_dielectric_reflects() {
    let gold = Vec3::new(1.0, 0.766, 0.336);
    let black = Surface::dielectric(Vec3::ZERO, 0.1);
    for (specular, color, weight, expected) in [
        (25.0, gold, 1.0, gold),
        (25.0, Vec3::splat(0.04), 1.0, Vec3::splat(0.04)),
        (1.0, Vec3::splat(100.0), 1.0, Vec3::ONE),
        (25.0, gold, 0.25, 0.25 * gold),
    ] {
        let surface = Surface {
            specular,
            specular_color: color,
            specular_weight: weight,
            ..black
        };
        let a = albedo(&surface, 0.999, Scattering::Multiple);
        assert!(a.distance(expected) < 0.01, "{a} {expected}");
    }
    // Half the weight is half of it at grazing angles too.
    let grazing = |weight: f32| {
        let surface = Surface {
            specular_weight: weight,
            ..black
        };
        albedo(&surface, 0.1, Scattering::Multiple).x
    };
    assert!((grazing(0.5) - 0.5 * grazing(1.0)).abs() < 0.005);
    // Over white, no channel gains, and the greatest keeps all.
    for roughness in [0.1, 0.6, 1.0] {
        for cosine in [0.15, 0.9] {
            let surface = Surface {
                specular: 25.0,
                specular_color: 0.9 * gold,
                ..Surface::dielectric(Vec3::ONE, roughness)
            };
            let a = albedo(&surface, cosine, Scattering::Multiple);
            assert!(
                a.max_element() < 1.015 && a.x > 0.985,
                "{roughness} {cosine}: {a}"
            );
        }
    }
}
