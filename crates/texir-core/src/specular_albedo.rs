//! What a dielectric reflects specularly of uniform light, by roughness: beside its diffuse albedo, what a surface
//! sends on of the light that arrives.

use std::f32::consts::PI;
use std::sync::LazyLock;

use crate::brdf::{Cosines, DIELECTRIC_F0, Masking, fresnel_weight, sample_half_vector, sample_weight};
use crate::real::V3;

/// Roughnesses of a table, from 0 to 1.
const NODES: usize = 33;
/// Quadrature points per axis.
const STEPS: usize = 32;

static SCHLICK: LazyLock<Vec<f32>> = LazyLock::new(|| table(Masking::Schlick));
static SMITH: LazyLock<Vec<f32>> = LazyLock::new(|| table(Masking::Smith));

/// The share of uniform light that a dielectric (F0 = 0.04) of perceptual roughness `r` reflects specularly, into all
/// directions together: ∫∫ f_s cosθ_i cosθ_o dω_i dω_o / π, from 0.09 (smooth, Smith's masking) to 0.02 (rough). What
/// bounces between microfacets is left out, as the BRDF does.
pub fn specular_albedo(masking: Masking, r: f32) -> f32 {
    let table = match masking {
        Masking::Schlick => &SCHLICK,
        Masking::Smith => &SMITH,
    };
    let place = r.clamp(0.0, 1.0) * (NODES - 1) as f32;
    let i = (place as usize).min(NODES - 2);
    let beyond = place - i as f32;
    table[i] * (1.0 - beyond) + table[i + 1] * beyond
}

fn table(masking: Masking) -> Vec<f32> {
    (0..NODES).map(|i| integral(masking, i as f32 / (NODES - 1) as f32)).collect()
}

/// By the midpoint rule in n·v, and in the square that half-vectors are drawn from; one half of it mirrors the other.
fn integral(masking: Masking, r: f32) -> f32 {
    let at = |i: usize| (i as f32 + 0.5) / STEPS as f32;
    let normal = V3([0.0, 0.0, 1.0]);
    let mut sum = 0.0;
    for i in 0..STEPS {
        let nv = at(i);
        let view = V3([(1.0 - nv * nv).sqrt(), 0.0, nv]);
        for j in 0..STEPS {
            let [sin, cos] = sample_half_vector(at(j), r);
            for k in 0..STEPS {
                let phi = PI * at(k);
                let half = V3([sin * phi.cos(), sin * phi.sin(), cos]);
                let light = half * (2.0 * view.dot(half)) - view;
                if view.dot(half) > 0.0 && light.dot(normal) > 0.0 {
                    let c = Cosines { nl: light.dot(normal), nv, nh: cos, vh: view.dot(half) };
                    let (f0, x) = (DIELECTRIC_F0 as f32, fresnel_weight(c.vh));
                    sum += 2.0 * nv * sample_weight(masking, &c, r) * (f0 * (1.0 - x) + x);
                }
            }
        }
    }
    sum / (STEPS * STEPS * STEPS) as f32
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::brdf::specular_over_fresnel;

    #[test]
    fn it_is_the_brdfs_integral_over_both_hemispheres() {
        // By spherical angles of both directions, in double precision: for lobes that such steps resolve.
        let steps = 96;
        let angle = |i: usize, all: f64| all * (i as f64 + 0.5) / steps as f64;
        let direction = |theta: f64, phi: f64| V3([theta.sin() * phi.cos(), theta.sin() * phi.sin(), theta.cos()]);
        let normal = V3([0.0, 0.0, 1.0]);
        for masking in [Masking::Schlick, Masking::Smith] {
            for r in [0.4, 0.7, 1.0] {
                let mut sum = 0.0;
                for i in 0..steps {
                    let view = direction(angle(i, std::f64::consts::FRAC_PI_2), 0.0);
                    for j in 0..steps {
                        for k in 0..steps {
                            let (theta, phi) = (angle(j, std::f64::consts::FRAC_PI_2), angle(k, std::f64::consts::PI));
                            let light = direction(theta, phi);
                            let c = Cosines::new(normal, view, light);
                            let x = fresnel_weight(c.vh);
                            let fresnel = DIELECTRIC_F0 * (1.0 - x) + x;
                            let sines = (1.0 - c.nv * c.nv).sqrt() * theta.sin();
                            sum += fresnel * specular_over_fresnel(masking, &c, r) * c.nl * c.nv * sines;
                        }
                    }
                }
                // Cells of (π/2)² π / steps³; light from both halves; 2π azimuths of the view, over π.
                let cell = (std::f64::consts::FRAC_PI_2 / steps as f64).powi(2) * std::f64::consts::PI / steps as f64;
                let (expected, found) = (sum * cell * 4.0, f64::from(specular_albedo(masking, r as f32)));
                assert!((found / expected - 1.0).abs() < 0.01, "{masking:?}, {r}: {found} for {expected}");
            }
        }
    }

    #[test]
    fn smooth_surfaces_reflect_what_fresnel_says_and_rough_ones_less() {
        // ∫ F(c) 2c dc by the midpoint rule.
        let steps = 1000;
        let fresnel = |i: usize| {
            let c = (i as f32 + 0.5) / steps as f32;
            let x = fresnel_weight(c);
            2.0 * c * (DIELECTRIC_F0 as f32 * (1.0 - x) + x) / steps as f32
        };
        let expected: f32 = (0..steps).map(fresnel).sum();
        assert!((specular_albedo(Masking::Smith, 0.0) / expected - 1.0).abs() < 5e-3, "{expected}");
        for masking in [Masking::Schlick, Masking::Smith] {
            let all: Vec<f32> = (2..=20).map(|i| specular_albedo(masking, i as f32 / 20.0)).collect();
            assert!(all.is_sorted_by(|a, b| a > b), "{all:?}");
        }
    }
}
