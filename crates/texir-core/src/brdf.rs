//! THE BRDF: simplified Disney with the constants of TexIR (Li et al. 2023), following Karis, "Real Shading in Unreal
//! Engine 4" (2013). Value, sampling, density, and what derivatives by roughness have in closed form (that of Smith's
//! masking, which no adjoint pass needs, [`crate::real::Dual`] tells); `shaders/shared/brdf.wgsl` is its twin.
//!
//! Directions are unit and point away from the surface; `n·l` and so on are clamped to [0, 1] by the caller. r is the
//! perceptual roughness, α = r². No function here includes the cosine n·l unless it says so.
//!
//! The whole of it, with Lambert's diffuse model:
//!
//! ```
//! use texir_core::brdf::{Cosines, Masking, f0, fresnel_weight, specular_over_fresnel};
//! use texir_core::real::V3;
//!
//! /// f = a/π (1−m) + F D G / (4 nl nv), 1/sr, without the cosine n·l.
//! fn brdf(albedo: V3<f32>, roughness: f32, metallic: f32, [n, v, l]: [V3<f32>; 3]) -> V3<f32> {
//!     let c = Cosines::new(n, v, l);
//!     let x = fresnel_weight(c.vh);
//!     let fresnel = f0(albedo, metallic).map(|f0| f0 * (1.0 - x) + x);
//!     let diffuse = albedo * ((1.0 - metallic) / std::f32::consts::PI);
//!     diffuse + fresnel * specular_over_fresnel(Masking::Smith, &c, roughness)
//! }
//!
//! let up = V3([0.0, 0.0, 1.0]);
//! let mirrored = brdf(V3([0.5; 3]), 0.2, 0.0, [up; 3]);
//! // At normal incidence F = 0.04, D = 1/(π α²) and G / (4 nl nv) = 1/4.
//! let expected = (0.5 + 0.04 / (4.0 * 0.2f32.powi(4))) / std::f32::consts::PI;
//! assert!((mirrored.0[0] / expected - 1.0).abs() < 5e-3);
//! ```

use serde::{Deserialize, Serialize};

use crate::real::{Real, V3};

/// Normal-incidence reflectance of dielectrics.
pub const DIELECTRIC_F0: f64 = 0.04;

/// The cosines of one pair of directions.
#[derive(Clone, Copy, Debug)]
pub struct Cosines<R> {
    /// n·l
    pub nl: R,
    /// n·v
    pub nv: R,
    /// n·h
    pub nh: R,
    /// v·h
    pub vh: R,
}

impl<R: Real> Cosines<R> {
    /// Of a normal and the directions to the camera and to the light, cut to [0, 1].
    pub fn new(normal: V3<R>, view: V3<R>, light: V3<R>) -> Self {
        let half = (view + light).normalize();
        let cut = |cosine: R| cosine.max(R::of(0.0)).min(R::of(1.0));
        let [nl, nv, nh, vh] =
            [(normal, light), (normal, view), (normal, half), (view, half)].map(|(a, b)| cut(a.dot(b)));
        Self { nl, nv, nh, vh }
    }
}

/// D = α² / (π (nh²(α²−1)+1)²): GGX distribution of half-vectors, per solid angle.
pub fn ndf<R: Real>(nh: R, r: R) -> R {
    ndf_from_sin2(R::of(1.0) - nh * nh, r)
}

/// [`ndf`] by sin²θ_h instead of nh: D = α² / (π (α² + sin²θ_h (1−α²))²). In single precision nh cannot
/// resolve the peak of a smooth lobe; the sine of a small angle can.
#[inline]
pub fn ndf_from_sin2<R: Real>(sin2: R, r: R) -> R {
    let a2 = r * r * r * r;
    let d = a2 + sin2 * (R::of(1.0) - a2);
    a2 / (R::of(std::f64::consts::PI) * d * d)
}

/// How microfacets hide each other: the g of the shadowing–masking term G = g(nl)·g(nv)·nl·nv.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Masking {
    /// [`g_schlick`]: Schlick's approximation as TexIR has it, with the k that Karis gives for point lights.
    #[default]
    Schlick,
    /// [`g_smith`]: Smith's term of GGX, as glTF 2.0 (appendix B.3.2) and engines have it.
    Smith,
}

impl Masking {
    /// g(c) at perceptual roughness r.
    #[inline]
    pub fn at<R: Real>(self, c: R, r: R) -> R {
        match self {
            Self::Schlick => g_schlick(c, r),
            Self::Smith => g_smith(c, r),
        }
    }
}

/// g(c) = 2/(c + √(α² + (1−α²)c²)) (Walter et al., "Microfacet Models for Refraction through Rough Surfaces", 2007, eq.
/// 34).
#[inline]
pub fn g_smith<R: Real>(c: R, r: R) -> R {
    let a2 = r * r * r * r;
    R::of(2.0) / (c + (a2 + (R::of(1.0) - a2) * c * c).sqrt())
}

/// g(c) = 1/(c(1−k)+k), k = (r+1)²/8 (Schlick, "An Inexpensive BRDF Model for Physically-based Rendering", 1994, with
/// Karis' k).
#[inline]
pub fn g_schlick<R: Real>(c: R, r: R) -> R {
    let k = (r + R::of(1.0)) * (r + R::of(1.0)) * R::of(0.125);
    R::of(1.0) / (c * (R::of(1.0) - k) + k)
}

/// x = 2^((−5.55472 vh − 6.98316) vh), the spherical-Gaussian Fresnel weight: F = F0(1−x) + x.
pub fn fresnel_weight<R: Real>(vh: R) -> R {
    ((R::of(-5.55472) * vh - R::of(6.98316)) * vh).exp2()
}

/// ∂ln x/∂vh of [`fresnel_weight`].
pub fn d_ln_fresnel_weight<R: Real>(vh: R) -> R {
    R::of(std::f64::consts::LN_2) * (R::of(-5.55472 * 2.0) * vh - R::of(6.98316))
}

/// F0 = 0.04(1−m) + a·m.
pub fn f0<R: Real>(albedo: V3<R>, metallic: R) -> V3<R> {
    albedo.map(|a| R::of(DIELECTRIC_F0) * (R::of(1.0) - metallic) + a * metallic)
}

/// f_s / F = D G / (4 nl nv) = D g(nl) g(nv) / 4. No cosine.
pub fn specular_over_fresnel<R: Real>(masking: Masking, c: &Cosines<R>, r: R) -> R {
    ndf(c.nh, r) * masking.at(c.nl, r) * masking.at(c.nv, r) * R::of(0.25)
}

/// Density of the light direction under half-vector sampling, per solid angle: D nh / (4 vh).
pub fn pdf<R: Real>(c: &Cosines<R>, r: R) -> R {
    ndf(c.nh, r) * c.nh / (R::of(4.0) * c.vh)
}

/// (sin, cos) of the polar angle of the half-vector drawn by `u`: cos²θ_h = (1−u)/(1+(α²−1)u), both without
/// cancellation.
pub fn sample_half_vector<R: Real>(u: R, r: R) -> [R; 2] {
    let (a2u, rest) = (r * r * r * r * u, R::of(1.0) - u);
    [a2u, rest].map(|part| (part / (rest + a2u)).sqrt())
}

/// w = f_s nl / (p F) of half-vector sampling: g(nl) g(nv) nl vh / nh. The cosine n·l is included; times F it is the
/// estimator's weight.
pub fn sample_weight<R: Real>(masking: Masking, c: &Cosines<R>, r: R) -> R {
    masking.at(c.nl, r) * masking.at(c.nv, r) * c.nl * c.vh / c.nh
}

/// ψ_D = ∂ln D/∂r = 4/r − 8r³q/(q(r⁴−1)+1), q = nh², at a half-vector drawn by [`sample_half_vector`] with the same r:
/// with q = (1−u)/((1−u)+α²u) that is 4(2u−1)/r, which has no cancellation, and whose mean over u is visibly 0, as D nh
/// integrates to 1 for every r.
pub fn d_ln_ndf_sampled<R: Real>(u: R, r: R) -> R {
    R::of(4.0) * (R::of(2.0) * u - R::of(1.0)) / r
}

/// ∂ln(g(nl) g(nv))/∂r = −(r+1)/4 · [(1−nl) g(nl) + (1−nv) g(nv)] of [`g_schlick`], which paper mode descends by.
pub fn d_ln_schlick<R: Real>(nl: R, nv: R, r: R) -> R {
    let one = R::of(1.0);
    -(r + one) * R::of(0.25) * ((one - nl) * g_schlick(nl, r) + (one - nv) * g_schlick(nv, r))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::real::Dual;

    fn cosines<R: Real>(v: V3<R>, l: V3<R>) -> Cosines<R> {
        Cosines::new(V3([R::of(0.0), R::of(0.0), R::of(1.0)]), v, l)
    }

    fn directions() -> Vec<(V3<f64>, V3<f64>)> {
        let d = |t: f64, p: f64| V3([t.sin() * p.cos(), t.sin() * p.sin(), t.cos()]);
        let mut all = Vec::new();
        for t in [0.1, 0.6, 1.2, 1.5] {
            for s in [0.0, 0.4, 1.1, 1.45] {
                all.push((d(t, 0.3), d(s, 2.0)));
            }
        }
        all
    }

    /// ψ_D for any half-vector.
    fn d_ln_ndf<R: Real>(nh: R, r: R) -> R {
        let q = nh * nh;
        let r3 = r * r * r;
        R::of(4.0) / r - R::of(8.0) * r3 * q / (q * (r3 * r - R::of(1.0)) + R::of(1.0))
    }

    #[test]
    fn psi_is_the_logarithmic_derivative() {
        for (v, l) in directions() {
            for r in [0.05, 0.2, 0.5, 0.8, 1.0] {
                let c = cosines(v, l);
                let wide = Cosines { nl: Dual::of(c.nl), nv: Dual::of(c.nv), nh: Dual::of(c.nh), vh: Dual::of(c.vh) };
                let f = specular_over_fresnel(Masking::Schlick, &wide, Dual::variable(r));
                let psi = d_ln_ndf(c.nh, r) + d_ln_schlick(c.nl, c.nv, r);
                assert!((psi - f.du / f.re).abs() < 1e-9 * (1.0 + psi.abs()), "r {r}: {psi} against {}", f.du / f.re);
                // Negative control: without the masking term the derivative is wrong.
                assert!((d_ln_ndf(c.nh, r) - f.du / f.re).abs() > 1e-4);
            }
        }
    }

    #[test]
    fn sampled_psi_is_the_general_one() {
        for r in [0.1, 0.4, 0.9] {
            for u in [0.01, 0.3, 0.7, 0.99] {
                let general = d_ln_ndf(sample_half_vector(u, r)[1], r);
                assert!((general - d_ln_ndf_sampled(u, r)).abs() < 1e-6 * (1.0 + general.abs()));
            }
        }
    }

    #[test]
    fn weight_is_value_over_density() {
        for (v, l) in directions() {
            for (masking, r) in [(Masking::Schlick, 0.1), (Masking::Smith, 0.5), (Masking::Schlick, 0.9)] {
                let c = cosines(v, l);
                let direct = specular_over_fresnel(masking, &c, r) * c.nl / pdf(&c, r);
                assert!((sample_weight(masking, &c, r) - direct).abs() < 1e-9 * direct);
            }
        }
    }

    #[test]
    fn half_vectors_follow_their_density() {
        // Chi-squared over 32 bins of cosθ_h, equal in u: the distribution function of cos²θ_h under D nh is
        // 1 − u(cos²θ), with u = (1−q)/(1+(α²−1)q).
        let r = 0.4f64;
        let (bins, count) = (32usize, 1u32 << 16);
        let mut observed = vec![0u32; bins];
        for i in 0..count {
            let x = crate::rng::hash2(i, 5);
            let u = f64::from(x) / 4_294_967_296.0;
            let q = sample_half_vector(u, r * 1.0)[1].powi(2);
            let cdf = numeric_cdf(q, r);
            observed[((cdf * bins as f64) as usize).min(bins - 1)] += 1;
        }
        let expected = f64::from(count) / bins as f64;
        let chi2 = |o: &[u32]| o.iter().map(|&n| (f64::from(n) - expected).powi(2) / expected).sum::<f64>();
        assert!(chi2(&observed) < 61.1, "{}", chi2(&observed)); // 99.9 % quantile at 31 degrees of freedom
        // Negative control: the density of another roughness is rejected.
        let mut wrong = vec![0u32; bins];
        for i in 0..count {
            let u = f64::from(crate::rng::hash2(i, 5)) / 4_294_967_296.0;
            let cdf = numeric_cdf(sample_half_vector(u, 0.42)[1].powi(2), r);
            wrong[((cdf * bins as f64) as usize).min(bins - 1)] += 1;
        }
        assert!(chi2(&wrong) > 61.1);
    }

    /// ∫ D nh dω over half-vectors with cos²θ_h ≥ q, by the midpoint rule in z = cosθ.
    fn numeric_cdf(q: f64, r: f64) -> f64 {
        const STEPS: usize = 400;
        // Substitute z² = 1 − s, 2z dz = −ds: ∫ D z dω = π ∫ D ds over s in [0, 1−q].
        let top = 1.0 - q;
        (0..STEPS)
            .map(|i| {
                let s = top * (i as f64 + 0.5) / STEPS as f64;
                std::f64::consts::PI * ndf((1.0 - s).sqrt(), r) * top / STEPS as f64
            })
            .sum()
    }
}
